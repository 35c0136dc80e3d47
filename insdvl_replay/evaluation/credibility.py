"""Whether a filter's errors are as large as it says: errors against the reference in its own standard deviations.

The reference is taken as exact: where it is no better than the filter, its own errors count as the filter's. Errors
of neighbouring times are nearly the same number, and a mean over them is less sure than their count suggests. Sources:
Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", chapter 5;
Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", 1946, for the
variance of a mean of squares; Sokal, "Monte Carlo methods in statistical mechanics", 1997, for where to stop adding up.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, chdtr

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.quantities import CREDIBILITY_QUANTITIES, JOINT
from insdvl_replay.core.rows import CredibilityRow
from insdvl_replay.core.states import BA, PHI
from insdvl_replay.core.words import Consistency
from insdvl_replay.evaluation.chi_square import (
    CONFIDENCE,
    chi_square_quantile,
    effective_samples,
    mean_interval,
    verdict,
)
from insdvl_replay.evaluation.consistency import FEWEST_UPDATES
from insdvl_replay.evaluation.state_errors import StateErrors, nees, whitened

FAR_SMALLER: Final = 0.25
"""Share of the expected NEES, half of the believed size, below which errors count as small. A filter starts at the
reference, so that for a while the errors of an honest one are smaller than it says."""
MANY_FAR_OFF: Final = 0.01
"""A smaller share of errors beyond three standard deviations is near enough to the 0.3 % of a consistent filter."""

_Judged = tuple[int, int, float, float, float, float, float, Consistency, float]
"""A row from its degrees of freedom on."""


def credibility_table(log: str, filters: Sequence[str], errors: Mapping[str, StateErrors]) -> list[CredibilityRow]:
    """Judge each filter by its errors against the reference.

    The interval of a mean is that of its `effective_samples`.

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
        For velocity and attitude, for the biases where the log carries the true ones, and for ``all`` of them with the
        whole of P; of these the shares are those inside the ellipsoids with the probabilities of one and three standard
        deviations. ``over-confident`` is also said where too many errors are beyond three of them.
    """
    return [
        CredibilityRow(log, name, quantity, *judged)
        for name in filters
        for quantity, judged in (_rows(errors[name]) if errors else _missing())
    ]


def _missing() -> Iterator[tuple[str, _Judged]]:
    for quantity in (*CREDIBILITY_QUANTITIES[: BA.start], JOINT):
        yield quantity, _without_numbers(1, 0, Consistency.NO_REFERENCE)


def _without_numbers(dof: int, samples: int, word: Consistency) -> _Judged:
    nan = float("nan")
    return dof, samples, nan, nan, nan, nan, nan, word, nan


def _rows(errors: StateErrors) -> Iterator[tuple[str, _Judged]]:
    known = np.isfinite(errors.error)
    standardised = _standardised(errors)
    for i, quantity in enumerate(CREDIBILITY_QUANTITIES):
        if i < BA.start or known[:, i].any():
            yield quantity, _judged(standardised[known[:, i], i : i + 1], _own_share(errors, i, known[:, i]))
    yield JOINT, _joint(errors, known)


def _standardised(errors: StateErrors) -> Floats:
    """Divide each error by its own standard deviation; misalignment turns from north and east to roll and pitch."""
    error, var = errors.error.copy(), errors.sd**2
    cos, sin = np.cos(errors.heading), np.sin(errors.heading)
    north, east = error[:, PHI.start], error[:, PHI.start + 1]
    var_north, var_east = var[:, PHI.start].copy(), var[:, PHI.start + 1].copy()
    cov = errors.cov[:, PHI.start, PHI.start + 1]
    error[:, PHI.start : PHI.stop - 1] = np.column_stack([cos * north + sin * east, cos * east - sin * north])
    var[:, PHI.start] = cos**2 * var_north + sin**2 * var_east + 2.0 * cos * sin * cov
    var[:, PHI.start + 1] = sin**2 * var_north + cos**2 * var_east - 2.0 * cos * sin * cov
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return np.asarray(error / np.sqrt(var))


def _own_share(errors: StateErrors, state: int, times: NDArray[np.bool_]) -> float:
    """Return the share of a variance that would be left if the attitude were known; 1 for the attitude itself.

    A filter starts at the reference. The misalignment that it allows for is not there, nor is what hangs on it, such as
    a velocity across the track or, on a straight line, a horizontal accelerometer bias.
    """
    if PHI.start <= state < PHI.stop or not times.any():
        return 1.0
    cov = errors.cov[times]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        by_attitude = nees(cov[:, PHI, state], cov[:, PHI, PHI]) / errors.sd[times, state] ** 2
    return float(np.mean(1.0 - np.nan_to_num(by_attitude, posinf=0.0)))


def _joint(errors: StateErrors, known: NDArray[np.bool_]) -> _Judged:
    """Judge all states that are ever compared, at the times when all of them are."""
    states = np.flatnonzero(known.any(axis=0))
    times = known[:, states].all(axis=1)
    if not len(states):
        return _without_numbers(0, 0, Consistency.NOT_IN_REFERENCE)
    return _judged(whitened(errors.error[np.ix_(times, states)], errors.cov[np.ix_(times, states, states)]))


def _judged(standardised: Floats, own_share: float = 1.0) -> _Judged:
    """Judge errors in standard deviations, shape (k, dof), that are uncorrelated in a consistent filter."""
    samples, dof = standardised.shape
    if not samples:
        return _without_numbers(dof, 0, Consistency.NOT_IN_REFERENCE)
    if not np.isfinite(standardised).all():
        return _without_numbers(dof, samples, Consistency.NOT_FINITE)
    squared = np.sum(standardised**2, axis=1)
    mean_nees, independent = float(squared.mean()), effective_samples(standardised)
    low, high = mean_interval(dof, independent)
    near_pct, far_pct = (100.0 * float(np.mean(squared <= _ellipsoid(sigmas, dof))) for sigmas in (1.0, 3.0))
    word = _word(mean_nees, low, high, dof, independent, own_share)
    if _many_far_off(1.0 - far_pct / 100.0, independent):
        word = Consistency.OVER_CONFIDENT
    return dof, samples, mean_nees, low, high, near_pct, far_pct, word, independent


def _word(mean_nees: float, low: float, high: float, dof: int, independent: float, own_share: float) -> Consistency:
    """Judge a mean NEES; few samples prove that errors are too large, but not that they are as they should be."""
    word = verdict(mean_nees, low, high, dof)
    if word == Consistency.OVER_CONFIDENT:
        return word
    if dof * independent < FEWEST_UPDATES:
        return Consistency.TOO_FEW
    return Consistency.CONSISTENT if mean_nees >= FAR_SMALLER * own_share * dof else word


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
