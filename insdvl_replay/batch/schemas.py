"""The JSON schema of everything that is read or written as JSON or TOML, and the definitions of messages."""

from typing import Any

from insdvl_replay.core.errors import ConfigError, LogError, hint_for

SCHEMAS = (
    "config",
    "report",
    "inspection",
    "study",
    "comparison",
    "trajectories",
    "calibration",
    "check",
    "history",
    "start",
)
"""Everything with a JSON schema: the settings, `report.json` of a replay and of a study, and the `--format json` output
of the other commands."""


def schema_text(name: str | None = None) -> str:
    """Return a JSON schema, or the definition of a ROS 2 message; without a name, the names of all schemas.

    Raises
    ------
    ConfigError
        Neither a schema nor a message type has this name.
    """
    if name is None:
        return "".join(f"{known}\n" for known in SCHEMAS)
    if name in SCHEMAS:
        return json_schema(name).decode()
    from insdvl_replay.logs.formats.definitions import definition_text

    known = [*SCHEMAS, "a message type such as insdvl_msgs/msg/NavSolution"]
    try:
        return definition_text(name)
    except LogError as error:
        hint = hint_for(name, known, most=len(known))
        raise ConfigError(f"schema '{name}' is not known", hint) from error


def lines_for_editors(name: str | None) -> str:
    """Return the first lines of a file of settings, by which editors find its schema, with what they need.

    Raises
    ------
    ConfigError
        It is asked for another schema than that of the settings.
    """
    from insdvl_replay.core.config_file import SCHEMA_FILE, SCHEMA_LINE

    if name != "config":
        text = "--toml: only files of settings are TOML with a schema"
        raise ConfigError(text, "`insdvl-replay schema config --toml`")
    return (
        f"{SCHEMA_LINE}"
        "# With this first line, editors complete the keys of a file, show their units and mark mistakes.\n"
        "# VS Code does it with the extension Even Better TOML, other editors with the server Taplo.\n"
        "# They need the schema in the same folder:\n"
        f"#   insdvl-replay schema config > {SCHEMA_FILE}\n"
    )


def json_schema(name: str) -> bytes:
    """Return the JSON schema (draft 2020-12) of one of `SCHEMAS`."""
    from insdvl_replay.core.report import as_json

    title = name
    if name == "config":
        title = "configuration"
    described: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"insdvl-replay {title}",
        **_with_words(_bare_schema(name)),
    }
    if name == "config":
        filters = described["$defs"]["ConfigFile"]["properties"]["filters"]
        filters["additionalProperties"] = {
            "anyOf": [filters["additionalProperties"], {"const": False}]
        }
    return as_json(described)


def _bare_schema(name: str) -> dict[str, Any]:
    """Return the schema of what is written, without words on it."""
    import msgspec

    from insdvl_replay.calibration.rows import TABLES as CALIBRATION
    from insdvl_replay.changes.formats import CheckReport
    from insdvl_replay.core.config import ConfigFile
    from insdvl_replay.core.report import Report
    from insdvl_replay.document.parts import ResultJson
    from insdvl_replay.document.render import result_schema
    from insdvl_replay.inspection.inventory import Inventory

    kinds: dict[str, type] = {
        "config": ConfigFile,
        "report": Report,
        "inspection": Inventory,
        "study": ResultJson,
        "check": CheckReport,
    }
    if name == "comparison":  # the other schemas do not wait for scipy
        from insdvl_replay.changes.comparison import Comparison

        kinds[name] = Comparison
    if name == "trajectories":
        from insdvl_replay.trajectories.comparison import TrajectoryComparison

        kinds[name] = TrajectoryComparison
    if name == "start":  # nor for numba
        from insdvl_replay.nav.user_candidate import StartFile

        kinds[name] = StartFile
    if name in kinds:
        return msgspec.json.schema(kinds[name])
    if name == "history":
        from insdvl_replay.show.history import TABLES as HISTORY

        return result_schema(HISTORY)
    return result_schema(CALIBRATION)


def _with_words(schema: dict[str, Any]) -> dict[str, Any]:
    """Put the allowed words of a value where it is described, not into separate definitions."""
    definitions = schema["$defs"]
    words = {
        f"#/$defs/{name}": found["enum"] for name, found in definitions.items() if "enum" in found
    }

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
