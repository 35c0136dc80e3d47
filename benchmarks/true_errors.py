"""What is true of two filters in a world: their errors over all its dives, which no filter and no judge knows.

One dive holds few independent errors, and of what is drawn once a dive, as a bias is, a single one. An ensemble holds
many, so that the mean of the log ratio has a narrow interval: better, same and worse are facts.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.history import History
from insdvl_replay.evaluation.reference_errors import ReferenceErrors

SEGMENT_S: Final = 60.0


class MeanSquares(NamedTuple):
    """Mean squared true errors of one filter in one dive; all but that of the depth are horizontal."""

    position_m2: float
    """Over the whole dive."""
    drift_m2: float
    """In a segment."""
    velocity_m2ps2: float
    end_m2: float
    depth_m2: float


class TrueRatio(NamedTuple):
    """Geometric mean over dives of the ratio of two filters' errors, its interval, and how the dives scatter."""

    value: float
    low: float
    """95 %, by the scatter over the dives of the ensemble."""
    high: float
    scatter: float
    """Standard deviation of the log ratio of a dive."""

    def __str__(self) -> str:
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}], s {self.scatter:.2f}"


class Soundness(NamedTuple):
    """What makes filters dead, or shows that they are set wrong: of all filters of a dive the largest of each."""

    rejected_pct: float
    nis_per_dof: float
    error_pct: float


def mean_squares(errors: ReferenceErrors) -> MeanSquares:
    """Give what one filter was off in one dive; a segment begins at each time of the reference."""
    ends = np.searchsorted(errors.time_ns, errors.time_ns + int(SEGMENT_S * NS_PER_S))
    begins = np.flatnonzero(ends < len(ends))
    position_m = errors.position_error_ned_m[:, :2]
    drift_m = position_m[ends[begins]] - position_m[begins]
    return MeanSquares(
        *map(_mean_square, (position_m, drift_m, errors.velocity_error_n[:, :2], position_m[-1:])),
        _mean_square(errors.position_error_ned_m[:, 2:]),
    )


def _mean_square(errors: Floats) -> float:
    return float(np.mean(np.sum(errors**2, axis=1)))


def ratio_of_logs(logs: Floats) -> TrueRatio:
    """Give the true ratio of an ensemble.

    Parameters
    ----------
    logs : ndarray, shape (dives,)
        Logarithms of candidate over baseline.
    """
    mean = float(logs.mean())
    scatter = float(logs.std(ddof=1))
    width = 1.96 * scatter / math.sqrt(len(logs))
    return TrueRatio(math.exp(mean), math.exp(mean - width), math.exp(mean + width), scatter)


def true_ratios(
    dives: Sequence[Mapping[str, MeanSquares]], baseline: str, candidate: str
) -> dict[str, TrueRatio]:
    """Compare the root mean squares of two filters over dives, quantity by quantity."""
    before, after = (np.array([dive[name] for dive in dives]) for name in (baseline, candidate))
    logs = 0.5 * np.log(after / before)
    return {
        name: ratio_of_logs(column)
        for name, column in zip(MeanSquares._fields, logs.T, strict=True)
    }


def soundness(histories: Sequence[History], errors: Mapping[str, ReferenceErrors]) -> Soundness:
    """Measure the pings that are rejected, NIS over its degrees of freedom, and position errors over the distance."""
    leading = [history.innovations[0] for history in histories]
    rejected = [np.mean(~innovations.used) for innovations in leading]
    nis_per_dof = [np.mean(innovations.nis) / innovations.dof for innovations in leading]
    error = [
        np.sqrt(_mean_square(error.position_error_ned_m[:, :2])) / error.distance_m
        for error in errors.values()
    ]
    return Soundness(
        100.0 * float(max(rejected)), float(max(nis_per_dof)), 100.0 * float(max(error))
    )
