"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.log_file import Block as Block
