"""Compare the cells of a dive's tables in two results: better, worse or the same.

The size of a number is compared: its value, its magnitude (*nearer zero*), or its ratio to its degrees of freedom
(*nearer dof*).
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from msgspec import Struct

from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.quantities import CONSISTENCY, label
from insdvl_replay.core.result import Cell, Row, StoredReport, StoredResult
from insdvl_replay.core.tables import CANDIDATES, PERCENTAGE, UNITS, Better, Number, TableLayout
from insdvl_replay.core.words import ChangeVerdict
from insdvl_replay.show.document import FORMS, MISSING

PRINTED_DIGITS: Final = 4
PRINTED_PERCENT_UNIT: Final = 0.1
ROUNDING: Final = 1e-9
"""Relative difference from rounding, by another processor or binary fractions: 0.3 - 0.2 is not more than 0.1."""
NAMES: Final = frozenset(("log", "filter", "unit"))
"""Columns that identify a row, with its key."""
PROSE: Final = frozenset(("sentence", "why"))
"""Columns with sentences, which are about numbers in other cells."""


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

    @property
    def grown(self) -> str:
        """The same for a number; empty for text."""
        return MISSING if self.change is None else self.growth


class Moved(NamedTuple):
    """The change of a cell: new minus old, change of the size in percent, verdict, and which direction is better."""

    change: float | None
    change_pct: float | None
    verdict: ChangeVerdict
    better: Better | None = None


# --- Names and changes as people read them.

_SHORT_NAMES: Final = {"rmse": "rms", "mean nis": "mean NIS", "mean nees": "mean NEES", "value": "", "fitted": ""}
_MOST_LETTERS: Final = 30  # of a setting in a sentence


def cell_name(table: str, filter_: str, row: str, column: str, baseline: str = "") -> str:
    """Name a cell in the field's words, such as ``aided position rms``; columns of the baseline are its own."""
    if baseline and (column == "baseline" or column.startswith("baseline_")):
        filter_, column = baseline, column.removeprefix("baseline").removeprefix("_")
    words = column.removesuffix(next((ending for ending in UNITS if column.endswith(ending)), "")).replace("_", " ")
    what = label(f"outage_{row}s" if table == "outage" else row).replace(",", "")
    return " ".join(filter(None, dict.fromkeys((filter_, what, _SHORT_NAMES.get(words, words)))))


def change_text(key: str, old: str, new: str) -> str:
    """Write the change of a setting, long values cut."""
    texts = (text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 3]}..." for text in (old, new))
    return f"{key} {' -> '.join(texts)}"


def changed_settings(
    old: Mapping[str, Any],  # by dotted key
    new: Mapping[str, Any],
    defaults: Mapping[str, Any] = {},  # of a key that a side lacks
) -> list[str]:
    """Write each setting that differs, with both values."""
    return [
        change_text(key, *(json.dumps(side.get(key, defaults.get(key))) for side in (old, new)))
        for key in dict.fromkeys((*old, *new))
        if old.get(key) != new.get(key)
    ]


# --- Compare.


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
    unit = PRINTED_PERCENT_UNIT if column.endswith(PERCENTAGE) else 10.0 ** (exponent - PRINTED_DIGITS + 1)
    return abs(new - old) <= unit * (1.0 + ROUNDING)


def judge_number(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    *,
    dofs: tuple[float, float] = (math.nan, math.nan),
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
    digits, digits_pct = _rounding(before, after, column), 100.0 * ROUNDING
    change_pct: float | None = None  # from zero, and from or to an infinite size
    if before == after:
        change_pct = 0.0
    elif column.endswith(PERCENTAGE):
        change_pct, digits_pct = after - before, digits
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
    word = ChangeVerdict.SAME if is_same else ChangeVerdict.BETTER if is_better else ChangeVerdict.WORSE
    return Moved(new - old, change_pct, word, better)


def _size(value: float, better: Better, dof: float) -> float:
    """Return the size of a number; infinite for a mean NIS of zero."""
    if better == "nearer dof":
        ratio = value / dof
        return max(ratio, 1.0 / ratio) if ratio > 0.0 else math.inf
    return abs(value) if better == "nearer zero" else value


def rank_verdict(old: Cell, new: Cell, best_first: tuple[str, ...]) -> ChangeVerdict:
    """Return the change of a word: better or worse if both words have a rank, else changed or the same."""
    if old == new:
        return ChangeVerdict.SAME
    if old not in best_first or new not in best_first:
        return ChangeVerdict.CHANGED
    return ChangeVerdict.WORSE if best_first.index(str(new)) > best_first.index(str(old)) else ChangeVerdict.BETTER


def judge_cell(
    old: Row,
    new: Row,
    column: str,
    layout: TableLayout,
    tolerance_pct: float | None = None,
    tolerance_abs: float | None = None,
) -> Moved:
    """Return the change of a cell that both rows have."""
    was, is_, better = old[column], new[column], layout.better.get(column)
    dofs = _dof(old), _dof(new)
    if layout.name == "evidence" and new.get("evidence") == CONSISTENCY and column in ("baseline", "value"):
        better, dofs = "nearer dof", (1.0, 1.0)  # NIS and NEES over their degrees of freedom
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        better = None
    if better is not None and not isinstance(was, str) and not isinstance(is_, str):
        return judge_number(
            was, is_, column, better, dofs=dofs, tolerance_pct=tolerance_pct, tolerance_abs=tolerance_abs
        )
    if not (isinstance(was, int | float) and isinstance(is_, int | float)):
        return Moved(None, None, rank_verdict(was, is_, layout.words.get(column, ())))
    same = better is None and isinstance(was, float) and isinstance(is_, float) and agree(was, is_, column)
    word = ChangeVerdict.SAME if same else rank_verdict(was, is_, layout.words.get(column, ()))
    return Moved(float(is_) - float(was), None, word)


def _dof(row: Row) -> float:
    dof = row.get("dof")
    return float(dof) if isinstance(dof, int | float) else math.nan


def named_rows(report: StoredReport, layout: TableLayout, place: object = "") -> dict[tuple[str, str, str], Row]:
    """Return the rows of a table by filter, key and unit; a ResultError if two have the same name.

    The block of the candidates is also a table; its rows are named by filter.
    """
    found = report.tables.get(layout.name, [])
    if layout is CANDIDATES:
        found = [{"filter": name, **row} for name, row in report.filters.items()]
    rows: dict[tuple[str, str, str], Row] = {}
    for number, row in enumerate(found, 1):
        name = str(row["filter"]), str(row[layout.key]), str(row.get("unit") or "")
        if name in rows:
            where = f"{place or report.log.name}: table {layout.name}, row {number}"
            raise ResultError(
                f"{where}: has the same names as an earlier row: {name[0]}, {name[1]}", "replay the log again"
            )
        rows[name] = row
    return rows


def changes_of(
    old: StoredResult, new: StoredResult, layouts: Sequence[TableLayout], tolerance_pct: float | None
) -> Iterator[Change]:
    """Compare the tables of one dive, cell by cell.

    Cells that can be better or worse are always listed. Counts, limits and words without rank are listed if changed.
    """
    for layout in layouts:
        befores, afters = (named_rows(side.report, layout, side.folder) for side in (old, new))
        for name in dict.fromkeys((*afters, *befores)):
            before, after = befores.get(name, {}), afters.get(name, {})
            for column in dict.fromkeys((*after, *before)):
                if column in NAMES | PROSE | {layout.key}:
                    continue
                moved = Moved(None, None, ChangeVerdict.NEW if column in after else ChangeVerdict.GONE)
                if column in before and column in after:
                    moved = judge_cell(before, after, column, layout, tolerance_pct)
                if moved.verdict != ChangeVerdict.SAME or column in layout.better or column in layout.words:
                    filter_, row, unit = name
                    place = new.name, layout.name, filter_, row, layout.unit_of(column, unit), column
                    yield Change(*place, before.get(column), after.get(column), *moved[:3])
