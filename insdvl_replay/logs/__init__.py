"""Logs: the only folder that knows MCAP, and the bags and messages of ROS.

`formats` finds the messages of a file as blocks of bytes and takes the fields out of them. `columns` makes clean
columns of the fields, for each role. `read` joins the two. `write` goes the other way.
"""

from insdvl_replay.logs.formats.recording import name_giver
from insdvl_replay.logs.read import read_dive
from insdvl_replay.logs.write import write_dive, write_replay

__all__ = ["name_giver", "read_dive", "write_dive", "write_replay"]
