"""Every cell of a dive's tables, before and after."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.changes import Change
from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.stored_report import Cell, Row, StoredReport, StoredResult
from insdvl_replay.core.table import PERCENTAGE, Better, TableLayout
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.core.words import ChangeWord

PRINTED_DIGITS: Final = 4
"""Significant digits of a printed number."""
PRINTED_PERCENT_UNIT: Final = 0.1
"""One unit of the last printed digit of a percentage."""
ROUNDING: Final = 1e-9
"""Share of a number that another processor, or binary fractions, may add: 0.3 - 0.2 is not more than 0.1."""


def rounding(old: float, new: float, column: str) -> float:
    """Return the difference of two numbers that says nothing.

    Parameters
    ----------
    column : str
        A percentage is itself a difference, of numbers that are 100 % or so.

    Returns
    -------
    float
        In the unit of the numbers; from zero every step says something, but for percentages.
    """
    return ROUNDING * max(100.0 if column.endswith(PERCENTAGE) else 0.0, min(abs(old), abs(new)))


def agree(old: float, new: float, column: str) -> bool:
    """Return whether two numbers are the same, but for a difference that says nothing."""
    return old == new or abs(new - old) <= rounding(old, new, column)


def within(change: float, allowed: float, digits: float) -> bool:
    """Return whether a change is no more than allowed, but for a difference that says nothing.

    Parameters
    ----------
    digits : float
        From `rounding` or `rounding_pct`, in the unit of the change.
    """
    return change <= allowed * (1.0 + ROUNDING) + digits


def size(value: float, better: Better, dof: float = math.nan) -> float:
    """Return what is compared of a number.

    Parameters
    ----------
    better : str
        What counts as better.
    dof : float
        Mean of a consistent filter, for ``nearer dof``.

    Returns
    -------
    float
        For ``nearer dof`` the larger of ``value / dof`` and ``dof / value``: 1 at best, infinite for a mean of zero.
    """
    if better == "nearer zero":
        return abs(value)
    if better == "nearer dof":
        ratio = value / dof
        return max(ratio, 1.0 / ratio) if ratio > 0.0 else math.inf
    return value


def size_change_pct(old: float, new: float, column: str) -> float | None:
    """State by how much a size grew, in percent of the old one; in percentage points where it is a percentage.

    Parameters
    ----------
    old, new : float
        From `size`.

    Returns
    -------
    float or None
        None where there is no percentage: from zero, or from or to an infinite size.
    """
    if old == new:
        return 0.0
    if column.endswith(PERCENTAGE):
        return new - old
    if old == 0.0 or math.isinf(old) or math.isinf(new):
        return None
    return 100.0 * (new - old) / abs(old)


def rounding_pct(old: float, new: float, column: str) -> float:
    """Return the change of a size, as `size_change_pct` has it, that says nothing."""
    return rounding(old, new, column) if column.endswith(PERCENTAGE) else 100.0 * ROUNDING


def prints_alike(old: float, new: float, column: str) -> bool:
    """Return whether two sizes differ by no more than one unit of the last digit that is printed of the larger."""
    largest = max(abs(old), abs(new))
    if math.isinf(largest) or largest == 0.0:
        return old == new
    if column.endswith(PERCENTAGE):
        unit = PRINTED_PERCENT_UNIT
    else:
        unit = 10.0 ** (math.floor(math.log10(largest)) - PRINTED_DIGITS + 1)
    return abs(new - old) <= unit * (1.0 + ROUNDING)


@dataclass(frozen=True)
class Moved:
    """What became of a cell.

    Attributes
    ----------
    change, change_pct : float or None
        As in `insdvl_replay.core.changes.Change`.
    """

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
    if alike:
        return Moved(new - old, change_pct, ChangeWord.SAME)
    is_better = (after > before) == (better == "higher")
    return Moved(new - old, change_pct, ChangeWord.BETTER if is_better else ChangeWord.WORSE)


def rank_word(old: Cell, new: Cell, best_first: tuple[str, ...]) -> ChangeWord:
    """State what became of a word: better or worse if both words have a rank, else whether it changed."""
    if old == new:
        return ChangeWord.SAME
    if old not in best_first or new not in best_first:
        return ChangeWord.CHANGED
    return ChangeWord.WORSE if best_first.index(str(new)) > best_first.index(str(old)) else ChangeWord.BETTER


NAMES: Final = frozenset(("log", "filter", "unit"))
"""Columns that name a row, with its key."""
HONESTY: Final = "honesty"
"""Evidence of means that are better the nearer they are to 1."""
SENTENCES: Final = frozenset((("filters", "verdict"),))
"""Cells that say in words what others say in numbers."""

_Key = tuple[str, str, str]


def compare_tables(
    old: StoredResult, new: StoredResult, layouts: Sequence[TableLayout], tolerance_pct: float | None
) -> list[Change]:
    """Compare the tables of one dive, row by row.

    A row is known by its filter, its key and its unit. What counts as better or worse is always listed; counts, limits
    and words without rank only where they changed.

    Parameters
    ----------
    layouts : sequence of TableLayout
        Which tables.
    tolerance_pct : float or None
        Up to which a change is none; None: up to the last printed digit.

    Raises
    ------
    ResultError
        Two rows have the same name.
    """
    changes = []
    for layout in layouts:
        before, after = named_rows(old, layout), named_rows(new, layout)
        for key in dict.fromkeys((*after, *before)):
            filter_, row, row_unit = key
            for column, was, is_, moved in _cells(before.get(key), after.get(key), layout, tolerance_pct):
                place = new.name, layout.name, filter_, row, layout.unit_of(column, row_unit), column
                changes.append(Change(*place, was, is_, moved.change, moved.change_pct, moved.word))
    return changes


def rows_of(report: StoredReport, layout: TableLayout) -> list[Row]:
    """Return the rows of a table, the candidates' block included.

    Returns
    -------
    list of dict
        They have the columns ``filter`` and the layout's key, without which no result is read.
    """
    if layout is CANDIDATES:
        return [{"filter": name, **row} for name, row in report.filters.items()]
    return report.tables.get(layout.name, [])


def named_rows(result: StoredResult, layout: TableLayout) -> dict[_Key, Row]:
    """Return the rows of a table by filter, key and unit.

    Returns
    -------
    dict of (str, str, str) to Row
        Empty where the report has no such table.

    Raises
    ------
    ResultError
        Two rows have the same name.
    """
    rows: dict[_Key, Row] = {}
    for number, row in enumerate(rows_of(result.report, layout), 1):
        place = f"{result.folder}: table {layout.name}, row {number}"
        key = str(row["filter"]), str(row[layout.key]), str(row.get("unit") or "")
        if key in rows:
            raise ResultError(f"{place}: is the second one of {key[0]}, {key[1]}", "replay the log again")
        rows[key] = row
    return rows


def _cells(
    old: Row | None, new: Row | None, layout: TableLayout, tolerance_pct: float | None
) -> Iterator[tuple[str, Cell, Cell, Moved]]:
    """Return each cell of a row with what became of it."""
    before, after = old or {}, new or {}
    skipped = NAMES | {layout.key} | {column for table, column in SENTENCES if table == layout.name}
    for column in dict.fromkeys((*after, *before)):
        if column in skipped:
            continue
        was, is_ = before.get(column), after.get(column)
        if column in before and column in after:
            moved = _judged(before, after, column, layout, tolerance_pct)
        else:
            moved = Moved(None, None, ChangeWord.NEW if column in after else ChangeWord.GONE)
        if moved.word != ChangeWord.SAME or column in layout.better or column in layout.words:
            yield column, was, is_, moved


def direction_of(layout: TableLayout, column: str, row: Row) -> tuple[Better | None, float]:
    """Return what is better in a cell, and the degrees of freedom that it may be nearer to; NaN where it has none.

    A mean NIS or NEES over its degrees of freedom, as the evidence on honesty has it, is better the nearer it is to 1.
    """
    if layout.name == "evidence" and row.get("evidence") == HONESTY and column in ("baseline", "value"):
        return "nearer dof", 1.0
    return layout.better.get(column), _number(row, "dof")


def _judged(old: Row, new: Row, column: str, layout: TableLayout, tolerance_pct: float | None) -> Moved:
    was, is_ = old[column], new[column]
    (_, dof_before), (better, dof_after) = (direction_of(layout, column, row) for row in (old, new))
    dofs = dof_before, dof_after
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        better = None
    if isinstance(was, float) and isinstance(is_, float) and better is None and agree(was, is_, column):
        return Moved(is_ - was, None, ChangeWord.SAME)
    if better is None or isinstance(was, str) or isinstance(is_, str):
        return Moved(_difference(was, is_), None, rank_word(was, is_, layout.words.get(column, ())))
    return judge_number(was, is_, column, better, dofs=dofs, tolerance_pct=tolerance_pct)


def _difference(old: Cell, new: Cell) -> float | None:
    if isinstance(old, int | float) and isinstance(new, int | float):
        return float(new - old)
    return None


def _number(row: Mapping[str, Cell], column: str) -> float:
    value = row.get(column)
    return float(value) if isinstance(value, int | float) else float("nan")
