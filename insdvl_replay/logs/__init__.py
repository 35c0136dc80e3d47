"""Logs: the only room that knows MCAP, and the bags and messages of ROS.

`container` finds the messages in a file as blocks of bytes, `encoding` takes the fields out of their bytes, and
`columns` makes of them the clean columns of the roles; `read` joins the three. `write` goes the other way.
"""

from insdvl_replay.logs.formats.recording import name_giver
from insdvl_replay.logs.read import read_dive
from insdvl_replay.logs.write import write_dive, write_replay

__all__ = ["name_giver", "read_dive", "write_dive", "write_replay"]
