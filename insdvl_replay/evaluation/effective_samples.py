"""How much a series in time is worth: the independent samples in its mean, and the blocks in which it may be redrawn.

Neighbouring values of a filter's error are nearly the same number, and a mean over them is less sure than their count
suggests. `samples_in_mean` is for the mean of any series, about that mean; `samples_in_mean_square` for the mean square
of an error that is normal and errs about zero. Sources: Anderson, "The statistical analysis of time series", 1971,
chapter 8, for the bias of autocorrelations about a mean; Bartlett, "On the theoretical specification and sampling
properties of autocorrelated time-series", 1946, for the variance of a mean of squares; Sokal, "Monte Carlo methods in
statistical mechanics", 1997, for where to stop adding up; Politis and White, "Automatic block-length selection for the
dependent bootstrap", 2004, with the correction of Patton, Politis and White, 2009.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats

ROUNDS: Final = 3
"""The bias depends on the correlation time that it biases: so often the two are brought to agree."""
SLOW: Final = 0.5
"""Correlation of neighbouring averages, in its standard deviations for independent ones, that tells of a slow part."""
FEWEST_AVERAGES: Final = 10
"""Fewer averages of neighbours show no slow part."""
WINDOW_TIMES: Final = 5.0
"""The sum of squared autocorrelations stops at the first lag beyond so many correlation times: the rest is noise."""


def samples_in_mean(values: Floats) -> float:
    """Return how many independent values would have a mean as sure as that of a series.

    That is ``n / tau`` with ``tau = 1 + 2 sum (1 - j/n) rho_j`` up to the first change of sign. Where the mean is
    estimated from the same values, each correlation comes out too small by about ``tau / n``, which is put back. Fast
    noise hides a slow part, whose correlations are small but many: averages of neighbours show it, and what they make
    of the variance of the mean counts where it is more.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Evenly spaced in time.

    Returns
    -------
    float
        From 1 to n; 1 where the values are all the same, and 0 without values.
    """
    n = len(values)
    if n < 2:
        return float(n)
    if values.var() <= 0.0:
        return 1.0
    samples, (averages, _) = n / _correlation_time(values), slow_part(values)
    if len(averages):
        of_averages = len(averages) / _correlation_time(averages)
        samples = min(samples, of_averages * float(values.var() / averages.var()))
    return float(np.clip(samples, 1.0, n))


def samples_in_mean_square(standardised: Floats) -> float:
    """Return the number of independent samples whose mean square would scatter as much as that of a series.

    For a normal series with autocorrelation ``r_j`` the mean square of N values has the variance of one square over
    ``N / tau``, with ``tau = 1 + 2 sum (1 - j/N) r_j^2``. With several components tau is their mean, which makes the
    variance right for the sum of their squares. What averages of neighbours make of it counts where it is more.

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
    shares = [_repeated_share(component) for component in standardised.T]
    return float(np.clip(1.0 / np.mean(shares), 1.0, len(standardised)))


def _repeated_share(series: Floats) -> float:
    """Return tau over the length of a series, or that of its slow part by what this has of the squares."""
    share, (averages, _) = _squared_correlation_time(series) / len(series), _averages(series)
    if not len(averages):
        return share
    of_squares = float(np.mean(averages**2) / max(np.mean(series**2), np.finfo(float).tiny))
    return max(share, of_squares**2 * _squared_correlation_time(averages) / len(averages))


def _squared_correlation_time(series: Floats) -> float:
    """Add up squared autocorrelations until they are noise."""
    k = len(series)
    correlation, weight = _correlation_about_zero(series), 1.0 - np.arange(k) / k
    times = 2.0 * np.cumsum(weight * correlation**2) - 1.0
    beyond = np.arange(k) >= WINDOW_TIMES * times
    return float(times[np.argmax(beyond)] if beyond.any() else times[-1])


def _correlation_about_zero(series: Floats) -> Floats:
    """Correlate a series with itself at every lag; 1 at all of them where it is zero throughout."""
    k = len(series)
    products = _products(series) / (k - np.arange(k))
    if products[0] == 0.0:
        return np.ones(k)
    correlation: Floats = np.clip(products / products[0], -1.0, 1.0)
    return correlation


def slow_part(values: Floats) -> tuple[Floats, int]:
    """Return averages over neighbours, and over how many, where these are correlated beyond chance; else none."""
    averages, together = _averages(values)
    if not len(averages):
        return averages, together
    covariance = _autocovariance(averages)
    slow = covariance[1] > SLOW * covariance[0] / np.sqrt(len(averages))
    return averages if slow else np.empty(0), together


def _averages(values: Floats) -> tuple[Floats, int]:
    """Return averages over neighbours, none where there would be few, and over how many."""
    n = len(values)
    together = max(1, int(np.ceil(np.sqrt(n) / 2.0)))
    groups = n // together
    if groups < FEWEST_AVERAGES:
        return np.empty(0), together
    return values[: groups * together].reshape(groups, together).mean(axis=1), together


def block_length(values: Floats) -> int:
    """Return the length of moving blocks with which the variance of a mean is estimated best.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Evenly spaced in time.

    Returns
    -------
    int
        From 1, for independent values, to ``min(3 sqrt(n), n / 3)``.
    """
    n = len(values)
    if n < 4:
        return 1
    covariance = _autocovariance(values)
    if covariance[0] <= 0.0:
        return 1
    lags = min(2 * _last_correlated_lag(covariance / covariance[0]), n - 1)
    lag = np.arange(lags + 1)
    # A window that is flat up to half of the lags does not bias what it adds up. Each lag but the first counts twice.
    weighted = np.clip(2.0 * (1.0 - lag / lags), 0.0, 1.0) * covariance[: lags + 1]
    long_run_variance = 2.0 * weighted.sum() - covariance[0]
    slope = 2.0 * float(lag @ weighted)
    longest = float(np.ceil(min(3.0 * np.sqrt(n), n / 3.0)))
    if long_run_variance <= 0.0:
        return int(longest)
    optimal = np.cbrt(2.0 * slope**2 * n / (4.0 / 3.0 * long_run_variance**2))
    return int(np.clip(np.ceil(optimal), 1.0, longest))


def _last_correlated_lag(correlation: Floats) -> int:
    """Find the lag after which a run of correlations is no larger than chance makes them; at least 1."""
    n = len(correlation)
    run = max(5, int(np.ceil(np.sqrt(np.log10(n)))))
    furthest = min(int(np.ceil(np.sqrt(n))) + run, n - 1)
    large = np.abs(correlation[1 : furthest + 1]) >= _chance(n)
    of_run = np.convolve(large, np.ones(run), "valid") if len(large) >= run else np.empty(0)
    quiet = np.flatnonzero(of_run < 0.5)
    if len(quiet):
        return max(1, int(quiet[0]))
    return max(1, int(np.flatnonzero(large)[-1]) + 1) if large.any() else 1


def _chance(n: int) -> float:
    """Return what correlations of n independent values seldom exceed, as Politis and White have it."""
    return float(2.0 * np.sqrt(np.log10(n) / n))


def _autocovariance(values: Floats) -> Floats:
    """Return the mean product of a series with itself at every lag, about its mean, each sum divided by n."""
    return _products(values - values.mean()) / len(values)


def _products(values: Floats) -> Floats:
    """Add up the products of a series with itself at every lag."""
    n = len(values)
    # Zeros in as great a number keep the series from meeting its own other end.
    spectrum = np.fft.rfft(values, 2 * n)
    products: Floats = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]
    return products


def _correlation_time(values: Floats) -> float:
    """Return tau, the number of neighbours that are worth one value, with the bias of correlations put back."""
    n = len(values)
    covariance = _autocovariance(values)
    # Divided by n and not by the n - j products there are, they already hold the factor 1 - j/n.
    correlation, weight = covariance / covariance[0], 1.0 - np.arange(n) / n
    tau = _sum_to_sign_change(correlation)
    for _ in range(ROUNDS):
        bias = min(tau / n, 1.0)
        tau = _sum_to_sign_change(correlation * (1.0 - bias) + weight * bias)
    return tau


def _sum_to_sign_change(correlation: Floats) -> float:
    negative = correlation <= 0.0
    end = int(np.argmax(negative)) if negative.any() else len(correlation)
    return float(2.0 * correlation[:end].sum() - 1.0)
