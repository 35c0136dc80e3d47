"""Whether a candidate beats the baseline over several dives: exact tests and intervals, for there are few of them.

Each dive is one independent pair, however long it is. Sources: Hodges and Lehmann, "Estimates of location based on rank
tests", 1963; Hollander and Wolfe, "Nonparametric statistical methods", chapter 3, for the interval of Walsh averages;
Demšar, "Statistical comparisons of classifiers over multiple data sets", 2006, and Holm, 1979.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.paired_statistics import DRAWS, NAN, SEED, Indices, RatioInterval

NOT_BELOW: Final = 1.0 - 1e-12
"""Of what is added up to a probability; a sum of halves that should be the same is not always to the last bit."""


class Pooled(NamedTuple):
    """Candidate over baseline, over dives: the interval is exact, and is the range of fewer than six dives."""

    ratio: float
    low: float
    high: float
    low90: float
    high90: float
    p: float
    won: int
    dives: int

    @property
    def interval(self) -> RatioInterval:
        """What `paired_statistics.word_of` judges; each dive is one independent sample."""
        return RatioInterval(self.ratio, self.low, self.high, self.low90, self.high90, float(self.dives))


def pooled_ratio(log_ratios: Floats) -> Pooled:
    """Return the Hodges-Lehmann ratio over dives, its exact intervals and the exact Wilcoxon signed-rank p.

    Parameters
    ----------
    log_ratios : ndarray, shape (n,)
        Of candidate over baseline, one for each dive. What is not finite is left out.

    Returns
    -------
    Pooled
        p is two-sided and at least ``2 / 2^n``. Dives where both filters are equal are left out of the test, as
        Wilcoxon did, and stay in the estimate; dives won are those below 1.
    """
    known = log_ratios[np.isfinite(log_ratios)]
    n = len(known)
    if not n:
        return Pooled(NAN, NAN, NAN, NAN, NAN, NAN, 0, 0)
    first, second = np.triu_indices(n)
    averages = np.sort((known[first] + known[second]) / 2.0)
    low, high, low90, high90 = np.exp([*_walsh_ends(averages, n, 0.025), *_walsh_ends(averages, n, 0.05)]).tolist()
    ratio, won = float(np.exp(np.median(averages))), int(np.sum(known < 0.0))
    return Pooled(ratio, low, high, low90, high90, _signed_rank_p(known), won, n)


def cluster_interval(log_ratios_by_dive: Sequence[Floats]) -> tuple[float, float]:
    """Return the 95 % interval of the median ratio over the windows of several dives.

    Dives are drawn with replacement, then windows inside each of them: windows of one dive err alike.

    Parameters
    ----------
    log_ratios_by_dive : sequence of ndarray, shape (windows,)
        For each dive. Dives without a window are left out.

    Returns
    -------
    low, high : float
        As ratios; NaN without a window.
    """
    dives = [windows for windows in log_ratios_by_dive if len(windows)]
    if not dives:
        return float("nan"), float("nan")
    counts = np.array([len(windows) for windows in dives])
    # Rows of one length; infinity stands behind the windows of a short dive, and after sorting behind all of them.
    table = np.full((len(dives), counts.max()), np.inf)
    for row, windows in zip(table, dives, strict=True):
        row[: len(windows)] = windows
    rng = np.random.default_rng(SEED)
    dive = rng.integers(0, len(dives), (DRAWS, len(dives), 1))
    window = (rng.random((DRAWS, len(dives), counts.max())) * counts[dive]).astype(np.int64)
    drawn = np.where(np.arange(counts.max()) < counts[dive], table[dive, window], np.inf).reshape(DRAWS, -1)
    medians = _medians_of_first(np.sort(drawn, axis=1), counts[dive].sum(axis=(1, 2)))
    low, high = np.exp(np.quantile(medians, [0.025, 0.975])).tolist()
    return low, high


def holm(p_values: Floats) -> Floats:
    """Return p-values adjusted for their number, so that at most a share p of such families holds a false one.

    Parameters
    ----------
    p_values : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        In the order they came in, at most 1.
    """
    order = np.argsort(p_values, kind="stable")
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.maximum.accumulate(p_values[order] * np.arange(len(p_values), 0, -1))
    return np.minimum(adjusted, 1.0)


def _walsh_ends(averages: Floats, n: int, tail: float) -> tuple[float, float]:
    """Return the ends of an interval with at most a tail beyond each; the range where n is too small for it."""
    below = np.cumsum(_rank_sum_probabilities(2 * np.arange(1, n + 1))[::2])
    outside = max(int(np.searchsorted(below, tail * NOT_BELOW)), 1)
    return float(averages[outside - 1]), float(averages[-outside])


def _signed_rank_p(log_ratios: Floats) -> float:
    """Return the two-sided p of the signed-rank sum, each sign as likely as the other; 1 where all are zero."""
    differing = log_ratios[log_ratios != 0.0]
    if not len(differing):
        return 1.0
    _, size, alike = np.unique(np.abs(differing), return_inverse=True, return_counts=True)
    # Those alike share the mean of their ranks, which is a whole number when doubled.
    ranks = (2 * np.cumsum(alike) - alike + 1)[size]
    positive = int(ranks[differing > 0.0].sum())
    smaller = min(positive, int(ranks.sum()) - positive)
    return float(min(1.0, 2.0 * _rank_sum_probabilities(ranks)[: smaller + 1].sum()))


def _rank_sum_probabilities(ranks: Indices) -> Floats:
    """Return the probability of every sum of ranks that are each taken or left with one half."""
    probabilities = np.zeros(int(ranks.sum()) + 1)
    probabilities[0] = 1.0
    for rank in ranks.tolist():
        probabilities[rank:] = (probabilities[rank:] + probabilities[:-rank]) / 2.0
        probabilities[:rank] /= 2.0
    return probabilities


def _medians_of_first(values: Floats, counts: Indices) -> Floats:
    """Return the median of so many first values of each sorted row."""
    rows = np.arange(len(values))
    medians: Floats = (values[rows, (counts - 1) // 2] + values[rows, counts // 2]) / 2.0
    return medians
