"""Logs: the only room that knows MCAP and ROS 2."""

from insdvl_replay.logs.dive_log import write_dive
from insdvl_replay.logs.reader import read_dive
from insdvl_replay.logs.recording import name_giver
from insdvl_replay.logs.replay_log import write_replay
from insdvl_replay.logs.survey import survey_log

__all__ = ["name_giver", "read_dive", "survey_log", "write_dive", "write_replay"]
