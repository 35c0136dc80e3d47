"""The rule of a verdict against scipy's Student t, and against how often it errs and finds in simulated dives."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.special import stdtrit
from scipy.stats import ttest_1samp, ttest_ind

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.words import EvidenceVerdict
from insdvl_replay.evaluation.interval import (
    BAND,
    NO_SPREAD,
    Interval,
    RunSpread,
    change_found,
    dives_needed,
    holm_levels,
    level_of_candidates,
    log_ratio_interval,
    quantile_always,
    run_spread,
    widened,
    word_of_interval,
)

BETTER, EQUIVALENT, UNDECIDED, WORSE = (
    EvidenceVerdict.BETTER, EvidenceVerdict.EQUIVALENT, EvidenceVerdict.UNDECIDED, EvidenceVerdict.WORSE,
)  # fmt: skip
NAN = math.nan


def word(
    log_ratios: Sequence[float] | Floats, vehicles: Sequence[str] | None = None
) -> EvidenceVerdict:
    found = log_ratio_interval(log_ratios, vehicles=vehicles)
    return word_of_interval(found.low, found.high)


def ends(found: Interval) -> list[float]:
    return [math.log(found.low), math.log(found.high)]


# --- The interval over dives.


@pytest.mark.parametrize("level", [0.95, 0.99])
@pytest.mark.parametrize("dives", [3, 5, 8, 13])
def test_interval_over_dives_is_that_of_scipy(dives: int, level: float) -> None:
    log_ratios = np.random.default_rng(dives).normal(-0.3, 0.2, dives)
    found = log_ratio_interval(log_ratios, level=level)
    assert ends(found) == pytest.approx(
        [*ttest_1samp(log_ratios, 0.0).confidence_interval(level)], rel=1e-9
    )
    assert found.ratio == pytest.approx(np.exp(log_ratios.mean()))
    assert found.scatter == pytest.approx(log_ratios.std(ddof=1))
    assert (found.dives, found.vehicles) == (dives, 1)


@pytest.mark.parametrize("mean", [-0.4, -0.02, 0.02, 0.4])
def test_p_is_that_of_a_ratio_at_the_nearer_end_of_the_band(mean: float) -> None:
    log_ratios = np.random.default_rng(6).normal(mean, 0.1, 6)
    side = "less" if log_ratios.mean() < 0.0 else "greater"
    edge = math.copysign(math.log(BAND), log_ratios.mean())
    expected = ttest_1samp(log_ratios, edge, alternative=side).pvalue
    assert log_ratio_interval(log_ratios).p == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("log_ratios", [[], [-0.3], [-0.3, -0.31], [-0.3, NAN, -0.31, np.inf]])
def test_fewer_than_three_dives_have_a_ratio_without_interval_and_p(
    log_ratios: list[float],
) -> None:
    found = log_ratio_interval(log_ratios)
    known = [value for value in log_ratios if math.isfinite(value)]
    assert found.dives == len(known)
    assert np.isnan([found.low, found.high, found.low_always, found.high_always, found.p]).all()
    assert found.ratio == pytest.approx(math.exp(np.mean(known)) if known else NAN, nan_ok=True)
    assert word(log_ratios) == UNDECIDED


def test_dives_without_a_number_are_left_out() -> None:
    log_ratios = np.array([-0.3, np.nan, -0.1, np.inf, -0.2])
    assert log_ratio_interval(log_ratios) == log_ratio_interval(log_ratios[[0, 2, 4]])


@pytest.mark.parametrize(
    ("log_ratio", "expected", "p"), [(0.0, EQUIVALENT, 1.0), (-0.1, BETTER, 0.0)]
)
def test_dives_that_agree_to_the_last_digit_leave_no_doubt(
    log_ratio: float, expected: str, p: float
) -> None:
    found = log_ratio_interval([log_ratio] * 8)
    assert (found.low, found.high, found.p) == pytest.approx(
        (math.exp(log_ratio), math.exp(log_ratio), p)
    )
    assert word_of_interval(found.low, found.high) == expected


def test_exchanged_filters_have_the_inverse_interval() -> None:
    log_ratios = np.random.default_rng(9).normal(-0.2, 0.1, 7)
    there, back = log_ratio_interval(log_ratios), log_ratio_interval(-log_ratios)
    inverse = [
        1.0 / there.ratio,
        1.0 / there.high,
        1.0 / there.low,
        1.0 / there.high_always,
        1.0 / there.low_always,
    ]
    assert [*back[:5]] == pytest.approx(inverse)
    assert (back.scatter, back.p) == pytest.approx((there.scatter, there.p))


def test_filter_that_diverged_has_ends_that_are_no_error() -> None:
    found = log_ratio_interval([800.0, 900.0, 1000.0])
    assert (found.ratio, found.high) == (math.inf, math.inf)
    assert word_of_interval(found.low, found.high) == WORSE


# --- Vehicles.


def test_one_vehicle_is_as_none() -> None:
    log_ratios = [-0.3, -0.2, -0.25, -0.1]
    assert log_ratio_interval(log_ratios, vehicles=["a"] * 4) == log_ratio_interval(log_ratios)


def test_from_three_vehicles_on_each_is_one_sample() -> None:
    dives = {"a": [-0.30, -0.26, -0.31, -0.29], "b": [-0.10], "c": [0.05, 0.07]}
    vehicles = [name for name, values in dives.items() for _ in values]
    log_ratios = [value for values in dives.values() for value in values]
    found = log_ratio_interval(log_ratios, vehicles=vehicles)
    means = [float(np.mean(values)) for values in dives.values()]
    assert ends(found) == pytest.approx([*ttest_1samp(means, 0.0).confidence_interval(0.95)])
    assert found.ratio == pytest.approx(math.exp(np.mean(means)))
    assert (found.dives, found.vehicles) == (7, 3)
    within = sum(np.var(values) * len(values) for values in dives.values())
    assert found.scatter == pytest.approx(math.sqrt(within / (7 - 3))), (
        "of dives within their vehicles"
    )


def test_vehicles_of_one_dive_each_are_as_dives() -> None:
    log_ratios = [-0.3, -0.2, -0.25, -0.1]
    found = log_ratio_interval(log_ratios, vehicles=["a", "b", "c", "d"])
    assert found == log_ratio_interval(log_ratios)._replace(vehicles=4)


def test_two_vehicles_have_equal_weight_and_a_scatter_each() -> None:
    """The mean of both, by Welch: half of the difference of one and the other's negative."""
    rng = np.random.default_rng(2)
    eight, five = rng.normal(-0.3, 0.05, 8), rng.normal(0.1, 0.2, 5)
    found = log_ratio_interval([*eight, *five], vehicles=["a"] * 8 + ["b"] * 5)
    welch = ttest_ind(eight, -five, equal_var=False).confidence_interval(0.95)
    assert ends(found) == pytest.approx([0.5 * welch.low, 0.5 * welch.high])
    assert math.log(found.ratio) == pytest.approx(0.5 * (eight.mean() + five.mean()))


def test_vehicle_of_a_single_dive_has_the_scatter_of_the_other() -> None:
    eight, one = np.random.default_rng(3).normal(-0.3, 0.05, 8), [0.1]
    found = log_ratio_interval([*eight, *one], vehicles=["a"] * 8 + ["b"])
    pooled = ttest_ind(eight, np.negative(one), equal_var=True).confidence_interval(0.95)
    assert ends(found) == pytest.approx([0.5 * pooled.low, 0.5 * pooled.high])


def test_two_vehicles_of_a_dive_each_have_no_interval() -> None:
    assert np.isnan(log_ratio_interval([-0.3, -0.3], vehicles=["a", "b"]).low)


def test_vehicles_that_differ_are_not_taken_for_many_dives() -> None:
    """Pairs that are equal over all vehicles, and differ from vehicle to vehicle: a word is wrong."""
    rng = np.random.default_rng(4)
    names = [name for name in "abc" for _ in range(4)]
    wrong, wrong_without = 0, 0
    for _ in range(600):
        log_ratios = np.repeat(rng.normal(0.0, 0.2, 3), 4) + rng.normal(0.0, 0.02, 12)
        wrong += word(log_ratios, names) in (BETTER, WORSE)
        wrong_without += word(log_ratios) in (BETTER, WORSE)
    # Three standard deviations above 2.5 %, which three samples with this scatter have.
    assert wrong <= 600 * 0.025 + 3.0 * math.sqrt(600 * 0.025)
    assert wrong_without >= 120, "dives of one vehicle are no samples of their own"


# --- The band.


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.7, 0.952, BETTER),
        (0.7, 1.0 / BAND, UNDECIDED),
        (0.7, 0.953, UNDECIDED),
        (0.953, 1.049, EQUIVALENT),
        (1.0 / BAND, BAND, EQUIVALENT),
        (1.0 / BAND - 1e-9, BAND, UNDECIDED),
        (1.0 / BAND, BAND + 1e-9, UNDECIDED),
        (0.953, 0.999, EQUIVALENT),
        (1.049, 1.2, UNDECIDED),
        (BAND, 1.2, UNDECIDED),
        (1.051, 1.2, WORSE),
        (0.0, math.inf, UNDECIDED),
        (2.0, math.inf, WORSE),
        (NAN, NAN, UNDECIDED),
    ],
)
def test_word_is_where_the_interval_is(low: float, high: float, expected: EvidenceVerdict) -> None:
    assert word_of_interval(low, high) == expected
    opposite = {BETTER: WORSE, WORSE: BETTER}.get(expected, expected)
    if low > 0.0 or math.isnan(low):
        assert word_of_interval(1.0 / high, 1.0 / low) == opposite, (
            "the band is as wide to both sides"
        )


def test_three_dives_that_agree_are_the_fewest_that_decide() -> None:
    log_ratios = np.log([0.70, 0.71, 0.72])
    assert word(log_ratios) == BETTER
    assert word(-log_ratios) == WORSE
    assert word(log_ratios[:2]) == UNDECIDED
    assert word(np.log([0.5, 0.7, 0.9])) == UNDECIDED
    assert word(np.log([0.99, 1.0, 1.01])) == EQUIVALENT


# --- How often it errs and finds.


RATIOS = (1.0, 0.9, 0.8, 0.67)
# By scatter and dives, in percent: wrong words on equal pairs, then found changes of the other ratios.
RATES = {
    (0.05, 3): (0.1, 21, 84, 100), (0.05, 5): (0.0, 48, 100, 100), (0.05, 8): (0.0, 78, 100, 100),
    (0.1, 3): (1.1, 9, 39, 84), (0.1, 5): (0.5, 16, 82, 100), (0.1, 8): (0.2, 29, 99, 100),
    (0.2, 3): (2.5, 5, 14, 39), (0.2, 5): (1.8, 7, 32, 83), (0.2, 8): (1.0, 10, 56, 99),
    (0.5, 3): (3.8, 3, 6, 11), (0.5, 5): (3.4, 4, 9, 23), (0.5, 8): (2.8, 5, 13, 40),
}  # fmt: skip


def counted_words(drawn: Floats) -> Counter[EvidenceVerdict]:
    """Count the words of many archives, shape (archives, dives)."""
    return Counter(word(one) for one in drawn)


@pytest.mark.nightly
@pytest.mark.parametrize(("scatter", "dives"), RATES)
def test_wrong_words_and_found_changes_are_those_of_the_documentation(
    scatter: float, dives: int
) -> None:
    archives = 4000
    drawn = np.random.default_rng(dives).normal(0.0, scatter, (archives, dives))
    for ratio, stated_pct in zip(RATIOS, RATES[scatter, dives], strict=True):
        words = counted_words(drawn + math.log(ratio))
        found_pct = 100.0 * (words[BETTER] + (words[WORSE] if ratio == 1.0 else 0)) / archives
        share = max(stated_pct, 0.1) / 100.0
        # Three standard deviations of so many archives, and half of the last digit.
        within_pct = 300.0 * math.sqrt(share * (1.0 - min(share, 0.999)) / archives) + 0.55
        assert found_pct == pytest.approx(stated_pct, abs=within_pct), ratio


def test_equal_pairs_seldom_have_a_word_and_changes_are_found() -> None:
    """The cell of five dives with a scatter of 0.1, in few archives."""
    drawn = np.random.default_rng(1).normal(0.0, 0.1, (400, 5))
    equal, changed = counted_words(drawn), counted_words(drawn + math.log(0.8))
    assert equal[BETTER] + equal[WORSE] <= 8
    assert 0.75 <= changed[BETTER] / 400 <= 0.89
    assert changed[WORSE] == 0


# --- An interval that may be looked at after every dive.


def excluded_at_some_look(log_ratios: Floats, quantiles: Floats) -> Floats:
    """Return for each archive, shape (archives, dives), whether its true mean of 0 was outside at any look."""
    dives = np.arange(1, log_ratios.shape[1] + 1)
    mean = np.cumsum(log_ratios, axis=1) / dives
    square = np.cumsum(log_ratios**2, axis=1) / dives
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sqrt((square - mean**2) / (dives - 1.0))
        outside = np.abs(mean) > quantiles * error
    return np.asarray(outside[:, 2:].any(axis=1))


def test_interval_for_every_look_holds_at_all_looks_together() -> None:
    looks = 60
    log_ratios = np.random.default_rng(5).normal(0.0, 1.0, (4000, looks))
    always = np.array([NAN, *(quantile_always(count) for count in range(2, looks + 1))])
    once = np.full(looks, 2.0)
    # Three standard deviations above 5 %.
    assert excluded_at_some_look(log_ratios, always).mean() <= 0.06
    assert excluded_at_some_look(log_ratios, once).mean() > 0.3, (
        "an interval for one look does not hold"
    )


def test_interval_for_every_look_has_its_closed_form() -> None:
    """By a normal mixture of weight 4 dives: t^2 = (n - 1)(q - 1) / (1 - q / (1 + 4 n))."""
    n, weight = 8, 33.0
    q = (20.0 * math.sqrt(weight)) ** (2.0 / n)
    factor = math.sqrt((n - 1) * (q - 1.0) / (1.0 - q / weight))
    log_ratios = np.random.default_rng(7).normal(-0.2, 0.1, n)
    found = log_ratio_interval(log_ratios)
    half = factor * log_ratios.std(ddof=1) / math.sqrt(n)
    expected = [math.exp(log_ratios.mean() - half), math.exp(log_ratios.mean() + half)]
    assert [found.low_always, found.high_always] == pytest.approx(expected)
    assert found.low_always < found.low < found.high < found.high_always


def test_interval_for_every_look_is_finite_from_four_dives_on() -> None:
    three = log_ratio_interval([-0.3, -0.31, -0.32])
    assert (three.low_always, three.high_always) == (0.0, math.inf)
    assert word_of_interval(three.low_always, three.high_always) == UNDECIDED
    assert math.isfinite(log_ratio_interval([-0.3, -0.31, -0.32, -0.3]).high_always)


@pytest.mark.nightly
@pytest.mark.parametrize("scatter", [0.1, 0.2, 0.5])
def test_growing_archives_of_equal_pairs_have_a_wrong_word_in_less_than_two_of_a_hundred(
    scatter: float,
) -> None:
    looks, archives, wrong = 200, 400, 0
    rng = np.random.default_rng(8)
    for log_ratios in rng.normal(0.0, scatter, (archives, looks)):
        for dives in range(3, looks + 1):
            found = log_ratio_interval(log_ratios[:dives])
            if word_of_interval(found.low_always, found.high_always) in (BETTER, WORSE):
                wrong += 1
                break
    # Two standard deviations of so many archives above 1.8 %.
    assert wrong <= 400 * 0.018 + 2.0 * math.sqrt(400 * 0.018)


# --- Several candidates, several rows.


def test_candidates_share_the_error_of_one() -> None:
    assert level_of_candidates(1) == pytest.approx(0.95)
    assert level_of_candidates(5) == pytest.approx(0.99)
    assert level_of_candidates(5, named=True, is_named=True) == pytest.approx(0.95)
    assert level_of_candidates(5, named=True) == pytest.approx(1.0 - 0.05 / 4.0)
    assert level_of_candidates(2, named=True) == pytest.approx(0.95)
    assert level_of_candidates(0) == pytest.approx(0.95)


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """Return Holm's adjusted p: the largest of k p1, (k - 1) p2, ... up to each, in the order of size."""
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, number in enumerate(np.argsort(p_values)):
        largest = max(largest, (len(p_values) - rank) * p_values[number])
        adjusted[number] = largest
    return adjusted


def test_rows_leave_the_band_where_holm_rejects() -> None:
    rng = np.random.default_rng(9)
    decided = 0
    for _ in range(300):
        rows = rng.normal(rng.normal(0.1, 0.1, (6, 1)), 0.1, (6, 5))
        p_values = [log_ratio_interval(row).p for row in rows]
        levels = holm_levels(p_values)
        intervals = [
            log_ratio_interval(row, level=level) for row, level in zip(rows, levels, strict=True)
        ]
        outside = [
            word_of_interval(found.low, found.high) in (BETTER, WORSE) for found in intervals
        ]
        assert outside == [p < 0.05 for p in holm_adjusted([2.0 * p for p in p_values])]
        decided += sum(outside)
    assert 100 < decided < 1700, "some are and some are not"


def test_holm_gives_the_smallest_p_the_smallest_part() -> None:
    levels = holm_levels([0.5, 0.001, NAN, 0.02])
    # 0.001 is below 0.05 / 3 / 2; 0.02 is not below 0.05 / 2 / 2, so that it and all others have its part.
    assert levels == pytest.approx([1.0 - 0.05 / 2, 1.0 - 0.05 / 3, 0.95, 1.0 - 0.05 / 2])
    assert holm_levels([]) == []
    assert holm_levels([0.3], 0.99) == pytest.approx([0.99])


def test_of_equal_rows_one_is_decided_as_seldom_as_of_one_row() -> None:
    rng = np.random.default_rng(10)
    with_holm, without = 0, 0
    for _ in range(500):
        rows = rng.normal(0.0, 0.5, (6, 5))
        levels = holm_levels([log_ratio_interval(row).p for row in rows])
        for level_of, is_holm in ((levels, True), ([0.95] * 6, False)):
            found = [
                log_ratio_interval(row, level=level)
                for row, level in zip(rows, level_of, strict=True)
            ]
            is_any = any(word_of_interval(one.low, one.high) in (BETTER, WORSE) for one in found)
            with_holm += is_any and is_holm
            without += is_any and not is_holm
    assert with_holm <= 0.05 * 500 + 3.0 * math.sqrt(0.05 * 500)
    assert without >= 60, "about 6 times 3.4 %"


# --- What several dives can find.


@pytest.mark.parametrize(
    ("scatter", "dives", "level"),
    [(0.1, 5, 0.95), (0.2, 8, 0.95), (0.05, 3, 0.95), (0.1, 6, 0.99)],
)
def test_change_that_is_found_is_found_in_four_of_five_cases(
    scatter: float, dives: int, level: float
) -> None:
    ratio = change_found(scatter, dives, level)
    assert ratio < 1.0 / BAND
    drawn = np.random.default_rng(11).normal(math.log(ratio), scatter, (2000, dives))
    intervals = [log_ratio_interval(one, level=level) for one in drawn]
    found = sum(word_of_interval(one.low, one.high) == BETTER for one in intervals)
    # Three standard deviations of so many archives.
    assert found / 2000 == pytest.approx(0.8, abs=0.027)


def test_dives_that_are_needed_are_the_fewest_that_find_the_change() -> None:
    needed = dives_needed(0.1, 0.9)
    assert needed is not None
    assert change_found(0.1, needed) >= 0.9 > change_found(0.1, needed - 1)
    drawn = np.random.default_rng(12).normal(math.log(0.9), 0.1, (1500, needed))
    assert counted_words(drawn)[BETTER] / 1500 == pytest.approx(0.8, abs=0.035)
    assert counted_words(drawn[:, : needed // 2])[BETTER] / 1500 < 0.6


def test_what_can_be_found_has_edges() -> None:
    assert change_found(0.0, 3) == pytest.approx(1.0 / BAND), (
        "what does not scatter is found beyond the band"
    )
    assert dives_needed(0.0, 0.9) == 3
    assert np.isnan([change_found(0.1, 2), change_found(NAN, 5)]).all()
    assert dives_needed(0.1, 0.99) is None, (
        "a change within the band is found by no number of dives"
    )
    assert dives_needed(NAN, 0.9) is None
    assert change_found(0.1, 20) > change_found(0.1, 5) > change_found(0.2, 5)


def test_spread_of_runs_is_the_variance_within_dives_of_both_sides() -> None:
    old = [[0.0, 0.2], [1.0, 1.4]]
    new = [[0.5], [0.5]]
    found = run_spread(old, new)
    assert found.freedom == 2
    # Squares about the means of 0.1 and of 1.2, over two degrees of freedom.
    assert found.variance == pytest.approx((2 * 0.1**2 + 2 * 0.2**2) / 2)
    both = run_spread(old, [[0.0, 0.2, 0.4], [1.0]])
    assert both.variance == pytest.approx(found.variance + 0.04)
    assert both.freedom == 2


def test_an_interval_is_no_narrower_than_single_runs_differ() -> None:
    interval = log_ratio_interval(np.log([0.80, 0.81, 0.79, 0.80]))
    assert widened(interval, NO_SPREAD, 0.95) == interval
    assert widened(interval, run_spread([[0.0, 0.0]], []), 0.95) == interval
    wide = widened(interval, RunSpread(0.01, 4), 0.95)
    half = stdtrit(4, 0.975) * 0.1
    assert wide.low == pytest.approx(interval.ratio * math.exp(-half))
    assert wide.high == pytest.approx(interval.ratio * math.exp(half))
    assert (wide.ratio, wide.dives) == (interval.ratio, interval.dives)


def test_few_dives_have_no_interval_that_could_be_widened() -> None:
    interval = log_ratio_interval([0.1, 0.2])
    assert math.isnan(widened(interval, RunSpread(0.01, 4), 0.95).low)
