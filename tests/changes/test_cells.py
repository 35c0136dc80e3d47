"""What became of one number or word."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from insdvl_replay.changes.cells import judge_number, prints_the_same, rank_verdict
from insdvl_replay.core.quantities import VERDICTS_BEST_FIRST
from insdvl_replay.core.tables import Better
from insdvl_replay.document.tables import number, numbers_apart, percent

BETTER: tuple[Better, ...] = ("lower", "higher", "nearer zero", "nearer dof")
OPPOSITE = {"better": "worse", "worse": "better", "same": "same"}
numbers = st.none() | st.floats(-1e6, 1e6).filter(lambda value: value == 0.0 or abs(value) > 1e-9)


@pytest.mark.parametrize(
    ("old", "new", "column", "better", "change_pct", "word"),
    [
        (2.0, 1.0, "sd", "lower", -50.0, "better"),
        (2.0, 2.5, "sd", "lower", 25.0, "worse"),
        (2.0, 2.5, "share", "higher", 25.0, "better"),
        (-2.0, -2.5, "share", "higher", -25.0, "worse"),
        (40.0, 38.0, "improvement_pct", "higher", -2.0, "worse"),
        (0.1, 0.05, "improvement_pct", "higher", -0.05, "same"),
        (-0.2, 0.1, "final", "nearer zero", -50.0, "better"),
        (0.1, -0.2, "final", "nearer zero", 100.0, "worse"),
        (-0.2, 0.2, "final", "nearer zero", 0.0, "same"),
        (6.0, 1.5, "mean_nis", "nearer dof", 0.0, "same"),
        (6.0, 3.0, "mean_nis", "nearer dof", -50.0, "better"),
        (3.0, 0.003, "mean_nis", "nearer dof", 99900.0, "worse"),
        (3.0, 0.0, "mean_nis", "nearer dof", None, "worse"),
        (0, 2, "rejected", "lower", None, "worse"),
        (2, 0, "rejected", "lower", -100.0, "better"),
        (1.0, None, "reached_s", "lower", None, "worse"),
        (None, 1.0, "reached_s", "lower", None, "better"),
        (None, None, "reached_s", "lower", None, "same"),
        (0.0, 0.0, "sd", "lower", 0.0, "same"),
    ],
)
def test_numbers_move_as_computed_by_hand(
    old: float | None,
    new: float | None,
    column: str,
    better: Better,
    change_pct: float | None,
    word: str,
) -> None:
    moved = judge_number(old, new, column, better, dofs=(3.0, 3.0))
    assert moved.verdict == word
    assert moved.change_pct == (
        None if change_pct is None else pytest.approx(change_pct, abs=1e-9)
    )
    assert moved.change == (
        None if old is None or new is None else pytest.approx(new - old, abs=1e-12)
    )


@pytest.mark.parametrize(
    ("new", "tolerance_pct", "word"),
    [
        (1.0009, 0.1, "same"),
        (1.001, 0.1, "same"),
        (1.0011, 0.1, "worse"),
        (0.9989, 0.1, "better"),
        (1.1, 0.0, "worse"),
    ],
)
def test_tolerance_is_the_largest_change_that_is_none(
    new: float, tolerance_pct: float, word: str
) -> None:
    assert judge_number(1.0, new, "sd", "lower", tolerance_pct=tolerance_pct).verdict == word


def test_no_tolerance_covers_a_number_that_was_lost_or_grew_from_zero() -> None:
    assert judge_number(1.0, None, "sd", "lower", tolerance_pct=1e9).verdict == "worse"
    assert judge_number(0.0, 1e-9, "sd", "lower", tolerance_pct=1e9).verdict == "worse"


@given(numbers, numbers, st.sampled_from(BETTER), st.sampled_from(("sd", "improvement_pct")))
def test_exchanging_old_and_new_exchanges_better_and_worse(
    old: float | None, new: float | None, better: Better, column: str
) -> None:
    there = judge_number(old, new, column, better, dofs=(3.0, 3.0))
    back = judge_number(new, old, column, better, dofs=(3.0, 3.0))
    assert back.verdict == OPPOSITE[there.verdict]


@given(st.floats(1e-4, 1e6), st.floats(0.999, 1.001))
def test_numbers_that_print_the_same_are_the_same(value: float, factor: float) -> None:
    other = value * factor
    if number(value) == number(other):
        assert prints_the_same(value, other, "sd")
    if percent(value) == percent(other):
        assert prints_the_same(value, other, "improvement_pct")


@given(st.floats(1e-4, 1e6))
def test_numbers_that_print_two_digits_apart_are_not_the_same(value: float) -> None:
    unit = 10.0 ** (math.floor(math.log10(1.01 * value)) - 3)
    assert not prints_the_same(value, value + 2.0 * unit, "sd")
    assert not prints_the_same(value, value + 0.2, "improvement_pct")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("consistent", "overconfident", "worse"),
        ("overconfident", "conservative", "better"),
        ("consistent", "consistent", "same"),
        ("consistent", "insufficient data", "changed"),
        ("consistent", None, "changed"),
    ],
)
def test_verdicts_have_a_rank(old: str, new: str | None, word: str) -> None:
    assert rank_verdict(old, new, VERDICTS_BEST_FIRST) == word


def test_two_numbers_have_as_many_digits_as_it_takes_to_tell_them_apart() -> None:
    assert numbers_apart(1.5432, 3.2711) == ("1.54", "3.27")
    assert numbers_apart(0.4, 0.400001) == ("0.4", "0.400001")
    assert numbers_apart(0.4, 0.4) == ("0.4", "0.4")
