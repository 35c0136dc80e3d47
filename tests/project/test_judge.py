"""What `make judge` finds in worlds whose truth nobody doubts, and how it counts."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from judge import (
    PRIMARY,
    QUESTIONS,
    Judged,
    JudgedDive,
    Task,
    judged_candidates,
    judged_dives,
    page,
    rates,
    tasks_of,
    truth_of,
)
from judged import (
    REFUSED,
    Record,
    level_of,
    over_dives,
    verdict_over,
    verdicts_over,
    word_counts,
    words_of_groups,
)
from scatter_judge import Truth
from true_errors import TrueRatio, mean_squares, ratio_of_logs, true_ratios
from worlds import WORLDS, made_dive

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.evaluation.interval import log_ratio_interval
from insdvl_replay.evaluation.reference_errors import ReferenceErrors

TOO_LARGE, UNFIT = (
    "candidate's R of 60 mm/s, truly 20",
    "unfit: baseline's R of 200 mm/s, truly 20",
)
DEAD = "dead: a knock, and gates that stay shut"


def number_of(name: str) -> int:
    """Find a world by its name."""
    return next(number for number, world in enumerate(WORLDS) if world.name == name)


def judged_world(name: str, dives: int, truth_dives: int) -> Judged:
    """Judge the only candidate of a world."""
    number = number_of(name)
    found = list(judged_dives(tasks_of(number, dives, truth_dives, 1), jobs=1))
    (judged,) = judged_candidates(number, found, 4, 1)
    return judged


@pytest.mark.nightly
def test_a_filter_that_hardly_trusts_its_dvl_is_worse_and_one_beside_an_unfit_or_dead_baseline_is_not_evaluated() -> (
    None
):
    worse = judged_world(TOO_LARGE, 8, 16)
    assert (worse.kind, worse.words[8]) == ("worse 10 %", Counter(worse=4))
    unevaluated = [judged_world(name, 3, 0) for name in (UNFIT, DEAD)]
    for judged in unevaluated:
        assert (judged.kind, judged.words[3]) == ("no word", Counter({"not evaluated": 4}))
    told, is_met = page([worse, *unevaluated], 8, 4, 1.0)
    assert is_met
    assert "| worse by 10 % or more, said worse | 1 |" in told
    assert "| 100.0 (4 of 4) |" in told
    assert "| dead or unfit, said anything but *not evaluated* | 2 | 0.0 (0 of 8) |" in told


def test_the_same_dive_of_a_world_is_made_again_and_another_differs() -> None:
    number = number_of("a gate against 1 % of outliers")
    first, again, other = (made_dive(number, seed)[0].dvl.beam_velocity_mps for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_drift_is_the_change_of_the_error_over_a_minute() -> None:
    time_s = np.arange(0.0, 300.0, 0.2)
    drifting_m = np.outer(time_s, [0.003, 0.004, 1.0])
    velocity_n = np.tile([0.03, 0.04, 1.0], (len(time_s), 1))
    errors = ReferenceErrors(
        np.rint(time_s * NS_PER_S).astype(np.int64),
        drifting_m,
        velocity_n,
        velocity_n,
        300.0,
        drifting_m,
    )
    squares = mean_squares(errors)
    assert (squares.drift_m2, squares.velocity_m2ps2) == pytest.approx((0.3**2, 0.05**2), rel=1e-9)
    assert squares.end_m2 == pytest.approx((0.005 * time_s[-1]) ** 2)
    assert squares.position_m2 == pytest.approx(float(np.mean((0.005 * time_s) ** 2)))
    assert squares.depth_m2 == pytest.approx(float(np.mean(time_s**2)))


def test_the_ratio_of_a_world_has_an_interval_that_holds_the_truth_95_times_of_100() -> None:
    rng, true, dives, tries = np.random.default_rng(1), 0.8, 60, 400
    logs = math.log(true) + 0.3 * rng.standard_normal((tries, dives))
    held = sum(ratio.low <= true <= ratio.high for ratio in map(ratio_of_logs, logs))
    assert 0.91 * tries <= held <= 0.98 * tries


def test_true_ratios_are_geometric_means_of_roots_of_mean_squares() -> None:
    squares = {"baseline": (1.0, 4.0), "aided": (0.25, 4.0)}
    made = np.array([np.full(5, value) for value in squares["baseline"]])
    dives = [
        {"baseline": before, "aided": after}
        for before, after in zip(made, made * [[0.25], [1.0]], strict=True)
    ]
    found = true_ratios(dives, "baseline", "aided")  # type: ignore[arg-type]
    assert found[PRIMARY].value == pytest.approx(math.sqrt(0.5))
    assert found[PRIMARY].scatter == pytest.approx(math.log(2.0) / math.sqrt(2.0))


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        (0.75, 0.85, "better 10 %"),
        (0.92, 0.94, "better"),
        (0.93, 0.97, "?"),
        (0.96, 1.04, "same"),
        (0.96, 1.06, "?"),
        (1.06, 1.2, "worse"),
        (1.2, 1.3, "worse 10 %"),
    ],
)
def test_a_truth_is_certain_if_its_interval_allows_for_no_other(
    low: float, high: float, kind: str
) -> None:
    ratios = {PRIMARY: TrueRatio(math.sqrt(low * high), low, high, 0.1)}
    truth = truth_of(WORLDS[number_of(TOO_LARGE)], ratios, is_copy=False)
    assert Judged("", truth, ratios, {}, "", 0).kind == kind


def test_a_copy_is_the_same_and_of_dead_filters_nothing_is_true() -> None:
    ratios = {PRIMARY: TrueRatio(0.8, 0.75, 0.85, 0.1)}
    assert truth_of(WORLDS[number_of(TOO_LARGE)], ratios, is_copy=True).name == "same"
    for name in (UNFIT, DEAD):
        assert truth_of(WORLDS[number_of(name)], ratios, is_copy=False).name == "no word"


# --- Words over dives, as the tool says them.


def record(
    ratio: float, acts: float = 0.5, vehicle: str = "", quantity: str = "position"
) -> Record:
    """Make a dive that has the one row that decides."""
    row = EvidenceRow(
        log="dive",
        filter="aided",
        evidence="track",
        quantity=quantity,
        unit="m",
        baseline=1.0,
        value=ratio,
        ratio=ratio,
        acts=acts,
        reference_noise=0.0,
        role=Role.PRIMARY,
    )
    return Record("undecided", (row,), vehicle=vehicle)


def test_the_word_on_log_ratios_is_that_of_the_interval_of_the_tool() -> None:
    logs = [math.log(ratio) for ratio in (0.79, 0.80, 0.81)]
    found, interval = over_dives(logs), log_ratio_interval(logs)
    assert (found.low, found.high, found.word) == (interval.low, interval.high, "better")
    assert found.word_always == "undecided"
    assert over_dives(logs[:2]).word == "undecided"
    wide = over_dives(logs, level=level_of(5))
    assert wide.low < found.low
    assert wide.high > found.high


def test_a_verdict_over_dives_needs_three_and_half_of_them() -> None:
    dives = [record(ratio) for ratio in (0.79, 0.80, 0.81)]
    assert verdict_over("aided", "baseline", dives) == "better"
    assert verdict_over("aided", "baseline", dives[:2]) == "undecided"
    assert verdict_over("aided", "baseline", [*dives, REFUSED, REFUSED]) == "better"
    assert verdict_over("aided", "baseline", [*dives, *[REFUSED] * 3]) == "not evaluated"


def test_dives_on_which_a_filter_does_not_repeat_are_no_evidence() -> None:
    dives = [record(ratio) for ratio in (0.79, 0.80, 0.81)]
    not_repeated = [replace(dive, word=Verdict.NOT_REPEATABLE) for dive in dives]
    assert verdict_over("aided", "baseline", not_repeated) == "not repeatable"
    assert verdict_over("aided", "baseline", [*dives, *not_repeated[:2]]) == "better"


def test_a_copy_has_no_effect() -> None:
    assert verdict_over("aided", "baseline", [record(1.0, acts=0.0)] * 3) == "no effect"


def test_several_candidates_share_the_error_rate_of_one() -> None:
    # 0.80 with a scatter of 0.072: the interval of one candidate ends at 0.941, that of one of five far beyond 1.
    dives = [record(0.8 * math.exp(off)) for off in (-0.07, 0.0, 0.07)]
    names = ["first", "second", "third", "fourth", "fifth"]
    alone = verdicts_over("baseline", {"first": dives})
    together = verdicts_over("baseline", dict.fromkeys(names, dives))
    named = verdicts_over("baseline", dict.fromkeys(names, dives), named="third")
    assert alone == {"first": "better"}
    assert together == dict.fromkeys(names, "undecided")
    assert named == {**together, "third": "better"}


def test_candidates_without_effect_do_not_share() -> None:
    dives, copies = (
        [record(0.8 * math.exp(off)) for off in (-0.07, 0.0, 0.07)],
        [record(1.0, acts=0.0)] * 3,
    )
    found = verdicts_over("baseline", {"aided": dives, "copy1": copies, "copy2": copies})
    assert found == {"aided": "better", "copy1": "no effect", "copy2": "no effect"}


def test_vehicles_that_differ_are_one_sample_each() -> None:
    ratios = {"a": 0.6, "b": 0.8, "c": 0.95}
    dives = [record(ratio, vehicle=vehicle) for vehicle, ratio in ratios.items() for _ in range(4)]
    alike = [record(ratio) for ratio in ratios.values() for _ in range(4)]
    assert verdict_over("aided", "baseline", dives) == "undecided"
    assert verdict_over("aided", "baseline", alike) == "better"


def test_the_settings_may_name_what_decides() -> None:
    dives = [record(ratio, quantity="drift_60s") for ratio in (0.79, 0.80, 0.81)]
    assert verdicts_over("baseline", {"aided": dives}, primary="drift_60s") == {"aided": "better"}
    assert verdicts_over("baseline", {"aided": dives}) == {"aided": "undecided"}


# --- Groups, and how words are counted.


def test_groups_are_drawn_from_the_dives_that_were_replayed() -> None:
    number = number_of(TOO_LARGE)
    squares = np.ones(5)
    errors = {"baseline": squares, "wrong": 1.5 * squares}
    dives = [JudgedDive(number, dive, {"wrong": record(1.2)}, errors, None) for dive in range(6)]  # type: ignore[arg-type]
    alone = [JudgedDive(number, dive, {}, errors, None) for dive in range(6, 20)]  # type: ignore[arg-type]
    (found,) = judged_candidates(number, [*dives, *alone], 10, 1)
    assert (found.words[3].total(), found.words[5].total(), found.words[8].total()) == (10, 10, 0)
    assert found.words[3] == Counter(worse=10)
    assert found.ratios[PRIMARY].value == pytest.approx(math.sqrt(1.5))
    assert found.dives == 6


def test_long_dives_are_fewer_and_dead_ones_tell_no_truth() -> None:
    usual, long, dead = (
        number_of(name) for name in (TOO_LARGE, "sea: tactical survey of 2 h", DEAD)
    )
    assert [task.is_replayed for task in tasks_of(usual, 4, 2, 1)] == [True] * 4 + [False] * 2
    assert [task.is_replayed for task in tasks_of(long, 4, 2, 1)] == [True, True, False]
    assert tasks_of(dead, 20, 5, 1) == [Task(dead, dive, 1, True) for dive in range(8)]


def of_words(
    kind: str, low: float, high: float, words: Counter[str], *, is_copy: bool = False
) -> Judged:
    """Make the words on groups of three dives."""
    return Judged(
        kind, Truth(kind, low, high), {}, {3: words, 5: Counter(), 8: Counter()}, "", 600, is_copy
    )


def test_words_are_wrong_where_the_truth_is_another() -> None:
    gain = of_words(
        "ensemble", 0.7, 0.8, Counter(better=60, worse=10, equivalent=10, undecided=20)
    )
    alike = of_words("ensemble", 0.97, 1.03, Counter(better=10, equivalent=90))
    copy = of_words("copy", 1.0, 1.0, Counter({"no effect": 99, "equivalent": 1}), is_copy=True)
    dead = of_words("no word", math.nan, math.nan, Counter({"not evaluated": 95, "undecided": 5}))
    rows, is_met = rates([gain, alike, copy, dead])
    found = dict(zip((question.asks for question in QUESTIONS), rows, strict=True))
    assert not is_met
    assert "| 60.0 (60 of 100) | - | - |  |" in found["better by 10 % or more, said better"]
    assert (
        "| 10.0 (10 of 100) * | - | - | at most 1 |" in found["better or worse, said the opposite"]
    )
    assert (
        "| 10.0 (10 of 100) * | - | - | at most 5 |"
        in found["the same, said better, worse or mixed"]
    )
    assert (
        "| 1.0 (1 of 100) * | - | - | at most 0 |"
        in found["copies, said anything but *no effect*"]
    )
    assert (
        "| 5.0 (5 of 100) * | - | - | at most 0 |"
        in found["dead or unfit, said anything but *not evaluated*"]
    )
    # Ten that are worse, ten that are equivalent, and ten that are better.
    assert "| 4 | 7.5 (30 of 400) * | - | - | at most 5 |" in found["all, wrong words"]


def test_rates_that_are_as_asked_are_met() -> None:
    copy = of_words("copy", 1.0, 1.0, Counter({"no effect": 100}), is_copy=True)
    alike = of_words("ensemble", 0.97, 1.03, Counter(better=4, equivalent=96))
    assert rates([copy, alike])[1]


def test_words_are_written_in_the_order_of_the_tool() -> None:
    assert word_counts(Counter(worse=1, better=3)) == "75 better, 25 worse"
    assert word_counts(Counter()) == "-"
    assert word_counts(Counter(dict.fromkeys(Verdict, 1))).startswith(
        "9 better, 9 better without DVL,"
    )


def test_words_are_of_drawn_groups() -> None:
    dives = [record(ratio) for ratio in np.linspace(0.79, 0.81, 8)]
    assert words_of_groups("aided", "baseline", dives, 5, 10, 1) == "100 better"
    assert words_of_groups("aided", "baseline", dives[:4], 5, 10, 1) == "-"


def test_a_dive_at_sea_is_made_again_and_no_other_has_its_motion() -> None:
    number = number_of("sea: MEMS in waves, 200 s")
    (first, exact), (again, _), (_, other_exact) = (made_dive(number, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.imu.specific_force_b, again.imu.specific_force_b)
    assert first.reference is not None
    assert exact.reference is not None
    assert other_exact.reference is not None
    assert np.ptp(exact.reference.velocity_n - other_exact.reference.velocity_n) > 1.0
    off_mps = first.reference.velocity_n - exact.reference.velocity_n
    assert 0.003 < off_mps.std() < 0.008
