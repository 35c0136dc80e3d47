"""Logs: the only room that knows MCAP, and the bags and messages of ROS.

`container` finds the messages in a file as blocks of bytes, `encoding` takes the fields out of their bytes, and
`columns` makes of them the clean columns of the roles; `reader` joins the three. `writing` goes the other way.
"""

from insdvl_replay.logs.container.recording import name_giver
from insdvl_replay.logs.reader import read_dive
from insdvl_replay.logs.writing.dive_log import write_dive
from insdvl_replay.logs.writing.replay_log import write_replay

__all__ = ["name_giver", "read_dive", "write_dive", "write_replay"]
