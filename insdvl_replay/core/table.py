"""What is known of the columns of a table beside their types, and of a table without its rows."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, get_args, get_origin, get_type_hints

from msgspec import Struct

Number = float | None
Better = Literal["lower", "higher", "nearer zero", "nearer dof"]
"""What is better: ``nearer zero`` for signed errors and correlations, ``nearer dof`` for a mean NIS or NEES."""
Kind = Literal["text", "count", "number"]
PERCENTAGE: Final = "_pct"
"""End of the name of a column whose numbers are percentages, and change by percentage points."""
UNITS: Final = {PERCENTAGE: "%", "_s": "s", "_mps": "m/s", "_m": "m"}
"""Units by the end of a column's name."""
RATIO: Final = "ratio"
"""So begin columns without a unit."""


def finite(number: Number) -> float:
    """Return a number of a row, NaN where it is missing or not finite."""
    return math.nan if number is None or not math.isfinite(number) else number


@dataclass(frozen=True)
class Column:
    """One column of a row type, as an annotation of its field.

    Attributes
    ----------
    comment : str
        What it holds, and those after it until the next one with a comment.
    better : Better or None
        What counts as better; None for words, counts and limits that are neither better nor worse.
    primary : bool
        A reader looks at it first.
    names : tuple of str or None
        What it names, if it names the row; empty where that is the user's choice.
    best_first : tuple of str
        The words that have a rank.
    head : str
        Under which people see it; ``{filter}`` and ``{baseline}`` stand for names. Empty where they do not.
    form : str
        How it is written, a key of `report.document.FORMS`.
    """

    comment: str = ""
    better: Better | None = None
    primary: bool = False
    names: tuple[str, ...] | None = None
    best_first: tuple[str, ...] = ()
    head: str = ""
    form: str = ""


@dataclass(frozen=True)
class TableLayout:
    """A table without its rows.

    Attributes
    ----------
    name : str
        As in ``report.json`` and in the name of the CSV file.
    row : type
        Of its rows.
    columns : dict of str to Column
        In the order of the files.
    kinds : dict of str to Kind
        What each column holds.
    key : str
        The column that, with log and filter, names a row.
    better : dict of str to Better
        Of the columns that have one.
    primary : str
        The column that a reader looks at first.
    words : dict of str to tuple of str
        By column, the words that have a rank, best first.
    rows : tuple of str
        What the key may name; empty where it names filters, whose names are the user's.
    baseline_too : bool
        The baseline has rows of its own; else it stands beside each candidate.
    about : str
        What a row says, for those who meet it as a message.
    title, footnote : str
        What the table says in one line, with ``{filter}`` and ``{baseline}`` for names, and what rows cannot say.
    """

    name: str
    row: type[Struct]
    columns: dict[str, Column]
    kinds: dict[str, Kind]
    key: str
    better: dict[str, Better]
    primary: str
    words: dict[str, tuple[str, ...]]
    rows: tuple[str, ...]
    baseline_too: bool
    about: str
    title: str
    footnote: str

    def unit_of(self, column: str, row_unit: str) -> str:
        """Return a column's unit: by the end of its name, none of a ratio, else the row's of what can be better."""
        if unit := next((unit for ending, unit in UNITS.items() if column.endswith(ending)), ""):
            return unit
        return row_unit if column in self.better and not column.startswith(RATIO) else ""


def layout_of(name: str, row: type[Struct]) -> TableLayout:
    """Read the layout of a table from its row type; rows without a column that names them bear a filter's name."""
    hints = get_type_hints(row, include_extras=True)
    columns = {column: _column(hints[column]) for column in row.__struct_fields__}
    key = next((column for column, found in columns.items() if found.names is not None), "filter")
    return TableLayout(
        name=name,
        row=row,
        columns=columns,
        kinds={column: _kind(hints[column]) for column in columns},
        key=key,
        better={column: found.better for column, found in columns.items() if found.better},
        primary=next(column for column, found in columns.items() if found.primary),
        words={column: found.best_first for column, found in columns.items() if found.best_first},
        rows=columns[key].names or () if key in columns else (),
        baseline_too=getattr(row, "baseline_too", False),
        about=getattr(row, "about", ""),
        title=getattr(row, "title", ""),
        footnote=getattr(row, "footnote", ""),
    )


def _column(hint: Any) -> Column:
    return next((found for found in getattr(hint, "__metadata__", ()) if isinstance(found, Column)), Column())


def _kind(hint: Any) -> Kind:
    plain = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    return "text" if plain is str else "count" if plain is int else "number"
