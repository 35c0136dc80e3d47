"""What a filter believes of itself: improvement and convergence time from the square roots of P's diagonal.

Any further measurement shrinks P. These tables say how sure a filter is, never how right; `reference` and `consistency`
do. Both are read where a filter has just used a ping: between pings the uncertainty grows, so that a look at any other
time would measure the time since the last ping. The end of the dive is its last ping.
"""

import numpy as np
import pandas as pd

from insdvl_replay.core.columns import Floats, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import NINE, STATES

SAME_PCT = 0.05
"""A smaller change of a standard deviation is called ``same``; shown with one digit it would read 0.0 %."""


def improvement_table(log: str, histories: tuple[History, ...]) -> pd.DataFrame:
    """Compare the standard deviations at the end of the dive, state by state.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        The first is the baseline.

    Returns
    -------
    DataFrame
        Columns log, filter, state, unit, baseline_sd, sd, improvement_pct, status (``improved``, ``same``, ``worse``,
        or ``not finite``); 12 rows for each candidate.
    """
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        for state in STATES:
            before, after = (_final_sd(history)[state.index] / state.factor for history in (baseline, candidate))
            change_pct = improvement_pct(before, after)
            status = _improvement_status(change_pct)
            rows.append((log, candidate.filter, state.id, state.unit, before, after, change_pct, status))
    return pd.DataFrame(
        rows, columns=["log", "filter", "state", "unit", "baseline_sd", "sd", "improvement_pct", "status"]
    )


def _final_sd(history: History) -> Floats:
    """Give the standard deviations after the last ping."""
    sd: Floats = history.sd[np.flatnonzero(history.updated)[-1]]
    return sd


def improvement_pct(before: float, after: float) -> float:
    """Give ``(before - after) / before`` in percent; NaN where ``before`` is zero or either is not finite."""
    if not (np.isfinite(before) and np.isfinite(after)) or before == 0.0:
        return float("nan")
    return float(100.0 * (before - after) / before)


def _improvement_status(change_pct: float) -> str:
    if not np.isfinite(change_pct):
        return "not finite"
    if abs(change_pct) < SAME_PCT:
        return "same"
    return "improved" if change_pct > 0.0 else "worse"


def convergence_table(log: str, histories: tuple[History, ...]) -> pd.DataFrame:
    """Say when each candidate became, and stayed, as sure as the baseline is at the end.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        The first is the baseline.

    Returns
    -------
    DataFrame
        Columns log, filter, state, unit, target_sd, baseline_s, reached_s, improvement_pct, status (``reached``,
        ``at_start``, ``never``); 12 rows for each candidate. Times are seconds from the start, the
        baseline's that of the last ping.
    """
    baseline, *candidates = histories
    baseline_s = float(seconds(baseline.time_ns[baseline.updated], baseline.time_ns[0])[-1])
    rows = []
    for candidate in candidates:
        read = candidate.updated | (candidate.time_ns == candidate.time_ns[0])
        time_s = seconds(candidate.time_ns[read], candidate.time_ns[0])
        for state in STATES:
            target = float(_final_sd(baseline)[state.index])
            reached_s, status = time_to_stay_below(time_s, candidate.sd[read, state.index], target)
            faster_pct = improvement_pct(baseline_s, reached_s) if status == "reached" else float("nan")
            shown = target / state.factor
            rows.append((log, candidate.filter, state.id, state.unit, shown, baseline_s, reached_s, faster_pct, status))
    names = ["log", "filter", "state", "unit", "target_sd", "baseline_s", "reached_s", "improvement_pct", "status"]
    return pd.DataFrame(rows, columns=names)


def time_to_stay_below(time_s: Floats, sd: Floats, target: float) -> tuple[float, str]:
    """Find the first time after which a standard deviation stays at or below a target.

    Parameters
    ----------
    time_s, sd : ndarray, shape (k,)
    target : float
        In the unit of ``sd``.

    Returns
    -------
    float
        Interpolated between the samples, s; NaN unless reached.
    str
        ``reached``, ``at_start`` (never above the target) or ``never`` (above it, or not finite, at the end).
    """
    above = np.flatnonzero(~(sd <= target))
    if len(above) == 0:
        return float("nan"), "at_start"
    last = int(above[-1])
    if last == len(sd) - 1:
        return float("nan"), "never"
    drop = sd[last] - sd[last + 1]
    fraction = (sd[last] - target) / drop if np.isfinite(drop) else 1.0
    return float(time_s[last] + fraction * (time_s[last + 1] - time_s[last])), "reached"


def mean_over_nine(table: pd.DataFrame, filter_name: str) -> float:
    """Average a table's improvement over the nine states without the velocity errors, as the paper does.

    Parameters
    ----------
    table : DataFrame
        From `improvement_table` or `convergence_table`.
    filter_name : str
        A candidate.

    Returns
    -------
    float
        Percent. No improvement to speak of (``at_start``, ``never``) counts as 0; a state that became worse counts as
        such. NaN if a standard deviation is not finite.
    """
    nine = {state.id for state in NINE}
    rows = table[(table["filter"] == filter_name) & table["state"].isin(nine)]
    if (rows["status"] == "not finite").any():
        return float("nan")
    return float(rows["improvement_pct"].fillna(0.0).mean())
