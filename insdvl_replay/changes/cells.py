"""The frame of two reports: every row of their tables side by side, and the verdict of each cell.

`compare` shows the verdicts, a gate looks at one column of some rows, and expected values are the old side of a gate.

The size of a number is compared: its value, its magnitude (*nearer zero*), or its ratio to its degrees of freedom
(*nearer dof*).
"""

import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple, TypeGuard

from msgspec import Struct

from insdvl_replay.core.quantities import CONSISTENCY, label
from insdvl_replay.core.report import Cell, Row, StoredReport
from insdvl_replay.core.tables import CANDIDATES, Better, Number, TableLayout
from insdvl_replay.core.units import PERCENTAGE, ending_of
from insdvl_replay.core.words import ChangeVerdict
from insdvl_replay.document.tables import FORMS

PRINTED_DIGITS: Final = 4
PRINTED_PERCENT_UNIT: Final = 0.1
# Relative difference from rounding, by another processor or binary fractions: 0.3 - 0.2 is not more than 0.1.
ROUNDING: Final = 1e-9
# Columns with sentences, which are about numbers in other cells.
PROSE: Final = frozenset(("sentence", "reason"))
# Columns that identify a row, with its key.
_NAMES: Final = frozenset(("log", "filter", "unit"))


# --- The frame.


class RowPair(NamedTuple):
    """A row of a table in two reports; empty for a report that does not have it."""

    layout: TableLayout
    filter: str
    row: str  # name of the row: a state, quantity or measurement; of a candidate, its name
    unit: str
    old: Row
    new: Row


def paired_rows(
    old: StoredReport | None, new: StoredReport, layouts: Iterable[TableLayout]
) -> Iterator[RowPair]:
    """Yield the rows of some tables, found by filter, key and unit: those of the new report, then those it lacks."""
    for layout in layouts:
        before = _rows_by_place(old, layout)
        after = _rows_by_place(new, layout)
        for place in dict.fromkeys((*after, *before)):
            yield RowPair(layout, *place, before.get(place, {}), after.get(place, {}))


_Place = tuple[str, str, str]  # filter, key and unit of a row


def _rows_by_place(report: StoredReport | None, layout: TableLayout) -> dict[_Place, Row]:
    """Return the rows of a table by their place; none without a report."""
    if report is None:
        return {}
    rows = report.tables.get(layout.name, [])
    if layout is CANDIDATES:
        rows = [{"filter": name, **row} for name, row in report.filters.items()]
    found = dict[_Place, Row]()
    for row in rows:
        found[str(row["filter"]), str(row[layout.key]), str(row.get("unit") or "")] = row
    return found


class Change(Struct, frozen=True):
    """One cell of a table, before and after; None if a side does not have it, and for the change of text."""

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
    verdict: ChangeVerdict

    @property
    def growth(self) -> str:
        """The change of the size in percent or points; the verdict if there is no percentage."""
        if self.change_pct is None:
            return self.verdict
        return f"{FORMS['signed_percent'](self.change_pct)} {unit_of_change(self.column)}"


def unit_of_change(column: str) -> str:
    """Return the unit of a relative change: percentages change by points."""
    if column.endswith(PERCENTAGE):
        return "points"
    return "%"


def changes_of(
    pairs: Iterable[RowPair],
    log: str,
    columns: Collection[str],
    tolerance_pct: float | None,
) -> Iterator[Change]:
    """Yield the changes of a dive, cell by cell; of all columns, if none is named.

    Cells that can be better or worse are always listed. Counts, limits and words without rank are listed if changed.
    """
    for pair in pairs:
        layout = pair.layout
        for column in dict.fromkeys((*pair.new, *pair.old)):
            if not _is_compared(column, layout) or (columns and column not in columns):
                continue
            moved = judge_cell(pair, column, tolerance_pct)
            has_rank = column in layout.better or column in layout.words
            if has_rank or moved.verdict != ChangeVerdict.SAME:
                yield Change(
                    log=log,
                    table=layout.name,
                    filter=pair.filter,
                    row=pair.row,
                    unit=layout.unit_of(column, pair.unit),
                    column=column,
                    old=pair.old.get(column),
                    new=pair.new.get(column),
                    change=moved.change,
                    change_pct=moved.change_pct,
                    verdict=moved.verdict,
                )


def _is_compared(column: str, layout: TableLayout) -> bool:
    """Return whether a column has values, and not the name of its row or a sentence."""
    return column not in _NAMES and column not in PROSE and column != layout.key


# --- The verdict of a cell.


class Moved(NamedTuple):
    """The change of a cell: new minus old, change of the size in percent, verdict, and which direction is better."""

    change: float | None
    change_pct: float | None
    verdict: ChangeVerdict
    better: Better | None = None


def judge_cell(
    pair: RowPair,
    column: str,
    tolerance_pct: float | None = None,
    tolerance_abs: float | None = None,
) -> Moved:
    """Return the change of a cell."""
    if column not in pair.new:
        return Moved(None, None, ChangeVerdict.GONE)
    if column not in pair.old:
        return Moved(None, None, ChangeVerdict.NEW)
    old = pair.old[column]
    new = pair.new[column]
    better = _better_of(pair, column)
    if better is not None and not isinstance(old, str) and not isinstance(new, str):
        return judge_number(
            old,
            new,
            column,
            better,
            dofs=_dofs(pair, column),
            tolerance_pct=tolerance_pct,
            tolerance_abs=tolerance_abs,
        )
    if is_number(old) and is_number(new):
        word = ChangeVerdict.SAME if agree(old, new, column) else ChangeVerdict.CHANGED
        return Moved(float(new) - float(old), None, word)
    return Moved(None, None, rank_verdict(old, new, pair.layout.words.get(column, ())))


def _better_of(pair: RowPair, column: str) -> Better | None:
    """Return which direction of a cell is better; None where it has none, or its degrees of freedom are not known."""
    if _is_ratio_to_dof(pair, column):
        return "nearer dof"
    better = pair.layout.better.get(column)
    if better == "nearer dof" and not all(dof > 0.0 for dof in _dofs(pair, column)):
        return None
    return better


def _is_ratio_to_dof(pair: RowPair, column: str) -> bool:
    """Return whether a cell of the evidence is NIS or NEES over its degrees of freedom."""
    is_consistency = pair.layout.name == "evidence" and pair.new.get("evidence") == CONSISTENCY
    return is_consistency and column in ("baseline", "value")


def _dofs(pair: RowPair, column: str) -> tuple[float, float]:
    """Return the degrees of freedom of a cell, before and after; NaN where they are not known."""
    if _is_ratio_to_dof(pair, column):
        return (1.0, 1.0)
    return (_dof(pair.old), _dof(pair.new))


def _dof(row: Row) -> float:
    dof = row.get("dof")
    if is_number(dof):
        return float(dof)
    return math.nan


def judge_number(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    *,
    dofs: tuple[float, float] = (math.nan, math.nan),  # before and after
    tolerance_pct: float | None = None,
    tolerance_abs: float | None = None,
) -> Moved:
    """Return the change of a number. Without a tolerance, numbers that print the same are the same; the larger of two
    tolerances counts.
    """
    if old is None and new is None:
        return Moved(None, None, ChangeVerdict.SAME, better)
    if new is None:
        return Moved(None, None, ChangeVerdict.WORSE, better)
    if old is None:
        return Moved(None, None, ChangeVerdict.BETTER, better)
    before = _size(old, better, dofs[0])
    after = _size(new, better, dofs[1])
    change_pct = _change_pct(before, after, column)
    is_same = before == after
    if tolerance_pct is None and tolerance_abs is None:
        is_same = prints_the_same(before, after, column)
    digits = _rounding(before, after, column)
    if tolerance_pct is not None and change_pct is not None:
        digits_pct = 100.0 * ROUNDING
        if column.endswith(PERCENTAGE) and before != after:
            digits_pct = digits
        is_same |= within(abs(change_pct), tolerance_pct, digits_pct)
    if tolerance_abs is not None:
        is_same |= within(abs(after - before), tolerance_abs, digits)
    return Moved(new - old, change_pct, _word(before, after, better, is_same=is_same), better)


def _change_pct(before: float, after: float, column: str) -> float | None:
    """Return the change of a size in percent, or points of a percentage; None from zero, and from or to infinity."""
    if before == after:
        return 0.0
    if column.endswith(PERCENTAGE):
        return after - before
    if before != 0.0 and math.isfinite(before) and math.isfinite(after):
        return 100.0 * (after - before) / abs(before)
    return None


def _word(
    before: float,
    after: float,
    better: Better,
    *,
    is_same: bool,
) -> ChangeVerdict:
    """Return the verdict on the change of a size."""
    if is_same:
        return ChangeVerdict.SAME
    is_larger = after > before
    if is_larger == (better == "higher"):
        return ChangeVerdict.BETTER
    return ChangeVerdict.WORSE


def _size(value: float, better: Better, dof: float) -> float:
    """Return the size of a number; infinite for a mean NIS of zero."""
    if better == "nearer dof":
        ratio = value / dof
        if ratio > 0.0:
            return max(ratio, 1.0 / ratio)
        return math.inf
    if better == "nearer zero":
        return abs(value)
    return value


def rank_verdict(old: Cell, new: Cell, best_first: tuple[str, ...]) -> ChangeVerdict:
    """Return the change of a word: better or worse if both words have a rank, else changed or the same."""
    if old == new:
        return ChangeVerdict.SAME
    if old not in best_first or new not in best_first:
        return ChangeVerdict.CHANGED
    if best_first.index(str(new)) > best_first.index(str(old)):
        return ChangeVerdict.WORSE
    return ChangeVerdict.BETTER


def is_number(value: Cell) -> TypeGuard[float | int]:
    """Return whether a value is a number; ``true`` and ``false`` are not."""
    return isinstance(value, float | int) and not isinstance(value, bool)


def agree(old: float, new: float, column: str) -> bool:
    """Return whether two numbers are the same, up to rounding."""
    return old == new or abs(new - old) <= _rounding(old, new, column)


def _rounding(old: float, new: float, column: str) -> float:
    """Return the difference that rounding may cause; a percentage is rounded at about 100 %."""
    size = min(abs(old), abs(new))
    if column.endswith(PERCENTAGE):
        size = max(size, 100.0)
    return ROUNDING * size


def within(change: float, allowed: float, digits: float) -> bool:
    """Return whether a change is within the allowed one, up to rounding."""
    return change <= allowed * (1.0 + ROUNDING) + digits


def prints_the_same(old: float, new: float, column: str) -> bool:
    """Return whether two sizes differ by at most one unit of the last printed digit of the larger one."""
    largest = max(abs(old), abs(new))
    if math.isinf(largest) or largest == 0.0:
        return old == new
    if column.endswith(PERCENTAGE):
        unit = PRINTED_PERCENT_UNIT
    else:
        unit = 10.0 ** (math.floor(math.log10(largest)) - PRINTED_DIGITS + 1)
    return abs(new - old) <= unit * (1.0 + ROUNDING)


# --- Names and settings as people read them.

_SHORT_NAMES: Final = {
    "rmse": "rms",
    "mean nis": "mean NIS",
    "mean nees": "mean NEES",
    "value": "",
    "fitted": "",
}
_MOST_LETTERS: Final = 30  # of a setting in a sentence


def cell_name(
    table: str,
    filter_: str,
    row: str,
    column: str,
    baseline: str = "",
) -> str:
    """Name a cell in the field's words, such as ``aided position rms``; columns of the baseline are its own."""
    if baseline and (column == "baseline" or column.startswith("baseline_")):
        filter_ = baseline
        column = column.removeprefix("baseline").removeprefix("_")
    column = column.removesuffix(ending_of(column))
    if table == "outage":
        row = f"outage_{row}s"
    what = label(row).replace(",", "")
    words = column.replace("_", " ")
    names = dict.fromkeys((filter_, what, _SHORT_NAMES.get(words, words)))
    return " ".join(name for name in names if name)


def change_text(key: str, old: str, new: str) -> str:
    """Write the change of a setting, long values cut."""
    return f"{key} {cut_value(old)} -> {cut_value(new)}"


def cut_value(text: str) -> str:
    """Return a value, a long one cut."""
    if len(text) <= _MOST_LETTERS:
        return text
    return f"{text[: _MOST_LETTERS - 3]}..."


def changed_settings(
    old: Mapping[str, Any],  # by dotted key
    new: Mapping[str, Any],
    defaults: Mapping[str, Any] = {},  # of a key that a side lacks
) -> dict[str, str]:
    """Write each setting that differs, with both values, by its key."""
    texts = dict[str, str]()
    for key in (*old, *new):
        if old.get(key) != new.get(key):
            before = json.dumps(old.get(key, defaults.get(key)))
            after = json.dumps(new.get(key, defaults.get(key)))
            texts[key] = change_text(key, before, after)
    return texts
