"""Effective samples of a series of errors, and whether the errors of two filters differ.

Neighbouring errors of a filter are nearly the same number, so a mean over them is less certain than their count
suggests. The first part counts independent samples: `samples_in_mean` for the mean of any series, about that mean;
`samples_in_mean_square` for the mean square of an error that is normal about zero. The second part compares two
filters. Filters of one dive share its sensors and its reference, so that their errors are compared pair by pair, and
time is resampled in blocks that keep neighbouring errors together. Ratios are candidate over baseline; means and
standard deviations are those of their logarithms.

Sources: Anderson, "The statistical analysis of time series", 1971, chapter 8 (bias of autocorrelations about a mean);
Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series", 1946 (variance of a
mean of squares); Sokal, "Monte Carlo methods in statistical mechanics", 1997 (where to stop the sum); Politis and
White, "Automatic block-length selection for the dependent bootstrap", 2004, corrected by Patton, Politis and White,
2009; Künsch, "The jackknife and the bootstrap for general stationary observations", 1989 (moving blocks); Diebold and
Mariano, "Comparing predictive accuracy", 1995 (differential of losses); Satterthwaite, 1946 (freedom of a sum of
variances); Schuirmann, 1987 (equivalence); Kish, "Survey sampling", 1965 (number of stretches that count).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from insdvl_replay.core.dive_columns import Floats, TimeNs, nanoseconds
from insdvl_replay.core.words import EvidenceVerdict

# The bias depends on the correlation time that it biases; this many iterations converge.
BIAS_ROUNDS: Final = 3
# Correlation of neighbouring averages, in its standard deviations for independent ones, that shows a slow part.
SLOW: Final = 0.5
FEWEST_AVERAGES: Final = 10  # Fewer averages of neighbours show no slow part.
# The sum of squared autocorrelations stops after this many correlation times; the rest is noise.
WINDOW_TIMES: Final = 5.0

MARGIN: Final = 0.05  # A smaller difference does not matter.
FEWEST_EFFECTIVE: Final = 6.0  # Fewer effective samples of one dive are undecided.
# A row decides below it. On equal filters any row of three dives decides in 0.2 % of cases (`make judge`).
LARGEST_P: Final = 0.01
SETTLED: Final = 0.10
# Standard deviations by which a difference must exceed the margin to have a p below 0.01 in four of five cases.
POWER: Final = 2.33 + 0.84
# Extra samples for Student's instead of the normal distribution: half the square of 2.33 (Guenther, 1981).
SMALL_SAMPLE: Final = 2.7
STRETCHES: Final = 8
# If fewer of the eight stretches of a dive count, each is one sample, however long it is.
FEWEST_STRETCHES: Final = 2.5
DRAWS: Final = 2000
SEED: Final = 20_260_000
# Blocks that estimate a variance best make its intervals too short. Longer blocks are noisier and less biased.
WIDER_THAN_OPTIMAL: Final = 3
# With fewer windows their correlation is unknown. Each is a restart; in simulated dives they are not correlated.
FEWEST_CORRELATED: Final = 20
# Neighbours of a longer series are averaged first, so that hours at 10 Hz take no longer than minutes.
MOST_VALUES: Final = 1000
TAILS: Final = (0.975, 0.95)  # Upper ends of the 95 % interval, and of the 90 % interval for equivalence.
NORMAL: Final = 1e6  # With this many degrees of freedom Student's distribution is normal.
NAN: Final = float("nan")


# --- Independent samples of one series.


def thinned(time_ns: TimeNs, step_s: float) -> NDArray[np.int64]:
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
    samples, (averages, _) = n / _correlation_time(values), _averages(values, slow=True)
    if len(averages):
        samples_of_averages = len(averages) / _correlation_time(averages)
        samples = min(samples, samples_of_averages * float(values.var() / averages.var()))
    return float(np.clip(samples, 1.0, n))


def _correlation_time(values: Floats) -> float:
    """Return tau, the number of neighbours that count as one sample."""
    n, bias, tau = len(values), 0.0, 1.0
    covariance = autocovariance(values)
    # Divided by n and not by the n - j products, they already hold the factor 1 - j/n.
    correlation, weight = covariance / covariance[0], 1.0 - np.arange(n) / n
    for _ in range(BIAS_ROUNDS + 1):
        corrected = correlation * (1.0 - bias) + weight * bias
        negative = corrected <= 0.0
        end = int(np.argmax(negative)) if negative.any() else n
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
        share, (averages, _) = _squared_correlation_time(series) / len(series), _averages(series)
        if len(averages):
            slow_share = float(np.mean(averages**2) / max(np.mean(series**2), np.finfo(float).tiny))
            share = max(share, slow_share**2 * _squared_correlation_time(averages) / len(averages))
        shares.append(share)
    return float(np.clip(1.0 / np.mean(shares), 1.0, len(standardised)))


def _squared_correlation_time(series: Floats) -> float:
    """Add up squared autocorrelations about zero until they are noise."""
    k, lag = len(series), np.arange(len(series))
    products = _lagged_products(series) / (k - lag)
    correlation = np.clip(products / products[0], -1.0, 1.0) if products[0] != 0.0 else np.ones(k)
    times = 2.0 * np.cumsum((1.0 - lag / k) * correlation**2) - 1.0
    beyond = lag >= WINDOW_TIMES * times
    return float(times[np.argmax(beyond)] if beyond.any() else times[-1])


def _averages(values: Floats, *, slow: bool = False) -> tuple[Floats, int]:
    """Return averages of neighbours, none if there are too few, and the number of averaged values.

    For a slow part only, there are none unless averages are correlated beyond chance.
    """
    together = max(1, int(np.ceil(np.sqrt(len(values)) / 2.0)))
    groups = len(values) // together
    averages = values[: groups * together].reshape(groups, together).mean(axis=1)
    known = groups >= FEWEST_AVERAGES
    if known and slow:
        covariance = autocovariance(averages)
        known = covariance[1] > SLOW * covariance[0] / np.sqrt(groups)
    return averages if known else np.empty(0), together


def block_length(values: Floats) -> int:
    """Return the length of moving blocks that estimates the variance of the mean of an evenly spaced series best.

    It is between 1, for independent values, and ``min(3 sqrt(n), n / 3)``.
    """
    n = len(values)
    covariance = autocovariance(values) if n >= 4 else np.zeros(1)
    if covariance[0] <= 0.0:
        return 1
    # The last lag before a run of correlations that independent values seldom exceed (Politis and White).
    run = max(5, int(np.ceil(np.sqrt(np.log10(n)))))
    furthest = min(int(np.ceil(np.sqrt(n))) + run, n - 1)
    large = np.abs(covariance[1 : furthest + 1] / covariance[0]) >= 2.0 * np.sqrt(np.log10(n) / n)
    large_in_run = np.convolve(large, np.ones(run), "valid") if len(large) >= run else np.empty(0)
    quiet = np.flatnonzero(large_in_run < 0.5)
    last_lag = 1
    if len(quiet):
        last_lag = max(1, int(quiet[0]))
    elif large.any():
        last_lag = int(np.flatnonzero(large)[-1]) + 1
    # A window that is flat up to half of the lags does not bias the sum. Each lag but the first counts twice.
    lags = min(2 * last_lag, n - 1)
    lag = np.arange(lags + 1)
    weighted = np.clip(2.0 * (1.0 - lag / lags), 0.0, 1.0) * covariance[: lags + 1]
    long_run_variance, slope = 2.0 * weighted.sum() - covariance[0], 2.0 * float(lag @ weighted)
    longest = float(np.ceil(min(3.0 * np.sqrt(n), n / 3.0)))
    if long_run_variance <= 0.0:
        return int(longest)
    optimal = np.cbrt(2.0 * slope**2 * n / (4.0 / 3.0 * long_run_variance**2))
    return int(np.clip(np.ceil(optimal), 1.0, longest))


def autocovariance(values: Floats) -> Floats:
    """Return the mean product of a series with itself at every lag, about its mean, each sum divided by n."""
    return _lagged_products(values - values.mean()) / len(values)


def _lagged_products(values: Floats) -> Floats:
    n = len(values)
    # Zero padding avoids circular correlation.
    spectrum = np.fft.rfft(values, 2 * n)
    products: Floats = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]
    return products


# --- The ratio of two series, with its interval and verdict.


class RatioInterval(NamedTuple):
    """Candidate over baseline, with the 95 % and the 90 % interval; all NaN if nothing could be compared."""

    ratio: float
    low: float
    high: float
    low90: float
    high90: float
    effective_samples: float  # a verdict needs enough of them
    freedom: float = math.inf  # of Student's intervals; may be much less than the effective samples
    stretch: int | None = None  # of `STRETCHES`, from 0, that holds nearly all of the errors
    drawn_p: float = math.nan  # of intervals that are not Student's: share of ratios on the other side of the margin

    @property
    def log_sd(self) -> float:
        """Standard deviation of the logarithm of the ratio; NaN where an end of the interval is not finite."""
        known = 0.0 < self.low <= self.high < math.inf
        width = 2.0 * float(stdtrit(min(self.freedom, NORMAL), TAILS[0]))
        return math.log(self.high / self.low) / width if known else NAN

    @property
    def p(self) -> float:
        """Probability of a ratio as far from 1 as this if the true difference is no larger than the margin."""
        if not math.isnan(self.drawn_p):
            return self.drawn_p
        beyond = abs(math.log(self.ratio)) - math.log(1.0 + MARGIN) if self.ratio > 0.0 else NAN
        if not self.log_sd > 0.0:
            return NAN if math.isnan(beyond) else float(beyond <= 0.0)
        return float(stdtr(min(self.freedom, NORMAL), -beyond / self.log_sd))

    @property
    def independent(self) -> float:
        """Independent values behind the interval: at most its degrees of freedom plus one."""
        return min(self.effective_samples, self.freedom + 1.0)


NO_INTERVAL: Final = RatioInterval(NAN, NAN, NAN, NAN, NAN, 0.0)


def paired_ratio(
    baseline_sq: Floats,  # (k,) or (s, k), squared errors, evenly spaced in time, from one start or s random starts
    candidate_sq: Floats,  # the same shape, or (k,) of one run with a start of its own
    *,
    least_block: int = 1,  # neighbours with common data, such as the length of a segment in steps
    is_correlated: bool = True,  # whether to look for correlation of neighbours
    log_scale: float = 0.0,  # logarithm of the candidate's unit over the baseline's
) -> RatioInterval:
    """Return the ratio of root mean squares of two filters' errors over the same times of one dive.

    The variance of its logarithm is that over moving blocks of time, the same for both filters and all starts, and
    that over starts. The interval is Student's, with the number of blocks and of starts for freedom. One run against
    several is one draw of a start: the ratio is the mean of logarithms, and the scatter of starts counts once for the
    run and once over the number of starts for the mean. Times at which an error is not finite are left out.
    """
    baseline, candidate = np.atleast_2d(baseline_sq), np.atleast_2d(candidate_sq)
    one_run, starts = len(candidate) < len(baseline), len(baseline)
    known = np.isfinite(baseline).all(axis=0) & np.isfinite(candidate).all(axis=0)
    baseline, candidate = baseline[:, known], np.broadcast_to(candidate[:, known], (starts, int(known.sum())))
    if np.array_equal(baseline, candidate) and baseline.size and not log_scale and not one_run:
        return RatioInterval(1.0, 1.0, 1.0, 1.0, 1.0, float(baseline.size))
    compared = (baseline.any(axis=1).all() if one_run else baseline.any()) and candidate.any()
    if baseline.shape[1] < 2 or not compared:
        return NO_INTERVAL
    logs = 0.5 * np.log(candidate.mean(axis=1) / baseline.mean(axis=1)) if one_run else np.empty(0)
    log_ratio = float(logs.mean()) if one_run else 0.5 * float(np.log(candidate.mean() / baseline.mean())) + log_scale

    # Neighbours of a long series are averaged; an incomplete last group is left out.
    together = -(-baseline.shape[1] // MOST_VALUES)
    groups = baseline.shape[1] // together
    baseline, candidate = (
        errors_sq[:, : groups * together].reshape(starts, groups, together).mean(axis=2)
        for errors_sq in (baseline, candidate)
    )
    differential = 0.5 * (candidate / candidate.mean() - baseline / baseline.mean())
    over_time = differential.mean(axis=0)

    # Blocks as long as the slow part needs, at most a third of the values.
    block = 1
    if is_correlated:
        averages, neighbours = _averages(over_time, slow=True)
        slow_length = block_length(averages)
        optimal = max(block_length(over_time), neighbours * slow_length if slow_length > 1 else 1)
        wanted = WIDER_THAN_OPTIMAL * optimal if optimal > 1 else 1
        block = max(1, min(max(wanted, -(-least_block // together)), groups // 3))

    # The variance over time, and over starts, with Satterthwaite's freedom of their sum.
    time_variance, freedom = _block_variance(baseline.mean(axis=0), candidate.mean(axis=0), block), groups / block - 1.0
    start_variance = 0.0
    if one_run:
        start_variance = float(logs.var(ddof=1)) * (1.0 + 1.0 / starts)
    elif starts > 1:
        start_variance = _block_variance(baseline.mean(axis=1), candidate.mean(axis=1), 1)
    if start_variance > 0.0:
        parts = time_variance**2 / max(freedom, 1.0) + start_variance**2 / max(starts - 1.0, 1.0)
        freedom = (time_variance + start_variance) ** 2 / parts

    # Effective samples: the variance of one value over that of the mean over times and starts.
    samples = float(differential.size)
    if is_correlated:
        samples = samples_in_mean(over_time)
        if starts > 1:
            mean_variance = over_time.var() / samples + differential.mean(axis=1).var(ddof=1) / starts
            ratio = differential.var() / mean_variance if mean_variance > 0.0 else 1.0
            samples = float(np.clip(ratio, 1.0, differential.size))
    log_sd = float(np.sqrt(time_variance + start_variance))
    interval = _student_interval(log_ratio, log_sd, max(freedom, 1.0), samples)

    # If nearly all errors are in few stretches of the dive, the samples are limited by Kish's number.
    paired = (baseline / baseline.mean() + candidate / candidate.mean()).mean(axis=0)
    sums = np.array([part.sum() for part in np.array_split(paired, STRETCHES)])
    counting = float(sums.sum() ** 2 / (sums**2).sum())
    if counting >= FEWEST_STRETCHES:
        return interval
    return interval._replace(effective_samples=min(samples, counting), stretch=int(np.argmax(sums)))


def _block_variance(baseline: Floats, candidate: Floats, block: int) -> float:
    """Return the variance of the logarithm of the ratio of root means over drawn blocks."""
    n = len(baseline)
    first = np.random.default_rng(SEED).integers(0, n - block + 1, (DRAWS, -(-n // block)))
    before, after = (
        np.convolve(errors_sq, np.ones(block), "valid")[first].sum(axis=1) for errors_sq in (baseline, candidate)
    )
    drawn = (before > 0.0) & (after > 0.0)
    # Blocks scatter about the mean of the same n values, which takes the freedom of one of them.
    return float(np.var(0.5 * np.log(after[drawn] / before[drawn]))) * n / (n - block)


def windows_ratio(baseline: Floats, candidate: Floats) -> RatioInterval:
    """Return the ratio of root mean squares of errors in windows of one dive, in the order of time, shape (k,)."""
    usable = np.isfinite(baseline) & np.isfinite(candidate)
    before, after = baseline[usable], candidate[usable]
    if len(before) < 2 or not (before.any() and after.any()):
        return NO_INTERVAL
    # The squares of a diverged filter's drifts may overflow.
    return paired_ratio(
        (before / before.max()) ** 2,
        (after / after.max()) ** 2,
        is_correlated=len(before) >= FEWEST_CORRELATED,
        log_scale=float(np.log(after.max()) - np.log(before.max())),
    )


def dives_ratio(log_ratios: Floats) -> RatioInterval:
    """Return the geometric mean of the ratios of several dives, with Student's intervals: each dive is one sample."""
    known = log_ratios[np.isfinite(log_ratios)]
    n = len(known)
    if n < 2:
        return NO_INTERVAL._replace(ratio=float(np.exp(known[0])) if n else NAN, effective_samples=float(n))
    return _student_interval(float(known.mean()), float(known.std(ddof=1)) / math.sqrt(n), n - 1.0, float(n))


def _student_interval(log_ratio: float, log_sd: float, freedom: float, effective_samples: float) -> RatioInterval:
    widths = [float(stdtrit(min(freedom, NORMAL), tail)) * log_sd for tail in TAILS]
    ends = [log_ratio + sign * width for width in widths for sign in (-1.0, 1.0)]
    # A diverged filter may have an infinite ratio.
    with np.errstate(over="ignore", invalid="ignore"):
        ratio, low, high, low90, high90 = np.exp([log_ratio, *ends]).tolist()
    return RatioInterval(ratio, low, high, low90, high90, effective_samples, freedom)


def verdict_of_interval(interval: RatioInterval, fewest: float = FEWEST_EFFECTIVE) -> EvidenceVerdict:
    """Return better or worse where the ratio is surely beyond the margin, equivalent surely inside, or undecided.

    Equivalent is two one-sided tests at 5 %. With too few effective samples the verdict is undecided.
    """
    least, most = 1.0 / (1.0 + MARGIN), 1.0 + MARGIN
    if not interval.effective_samples >= fewest:
        return EvidenceVerdict.UNDECIDED
    if least <= interval.low90 and interval.high90 <= most:
        return EvidenceVerdict.EQUIVALENT
    if not interval.p < LARGEST_P:
        return EvidenceVerdict.UNDECIDED
    return EvidenceVerdict.BETTER if interval.ratio < 1.0 else EvidenceVerdict.WORSE


def what_settles(interval: RatioInterval, dives: int) -> str:
    """Say how many dives find a difference of 10 % in four of five cases, with this scatter over dives."""
    beyond = math.log((1.0 + SETTLED) / (1.0 + MARGIN))
    needed = (POWER * interval.log_sd * math.sqrt(dives) / beyond) ** 2 + SMALL_SAMPLE
    if not needed > dives:
        return ""
    these = "this one" if dives == 1 else "these"
    return f"at least {math.ceil(needed)} dives like {these} would show a difference of {100.0 * SETTLED:.0f} %"
