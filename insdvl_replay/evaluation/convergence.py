"""When each candidate became, and stayed, as sure as the baseline is at the end; and, where that is known, as right."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.tables import ConvergenceRow
from insdvl_replay.core.words import ConvergenceStatus
from insdvl_replay.evaluation.believed import believed_states, improvement_pct, last_row
from insdvl_replay.evaluation.measured_convergence import MeasuredConvergence, measured_convergences

NOT_MEASURED: Final[Mapping[str, Mapping[str, MeasuredConvergence]]] = MappingProxyType({})


def convergence_table(
    log: str, histories: tuple[History, ...], measured: Mapping[str, Mapping[str, MeasuredConvergence]] = NOT_MEASURED
) -> list[ConvergenceRow]:
    """State when each candidate became, and stayed, as sure as the baseline is at the end, and when it came nearest.

    A recorded solution has rows for those of the 12 states whose standard deviations it gives. Times count from the
    start; the baseline's time is its last ping.
    """
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        pings = candidate.updated | (candidate.time_ns == candidate.time_ns[0])
        for state in believed_states(candidate):
            last = last_row(baseline, candidate)
            target, baseline_s = float(baseline.sd[last, state.index]), _since_start_s(baseline, last)
            told = pings & np.isfinite(candidate.sd[:, state.index]) if candidate.is_read else pings
            time_s = seconds(candidate.time_ns[told], candidate.time_ns[0])
            reached_s, status = time_to_stay_below(time_s, candidate.sd[told, state.index], target)
            faster_pct = improvement_pct(baseline_s, reached_s) if status == ConvergenceStatus.REACHED else float("nan")
            named = log, candidate.filter, state.id, state.unit
            predicted = target / state.factor, baseline_s, reached_s, faster_pct
            found = _measured(measured.get(candidate.filter, {}).get(state.id), state.factor)
            unchanged_s = _stays_s(baseline, last, state.index)
            nearest_s = nearest_approach_s(time_s, candidate.sd[told, state.index], target)
            nearest = nearest_s, improvement_pct(baseline_s, nearest_s)
            rows.append(ConvergenceRow(*named, *predicted, status, *found, unchanged_s, *nearest))
    return rows


def _stays_s(baseline: History, last: int, state: int) -> float:
    """Return when the baseline came to stay as sure as it is at the end; NaN where it always was."""
    pings = np.flatnonzero(baseline.updated[: last + 1] | (baseline.time_ns[: last + 1] == baseline.time_ns[0]))
    time_s = seconds(baseline.time_ns[pings], baseline.time_ns[0])
    return time_to_stay_below(time_s, baseline.sd[pings, state], float(baseline.sd[last, state]))[0]


def _since_start_s(history: History, row: int) -> float:
    return float(seconds(history.time_ns[row : row + 1], history.time_ns[0])[0])


def _measured(found: MeasuredConvergence | None, factor: float) -> tuple[float, float, float, str]:
    if found is None:
        return float("nan"), float("nan"), float("nan"), ConvergenceStatus.NOT_MEASURED
    return found.target / factor, found.baseline_s, found.candidate_s, found.status


def nearest_approach_s(time_s: Floats, sd: Floats, target: float) -> float:
    """Return the first time at which a standard deviation is nearest to a target; NaN where no distance is finite.

    This is the convergence time of Levy and Klein. It is no arrival: the standard deviation may turn back there.
    """
    distance = np.abs(sd - target)
    return float(time_s[np.nanargmin(distance)]) if np.isfinite(distance).any() else float("nan")


def time_to_stay_below(time_s: Floats, sd: Floats, target: float) -> tuple[float, ConvergenceStatus]:
    """Find the first time after which a standard deviation stays at or below a target.

    The time is interpolated between the samples, and NaN unless reached. ``at_start`` is never above the target;
    ``never`` is above it, or not finite, at the end.
    """
    above = np.flatnonzero(~(sd <= target))
    if len(above) == 0:
        return float("nan"), ConvergenceStatus.AT_START
    last = int(above[-1])
    if last == len(sd) - 1:
        return float("nan"), ConvergenceStatus.NEVER
    drop = sd[last] - sd[last + 1]
    fraction = (sd[last] - target) / drop if np.isfinite(drop) else 1.0
    return float(time_s[last] + fraction * (time_s[last + 1] - time_s[last])), ConvergenceStatus.REACHED


__all__ = ["NOT_MEASURED", "convergence_table", "measured_convergences", "nearest_approach_s", "time_to_stay_below"]
