"""What is true of two filters in a world: their errors over all its dives, which no filter and no judge knows.

One dive holds few independent errors, and of what is drawn once a dive, as a bias is, a single one. An ensemble holds
many, so that the ratio of the root mean squares has a narrow interval: better, same and worse are facts.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.history import History
from insdvl_replay.evaluation.reference_errors import ReferenceErrors

MARGIN: Final = 1.05
"""A ratio of errors nearer to 1 makes no difference to anybody."""
LARGE: Final = 1.1
SEGMENT_S: Final = 60.0
DRAWS, SEED = 2000, 1


class MeanSquares(NamedTuple):
    """Mean squared true errors of one filter in one dive; all but that of the depth are horizontal."""

    drift_m2: float
    """In a segment."""
    velocity_m2ps2: float
    position_m2: float
    end_m2: float
    depth_m2: float


class Ratio(NamedTuple):
    """Root mean square of the candidate's errors over the baseline's, and the interval that holds it with 95 %."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


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
        *map(_mean_square, (drift_m, errors.velocity_error_n[:, :2], position_m, position_m[-1:])),
        _mean_square(errors.position_error_ned_m[:, 2:]),
    )


def _mean_square(errors: Floats) -> float:
    return float(np.mean(np.sum(errors**2, axis=1)))


def true_ratio(baseline: Floats, candidate: Floats) -> Ratio:
    """Compare the root mean squares of two filters over all dives; the interval is of dives drawn with replacement.

    Parameters
    ----------
    baseline, candidate : ndarray, shape (dives,)
        Mean squares of each dive.
    """
    drawn = np.random.default_rng(SEED).integers(len(baseline), size=(DRAWS, len(baseline)))
    ratios = np.sqrt(candidate[drawn].sum(axis=1) / baseline[drawn].sum(axis=1))
    low, high = np.quantile(ratios, (0.025, 0.975))
    return Ratio(float(np.sqrt(candidate.sum() / baseline.sum())), float(low), float(high))


def true_ratios(dives: Sequence[Mapping[str, MeanSquares]], baseline: str, candidate: str) -> tuple[Ratio, ...]:
    """Compare two filters over dives, in the order of `MeanSquares`."""
    before, after = (np.array([dive[name] for dive in dives]) for name in (baseline, candidate))
    return tuple(true_ratio(*columns) for columns in zip(before.T, after.T, strict=True))


def truth(ratios: Sequence[Ratio]) -> str:
    """Say which class a candidate is of: A truly better in something and worse in nothing, B the same, C worse, or AC.

    A question mark follows where the intervals allow for another class.
    """
    kind = _class_of([_side(ratio.value) for ratio in ratios])
    allowed = product(*(range(_side(ratio.low), _side(ratio.high) + 1) for ratio in ratios))
    return kind if {_class_of(sides) for sides in allowed} == {kind} else f"{kind}?"


def is_large(ratios: Sequence[Ratio]) -> bool:
    """Return whether a difference is of 10 % or more in one of the ratios."""
    return any(not 1.0 / LARGE < ratio.value < LARGE for ratio in ratios)


def _class_of(sides: Collection[int]) -> str:
    return ("A" if -1 in sides else "") + ("C" if 1 in sides else "") or "B"


def _side(ratio: float) -> int:
    """Return whether a ratio is below the margin, -1, in it or above it, 1."""
    return int(ratio >= MARGIN) - int(ratio <= 1.0 / MARGIN)


def soundness(histories: Sequence[History], errors: Mapping[str, ReferenceErrors]) -> Soundness:
    """Measure the pings that are rejected, NIS over its degrees of freedom, and position errors over the distance."""
    leading = [history.innovations[0] for history in histories]
    rejected = [np.mean(~innovations.used) for innovations in leading]
    nis_per_dof = [np.mean(innovations.nis) / innovations.dof for innovations in leading]
    error = [np.sqrt(_mean_square(error.position_error_ned_m[:, :2])) / error.distance_m for error in errors.values()]
    return Soundness(100.0 * float(max(rejected)), float(max(nis_per_dof)), 100.0 * float(max(error)))
