"""What a filter believes of itself: improvement and convergence time from the square roots of P's diagonal.

Any further measurement shrinks P. These tables say how sure a filter is, never how right; `reference` and `consistency`
do. Both are read where a filter has just used a ping: between pings the uncertainty grows, so that a look at any other
time would measure the time since the last ping. The end of the dive is its last ping.
"""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History
from insdvl_replay.core.states import NINE, STATES, State
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import ConvergenceRow, ImprovementRow
from insdvl_replay.core.words import ImprovementStatus

_Row = TypeVar("_Row", ImprovementRow, ConvergenceRow, ImprovementRow | ConvergenceRow)
SAME_PCT = 0.05
"""A smaller change of a standard deviation is called ``same``; shown with one digit it would read 0.0 %."""


def improvement_table(log: str, histories: tuple[History, ...]) -> list[ImprovementRow]:
    """Compare the standard deviations at the end of the dive, 12 states for each candidate, or those that it tells.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        The first is the baseline.
    """
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        for state in believed_states(candidate):
            ends = final_sd(baseline, candidate), final_sd(candidate)
            before, after = (float(sd[state.index]) / state.factor for sd in ends)
            change_pct = improvement_pct(before, after)
            status = _improvement_status(change_pct)
            rows.append(ImprovementRow(log, candidate.filter, state.id, state.unit, before, after, change_pct, status))
    return rows


def believed_states(history: History) -> list[State]:
    """List the twelve states, or those of them of which a solution that was read says how sure it is."""
    believed = history.believed if history.updated.any() else np.zeros(len(history.states), np.bool_)
    return [state for state in STATES if believed[state.index]]


def last_row(history: History, judged_as: History | None = None) -> int:
    """Return the row of the last ping; of one beside a solution that was read, the last that it speaks of, too."""
    is_read = judged_as is not None and judged_as.is_read
    rows = np.flatnonzero(history.updated & judged_as.updated if judged_as is not None and is_read else history.updated)
    return int(rows[-1])


def final_sd(history: History, judged_as: History | None = None) -> Floats:
    """Return the standard deviations after the last ping; the other argument as of `last_row`."""
    sd: Floats = history.sd[last_row(history, judged_as)]
    return sd


def improvement_pct(before: float, after: float) -> float:
    """Return ``(before - after) / before`` in percent; NaN where ``before`` is zero or either is not finite."""
    if not (np.isfinite(before) and np.isfinite(after)) or before == 0.0:
        return float("nan")
    return float(100.0 * (before - after) / before)


def _improvement_status(change_pct: float) -> ImprovementStatus:
    if not np.isfinite(change_pct):
        return ImprovementStatus.NOT_FINITE
    if abs(change_pct) < SAME_PCT:
        return ImprovementStatus.SAME
    return ImprovementStatus.IMPROVED if change_pct > 0.0 else ImprovementStatus.WORSE


def mean_over_nine(table: Sequence[ImprovementRow | ConvergenceRow], candidate: str) -> float:
    """Average a table's improvement over the nine states without the velocity errors, as the paper does.

    NaN for a candidate that lacks one of the nine.
    """
    rows = _nine(table, candidate)
    if any(row.status == ImprovementStatus.NOT_FINITE for row in rows):
        return float("nan")
    return _mean([finite(row.improvement_pct) for row in rows])


def unchanged_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the improvement of a candidate that changes nothing."""
    rows = _nine(table, candidate)
    return _mean([improvement_pct(finite(row.baseline_s), finite(row.unchanged_s)) for row in rows])


def nearest_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the improvement by the nearest approach, see `convergence.nearest_approach_s`."""
    return _mean([finite(row.nearest_approach_improvement_pct) for row in _nine(table, candidate)])


def _nine(table: Iterable[_Row], candidate: str) -> list[_Row]:
    return [row for row in table if row.filter == candidate and row.state in {state.id for state in NINE}]


def _mean(improvements_pct: list[float]) -> float:
    """Average over nine states, of which one that did not improve counts 0; NaN where one of them is missing."""
    return float(np.mean(np.nan_to_num(improvements_pct))) if len(improvements_pct) == len(NINE) else float("nan")
