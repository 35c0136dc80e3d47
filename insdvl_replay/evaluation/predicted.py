"""Predicted improvement: what the square roots of P's diagonal say of each candidate next to the baseline.

Any further measurement shrinks P. This table says how certain a filter is, never how right; `errors` and `consistency`
do. It is read where a filter has just used a ping, since between pings P grows; the end of the dive is the last ping.
"""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from insdvl_replay.core.history import History
from insdvl_replay.core.states import NINE, STATES, State
from insdvl_replay.core.tables import ConvergenceRow, ImprovementRow, finite
from insdvl_replay.core.words import ImprovementStatus

SAME_PCT: Final = 0.05
"""A smaller change of a standard deviation is called ``same``; shown with one digit it would read 0.0 %."""
_NINE: Final = frozenset(state.id for state in NINE)


def improvement_table(log: str, histories: tuple[History, ...]) -> list[ImprovementRow]:
    """Compare the standard deviations at the end of the dive, for the states that each candidate has one of."""
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        for state in predicted_states(candidate):
            ends = baseline.sd[last_row(baseline, candidate)], candidate.sd[last_row(candidate, candidate)]
            before, after = (float(sd[state.index]) / state.factor for sd in ends)
            change_pct = improvement_pct(before, after)
            status = ImprovementStatus.IMPROVED if change_pct > 0.0 else ImprovementStatus.WORSE
            if not np.isfinite(change_pct):
                status = ImprovementStatus.NOT_FINITE
            elif abs(change_pct) < SAME_PCT:
                status = ImprovementStatus.SAME
            rows.append(ImprovementRow(log, candidate.filter, state.id, state.unit, before, after, change_pct, status))
    return rows


def predicted_states(history: History) -> list[State]:
    """List those of the twelve states that a history has standard deviations of."""
    predicted = history.believed if history.updated.any() else np.zeros(len(history.states), np.bool_)
    return [state for state in STATES if predicted[state.index]]


def last_row(history: History, candidate: History) -> int:
    """Return the row of the last ping; next to a candidate that is partial, the last that it speaks of, too."""
    return int(np.flatnonzero(history.updated & candidate.updated if candidate.is_partial else history.updated)[-1])


def improvement_pct(before: float, after: float) -> float:
    """Return ``(before - after) / before`` in percent; NaN where ``before`` is zero or either is not finite."""
    if not (np.isfinite(before) and np.isfinite(after)) or before == 0.0:
        return float("nan")
    return float(100.0 * (before - after) / before)


def mean_over_nine(table: Sequence[ImprovementRow | ConvergenceRow], candidate: str) -> float:
    """Average a table's improvement over the nine states without the velocity errors, as the paper does.

    NaN for a candidate that lacks one of the nine. A state that did not improve counts 0.
    """
    rows = [row for row in table if row.filter == candidate and row.state in _NINE]
    if any(row.status == ImprovementStatus.NOT_FINITE for row in rows):
        return float("nan")
    return _mean(finite(row.improvement_pct) for row in rows)


def unchanged_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the improvement of a candidate that changes nothing."""
    rows = [row for row in table if row.filter == candidate and row.state in _NINE]
    return _mean(improvement_pct(finite(row.baseline_s), finite(row.unchanged_s)) for row in rows)


def nearest_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the improvement by the nearest approach, see `convergence.nearest_approach_s`."""
    rows = [row for row in table if row.filter == candidate and row.state in _NINE]
    return _mean(finite(row.nearest_approach_improvement_pct) for row in rows)


def _mean(improvements_pct: Iterable[float]) -> float:
    found = np.nan_to_num(list(improvements_pct))
    return float(np.mean(found)) if len(found) == len(NINE) else float("nan")
