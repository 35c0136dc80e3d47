"""The old place of these names."""

from insdvl_replay.show.plot import *  # noqa: F403
