"""Whether the mean of squares is what it should be: its chi-square interval, and how many independent ones it is of.

Errors of a filter change slowly: those of neighbouring times are nearly the same number, and a mean over them is less
sure than their count suggests. Sources: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
Navigation", chapter 5; Bartlett, "On the theoretical specification and sampling properties of autocorrelated
time-series", 1946, for the variance of a mean of squares; Sokal, "Monte Carlo methods in statistical mechanics", 1997,
for where to stop adding up.
"""

from typing import Final

import numpy as np
from scipy.special import chdtri

from insdvl_replay.core.columns import Floats
from insdvl_replay.core.words import Consistency

CONFIDENCE: Final = 0.95
"""Share of consistent filters whose mean lies inside the interval."""
SMALL_EXCESS: Final = 0.1
"""A NIS or NEES that is off by a smaller share stands for a standard deviation that is off by less than 5 %."""
WINDOW_TIMES: Final = 5.0
"""The sum stops at the first lag beyond this many correlation times: what follows is noise."""


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value below which a chi-square variable lies with a probability; infinite for probability 1."""
    return float("inf") if probability >= 1.0 else float(chdtri(dof, 1.0 - probability))


def mean_interval(dof: int, count: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the interval in which the mean of chi-square variables lies.

    The sum of ``count`` independent variables with ``dof`` degrees of freedom has ``count * dof`` of them.

    Parameters
    ----------
    dof : int
        Of one variable.
    count : float
        How many are averaged; of variables that depend on each other the effective number, which need not be whole.
    confidence : float
        Probability of the interval, two-sided.
    """
    tail = (1.0 - confidence) / 2.0
    return (
        chi_square_quantile(tail, count * dof) / count,
        chi_square_quantile(1.0 - tail, count * dof) / count,
    )


def verdict(mean: float, low: float, high: float, dof: int) -> Consistency:
    """Judge a mean NIS or NEES: consistent in its interval or near ``dof``, over-confident above, or over-cautious."""
    if not np.isfinite(mean):
        return Consistency.NOT_FINITE
    if low <= mean <= high or abs(mean / dof - 1.0) <= SMALL_EXCESS:
        return Consistency.CONSISTENT
    return Consistency.OVER_CONFIDENT if mean > high else Consistency.OVER_CAUTIOUS


def effective_samples(standardised: Floats) -> float:
    """Return the number of independent samples whose mean square would scatter as much as that of a series.

    For a normal series with autocorrelation ``r_j`` the mean square of N values has the variance of one square over
    ``N / tau``, with ``tau = 1 + 2 sum (1 - j/N) r_j^2``. With several components tau is their mean, which makes the
    variance right for the sum of their squares.

    Parameters
    ----------
    standardised : ndarray, shape (k, n)
        Errors in their own standard deviations, evenly spaced in time; of several components uncorrelated ones. Their
        mean is taken to be zero and not taken off: an error that stays is one sample, however often it is looked at.

    Returns
    -------
    float
        From 1 to k.
    """
    k = len(standardised)
    times = [_correlation_time(component) for component in standardised.T]
    return float(np.clip(k / np.mean(times), 1.0, k))


def _correlation_time(series: Floats) -> float:
    """Add up squared autocorrelations until they are noise."""
    k = len(series)
    correlation, weight = _autocorrelation(series), 1.0 - np.arange(k) / k
    times = 2.0 * np.cumsum(weight * correlation**2) - 1.0
    beyond = np.arange(k) >= WINDOW_TIMES * times
    return float(times[np.argmax(beyond)] if beyond.any() else times[-1])


def _autocorrelation(series: Floats) -> Floats:
    """Correlate a series with itself at every lag; 1 at all of them where it is zero throughout."""
    k = len(series)
    # Zeros in as great a number keep the series from meeting its own other end.
    spectrum = np.fft.rfft(series, 2 * k)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * k)[:k] / (k - np.arange(k))
    if products[0] == 0.0:
        return np.ones(k)
    correlation: Floats = np.clip(products / products[0], -1.0, 1.0)
    return correlation
