"""A study as JSON."""

from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta, Struct

from insdvl_replay.core.errors import Note
from insdvl_replay.results.json_report import Files, Tool, as_json, package_versions, records, this_tool

if TYPE_CHECKING:
    # Only its type is needed, and whoever asks for the schema must not wait for pandas.
    from insdvl_replay.studies.study_report import StudyReport


class StudyResult(Struct, frozen=True):
    """What a study keeps as JSON."""

    tool: Tool
    versions: Annotated[dict[str, str], Meta(description="of Python and the packages that may move a number")]
    study: Annotated[str, Meta(description="name of the command")]
    arguments: Annotated[dict[str, Any], Meta(description="what it was asked")]
    sentences: Annotated[list[str], Meta(description="what it found, in words")]
    tables: Annotated[
        dict[str, list[dict[str, Any]]], Meta(description="row for row as in the CSV files; null for what is missing")
    ]
    notes: Annotated[list[Note], Meta(description="what was dropped, assumed or found odd")]
    config: Annotated[dict[str, Any], Meta(description="resolved settings, as in config.schema.json")]
    files: Files = {}


def study_json(report: "StudyReport") -> bytes:
    """Write a study as JSON, null for what is missing. The same study gives the same bytes."""
    result = StudyResult(
        tool=this_tool(),
        versions=package_versions(),
        study=report.study,
        arguments=dict(report.arguments),
        sentences=list(report.sentences),
        tables={name: records(table) for name, table in report.tables.items()},
        notes=list(report.notes),
        config=msgspec.to_builtins(report.config),
    )
    return as_json(result)
