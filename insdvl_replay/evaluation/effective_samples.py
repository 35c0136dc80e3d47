"""How many independent samples a series of errors is worth.

Errors of a filter change slowly: those of neighbouring times are nearly the same number, and a mean over them is less
sure than their count suggests. Sources: Bartlett, "On the theoretical specification and sampling properties of
autocorrelated time-series", 1946, for the variance of a mean of squares; Sokal, "Monte Carlo methods in statistical
mechanics", 1997, for where to stop adding up.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats

WINDOW_TIMES: Final = 5.0
"""The sum stops at the first lag beyond this many correlation times: what follows is noise."""


def effective_samples(standardised: Floats) -> float:
    """Give the number of independent samples whose mean square would scatter as much as that of a series.

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
