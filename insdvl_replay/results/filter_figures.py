"""The old place of these names."""

from insdvl_replay.show.figures import *  # noqa: F403
