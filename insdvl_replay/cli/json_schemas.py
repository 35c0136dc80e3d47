"""JSON schemas of settings and results, generated from the structures that read and write them."""

from typing import Any, Final

import msgspec

from insdvl_replay.calibration.rows import TABLES as CALIBRATION
from insdvl_replay.changes.comparison import Comparison
from insdvl_replay.changes.formats import CheckReport
from insdvl_replay.core.config import Config
from insdvl_replay.core.result import Report, ResultJson, as_json
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.show.render import result_schema

SCHEMAS: Final[dict[str, type | dict[str, type[msgspec.Struct]]]] = {
    "config": Config,
    "report": Report,
    "inspection": Inventory,
    "study": ResultJson,
    "comparison": Comparison,
    "calibration": CALIBRATION,
    "check": CheckReport,
}
"""By the name that the command line and the files in schemas/ use: what `config` reads from TOML, `report.json` of a
replay and of a study, and what `--format json` prints of the other commands. Of a result that is its tables."""


def json_schema(name: str) -> bytes:
    """Describe one of them as JSON schema (draft 2020-12)."""
    title, found = "configuration" if name == "config" else name, SCHEMAS[name]
    schema: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"insdvl-replay {title}",
        **_with_words(result_schema(found) if isinstance(found, dict) else msgspec.json.schema(found)),
    }
    return as_json(schema)


def _with_words(schema: dict[str, Any]) -> dict[str, Any]:
    """List the words that a value may be where it is described, not as definitions of their own."""
    definitions = schema["$defs"]
    words = {f"#/$defs/{name}": found["enum"] for name, found in definitions.items() if "enum" in found}

    def listed(part: Any) -> Any:
        if isinstance(part, list):
            return [listed(inner) for inner in part]
        if not isinstance(part, dict):
            return part
        if part.get("$ref") in words:
            part = {"enum": words[part["$ref"]], **part}
            del part["$ref"]
        return {key: listed(inner) for key, inner in part.items()}

    others = {name: found for name, found in definitions.items() if "enum" not in found}
    return {**schema, "$defs": listed(others)}
