"""Logs: the only folder that knows MCAP, and the bags and messages of ROS.

`formats` finds the messages of a file as blocks of bytes and takes the fields out of them. `columns` makes clean
columns of the fields, for each role. `read` joins the two. `write` goes the other way.
"""

from insdvl_replay.logs.formats.mcap_file import MAGIC
from insdvl_replay.logs.formats.recording import name_giver
from insdvl_replay.logs.read import held_back_messages, read_dive, read_solution
from insdvl_replay.logs.write import copy_log, write_dive, write_replay

__all__ = [
    "MAGIC", "copy_log", "held_back_messages", "name_giver", "read_dive", "read_solution", "write_dive", "write_replay"
]  # fmt: skip
