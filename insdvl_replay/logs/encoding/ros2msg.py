"""Names of `logs.formats` for those who still ask here."""

from insdvl_replay.logs.formats.types import PRIMITIVES as PRIMITIVES
from insdvl_replay.logs.formats.types import Field as Field
from insdvl_replay.logs.formats.types import definition_text as definition_text
from insdvl_replay.logs.formats.types import full_name as full_name
from insdvl_replay.logs.formats.types import missing_types as missing_types
from insdvl_replay.logs.formats.types import parse_definitions as _parse_definitions

Definition = tuple[Field, ...]


def parse_definitions(type_name: str, text: str) -> dict[str, Definition]:
    """Parse the full text of a type."""
    return dict(_parse_definitions(type_name, text))
