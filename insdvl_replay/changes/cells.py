"""Every cell of a dive's tables in two results, side by side, and whether it became better or worse.

A size is what is compared of a number: itself, its magnitude (*nearer zero*), or how many times it is off its degrees
of freedom (*nearer dof*).
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from msgspec import Struct

from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.quantities import CONSISTENT
from insdvl_replay.core.result import Cell, Row, StoredReport, StoredResult
from insdvl_replay.core.tables import CANDIDATES, PERCENTAGE, Better, Number, TableLayout
from insdvl_replay.core.words import ChangeWord

PRINTED_DIGITS: Final = 4
PRINTED_PERCENT_UNIT: Final = 0.1
ROUNDING: Final = 1e-9
"""Share of a number that another processor, or binary fractions, may add: 0.3 - 0.2 is not more than 0.1."""
NAMES: Final = frozenset(("log", "filter", "unit"))
"""Columns that name a row, with its key."""
SENTENCES: Final = frozenset((("filters", "verdict"),))
"""Cells that say in words what others say in numbers."""


class Change(Struct, frozen=True):
    """One cell of a table, before and after; None where a side lacks it, as the difference of words."""

    log: str
    table: str
    filter: str
    row: str
    unit: str
    column: str
    old: Cell
    new: Cell
    change: Number  # new minus old
    change_pct: Number  # of the size; in percentage points where it is a percentage
    word: ChangeWord


def rounding(old: float, new: float, column: str) -> float:
    """Return the difference of two numbers that says nothing; a percentage is of numbers that are 100 % or so."""
    return ROUNDING * max(100.0 if column.endswith(PERCENTAGE) else 0.0, min(abs(old), abs(new)))


def rounding_pct(old: float, new: float, column: str) -> float:
    """Return the change of a size, as `size_change_pct` has it, that says nothing."""
    return rounding(old, new, column) if column.endswith(PERCENTAGE) else 100.0 * ROUNDING


def agree(old: float, new: float, column: str) -> bool:
    """Return whether two numbers are the same, but for a difference that says nothing."""
    return old == new or abs(new - old) <= rounding(old, new, column)


def within(change: float, allowed: float, digits: float) -> bool:
    """Return whether a change is no more than allowed, but for digits that say nothing."""
    return change <= allowed * (1.0 + ROUNDING) + digits


def size(value: float, better: Better, dof: float = math.nan) -> float:
    """Return what is compared of a number: of a mean NIS how many times it is off its dof, infinite for zero."""
    if better == "nearer zero":
        return abs(value)
    if better == "nearer dof":
        ratio = value / dof
        return max(ratio, 1.0 / ratio) if ratio > 0.0 else math.inf
    return value


def size_change_pct(old: float, new: float, column: str) -> float | None:
    """State by how much a size grew, in percent or points; None from zero, and from or to an infinite size."""
    if old == new:
        return 0.0
    if column.endswith(PERCENTAGE):
        return new - old
    if old == 0.0 or math.isinf(old) or math.isinf(new):
        return None
    return 100.0 * (new - old) / abs(old)


def prints_alike(old: float, new: float, column: str) -> bool:
    """Return whether two sizes differ by no more than one unit of the last digit that is printed of the larger."""
    largest = max(abs(old), abs(new))
    if math.isinf(largest) or largest == 0.0:
        return old == new
    exponent = math.floor(math.log10(largest))
    unit = PRINTED_PERCENT_UNIT if column.endswith(PERCENTAGE) else 10.0 ** (exponent - PRINTED_DIGITS + 1)
    return abs(new - old) <= unit * (1.0 + ROUNDING)


class Moved(NamedTuple):
    """What became of a cell: new minus old, the change of the size in percent, and the word."""

    change: float | None
    change_pct: float | None
    word: ChangeWord


def judge_number(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    *,
    dofs: tuple[float, float] = (math.nan, math.nan),
    tolerance_pct: float | None = None,
) -> Moved:
    """Judge what became of a number; without a tolerance the same is what prints alike. ``dofs``: old and new."""
    if old is None or new is None:
        word = ChangeWord.WORSE if new is None else ChangeWord.BETTER
        return Moved(None, None, ChangeWord.SAME if old is new else word)
    before, after = size(old, better, dofs[0]), size(new, better, dofs[1])
    change_pct = size_change_pct(before, after, column)
    if tolerance_pct is None:
        alike = prints_alike(before, after, column)
    else:
        digits = rounding_pct(before, after, column)
        alike = before == after or (change_pct is not None and within(abs(change_pct), tolerance_pct, digits))
    is_better = (after > before) == (better == "higher")
    word = ChangeWord.SAME if alike else ChangeWord.BETTER if is_better else ChangeWord.WORSE
    return Moved(new - old, change_pct, word)


def rank_word(old: Cell, new: Cell, best_first: tuple[str, ...]) -> ChangeWord:
    """State what became of a word: better or worse if both words have a rank, else whether it changed."""
    if old == new:
        return ChangeWord.SAME
    if old not in best_first or new not in best_first:
        return ChangeWord.CHANGED
    return ChangeWord.WORSE if best_first.index(str(new)) > best_first.index(str(old)) else ChangeWord.BETTER


def direction_of(layout: TableLayout, column: str, row: Row) -> tuple[Better | None, float]:
    """Return what is better in a cell, and the degrees of freedom that it may be nearer to; NaN where it has none.

    A mean NIS or NEES over its degrees of freedom, as the evidence on honesty has it, is better the nearer it is to 1.
    """
    if layout.name == "evidence" and row.get("evidence") == CONSISTENT and column in ("baseline", "value"):
        return "nearer dof", 1.0
    dof = row.get("dof")
    return layout.better.get(column), float(dof) if isinstance(dof, int | float) else math.nan


def judge_cell(old: Row, new: Row, column: str, layout: TableLayout, tolerance_pct: float | None) -> Moved:
    """Judge what became of a cell that both rows have."""
    was, is_ = old[column], new[column]
    (_, dof_before), (better, dof_after) = (direction_of(layout, column, row) for row in (old, new))
    dofs = dof_before, dof_after
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        better = None
    if isinstance(was, float) and isinstance(is_, float) and better is None and agree(was, is_, column):
        return Moved(is_ - was, None, ChangeWord.SAME)
    if better is None or isinstance(was, str) or isinstance(is_, str):
        numbers = isinstance(was, int | float) and isinstance(is_, int | float)
        change = float(is_) - float(was) if numbers else None  # type: ignore[arg-type]
        return Moved(change, None, rank_word(was, is_, layout.words.get(column, ())))
    return judge_number(was, is_, column, better, dofs=dofs, tolerance_pct=tolerance_pct)


def rows_of(report: StoredReport, layout: TableLayout) -> list[Row]:
    """Return the rows of a table; the candidates' block is one. They have ``filter`` and the layout's key."""
    if layout is CANDIDATES:
        return [{"filter": name, **row} for name, row in report.filters.items()]
    return report.tables.get(layout.name, [])


def named_rows(result: StoredResult, layout: TableLayout) -> dict[tuple[str, str, str], Row]:
    """Return the rows of a table by filter, key and unit; a ResultError says that two have the same name."""
    rows: dict[tuple[str, str, str], Row] = {}
    for number, row in enumerate(rows_of(result.report, layout), 1):
        name = str(row["filter"]), str(row[layout.key]), str(row.get("unit") or "")
        if name in rows:
            place = f"{result.folder}: table {layout.name}, row {number}"
            raise ResultError(f"{place}: is the second one of {name[0]}, {name[1]}", "replay the log again")
        rows[name] = row
    return rows


def changes_of(
    old: StoredResult, new: StoredResult, layouts: Sequence[TableLayout], tolerance_pct: float | None
) -> Iterator[Change]:
    """Compare the tables of one dive, row by row.

    What counts as better or worse is always listed; counts, limits and words without rank only where they changed.
    """
    for layout in layouts:
        befores, afters = named_rows(old, layout), named_rows(new, layout)
        skipped = NAMES | {layout.key} | {column for table, column in SENTENCES if table == layout.name}
        for name in dict.fromkeys((*afters, *befores)):
            before, after = befores.get(name, {}), afters.get(name, {})
            for column in dict.fromkeys((*after, *before)):
                if column in skipped:
                    continue
                moved = Moved(None, None, ChangeWord.NEW if column in after else ChangeWord.GONE)
                if column in before and column in after:
                    moved = judge_cell(before, after, column, layout, tolerance_pct)
                if moved.word != ChangeWord.SAME or column in layout.better or column in layout.words:
                    filter_, row, unit = name
                    place = new.name, layout.name, filter_, row, layout.unit_of(column, unit), column
                    yield Change(*place, before.get(column), after.get(column), *moved)
