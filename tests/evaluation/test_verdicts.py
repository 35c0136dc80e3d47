"""Verdicts: decided by what the tables say, never by a filter's name."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pytest

from insdvl_replay.core.states import STATES
from insdvl_replay.core.tables import (
    REFERENCE_QUANTITIES,
    Candidate,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    ImprovementRow,
    ReferenceErrorRow,
    Tables,
)
from insdvl_replay.evaluation.verdicts import consistency_of, credibility_of, verdicts


def judged(
    believed_pct: float,
    actual_pct: float | None,
    of_aided: str = "consistent",
    of_baseline: str = "consistent",
    errors_of_aided: str = "consistent",
    errors_of_baseline: str = "consistent",
    dead: Mapping[str, str] = MappingProxyType({}),
    status: str = "compared",
) -> Candidate:
    """Judge a candidate whose states all improved alike, and whose errors all did."""
    known = actual_pct is not None
    rmse = 2.0 * (1.0 - actual_pct / 100.0) if actual_pct is not None else np.nan
    tables = Tables(
        [ImprovementRow("dive", "aided", state.id, state.unit, 1.0, 1.0, believed_pct, "improved") for state in STATES],
        [ConvergenceRow("dive", "aided", state.id, state.unit, 1.0, 9.0, 9.0, 0.0, "reached") for state in STATES],
        [
            ReferenceErrorRow(
                *("dive", "aided", quantity, unit, 2.0, rmse, actual_pct, 0.0, 0.0, 9),
                status if known else "no reference",
            )
            for quantity, unit in REFERENCE_QUANTITIES.items()
        ],
        [
            consistency("baseline", "velocity", of_baseline),
            consistency("aided", "velocity", of_aided),
            consistency("aided", "acceleration", of_aided),
        ],
        [credibility("baseline", "all", errors_of_baseline), credibility("aided", "all", errors_of_aided)],
    )
    return verdicts(tables, "baseline", ["aided"], dead)["aided"]


def consistency(filter_: str, measurement: str, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, measurement, 3, 9, 0, 3.0, 2.0, 4.0, verdict)


def credibility(filter_: str, quantity: str, verdict: str) -> CredibilityRow:
    return CredibilityRow("dive", filter_, quantity, 1, 9, 1.0, 0.5, 1.5, 68.0, 99.0, verdict, 9.0)


@pytest.mark.parametrize(
    ("believed_pct", "actual_pct", "word"),
    [
        (40.0, 35.0, "borne out"),
        (40.0, 20.0, "borne out"),
        (40.0, 19.9, "not borne out"),
        (40.0, 0.0, "not borne out"),
        (40.0, -4.9, "not borne out"),
        (40.0, -5.1, "worse"),
        (0.0, -50.0, "worse"),
        (1.0, 0.5, "none believed"),
        (-20.0, 0.0, "none believed"),
        (40.0, None, "no reference"),
    ],
)
def test_improvement_is_judged_by_the_reference(believed_pct: float, actual_pct: float | None, word: str) -> None:
    assert judged(believed_pct, actual_pct).improvement == word


@pytest.mark.parametrize("dead", ["aided", "baseline"])
@pytest.mark.parametrize("actual_pct", [80.0, -80.0, None])
def test_nothing_is_said_of_gain_or_loss_where_a_filter_is_dead(dead: str, actual_pct: float | None) -> None:
    verdict = judged(
        40.0,
        actual_pct,
        "consistent",
        "over-confident",
        "too few",
        "too few",
        dead={dead: f"{dead} rejected 209 of 300"},
    )
    assert verdict.improvement == "not judged"
    assert verdict.verdict == (
        f"aided is NOT JUDGED against baseline: {dead} rejected 209 of 300; settle that first. "
        "aided is consistent, baseline over-confident."
    )


def test_sentence_holds_the_numbers_that_it_was_judged_by() -> None:
    sentence = judged(40.0, -75.0, of_aided="over-confident", errors_of_aided="over-confident").verdict
    assert "40.0 % smaller errors than baseline" in sentence
    assert "75.0 % larger in the median (position 2.00 m, now 3.50 m): it is WORSE" in sentence
    assert "aided is over-confident, baseline consistent." in sentence


def test_errors_of_a_part_of_the_dive_decide_nothing() -> None:
    verdict = judged(40.0, 35.0, status="partly covered")
    assert verdict.improvement == "no reference"
    assert "the reference covers too little of the replay to compare with" in verdict.verdict


def test_sentence_without_a_reference_says_so() -> None:
    assert "there is no reference to compare with: nothing tells whether that is so" in judged(40.0, None).verdict


@pytest.mark.parametrize(
    ("innovations", "errors", "words"),
    [
        ("consistent", "consistent", "Both filters are consistent."),
        (
            "consistent",
            "over-confident",
            "aided is consistent by the innovations and over-confident against the reference, baseline consistent.",
        ),
        ("over-confident", "too few", "aided is over-confident, baseline consistent."),
        ("over-confident", "no reference", "aided is over-confident, baseline consistent."),
        ("too few", "over-confident", "aided is over-confident against the reference, baseline consistent."),
    ],
)
def test_sentence_says_whether_innovations_or_errors_speak(innovations: str, errors: str, words: str) -> None:
    verdict = judged(40.0, 0.0, of_aided=innovations, errors_of_aided=errors)
    assert verdict.verdict.endswith(words)
    assert (verdict.consistency, verdict.credibility) == (innovations, errors)


def test_gravest_verdict_of_the_measurements_stands_for_the_filter() -> None:
    rows = [
        ("a", "velocity", "consistent"),
        ("a", "acceleration", "over-cautious"),
        ("a", "velocity", "over-confident"),
        ("b", "velocity", "over-cautious"),
        ("b", "velocity_x", "over-confident"),
        ("c", "velocity", "too few"),
    ]
    table = [consistency(*row) for row in rows]
    assert [consistency_of(table, name) for name in "abcd"] == ["over-confident", "over-cautious", "too few", "too few"]


def test_errors_of_all_states_together_stand_for_the_filter() -> None:
    rows = [
        ("a", "velocity_n", "over-confident"),
        ("a", "all", "consistent"),
        ("b", "velocity_n", "over-cautious"),
        ("b", "heading", "too few"),
        ("b", "all", "no reference"),
    ]
    table = [credibility(*row) for row in rows]
    assert [credibility_of(table, name) for name in "ab"] == ["consistent", "no reference"]
