"""The cells of a comparison as text: values, changes, and where they stand."""

from insdvl_replay.core.changes import Aggregate, Change
from insdvl_replay.core.stored_result import Cell
from insdvl_replay.core.table_layout import PERCENTAGE
from insdvl_replay.report.display_table import MISSING, number

_FINE_PCT = 0.95
"""Smaller percentages have two digits behind the point, larger ones one."""
_NONE_PCT = 0.005
"""Smaller ones would print as zero with a sign."""


def is_percentage(cell: Change | Aggregate) -> bool:
    """Say whether a cell holds a percentage, which changes by percentage points."""
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
    """Say where in its table a cell stands, in the names that files and options use."""
    row = "" if change.row == change.filter else f" {change.row}"
    return f"{change.filter}{row} {change.column}"


def movement(change: Change) -> str:
    """Say from where to where a cell moved, and by how much."""
    old, new = old_and_new(change)
    unit = f" {change.unit}" if change.unit else ""
    return f"from {old} to {new}{unit} ({growth(change)})"


def growth(change: Change) -> str:
    """Say by how much a cell's size grew, with the unit; its word where there is no percentage."""
    if change.change_pct is None:
        return change.word
    return f"{percent_text(change.change_pct)} {'points' if is_percentage(change) else '%'}"


def described(change: Change) -> str:
    """Say in one line where a cell stands and how it moved."""
    return f"{change.log}, {change.table}: {place(change)} {movement(change)}"
