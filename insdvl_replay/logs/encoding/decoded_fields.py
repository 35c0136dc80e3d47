"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.decoded import DecodedFields as DecodedFields
