"""Tests and intervals over dives against scipy, against every assignment of signs, and at the edges."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import rankdata, wilcoxon

from insdvl_replay.core.words import EvidenceWord
from insdvl_replay.evaluation.over_dives import cluster_interval, holm, pooled_ratio
from insdvl_replay.evaluation.paired_statistics import word_of


@pytest.mark.parametrize("dives", [1, 2, 5, 6, 8, 13, 30])
def test_p_is_that_of_scipy(dives: int) -> None:
    for log_ratios in np.random.default_rng(dives).normal(0.2, 1.0, (20, dives)):
        expected = wilcoxon(log_ratios, method="exact").pvalue
        assert pooled_ratio(log_ratios).p == pytest.approx(expected, rel=1e-12)


def test_p_with_ties_and_zeros_is_that_of_every_assignment_of_signs() -> None:
    log_ratios = np.array([0.0, -0.1, -0.1, 0.1, -0.2, -0.2, -0.3, 0.4])
    ranks = rankdata(np.abs(log_ratios[1:]))
    sums = np.array([ranks @ signs for signs in product([0.0, 1.0], repeat=7)])
    smaller = min(ranks @ (log_ratios[1:] > 0), ranks @ (log_ratios[1:] < 0))
    assert pooled_ratio(log_ratios).p == pytest.approx(min(1.0, 2.0 * np.mean(sums <= smaller)), rel=1e-12)


@pytest.mark.parametrize("dives", [1, 3, 5])
def test_few_dives_give_their_range_and_never_a_small_p(dives: int) -> None:
    log_ratios = -0.5 - 0.01 * np.arange(dives)
    pooled = pooled_ratio(log_ratios)
    assert pooled.p == min(1.0, 2.0 / 2.0**dives)
    assert pooled.p > 0.05
    assert (pooled.low, pooled.high) == pytest.approx((np.exp(log_ratios.min()), np.exp(log_ratios.max())))
    assert (pooled.low90, pooled.high90) == (pooled.low, pooled.high)
    assert (pooled.won, pooled.dives) == (dives, dives)
    assert word_of(pooled.interval) == EvidenceWord.UNDECIDED


def test_six_dives_that_agree_are_the_fewest_that_decide() -> None:
    pooled = pooled_ratio(np.log([0.5, 0.6, 0.7, 0.8, 0.75, 0.65]))
    assert pooled.p == 2.0 / 2.0**6
    assert word_of(pooled.interval) == EvidenceWord.BETTER


@pytest.mark.parametrize("dives", [6, 7, 8, 13, 20])
def test_interval_is_where_the_test_does_not_reject(dives: int) -> None:
    log_ratios = np.random.default_rng(dives).normal(-0.1, 0.4, dives)
    pooled = pooled_ratio(log_ratios)
    for low, high, level in ((pooled.low, pooled.high, 0.05), (pooled.low90, pooled.high90, 0.10)):
        for end, outwards in ((np.log(low), -1.0), (np.log(high), 1.0)):
            inside, outside = (
                wilcoxon(log_ratios - end + step * outwards, method="exact").pvalue for step in (1e-9, -1e-9)
            )
            assert inside > level
            assert outside <= level


def test_hodges_lehmann_is_the_median_of_walsh_averages() -> None:
    assert pooled_ratio(np.array([0.0, 1.0, 5.0])).ratio == pytest.approx(np.exp(1.75))
    assert pooled_ratio(np.full(8, -0.2)).ratio == pytest.approx(np.exp(-0.2))


def test_dives_without_a_number_are_left_out_and_equal_dives_decide_nothing() -> None:
    log_ratios = np.array([-0.3, np.nan, -0.1, np.inf])
    assert pooled_ratio(log_ratios) == pooled_ratio(log_ratios[[0, 2]])
    equal = pooled_ratio(np.zeros(8))
    assert (equal.ratio, equal.low, equal.high, equal.p, equal.won) == (1.0, 1.0, 1.0, 1.0, 0)
    assert word_of(equal.interval) == EvidenceWord.EQUIVALENT
    nothing = pooled_ratio(np.array([np.nan]))
    assert np.isnan(nothing.ratio)
    assert nothing.dives == 0
    assert word_of(nothing.interval) == EvidenceWord.UNDECIDED


def test_cluster_interval_holds_what_is_true_where_dives_differ() -> None:
    rng, held = np.random.default_rng(1), []
    for _ in range(150):
        dives = [rng.normal(-0.2 + 0.3 * rng.standard_normal(), 0.3, rng.integers(4, 9)) for _ in range(12)]
        low, high = cluster_interval(dives)
        held.append(low <= np.exp(-0.2) <= high)
    assert 0.86 <= np.mean(held) <= 0.99


def test_cluster_interval_of_one_value_a_dive_is_that_of_dives() -> None:
    same = cluster_interval([np.full(count, -0.3) for count in (1, 4, 9)])
    assert same == pytest.approx((np.exp(-0.3), np.exp(-0.3)))
    low, high = cluster_interval([np.full(5, 0.1), np.full(5, 0.2), np.empty(0)])
    assert (low, high) == pytest.approx((np.exp(0.1), np.exp(0.2)))
    assert np.isnan(cluster_interval([])).all()


def test_holm_has_the_textbooks_numbers() -> None:
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, 0.7])), [1.0, 1.0])
    assert holm(np.empty(0)).size == 0
