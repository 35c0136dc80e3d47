"""When the true errors of runs from drawn starts have fallen to what the baseline's are at the end.

What a filter believes of its convergence, see `believed`, follows from P alone. This is measured: the rms of true
errors over the starts, and at each time over the last tenth of what has passed, so that ten seconds are seen as finely
as an hour, and the end of the dive is its last tenth.
"""

import math
from typing import Final, NamedTuple, TypeVar

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.words import ConvergenceStatus
from insdvl_replay.evaluation.drawn_errors import DrawnErrors, squared_errors
from insdvl_replay.evaluation.paired_statistics import MARGIN

LAST: Final = 0.1
"""Share of the time that has passed of which an rms is."""
STEP: Final = 0.02
"""Each time at which the rms is looked at is so much of itself before the next."""
RESAMPLES: Final = 1000
SEED: Final = 1
V = TypeVar("V", float, Floats)
BEYOND: Final = 1e200
"""Stands for a square that is larger, or not finite: no filter comes back from there."""


class MeasuredConvergence(NamedTuple):
    """When two filters became, and stayed, as good as the baseline is at the end, and the ratio of the two times.

    Attributes
    ----------
    target : float
        Rms of the baseline over the last tenth of the time, SI unit.
    baseline_s, candidate_s : float
        From the start; NaN unless reached.
    status : ConvergenceStatus
        ``reached``, ``at_start`` or ``never``; of the baseline where that does not fall, else of the candidate.
    ratio : float
        Candidate over baseline, below 1 is sooner; NaN unless both are reached.
    low, high, low90, high90 : float
        Ends of the middle 95 % and 90 % of the ratios if the starts are drawn anew from those that were run, in which
        a time at the start counts as the first one, and never as infinite: where the candidate is never there, they
        say how surely. NaN where the baseline does not fall.
    p : float
        The share of those ratios that are not beyond the margin on the side of the ratio.
    starts : int
        How many.
    """

    target: float
    baseline_s: float
    candidate_s: float
    status: ConvergenceStatus
    ratio: float
    low: float
    high: float
    low90: float
    high90: float
    p: float
    starts: int


def measured_convergences(baseline: DrawnErrors, candidate: DrawnErrors) -> dict[str, MeasuredConvergence]:
    """Compare the convergence of two filters in all that `squared_errors` has and that measurements bring down.

    The dive's own start is left out, since it lacks the errors that are to fall. The position is, too: no measurement
    tells of it.

    Parameters
    ----------
    baseline, candidate : DrawnErrors
        Of the same starts.

    Returns
    -------
    dict of str to MeasuredConvergence
        By quantity; empty where fewer than two starts were drawn, as of a solution that was read.
    """
    if min(len(baseline.error), len(candidate.error)) < 3:
        return {}
    before, after = squared_errors(baseline), squared_errors(candidate)
    return {
        quantity: measured_convergence(before[quantity][1:], after[quantity][1:], baseline.time_s)
        for quantity in before
        if quantity in after and quantity != "position_h" and _is_known(before[quantity][1:], after[quantity][1:])
    }


def _is_known(baseline_sq: Floats, candidate_sq: Floats) -> bool:
    """Return whether there is a time at which both have a number from one of the starts."""
    return bool((np.isfinite(baseline_sq).any(axis=0) & np.isfinite(candidate_sq).any(axis=0)).any())


def measured_convergence(baseline_sq: Floats, candidate_sq: Floats, time_s: Floats) -> MeasuredConvergence:
    """Find from when on two filters are as good as the baseline is at the end.

    The rms of s normal draws has the standard error ``1 / sqrt(2 s)`` of itself: by so much it may exceed the target.
    A filter that is there at once but not for good is as good at the start, and has nothing to bring down: a heading
    that drifts, or a level that a straight dive does not show.

    Parameters
    ----------
    baseline_sq, candidate_sq : ndarray, shape (s, k)
        Squared errors from the same s starts. Times at which no start has a number are left out.
    time_s : ndarray, shape (k,)
        After the start, increasing.
    """
    known = np.isfinite(baseline_sq).any(axis=0) & np.isfinite(candidate_sq).any(axis=0)
    at_s, before, after = over_last_part(time_s[known], baseline_sq[:, known], candidate_sq[:, known])
    starts = len(before)
    (baseline_s,), (candidate_s,) = _reached_s(at_s, np.full((1, starts), 1.0 / starts), before, after)
    bounds, p, falls = np.full(4, np.nan), math.nan, _status(baseline_s) == ConvergenceStatus.REACHED
    if falls:
        again = np.random.default_rng(SEED).multinomial(starts, np.full(starts, 1.0 / starts), RESAMPLES) / starts
        baselines_s, candidates_s = _reached_s(at_s, again, before, after)
        ratios = np.maximum(candidates_s, at_s[0]) / np.maximum(baselines_s, at_s[0])
        # None lies between two of them: some may be infinite.
        bounds = np.quantile(ratios, [0.025, 0.975, 0.05, 0.95], method="inverted_cdf")
        is_sooner = candidate_s < baseline_s
        p = float(np.mean(ratios * (1.0 + MARGIN) > 1.0 if is_sooner else ratios < 1.0 + MARGIN))
    target, status = float(np.sqrt(before[:, -1].mean())), _status(candidate_s if falls else baseline_s)
    baseline_s, candidate_s = _nan_unless_reached(baseline_s), _nan_unless_reached(candidate_s)
    low, high, low90, high90 = (float(bound) for bound in bounds)
    ratio = candidate_s / baseline_s
    return MeasuredConvergence(target, baseline_s, candidate_s, status, ratio, low, high, low90, high90, p, starts)


def over_last_part(time_s: Floats, *squares: Floats) -> tuple[Floats, ...]:
    """Take means over the last part of what has passed, at times that lie ever further apart.

    Parameters
    ----------
    time_s : ndarray, shape (k,)
        After the start, increasing.
    squares : ndarray, shape (s, k)

    Returns
    -------
    ndarray, shape (g,)
        The times.
    ndarray, shape (s, g)
        Of each of the squares, the means.
    """
    steps = np.arange(np.log(time_s[0] / time_s[-1]) // np.log(1.0 - STEP), -1.0, -1.0)
    at_s = np.maximum(time_s[-1] * (1.0 - STEP) ** steps, time_s[0])
    last = np.searchsorted(time_s, at_s, side="right")
    first = np.minimum(np.searchsorted(time_s, (1.0 - LAST) * at_s, side="right"), last - 1)
    # Not by differences of running sums: what errors begin with may be a billion times what they end with.
    ends = np.column_stack([first, last]).ravel()
    sums = (np.add.reduceat(np.pad(_bounded(square), ((0, 0), (0, 1))), ends, axis=1)[:, ::2] for square in squares)
    return at_s, *(total / (last - first) for total in sums)


def _bounded(squares: Floats) -> Floats:
    return np.fmin(squares, BEYOND)


def limit_of(rms: V, starts: int) -> V:
    """Return up to where a filter is as good as an rms over so many starts, which has a standard error of its own."""
    return rms * (1.0 + 1.0 / math.sqrt(2.0 * starts))


def _reached_s(at_s: Floats, weights: Floats, before: Floats, after: Floats) -> tuple[Floats, Floats]:
    """Return when both filters reach what the baseline has at the end: 0 at the start, infinite never.

    Parameters
    ----------
    at_s : ndarray, shape (g,)
    weights : ndarray, shape (r, s)
        Of the starts in each of r means.
    before, after : ndarray, shape (s, g)
        Mean squares of the baseline and of the candidate.

    Returns
    -------
    tuple of ndarray, shape (r,)
    """
    baseline_sq = weights @ before
    limit_sq = limit_of(np.sqrt(baseline_sq[:, -1]), len(before)) ** 2
    return _stays_below_s(at_s, baseline_sq, limit_sq), _stays_below_s(at_s, weights @ after, limit_sq)


def _stays_below_s(at_s: Floats, mean_sq: Floats, limit_sq: Floats) -> Floats:
    """Find from when on mean squares, shape (r, g), stay at or below their limits, between two times on a line."""
    rows, above = np.arange(len(mean_sq)), mean_sq > limit_sq[:, None]
    last = len(at_s) - 1 - np.argmax(above[:, ::-1], axis=1)
    following = np.minimum(last + 1, len(at_s) - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (mean_sq[rows, last] - limit_sq) / (mean_sq[rows, last] - mean_sq[rows, following])
        reached_s = at_s[last] + share * (at_s[following] - at_s[last])
    return np.where(above[:, -1], np.inf, np.where(above[:, 0], reached_s, 0.0))


def _status(reached_s: float) -> ConvergenceStatus:
    if reached_s == 0.0:
        return ConvergenceStatus.AT_START
    return ConvergenceStatus.REACHED if np.isfinite(reached_s) else ConvergenceStatus.NEVER


def _nan_unless_reached(reached_s: float) -> float:
    return float(reached_s) if _status(reached_s) == ConvergenceStatus.REACHED else float("nan")
