"""Whether a filter's errors are as large as it says: errors against the reference in its own standard deviations.

The reference is taken as exact: where it is no better than the filter, its own errors count as the filter's. Errors
of neighbouring times are nearly the same number, and a mean over them is less sure than their count suggests. The
gravest of the groups of states stands for a filter: all states together are consistent, too, where some err by far more
than the filter says and others by far less. Source:
Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, chdtr

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    CREDIBILITY_GROUPS,
    CREDIBILITY_QUANTITIES,
    JOINT,
    POSITION_QUANTITIES,
)
from insdvl_replay.core.states import BA
from insdvl_replay.core.tables import CredibilityRow
from insdvl_replay.core.words import Consistency, Reason
from insdvl_replay.evaluation.chi_square import CONFIDENCE, chi_square_quantile, consistency_word, mean_interval, reason
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES
from insdvl_replay.evaluation.effective_samples import samples_in_mean_square
from insdvl_replay.evaluation.state_errors import (
    StateErrors,
    about_vehicle,
    nees,
    shared_variance,
    state_errors,
    whitened,
)

FAR_SMALLER: Final = 0.25
"""Share of the expected NEES, half of the believed size, below which errors count as small. A filter starts at the
reference, so that for a while the errors of an honest one are smaller than it says."""
MANY_FAR_OFF: Final = 0.01
"""A smaller share of errors beyond three standard deviations is near enough to the 0.3 % of a consistent filter."""


class _Judged(NamedTuple):
    """A row from its degrees of freedom on."""

    dof: int
    samples: int
    mean_nees: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")
    within_1sd_pct: float = float("nan")
    within_3sd_pct: float = float("nan")
    verdict: Consistency = Consistency.NOT_FINITE
    effective_samples: float = float("nan")
    why: Reason = Reason.NONE


def credibility_table(log: str, filters: Sequence[str], errors: Mapping[str, StateErrors]) -> list[CredibilityRow]:
    """Judge each filter by its errors against the reference.

    The interval of a mean is that of its independent samples, as the errors repeat themselves and as P says that they
    hang on those of slower states: of fast noise over a heading error, dives in which that is small show the noise.

    Parameters
    ----------
    log : str
        Name of the dive.
    filters : sequence of str
        All filters; the baseline has rows of its own.
    errors : mapping of str to StateErrors
        By filter; empty where the dive has no reference.

    Returns
    -------
    list of CredibilityRow
        For velocity and attitude, for the biases where the log carries the true ones; for the groups of these with
        their block of P, and for ``all`` of them with the whole of P. The shares of these are those inside the
        ellipsoids with the probabilities of one and three standard deviations. ``over-confident`` is also said where
        too many errors are beyond three of them. Where the verdict is not what the interval says, ``why`` tells. A
        solution that was read has rows of what its covariances tell.
    """
    return [
        CredibilityRow(log, name, quantity, *judged)
        for name in filters
        for quantity, judged in (_rows(errors[name]) if errors else _missing())
    ]


def _missing() -> Iterator[tuple[str, _Judged]]:
    motion = [name for name, states in CREDIBILITY_GROUPS.items() if states.stop <= BA.start]
    for quantity in (*CREDIBILITY_QUANTITIES[: BA.start], *motion, JOINT):
        yield quantity, _Judged(1, 0, verdict=Consistency.NO_REFERENCE)


def _rows(errors: StateErrors) -> Iterator[tuple[str, _Judged]]:
    """Judge each state, with the attitude about the vehicle's level axes; then each group of them, and all."""
    ever: NDArray[np.bool_] = np.any(np.isfinite(errors.error), axis=0)
    of_vehicle = about_vehicle(errors)
    of_each = _independent_of_each(of_vehicle)
    quantities = (*CREDIBILITY_QUANTITIES, *POSITION_QUANTITIES)[: errors.error.shape[1]]
    for state, quantity in enumerate(quantities):
        if errors.believed[state] and (state < BA.start or ever[state]):
            yield quantity, _judged(of_vehicle, np.array([state]), of_each)
    # What stays the same in n turns with the vehicle from one of its axes to the other: a group would not show that.
    of_each = _independent_of_each(errors)
    for group, states in ALL_CREDIBILITY_GROUPS.items():
        if errors.believed[states].any() and (states.stop <= BA.start or ever[states].any()):
            yield group, _judged(errors, np.arange(states.start, states.stop), of_each)
    if errors.believed.any():
        yield JOINT, _judged(errors, np.flatnonzero(ever), of_each)


def _standardised(errors: StateErrors, states: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return errors of some states in standard deviations, uncorrelated if P is right, at the times that know them all.

    Returns
    -------
    standardised : ndarray, shape (t, n)
        Not finite where the filter broke down.
    cov : ndarray, shape (t, n, n)
        P at these times.
    """
    times = np.isfinite(errors.error[:, states]).all(axis=1) & bool(len(states))
    cov = errors.cov[times]
    return whitened(errors.error[np.ix_(times, states)], cov[:, states[:, None], states]), cov


def _independent_of_each(errors: StateErrors) -> Floats:
    """Return how many samples the errors of each state are worth, shape (n,)."""
    series = [_standardised(errors, np.array([state]))[0] for state in range(errors.error.shape[1])]
    known = [len(one) > 0 and bool(np.isfinite(one).all()) for one in series]
    worth = [samples_in_mean_square(one) for one, is_known in zip(series, known, strict=True) if is_known]
    # An unknown bias, which hardly changes, is as slow as the slowest that is known.
    found = np.full(len(series), min(worth, default=1.0))
    found[known] = worth
    return found


def _judged(errors: StateErrors, states: NDArray[np.int64], independent_of_each: Floats) -> _Judged:
    """Judge the errors of some states together."""
    standardised, cov = _standardised(errors, states)
    samples, dof = standardised.shape
    if not samples:
        return _Judged(dof, 0, verdict=Consistency.NOT_IN_REFERENCE)
    if not np.isfinite(standardised).all():
        return _Judged(dof, samples, verdict=Consistency.NOT_FINITE)
    squared = np.sum(standardised**2, axis=1)
    of_each, of_attitude = shared_variance(cov, states)
    independent = _independent(samples_in_mean_square(standardised), of_each, independent_of_each, states)
    mean_nees, (low, high) = float(squared.mean()), mean_interval(dof, independent)
    near_pct, far_pct = (100.0 * float(np.mean(squared <= _ellipsoid(sigmas, dof))) for sigmas in (1.0, 3.0))
    own_share = 1.0 - of_attitude if errors.exact_start else np.inf
    word, why = _word(mean_nees, low, high, dof, independent, own_share)
    if word != Consistency.OVER_CONFIDENT and _many_far_off(1.0 - far_pct / 100.0, independent):
        word, why = Consistency.OVER_CONFIDENT, Reason.BEYOND_3_SD
    return _Judged(dof, samples, mean_nees, low, high, near_pct, far_pct, word, independent, why)


def _independent(own: float, of_each: Floats, independent_of_each: Floats, states: NDArray[np.int64]) -> float:
    """Return how many samples errors are worth that hang on those of other states, which may be slower.

    What a share s of the variance hangs on is the same in all of the dive, or in as much of it as makes one sample of
    the other state: of squared correlations ``s^2`` are those of the other state, the rest those of the errors. What
    hangs on it is said by P; how much the errors show of it depends on how large the other one happens to be.
    """
    share = of_each**2
    share[states] = 0.0
    repeated = share / independent_of_each + (1.0 - share) / own
    return float(1.0 / np.max(repeated, where=np.isfinite(repeated), initial=1.0 / own))


def _word(
    mean_nees: float, low: float, high: float, dof: int, independent: float, own_share: float
) -> tuple[Consistency, Reason]:
    """Judge a mean NEES; few samples prove that errors are too large, but not that they are as they should be.

    A filter starts on the reference: the misalignment that it allows for is not there, nor is what hangs on it, such as
    a velocity across the track or, on a straight line, a horizontal accelerometer bias. Errors that are too small are
    therefore held against the own share of a variance, which would be left if the attitude were known; infinitely much
    of a solution with a start of its own.
    """
    word = consistency_word(mean_nees, low, high, dof)
    if word != Consistency.OVER_CONFIDENT and dof * independent < FEWEST_UPDATES:
        return Consistency.TOO_FEW, Reason.NONE
    if word == Consistency.OVER_CAUTIOUS and mean_nees >= FAR_SMALLER * own_share * dof:
        return Consistency.CONSISTENT, Reason.EXACT_START
    return word, reason(word, mean_nees, low, high)


def _many_far_off(share: float, independent: float) -> bool:
    """Return whether more errors exceed 3 standard deviations than chance allows, and by enough to matter."""
    return share >= MANY_FAR_OFF and probability_of(share, independent) < 1.0 - CONFIDENCE


def probability_of(far_off: float, independent: float) -> float:
    """Bound how probable so large a share of errors beyond 3 standard deviations is in a consistent filter.

    Of at least one independent sample it is the binomial probability, continued between whole numbers. Of less, an
    excursion that happened to last, it is Markov's bound, which holds however the errors depend on each other. The two
    meet. Exceedances repeat themselves less than squares do, by whose correlation the samples are counted.
    """
    expected = 1.0 - float(chdtr(1, 9.0))
    count = far_off * independent
    return expected / far_off if count < 1.0 else float(betainc(count, independent - count + 1.0, expected))


def _ellipsoid(sigmas: float, dof: int) -> float:
    """Return the NEES that is exceeded as rarely as a normal variable exceeds so many standard deviations."""
    return chi_square_quantile(float(chdtr(1, sigmas**2)), dof)


__all__ = [
    "FAR_SMALLER",
    "MANY_FAR_OFF",
    "StateErrors",
    "about_vehicle",
    "credibility_table",
    "nees",
    "probability_of",
    "state_errors",
    "whitened",
]
