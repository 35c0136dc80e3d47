"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.log_file import COPY_AGAIN as COPY_AGAIN
from insdvl_replay.logs.formats.log_file import damaged_file_error as damaged_file_error
