"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.layout import layout_for_texts as layout_for_texts
