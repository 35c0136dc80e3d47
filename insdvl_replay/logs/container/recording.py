"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.recording import CHANNELS_OF_A_PART as CHANNELS_OF_A_PART
from insdvl_replay.logs.formats.recording import Recording as Recording
from insdvl_replay.logs.formats.recording import bag_parts as bag_parts
from insdvl_replay.logs.formats.recording import name_giver as name_giver
from insdvl_replay.logs.formats.recording import open_recording as open_recording
