"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.recording import OTHER_FORMATS as OTHER_FORMATS
from insdvl_replay.logs.formats.recording import OtherFormat as OtherFormat
