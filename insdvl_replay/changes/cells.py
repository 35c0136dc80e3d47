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
from insdvl_replay.core.tables import CANDIDATES, PERCENTAGE, UNITS, Better, Number, TableLayout
from insdvl_replay.core.words import ChangeVerdict
from insdvl_replay.document.tables import FORMS

PRINTED_DIGITS: Final = 4
PRINTED_PERCENT_UNIT: Final = 0.1
# Relative difference from rounding, by another processor or binary fractions: 0.3 - 0.2 is not more than 0.1.
ROUNDING: Final = 1e-9
# Columns with sentences, which are about numbers in other cells.
PROSE: Final = frozenset(("sentence", "reason", "why"))
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
        sides = []
        for report in (old, new):
            rows = report.tables.get(layout.name, []) if report else []
            if layout is CANDIDATES and report:
                rows = [{"filter": name, **row} for name, row in report.filters.items()]
            sides.append(
                {
                    (str(row["filter"]), str(row[layout.key]), str(row.get("unit") or "")): row
                    for row in rows
                }
            )
        before, after = sides
        for name in dict.fromkeys((*after, *before)):
            yield RowPair(layout, *name, before.get(name, {}), after.get(name, {}))


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
        return f"{FORMS['signed_percent'](self.change_pct)} {'points' if self.column.endswith(PERCENTAGE) else '%'}"


def changes_of(
    pairs: Iterable[RowPair], log: str, columns: Collection[str], tolerance_pct: float | None
) -> Iterator[Change]:
    """Yield the changes of a dive, cell by cell; of all columns, if none is named.

    Cells that can be better or worse are always listed. Counts, limits and words without rank are listed if changed.
    """
    for pair in pairs:
        layout = pair.layout
        for column in dict.fromkeys((*pair.new, *pair.old)):
            if (
                column in _NAMES
                or column in PROSE
                or column == layout.key
                or (columns and column not in columns)
            ):
                continue
            moved = judge_cell(pair, column, tolerance_pct)
            if (
                moved.verdict != ChangeVerdict.SAME
                or column in layout.better
                or column in layout.words
            ):
                place = (
                    log,
                    layout.name,
                    pair.filter,
                    pair.row,
                    layout.unit_of(column, pair.unit),
                    column,
                )
                yield Change(*place, pair.old.get(column), pair.new.get(column), *moved[:3])


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
    if not (column in pair.old and column in pair.new):
        return Moved(None, None, ChangeVerdict.NEW if column in pair.new else ChangeVerdict.GONE)
    old = pair.old[column]
    new = pair.new[column]
    better = pair.layout.better.get(column)
    before_dof = pair.old.get("dof")
    after_dof = pair.new.get("dof")
    if (
        pair.layout.name == "evidence"
        and pair.new.get("evidence") == CONSISTENCY
        and column in ("baseline", "value")
    ):
        # NIS and NEES over their degrees of freedom
        better = "nearer dof"
        before_dof = 1.0
        after_dof = 1.0
    dofs = tuple(float(dof) if is_number(dof) else math.nan for dof in (before_dof, after_dof))
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        better = None
    if better is not None and not isinstance(old, str) and not isinstance(new, str):
        return judge_number(
            old,
            new,
            column,
            better,
            dofs=dofs,
            tolerance_pct=tolerance_pct,
            tolerance_abs=tolerance_abs,
        )
    if is_number(old) and is_number(new):
        word = ChangeVerdict.SAME if agree(old, new, column) else ChangeVerdict.CHANGED
        return Moved(float(new) - float(old), None, word)
    return Moved(None, None, rank_verdict(old, new, pair.layout.words.get(column, ())))


def judge_number(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    *,
    dofs: tuple[float, ...] = (math.nan, math.nan),  # before and after
    tolerance_pct: float | None = None,
    tolerance_abs: float | None = None,
) -> Moved:
    """Return the change of a number. Without a tolerance, numbers that print the same are the same; the larger of two
    tolerances counts.
    """
    if old is None or new is None:
        word = ChangeVerdict.WORSE if new is None else ChangeVerdict.BETTER
        return Moved(None, None, ChangeVerdict.SAME if old is new else word, better)
    before, after = (_size(value, better, dof) for value, dof in zip((old, new), dofs, strict=True))
    digits = _rounding(before, after, column)
    digits_pct = 100.0 * ROUNDING
    change_pct: float | None = None  # from zero, and from or to an infinite size
    if before == after:
        change_pct = 0.0
    elif column.endswith(PERCENTAGE):
        change_pct = after - before
        digits_pct = digits
    elif before != 0.0 and math.isfinite(before) and math.isfinite(after):
        change_pct = 100.0 * (after - before) / abs(before)
    is_same = before == after
    if tolerance_pct is None and tolerance_abs is None:
        is_same = prints_the_same(before, after, column)
    if tolerance_pct is not None and change_pct is not None:
        is_same |= within(abs(change_pct), tolerance_pct, digits_pct)
    if tolerance_abs is not None:
        is_same |= within(abs(after - before), tolerance_abs, digits)
    is_better = (after > before) == (better == "higher")
    word = (
        ChangeVerdict.SAME
        if is_same
        else ChangeVerdict.BETTER
        if is_better
        else ChangeVerdict.WORSE
    )
    return Moved(new - old, change_pct, word, better)


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
    return ROUNDING * max(100.0 if column.endswith(PERCENTAGE) else 0.0, min(abs(old), abs(new)))


def within(change: float, allowed: float, digits: float) -> bool:
    """Return whether a change is within the allowed one, up to rounding."""
    return change <= allowed * (1.0 + ROUNDING) + digits


def prints_the_same(old: float, new: float, column: str) -> bool:
    """Return whether two sizes differ by at most one unit of the last printed digit of the larger one."""
    largest = max(abs(old), abs(new))
    if math.isinf(largest) or largest == 0.0:
        return old == new
    exponent = math.floor(math.log10(largest))
    unit = (
        PRINTED_PERCENT_UNIT
        if column.endswith(PERCENTAGE)
        else 10.0 ** (exponent - PRINTED_DIGITS + 1)
    )
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


def cell_name(table: str, filter_: str, row: str, column: str, baseline: str = "") -> str:
    """Name a cell in the field's words, such as ``aided position rms``; columns of the baseline are its own."""
    if baseline and (column == "baseline" or column.startswith("baseline_")):
        filter_ = baseline
        column = column.removeprefix("baseline").removeprefix("_")
    words = column.removesuffix(
        next((ending for ending in UNITS if column.endswith(ending)), "")
    ).replace("_", " ")
    what = label(f"outage_{row}s" if table == "outage" else row).replace(",", "")
    return " ".join(filter(None, dict.fromkeys((filter_, what, _SHORT_NAMES.get(words, words)))))


def change_text(key: str, old: str, new: str) -> str:
    """Write the change of a setting, long values cut."""
    return f"{key} {_cut(old)} -> {_cut(new)}"


def _cut(text: str) -> str:
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
