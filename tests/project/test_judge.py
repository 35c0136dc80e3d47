"""What `make judge` finds in two worlds whose truth nobody doubts, and how it counts."""

from collections import Counter

import judge
import numpy as np
import pytest
from judge import (
    QUESTIONS,
    SEA_QUESTIONS,
    Judged,
    JudgedDive,
    evaluated_candidates,
    judged_dives,
    page,
    rates,
    sea_rates,
)
from true_errors import Ratio, mean_squares, true_ratio, truth
from worlds import WORLDS, made_dive

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.evaluation.reference_errors import ReferenceErrors

CAUTIOUS, DEAD = "baseline's R of 200 mm/s, truly 20", "dead: a knock, and gates that stay shut"
DIVES = 4


def number_of(name: str) -> int:
    """Find a world by its name."""
    return next(number for number, world in enumerate(WORLDS) if world.name == name)


@pytest.mark.nightly
def test_a_baseline_that_hardly_trusts_its_dvl_is_beaten_and_a_dead_one_is_not_evaluated() -> None:
    tasks = [(number_of(name), dive) for name in (CAUTIOUS, DEAD) for dive in range(DIVES)]
    better, dead = evaluated_candidates(list(judged_dives(tasks, jobs=1)), "reference")
    assert (better.name, better.kind, better.words["better"]) == (CAUTIOUS, "A", DIVES)
    assert (dead.name, dead.kind, dead.words) == (DEAD, "D", Counter({"not evaluated": DIVES}))
    told = page([better, dead], DIVES, "reference", 1.0)
    assert f"| truly better, said better | 100.0 % ({DIVES} of {DIVES}) |" in told
    assert f"| dead, said anything but *not evaluated* | 0.0 % (0 of {DIVES}) |" in told


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
        np.rint(time_s * NS_PER_S).astype(np.int64), drifting_m, velocity_n, velocity_n, 300.0, drifting_m
    )
    squares = mean_squares(errors)
    assert squares[:2] == pytest.approx((0.3**2, 0.05**2), rel=1e-9)
    assert squares.end_m2 == pytest.approx((0.005 * time_s[-1]) ** 2)
    assert squares.position_m2 == pytest.approx(float(np.mean((0.005 * time_s) ** 2)))
    assert squares.depth_m2 == pytest.approx(float(np.mean(time_s**2)))


def test_the_ratio_of_a_world_has_an_interval_that_holds_the_truth_95_times_of_100() -> None:
    rng, true, dives, tries = np.random.default_rng(1), 0.8, 60, 400
    common = rng.gamma(2.0, size=(tries, dives))
    own = rng.gamma(4.0, 0.25, size=(2, tries, dives))
    ratios = [true_ratio(*pair) for pair in zip(common * own[0], true**2 * common * own[1], strict=True)]
    held = sum(ratio.low <= true <= ratio.high for ratio in ratios)
    assert 0.91 * tries <= held <= 0.98 * tries


@pytest.mark.parametrize(
    ("drift", "velocity", "kind"),
    [
        (Ratio(0.80, 0.75, 0.85), Ratio(1.00, 0.98, 1.02), "A"),
        (Ratio(0.80, 0.75, 0.97), Ratio(1.00, 0.98, 1.02), "A?"),
        (Ratio(0.80, 0.75, 0.85), Ratio(1.00, 0.98, 1.07), "A?"),
        (Ratio(0.80, 0.75, 0.85), Ratio(1.20, 1.15, 1.25), "AC"),
        (Ratio(1.00, 0.96, 1.04), Ratio(1.00, 0.98, 1.02), "B"),
        (Ratio(1.00, 0.96, 1.04), Ratio(1.00, 0.98, 1.06), "B?"),
        (Ratio(1.00, 0.96, 1.04), Ratio(1.20, 1.15, 1.25), "C"),
    ],
)
def test_a_class_is_certain_if_the_intervals_allow_for_no_other(drift: Ratio, velocity: Ratio, kind: str) -> None:
    assert truth([drift, velocity]) == kind


def test_whole_groups_of_eight_dives_are_pooled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judge, "pooled_verdict_word", lambda _, evidence: f"{evidence[0]} to {evidence[-1]}")
    dives = [JudgedDive(0, {"aided": "better"}, {"aided": dive}, {}, None) for dive in range(20)]
    (found,) = evaluated_candidates(dives, "reference")
    assert found.pooled == Counter(["0 to 7", "8 to 15"])
    assert found.words == Counter(better=20)


def of_words(name: str, kind: str, words: Counter[str], pooled: Counter[str]) -> Judged:
    return Judged(name, kind, {}, words, pooled, "", words, is_far=kind != "B", is_copy="copy" in name)


def test_words_at_sea_are_wrong_where_the_truth_is_another() -> None:
    gain = of_words("sea: gain", "A", Counter(better=6, worse=1, equivalent=1, undecided=2), Counter(better=1))
    alike = of_words("sea: alike", "B", Counter(better=1, equivalent=9), Counter(mixed=1))
    copy = of_words("sea: copy", "B", Counter(equivalent=10), Counter(undecided=1))
    rows = dict(zip((question.asks for question in SEA_QUESTIONS), sea_rates([gain, alike, copy]), strict=True))
    assert "| 60.0 % (6 of 10) | at least 45 % |" in rows["gains of 10 % or more, said better"]
    assert "| 10.0 % (1 of 10) | at most 1 % |" in rows["truly better or worse, said the opposite"]
    assert "| 5.0 % (1 of 20) | at most 2 % |" in rows["truly the same, said better or worse"]
    assert "| 10.0 % (3 of 30) |" in rows["all, wrong words"]
    assert rows["copies, said equivalent"].endswith("| 0.0 % (0 of 1) | at least 95 % |")


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


def test_words_are_counted_in_the_class_that_is_true() -> None:
    right = of_words("a", "A?", Counter(better=45, worse=15), Counter(better=7))
    dead = of_words("d", "D", Counter({"not evaluated": 50, "better": 10}), Counter({"not evaluated": 7}))
    rows = dict(zip((question.asks for question in QUESTIONS), rates([right, dead]), strict=True))
    assert "| 75.0 % (45 of 60) | at least 60 % | 100.0 % (7 of 7) |" in rows["truly better, said better"]
    assert "| 25.0 % (15 of 60) |" in rows["truly better, said worse"]
    assert "| - | at least 60 % | - | 100 % |" in rows["truly worse, said worse"]
    assert "| 16.7 % (10 of 60) | 0 | 0.0 % (0 of 7) |" in rows["dead, said anything but *not evaluated*"]
