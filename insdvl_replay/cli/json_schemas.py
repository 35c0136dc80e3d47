"""JSON schemas of settings and results, generated from the structures that read and write them."""

from collections.abc import Callable
from typing import Any, Final

import msgspec

from insdvl_replay.core.changes import Comparison
from insdvl_replay.core.config import Config
from insdvl_replay.gates.check_json import CheckReport
from insdvl_replay.inspection.inventory import Inventory
from insdvl_replay.results.json_report import Report, as_json


def config_schema() -> bytes:
    """Describe the configuration, once it is read from TOML, as JSON schema (draft 2020-12)."""
    return _schema(Config, "insdvl-replay configuration")


def report_schema() -> bytes:
    """Describe report.json as JSON schema (draft 2020-12)."""
    return _schema(Report, "insdvl-replay report")


def inspection_schema() -> bytes:
    """Describe what ``inspect --format json`` prints as JSON schema (draft 2020-12)."""
    return _schema(Inventory, "insdvl-replay inspection")


def study_schema() -> bytes:
    """Describe the report.json of a study as JSON schema (draft 2020-12)."""
    # Its tables and pictures are heavy to import, and no other schema waits for that.
    from insdvl_replay.studies.study_report import StudyResult

    return _schema(StudyResult, "insdvl-replay study")


def comparison_schema() -> bytes:
    """Describe what ``compare --format json`` prints as JSON schema (draft 2020-12)."""
    return _schema(Comparison, "insdvl-replay comparison")


def check_schema() -> bytes:
    """Describe what ``check --format json`` prints as JSON schema (draft 2020-12)."""
    return _schema(CheckReport, "insdvl-replay check")


SCHEMAS: Final[dict[str, Callable[[], bytes]]] = {
    "config": config_schema,
    "report": report_schema,
    "inspection": inspection_schema,
    "study": study_schema,
    "comparison": comparison_schema,
    "check": check_schema,
}
"""By the name that the command line and the files in schemas/ use."""


def _schema(root: type, title: str) -> bytes:
    schema: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **msgspec.json.schema(root),
    }
    return as_json(schema)
