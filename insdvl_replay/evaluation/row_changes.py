"""Every cell of a dive's tables, before and after."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from insdvl_replay.core.changes import Change
from insdvl_replay.core.errors import ResultError
from insdvl_replay.core.stored_result import Cell, Row, StoredReport, StoredResult
from insdvl_replay.core.table_layout import TableLayout
from insdvl_replay.core.tables import CANDIDATES
from insdvl_replay.evaluation.cell_change import Moved, agree, judge_number, rank_word

NAMES: Final = frozenset(("log", "filter", "unit"))
"""Columns that name a row, with its key."""
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
    """Give the rows of a table, the candidates' block included.

    Returns
    -------
    list of dict
        They have the columns ``filter`` and the layout's key, without which no result is read.
    """
    if layout is CANDIDATES:
        return [{"filter": name, **row} for name, row in report.filters.items()]
    return report.tables.get(layout.name, [])


def named_rows(result: StoredResult, layout: TableLayout) -> dict[_Key, Row]:
    """Give the rows of a table by filter, key and unit.

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
    """Give each cell of a row with what became of it."""
    before, after = old or {}, new or {}
    skipped = NAMES | {layout.key} | {column for table, column in SENTENCES if table == layout.name}
    for column in dict.fromkeys((*after, *before)):
        if column in skipped:
            continue
        was, is_ = before.get(column), after.get(column)
        if column in before and column in after:
            moved = _judged(before, after, column, layout, tolerance_pct)
        else:
            moved = Moved(None, None, "new" if column in after else "gone")
        if moved.word != "same" or column in layout.better or column in layout.words:
            yield column, was, is_, moved


def _judged(old: Row, new: Row, column: str, layout: TableLayout, tolerance_pct: float | None) -> Moved:
    was, is_ = old[column], new[column]
    better = layout.better.get(column)
    dofs = _number(old, "dof"), _number(new, "dof")
    if better == "nearer dof" and not all(dof > 0.0 for dof in dofs):
        better = None
    if isinstance(was, float) and isinstance(is_, float) and better is None and agree(was, is_, column):
        return Moved(is_ - was, None, "same")
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
