"""The worlds in which a part of the dives stands out or none does, and how archives of them are counted."""

import math

import numpy as np
import pytest
from judged import WherePart
from scatter_worlds import OTHER, dive_of, exchanged
from where_worlds import (
    BASELINE,
    SEED,
    SIZE,
    TURNS,
    WORLDS,
    JudgedDive,
    JudgedWorld,
    TrueParts,
    WhereWorld,
    is_turning,
    page,
    rates_of,
    tasks_of,
    true_parts_of,
)


def world_of(name: str) -> WhereWorld:
    """Find a world by the beginning of its name."""
    (found,) = [one for one in WORLDS if one.world.name.startswith(name)]
    return found


def ratios_of(name: str, number: int = 0) -> TrueParts:
    """Measure one dive of a world."""
    world = world_of(name).world
    errors = true_parts_of(world, dive_of(world, number, SEED))
    return TrueParts(*np.divide(errors[OTHER], errors[BASELINE]).tolist())


def test_a_lever_arm_that_is_off_is_worse_in_turns_alone() -> None:
    ratios = ratios_of("lever arm off by 0.4 m")
    assert ratios.in_turns > 2.0
    assert ratios.in_legs == pytest.approx(1.0, abs=0.2)


def test_errors_that_are_larger_by_a_factor_are_so_everywhere() -> None:
    ratios = ratios_of("all errors times 5")
    np.testing.assert_allclose(ratios, 5.0, rtol=1e-3)


def test_two_dvls_of_the_same_noise_can_be_exchanged() -> None:
    world = world_of("two DVLs of the same noise").world
    drawn = dive_of(world, 2, SEED)
    there = true_parts_of(world, drawn)
    back = true_parts_of(world, exchanged(drawn, OTHER))
    assert world.can_be_exchanged
    np.testing.assert_allclose(there[OTHER], back[BASELINE], rtol=1e-6)
    np.testing.assert_allclose(there[BASELINE], back[OTHER], rtol=1e-6)
    assert abs(math.log(there[OTHER].in_legs / there[BASELINE].in_legs)) > 1e-3


def test_surveys_turn_and_go_straight() -> None:
    for number in range(3):
        world = WORLDS[0].world
        turning = is_turning(dive_of(world, number, SEED).exact)
        assert 0.1 < float(turning.mean()) < 0.4
        assert int(np.sum(np.diff(turning.astype(int)) == 1)) >= 4


def part(name: str, ratio: float, *, stands_out: bool) -> WherePart:
    """Make a part of which something is said."""
    return WherePart(name, ratio, stands_out)


def judged(name: str, *archives: list[WherePart]) -> JudgedWorld:
    """Let the tool say something of some archives that have no dive in common."""
    errors = {BASELINE: TrueParts(1.0, 1.0), OTHER: TrueParts(2.0, 1.0)}
    dives = [JudgedDive(0, number, None, errors) for number in range(SIZE * len(archives))]
    return JudgedWorld(world_of(name), dives, archives)


OUT = part(TURNS, 1.5, stands_out=True)
CALM = part(TURNS, 1.5, stands_out=False)
BETTER = part(TURNS, 0.5, stands_out=True)
LEGS = part("straight", 1.5, stands_out=True)


def test_archives_are_counted() -> None:
    world = judged("lever arm off by 0.2 m", [OUT], [CALM], [BETTER, LEGS], [OUT, LEGS])
    assert (world.turns_found, world.others_worse, world.spoken) == (2, 2, 3)
    assert world.independent == 4.0
    assert world.true_ratios == "2.00 / 1.00"
    assert world.reported == "turns 1.14, straight 1.50"


def test_rates_are_as_asked_but_for_chance() -> None:
    found = rates_of([judged("lever arm off by 0.2 m", *[[OUT]] * 10)])
    assert [(rate.counted, rate.is_met) for rate in found] == [(10, True), (0, True)]
    half = [[OUT]] * 5 + [[CALM]] * 5
    assert [rate.is_met for rate in rates_of([judged("lever arm off by 0.2 m", *half)])] == [
        False,
        True,
    ]
    quiet = [[CALM]] * 19 + [[OUT]]
    assert [rate.is_met for rate in rates_of([judged("two IMUs", *quiet)])] == [True]
    loud = [[CALM]] * 10 + [[OUT]] * 10
    (rate,) = rates_of([judged("two IMUs", *loud)])
    assert not rate.is_met
    assert "10 of 20 | 20 | 50.0 * | at most 5 |" in rate.text


def test_nothing_is_asked_of_worlds_that_are_shown() -> None:
    text, all_met = page([judged("noise of the DVL", [OUT])], 6, 1, 1.0)
    assert all_met
    assert (
        "| noise of the DVL times 5 | not asked | 2.00 / 1.00 | 1 | 1 turns | turns 1.50 |" in text
    )


def test_every_other_dive_of_an_equal_pair_is_the_one_before_exchanged() -> None:
    number = [one.world.name for one in WORLDS].index("two IMUs")
    tasks = tasks_of([number], 4, SEED)
    assert [(task.number, task.is_exchanged) for task in tasks] == [
        (0, False),
        (0, True),
        (1, False),
        (1, True),
    ]
    assert [task.number for task in tasks_of([0], 3, SEED)] == [0, 1, 2]
