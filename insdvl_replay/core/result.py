"""What a command returns, and its parts. `show` writes it for a terminal, as Markdown, LaTeX, HTML, CSV and JSON.

A command fills a `Result` and hands it on::

    class DelayRow(Struct, frozen=True):
        title: ClassVar = "Delays of the DVL"

        dive: Annotated[str, Col(head="dive")]
        delay_s: Annotated[Number, Col("Null if it cannot be determined.", head="delay\n[s]")]

    result = Result("calibration", "Calibration from 3 dives", [Callout("Estimated: delay.", "good")], {"delays": rows})
    write_stdout(written(result, format_))  # cli.screen; any --format
    save_result(result, folder)               # show.render; page, figures, CSV, settings, report.json

A table is a list of rows of one type (see `tables`), or a pandas frame. CSV and JSON have all columns. Shown tables
have the columns with a head; `display` replaces them by tables of ``show.document.table_of``. The order is title,
sentences, figures, tables, notes, provenance; a command with another order sets `document`.
"""

import hashlib
import importlib.util
import platform
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import astuple

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_record import Channel, ImuFingerprint, ReferenceDelay, StartHeading
from insdvl_replay.core.errors import Note
from insdvl_replay.core.runtime import sources_digest
from insdvl_replay.core.tables import CandidateVerdict, Tables
from insdvl_replay.core.version import __version__

if TYPE_CHECKING:
    # Only types are needed: reading a stored result must not wait for these imports.
    import pandas as pd

    from insdvl_replay.core.dive_columns import Dive, Floats

T = TypeVar("T")

# --- Figures: panels of curves on two axes, in the units that are shown.

Scale = Literal["linear", "log"]
REFERENCE: Final = "reference"
LIMIT: Final = "limit"
REJECTED: Final = "rejected"
PREDICTED: Final = "sigma"
"""Added to the style of a filter: finely dotted."""


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
    label: str = ""  # text at the end of the line
    band: "tuple[Floats, Floats] | None" = (
        None  # (k,), lower and upper edge of the area about the line
    )
    name: str | None = (
        None  # at the cursor; None: the label, or that of the style in the legend; empty: not read
    )
    time: "Floats | None" = None  # (k,), of each point of a track, in seconds


@dataclass(frozen=True)
class Shade:
    """A stretch of the horizontal axis, behind everything."""

    begin: float
    end: float
    style: str


def dashes_on_top(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Return the curves with the baseline last, so that equal curves are visible through its dashes."""
    return (*curves[1:], *curves[:1])


@dataclass(frozen=True)
class Panel:
    """Curves on two axes."""

    title: str  # with the unit of the vertical axis
    x_label: str  # with the unit
    curves: tuple[Curve, ...]  # the last is on top
    levels: tuple[float, ...] = ()  # horizontal lines, drawn as limits
    y_scale: Scale = "linear"  # a logarithmic axis leaves out values that are not positive
    y_limits: tuple[float, float] | None = None  # None: fits the curves
    equal: bool = False  # both axes have the same scale
    x_whole: bool = False  # ticks are whole numbers
    x_scale: Scale = "linear"
    x_limits: tuple[float, float] | None = None  # None: fits the curves
    shades: tuple[Shade, ...] = ()
    low: bool = False  # usual height although `equal`


@dataclass(frozen=True)
class Figure:
    """Panels that belong together."""

    title: str
    caption: str  # explanation
    panels: tuple[Panel, ...]
    legend: tuple[tuple[str, str], ...] = ()  # style and meaning


# --- The parts of a document, in the order in which they are read.

CellText = str | tuple[str, ...]
"""Text of a cell: one line, or several."""


@dataclass(frozen=True)
class DisplayTable:
    """A table as shown. In HTML, a table with links has its own row; others are side by side if there is room."""

    title: str
    header: tuple[str, ...]  # with units; a line break allows folding
    alignment: str  # a letter for each column: l for words, r for numbers
    rows: tuple[tuple[CellText, ...], ...]
    footnote: str = ""
    spare: tuple[
        int | tuple[int, ...], ...
    ] = ()  # columns that a narrow terminal leaves out, in this order
    folds: int = 0  # letters that may be folded before a column is left out
    links: tuple[str, ...] | None = None  # link target of the first cell of each row; "" for none
    folded: bool = False  # in HTML folded under its title; left out in print


@dataclass(frozen=True)
class Title:
    """The title of a document, one line."""

    text: str


@dataclass(frozen=True)
class Callout:
    """The main sentence; ``good`` or ``bad`` colours it."""

    text: str
    tone: str = ""


@dataclass(frozen=True)
class Remark:
    """A sentence with a hint, which may be empty."""

    sentence: str
    hint: str = ""

    @property
    def text(self) -> str:
        """Both on one line."""
        if self.hint:
            return f"{self.sentence}; hint: {self.hint}"
        return self.sentence


@dataclass(frozen=True)
class Sentences:
    """Sentences that belong together; a terminal prints an empty line before them."""

    lines: "tuple[str | Remark | Callout, ...]"


@dataclass(frozen=True)
class Code:
    """Lines to copy unchanged."""

    text: str
    language: str


@dataclass(frozen=True)
class Heading:
    """A heading of a page, with a link at the top of the page."""

    text: str


@dataclass(frozen=True)
class Html:
    """A part of a page as HTML."""

    text: str


Format = Literal["terminal", "markdown", "latex", "html"]
PRINTED: Final[tuple[Format, ...]] = ("terminal", "markdown", "latex")
PAGE: Final[tuple[Format, ...]] = ("html",)
PRINTED_LONG: Final[tuple[Format, ...]] = ("markdown", "latex")


@dataclass(frozen=True)
class Only:
    """Parts for some formats only."""

    formats: tuple[Format, ...]
    parts: "tuple[Part, ...]"


Sentence = str | Callout | Remark
Part = Sentence | Title | Sentences | Code | DisplayTable | Heading | Figure | Html | Only
Document = Sequence[Part]


# --- The result.


class Tool(Struct, frozen=True):
    """Program and time of the report. Only this differs between two runs on the same input."""

    name: str = "insdvl-replay"
    version: str = __version__
    sources: Annotated[
        str | None,
        Meta(description="digest of the package's files, which change without its version"),
    ] = None
    started_at: Annotated[str | None, Meta(description="UTC, ISO 8601")] = None
    elapsed_s: float | None = None
    cpu_s: Annotated[
        dict[str, float], Meta(description="processor seconds of one run over the dive, by filter")
    ] = {}


def this_tool() -> Tool:
    """Return this program's name and version, without the time of day."""
    return Tool(sources=sources_digest())


@cache
def package_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that may affect numbers."""
    packages = ("numpy", "numba", "pandas", "scipy", "mcap")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


@dataclass(frozen=True)
class Block:
    """A table as CSV: for tables without rows, or with columns that depend on the data."""

    header: Sequence[str]
    rows: Iterable[Sequence[object]]

    @classmethod
    def of(cls, kind: type[Struct], rows: Iterable[Struct]) -> "Block":
        """Return a table of rows of one type, possibly none."""
        return cls(kind.__struct_fields__, [*map(astuple, rows)])


@dataclass(frozen=True)
class Result:
    """The result of a command."""

    kind: (
        str  # montecarlo, window, observability, calibration, inspection, comparison, check, replay
    )
    title: str
    sentences: Sequence[Sentence] = ()
    tables: "Mapping[str, Sequence[Struct] | Block | pd.DataFrame]" = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)  # by file name
    notes: Sequence[Note] = ()
    config: Config | None = None  # resolved settings
    arguments: Mapping[str, Any] = field(default_factory=dict)  # of the command
    facts: Mapping[str, Any] = field(
        default_factory=dict
    )  # other results, neither sentence nor table
    series: "Mapping[str, Sequence[Struct] | pd.DataFrame]" = field(
        default_factory=dict
    )  # long tables: CSV files only
    block: str = "table"  # name of the CSV column with the table's name; empty for one table
    display: Sequence[Part] = ()  # the tables as shown; empty: by their row types
    document: Sequence[Part] | None = None  # all parts in another order; None: in the usual order
    data: Any = None  # content of the JSON, if it is not the above
    settings: str = ""  # TOML for ``-c`` that the command found


class ResultJson(Struct, frozen=True):
    """A result as JSON."""

    tool: Tool
    versions: Annotated[
        dict[str, str],
        Meta(description="versions of Python and of the packages that may affect numbers"),
    ]
    kind: Annotated[str, Meta(description="the command or study of this result")]
    title: str
    arguments: Annotated[dict[str, Any], Meta(description="what it was asked")]
    facts: Annotated[
        dict[str, Any], Meta(description="what was found that is neither sentence nor table")
    ]
    sentences: Annotated[list[str], Meta(description="what it found, in words")]
    tables: Annotated[
        dict[str, list[dict[str, Any]]],
        Meta(description="row for row as in the CSV files; null for what is missing"),
    ]
    notes: Annotated[list[Note], Meta(description="notes: dropped data, assumptions and anomalies")]
    config: Annotated[
        dict[str, Any], Meta(description="resolved settings, as in config.schema.json")
    ]
    files: "Files" = {}


Files = Annotated[
    dict[str, str],
    Meta(
        description="SHA-256 of each file of the result; of report.json, without the time of day and its own. Early "
        "reports lack it"
    ),
]
"""Names and digests, as `folder.list_files` writes them at the end."""


# --- The report of a replay, report.json.


class Log(Struct, frozen=True):
    """The log that was replayed."""

    name: str
    sha256: Annotated[
        str, Meta(description="of the log's bytes; empty for a dive that was never a file")
    ]
    start_ns: Annotated[int, Meta(description="on the log's own clock")]
    end_ns: int
    duration_s: float
    channels: list[Channel]


class CodeFile(Struct, frozen=True):
    """A file of user code that was run."""

    file: str
    sha256: str


class Report(Struct, frozen=True):
    """The result of one replay."""

    tool: Tool
    versions: Annotated[
        dict[str, str],
        Meta(description="versions of Python and of the packages that may affect numbers"),
    ]
    log: Log
    baseline: Annotated[
        str, Meta(description="name of the filter that the candidates are compared with")
    ]
    filters: Annotated[
        dict[str, CandidateVerdict],
        Meta(description="verdict and mean improvements of each candidate"),
    ]
    tables: Tables
    notes: Annotated[list[Note], Meta(description="notes: dropped data, assumptions and anomalies")]
    config: Annotated[
        dict[str, Any], Meta(description="resolved settings, as in config.schema.json")
    ]
    code: Annotated[
        dict[str, CodeFile], Meta(description="user code that was run, by its name in the settings")
    ] = {}
    reference_delay: Annotated[
        ReferenceDelay | None,
        Meta(
            description="how much later the reference's stamps are than the IMU's, beyond reference.latency_s; null in "
            "early reports, which did not look"
        ),
    ] = None
    vehicle: Annotated[
        str,
        Meta(
            description="that made the dive, as its manifest or vehicle.name says; empty: nobody said"
        ),
    ] = ""
    imu_fingerprint: Annotated[
        ImuFingerprint | None,
        Meta(
            description="digests of samples of the IMU, by which copies of a dive are known; null in early reports"
        ),
    ] = None
    start_heading: Annotated[
        StartHeading | None,
        Meta(
            description="what the heading at the start comes from, and how well it is known; null in early reports"
        ),
    ] = None
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
        log=Log(
            dive.name,
            dive.sha256,
            start_ns,
            end_ns,
            (end_ns - start_ns) * 1e-9,
            list(dive.channels),
        ),
        baseline=config.baseline,
        filters=_without_nan(dict(candidates), dict[str, CandidateVerdict]),
        tables=_without_nan(tables, Tables),
        notes=list(notes),
        config=msgspec.to_builtins(config),
        code={word: _code_file(word) for word in config.code},
        reference_delay=dive.reference_delay,
        vehicle=config.vehicle.name,
        imu_fingerprint=dive.imu_fingerprint,
        start_heading=dive.start_heading,
    )


def _code_file(word: str) -> CodeFile:
    """Return the file of a program, or of the module of a class."""
    module, is_class, _ = word.partition(":")
    file = getattr(sys.modules.get(module), "__file__", None) or shutil.which(word) or word
    if (
        is_class and "/" not in word and module not in sys.modules
    ):  # a class is imported by a process of its own
        try:
            file = getattr(importlib.util.find_spec(module), "origin", None) or ""
        except Exception:  # of a package that is imported on the way
            file = ""
    file = file if Path(file).is_file() else ""
    return CodeFile(file, hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else "")


def _without_nan(content: T, kind: type[T]) -> T:
    """Return the value as JSON gives it back: None for missing or not finite numbers."""
    return msgspec.json.decode(msgspec.json.encode(content), type=kind)


def as_json(content: Any) -> bytes:
    """Return JSON, indented, with a final newline. The same content gives the same bytes."""
    return msgspec.json.format(msgspec.json.encode(content)) + b"\n"


# Made once, before threads: msgspec 0.22 ends the process if two of them meet a type for the first time.
_REPORTS: Final = msgspec.json.Decoder(Report)


def decode_report(data: bytes) -> Report:
    """Read a report; raises a msgspec.ValidationError if the data are not a report."""
    return _REPORTS.decode(data)


# --- A stored report of this or another version, with the tables, rows and columns that it has.

Cell = str | int | float | bool | None
Row = dict[str, Cell]


class StoredLog(Struct, frozen=True):
    """The log that was replayed. Fields that an old result does not have are empty."""

    name: str
    sha256: str = ""
    start_ns: int | None = None
    end_ns: int | None = None
    duration_s: float | None = None
    channels: list[dict[str, Cell]] = []


class StoredReport(Struct, frozen=True):
    """The blocks of a report.json."""

    tool: dict[str, Any]
    log: StoredLog
    tables: dict[str, list[Row]]
    versions: dict[str, str] = {}
    baseline: str = ""
    filters: dict[str, Row] = {}
    notes: list[Note] = []
    config: dict[str, Any] = {}
    reference_delay: ReferenceDelay | None = None
    vehicle: str = ""
    imu_fingerprint: ImuFingerprint | None = None


@dataclass(frozen=True)
class StoredResult:
    """One result and its folder."""

    folder: Path  # of the report
    below: str  # the folder relative to the searched folder; ``.`` for that folder
    report: StoredReport

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.report.log.name
