"""Predicted improvement and convergence of each candidate by covariance, and measured convergence by errors.

Predicted improvement and convergence follow from P alone. Any further measurement shrinks P: they say how certain a
filter is, never how right. P is read where a filter has just used a ping, since between pings it grows; the end of the
dive is the last ping. Measured convergence is that of the rms of true errors over random starts; at
each time it is over the last tenth of what has passed, so that ten seconds are seen as finely as an hour, and the end
of the dive is its last tenth.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Mask, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import CONVERGED
from insdvl_replay.core.states import DV, NINE, STATES, State
from insdvl_replay.core.tables import ConvergenceRow, ImprovementRow, finite
from insdvl_replay.core.words import ConvergenceStatus, ImprovementStatus
from insdvl_replay.evaluation.reference_errors import DrawnErrors, improvement_pct, squared_errors

LAST: Final = 0.1  # An rms is over this last share of the elapsed time.
STEP: Final = 0.02  # Relative step between the times of an rms.
SAME_PCT: Final = 0.05  # A smaller change of a standard deviation is ``same``: with one digit it would read 0.0 %.
BEYOND: Final = 1e200  # Replaces larger or not finite squares; no filter recovers from there.
NINE_NAMES: Final = frozenset(state.id for state in NINE)
FEWEST_RUNS: Final = 3  # From the own start of the dive, and from two that are drawn.


# --- Measured convergence.


class MeasuredConvergence(NamedTuple):
    """Times from which two filters stay as good as the baseline at the end."""

    target: float  # rms of the baseline over the last tenth of the time, SI unit
    baseline_s: float  # from the start; NaN unless reached
    candidate_s: float
    status: ConvergenceStatus  # of the baseline if its errors do not fall, else of the candidate


_NOT_MEASURED: Final = MeasuredConvergence(
    math.nan, math.nan, math.nan, ConvergenceStatus.NOT_MEASURED
)


def measured_convergences(
    baseline: DrawnErrors, candidate: DrawnErrors
) -> dict[str, MeasuredConvergence]:
    """Compare the convergence of two filters from the same starts, by quantity of `reference_errors.squared_errors`.

    Empty where fewer than two starts were drawn. The dive's own start
    is left out, since it lacks the errors that are to fall; so is the position, of which no measurement tells.
    """
    if min(len(baseline.error), len(candidate.error)) < FEWEST_RUNS:
        return {}
    before = squared_errors(baseline)
    after = squared_errors(candidate)
    found = {}
    for quantity in before:
        if quantity not in after or quantity == "position_h":
            continue
        baseline_sq = before[quantity][1:]
        candidate_sq = after[quantity][1:]
        if _known_times(baseline_sq, candidate_sq).any():
            found[quantity] = measured_convergence(baseline_sq, candidate_sq, baseline.time_s)
    return found


def _known_times(*squares: Floats) -> Mask:
    """Find the times, shape (k,), at which each of some errors has a number from some start; each is (s, k)."""
    known: Mask = np.all([np.isfinite(square).any(axis=0) for square in squares], axis=0)
    return known


def measured_convergence(
    baseline_sq: Floats,  # (s, k), squared errors from s starts; times at which no start has a number are left out
    candidate_sq: Floats,  # (s, k), from the same starts
    time_s: Floats,  # (k,), after the start, increasing
) -> MeasuredConvergence:
    """Return the times from which two filters stay as good as the baseline at the end.

    The rms of s normal draws has the standard error ``1 / sqrt(2 s)`` of itself: by so much it may exceed the target. A
    filter that is there at once but not for good is as good at the start, and has nothing to bring down.
    """
    known = _known_times(baseline_sq, candidate_sq)
    at_s, before, after = over_last_part(
        time_s[known], baseline_sq[:, known], candidate_sq[:, known]
    )
    baseline_mean_sq = before.mean(axis=0)
    candidate_mean_sq = after.mean(axis=0)
    target = np.sqrt(baseline_mean_sq[-1])
    limit_sq = float(limit_of(target, len(before))) ** 2
    baseline_s = _reached_s(at_s, baseline_mean_sq, limit_sq)
    candidate_s = _reached_s(at_s, candidate_mean_sq, limit_sq)
    status = _status(baseline_s)
    if status == ConvergenceStatus.REACHED:
        status = _status(candidate_s)
    return MeasuredConvergence(
        float(target), _if_reached(baseline_s), _if_reached(candidate_s), status
    )


def _if_reached(reached_s: float) -> float:
    """Return the time of `_reached_s`; NaN at the start and for never."""
    if 0.0 < reached_s < math.inf:
        return reached_s
    return math.nan


def _reached_s(at_s: Floats, mean_sq: Floats, limit_sq: float) -> float:
    """Return when a mean square stays below the limit: 0 at the start, infinite never; on a line between two times."""
    above = mean_sq > limit_sq
    if above[-1]:
        return math.inf
    if not above[0]:
        return 0.0
    last = len(at_s) - 1 - int(np.argmax(above[::-1]))
    share = (mean_sq[last] - limit_sq) / (mean_sq[last] - mean_sq[last + 1])
    return float(at_s[last] + share * (at_s[last + 1] - at_s[last]))


def over_last_part(time_s: Floats, *squares: Floats) -> tuple[Floats, ...]:
    """Return times with growing steps, shape (g,), and means over the last part of the elapsed time.

    The times, shape (k,), increase after the start. The means are of each of the squares: (s, k) becomes (s, g).
    """
    steps = np.arange(np.log(time_s[0] / time_s[-1]) // np.log(1.0 - STEP), -1.0, -1.0)
    at_s = np.maximum(time_s[-1] * (1.0 - STEP) ** steps, time_s[0])
    last = np.searchsorted(time_s, at_s, side="right")
    first = np.minimum(np.searchsorted(time_s, (1.0 - LAST) * at_s, side="right"), last - 1)
    # Not by differences of running sums: what errors begin with may be a billion times what they end with.
    ends = np.column_stack([first, last]).ravel()
    sums = (
        np.add.reduceat(np.pad(np.fmin(square, BEYOND), ((0, 0), (0, 1))), ends, axis=1)[:, ::2]
        for square in squares
    )
    return at_s, *(total / (last - first) for total in sums)


def limit_of(rms: Floats, starts: int) -> Floats:
    """Return the limit up to which a filter is as good as an rms over some starts: one standard error more."""
    return rms * (1.0 + 1.0 / math.sqrt(2.0 * starts))


def _status(reached_s: float) -> ConvergenceStatus:
    if reached_s == 0.0:
        return ConvergenceStatus.AT_START
    if np.isfinite(reached_s):
        return ConvergenceStatus.REACHED
    return ConvergenceStatus.NEVER


class ConvergenceCurves(NamedTuple):
    """Errors of all filters from random starts in one quantity, at g times with growing steps."""

    time_s: Floats  # (g,), after the start
    # (g,) by filter, SI units: true errors over the starts, over the last part of the time
    rms: Mapping[str, Floats]
    predicted: Mapping[str, Floats]  # (g,) by filter: what it predicts of them from its own start
    limit: float  # below which a filter has converged


def convergence_curves(drawn: Sequence[DrawnErrors]) -> dict[str, ConvergenceCurves]:
    """Return the rms of each filter's true errors over its random starts, without the dive's own, by quantity."""
    drawn = [errors for errors in drawn if len(errors.error) >= FEWEST_RUNS]
    if not drawn:
        return {}
    true_squares = {errors.filter: squared_errors(errors) for errors in drawn}
    predicted_squares = {errors.filter: _predicted_squares(errors) for errors in drawn}
    curves = {}
    for quantity, name in CONVERGED.items():
        if not all(name in squares for squares in true_squares.values()):
            continue
        true_sq = {one: squares[name][1:] for one, squares in true_squares.items()}
        known = _known_times(*true_sq.values())
        if not known.any():
            continue
        unknown = np.full((1, len(known)), np.nan)
        predicted_sq = {one: own.get(name, unknown) for one, own in predicted_squares.items()}
        time_s = drawn[0].time_s[known]
        at_s, rms_of = _rms_over_last_part(time_s, known, true_sq)
        _, expected_of = _rms_over_last_part(time_s, known, predicted_sq)
        first = drawn[0].filter
        limit = float(limit_of(rms_of[first][-1], len(true_sq[first])))
        curves[quantity] = ConvergenceCurves(at_s, rms_of, expected_of, limit)
    return curves


def _predicted_squares(errors: DrawnErrors) -> dict[str, Floats]:
    """Return the squares of a filter's sigma, shape (1, k), by quantity of `reference_errors.squared_errors`."""
    as_errors = replace(errors, velocity_error_n=errors.sd[None, :, DV], error=errors.sd[None])
    return squared_errors(as_errors)


def _rms_over_last_part(
    time_s: Floats,  # the known times
    known: Mask,  # (k,)
    squares: Mapping[str, Floats],  # (s, k) by filter
) -> tuple[Floats, dict[str, Floats]]:
    """Return times with growing steps, shape (g,), and each filter's rms over its starts and the last part, (g,)."""
    at_s, *means = over_last_part(time_s, *(square[:, known] for square in squares.values()))
    rms = [np.sqrt(mean.mean(axis=0)) for mean in means]
    return at_s, dict(zip(squares, rms, strict=True))


# --- The tables: predicted improvement, and predicted convergence with the measured one next to it.


def improvement_table(log: str, histories: tuple[History, ...]) -> list[ImprovementRow]:
    """Compare the standard deviations at the end of the dive, for the states that each candidate has."""
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        for state in predicted_states(candidate):
            baseline_sd = baseline.sd[last_row(baseline, candidate), state.index]
            sd = candidate.sd[last_row(candidate, candidate), state.index]
            before = float(baseline_sd) / state.factor
            after = float(sd) / state.factor
            change_pct = improvement_pct(before, after)
            rows.append(
                ImprovementRow(
                    log=log,
                    filter=candidate.filter,
                    state=state.id,
                    unit=state.unit,
                    baseline_sd=before,
                    sd=after,
                    improvement_pct=change_pct,
                    status=_improvement_status(change_pct),
                )
            )
    return rows


def _improvement_status(change_pct: float) -> ImprovementStatus:
    if not np.isfinite(change_pct):
        return ImprovementStatus.NOT_FINITE
    if abs(change_pct) < SAME_PCT:
        return ImprovementStatus.SAME
    if change_pct > 0.0:
        return ImprovementStatus.IMPROVED
    return ImprovementStatus.WORSE


def predicted_states(history: History) -> list[State]:
    """List the states, of the twelve, for which a history has standard deviations."""
    if not history.updated.any():
        return []
    return [state for state in STATES if history.predicted[state.index]]


def last_row(history: History, candidate: History) -> int:
    """Return the row of the last ping; with a partial candidate, the last row that it covers."""
    pings = history.updated
    shared = history.updated & candidate.updated
    if candidate.is_partial and shared.any():
        pings = shared
    return int(np.flatnonzero(pings)[-1])


def mean_over_nine(table: Sequence[ImprovementRow | ConvergenceRow], candidate: str) -> float:
    """Average a table's improvement over the nine states without the velocity errors, as the paper does.

    NaN for a candidate that lacks one of the nine. A state that did not improve counts 0.
    """
    rows = [row for row in table if row.filter == candidate and row.state in NINE_NAMES]
    if any(row.status == ImprovementStatus.NOT_FINITE for row in rows):
        return float("nan")
    return _mean(finite(row.improvement_pct) for row in rows)


def unchanged_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the convergence improvement of a candidate without any change."""
    rows = [row for row in table if row.filter == candidate and row.state in NINE_NAMES]
    return _mean(improvement_pct(finite(row.baseline_s), finite(row.unchanged_s)) for row in rows)


def nearest_over_nine(table: Sequence[ConvergenceRow], candidate: str) -> float:
    """Average over the same states the improvement by the nearest approach, see `convergence.nearest_approach_s`."""
    rows = [row for row in table if row.filter == candidate and row.state in NINE_NAMES]
    return _mean(finite(row.nearest_approach_improvement_pct) for row in rows)


def _mean(improvements_pct: Iterable[float]) -> float:
    found = np.nan_to_num(list(improvements_pct))
    if len(found) == len(NINE):
        return float(np.mean(found))
    return float("nan")


def convergence_table(
    log: str,
    histories: tuple[History, ...],
    measured: Mapping[str, Mapping[str, MeasuredConvergence]],
) -> list[ConvergenceRow]:
    """Return when the sigma of each candidate stays below the baseline's final one, and when it is nearest to it.

    Times count from the start; the baseline's time is its last ping.
    """
    baseline, *candidates = histories
    rows = []
    for candidate in candidates:
        of_states = measured.get(candidate.filter, {})
        for state in predicted_states(candidate):
            found = of_states.get(state.id, _NOT_MEASURED)
            rows.append(_convergence_row(log, baseline, candidate, state, found))
    return rows


def _convergence_row(
    log: str,
    baseline: History,
    candidate: History,
    state: State,
    measured: MeasuredConvergence,
) -> ConvergenceRow:
    """Return when the sigma of a candidate in one state is as small as the baseline's final one."""
    last = last_row(baseline, candidate)
    baseline_time_s = seconds(baseline.time_ns, baseline.time_ns[0])[: last + 1]
    baseline_s = float(baseline_time_s[last])
    target = float(baseline.sd[last, state.index])
    seen = np.flatnonzero(baseline.updated[: last + 1] | (baseline_time_s == 0.0))
    unchanged_s, _ = time_to_stay_below(
        baseline_time_s[seen], baseline.sd[seen, state.index], target
    )

    pings = candidate.updated | (candidate.time_ns == candidate.time_ns[0])
    if candidate.is_partial:
        pings &= np.isfinite(candidate.sd[:, state.index])
    time_s = seconds(candidate.time_ns[pings], candidate.time_ns[0])
    sd = candidate.sd[pings, state.index]
    reached_s, status = time_to_stay_below(time_s, sd, target)
    faster_pct = math.nan
    if status == ConvergenceStatus.REACHED:
        faster_pct = improvement_pct(baseline_s, reached_s)
    nearest_s = nearest_approach_s(time_s, sd, target)
    return ConvergenceRow(
        log=log,
        filter=candidate.filter,
        state=state.id,
        unit=state.unit,
        target_sd=target / state.factor,
        baseline_s=baseline_s,
        reached_s=reached_s,
        improvement_pct=faster_pct,
        status=status,
        measured_target=measured.target / state.factor,
        measured_baseline_s=measured.baseline_s,
        measured_s=measured.candidate_s,
        measured_status=measured.status,
        unchanged_s=unchanged_s,
        nearest_approach_s=nearest_s,
        nearest_approach_improvement_pct=improvement_pct(baseline_s, nearest_s),
    )


def nearest_approach_s(time_s: Floats, sd: Floats, target: float) -> float:
    """Return the first time at which a standard deviation is nearest to a target; NaN where no distance is finite.

    This is the convergence time of Levy and Klein. The standard deviation may grow again after it.
    """
    distance = np.abs(sd - target)
    if np.isfinite(distance).any():
        return float(time_s[np.nanargmin(distance)])
    return float("nan")


def time_to_stay_below(
    time_s: Floats, sd: Floats, target: float
) -> tuple[float, ConvergenceStatus]:
    """Find the first time after which a standard deviation stays at or below a target, between samples on a line.

    NaN unless reached: ``at_start`` is never above the target; ``never`` is above it, or not finite, at the end.
    """
    above = np.flatnonzero(~(sd <= target))
    if len(above) == 0:
        return float("nan"), ConvergenceStatus.AT_START
    last = int(above[-1])
    if last == len(sd) - 1:
        return float("nan"), ConvergenceStatus.NEVER
    drop = sd[last] - sd[last + 1]
    fraction = 1.0
    if np.isfinite(drop):
        fraction = (sd[last] - target) / drop
    reached_s = float(time_s[last] + fraction * (time_s[last + 1] - time_s[last]))
    return reached_s, ConvergenceStatus.REACHED
