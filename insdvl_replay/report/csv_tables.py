"""The old place of these names."""

from insdvl_replay.show.document import *  # noqa: F403
