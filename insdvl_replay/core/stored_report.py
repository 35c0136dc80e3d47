"""The old place of these names."""

from insdvl_replay.core.result import *  # noqa: F403
