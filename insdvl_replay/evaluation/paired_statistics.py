"""Whether a candidate beats the baseline: ratios of paired errors over one dive, their intervals, and their word.

Filters of one dive share its sensors and its reference, so that what they lose at one time is compared pair by pair,
and time is redrawn in blocks that keep neighbouring errors together. Ratios are means and differences of logarithms
inside; below 1 the candidate is better. Sources: Künsch, "The jackknife and the bootstrap for general stationary
observations", 1989, for moving blocks; Diebold and Mariano, "Comparing predictive accuracy", 1995, for the
differential of losses; Satterthwaite, 1946, for the freedom of a sum of variances; Schuirmann, 1987, for equivalence;
Kish, "Survey sampling", 1965, for the number of stretches that count.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.words import EvidenceWord
from insdvl_replay.evaluation.effective_samples import block_length, samples_in_mean, slow_part

MARGIN: Final = 0.05
"""A difference of less than this share is none that matters."""
FEWEST_EFFECTIVE: Final = 6.0
"""Fewer independent samples of one dive decide nothing."""
LARGEST_P: Final = 0.01
"""A row decides below it. On equal filters any row of three dives decides in 0.2 % of cases (`make judge`)."""
SETTLED: Final = 0.10
POWER: Final = 2.33 + 0.84
"""Standard deviations by which a difference must exceed the margin to have a p below 0.01 in four of five cases."""
SMALL_SAMPLE: Final = 2.7
"""Samples that Student's distribution needs beside the normal one: half the square of 2.33 (Guenther, 1981)."""
STRETCHES: Final = 8
FEWEST_STRETCHES: Final = 2.5
"""Of eight stretches of a dive fewer that count are as many samples, however long they are."""
DRAWS: Final = 2000
SEED: Final = 20_260_000
WIDER_THAN_OPTIMAL: Final = 3
"""Blocks that estimate a variance best make its intervals too short: longer ones are noisier, and less biased."""
FEWEST_CORRELATED: Final = 20
"""Of fewer windows nothing tells how they are correlated. Each is a restart: over simulated dives they are not."""
MOST_VALUES: Final = 1000
"""Of a longer series neighbours are first averaged, so that hours at 10 Hz are drawn as fast as minutes."""
TAILS: Final = (0.975, 0.95)
"""Upper ends of the 95 % interval, and of the 90 % interval by which equivalence is judged."""
NORMAL: Final = 1e6
"""With so much freedom Student's distribution is the normal one."""
NAN: Final = float("nan")

Indices = NDArray[np.int64]


class RatioInterval(NamedTuple):
    """Candidate over baseline, with the 95 % and the 90 % interval; all NaN where nothing could be compared.

    Student's intervals have a freedom, which may be much less than the effective samples by which a word is allowed.
    The stretch is that of `STRETCHES`, from 0, which holds nearly all of the errors, if there is one.
    """

    ratio: float
    low: float
    high: float
    low90: float
    high90: float
    effective_samples: float
    freedom: float = math.inf
    stretch: int | None = None
    drawn_p: float = math.nan
    """Of intervals that are not Student's: the share of drawn ratios on the other side of the margin."""

    @property
    def log_sd(self) -> float:
        """Standard deviation of the logarithm of the ratio; NaN where an end is beyond all numbers."""
        known = 0.0 < self.low <= self.high < math.inf
        return math.log(self.high / self.low) / (2.0 * _student(self.freedom, TAILS[0])) if known else NAN

    @property
    def p(self) -> float:
        """Of a difference of at most the margin: of one as large as this if the true one is no larger."""
        if not math.isnan(self.drawn_p):
            return self.drawn_p
        beyond = abs(math.log(self.ratio)) - math.log(1.0 + MARGIN) if self.ratio > 0.0 else NAN
        if not self.log_sd > 0.0:
            return NAN if math.isnan(beyond) else float(beyond <= 0.0)
        return float(stdtr(min(self.freedom, NORMAL), -beyond / self.log_sd))

    @property
    def independent(self) -> float:
        """How many independent values the interval rests on: never more than it has degrees of freedom, and one."""
        return min(self.effective_samples, self.freedom + 1.0)


def _student(freedom: float, tail: float) -> float:
    return float(stdtrit(min(freedom, NORMAL), tail))


NOTHING: Final = RatioInterval(NAN, NAN, NAN, NAN, NAN, 0.0)


def paired_ratio(
    baseline_sq: Floats,
    candidate_sq: Floats,
    *,
    least_block: int = 1,
    is_correlated: bool = True,
    log_scale: float = 0.0,
) -> RatioInterval:
    """Return the ratio of root mean squares of two filters' errors over the same times of one dive.

    The standard deviation of its logarithm is that over moving blocks of time, drawn alike for both filters and all
    starts; with several starts that over starts is added. The interval is Student's, with the number of blocks and of
    starts for its freedom.

    Parameters
    ----------
    baseline_sq, candidate_sq : ndarray, shape (k,) or (s, k)
        Squared losses, evenly spaced in time, of one start or of s drawn starts of the same dive. A time at which one
        of them is not finite is left out.
    least_block : int
        How many values a loss overlaps with, such as the length of a segment in steps.
    is_correlated : bool
        Whether neighbours may tell the same, so that their correlation is looked for.
    log_scale : float
        Logarithm of the candidate's unit over the baseline's.

    Returns
    -------
    RatioInterval
        Its effective samples are those of the differential of the losses, over time and starts.
    """
    baseline, candidate = _finite_pairs(np.atleast_2d(baseline_sq), np.atleast_2d(candidate_sq))
    if np.array_equal(baseline, candidate) and baseline.size and not log_scale:
        return RatioInterval(1.0, 1.0, 1.0, 1.0, 1.0, float(baseline.size))
    if baseline.shape[1] < 2 or not (baseline.any() and candidate.any()):
        return NOTHING
    log_ratio = 0.5 * float(np.log(candidate.mean() / baseline.mean())) + log_scale
    together = -(-baseline.shape[1] // MOST_VALUES)
    baseline, candidate = _averaged(baseline, together), _averaged(candidate, together)
    differential = 0.5 * (candidate / candidate.mean() - baseline / baseline.mean())
    block = _block(differential.mean(axis=0), -(-least_block // together)) if is_correlated else 1
    time_variance = _block_variance(baseline.mean(axis=0), candidate.mean(axis=0), block)
    start_variance = _block_variance(baseline.mean(axis=1), candidate.mean(axis=1), 1) if len(baseline) > 1 else 0.0
    freedom = _freedom(time_variance, baseline.shape[1] / block - 1.0, start_variance, len(baseline) - 1.0)
    log_sd = float(np.sqrt(time_variance + start_variance))
    samples = _effective_over_starts(differential) if is_correlated else float(differential.size)
    return _one_sample(_student_interval(log_ratio, log_sd, freedom, samples), baseline, candidate)


def ratio_beside_starts(baseline_sq: Floats, candidate_sq: Floats, *, least_block: int = 1) -> RatioInterval:
    """Return the ratio of the root mean square of one run to that of a baseline's runs, in the mean of logarithms.

    The one run has a start of its own, of which it is one draw, as each of the baseline's: what starts scatter by
    counts once for the run, and once over the number of starts for the mean that it is held against.

    Parameters
    ----------
    baseline_sq : ndarray, shape (s, k)
        Squared losses from s starts, two at least, evenly spaced in time. A time at which one is not finite is left
        out.
    candidate_sq : ndarray, shape (k,)
        Of the one run.
    least_block : int
        As of `paired_ratio`.
    """
    baseline, candidate = _finite_pairs(baseline_sq, np.broadcast_to(candidate_sq, baseline_sq.shape))
    if baseline.shape[1] < 2 or not (baseline.any(axis=1).all() and candidate.any()):
        return NOTHING
    logs = 0.5 * np.log(candidate.mean(axis=1) / baseline.mean(axis=1))
    together = -(-baseline.shape[1] // MOST_VALUES)
    baseline, candidate = _averaged(baseline, together), _averaged(candidate, together)
    differential = 0.5 * (candidate / candidate.mean() - baseline / baseline.mean())
    block = _block(differential.mean(axis=0), -(-least_block // together))
    time_variance = _block_variance(baseline.mean(axis=0), candidate[0], block)
    start_variance = float(logs.var(ddof=1)) * (1.0 + 1.0 / len(logs))
    freedom = _freedom(time_variance, baseline.shape[1] / block - 1.0, start_variance, len(logs) - 1.0)
    log_sd = float(np.sqrt(time_variance + start_variance))
    interval = _student_interval(float(logs.mean()), log_sd, freedom, _effective_over_starts(differential))
    return _one_sample(interval, baseline, candidate)


def windows_ratio(baseline: Floats, candidate: Floats) -> RatioInterval:
    """Return the ratio of root mean squares of two filters' errors over windows of one dive, such as coasting drifts.

    Parameters
    ----------
    baseline, candidate : ndarray, shape (k,)
        Errors, in the order of time. A window in which one of them is not finite is left out.
    """
    usable = np.isfinite(baseline) & np.isfinite(candidate)
    before, after = baseline[usable], candidate[usable]
    if len(before) < 2 or not (before.any() and after.any()):
        return NOTHING
    # Drifts of a filter that broke down have squares beyond all numbers.
    return paired_ratio(
        (before / before.max()) ** 2,
        (after / after.max()) ** 2,
        is_correlated=len(before) >= FEWEST_CORRELATED,
        log_scale=float(np.log(after.max()) - np.log(before.max())),
    )


def dives_ratio(log_ratios: Floats) -> RatioInterval:
    """Return the geometric mean of the ratios of several dives, with Student's intervals: each dive is one sample.

    Parameters
    ----------
    log_ratios : ndarray, shape (n,)
        Of candidate over baseline, one for each dive. What is not finite is left out.
    """
    known = log_ratios[np.isfinite(log_ratios)]
    n = len(known)
    if n < 2:
        return NOTHING._replace(ratio=float(np.exp(known[0])) if n else NAN, effective_samples=float(n))
    log_sd = float(known.std(ddof=1)) / math.sqrt(n)
    return _student_interval(float(known.mean()), log_sd, n - 1.0, float(n))


def word_of(interval: RatioInterval, fewest: float = FEWEST_EFFECTIVE) -> EvidenceWord:
    """Judge a ratio: better or worse where it is surely beyond the margin, equivalent surely inside, or undecided.

    Equivalent is two one-sided tests at 5 %. Too few effective samples decide nothing.
    """
    least, most = 1.0 / (1.0 + MARGIN), 1.0 + MARGIN
    if not interval.effective_samples >= fewest:
        return EvidenceWord.UNDECIDED
    if least <= interval.low90 and interval.high90 <= most:
        return EvidenceWord.EQUIVALENT
    if not interval.p < LARGEST_P:
        return EvidenceWord.UNDECIDED
    return EvidenceWord.BETTER if interval.ratio < 1.0 else EvidenceWord.WORSE


def what_settles(interval: RatioInterval, dives: int) -> str:
    """Say how many dives show a difference of 10 % in four of five cases, if ratios scatter so over dives."""
    beyond = math.log((1.0 + SETTLED) / (1.0 + MARGIN))
    needed = (POWER * interval.log_sd * math.sqrt(dives) / beyond) ** 2 + SMALL_SAMPLE
    if not needed > dives:
        return ""
    share = f"{100.0 * SETTLED:.0f} %"
    return f"about {math.ceil(needed)} dives like {'this one' if dives == 1 else 'these'} would settle {share}"


def _one_sample(interval: RatioInterval, baseline: Floats, candidate: Floats) -> RatioInterval:
    """Let errors of which nearly all are in one of eight stretches of the dive count as the samples that they are."""
    paired = (baseline / baseline.mean() + candidate / candidate.mean()).mean(axis=0)
    sums = np.array([part.sum() for part in np.array_split(paired, STRETCHES)])
    counting = float(sums.sum() ** 2 / (sums**2).sum())
    if counting >= FEWEST_STRETCHES:
        return interval
    samples = min(interval.effective_samples, counting)
    return interval._replace(effective_samples=samples, stretch=int(np.argmax(sums)))


def _finite_pairs(baseline: Floats, candidate: Floats) -> tuple[Floats, Floats]:
    known = (np.isfinite(baseline) & np.isfinite(candidate)).all(axis=0)
    return baseline[:, known], candidate[:, known]


def _averaged(losses: Floats, together: int) -> Floats:
    """Average so many neighbouring times at once; what does not fill the last group is left out."""
    starts, times = losses.shape
    groups = times // together
    averages: Floats = losses[:, : groups * together].reshape(starts, groups, together).mean(axis=2)
    return averages


def _block(values: Floats, least_block: int) -> int:
    """Return how many neighbours are drawn together: as the slow part asks for, at most a third of the values."""
    averages, together = slow_part(values)
    optimal = max(block_length(values), together * block_length(averages) if block_length(averages) > 1 else 1)
    wanted = WIDER_THAN_OPTIMAL * optimal if optimal > 1 else 1
    return max(1, min(max(wanted, least_block), len(values) // 3))


def _first_of_blocks(n: int, block: int) -> Indices:
    """Draw where the blocks begin that fill n values, shape (draws, blocks)."""
    return np.random.default_rng(SEED).integers(0, n - block + 1, (DRAWS, -(-n // block)))


def _block_variance(baseline: Floats, candidate: Floats, block: int) -> float:
    """Return the variance of the logarithm of the ratio of root means over drawn blocks."""
    n = len(baseline)
    first = _first_of_blocks(n, block)
    before, after = (np.convolve(loss, np.ones(block), "valid")[first].sum(axis=1) for loss in (baseline, candidate))
    drawn = (before > 0.0) & (after > 0.0)
    # Blocks scatter about the mean of the same n values, which takes the freedom of one of them.
    return float(np.var(0.5 * np.log(after[drawn] / before[drawn]))) * n / (n - block)


def _freedom(first: float, first_freedom: float, second: float, second_freedom: float) -> float:
    """Return the degrees of freedom of a sum of two variances (Satterthwaite); at least 1."""
    if not second > 0.0:
        return max(first_freedom, 1.0)
    parts = first**2 / max(first_freedom, 1.0) + second**2 / max(second_freedom, 1.0)
    return (first + second) ** 2 / parts


def _student_interval(log_ratio: float, log_sd: float, freedom: float, effective: float) -> RatioInterval:
    widths = [_student(freedom, tail) * log_sd for tail in TAILS]
    ends = [log_ratio + sign * width for width in widths for sign in (-1.0, 1.0)]
    return _interval(log_ratio, ends, effective, freedom)


def _interval(log_ratio: float, log_ends: Sequence[float], effective: float, freedom: float) -> RatioInterval:
    # A filter that broke down may be worse beyond all numbers: infinitely.
    with np.errstate(over="ignore", invalid="ignore"):
        low, high, low90, high90 = np.exp(log_ends).tolist()
    return RatioInterval(float(np.exp(log_ratio)), low, high, low90, high90, effective, freedom)


def _effective_over_starts(differential: Floats) -> float:
    """Return the variance of one value over that of the mean over times and starts."""
    starts = len(differential)
    over_time = differential.mean(axis=0)
    samples = samples_in_mean(over_time)
    if starts == 1:
        return samples
    of_mean = over_time.var() / samples + differential.mean(axis=1).var(ddof=1) / starts
    return float(np.clip(differential.var() / of_mean, 1.0, differential.size)) if of_mean > 0.0 else 1.0
