"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.fields import ENCODINGS as ENCODINGS
from insdvl_replay.logs.formats.fields import NUMBER as NUMBER
from insdvl_replay.logs.formats.fields import ROWS as ROWS
from insdvl_replay.logs.formats.fields import Columns as Columns
from insdvl_replay.logs.formats.fields import Element as Element
from insdvl_replay.logs.formats.fields import FieldReader as FieldReader
from insdvl_replay.logs.formats.fields import Kinds as Kinds
from insdvl_replay.logs.formats.fields import channel_paths as channel_paths
from insdvl_replay.logs.formats.fields import check_encoding as check_encoding
from insdvl_replay.logs.formats.fields import check_path as check_path
from insdvl_replay.logs.formats.fields import fields_hint as fields_hint
from insdvl_replay.logs.formats.fields import find_path as find_path
from insdvl_replay.logs.formats.fields import open_reader as open_reader
from insdvl_replay.logs.formats.fields import split_paths as split_paths
