"""How well a filter predicts the DVL: the log score of held-out velocities, one step ahead and in DVL outages.

The score of a ping is the logarithm of the density that the filter gave to what was measured, before it used it. It
rewards small errors and honest sigmas alike, needs no reference, and a late reference cannot turn it round. It is blind
to errors that filter and DVL share: heading, scale, position.

Source: Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", 2007.
"""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.quantities import is_beam
from insdvl_replay.evaluation.outage_test import OutageRuns, Windows

WINDOWS_S: Final = (60, 30)  # The longest of these that the dive has.


class Score(NamedTuple):
    """How two filters predict the same pings: minus the mean log score, nat per component of a measurement."""

    baseline: float
    value: float
    pings: int

    @property
    def ratio(self) -> float:
        """The ratio of the mean densities, baseline over candidate: the smaller, the better the candidate predicts."""
        difference = self.value - self.baseline
        if difference < 700.0:
            return math.exp(difference)
        if difference == difference:
            return math.inf
        return math.nan


class _Pings(NamedTuple):
    time_ns: TimeNs  # (m,)
    scores: Floats  # (m,), minus log score of a ping, nat
    dof: int


def prediction_of(
    baseline: History, candidate: History, outages: OutageRuns, settled_s: float
) -> Score | None:
    """Compare how two filters predict the DVL; None where they do not predict the same measurements.

    The mean is that of two means of equal weight, where both are known: of the pings one step ahead, after the
    baseline has settled, and of the pings inside the windows of the outage test.
    """
    parts = []
    for part in (
        _one_step(baseline, candidate, settled_s),
        _in_outages(baseline.filter, candidate.filter, outages),
    ):
        if part is not None:
            parts.append(part)
    if not parts:
        return None
    return Score(
        baseline=float(np.mean([part.baseline for part in parts])),
        value=float(np.mean([part.value for part in parts])),
        pings=sum(part.pings for part in parts),
    )


def _one_step(baseline: History, candidate: History, settled_s: float) -> Score | None:
    pings = _pings_of(baseline)
    new_pings = _pings_of(candidate)
    if not pings or pings.keys() != new_pings.keys():
        return None
    total = 0.0
    new_total = 0.0
    dof = 0
    count = 0
    from_ns = int(baseline.time_ns[0]) + round(settled_s * NS_PER_S)
    for name, before in pings.items():
        after = new_pings[name]
        _, rows, new_rows = np.intersect1d(before.time_ns, after.time_ns, return_indices=True)
        scores = before.scores[rows]
        new_scores = after.scores[new_rows]
        known = (before.time_ns[rows] >= from_ns) & np.isfinite(scores) & np.isfinite(new_scores)
        total += float(scores[known].sum())
        new_total += float(new_scores[known].sum())
        dof += before.dof * int(known.sum())
        count += int(known.sum())
    if not dof:
        return None
    return Score(total / dof, new_total / dof, count)


def _pings_of(history: History) -> Mapping[str, _Pings]:
    """Return the pings that a filter is aided by, by measurement: the velocity, or the beams."""
    return {
        met.measurement: _Pings(met.time_ns, _minus_log_score(met), met.dof)
        for met in history.innovations
        if (met.measurement == "velocity" or is_beam(met.measurement))
        and not met.is_held_out
        and len(met.time_ns)
    }


def _minus_log_score(met: Innovations) -> Floats:
    """Return minus the log score of each ping. One beyond the gate counts as much as the gate is."""
    return np.asarray(
        0.5 * (met.weight * met.nis + met.log_det + met.dof * math.log(2.0 * math.pi))
    )


def _in_outages(baseline: str, candidate: str, outages: OutageRuns) -> Score | None:
    if baseline not in outages.runs or candidate not in outages.runs:
        return None
    windows = _chosen_windows(outages)
    if windows is None:
        return None
    scores = _scores_in(windows, outages, baseline)
    new_scores = _scores_in(windows, outages, candidate)
    if scores.shape != new_scores.shape:
        return None
    known = np.isfinite(scores) & np.isfinite(new_scores)
    if not known.any():
        return None
    before = float(scores[known].mean()) / 3.0
    after = float(new_scores[known].mean()) / 3.0
    return Score(before, after, int(known.sum()))


def _chosen_windows(outages: OutageRuns) -> Windows | None:
    """Return the windows of the first length of `WINDOWS_S` that the dive has; None if it has none."""
    for window_s in WINDOWS_S:
        for windows in outages.plan.by_length:
            if windows.window_s == window_s and len(windows.first):
                return windows
    return None


def _scores_in(windows: Windows, outages: OutageRuns, name: str) -> Floats:
    """Return minus the log scores of a filter for all held-out pings of some windows, one after the other."""
    rows = np.searchsorted(outages.plan.runs[0], windows.first)
    steps = windows.last - windows.first
    scores = []
    for row, step in zip(rows, steps, strict=True):
        scores.append(outages.runs[name][row].minus_log_score[1 : step + 1])
    return np.concatenate(scores)


def crps(error: Floats, sigma: Floats) -> float:
    """Return the mean continuous ranked probability score of normal predictions, in the unit of the error.

    Parameters
    ----------
    error, sigma : arrays of the same shape
        Error and standard deviation of each component.
    """
    from scipy.special import erf

    known = np.isfinite(error) & np.isfinite(sigma) & (sigma > 0.0)
    if not known.any():
        return math.nan
    z = error[known] / sigma[known]
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    share = erf(z / math.sqrt(2.0))  # 2 Phi(z) - 1
    return float(np.mean(sigma[known] * (z * share + 2.0 * density - 1.0 / math.sqrt(math.pi))))
