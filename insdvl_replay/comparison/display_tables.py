"""The cells of a comparison as text, and their tables: the cells of one dive, or each cell over many dives."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, Literal, TypeVar

from insdvl_replay.comparison.aggregation import loss, loss_of
from insdvl_replay.core.changes import Aggregate, Change, Comparison
from insdvl_replay.core.quantities import label
from insdvl_replay.core.stored_report import Cell
from insdvl_replay.core.table import PERCENTAGE
from insdvl_replay.core.tables import CANDIDATES, LAYOUTS
from insdvl_replay.core.words import ChangeWord
from insdvl_replay.report.document import MISSING, Column, DisplayTable, number, table_of

SortOrder = Literal["table", "name", "change", "worse"]
"""As in the reports; by row; largest change first; largest loss first."""


def in_order(comparison: Comparison, order: SortOrder, *, only_changed: bool) -> Comparison:
    """Put changes and aggregates into an order; counts stay those of all.

    Parameters
    ----------
    only_changed : bool
        Leave out what is the same, and of the aggregates what is the same in all dives.
    """
    changes, overall = comparison.changes, comparison.aggregates
    if only_changed:
        changes = tuple(change for change in changes if change.word != ChangeWord.SAME)
        overall = tuple(aggregate for aggregate in overall if aggregate.same < aggregate.dives)
    if order != "table":
        changes = tuple(sorted(changes, key=_CHANGE_KEYS[order]))
        overall = tuple(sorted(overall, key=_AGGREGATE_KEYS[order]))
    return replace(comparison, changes=changes, aggregates=overall)


def _size(change_pct: float | None) -> float:
    return math.inf if change_pct is None else abs(change_pct)


_CHANGE_KEYS: Final[dict[str, Callable[[Change], str | float]]] = {
    "name": lambda change: change.row,
    "change": lambda change: 0.0 if change.word == ChangeWord.SAME else -_size(change.change_pct),
    "worse": lambda change: -loss_of(change),
}
_AGGREGATE_KEYS: Final[dict[str, Callable[[Aggregate], str | float]]] = {
    "name": lambda aggregate: aggregate.row,
    "change": lambda aggregate: -_size(aggregate.median_change_pct),
    "worse": lambda aggregate: -loss(aggregate.worst_word, aggregate.worst_change_pct),
}


_BETTER: Final = {(layout.name, column): better for layout in LAYOUTS for column, better in layout.better.items()}
_KEYS: Final = {layout.name: layout.key for layout in LAYOUTS}
_MEANING: Final = {
    "lower": "lower is better",
    "higher": "higher is better",
    "nearer zero": "nearer zero is better; % of the magnitude",
    "nearer dof": "nearer dof is better; % of their ratio",
}
_FEW_ROWS: Final = 3
"""Up to here the rows of several filters share a table."""
_FINE_PCT = 0.95
"""Smaller percentages have two digits behind the point, larger ones one."""
_NONE_PCT = 0.005
"""Smaller ones would print as zero with a sign."""
Item = TypeVar("Item", Change, Aggregate)
Columns = list[Column[Item]]


def change_tables(changes: Iterable[Change]) -> list[DisplayTable]:
    """Show the cells of one dive, a table for each column; what is said of the candidates is one table."""
    groups = sorted(_grouped(changes), key=lambda group: all(change.word == ChangeWord.CHANGED for change in group))
    return [_table(group, _value_columns(group)) for group in groups]


def aggregate_tables(aggregates: Iterable[Aggregate]) -> list[DisplayTable]:
    """Show each cell over many dives, a table for each column; what is said of the candidates is one table."""
    return [_table(group, _share_columns(group)) for group in _grouped(aggregates)]


def _grouped(items: Iterable[Item]) -> Iterator[list[Item]]:
    """Put together what stands in one column, filters apart where they have many rows."""
    by_column: dict[tuple[str, str], list[Item]] = {}
    for item in items:
        column = "" if item.table == CANDIDATES.name else item.column
        by_column.setdefault((item.table, column), []).append(item)
    for group in by_column.values():
        rows = Counter(item.filter for item in group)
        if max(rows.values()) <= _FEW_ROWS or group[0].table == CANDIDATES.name:
            yield group
        else:
            yield from ([item for item in group if item.filter == name] for name in rows)


def _table(items: Sequence[Item], value_columns: Columns[Item]) -> DisplayTable:
    columns: Columns[Item] = _naming_columns(items) + value_columns
    return table_of(_title(items), items, columns)


def _naming_columns(items: Sequence[Item]) -> Columns[Item]:
    """Return the columns that name a row: its filter and its unit only where they are not the same for all."""
    columns: Columns[Item] = []
    if len({item.filter for item in items}) > 1 or items[0].table == CANDIDATES.name:
        columns.append(("filter", "l", lambda item: item.filter))
    if items[0].table == CANDIDATES.name:
        columns.append(("what", "l", lambda item: _spoken(item.column)))
        return columns
    columns.append((_KEYS[items[0].table], "l", lambda item: label(item.row)))
    if len({item.unit for item in items}) > 1:
        columns.append(("unit", "l", lambda item: item.unit))
    return columns


def _value_columns(changes: Sequence[Change]) -> Columns[Change]:
    words = any(isinstance(value, str) for change in changes for value in (change.old, change.new))
    columns: Columns[Change] = [
        ("old", "l" if words else "r", lambda change: old_and_new(change)[0]),
        ("new", "l" if words else "r", lambda change: old_and_new(change)[1]),
    ]
    if changes[0].table == CANDIDATES.name:
        columns.append(("change", "r", lambda change: growth(change) if change.change is not None else MISSING))
    elif not words:
        columns.append(("points" if is_percentage(changes[0]) else "change", "r", change_text))
        if not is_percentage(changes[0]) and any(change.change_pct is not None for change in changes):
            columns.append(("%", "r", lambda change: percent_text(change.change_pct)))
    return [*columns, ("", "l", lambda change: change.word)]


def _share_columns(aggregates: Sequence[Aggregate]) -> Columns[Aggregate]:
    unit = "points" if is_percentage(aggregates[-1]) else "%"
    return [
        ("dives", "r", lambda cell: str(cell.dives)),
        ("better\n[%]", "r", lambda cell: f"{cell.share_better_pct:.0f}"),
        ("worse\n[%]", "r", lambda cell: f"{100.0 * cell.worse / cell.dives:.0f}"),
        (f"median\n[{unit}]", "r", lambda cell: percent_text(cell.median_change_pct)),
        (f"worst\n[{unit}]", "r", lambda cell: percent_text(cell.worst_change_pct)),
        ("in", "l", _worst_in),
    ]


def _worst_in(cell: Aggregate) -> str:
    """Name the dive that lost most; of words, only if one fell."""
    rose = cell.worst_word == ChangeWord.BETTER and cell.worst_change_pct is None
    return MISSING if rose or cell.worst_word == ChangeWord.SAME else cell.worst_log


def _title(items: Sequence[Item]) -> str:
    first = items[0]
    if first.table == CANDIDATES.name:
        return "Verdicts: what is said of each candidate"
    names, units = ({getattr(item, what) for item in items} for what in ("filter", "unit"))
    of_filter = f", {first.filter}" if len(names) == 1 else ""
    in_unit = f" [{first.unit}]" if len(units) == 1 and first.unit else ""
    better = _BETTER.get((first.table, first.column))
    meaning = f" ({_MEANING[better]})" if better else ""
    return f"{_spoken(first.table).capitalize()}{of_filter}: {first.column}{in_unit}{meaning}"


def _spoken(name: str) -> str:
    return name.removesuffix("_pct").replace("_", " ")


def is_percentage(cell: Change | Aggregate) -> bool:
    """Return whether a cell holds a percentage, which changes by percentage points."""
    return cell.column.endswith(PERCENTAGE)


def old_and_new(change: Change) -> tuple[str, str]:
    """Write what stood in a cell, and what stands there."""
    return _text(change.old, change), _text(change.new, change)


def _text(value: Cell, change: Change) -> str:
    if isinstance(value, float):
        return f"{value:.1f}" if is_percentage(change) else number(value)
    return MISSING if value is None else str(value).replace("_", " ")


def percent_text(percent: float | None) -> str:
    """Write a change in percent with its sign."""
    if percent is None:
        return MISSING
    if abs(percent) < _NONE_PCT:
        return "0"
    return f"{percent:+.1f}" if abs(percent) >= _FINE_PCT else f"{percent:+.2f}"


def change_text(change: Change) -> str:
    """Write new minus old, with its sign."""
    if change.change is None:
        return MISSING
    if is_percentage(change):
        return percent_text(change.change)
    if isinstance(change.old, int) and isinstance(change.new, int):
        return f"{change.new - change.old:+d}"
    return f"+{number(change.change)}" if change.change > 0.0 else number(change.change)


def place(change: Change) -> str:
    """State where in its table a cell stands, in the names that files and options use."""
    row = "" if change.row == change.filter else f" {change.row}"
    return f"{change.filter}{row} {change.column}"


def movement(change: Change) -> str:
    """State from where to where a cell moved, and by how much."""
    old, new = old_and_new(change)
    unit = f" {change.unit}" if change.unit else ""
    return f"from {old} to {new}{unit} ({growth(change)})"


def growth(change: Change) -> str:
    """State by how much a cell's size grew, with the unit; its word where there is no percentage."""
    if change.change_pct is None:
        return change.word
    return f"{percent_text(change.change_pct)} {'points' if is_percentage(change) else '%'}"


def described(change: Change) -> str:
    """State in one line where a cell stands and how it moved."""
    return f"{change.log}, {change.table}: {place(change)} {movement(change)}"
