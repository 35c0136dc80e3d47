"""Intervals of paired ratios against closed forms, and against how often they hold what is true."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student_t
from scipy.stats import ttest_1samp

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.words import EvidenceVerdict
from insdvl_replay.evaluation.series import (
    NO_INTERVAL,
    RatioInterval,
    block_length,
    dives_ratio,
    paired_ratio,
    samples_in_mean,
    verdict_of_interval,
    what_settles,
    windows_ratio,
)


def autoregressive(rng: np.random.Generator, rho: float, *shape: int) -> Floats:
    """Stationary normal series of unit variance along the last axis."""
    noise = rng.standard_normal((*shape[:-1], shape[-1] + 500)) * np.sqrt(1.0 - rho**2)
    series: Floats = lfilter([1.0], [1.0, -rho], noise, axis=-1)[..., 500:]
    return series


def alike_pairs(rng: np.random.Generator, rho: float, runs: int, n: int) -> tuple[Floats, Floats]:
    """Squared errors of two filters that are equally good and share half of what drives them, shape (runs, n)."""
    common, *own = autoregressive(rng, rho, 3, runs, n)
    return (common + own[0]) ** 2 / 2.0, (common + own[1]) ** 2 / 2.0


def segment_pairs(rng: np.random.Generator, runs: int, n: int, segment: int) -> tuple[Floats, Floats]:
    """Squared changes of two random walks in the plane, over overlapping segments."""
    walks = np.cumsum(rng.standard_normal((3, 2, runs, n + segment)), axis=-1)
    common, *own = walks[..., segment:] - walks[..., :-segment]
    return np.sum((common + own[0]) ** 2, axis=0), np.sum((common + own[1]) ** 2, axis=0)


# --- What a series is worth.


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_effective_samples_of_an_autoregressive_series_have_the_closed_form(rho: float) -> None:
    n = 10_000
    series = autoregressive(np.random.default_rng(1), rho, 40, n)
    found = np.median([samples_in_mean(run) for run in series])
    assert found == pytest.approx(n * (1.0 - rho) / (1.0 + rho), rel=0.1)


def test_bias_of_short_series_is_taken_off() -> None:
    series = autoregressive(np.random.default_rng(2), 0.8, 400, 100)
    found = np.median([samples_in_mean(run) for run in series])
    assert found == pytest.approx(100.0 / 9.0, rel=0.25)


@pytest.mark.parametrize(("values", "worth"), [([], 0.0), ([3.0], 1.0), ([2.0] * 50, 1.0), ([1.0, -1.0] * 25, 50.0)])
def test_effective_samples_at_the_edges(values: list[float], worth: float) -> None:
    assert samples_in_mean(np.array(values)) == worth


def test_trend_is_worth_next_to_nothing() -> None:
    assert samples_in_mean(np.arange(200.0)) < 6.0


@pytest.mark.parametrize("rho", [0.3, 0.5, 0.8])
def test_block_length_is_the_optimal_one_of_an_autoregressive_series(rho: float) -> None:
    n = 20_000
    # 2 sum j rho^j and the sum of all rho^|j|, in the formula of Politis and White as corrected by Patton.
    slope, long_run = 2.0 * rho / (1.0 - rho) ** 2, (1.0 + rho) / (1.0 - rho)
    optimal = np.cbrt(1.5 * n * slope**2 / long_run**2)
    found = np.median([block_length(run) for run in autoregressive(np.random.default_rng(3), rho, 20, n)])
    assert found == pytest.approx(optimal, rel=0.25)


def test_block_length_keeps_to_its_bounds() -> None:
    white = np.random.default_rng(4).standard_normal((50, 400))
    assert np.median([block_length(run) for run in white]) <= 3
    assert block_length(np.arange(400.0)) <= 60
    assert block_length(np.ones(400)) == 1
    assert block_length(np.array([1.0, 2.0])) == 1


# --- Paired losses.


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("rho", "n", "least"), [(0.0, 60, 0.92), (0.5, 120, 0.91), (0.9, 60, 0.87), (0.9, 300, 0.88), (0.9, 500, 0.89)]
)
def test_interval_holds_what_is_true_about_as_often_as_it_says(rho: float, n: int, least: float) -> None:
    pairs = zip(*alike_pairs(np.random.default_rng(5), rho, 400, n), strict=True)
    intervals = [paired_ratio(*pair) for pair in pairs]
    # Three standard deviations of 400 draws, some 4 %, below what a thousand pairs and more have: 90 to 95 %.
    assert least <= np.mean([interval.low <= 1.0 <= interval.high for interval in intervals]) <= 0.985
    assert least - 0.07 <= np.mean([interval.low90 <= 1.0 <= interval.high90 for interval in intervals]) <= 0.95


@pytest.mark.nightly
@pytest.mark.parametrize("n", [73, 150])
def test_interval_over_overlapping_segments_holds_what_is_true(n: int) -> None:
    pairs = zip(*segment_pairs(np.random.default_rng(6), 400, n, 12), strict=True)
    intervals = [paired_ratio(*pair, least_block=12) for pair in pairs]
    assert 0.90 <= np.mean([interval.low <= 1.0 <= interval.high for interval in intervals]) <= 0.985


def test_least_block_holds_where_the_losses_look_independent() -> None:
    pairs = list(zip(*alike_pairs(np.random.default_rng(18), 0.0, 40, 90), strict=True))
    short, long = (
        np.median(
            [np.log(high / low) for _, low, high, *_ in (paired_ratio(*pair, least_block=least) for pair in pairs)]
        )
        for least in (1, 30)
    )
    assert long > 1.5 * short, "three blocks leave two degrees of freedom"


def slow_under_noise(rng: np.random.Generator, runs: int, n: int) -> tuple[Floats, Floats]:
    """Squared errors of two filters, half of them fast noise and half slow, such as that of a heading."""
    fast, slow = rng.standard_normal((3, runs, n)), autoregressive(rng, 0.98, 3, runs, n)
    common, *own = fast + slow
    return (common + own[0]) ** 2, (common + own[1]) ** 2


def test_fast_noise_does_not_hide_a_slow_error() -> None:
    intervals = [
        paired_ratio(*pair) for pair in zip(*slow_under_noise(np.random.default_rng(17), 400, 400), strict=True)
    ]
    # Without the averages of neighbours it is 79 %.
    assert 0.85 <= np.mean([interval.low <= 1.0 <= interval.high for interval in intervals]) <= 0.985
    assert np.median([interval.effective_samples for interval in intervals]) < 80.0


def test_ratio_is_that_of_the_root_mean_squares() -> None:
    baseline, candidate = alike_pairs(np.random.default_rng(7), 0.5, 1, 300)
    found = paired_ratio(baseline[0], 0.25 * candidate[0])
    assert found.ratio == pytest.approx(0.5 * np.sqrt(candidate.mean() / baseline.mean()), rel=1e-12)
    assert found.low < found.low90 < found.ratio < found.high90 < found.high
    assert np.sqrt(found.low * found.high) == pytest.approx(found.ratio, rel=1e-12)


def test_pairing_makes_the_interval_short_where_both_filters_err_alike() -> None:
    rng = np.random.default_rng(8)
    error = autoregressive(rng, 0.5, 200)
    paired = paired_ratio(error**2, (error + 0.05 * rng.standard_normal(200)) ** 2)
    apart = paired_ratio(error**2, autoregressive(rng, 0.5, 200) ** 2)
    assert np.log(paired.high / paired.low) < 0.1 * np.log(apart.high / apart.low)


def test_exchanged_filters_have_the_inverse_interval() -> None:
    baseline, candidate = (squared_errors[0] for squared_errors in alike_pairs(np.random.default_rng(9), 0.7, 1, 150))
    there, back = paired_ratio(baseline, candidate), paired_ratio(candidate, baseline)
    expected = [1.0 / there.ratio, 1.0 / there.high, 1.0 / there.low, 1.0 / there.high90, 1.0 / there.low90]
    np.testing.assert_allclose(back[:5], expected, rtol=1e-9)
    assert back.effective_samples == pytest.approx(there.effective_samples, rel=1e-9)


def test_same_losses_are_equal_beyond_doubt() -> None:
    squared_errors = np.random.default_rng(10).random(50)
    assert paired_ratio(squared_errors, squared_errors) == RatioInterval(1.0, 1.0, 1.0, 1.0, 1.0, 50.0)


def test_times_that_are_not_numbers_are_left_out_and_too_few_give_nothing() -> None:
    baseline, candidate = (squared_errors[0] for squared_errors in alike_pairs(np.random.default_rng(11), 0.0, 1, 60))
    holes = baseline.copy()
    holes[[3, 40]] = np.nan, np.inf
    assert paired_ratio(holes, candidate) == paired_ratio(np.delete(baseline, [3, 40]), np.delete(candidate, [3, 40]))
    for few in (np.empty(0), np.array([1.0]), np.full(20, np.nan)):
        np.testing.assert_equal(paired_ratio(few, few + 1.0), NO_INTERVAL)
    np.testing.assert_equal(paired_ratio(baseline, np.zeros(60)), NO_INTERVAL)


def test_long_series_are_averaged_and_as_sure_as_they_scatter() -> None:
    pairs = list(zip(*alike_pairs(np.random.default_rng(16), 0.95, 60, 6_500), strict=True))
    intervals = [paired_ratio(*pair) for pair in pairs]
    for interval, (baseline, candidate) in zip(intervals, pairs, strict=True):
        assert interval.ratio == pytest.approx(np.sqrt(candidate.mean() / baseline.mean()), rel=1e-9)
    scatter = np.std([np.log(interval.ratio) for interval in intervals])
    half = np.median([np.log(interval.high / interval.low) / 2.0 for interval in intervals])
    assert half == pytest.approx(1.96 * scatter, rel=0.3)


@pytest.mark.parametrize("growth", [11.0, 55.0])
def test_filter_that_breaks_down_is_worse_by_numbers_of_any_size(growth: float) -> None:
    found = paired_ratio(np.ones(12), np.exp(growth * np.arange(12)))
    assert found.ratio > 1e20
    assert verdict_of_interval(found) == EvidenceVerdict.WORSE


# --- Drawn starts.


def started(rng: np.random.Generator, runs: int, starts: int, n: int) -> tuple[Floats, Floats]:
    """Errors that stay through a dive as each start drew them, with a little noise, shape (runs, starts, n)."""
    drawn = rng.standard_normal((3, runs, starts, 1)) + 0.3 * rng.standard_normal((3, runs, starts, n))
    return (drawn[0] + drawn[1]) ** 2, (drawn[0] + drawn[2]) ** 2


@pytest.mark.nightly
def test_interval_over_drawn_starts_holds_what_is_true() -> None:
    pairs = zip(*started(np.random.default_rng(12), 300, 16, 60), strict=True)
    intervals = [paired_ratio(*pair) for pair in pairs]
    assert 0.89 <= np.mean([interval.low <= 1.0 <= interval.high for interval in intervals]) <= 0.985
    # Each start is one error, however long it is looked at.
    assert np.median([interval.effective_samples for interval in intervals]) == pytest.approx(16.0, rel=0.25)


def test_starts_whose_errors_stay_are_worth_as_many_as_are_free() -> None:
    """Each of four starts has one ratio through the dive: nothing varies in time, and one mean is taken off."""
    starts, n = 4, 100
    size = 1.0 + 0.01 * np.array([3.0, -1.0, -4.0, 2.0])
    noise = 1.0 + 1e-6 * np.random.default_rng(14).standard_normal((starts, n))
    found = paired_ratio(np.ones((starts, n)), size[:, None] * noise)
    assert found.effective_samples == pytest.approx(starts - 1.0, rel=1e-3)
    sd = 0.5 * size.std(ddof=1) / size.mean() / np.sqrt(starts)
    width = 0.5 * np.log(found.high / found.low)
    assert width == pytest.approx(student_t.isf(0.025, starts - 1) * sd, rel=0.05)


def test_one_start_alone_is_the_same_with_and_without_an_axis() -> None:
    baseline, candidate = alike_pairs(np.random.default_rng(13), 0.5, 1, 100)
    assert paired_ratio(baseline, candidate) == paired_ratio(baseline[0], candidate[0])


# --- Windows.


@pytest.mark.nightly
@pytest.mark.parametrize(("windows", "least"), [(6, 0.92), (10, 0.91), (19, 0.91), (20, 0.91), (60, 0.93)])
def test_ratio_over_windows_holds_what_is_true(windows: int, least: float) -> None:
    """Of horizontal drifts, whose two components are normal."""
    rng = np.random.default_rng(14)
    pairs = np.hypot(*rng.standard_normal((2, 1000, 2, windows)))
    intervals = [windows_ratio(before, 0.8 * after) for before, after in pairs]
    assert least <= np.mean([interval.low <= 0.8 <= interval.high for interval in intervals]) <= 0.97


def test_six_windows_tell_a_filter_that_drifts_tenfold() -> None:
    """One in which the baseline hardly drifts, and one in which the candidate does not, do not hide it."""
    baseline = np.array([0.4, 0.3, 0.002, 0.5, 0.2, 0.4])
    candidate = np.array([5.0, 4.0, 6.0, 0.3, 5.0, 7.0])
    assert verdict_of_interval(windows_ratio(baseline, candidate)) == EvidenceVerdict.WORSE


def test_windows_ratio_is_that_of_root_mean_squares() -> None:
    baseline, candidate = np.array([1.0, 2.0, 2.0, np.nan, 3.0]), np.array([0.5, 1.0, 1.0, 1.0, np.inf])
    assert windows_ratio(baseline, candidate).ratio == pytest.approx(0.5)
    assert windows_ratio(baseline, 1e200 * candidate).ratio == pytest.approx(0.5e200)
    for few in (np.empty(0), np.ones(1)):
        np.testing.assert_equal(windows_ratio(few, 2.0 * few), NO_INTERVAL)


# --- Words.


@dataclass(frozen=True)
class Case:
    """A ratio with the half width of its interval of 95 %, which is that of a normal distribution."""

    ratio: float
    half: float
    effective: float
    verdict: EvidenceVerdict


@pytest.mark.parametrize(
    "case",
    [
        Case(0.80, 0.10, 20.0, EvidenceVerdict.BETTER),
        Case(0.80, 0.10, 5.9, EvidenceVerdict.UNDECIDED),
        Case(0.80, 0.30, 20.0, EvidenceVerdict.UNDECIDED),
        Case(0.80, 0.18, 20.0, EvidenceVerdict.UNDECIDED),
        Case(0.13, 1.5, 20.0, EvidenceVerdict.BETTER),
        Case(0.90, 0.001, 20.0, EvidenceVerdict.BETTER),
        Case(0.97, 0.001, 20.0, EvidenceVerdict.EQUIVALENT),
        Case(0.96, 0.03, 20.0, EvidenceVerdict.UNDECIDED),
        Case(1.03, 0.01, 20.0, EvidenceVerdict.EQUIVALENT),
        Case(1.20, 0.10, 20.0, EvidenceVerdict.WORSE),
        Case(1.20, 0.30, 20.0, EvidenceVerdict.UNDECIDED),
        Case(float("nan"), 0.1, 20.0, EvidenceVerdict.UNDECIDED),
        Case(0.80, 0.10, float("nan"), EvidenceVerdict.UNDECIDED),
    ],
)
def test_word(case: Case) -> None:
    ratio, half = case.ratio, case.half
    ends = ratio * np.exp([-half, half, -0.8 * half, 0.8 * half])
    assert verdict_of_interval(RatioInterval(ratio, *ends.tolist(), case.effective)) == case.verdict


@pytest.mark.parametrize("freedom", [1.0, 5.0, 30.0, np.inf])
def test_p_is_students_of_the_interval(freedom: float) -> None:
    tails = student_t.ppf([0.975, 0.95], freedom) * 0.1
    ends = 0.8 * np.exp([-tails[0], tails[0], -tails[1], tails[1]])
    found = RatioInterval(0.8, *ends.tolist(), 20.0, freedom)
    assert found.log_sd == pytest.approx(0.1, rel=1e-5)
    assert found.p == pytest.approx(student_t.sf(-np.log(0.8 * 1.05) / 0.1, freedom), rel=1e-4)
    assert np.isnan(NO_INTERVAL.p)


# --- One stretch is one sample.


def with_one_stretch(larger: float, share: float = 0.125) -> tuple[Floats, Floats]:
    """Squared errors of equal filters, in a share of the dive so many times larger."""
    baseline, candidate = (squared_errors[0] for squared_errors in alike_pairs(np.random.default_rng(19), 0.3, 1, 800))
    sizes = np.ones(800)
    sizes[400 : 400 + round(800 * share)] = larger
    return sizes * baseline, sizes * candidate


def test_errors_of_one_stretch_count_as_one_sample() -> None:
    """Of eight sums 1, ..., 1, L Kish's number is (7 + L)^2 / (7 + L^2)."""
    found = paired_ratio(*with_one_stretch(1000.0))
    assert found.effective_samples == pytest.approx(1007.0**2 / (7.0 + 1000.0**2), rel=0.01)
    assert found.stretch == 4
    assert verdict_of_interval(found._replace(ratio=0.5)) == EvidenceVerdict.UNDECIDED
    even = paired_ratio(*with_one_stretch(1.0))
    assert even.stretch is None
    assert even.effective_samples > 50.0


def test_errors_of_two_stretches_count_as_two_samples() -> None:
    assert paired_ratio(*with_one_stretch(1000.0, 0.25)).effective_samples == pytest.approx(2.0, rel=0.05)
    assert paired_ratio(*with_one_stretch(1000.0, 0.5)).stretch is None


# --- Several dives.


@pytest.mark.parametrize("dives", [2, 3, 8, 13])
def test_interval_and_p_over_dives_are_those_of_scipy(dives: int) -> None:
    log_ratios = np.random.default_rng(dives).normal(-0.3, 0.2, dives)
    found, expected = dives_ratio(log_ratios), ttest_1samp(log_ratios, 0.0)
    beyond = ttest_1samp(log_ratios, -np.log(1.05), alternative="less")
    assert found.p == pytest.approx(beyond.pvalue, rel=1e-9)
    for ends, level in (((found.low, found.high), 0.95), ((found.low90, found.high90), 0.9)):
        assert np.log(ends) == pytest.approx([*expected.confidence_interval(level)], rel=1e-9)
    assert found.ratio == pytest.approx(np.exp(log_ratios.mean()))


def test_three_dives_that_agree_are_the_fewest_that_decide() -> None:
    log_ratios = np.log([0.70, 0.71, 0.72])
    assert verdict_of_interval(dives_ratio(log_ratios), 3) == EvidenceVerdict.BETTER
    assert verdict_of_interval(dives_ratio(-log_ratios), 3) == EvidenceVerdict.WORSE
    assert verdict_of_interval(dives_ratio(log_ratios[:2]), 3) == EvidenceVerdict.UNDECIDED
    assert verdict_of_interval(dives_ratio(np.log([0.5, 0.7, 0.9])), 3) == EvidenceVerdict.UNDECIDED


def test_dives_without_a_number_are_left_out_and_equal_dives_are_equivalent() -> None:
    log_ratios = np.array([-0.3, np.nan, -0.1, np.inf])
    assert dives_ratio(log_ratios) == dives_ratio(log_ratios[[0, 2]])
    equal = dives_ratio(np.zeros(8))
    assert (equal.ratio, equal.low, equal.high, equal.p) == (1.0, 1.0, 1.0, 1.0)
    assert verdict_of_interval(equal, 3) == EvidenceVerdict.EQUIVALENT
    one, none = dives_ratio(np.array([-0.3])), dives_ratio(np.array([np.nan]))
    assert (one.ratio, one.effective_samples, none.effective_samples) == (np.exp(-0.3), 1.0, 0.0)
    assert verdict_of_interval(one, 3) == verdict_of_interval(none, 3) == EvidenceVerdict.UNDECIDED


def test_what_settles_is_the_number_of_dives_that_find_ten_percent() -> None:
    """Ratios with a standard deviation of 0.04 over dives: (3.17 * 0.04 / ln(1.1 / 1.05))^2 + 2.7 is 10.1."""
    logs = 0.04 * np.array([-1.0, 0.0, 1.0])
    assert re.findall(r"\d+", what_settles(dives_ratio(logs), 3)) == ["11", "10"]
    assert what_settles(dives_ratio(0.1 * logs), 3) == "", "three are enough"
    assert what_settles(NO_INTERVAL, 3) == ""
    drawn = np.random.default_rng(3).normal(-np.log(1.1), 0.04, (1000, 11))
    found = sum(verdict_of_interval(dives_ratio(one), 3) == EvidenceVerdict.BETTER for one in drawn)
    assert 770 <= found <= 850, "four of five"


def test_filters_that_differ_by_the_margin_are_better_in_a_hundredth_of_cases() -> None:
    drawn = np.random.default_rng(4).normal(-np.log(1.05), 0.02, (2000, 8))
    assert sum(verdict_of_interval(dives_ratio(one), 3) == EvidenceVerdict.BETTER for one in drawn) <= 33


def test_same_seed_draws_the_same() -> None:
    baseline, candidate = (squared_errors[0] for squared_errors in alike_pairs(np.random.default_rng(15), 0.5, 1, 100))
    assert paired_ratio(baseline, candidate) == paired_ratio(baseline, candidate)
    assert windows_ratio(baseline, candidate) == windows_ratio(baseline, candidate)


def test_no_more_independent_values_than_the_interval_has_freedom() -> None:
    """White errors in stretches that overlap by ten: the interval counts blocks, of which there are fewer."""
    rng = np.random.default_rng(5)
    before, after = rng.chisquare(1, (2, 400))
    found = paired_ratio(before, after, least_block=10)
    assert found.effective_samples > 100.0
    assert found.independent == pytest.approx(400.0 / 10.0)
    assert paired_ratio(before, before).independent == 400.0


# --- One run beside runs from many starts.


@pytest.mark.nightly
@pytest.mark.parametrize("scatter", [0.0, 0.3, 1.0])
def test_one_run_among_those_of_drawn_starts_is_held_as_often_as_said(scatter: float) -> None:
    """Seventeen runs, alike but for what each start makes of its errors: which of them is the one is an accident.

    Its rms scatters log-normally over starts, as that of a heading error over dives does, about.
    """
    rng, trials, outside = np.random.default_rng(8), 400, 0
    for _ in range(trials):
        size = np.exp(scatter * rng.standard_normal((17, 1)))
        squared = (size * autoregressive(rng, 0.3, 17, 200)) ** 2
        interval = paired_ratio(squared[:16], squared[16])
        outside += not interval.low <= 1.0 <= interval.high
    assert outside <= 0.08 * trials


def test_one_run_is_compared_in_the_mean_of_logarithms() -> None:
    rng = np.random.default_rng(9)
    base = rng.standard_normal((1, 400)) ** 2
    interval = paired_ratio(np.vstack([base, 4.0 * base, 16.0 * base]), 36.0 * base[0])
    assert interval.ratio == pytest.approx(3.0)
    # ln 6, ln 3 and ln 1.5 have a standard deviation of ln 2; the one run's start adds to that of the mean.
    width = np.log(2.0) * np.sqrt(1.0 + 1.0 / 3.0)
    assert np.log(interval.high / interval.ratio) == pytest.approx(4.303 * width, rel=0.02)
    assert paired_ratio(np.vstack([base, base]), np.full(400, np.nan)) == NO_INTERVAL


def test_interval_of_independent_pairs_is_students() -> None:
    """To first order: a logarithm of a ratio scatters as the difference of what each loss is of its mean."""
    n, rng = 400, np.random.default_rng(31)
    baseline_sq, candidate_sq = rng.standard_normal((2, n)) ** 2
    found = paired_ratio(baseline_sq, candidate_sq, is_correlated=False)
    apart = 0.5 * (candidate_sq / candidate_sq.mean() - baseline_sq / baseline_sq.mean())
    for ends, quantile in (((found.low, found.high), 0.975), ((found.low90, found.high90), 0.95)):
        expected = student_t.isf(1.0 - quantile, n - 1) * apart.std(ddof=1) / np.sqrt(n)
        assert 0.5 * np.log(ends[1] / ends[0]) == pytest.approx(expected, rel=0.1)
