"""What a command returns, and its parts. `show` writes it for a terminal, as Markdown, LaTeX, HTML, CSV and JSON.

A command fills a `Result` and hands it on::

    class DelayRow(Struct, frozen=True):
        title: ClassVar = "Delays: how late the DVL is"

        dive: Annotated[str, Col(head="dive")]
        delay_s: Annotated[Number, Col("Null where nothing shows it.", head="delay\n[s]")]

    result = Result("calibration", "Calibration from 3 dives", [Callout("Estimated: delay.", "good")], {"delays": rows})
    write_stdout(written(result, format_))  # cli.screen; any --format
    save_result(result, folder)               # show.render; page, figures, CSV, settings, report.json

A table is a list of rows of one type (see `tables`), or a pandas frame. CSV and JSON have all of it. People see the
columns that have a head. Where that is not enough, `display` holds what they see, made by ``show.document.table_of``.
The order is title, sentences, figures, tables, notes, provenance; a command with another order gives `document`.
"""

import hashlib
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import astuple

from insdvl_replay import __version__
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_record import Channel
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import sources_digest
from insdvl_replay.core.tables import CandidateVerdict, Tables

if TYPE_CHECKING:
    # Only their types are needed: who looks into a stored result must not wait for them.
    import pandas as pd

    from insdvl_replay.core.dive_columns import Dive, Floats

T = TypeVar("T")

# --- Figures: panels of curves on two axes, in the units that are shown.

Scale = Literal["linear", "log"]
REFERENCE: Final = "reference"
LIMIT: Final = "limit"
REJECTED: Final = "rejected"
PREDICTED: Final = "sigma"
"""Beside the style of a filter: finely dotted."""


def filter_style(number: int) -> str:
    """Return the style of a filter by its place in the configuration; the first is the baseline."""
    return f"filter{number % 6}"


@dataclass(frozen=True)
class Curve:
    """One line, or separate points."""

    x: "Floats"  # (k,)
    y: "Floats"  # (k,); NaN interrupts the line
    style: str  # class in the style sheet
    points: bool = False
    label: str = ""  # is written at the end of the line


@dataclass(frozen=True)
class Band:
    """The area between two lines, below the curves."""

    x: "Floats"  # (k,)
    low: "Floats"  # (k,)
    high: "Floats"  # (k,)
    style: str


@dataclass(frozen=True)
class Shade:
    """A stretch of the horizontal axis, behind everything."""

    begin: float
    end: float
    style: str


def dashes_on_top(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Draw the baseline, the first, last: curves that equal it are seen through its dashes."""
    return (*curves[1:], *curves[:1])


@dataclass(frozen=True)
class Panel:
    """Curves on two axes."""

    title: str  # with the unit of the vertical axis
    x_label: str  # with the unit
    curves: tuple[Curve, ...]  # the last is on top
    bands: tuple[Band, ...] = ()
    levels: tuple[float, ...] = ()  # horizontal lines, drawn as limits
    y_scale: Scale = "linear"  # on a logarithmic axis, what is not positive is missing
    y_limits: tuple[float, float] | None = None  # None: as much as the curves need
    equal: bool = False  # one unit is as long on both axes
    x_whole: bool = False  # x counts something: ticks are whole numbers
    x_scale: Scale = "linear"
    shades: tuple[Shade, ...] = ()
    low: bool = False  # as low as others, though both axes are equal


@dataclass(frozen=True)
class Figure:
    """Panels that belong together."""

    title: str
    caption: str  # how they are read
    panels: tuple[Panel, ...]
    legend: tuple[tuple[str, str], ...] = ()  # style and meaning


# --- The parts of a document, in the order in which they are read.

CellText = str | tuple[str, ...]
"""What a cell shows: one line, or several."""


@dataclass(frozen=True)
class DisplayTable:
    """A table as people see it. In HTML, a table with links is alone; others are side by side where there is room."""

    title: str
    header: tuple[str, ...]  # with units; a line break is a good place to fold
    alignment: str  # a letter for each column: l for words, r for numbers
    rows: tuple[tuple[CellText, ...], ...]
    footnote: str = ""
    title_apart: bool = False  # on a terminal the title is not folded to the width of a narrow table
    spare: tuple[int, ...] = ()  # columns that a narrow terminal leaves out, the first of them first
    folds: int = 0  # letters by which other columns may be folded before one is left out
    links: tuple[str, ...] | None = None  # where the first cell of each row leads; "" is nowhere
    folded: bool = False  # in HTML, under its title; on paper it is left out


@dataclass(frozen=True)
class Title:
    """What the whole is, in one line."""

    text: str


@dataclass(frozen=True)
class Callout:
    """The sentence that a reader takes away; ``good`` or ``bad`` colours it."""

    text: str
    tone: str = ""


@dataclass(frozen=True)
class Remark:
    """A sentence, and what helps; the hint is empty where nothing does."""

    sentence: str
    hint: str = ""

    @property
    def text(self) -> str:
        """Both on one line."""
        return f"{self.sentence}; hint: {self.hint}" if self.hint else self.sentence


@dataclass(frozen=True)
class Sentences:
    """Sentences that belong together; a terminal leaves a line free before them."""

    lines: "tuple[str | Remark | Callout, ...]"


@dataclass(frozen=True)
class Code:
    """Lines to be copied as they are."""

    text: str
    language: str


@dataclass(frozen=True)
class Heading:
    """Begins a chapter of a page, and has a link at the page's top."""

    text: str


@dataclass(frozen=True)
class Html:
    """A part of a page that is HTML already."""

    text: str


Format = Literal["terminal", "markdown", "latex", "html"]
PRINTED: Final[tuple[Format, ...]] = ("terminal", "markdown", "latex")
PAGE: Final[tuple[Format, ...]] = ("html",)
PRINTED_LONG: Final[tuple[Format, ...]] = ("markdown", "latex")


@dataclass(frozen=True)
class Only:
    """Parts that only some formats show."""

    formats: tuple[Format, ...]
    parts: "tuple[Part, ...]"


Sentence = str | Callout | Remark
Part = Sentence | Title | Sentences | Code | DisplayTable | Heading | Figure | Html | Only
Document = Sequence[Part]


# --- The result.


class Tool(Struct, frozen=True):
    """What made the report, and when: the one place where two runs on the same input may differ."""

    name: str = "insdvl-replay"
    version: str = __version__
    sources: Annotated[
        str | None, Meta(description="digest of the package's files, which change without its version")
    ] = None
    started_at: Annotated[str | None, Meta(description="UTC, ISO 8601")] = None
    elapsed_s: float | None = None


def this_tool() -> Tool:
    """Return this program's name and version, without the time of day."""
    return Tool(sources=sources_digest())


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that may change a number."""
    packages = ("numpy", "numba", "pandas", "scipy", "mcap")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


@dataclass(frozen=True)
class Block:
    """A table as CSV has it, where rows of structs do not say it all: without any, or with columns of the moment."""

    header: Sequence[str]
    rows: Iterable[Sequence[object]]

    @classmethod
    def of(cls, kind: type[Struct], rows: Iterable[Struct]) -> "Block":
        """Return rows of a type, of which there may be none."""
        return cls(kind.__struct_fields__, map(astuple, rows))


@dataclass(frozen=True)
class Result:
    """What a command found."""

    kind: str  # montecarlo, window, observability, calibration, inspection, comparison, check, replay
    title: str
    sentences: Sequence[Sentence] = ()
    tables: "Mapping[str, Sequence[Struct] | Block | pd.DataFrame]" = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)  # by the names of their files
    notes: Sequence[Note] = ()
    config: Config | None = None  # resolved settings
    arguments: Mapping[str, Any] = field(default_factory=dict)  # what was asked
    facts: Mapping[str, Any] = field(default_factory=dict)  # what was found that is neither sentence nor table
    series: "Mapping[str, Sequence[Struct] | pd.DataFrame]" = field(default_factory=dict)  # long tables: CSV files only
    block: str = "table"  # head of the CSV column that names the table of a row; empty: of one table, there is none
    display: Sequence[Part] = ()  # the tables as people see them; empty: each as its row type says
    document: Sequence[Part] | None = None  # the whole in the command's own order; None: in the usual order
    data: Any = None  # what JSON holds, where it is not the above


class ResultJson(Struct, frozen=True):
    """A result as JSON."""

    tool: Tool
    versions: Annotated[dict[str, str], Meta(description="of Python and the packages that may move a number")]
    kind: Annotated[str, Meta(description="what it is the result of")]
    title: str
    arguments: Annotated[dict[str, Any], Meta(description="what it was asked")]
    facts: Annotated[dict[str, Any], Meta(description="what was found that is neither sentence nor table")]
    sentences: Annotated[list[str], Meta(description="what it found, in words")]
    tables: Annotated[
        dict[str, list[dict[str, Any]]], Meta(description="row for row as in the CSV files; null for what is missing")
    ]
    notes: Annotated[list[Note], Meta(description="what was dropped, assumed or found odd")]
    config: Annotated[dict[str, Any], Meta(description="resolved settings, as in config.schema.json")]
    files: "Files" = {}


Files = Annotated[
    dict[str, str],
    Meta(
        description="SHA-256 of each file of the result; of report.json, without the time of day and its own. Early "
        "reports lack it"
    ),
]
"""As `folder.list_files` writes it when all files are there."""


# --- The report of a replay, report.json.


class Log(Struct, frozen=True):
    """What was replayed."""

    name: str
    sha256: Annotated[str, Meta(description="of the log's bytes; empty for a dive that was never a file")]
    start_ns: Annotated[int, Meta(description="on the log's own clock")]
    end_ns: int
    duration_s: float
    channels: list[Channel]


class CodeFile(Struct, frozen=True):
    """A file of the user's code that was run."""

    file: str
    sha256: str


class Report(Struct, frozen=True):
    """The result of one replay."""

    tool: Tool
    versions: Annotated[dict[str, str], Meta(description="of Python and the packages that may move a number")]
    log: Log
    baseline: Annotated[str, Meta(description="name of the filter that the candidates are compared with")]
    filters: Annotated[dict[str, CandidateVerdict], Meta(description="what there is to say of each candidate")]
    tables: Tables
    notes: Annotated[list[Note], Meta(description="what was dropped, assumed or found odd")]
    config: Annotated[dict[str, Any], Meta(description="resolved settings, as in config.schema.json")]
    code: Annotated[dict[str, CodeFile], Meta(description="the user's code that was run, by its word in aiding")] = {}
    files: Files = {}


def build_report(
    dive: "Dive",
    config: Config,
    tables: Tables,
    candidates: Mapping[str, CandidateVerdict],
    notes: Sequence[Note],
    start_ns: int,
    end_ns: int,
    tool: Tool = Tool(),
) -> Report:
    """Return the result of a replay."""
    return Report(
        tool=tool,
        versions=package_versions(),
        log=Log(dive.name, dive.sha256, start_ns, end_ns, (end_ns - start_ns) * 1e-9, list(dive.channels)),
        baseline=config.baseline,
        filters=_without_nan(dict(candidates), dict[str, CandidateVerdict]),
        tables=_without_nan(tables, Tables),
        notes=list(notes),
        config=msgspec.to_builtins(config),
        code={word: _code_file(word) for word in config.code},
    )


def _code_file(word: str) -> CodeFile:
    """Return the file from which this process has imported the code."""
    file = getattr(sys.modules.get(word.partition(":")[0]), "__file__", None) or ""
    return CodeFile(file, hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else "")


def _without_nan(content: T, kind: type[T]) -> T:
    """Return what JSON would give back: None for what is missing or not finite."""
    return msgspec.json.decode(msgspec.json.encode(content), type=kind)


def as_json(content: Any) -> bytes:
    """Return JSON, indented, with a final newline. The same content gives the same bytes."""
    return msgspec.json.format(msgspec.json.encode(content)) + b"\n"


def decode_report(data: bytes) -> Report:
    """Read a report back; a msgspec.ValidationError where the data are something else."""
    return msgspec.json.decode(data, type=Report)


# --- A report as it is read back, of this version or another: with whatever tables, rows and columns it holds.

Cell = str | int | float | bool | None
Row = dict[str, Cell]


class StoredLog(Struct, frozen=True):
    """What was replayed. Of an old result, what it does not report is empty."""

    name: str
    sha256: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    duration_s: float | None = None
    channels: list[dict[str, Cell]] = []


class StoredReport(Struct, frozen=True):
    """The blocks of a report.json."""

    tool: dict[str, Cell]
    log: StoredLog
    tables: dict[str, list[Row]]
    versions: dict[str, str] = {}
    baseline: str = ""
    filters: dict[str, Row] = {}
    notes: list[Note] = []
    config: dict[str, Any] = {}


@dataclass(frozen=True)
class StoredResult:
    """One result and its place."""

    folder: Path  # that holds the report
    below: str  # the same from the folder that was searched; ``.`` for that folder itself
    report: StoredReport

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.report.log.name


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested settings by their dotted keys; lists stay whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", list(value) if isinstance(value, tuple) else value
