"""The rule of every verdict: one ratio over dives, its interval, and a band of a factor 1.05 to each side of 1.

Each dive gives one logarithm of a ratio, candidate over baseline. The interval is Student's t of these logarithms over
dives, or over the means of vehicles. A second interval may be looked at after every dive of an archive that grows.

Sources: Student, "The probable error of a mean", 1908; Satterthwaite, 1946 (freedom of a sum of variances); Holm, "A
simple sequentially rejective multiple test procedure", 1979; Lai, "On confidence sequences", 1976, and Wang and Ramdas,
"Anytime-valid t-tests and confidence sequences for Gaussian means with unknown variance", 2025 (intervals for every
look).
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.special import nctdtr, stdtr, stdtrit

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import FEWEST_DIVES
from insdvl_replay.core.words import EvidenceVerdict

BAND: Final = 1.05  # A ratio within this factor of 1 makes no difference.
LEVEL: Final = 0.95
FEWEST_VEHICLES: Final = 3  # From so many on, each vehicle is one sample.
# Weight of the dives against the width that an interval for every look begins with; 4 suits archives of 5 to 50 dives.
PRIOR_WEIGHT: Final = 4.0
POWER: Final = 0.8  # "in four of five cases"
MOST_DIVES: Final = 1000  # that are planned for
NAN: Final = math.nan


class Interval(NamedTuple):
    """Candidate over baseline, with its interval; the ends are NaN with fewer than three dives."""

    ratio: float  # geometric mean
    low: float
    high: float
    low_always: float  # for all looks together
    high_always: float
    dives: int  # with a finite ratio
    vehicles: int
    scatter: float  # standard deviation of the logarithms over dives, within vehicles where there are several
    p: float  # probability of such data if the true ratio were at the nearer end of the band


def log_ratio_interval(
    log_ratios: Sequence[float] | Floats,
    *,
    level: float = LEVEL,
    vehicles: Sequence[str] | None = None,
    level_always: float = LEVEL,
) -> Interval:
    """Return the interval of the mean logarithm of several dives.

    Parameters
    ----------
    log_ratios : sequence of float
        Logarithm of candidate over baseline, one for each dive; those that are not finite are left out.
    level : float
        Confidence.
    vehicles : sequence of str, optional
        The vehicle of each dive. From three vehicles on, each mean over a vehicle's dives is one sample. Two vehicles
        have equal weight, and the scatter is that of the dives within them.
    level_always : float
        Confidence of the interval for every look.
    """
    logs = np.asarray(log_ratios, np.float64)
    if vehicles is None:
        vehicles = [""] * len(logs)
    names = np.asarray([*vehicles])
    known = np.isfinite(logs)
    logs = logs[known]
    names = names[known]
    groups = [logs[names == name] for name in dict.fromkeys(names.tolist())]
    mean, error, freedom, scatter = _mean_and_error(groups)
    n = len(logs)
    ratio = _exp(mean)
    if n < FEWEST_DIVES or not freedom >= 1.0:
        return Interval(ratio, NAN, NAN, NAN, NAN, n, len(groups), scatter, NAN)
    half = float(stdtrit(freedom, 0.5 + 0.5 * level)) * error
    half_always = error * quantile_always(round(freedom) + 1, level_always)
    return Interval(
        ratio=ratio,
        low=_exp(mean - half),
        high=_exp(mean + half),
        low_always=_exp(mean - half_always),
        high_always=_exp(mean + half_always),
        dives=n,
        vehicles=len(groups),
        scatter=scatter,
        p=_p(mean, error, freedom),
    )


class RunSpread(NamedTuple):
    """How far repeated runs of the same dives differ in one quantity."""

    variance: float  # of the logarithm of the ratio, from run to run
    freedom: int

    def half_width(self, level: float) -> float:
        """Return the half width of the interval that holds a share of the log ratios of single runs."""
        if self.freedom < 1 or not self.variance > 0.0:
            return 0.0
        quantile = float(stdtrit(self.freedom, 0.5 + 0.5 * level))
        return quantile * math.sqrt(self.variance)


def run_spread(old: Iterable[Sequence[float]], new: Iterable[Sequence[float]]) -> RunSpread:
    """Return the spread of repeated runs, by the logarithms of the errors of each dive's runs on both sides.

    A side without repeated runs adds nothing. The side with fewer degrees of freedom gives these.
    """
    variance = 0.0
    freedoms = list[int]()
    for side in (old, new):
        squares = 0.0
        freedom = 0
        for runs in side:
            logs = np.asarray(runs, np.float64)
            logs = logs[np.isfinite(logs)]
            if len(logs) > 1:
                squares += float(((logs - logs.mean()) ** 2).sum())
                freedom += len(logs) - 1
        if squares > 0.0:
            variance += squares / freedom
            freedoms.append(freedom)
    return RunSpread(variance, min(freedoms, default=0))


def widened(interval: Interval, spread: RunSpread, level: float) -> Interval:
    """Return an interval that is at least as wide as single runs differ from each other."""
    half = spread.half_width(level)
    if half == 0.0 or not math.isfinite(interval.low):
        return interval
    low = interval.ratio * math.exp(-half)
    high = interval.ratio * math.exp(half)
    return interval._replace(
        low=min(interval.low, low),
        high=max(interval.high, high),
        low_always=min(interval.low_always, low),
        high_always=max(interval.high_always, high),
    )


NO_SPREAD: Final = RunSpread(0.0, 0)


def is_by_vehicle(interval: Interval) -> bool:
    """Return whether vehicles are the samples and have several dives, so that more dives do not make it narrower."""
    return FEWEST_VEHICLES <= interval.vehicles < interval.dives


def _mean_and_error(groups: Sequence[Floats]) -> tuple[float, float, float, float]:
    """Return the mean of logarithms, its standard error, the degrees of freedom, and the scatter of dives."""
    if not groups:
        return NAN, NAN, NAN, NAN
    sizes = np.array([len(group) for group in groups], np.float64)
    within = float(sum(((group - group.mean()) ** 2).sum() for group in groups))
    spare = float(sizes.sum()) - len(groups)
    means = np.array([group.mean() for group in groups])
    mean = float(means.mean())
    if len(groups) >= FEWEST_VEHICLES:
        scatter = float(means.std(ddof=1))
        error = scatter / math.sqrt(len(groups))
        if spare > 0.0:
            scatter = math.sqrt(within / spare)
        return mean, error, len(groups) - 1.0, scatter
    if spare <= 0.0:
        return mean, NAN, NAN, NAN
    scatter = math.sqrt(within / spare)
    variances = scatter**2 / sizes
    freedom = spare
    if len(groups) > 1 and sizes.min() > 1.0:
        # Each vehicle has a scatter of its own (Welch).
        variances = np.array([group.var(ddof=1) for group in groups]) / sizes
        if variances.sum() > 0.0:
            freedom = float(variances.sum() ** 2 / (variances**2 / (sizes - 1.0)).sum())
    return mean, math.sqrt(float(variances.sum())) / len(groups), freedom, scatter


def _exp(value: float) -> float:
    """Return the exponential; infinite for a filter that diverged."""
    if value < 700.0:
        return math.exp(value)
    if value == value:
        return math.inf
    return NAN


def _p(mean: float, error: float, freedom: float) -> float:
    beyond = abs(mean) - math.log(BAND)
    if not error > 0.0:
        return float(beyond <= 0.0)
    return float(stdtr(freedom, -beyond / error))


def word_of_interval(low: float, high: float) -> EvidenceVerdict:
    """Return the word of an interval by the band; undecided without one."""
    if high < 1.0 / BAND:
        return EvidenceVerdict.BETTER
    if low > BAND:
        return EvidenceVerdict.WORSE
    if low >= 1.0 / BAND and high <= BAND:
        return EvidenceVerdict.EQUIVALENT
    return EvidenceVerdict.UNDECIDED


def quantile_always(samples: int, level: float = LEVEL) -> float:
    """Return the factor of the standard error for an interval that holds at every look; infinite for few samples."""
    n = float(samples)
    weight = 1.0 + PRIOR_WEIGHT * n
    q = (math.sqrt(weight) / (1.0 - level)) ** (2.0 / n)
    if q >= weight:
        return math.inf
    return math.sqrt((n - 1.0) * (q - 1.0) / (1.0 - q / weight))


def level_of_candidates(count: int, *, named: bool = False, is_named: bool = False) -> float:
    """Return the confidence for one of several candidates, so that together they err as seldom as one.

    A candidate that was named before the run has the full 95 %, and the others share 95 % among them (Bonferroni).
    """
    if is_named:
        return LEVEL
    sharing = max(count - named, 1)
    return 1.0 - (1.0 - LEVEL) / sharing


def holm_levels(p_values: Sequence[float], level: float = LEVEL) -> list[float]:
    """Return the confidence of each interval of a family, so that together they err as seldom as one (Holm).

    The smallest p of k is compared with the k-th part of the error, the next with the (k - 1)-th part, and so on until
    one is not below its part; that and all others have its confidence. NaN stands for a row without an interval.
    """
    allowed = 1.0 - level
    known = [number for number, p in enumerate(p_values) if p == p]
    levels = [level] * len(p_values)
    left = len(known)
    for number in sorted(known, key=lambda number: p_values[number]):
        levels[number] = 1.0 - allowed / left
        # Two tails: the interval leaves the band on one of its sides.
        if left > 1 and 2.0 * p_values[number] < allowed / left:
            left -= 1
    return levels


# --- What several dives can find.


def change_found(scatter: float, dives: int, level: float = LEVEL) -> float:
    """Return the ratio below 1 that so many dives find in four of five cases; NaN for fewer than three dives.

    The logarithm of the ratio is normal over dives with the given standard deviation.
    """
    if dives < FEWEST_DIVES or not scatter >= 0.0:
        return NAN
    freedom = dives - 1.0
    error = scatter / math.sqrt(dives)
    if error == 0.0:
        return 1.0 / BAND
    quantile = float(stdtrit(freedom, 0.5 + 0.5 * level))
    # of the shift beyond the band, in standard errors
    least = 0.0
    most = 100.0
    for _ in range(60):
        shift = 0.5 * (least + most)
        # The statistic is noncentral t; it must exceed the quantile.
        missed = float(nctdtr(freedom, shift, quantile))
        if missed > 1.0 - POWER:
            least = shift
        else:
            most = shift
    return _exp(-(math.log(BAND) + most * error))


def chance_found(scatter: float, dives: int, ratio: float, level: float = LEVEL) -> float:
    """Return how often so many dives find a ratio that is below the band; 0 for fewer than three dives.

    The logarithm of the ratio is normal over dives with the given standard deviation.
    """
    if dives < FEWEST_DIVES:
        return 0.0
    freedom = dives - 1.0
    quantile = float(stdtrit(freedom, 0.5 + 0.5 * level))
    beyond = -math.log(ratio * BAND)
    return 1.0 - float(nctdtr(freedom, beyond * math.sqrt(dives) / scatter, quantile))


def smallest_sign_p(dives: int) -> float:
    """Return the smallest two-sided p of a sign test: the one if all dives are on one side."""
    return math.ldexp(1.0, 1 - dives)


def dives_needed(scatter: float, ratio: float, level: float = LEVEL) -> int | None:
    """Return the fewest dives that find a ratio below 1 in four of five cases; None for more than a thousand."""
    if not change_found(scatter, MOST_DIVES, level) >= ratio:
        return None
    least = FEWEST_DIVES
    most = MOST_DIVES
    while least < most:
        middle = (least + most) // 2
        if change_found(scatter, middle, level) >= ratio:
            most = middle
        else:
            least = middle + 1
    return least
