"""The result of a study: sentences and tables, for people, for scripts, as a page, and the folder that keeps them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pandas as pd
from matplotlib.figure import Figure
from msgspec import Meta, Struct
from rich.console import Group, RenderableType
from rich.text import Text

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import render_toml
from insdvl_replay.core.errors import Note
from insdvl_replay.report.csv_tables import rows_csv, table_csv
from insdvl_replay.report.display_table import ShownTable
from insdvl_replay.report.markup import latex_page, markdown_page
from insdvl_replay.report.page import Heading, Lead, Part, page
from insdvl_replay.report.page_parts import facts, losses, picture, settings_details
from insdvl_replay.report.pictures import picture_bytes
from insdvl_replay.report.terminal import dressed, spoken
from insdvl_replay.results.folder import COMPLETE, PAGE
from insdvl_replay.results.json_report import Files, Tool, as_json, package_versions, this_tool


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
    shown : tuple of ShownTable
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
    tables: Mapping[str, pd.DataFrame]
    shown: tuple[ShownTable, ...]
    config: Config
    notes: tuple[Note, ...] = ()
    series: Mapping[str, pd.DataFrame] = field(default_factory=dict)


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
    report: StudyReport, folder: Path, pictures: Mapping[str, Figure] | None = None, *, png: bool = False
) -> None:
    """Write the pictures, the tables, the settings, the page and, last, the file by which a result is known.

    Parameters
    ----------
    report : StudyReport
    folder : Path
        Exists; its other files are left alone.
    pictures : mapping of str to matplotlib.figure.Figure, optional
        By the name of their files.
    png : bool
        Write the pictures as PNG, too.
    """
    drawn = {name: picture_bytes(figure, "svg") for name, figure in (pictures or {}).items()}
    for name, svg in drawn.items():
        (folder / f"{name}.svg").write_bytes(svg)
    for name, figure in (pictures or {}).items() if png else ():
        (folder / f"{name}.png").write_bytes(picture_bytes(figure, "png"))
    (folder / PAGE).write_bytes(study_page(report, drawn))
    for name, table in {**report.tables, **report.series}.items():
        (folder / f"{name}.csv").write_bytes(table_csv(table))
    (folder / "config.toml").write_text(render_toml(report.config), "utf-8")
    (folder / COMPLETE).write_bytes(study_json(report))


def study_csv(report: StudyReport) -> str:
    """Write the tables one after the other, each line beginning with the table's name, a blank line between them."""
    blocks = []
    for name, table in report.tables.items():
        rows = ((name, *row) for row in table.itertuples(index=False, name=None))
        blocks.append(rows_csv(("table", *table.columns), rows))
    return "\n".join(blocks)


def study_markdown(report: StudyReport) -> str:
    """Dress a study in Markdown."""
    return markdown_page(report.title, report.sentences, report.shown)


def study_latex(report: StudyReport) -> str:
    """Dress a study in LaTeX."""
    return latex_page(report.title, report.sentences, report.shown)


def study_terminal(report: StudyReport) -> Group:
    """Dress a study for a terminal, to be printed by a rich console."""
    parts: list[RenderableType] = [spoken(report.title, "bold"), *map(spoken, report.sentences)]
    for table in report.shown:
        parts += [Text(), dressed(table)]
    return Group(*parts)


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


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(column): value for column, value in row.items()} for row in table.to_dict("records")]


def study_page(report: StudyReport, pictures: Mapping[str, bytes]) -> bytes:
    """Write the page of a study.

    Parameters
    ----------
    report : StudyReport
    pictures : mapping of str to bytes
        SVG by name.

    Returns
    -------
    bytes
        The same study gives the same bytes.
    """
    tool = Tool()
    asked = {
        name: ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        for name, value in report.arguments.items()
    }
    versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
    parts: list[Part] = [
        *map(Lead, report.sentences),
        Heading("Pictures"),
        *(picture(name, svg) for name, svg in pictures.items()),
        Heading("Tables"),
        *report.shown,
        Heading("What was lost or assumed"),
        losses(report.notes),
        Heading("Provenance"),
        facts({**asked, "tool": f"{tool.name} {tool.version}", "with": versions}),
        settings_details(render_toml(report.config)),
    ]
    return page(report.title, parts)
