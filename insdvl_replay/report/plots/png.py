"""The old place of these names."""

from insdvl_replay.show.paper import *  # noqa: F403
