"""Verdicts: decided by what the tables say, never by a filter's name."""

import re

import numpy as np
import pytest
from made_histories import history
from made_verdicts import consistency, credibility, judged

from insdvl_replay.core.errors import Note
from insdvl_replay.core.tables import EvidenceRow, Tables
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.verdicts import consistency_of, credibility_of, evaluated_candidates


@pytest.mark.parametrize(
    ("words", "verdict"),
    [
        (["better", "equivalent", "undecided"], "better"),
        (["undecided", "undecided", "better"], "better"),
        (["worse", "equivalent"], "worse"),
        (["better", "worse"], "mixed"),
        (["equivalent", "undecided"], "equivalent"),
        (["undecided", "equivalent"], "undecided"),
        ([], "undecided"),
    ],
)
def test_evidence_together_is_better_where_nothing_is_worse(words: list[str], verdict: str) -> None:
    assert judged(words).verdict == verdict


@pytest.mark.parametrize(
    ("predicted_pct", "ratio", "prediction"),
    [
        (40.0, (0.6, 0.5, 0.7), "confirmed"),
        (40.0, (0.79, 0.79, 0.79), "confirmed"),
        (40.0, (0.8, 0.7, 0.9), "undecided"),
        (40.0, (0.9, 0.81, 0.99), "not confirmed"),
        (40.0, (1.5, 1.2, 1.8), "not confirmed"),
        (4.0, (0.6, 0.5, 0.7), "undecided"),
        (-30.0, (0.6, 0.5, 0.7), "undecided"),
    ],
)
def test_prediction_is_confirmed_by_half_of_it_with_its_interval(
    predicted_pct: float, ratio: tuple[float, float, float], prediction: str
) -> None:
    assert judged(["better"], predicted_pct, ratio).prediction == prediction


@pytest.mark.parametrize(("starts", "prediction"), [(1, "undecided"), (7, "undecided"), (8, "not confirmed")])
def test_few_starts_say_nothing_of_what_is_predicted(starts: int, prediction: str) -> None:
    """From the exact start a filter cannot show that it wears off errors of the start."""
    found = judged(["equivalent"], 40.0, (1.0, 0.99, 1.01), starts=starts)
    assert found.prediction == prediction
    assert bool(re.search(r"takes 8 random starts\b", found.sentence)) == (starts < 8)


def test_as_good_names_what_the_first_piece_leaves_undecided() -> None:
    words = ["equivalent", "undecided", "equivalent", "undecided"]
    assert "undecided: drift in 60 s, velocity along." in judged(words).sentence
    assert "undecided:" not in judged(["equivalent", "equivalent"]).sentence
    assert "undecided:" not in judged(["better", "undecided"]).sentence


@pytest.mark.parametrize("unsound", ["aided", "baseline"])
@pytest.mark.parametrize("word", ["better", "worse", "undecided"])
def test_nothing_is_said_of_gain_or_loss_where_a_filter_is_dead(unsound: str, word: str) -> None:
    verdict = judged(
        [word],
        of_baseline="overconfident",
        errors_of_aided="insufficient data",
        errors_of_baseline="insufficient data",
        unsound={"aided": f"{unsound} rejected 209 of 300"},
    )
    assert (verdict.verdict, verdict.prediction) == ("not evaluated", "undecided")
    assert f": {unsound} rejected 209 of 300" in verdict.sentence


def test_sentence_holds_the_numbers_that_it_was_evaluated_by() -> None:
    sentence = judged(["worse"], 40.0, (1.75, 1.5, 2.0), of_aided="overconfident", of_consistency="worse").sentence
    assert re.match(r"aided .*WORSE .*baseline: drift in 30 s 75\.0 % .*3\.5 m .*2 m; .*\+50\.0 .*\+100\.0 %", sentence)
    assert "40.0 %" in sentence
    assert " 30.0 % larger" in judged(["better"], -30.0).sentence


def test_a_reference_that_shares_sensors_is_part_of_the_sentence() -> None:
    apart = judged(["better"]).sentence
    assert judged(["better"], independent=False).sentence.startswith(f"{apart} ")


@pytest.mark.parametrize("errors", ["consistent", "overconfident", "insufficient data", "no reference"])
@pytest.mark.parametrize("innovations", ["consistent", "overconfident", "insufficient data"])
def test_innovations_and_errors_have_a_word_each(innovations: str, errors: str) -> None:
    verdict = judged(["undecided"], of_aided=innovations, errors_of_aided=errors)
    assert (verdict.consistency, verdict.credibility) == (innovations, errors)


def test_gravest_verdict_of_the_measurements_is_for_the_filter() -> None:
    rows = [
        ("a", "velocity", "consistent"),
        ("a", "acceleration", "conservative"),
        ("a", "velocity", "overconfident"),
        ("b", "velocity", "conservative"),
        ("b", "velocity_x", "overconfident"),
        ("c", "velocity", "insufficient data"),
    ]
    table = [consistency(*row) for row in rows]
    assert [consistency_of(table, name) for name in "abcd"] == [
        "overconfident",
        "conservative",
        "insufficient data",
        "not available",
    ]


def test_gravest_group_of_errors_is_for_the_filter() -> None:
    rows = [
        ("a", "heading", "overconfident"),
        ("a", "velocity", "conservative"),
        ("a", "attitude", "consistent"),
        ("a", "all", "consistent"),
        ("b", "velocity", "conservative"),
        ("b", "attitude", "overconfident"),
        ("b", "all", "consistent"),
        ("c", "velocity", "consistent"),
        ("c", "attitude", "not in reference"),
        ("d", "velocity", "insufficient data"),
        ("d", "attitude", "not in reference"),
        ("e", "velocity", "no reference"),
        ("e", "attitude", "no reference"),
    ]
    table = [credibility(*row) for row in rows]
    assert [credibility_of(table, name) for name in "abcde"] == [
        "conservative", "overconfident", "consistent", "insufficient data", "no reference",
    ]  # fmt: skip


def test_evidence_on_a_candidate_that_is_not_evaluated_has_no_words() -> None:
    row = EvidenceRow("dive", "aided", "accuracy", "drift_30s", "m", 2.0, 1.0, 0.5, 0.4, 0.6, 30.0, 16, 60, "better")
    histories = tuple(history(name, np.full(9, 3.0)) for name in ("baseline", "aided"))
    contradiction = Note("dvl_contradiction", "columns contradict each other", severity=Severity.WARNING)
    for notes, word in ((), "better"), ((contradiction,), ""):
        tables, found = evaluated_candidates(histories, {}, Tables([], [], [], [], [], [row]), notes, independent=True)
        assert [(left.verdict, left.ratio) for left in tables.evidence] == [(word, 0.5)]
        assert found["aided"].verdict == (word or "not evaluated")
