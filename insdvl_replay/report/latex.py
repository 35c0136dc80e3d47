"""The old place of these names."""

from insdvl_replay.show.text import *  # noqa: F403
