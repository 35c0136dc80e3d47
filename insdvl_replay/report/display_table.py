"""Tables and numbers for people: titles, units, four significant digits."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.states import STATES

MISSING: Final = "-"
_LABELS: Final = {state.id: state.label for state in STATES}
_QUANTITIES: Final = {
    "velocity_n": "velocity, north",
    "velocity_e": "velocity, east",
    "velocity_d": "velocity, down",
    "roll": "roll",
    "pitch": "pitch",
    "heading": "heading",
    "position_h": "position",
    "depth": "depth",
    "position_h_pct": "pos. / distance",
    "all": "all together",
}


CellText = str | tuple[str, ...]
"""What stands in a cell: one line, or several."""


@dataclass(frozen=True)
class ShownTable:
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
    """

    title: str
    header: tuple[str, ...]
    alignment: str
    rows: tuple[tuple[CellText, ...], ...]
    footnote: str = ""
    title_apart: bool = False


Row = TypeVar("Row")
Column = tuple[str, str, Callable[[Row], CellText]]
"""Name, alignment, and what stands there."""


def table_of(title: str, rows: Sequence[Row], columns: Sequence[Column[Row]], footnote: str = "") -> ShownTable:
    """Lay out rows, a column for each thing that is said of them."""
    return ShownTable(
        title,
        tuple(name for name, _, _ in columns),
        "".join(letter for _, letter, _ in columns),
        tuple(tuple(text(row) for _, _, text in columns) for row in rows),
        footnote,
    )


def cell_lines(cell: CellText) -> list[str]:
    """Give the lines of a cell as they can be shown anywhere."""
    return [visible(line) for line in ([cell] if isinstance(cell, str) else cell)]


def row_label(name: str) -> str:
    """Name a state or quantity in words; other names stand for themselves."""
    return _LABELS.get(name) or _QUANTITIES.get(name, name)


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


def counted(count: int, noun: str) -> str:
    """Write how many there are of something."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def decimal(value: float | None, digits: int) -> str:
    """Write a number with a fixed number of digits after the point."""
    return MISSING if value is None or math.isnan(value) else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """Write a percentage with one digit."""
    return MISSING if value is None or math.isnan(value) else f"{value:.1f} %"
