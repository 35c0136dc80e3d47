"""Verdicts: decided by what the tables say, never by a filter's name."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import pytest
from msgspec.structs import replace

from insdvl_replay.core.quantities import EVIDENCE_QUANTITIES, REFERENCE_QUANTITIES
from insdvl_replay.core.states import STATES
from insdvl_replay.core.tables import (
    Candidate,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    EvidenceRow,
    ImprovementRow,
    ReferenceErrorRow,
    Tables,
)
from insdvl_replay.evaluation.evidence import without_words
from insdvl_replay.evaluation.verdicts import consistency_of, credibility_of, verdicts


def judged(
    words: Sequence[str],
    believed_pct: float = 40.0,
    ratio: tuple[float, float, float] = (0.8, 0.7, 0.9),
    of_aided: str = "consistent",
    of_baseline: str = "consistent",
    errors_of_aided: str = "consistent",
    errors_of_baseline: str = "consistent",
    unsound: Mapping[str, str] = MappingProxyType({}),
    honesty: str = "equivalent",
    independent: bool = True,
    kind: str = "accuracy",
    samples: int = 9,
    starts: int = 16,
) -> Candidate:
    """Judge a candidate whose states all improved alike, by pieces of evidence that say these words."""
    row = "dive", "aided"
    pieces = [
        EvidenceRow(*row, kind, quantity, "m", 2.0, 2.0 * ratio[0], *ratio, 30.0, starts, 60, word)
        for quantity, word in zip(EVIDENCE_QUANTITIES, words, strict=False)
    ]
    pieces.append(EvidenceRow(*row, "honesty", "nis", "", 2.0, 1.0, 0.5, None, None, None, 1, 0, honesty))
    tables = Tables(
        [ImprovementRow(*row, state.id, state.unit, 1.0, 1.0, believed_pct, "improved") for state in STATES],
        [ConvergenceRow(*row, state.id, state.unit, 1.0, 9.0, 9.0, 0.0, "reached") for state in STATES],
        [
            ReferenceErrorRow(*row, quantity, unit, 2.0, 1.6, 20.0, 0.0, 0.0, samples, "compared")
            for quantity, unit in REFERENCE_QUANTITIES.items()
        ],
        [
            consistency("baseline", "velocity", of_baseline),
            consistency("aided", "velocity", of_aided),
            consistency("aided", "acceleration", of_aided),
        ],
        [
            row
            for name, attitude in (("baseline", errors_of_baseline), ("aided", errors_of_aided))
            for row in of_errors(name, attitude)
        ],
        pieces,
    )
    return verdicts(tables, "baseline", ["aided"], unsound, independent=independent)["aided"]


def consistency(filter_: str, measurement: str, verdict: str) -> ConsistencyRow:
    return ConsistencyRow("dive", filter_, measurement, 3, 9, 0, 3.0, 2.0, 4.0, verdict)


def of_errors(filter_: str, attitude: str) -> list[CredibilityRow]:
    """Velocities that are consistent where the attitude could be judged, and all states together always."""
    velocity = attitude if attitude in {"no reference", "too few"} else "consistent"
    rows = ("heading", "too few"), ("velocity", velocity), ("attitude", attitude), ("all", "consistent")
    return [credibility(filter_, *row) for row in rows]


def credibility(filter_: str, quantity: str, verdict: str) -> CredibilityRow:
    return CredibilityRow("dive", filter_, quantity, 1, 9, 1.0, 0.5, 1.5, 68.0, 99.0, verdict, 9.0)


@pytest.mark.parametrize(
    ("words", "judgement"),
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
def test_evidence_together_is_better_where_nothing_is_worse(words: list[str], judgement: str) -> None:
    assert judged(words).improvement == judgement


@pytest.mark.parametrize(
    ("believed_pct", "ratio", "belief"),
    [
        (40.0, (0.6, 0.5, 0.7), "borne out"),
        (40.0, (0.79, 0.79, 0.79), "borne out"),
        (40.0, (0.8, 0.7, 0.9), "undecided"),
        (40.0, (0.9, 0.81, 0.99), "not borne out"),
        (40.0, (1.5, 1.2, 1.8), "not borne out"),
        (4.0, (0.6, 0.5, 0.7), "undecided"),
        (-30.0, (0.6, 0.5, 0.7), "undecided"),
    ],
)
def test_belief_is_borne_out_by_half_of_it_with_its_interval(
    believed_pct: float, ratio: tuple[float, float, float], belief: str
) -> None:
    assert judged(["better"], believed_pct, ratio).belief == belief


@pytest.mark.parametrize(("starts", "belief"), [(1, "undecided"), (7, "undecided"), (8, "not borne out")])
def test_few_starts_say_nothing_of_what_is_believed(starts: int, belief: str) -> None:
    """From the exact start a filter cannot show that it wears off errors of the start."""
    found = judged(["equivalent"], 40.0, (1.0, 0.99, 1.01), starts=starts)
    assert found.belief == belief
    assert ("it takes 8 drawn starts to tell whether that is so" in found.verdict) == (starts < 8)


def test_as_good_names_what_the_first_piece_leaves_undecided() -> None:
    words = ["equivalent", "undecided", "equivalent", "undecided"]
    assert "; undecided: drift in 60 s, velocity along. It believes" in judged(words).verdict
    assert "undecided:" not in judged(["equivalent", "equivalent"]).verdict
    assert "undecided:" not in judged(["better", "undecided"]).verdict


@pytest.mark.parametrize("unsound", ["aided", "baseline"])
@pytest.mark.parametrize("word", ["better", "worse", "undecided"])
def test_nothing_is_said_of_gain_or_loss_where_a_filter_is_dead(unsound: str, word: str) -> None:
    verdict = judged(
        [word],
        of_baseline="over-confident",
        errors_of_aided="too few",
        errors_of_baseline="too few",
        unsound={"aided": f"{unsound} rejected 209 of 300"},
    )
    assert (verdict.improvement, verdict.belief) == ("not judged", "undecided")
    assert verdict.verdict == (
        f"aided is NOT JUDGED against baseline: {unsound} rejected 209 of 300; settle that first. "
        "aided is consistent, baseline over-confident."
    )


def test_sentence_holds_the_numbers_that_it_was_judged_by() -> None:
    sentence = judged(["worse"], 40.0, (1.75, 1.5, 2.0), of_aided="over-confident", honesty="worse").verdict
    assert sentence.startswith(
        "aided is WORSE than baseline: drift in 30 s 75.0 % larger (this dive: 2 m, now 3.5 m; "
        "95 % on this dive: +50.0 to +100.0 %); and it is less honest. It believes in 40.0 % smaller errors, and that "
        "is NOT borne out. "
    )


def test_better_and_more_honest_and_better_than_believed_can_be_said() -> None:
    assert "; and it is more honest." in judged(["better"], honesty="better").verdict
    assert "; but it is more honest." in judged(["worse"], honesty="better").verdict
    assert "; but it is less honest." in judged(["better"], honesty="worse").verdict
    assert "It believes in 30.0 % larger errors. " in judged(["better"], -30.0).verdict


def test_sentence_says_that_a_reference_tells_nothing_of_what_is_believed() -> None:
    sentence = judged(["better"], kind="coasting").verdict
    assert "It believes in 40.0 % smaller errors, and the reference does not tell whether that is so." in sentence


def test_without_a_reference_nothing_is_said_of_what_is_believed() -> None:
    """That there is none is said of the dive, and not of each candidate again."""
    sentence = judged(["better"], kind="coasting", samples=0).verdict
    assert "It believes in 40.0 % smaller errors. Both" in sentence


def test_a_reference_that_shares_sensors_is_part_of_the_sentence() -> None:
    assert judged(["better"], independent=False).verdict.endswith("errors that they have in common are not seen.")
    assert "share" not in judged(["better"]).verdict


@pytest.mark.parametrize(
    ("innovations", "errors", "words"),
    [
        ("consistent", "consistent", "Both filters are consistent."),
        (
            "consistent",
            "over-confident",
            "aided is consistent by the innovations and over-confident in attitude against the reference, baseline "
            "consistent.",
        ),
        ("over-confident", "too few", "aided is over-confident, baseline consistent."),
        ("over-confident", "no reference", "aided is over-confident, baseline consistent."),
        (
            "over-confident",
            "over-confident",
            "aided is over-confident by the innovations, and in attitude against the reference, baseline consistent.",
        ),
        (
            "too few",
            "over-confident",
            "aided is over-confident in attitude against the reference, baseline consistent.",
        ),
    ],
)
def test_sentence_says_whether_innovations_or_errors_speak(innovations: str, errors: str, words: str) -> None:
    verdict = judged(["undecided"], of_aided=innovations, errors_of_aided=errors)
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
    assert [consistency_of(table, name) for name in "abcd"] == [
        "over-confident",
        "over-cautious",
        "too few",
        "not told",
    ]


def test_sentence_names_the_groups_where_others_are_better() -> None:
    alike = {"of_aided": "over-cautious", "of_baseline": "over-cautious"}
    verdict = judged(["undecided"], **alike, errors_of_aided="too few", errors_of_baseline="too few").verdict
    assert verdict.endswith("Both filters are over-cautious.")
    named = judged(["undecided"], **alike, errors_of_aided="over-confident", errors_of_baseline="too few").verdict
    assert named.endswith(
        "aided is over-cautious by the innovations and over-confident in attitude against the reference, baseline "
        "over-cautious."
    )


def test_gravest_group_of_errors_stands_for_the_filter() -> None:
    rows = [
        ("a", "heading", "over-confident"),
        ("a", "velocity", "over-cautious"),
        ("a", "attitude", "consistent"),
        ("a", "all", "consistent"),
        ("b", "velocity", "over-cautious"),
        ("b", "attitude", "over-confident"),
        ("b", "all", "consistent"),
        ("c", "velocity", "consistent"),
        ("c", "attitude", "not in reference"),
        ("d", "velocity", "too few"),
        ("d", "attitude", "not in reference"),
        ("e", "velocity", "no reference"),
        ("e", "attitude", "no reference"),
    ]
    table = [credibility(*row) for row in rows]
    assert [credibility_of(table, name) for name in "abcde"] == [
        "over-cautious", "over-confident", "consistent", "too few", "no reference",
    ]  # fmt: skip


def test_evidence_on_a_candidate_that_is_not_judged_has_no_words() -> None:
    row = EvidenceRow("dive", "aided", "accuracy", "drift_30s", "m", 2.0, 1.0, 0.5, 0.4, 0.6, 30.0, 16, 60, "better")
    found = without_words([row, replace(row, filter="other")], {"aided": "aided rejected 209 of 300"})
    assert [(row.filter, row.word, row.ratio) for row in found] == [("aided", "", 0.5), ("other", "better", 0.5)]
