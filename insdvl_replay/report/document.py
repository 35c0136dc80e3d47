"""What is to be shown, before any format: the parts of a document, in the order in which they are read.

A feature builds its parts once, and `terminal`, `markdown`, `latex` and `page` render what their format can show.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, TypeVar

from msgspec import Struct

from insdvl_replay.core.errors import Note, visible
from insdvl_replay.core.quantities import label
from insdvl_replay.core.table import layout_of
from insdvl_replay.report.plots.panel import Figure, Panel

MISSING: Final = "-"
TENFOLD: Final = 10.0
"""From here on, a ratio has as many digits as other numbers."""
CellText = str | tuple[str, ...]
"""What stands in a cell: one line, or several."""


@dataclass(frozen=True)
class DisplayTable:
    """A table ready to be rendered.

    Attributes
    ----------
    title : str
        What it says, in one line.
    header : tuple of str
        Column names with units; a line break is a good place to fold.
    alignment : str
        One letter for each column: l for words, r for numbers.
    footnote : str
        What the rows cannot say.
    title_apart : bool
        On a terminal the title has a line of its own, and is not folded to the width of a narrow table.
    spare : tuple of int
        Columns that a terminal leaves out where it is too narrow for all, the first of them first.
    folds : int
        Letters by which other columns may be folded before one is left out, for long names in a first column.
    """

    title: str
    header: tuple[str, ...]
    alignment: str
    rows: tuple[tuple[CellText, ...], ...]
    footnote: str = ""
    title_apart: bool = False
    spare: tuple[int, ...] = ()
    folds: int = 0


Row = TypeVar("Row")
Column = tuple[str, str, Callable[[Row], CellText]]
"""Name, alignment, and what stands there."""


def table_of(
    title: str,
    rows: Sequence[Row],
    columns: Sequence[Column[Row]],
    footnote: str = "",
    spare: tuple[int, ...] = (),
) -> DisplayTable:
    """Lay out rows, a column for each thing that is said of them."""
    return DisplayTable(
        title,
        tuple(name for name, _, _ in columns),
        "".join(letter for _, letter, _ in columns),
        tuple(tuple(text(row) for _, _, text in columns) for row in rows),
        footnote,
        spare=spare,
    )


def shown(kind: type[Struct], rows: Sequence[Row], footnote: str = "", **names: str) -> DisplayTable:
    """Lay out rows of a type as it says: its columns that have a head, in which ``{filter}`` is a name."""
    layout = layout_of("", kind)
    columns: list[Column[Row]] = [
        (column.head.format(**names), "l" if layout.kinds[name] == "text" else "r", _writer(name, column.form))
        for name, column in layout.columns.items()
        if column.head
    ]
    return table_of(layout.title.format(**names), rows, columns, footnote or layout.footnote)


def _writer(name: str, form: str) -> Callable[[Row], str]:
    return lambda row: FORMS[form](getattr(row, name))


def cell_lines(cell: CellText) -> list[str]:
    """Return the lines of a cell as they can be shown anywhere."""
    return [visible(line) for line in ([cell] if isinstance(cell, str) else cell)]


def number(value: float | None) -> str:
    """Write a number with four significant digits, without an exponent where that stays short."""
    if value is None or math.isnan(value):
        return MISSING
    if value == 0.0 or math.isinf(value):
        return f"{value:g}"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return f"{value:.{max(3 - exponent, 0)}f}"
    return f"{value:.2e}"


def significant(value: float | None) -> str:
    """Write a number with two significant digits, for a narrow column."""
    return MISSING if value is None or math.isnan(value) else f"{value:.2g}"


def counted(count: int, noun: str) -> str:
    """Write how many there are of something."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def decimal(value: float | None, digits: int) -> str:
    """Write a number with a fixed number of digits after the point."""
    return MISSING if value is None or math.isnan(value) else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """Write a percentage with one digit."""
    return MISSING if value is None or math.isnan(value) else f"{value:z.1f} %"


def ratio(value: float | None) -> str:
    """Write a ratio with three decimals, one of ten and more with four digits."""
    return decimal(value, 3) if value is None or abs(value) < TENFOLD else number(value)


def signed_percent(value: float | None) -> str:
    """Write a change in percent with its sign: one digit behind the point, two of a small one, none of almost none."""
    if value is None or abs(value) < 0.005:
        return MISSING if value is None else "0"
    return f"{value:+.1f}" if abs(value) >= 0.95 else f"{value:+.2f}"


FORMS: Final[Mapping[str, Callable[[Any], str]]] = {
    "": lambda value: number(value) if value is None or isinstance(value, float) else str(value),
    "label": label,
    "short": lambda name: label(name).replace("accelerometer", "accel."),
    "words": lambda value: value.replace("_", " "),
    "percent": percent,
    "ratio": ratio,
    "significant": significant,
    "signed": lambda value: number(value) if value is None or value <= 0.0 else f"+{number(value)}",
    "signed_percent": signed_percent,
    "cell": lambda value: number(value) if isinstance(value, float) else "-" if value is None else str(value),
    **{str(digits): partial(decimal, digits=digits) for digits in range(5)},
}
"""How the value of a column is written, by the name in its row type."""

Format = Literal["terminal", "markdown", "latex", "html"]
PRINTED: Final[tuple[Format, ...]] = ("terminal", "markdown", "latex")
PAGE: Final[tuple[Format, ...]] = ("html",)
PRINTED_LONG: Final[tuple[Format, ...]] = ("markdown", "latex")
"""Of what is printed, that which is not too long."""


@dataclass(frozen=True)
class Title:
    """What the whole is, in one line."""

    text: str


@dataclass(frozen=True)
class Callout:
    """The sentence that a reader takes away; the tone, ``good`` or ``bad``, colours the edge beside it on a page."""

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
    """Sentences that stand together, apart from what is before them."""

    lines: tuple[str | Remark | Callout, ...]


@dataclass(frozen=True)
class Code:
    """Lines to be copied as they are."""

    text: str
    language: str


@dataclass(frozen=True)
class Heading:
    """Begins a part of a page, to which the page's head leads."""

    text: str


@dataclass(frozen=True)
class LinkedTable:
    """A table of a page whose rows lead somewhere: the first cell of each to its address, unless that is empty."""

    table: DisplayTable
    links: tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """Facts of a page by their names."""

    named: Mapping[str, str]


@dataclass(frozen=True)
class Details:
    """A long text of a page that is folded away; on paper it is unfolded."""

    title: str
    text: str


@dataclass(frozen=True)
class Folded:
    """Tables of a page that are folded away under a line; on paper they are left out."""

    title: str
    tables: tuple[DisplayTable, ...]


@dataclass(frozen=True)
class Pictures:
    """Pictures of a page that stand in one row, each a panel, or a fragment with a title of its own."""

    shown: tuple[Panel | str, ...]
    caption: str


@dataclass(frozen=True)
class Html:
    """A fragment of a page that is HTML already."""

    text: str


@dataclass(frozen=True)
class Only:
    """Parts that some formats alone show."""

    formats: tuple[Format, ...]
    parts: tuple["Part", ...]


Text = str | Title | Callout | Remark
"""Of one sentence; plain text becomes a paragraph."""
OfPage = Heading | LinkedTable | Facts | Details | Folded | Pictures | Figure | Html
"""What pages alone can show."""
Part = Text | Sentences | Code | DisplayTable | OfPage | Only
Document = Sequence[Part]


def parts_for(format_: Format, document: Document) -> Iterator[Part]:
    """Yield the parts that a format shows."""
    for part in document:
        if isinstance(part, Only):
            if format_ in part.formats:
                yield from part.parts
        elif format_ in PAGE or not isinstance(part, OfPage):
            yield part


def losses(notes: Iterable[Note]) -> DisplayTable | str:
    """State with counts what was dropped, assumed or found odd."""
    rows = tuple((str(note.count), note.severity, f"{note.text} [{note.code}]", note.hint) for note in notes)
    if not rows:
        return "Nothing."
    return DisplayTable("Notes on reading, preparing and filtering", ("count", "", "what", "what helps"), "rlll", rows)


def settings_details(settings: str) -> Details:
    """Fold the resolved configuration away."""
    return Details("Settings, which repeat this result", settings)
