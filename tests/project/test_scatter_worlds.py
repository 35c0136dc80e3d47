"""Worlds whose filters differ by constants of a dive: that equal ones can be exchanged, and how words are counted."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from judged import log_ratio_of
from scatter_filters import CASE
from scatter_judge import (
    JudgedDive,
    Task,
    Truth,
    drawn_fleets,
    drawn_groups,
    is_opposite,
    judged_dive,
    judged_pairs,
    outcome,
    page,
    plain,
    tasks_of,
)
from scatter_worlds import (
    FIVE,
    OTHER,
    WORLDS,
    ScatterWorld,
    dive_of,
    exchanged,
    factors,
    reference_of,
    true_errors_of,
)

from insdvl_replay.core.words import Verdict

EQUAL = ("two compasses, s 0.5", "two mountings, s 0.5", "two IMUs, s 0.5")


def world_of(name: str) -> ScatterWorld:
    """Find a world by its name."""
    return next(world for world in WORLDS if world.name == name)


def number_of(name: str) -> int:
    """Find its number."""
    return [world.name for world in WORLDS].index(name)


@pytest.mark.parametrize("name", [*EQUAL, "late: two compasses, s 0.2"])
def test_filters_of_an_equal_pair_can_be_exchanged(name: str) -> None:
    world, drawn = world_of(name), dive_of(world_of(name), 3)
    there, back = true_errors_of(world, drawn), true_errors_of(world, exchanged(drawn, OTHER))
    assert world.can_be_exchanged
    np.testing.assert_allclose(there[OTHER], back["baseline"], rtol=1e-6)
    np.testing.assert_allclose(there["baseline"], back[OTHER], rtol=1e-6)
    assert abs(np.log(there[OTHER].position / there["baseline"].position)) > 0.01


def test_all_errors_of_a_filter_are_larger_by_the_factor_that_is_drawn() -> None:
    world = world_of("errors times 0.8, s 0.2")
    drawn = dive_of(world, 0)
    errors, factor = true_errors_of(world, drawn), drawn.told[OTHER].factor
    ratios = np.array(errors[OTHER]) / np.array(errors["baseline"])
    np.testing.assert_allclose(ratios, factor, rtol=2e-3)


def test_worlds_draw_dives_of_their_own_and_the_same_again() -> None:
    first, again, next_ = (dive_of(world_of(EQUAL[0]), number) for number in (0, 0, 1))
    other = dive_of(world_of("two compasses, s 0.2"), 0)
    assert first.told == again.told
    np.testing.assert_array_equal(
        first.reported.imu.specific_force_b, again.reported.imu.specific_force_b
    )
    for different in (next_, other):
        assert not np.array_equal(
            first.reported.imu.specific_force_b, different.reported.imu.specific_force_b
        )


def test_a_late_reference_is_late_and_says_the_same() -> None:
    drawn = dive_of(world_of("late: two compasses, s 0.2"), 0)
    late_s = (reference_of(drawn.reported).time_ns - reference_of(drawn.exact).time_ns) / 1e9
    assert np.ptp(late_s) == pytest.approx(0.0, abs=1e-9)
    assert 0.1 <= late_s[0] <= 0.3
    assert (drawn.reported.dvl.time_ns - drawn.exact.dvl.time_ns)[0] == pytest.approx(0.12e9)


@pytest.mark.nightly
def test_a_better_start_makes_the_same_compass_worse() -> None:
    """A start heading of 0.02 deg is better than the compass, and one of 1 deg is worse, on the median dive."""
    ratios = []
    for sd_deg in ("0.02", "1"):
        world = world_of(f"a compass, start heading good to {sd_deg} deg")
        dives = [true_errors_of(world, dive_of(world, number)) for number in range(8)]
        ratios.append(
            np.median([dive["compass"].heading / dive["baseline"].heading for dive in dives])
        )
    assert ratios[0] > 1.0 > ratios[1]


def test_a_class_without_a_change_is_a_copy_of_the_baseline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(CASE, "")
    found = judged_dive(Task(number_of("a copy that is a class"), 0, 5, is_replayed=True))
    assert found.errors[OTHER] == pytest.approx(found.errors["baseline"], rel=1e-9)
    for quantity in ("position", "drift_60s"):
        assert log_ratio_of(found.records[OTHER], quantity) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.nightly
def test_the_tool_reports_the_true_ratio_and_a_page_tells_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(CASE, "")
    number = number_of("errors times 0.8, s 0.1")
    dives = [judged_dive(Task(number, dive, 5, is_replayed=True)) for dive in range(3)]
    for dive in dives:
        true = np.log(dive.errors[OTHER].position / dive.errors["baseline"].position)
        # The reference has noise of some centimetres.
        assert log_ratio_of(dive.records[OTHER], "position") == pytest.approx(true, abs=0.05)
    (pair,) = judged_pairs(WORLDS[number], dives, 4, 1)
    assert pair.words[3].total() == 4
    assert pair.words[5].total() == 0
    text, _ = page([pair], dives, 1.0, 4)
    assert "| errors times 0.8, s 0.1 |" in text
    assert text.startswith("# Judgement: dives that scatter\n")


def test_a_filter_that_answers_anew_each_time_is_such_a_one() -> None:
    world = world_of("another answer each time")
    drawn = dive_of(world, 0)
    first, second = (true_errors_of(world, drawn)[OTHER] for _ in range(2))
    assert first != second


def test_a_dive_that_tells_the_truth_alone_is_not_replayed() -> None:
    found = judged_dive(Task(number_of("a copy"), 0, 5, is_replayed=False))
    assert found == JudgedDive("a copy", 0, {}, found.errors, 0.0)
    assert set(found.errors) == {"baseline", "copy"}


BETTER, WORSE, SAME = (
    Truth("ensemble", *ends) for ends in ((0.75, 0.85), (1.2, 1.3), (0.97, 1.03))
)
EXCHANGEABLE, NOBODY = Truth("equal", 1.0, 1.0), Truth("no word", 0.7, 0.8)
UNSURE = Truth("ensemble", 0.9, 1.1)


@pytest.mark.parametrize(
    ("word", "truth", "said"),
    [
        ("better", BETTER, "right"),
        ("better without DVL", BETTER, "right"),
        ("worse", BETTER, "wrong"),
        ("equivalent", BETTER, "wrong"),
        ("mixed", BETTER, "mixed"),
        ("undecided", BETTER, "undecided"),
        ("not evaluated", BETTER, "undecided"),
        ("worse", WORSE, "right"),
        ("better", WORSE, "wrong"),
        ("equivalent", SAME, "right"),
        ("better", SAME, "wrong"),
        ("better", EXCHANGEABLE, "wrong"),
        ("mixed", EXCHANGEABLE, "wrong"),
        ("worse without DVL", BETTER, "wrong"),
        ("equivalent without DVL", SAME, "right"),
        ("no effect", SAME, "right"),
        ("no effect", EXCHANGEABLE, "right"),
        ("no effect", BETTER, "wrong"),
        ("no effect", NOBODY, "wrong"),
        ("equivalent", EXCHANGEABLE, "right"),
        ("better", UNSURE, "undecided"),
        ("worse", UNSURE, "undecided"),
        ("better", NOBODY, "wrong"),
        ("equivalent", NOBODY, "wrong"),
        ("not evaluated", NOBODY, "right"),
    ],
)
def test_words_are_held_against_the_truth(word: str, truth: Truth, said: str) -> None:
    assert outcome(word, truth) == said


def test_every_word_of_the_tool_says_something_of_gain_or_loss_or_nothing() -> None:
    said = {word: plain(str(word)) for word in Verdict}
    assert set(said.values()) == {"better", "equivalent", "worse", "mixed", "undecided"}
    with pytest.raises(ValueError, match="smashing"):
        plain("smashing")


def test_the_opposite_is_a_word_of_the_wrong_sign() -> None:
    assert is_opposite("worse", BETTER)
    assert is_opposite("better", WORSE)
    assert not is_opposite("better", BETTER)
    assert not is_opposite("better", EXCHANGEABLE)


def test_groups_hold_each_number_once_and_need_enough() -> None:
    numbers = [row // 2 for row in range(20)]
    groups = drawn_groups(numbers, 8, 50, 1)
    assert len(groups) == 50
    assert all(len({numbers[row] for row in group}) == 8 for group in groups)
    assert {row for group in groups for row in group} == set(range(20))
    assert drawn_groups(numbers[:14], 8, 50, 1) == []


def test_a_fleet_has_four_vehicles_that_are_each_exchanged_as_a_whole() -> None:
    rows = [(row // 2, row % 2 == 1) for row in range(24)]
    vehicles, sides = [number // 2 for number, _ in rows], [side for _, side in rows]
    groups = drawn_fleets(vehicles, sides, 8, 50, 1)
    assert len(groups) == 50
    for group in groups:
        of_vehicle = Counter(vehicles[row] for row in group)
        assert sorted(of_vehicle.values()) == [2, 2, 2, 2]
        assert len({(vehicles[row], sides[row]) for row in group}) == 4
        assert len(set(group)) == 8
    assert {sides[row] for group in groups for row in group} == {True, False}
    assert drawn_fleets(vehicles[:12], sides[:12], 8, 50, 1) == []
    for group in drawn_fleets(vehicles[:12], sides[:12], 3, 50, 1):
        assert len({vehicles[row] for row in group}) == 3


def test_a_vehicle_has_a_factor_of_its_own_and_the_tool_is_told_its_name() -> None:
    world = world_of("vehicles that differ, equal on average")
    steady = replace(world, draw=factors(OTHER, ratio=1.0, log_sd=0.0))
    by_dive = [dive_of(steady, number).told[OTHER].factor for number in range(6)]
    assert by_dive[0] == by_dive[1] != by_dive[2] == by_dive[3] != by_dive[4] == by_dive[5]
    names = [world.config_of(number).vehicle.name for number in range(6)]
    assert names == ["vehicle 0"] * 2 + ["vehicle 1"] * 2 + ["vehicle 2"] * 2
    assert world_of("a copy").config_of(5) == world_of("a copy").config


@pytest.mark.nightly
def test_one_of_five_filters_is_better_and_is_named_before_anything_is_run() -> None:
    world = world_of("five at once, the first is named and 0.8 of the baseline")
    assert (world.candidates, world.config.evaluation.candidate) == (FIVE, "first")
    factors_of = [
        [dive_of(world, number).told[name].factor for name in FIVE] for number in range(12)
    ]
    first, *others = np.log(factors_of).T.mean(axis=1)
    assert first == pytest.approx(np.log(0.8), abs=0.1)
    assert others == pytest.approx(np.zeros(4), abs=0.1)


def test_half_of_the_dives_of_an_equal_pair_are_exchanged() -> None:
    equal, five = number_of(EQUAL[0]), number_of("five compasses, none differs")
    tasks = tasks_of([equal, five], 4, 3, 1)
    assert [(task.number, task.is_exchanged) for task in tasks if task.world == equal] == [
        (0, False),
        (0, True),
        (1, False),
        (1, True),
    ]
    assert [(task.number, task.is_exchanged) for task in tasks if task.world == five] == [
        (number, False) for number in range(4)
    ]
    late = number_of("late: R of 2 mm/s, truly 7")
    assert [task.is_replayed for task in tasks_of([late], 2, 1, 1)] == [True, True, False]


def test_the_factor_of_an_exchanged_filter_is_its_inverse() -> None:
    world = world_of("equal on average, s 0.3")
    drawn = dive_of(world, 0)
    back = exchanged(drawn, OTHER)
    assert back.told[OTHER].factor == pytest.approx(1.0 / drawn.told[OTHER].factor)
    np.testing.assert_array_equal(
        back.reported.imu.angular_rate_b, drawn.reported.imu.angular_rate_b
    )
