"""The plan says what the dives of a result find, and how many find less, by the power of Student's test."""

import math

import msgspec
import numpy as np
import pytest
from made_reports import report, tables
from made_verdicts import evidence_row
from scipy import stats

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.quantities import FEWEST_DIVES
from insdvl_replay.core.words import Role
from insdvl_replay.evaluation.answers import CandidateAnswer, pooled_candidate
from insdvl_replay.evaluation.interval import (
    BAND,
    LEVEL,
    MOST_DIVES,
    POWER,
    chance_found,
    change_found,
    smallest_sign_p,
)
from insdvl_replay.evaluation.sentences import SCATTER_OF_ACTS, plan_line
from insdvl_replay.show.plan import (
    SOUGHT_PCT,
    USUAL_SCATTERS,
    PlanRow,
    plan_of_tracks,
    plan_result,
    plan_rows,
    tracks_rows,
)


def answer(
    ratios: dict[str, list[float]], acts: float = 0.5, vehicles: list[str] | None = None
) -> CandidateAnswer:
    """Return the answer of dives with these ratios, by quantity."""
    dives = len(next(iter(ratios.values())))
    rows = [
        [
            evidence_row(quantity, values[place], acts=acts, log=f"dive {place}")
            for quantity, values in ratios.items()
        ]
        for place in range(dives)
    ]
    return pooled_candidate("aided", "baseline", rows, dives, vehicles=vehicles)


def row_of(quantity: str, found: CandidateAnswer) -> PlanRow:
    (row,) = (row for row in plan_rows([found]) if row.quantity == quantity)
    return row


def power(change_pct: float, scatter: float, dives: int) -> float:
    """Return how often so many dives find a change: its interval lies wholly below the band."""
    shift = -np.log(1.0 - change_pct / 100.0) - np.log(BAND)
    quantile = stats.t.ppf(0.5 + 0.5 * LEVEL, dives - 1)
    return float(stats.nct.sf(quantile, dives - 1, shift / (scatter / np.sqrt(dives))))


def test_change_that_these_dives_find_is_found_in_four_of_five_cases() -> None:
    row = row_of("position", answer({"position": [0.7, 0.8, 0.9, 1.0, 0.85]}))
    assert (row.filter, row.role, row.dives) == ("aided", Role.PRIMARY, 5)
    assert row.scatter == pytest.approx(np.std(np.log([0.7, 0.8, 0.9, 1.0, 0.85]), ddof=1))
    assert row.finds_pct is not None
    assert power(row.finds_pct, row.scatter, 5) == pytest.approx(POWER, abs=1e-3)


def test_numbers_of_dives_are_the_fewest_that_find_their_change() -> None:
    row = row_of("position", answer({"position": [0.7, 0.8, 0.9, 1.0, 0.85]}))
    assert row.scatter is not None
    for change_pct, dives in zip(
        SOUGHT_PCT, (row.dives_20pct, row.dives_10pct, row.dives_7pct), strict=True
    ):
        assert dives is not None
        assert (
            power(change_pct, row.scatter, dives)
            >= POWER
            > power(change_pct, row.scatter, dives - 1)
        )
    assert row.dives_20pct < row.dives_10pct < row.dives_7pct


def test_scatter_of_fewer_than_three_dives_is_taken_from_how_far_the_candidate_acts() -> None:
    row = row_of("position", answer({"position": [0.9, 0.8]}, acts=0.3))
    assert row.dives == 2
    assert row.dives < FEWEST_DIVES
    assert row.scatter == pytest.approx(SCATTER_OF_ACTS * 0.3)
    assert row.finds_pct is None, "they find nothing"
    assert row.dives_10pct is not None
    assert power(10.0, row.scatter, row.dives_10pct) >= POWER


def test_more_dives_than_a_thousand_are_no_plan() -> None:
    row = row_of("position", answer({"position": [0.1, 9.0, 0.2, 5.0]}))
    assert row.scatter is not None
    assert power(7.0, row.scatter, MOST_DIVES) < POWER
    assert row.dives_7pct is None


def test_dives_of_several_vehicles_have_no_plan_by_dives() -> None:
    """The dives of each vehicle differ little, and the vehicles much: the interval is as wide as the vehicles say."""
    ratios = {"position": [0.80, 0.81, 0.99, 1.00, 1.20, 1.21]}
    found = answer(ratios, vehicles=["a", "a", "b", "b", "c", "c"])
    assert list(plan_rows([found])) == []
    assert plan_line(found).startswith("Each vehicle is one sample")
    assert "in four of five cases" in plan_line(answer(ratios))
    one_dive_each = answer(ratios, vehicles=["a", "b", "c", "d", "e", "f"])
    assert plan_line(one_dive_each) == plan_line(answer(ratios))


def test_plan_of_several_vehicles_says_why_it_is_empty() -> None:
    reports = [
        msgspec.structs.replace(report(f"{vehicle}{number}"), vehicle=vehicle)
        for vehicle in ("a", "b", "c")
        for number in (1, 2)
    ]
    result = plan_result(reports)
    assert result.tables["plan"].rows == []
    assert "Each vehicle is one sample" in str(result.document)


def test_rows_that_are_only_shown_have_no_plan() -> None:
    found = answer({"position": [0.9] * 3, "drift_30s": [0.9] * 3, "convergence_level": [0.9] * 3})
    assert [row.quantity for row in plan_rows([found])] == ["position"]


def test_secondary_rows_that_may_warn_have_a_level_of_their_own() -> None:
    """Holm asks more of each of several, so that they find less than the primary one with the same scatter."""
    ratios = [0.9, 1.0, 1.1, 0.95]
    found = answer({"position": ratios, "drift_60s": ratios, "level": ratios, "heading": ratios})
    position, level = row_of("position", found), row_of("level", found)
    assert level.role == Role.SECONDARY
    assert level.scatter == pytest.approx(position.scatter)
    assert level.finds_pct is not None
    assert position.finds_pct is not None
    assert level.finds_pct > position.finds_pct


def test_plan_of_a_result_has_a_row_for_each_quantity() -> None:
    result = plan_result([report("one"), report("two")])
    assert result.kind == "plan"
    rows = result.tables["plan"].rows
    assert [(row[0], row[1]) for row in map(list, rows)] == [
        ("aided", "position"),
        ("aided", "level"),
    ]


def test_plan_without_evidence_says_so() -> None:
    bare = msgspec.structs.replace(tables(), evidence=[])
    result = plan_result([report("one", bare)])
    assert "There is no evidence to plan with." in result.document
    assert result.title == "What 1 dive finds"


# --- Without results.


def test_tracks_find_what_the_docs_say() -> None:
    """The table of docs/verdict.md, which is from simulation: a tenth of 0.1 is found by five dives in 16 %."""
    rows = {row.scatter: row for row in tracks_rows(5, 0.9)}
    assert rows[0.1].chance_pct == pytest.approx(16.0, abs=1.0)
    assert rows[0.2].chance_pct == pytest.approx(7.0, abs=1.0)
    eight = {row.scatter: row for row in tracks_rows(8, 0.8)}
    assert eight[0.2].chance_pct == pytest.approx(56.0, abs=1.0)


def test_a_change_that_is_found_in_four_of_five_cases_has_that_chance() -> None:
    for scatter in USUAL_SCATTERS:
        assert chance_found(scatter, 5, change_found(scatter, 5)) == pytest.approx(0.8, abs=1e-6)


def test_two_tracks_have_no_verdict_and_a_sign_test_says_no_more() -> None:
    (row, *_) = tracks_rows(2, 0.5)
    assert (row.finds_pct, row.chance_pct) == (None, 0.0)
    assert [smallest_sign_p(dives) for dives in (1, 2, 5)] == [1.0, 0.5, 0.0625]
    assert "sign test of 2 dives is 0.5" in str(plan_of_tracks(2, 0.9).document)


@pytest.mark.parametrize("ratio", [0.0, -1.0, 0.953, 1.2, math.nan])
def test_a_ratio_that_no_dives_can_find_is_an_error(ratio: float) -> None:
    with pytest.raises(ConfigError, match="cannot be found"):
        list(tracks_rows(5, ratio))
