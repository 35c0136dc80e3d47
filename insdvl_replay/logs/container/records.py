"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.log_file import LogChannel as LogChannel
from insdvl_replay.logs.formats.log_file import by_topic as by_topic
from insdvl_replay.logs.formats.records import MAGIC as MAGIC
