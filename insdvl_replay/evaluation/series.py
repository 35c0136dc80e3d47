"""Effective samples of a series of errors.

Neighbouring errors of a filter are nearly the same number, so a mean over them is less certain than their count
suggests: `samples_in_mean` counts independent samples for the mean of any series, about that mean;
`samples_in_mean_square` those for the mean square of an error that is normal about zero.

Sources: Anderson, "The statistical analysis of time series", 1971, chapter 8 (bias of autocorrelations about a mean);
Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", 1946 (variance of a
mean of squares); Sokal, "Monte Carlo methods in statistical mechanics", 1997 (where to stop the sum).
"""

import math
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Integers, TimeNs, nanoseconds

# The bias depends on the correlation time that it biases; this many iterations converge.
BIAS_ROUNDS: Final = 3
# Correlation of neighbouring averages, in its standard deviations for independent ones, that shows a slow part.
SLOW: Final = 0.5
FEWEST_AVERAGES: Final = 10  # Fewer averages of neighbours show no slow part.
# The sum of squared autocorrelations stops after this many correlation times; the rest is noise.
WINDOW_TIMES: Final = 5.0


# --- Independent samples of one series.


def thinned(time_ns: TimeNs, step_s: float) -> Integers:
    """Return the first row in every step of time."""
    if not len(time_ns):
        return np.empty(0, np.int64)
    _, rows = np.unique((time_ns - time_ns[0]) // nanoseconds(step_s), return_index=True)
    return np.asarray(rows, dtype=np.int64)


def samples_in_mean(values: Floats) -> float:
    """Return the effective samples for the mean of an evenly spaced series.

    That is ``n / tau`` with ``tau = 1 + 2 sum (1 - j/n) rho_j`` up to the first change of sign, and the bias of
    ``rho_j`` about the estimated mean, ``tau / n``, put back. Averages of neighbours show a slow part that fast noise
    hides.
    """
    n = len(values)
    if n < 2:
        return float(n)
    if values.var() <= 0.0:
        return 1.0
    samples = n / _correlation_time(values)
    averages = _averages(values, slow=True)
    if len(averages):
        samples_of_averages = len(averages) / _correlation_time(averages)
        samples = min(samples, samples_of_averages * float(values.var() / averages.var()))
    return float(np.clip(samples, 1.0, n))


def _correlation_time(values: Floats) -> float:
    """Return tau, the number of neighbours that count as one sample."""
    n = len(values)
    bias = 0.0
    tau = 1.0
    covariance = autocovariance(values)
    # Divided by n and not by the n - j products, they already hold the factor 1 - j/n.
    correlation = covariance / covariance[0]
    weight = 1.0 - np.arange(n) / n
    for _ in range(BIAS_ROUNDS + 1):
        corrected = correlation * (1.0 - bias) + weight * bias
        negative = corrected <= 0.0
        end = n
        if negative.any():
            end = int(np.argmax(negative))
        tau = float(2.0 * corrected[:end].sum() - 1.0)
        bias = min(tau / n, 1.0)
    return tau


def samples_in_mean_square(standardised: Floats) -> float:
    """Return the effective samples for the mean square of a series.

    The series, shape (k, n), is evenly spaced: errors in their own standard deviations, n uncorrelated components. It
    is ``k / tau`` with ``tau = 1 + 2 sum (1 - j/k) r_j^2`` in the mean over components. The mean is not subtracted: an
    error that stays is one sample. What averages of neighbours make of it counts where it is more.
    """
    shares = []
    for series in standardised.T:
        share = _squared_correlation_time(series) / len(series)
        averages = _averages(series)
        if len(averages):
            slow_share = float(
                np.mean(averages**2) / max(np.mean(series**2), np.finfo(float).tiny)
            )
            share = max(share, slow_share**2 * _squared_correlation_time(averages) / len(averages))
        shares.append(share)
    return float(np.clip(1.0 / np.mean(shares), 1.0, len(standardised)))


def _squared_correlation_time(series: Floats) -> float:
    """Add up squared autocorrelations about zero until they are noise."""
    k = len(series)
    lag = np.arange(len(series))
    products = _lagged_products(series) / (k - lag)
    correlation = np.ones(k)
    if products[0] != 0.0:
        correlation = np.clip(products / products[0], -1.0, 1.0)
    times = 2.0 * np.cumsum((1.0 - lag / k) * correlation**2) - 1.0
    beyond = lag >= WINDOW_TIMES * times
    if beyond.any():
        return float(times[np.argmax(beyond)])
    return float(times[-1])


def common_noise(first: Floats, second: Floats) -> float:
    """Return the standard deviation of white noise that two series of errors share, each component, shape (k, d).

    Of two filters that are compared with one reference it is that of the reference. Second differences leave out what
    changes slowly: those of white noise have six times its variance.
    """
    before = np.diff(first, 2, axis=0)
    after = np.diff(second, 2, axis=0)
    products = before * after
    known = np.isfinite(products).all(axis=1)
    if np.count_nonzero(known) < FEWEST_AVERAGES:
        return 0.0
    variance = float(np.mean(products[known])) / 6.0
    return math.sqrt(max(variance, 0.0))


def _averages(values: Floats, *, slow: bool = False) -> Floats:
    """Return averages of neighbours, none if there are too few.

    For a slow part only, there are none unless averages are correlated beyond chance.
    """
    together = max(1, int(np.ceil(np.sqrt(len(values)) / 2.0)))
    groups = len(values) // together
    averages: Floats = values[: groups * together].reshape(groups, together).mean(axis=1)
    if groups < FEWEST_AVERAGES:
        return np.empty(0)
    if slow:
        covariance = autocovariance(averages)
        if not covariance[1] > SLOW * covariance[0] / np.sqrt(groups):
            return np.empty(0)
    return averages


def autocovariance(values: Floats) -> Floats:
    """Return the mean product of a series with itself at every lag, about its mean, each sum divided by n."""
    return _lagged_products(values - values.mean()) / len(values)


def _lagged_products(values: Floats) -> Floats:
    n = len(values)
    # Zero padding avoids circular correlation.
    spectrum = np.fft.rfft(values, 2 * n)
    products: Floats = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]
    return products
