"""The old place of these names."""

from insdvl_replay.core.tables import *  # noqa: F403
