"""The result of a study: sentences and tables, for people, for scripts and for the folder that keeps them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta, Struct

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.errors import Note
from insdvl_replay.report.csv_tables import blocks_csv, table_csv
from insdvl_replay.report.document import (
    PAGE,
    Callout,
    DisplayTable,
    Facts,
    Heading,
    Only,
    Part,
    Title,
    losses,
    settings_details,
)
from insdvl_replay.report.plots.panel import Figure
from insdvl_replay.results.folder import COMPLETE
from insdvl_replay.results.folder import PAGE as PAGE_FILE
from insdvl_replay.results.json_report import Files, Tool, as_json, package_versions, this_tool

if TYPE_CHECKING:
    # Only their types are needed, and whoever asks for the schema must not wait for them.
    import pandas as pd


@dataclass(frozen=True)
class StudyReport:
    """What a study found.

    Attributes
    ----------
    study : str
        Name of the command.
    title : str
        What was studied, in one line.
    arguments : mapping of str to anything
        What it was asked, as JSON can write it.
    sentences : tuple of str
        What it found, in words.
    tables : mapping of str to DataFrame
        What it found, in numbers.
    display : tuple of DisplayTable
        The same for people.
    config : Config
        Resolved settings.
    notes : tuple of Note
        What was dropped, assumed or found odd.
    series : mapping of str to DataFrame
        Long tables, which go to files alone.
    """

    study: str
    title: str
    arguments: Mapping[str, Any]
    sentences: tuple[str, ...]
    tables: "Mapping[str, pd.DataFrame]"
    display: tuple[DisplayTable, ...]
    config: Config
    notes: tuple[Note, ...] = ()
    series: "Mapping[str, pd.DataFrame]" = field(default_factory=dict)


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


def write_study(
    report: StudyReport, folder: Path, figures: Mapping[str, Figure] | None = None, *, png: bool = False
) -> None:
    """Write the figures, the tables, the settings, the page and, last, the file by which a result is known."""
    # Not for whoever asks for the schema, which must not wait for numpy.
    from insdvl_replay.report.page import page
    from insdvl_replay.report.plots.png import figure_png
    from insdvl_replay.report.plots.svg import sheet_svg

    figures = figures or {}
    for name, figure in figures.items():
        (folder / f"{name}.svg").write_bytes(sheet_svg(figure))
        if png:
            (folder / f"{name}.png").write_bytes(figure_png(figure))
    (folder / PAGE_FILE).write_bytes(page(study_document(report, list(figures.values()))))
    for name, table in {**report.tables, **report.series}.items():
        (folder / f"{name}.csv").write_bytes(table_csv(table))
    (folder / "config.toml").write_text(render_toml(report.config), "utf-8")
    (folder / COMPLETE).write_bytes(study_json(report))


def study_document(report: StudyReport, figures: Sequence[Figure] = ()) -> list[Part]:
    """Lay out a study."""
    return [
        Title(report.title),
        *map(Callout, report.sentences),
        Heading("Pictures"),
        *figures,
        Heading("Tables"),
        *report.display,
        Heading("What was lost or assumed"),
        Only(PAGE, (losses(report.notes),)),
        Heading("Provenance"),
        *_provenance(report),
    ]


def study_csv(report: StudyReport) -> str:
    """Write the tables one after the other."""
    return blocks_csv(
        "table",
        {
            name: (list(table.columns), table.itertuples(index=False, name=None))
            for name, table in report.tables.items()
        },
    )


def study_json(report: StudyReport) -> bytes:
    """Write a study as JSON, null for what is missing. The same study gives the same bytes."""
    result = StudyResult(
        tool=this_tool(),
        versions=package_versions(),
        study=report.study,
        arguments=dict(report.arguments),
        sentences=list(report.sentences),
        tables={name: _rows(table) for name, table in report.tables.items()},
        notes=list(report.notes),
        config=msgspec.to_builtins(report.config),
    )
    return as_json(result)


def _rows(table: "pd.DataFrame") -> list[dict[str, Any]]:
    return [{str(column): value for column, value in row.items()} for row in table.to_dict("records")]


def _provenance(report: StudyReport) -> tuple[Part, ...]:
    tool = Tool()
    asked = {
        name: ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        for name, value in report.arguments.items()
    }
    versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
    return (
        Facts({**asked, "tool": f"{tool.name} {tool.version}", "with": versions}),
        settings_details(render_toml(report.config)),
    )
