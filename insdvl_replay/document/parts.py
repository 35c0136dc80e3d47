"""What a command returns, and its parts. Its siblings write it for a terminal, as Markdown, LaTeX, HTML, CSV and JSON.

A command fills a `Result` and hands it on::

    class DelayRow(Struct, frozen=True):
        title: ClassVar = "Delays of the DVL"

        dive: Annotated[str, Col(head="dive")]
        delay_s: Annotated[Number, Col("Null if it cannot be determined.", head="delay\n[s]")]

    result = Result("calibration", "Calibration from 3 dives", [Callout("Estimated: delay.", "good")], {"delays": rows})
    write_stdout(written(result, format_))  # cli.screen; any --format
    save_result(result, folder)               # document.render; page, figures, CSV, settings, report.json

A table is a list of rows of one type (see `core.tables`), or a pandas frame. CSV and JSON have all columns. Shown
tables have the columns with a head; `display` replaces them by tables of ``tables.table_of``. The order is title,
sentences, figures, tables, notes, provenance; a command with another order sets `document`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from msgspec import Meta, Struct
from msgspec.structs import astuple

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Files, Tool

if TYPE_CHECKING:
    # Only types are needed: reading a stored result must not wait for these imports.
    import pandas as pd

    from insdvl_replay.core.dive_columns import Floats

# --- Figures: panels of curves on two axes, in the units that are shown.

Scale = Literal["linear", "log"]
REFERENCE: Final = "reference"
LIMIT: Final = "limit"
REJECTED: Final = "rejected"
POINT: Final = "points"
"""Added to the style of a filter in a legend: its points instead of its line."""
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
    # (k,), lower and upper edge of the area about the line
    band: "tuple[Floats, Floats] | None" = None
    # at the cursor; None: the label, or that of the style in the legend; empty: not read
    name: str | None = None
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
    ends: bool = True  # on equal axes the start and the end of a track are marked
    folded: bool = False  # on the first screen of a page folded under its title

    @property
    def is_tall(self) -> bool:
        """Whether it is as high as it is wide."""
        return self.equal and not self.low


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
    # columns that a narrow terminal leaves out, in this order
    spare: tuple[int | tuple[int, ...], ...] = ()
    folds: int = 0  # letters that may be folded before a column is left out
    links: tuple[str, ...] | None = None  # link target of the first cell of each row; "" for none
    folded: bool = False  # in HTML folded under its title; in print it is open
    whole: bool = False  # in a pipe each row is one line, however long


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
    explains_figures: bool = False  # it says how to read figures, so the page need not


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

    # montecarlo, window, observability, calibration, inspection, comparison, check, replay
    kind: str
    title: str
    sentences: Sequence[Sentence] = ()
    tables: "Mapping[str, Sequence[Struct] | Block | pd.DataFrame]" = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)  # by file name
    notes: Sequence[Note] = ()
    config: Config | None = None  # resolved settings
    arguments: Mapping[str, Any] = field(default_factory=dict)  # of the command
    # other results, neither sentence nor table
    facts: Mapping[str, Any] = field(default_factory=dict)
    # long tables: CSV files only
    series: "Mapping[str, Sequence[Struct] | pd.DataFrame]" = field(default_factory=dict)
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
    notes: Annotated[
        list[Note], Meta(description="notes: dropped data, assumptions and anomalies")
    ]
    config: Annotated[
        dict[str, Any], Meta(description="resolved settings, as in config.schema.json")
    ]
    files: Files = {}
