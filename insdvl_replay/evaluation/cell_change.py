"""What became of one number or one word: by how much it moved, and whether that is better.

A number is better when its size is smaller (larger for ``higher``). The size is the value itself, its magnitude for
signed errors, and for a mean NIS or NEES the factor by which it is off its degrees of freedom.
"""

import math
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.changes import Word
from insdvl_replay.core.stored_result import Cell
from insdvl_replay.core.table_layout import PERCENTAGE, Better

PRINTED_DIGITS: Final = 4
"""Significant digits of a printed number."""
PRINTED_PERCENT_UNIT: Final = 0.1
"""One unit of the last printed digit of a percentage."""
ROUNDING: Final = 1e-9
"""Share of a number that another processor, or binary fractions, may add: 0.3 - 0.2 is not more than 0.1."""


def rounding(old: float, new: float, column: str) -> float:
    """Give the difference of two numbers that says nothing.

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
    """Say whether two numbers are the same, but for a difference that says nothing."""
    return old == new or abs(new - old) <= rounding(old, new, column)


def within(change: float, allowed: float, digits: float) -> bool:
    """Say whether a change is no more than allowed, but for a difference that says nothing.

    Parameters
    ----------
    digits : float
        From `rounding` or `rounding_pct`, in the unit of the change.
    """
    return change <= allowed * (1.0 + ROUNDING) + digits


def size(value: float, better: Better, dof: float = math.nan) -> float:
    """Give what is compared of a number.

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
    """Say by how much a size grew, in percent of the old one; in percentage points where it is a percentage.

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
    """Give the change of a size, as `size_change_pct` has it, that says nothing."""
    return rounding(old, new, column) if column.endswith(PERCENTAGE) else 100.0 * ROUNDING


def prints_alike(old: float, new: float, column: str) -> bool:
    """Say whether two sizes differ by no more than one unit of the last digit that is printed of the larger."""
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
    word: Word


def judge_number(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    *,
    dofs: tuple[float, float] = (math.nan, math.nan),
    tolerance_pct: float | None = None,
) -> Moved:
    """Say what became of a number."""
    if old is None or new is None:
        return Moved(None, None, "same" if old is new else "worse" if new is None else "better")
    before, after = size(old, better, dofs[0]), size(new, better, dofs[1])
    change_pct = size_change_pct(before, after, column)
    if tolerance_pct is None:
        alike = prints_alike(before, after, column)
    else:
        digits = rounding_pct(before, after, column)
        alike = before == after or (change_pct is not None and within(abs(change_pct), tolerance_pct, digits))
    if alike:
        return Moved(new - old, change_pct, "same")
    return Moved(new - old, change_pct, "better" if (after > before) == (better == "higher") else "worse")


def rank_word(old: Cell, new: Cell, best_first: tuple[str, ...]) -> Word:
    """Say what became of a word: better or worse if both words have a rank, else whether it changed."""
    if old == new:
        return "same"
    if old not in best_first or new not in best_first:
        return "changed"
    return "worse" if best_first.index(str(new)) > best_first.index(str(old)) else "better"
