"""The old place of these names."""

from insdvl_replay.show.page import *  # noqa: F403
