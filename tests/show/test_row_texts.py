"""Rows over dives in words: an interval and a word only with enough dives, and sizes in units that people use."""

import math
from typing import Any

import numpy as np
import pytest
from made_verdicts import evidence_row

from insdvl_replay.core.tables import PooledRow, layout_of
from insdvl_replay.document.tables import FORMS
from insdvl_replay.evaluation.answers import CandidateAnswer, pooled_candidate
from insdvl_replay.evaluation.sentences import (
    acts_line,
    changed,
    interval_text,
    plan_line,
    ratio_text,
    ratio_with_interval,
    settling_line,
    share_text,
    word_of,
)
from insdvl_replay.show.answers import evidence_cells, verdict_in_table
from insdvl_replay.show.first_screen import interval_ends


def answer(ratios: dict[str, list[float]], **changes: Any) -> CandidateAnswer:
    count = len(next(iter(ratios.values())))
    dives = [
        [evidence_row(name, values[i], **changes) for name, values in ratios.items()]
        for i in range(count)
    ]
    return pooled_candidate("aided", "baseline", dives, count)


def row(quantity: str, *ratios: float) -> PooledRow:
    return next(
        found for found in answer({quantity: [*ratios]}).rows if found.quantity == quantity
    )


@pytest.mark.parametrize("ratios", [(0.8,), (0.8, 0.81)])
def test_few_dives_have_a_ratio_and_no_interval(ratios: tuple[float, ...]) -> None:
    found = row("position", *ratios)
    assert (interval_text(found), interval_ends(found)) == ("-", None)
    assert ratio_with_interval(found) == f"position {ratio_text(found.ratio)}"


def test_three_dives_have_an_interval() -> None:
    found = row("position", 0.79, 0.80, 0.81)
    assert interval_text(found) == f"{found.low:.2f} .. {found.high:.2f}"
    assert ratio_with_interval(found) == f"position 0.80 ({interval_text(found)})"
    assert interval_ends(found) == (found.low, found.high)


def test_word_of_one_dive_is_absent_and_of_a_row_that_is_only_shown_in_brackets() -> None:
    better = [0.70, 0.71, 0.72]
    found = answer(
        {"position": better, "level": better, "drift_30s": better, "convergence_level": better}
    )
    words = {one.quantity: verdict_in_table(one) for one in found.rows}
    assert words == {
        "position": "better",
        "level": "better",
        "drift_30s": "(better)",
        "convergence_level": "sooner",
    }
    alone = answer({"position": [0.7], "level": [0.7], "drift_30s": [0.7]})
    assert {verdict_in_table(one) for one in alone.rows} == {""}
    assert (word_of(found), word_of(alone)) == ("BETTER", "one dive")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (math.nan, "-"),
        (0.847, "0.85"),
        (9.99, "9.99"),
        (9.996, "10"),
        (50.03, "50"),
        (math.inf, "inf"),
    ],
)
def test_ratio_has_two_decimals_or_three_digits(value: float | None, text: str) -> None:
    assert ratio_text(value) == text


@pytest.mark.parametrize(
    ("quantity", "ratio", "text"),
    [
        ("position", 0.86, "position 14.0 % smaller"),
        ("position", 1.13, "position 13.0 % larger"),
        ("position", 3.5, "position 3.5 times as large"),
        ("convergence_level", 0.8, "level settled 20.0 % sooner"),
        ("convergence_level", 1.5, "level settled 50.0 % later"),
        ("convergence_level", 4.0, "level settled 4 times as late"),
    ],
)
def test_change_is_said_in_per_cent_or_times(quantity: str, ratio: float, text: str) -> None:
    assert changed(row(quantity, ratio)) == text


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0 %"), (0.0049, "0.49 %"), (0.04, "4 %"), (3.2, "320 %")]
)
def test_share_is_in_per_cent(share: float, text: str) -> None:
    assert share_text(share) == text


def test_track_is_moved_by_a_length_and_its_share() -> None:
    """The baseline's error is 2 m."""
    assert acts_line(answer({"position": [0.9]}, acts=0.2)) == (
        "acts: moves the track by 400 mm, 20 % of its error"
    )
    assert "by 3 m, 150 %" in acts_line(answer({"position": [0.9]}, acts=1.5))


def test_row_that_is_moved_most_is_named_too() -> None:
    rows = [evidence_row("position", 0.9, acts=0.2), evidence_row("level", 0.9, acts=0.6)]
    found = pooled_candidate("aided", "baseline", [rows], 1)
    assert acts_line(found).endswith("20 % of its error; the level by 60 %")


def test_what_is_proved_on_one_dive_takes_no_other_dives() -> None:
    assert plan_line(answer({"position": [1.0]}, acts=0.03)) == ""
    assert plan_line(answer({"position": [1.0]}, acts=0.3)).startswith("A verdict takes 3 dives")


def test_convergence_says_what_its_starts_are() -> None:
    found = answer({"position": [1.0] * 3, "convergence_velocity": [0.79, 0.80, 0.81]})
    assert settling_line(found, "level 0.5 deg").startswith(
        "convergence: SOONER, velocity settled 0.80 ("
    )
    assert settling_line(found, "level 0.5 deg").endswith(
        "from starts as uncertain as [initial]: level 0.5 deg"
    )
    alone = answer({"position": [1.0], "convergence_velocity": [0.8]})
    assert settling_line(alone) == "convergence: velocity settled 20.0 % sooner, from drawn starts"
    assert settling_line(answer({"position": [1.0]})) == ""
    never = answer({"position": [1.0], "convergence_velocity": [math.nan]})
    assert "never settles" in settling_line(never)


def test_one_dive_says_how_many_a_verdict_takes() -> None:
    assert plan_line(answer({"position": [0.9]}, acts=0.2)).startswith(
        "A verdict takes 3 dives; about "
    )
    assert plan_line(answer({"level": [0.9]})) == "", "nothing decides"
    assert plan_line(answer({"position": [1.0]}, acts=0.001)) == "", (
        "it has no effect, whatever further dives are"
    )


def test_cells_of_a_table_are_of_the_quantity_that_decides() -> None:
    found = answer({"level": [0.5] * 3, "position": list(np.exp([-0.01, 0.0, 0.01]))})
    name, ratio, interval = evidence_cells(found)
    assert (name, ratio) == ("position", "1.00")
    assert " .. " in interval
    assert evidence_cells(answer({"level": [0.5] * 3})) == ("-", "-", "-")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "< 0.0001"),
        (0.00004, "< 0.0001"),
        (0.00006, "0.0001"),
        (0.0312, "0.0312"),
        (None, "-"),
    ],
)
def test_a_probability_is_never_zero(value: float | None, text: str) -> None:
    assert FORMS["probability"](value) == text
    column = layout_of("", PooledRow).columns["p"]
    assert column.form == "probability"


def test_a_number_of_dives_for_the_change_that_is_found_already_is_left_out() -> None:
    """Six dives that find 10.4 % would need a seventh for 10 %, which is the same in print."""
    for spread in np.arange(0.02, 0.2, 0.0005):
        ratios = list(np.exp(spread * np.array([-1.0, 1.0, -0.5, 0.5, -0.2, 0.2])))
        line = plan_line(answer({"position": ratios}))
        if "a change of 10 %" in line:
            assert line.endswith("in four of five cases.")
            return
    pytest.fail("no spread has a change of 10 %")
