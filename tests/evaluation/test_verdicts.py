"""Verdicts on one dive: decided by what the tables say, never by a filter's name."""

import re

import numpy as np
import pytest
from made_histories import history
from made_verdicts import consistency, credibility, evidence_row, judged

from insdvl_replay.core.errors import Note
from insdvl_replay.core.tables import EvidenceRow, Tables
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.verdicts import consistency_of, credibility_of, evaluated_candidates


def dive(**ratios: float) -> list[EvidenceRow]:
    """Return the evidence of a dive by quantity."""
    return [evidence_row(name, ratio) for name, ratio in ratios.items()]


@pytest.mark.parametrize("ratio", [0.1, 1.0, 9.0])
def test_one_dive_is_undecided_and_says_what_was_on_it(ratio: float) -> None:
    found = judged(dive(position=ratio, level=0.1, drift_60s=9.0))
    assert (found.verdict, found.prediction, found.primary) == (
        "undecided",
        "undecided",
        "position",
    )
    assert re.match(
        r"aided against baseline: on this dive position .*; one dive cannot tell", found.sentence
    )


@pytest.mark.parametrize(
    ("acts", "verdict", "word"),
    [(0.0, "no effect", "NO EFFECT"), (0.03, "equivalent", "EQUIVALENT")],
)
def test_one_dive_proves_how_little_a_candidate_does(acts: float, verdict: str, word: str) -> None:
    found = judged(
        [evidence_row("position", 1.0, acts=acts), evidence_row("level", 1.0, acts=acts)]
    )
    assert found.verdict == verdict
    assert found.sentence.startswith(f"aided against baseline: {word}, ")


def test_a_prediction_is_refuted_by_a_proof_alone() -> None:
    """A filter that moves the position by 15 % cannot make it smaller by half of 40 %."""
    assert judged([evidence_row("position", 0.9, acts=0.15)], 40.0).prediction == "not confirmed"
    assert judged([evidence_row("position", 0.9, acts=0.25)], 40.0).prediction == "undecided"


def test_settings_name_what_decides() -> None:
    rows = dive(position=0.8, drift_60s=1.2)
    assert judged(rows).primary == "position"
    found = judged(rows, primary="drift_60s")
    assert found.primary == "drift_60s"
    assert "on this dive drift in 60 s 20.0 % larger" in found.sentence


def test_without_an_independent_position_the_outage_decides_and_says_so() -> None:
    rows = [evidence_row("position", 0.8, role="shown"), evidence_row("outage_30s", 0.7)]
    found = judged(rows)
    assert found.primary == "outage_30s"
    assert "no position reference" in found.sentence
    assert "no position reference" not in judged(dive(position=0.8, outage_30s=0.7)).sentence


@pytest.mark.parametrize("unsound", ["aided", "baseline"])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_nothing_is_said_of_gain_or_loss_where_a_filter_is_dead(
    unsound: str, ratio: float
) -> None:
    verdict = judged(
        dive(position=ratio),
        of_baseline="overconfident",
        errors_of_aided="insufficient data",
        errors_of_baseline="insufficient data",
        unsound={"aided": f"{unsound} rejected 209 of 300"},
    )
    assert (verdict.verdict, verdict.prediction) == ("not evaluated", "undecided")
    assert f"{unsound} rejected 209 of 300. settle this first." in verdict.sentence.lower()
    assert "smaller" not in verdict.sentence
    assert "larger" not in verdict.sentence


def test_sentence_holds_the_numbers_that_it_was_evaluated_by() -> None:
    sentence = judged(
        [evidence_row("position", 1.75, acts=0.8)], 40.0, of_aided="overconfident"
    ).sentence
    assert "on this dive position 75.0 % larger" in sentence
    assert "moves the track by 1.6 m, 80 % of its error" in sentence
    assert "predicted: 40.0 % smaller sigma. Not confirmed: position is not smaller." in sentence
    assert "aided is overconfident" in sentence
    assert " 30.0 % larger" in judged(dive(position=0.8), -30.0).sentence


@pytest.mark.parametrize(
    "errors", ["consistent", "overconfident", "insufficient data", "no reference"]
)
@pytest.mark.parametrize("innovations", ["consistent", "overconfident", "insufficient data"])
def test_innovations_and_errors_have_a_word_each(innovations: str, errors: str) -> None:
    verdict = judged(dive(position=1.0), of_aided=innovations, errors_of_aided=errors)
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


def test_evidence_on_a_candidate_that_is_not_evaluated_decides_nothing() -> None:
    rows = dive(position=0.5, level=0.5)
    histories = tuple(history(name, np.full(9, 3.0)) for name in ("baseline", "aided"))
    contradiction = Note(
        "dvl_contradiction", "columns contradict each other", severity=Severity.WARNING
    )
    for notes, roles, word in (
        ((), ["primary", "secondary"], "undecided"),
        ((contradiction,), ["shown", "shown"], "not evaluated"),
    ):
        tables, found = evaluated_candidates(
            histories, {}, Tables([], [], [], [], [], rows), notes
        )
        assert [row.role for row in tables.evidence] == roles
        assert [row.ratio for row in tables.evidence] == [0.5, 0.5]
        assert found["aided"].verdict == word
