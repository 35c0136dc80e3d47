"""The word of position must not depend on how well a reference happens to know the heading at the start."""

import math

import pytest

from insdvl_replay.core.dive_record import StartHeading
from insdvl_replay.core.quantities import DRAWN_HEADING, label
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import HeadingSource, Role, Verdict
from insdvl_replay.evaluation.answers import CandidateAnswer, pooled_candidate
from insdvl_replay.evaluation.sentences import answer_lines, headline, start_of

SCATTER = (
    -0.02,
    -0.01,
    0.0,
    0.01,
    0.02,
)  # of the logarithms over five dives; the interval is a factor 1.02 wide
WIDE = tuple(10.0 * step for step in SCATTER)  # the interval is a factor 1.22 wide


def row(quantity: str, log_ratio: float, role: Role) -> EvidenceRow:
    ratio = math.exp(log_ratio)
    return EvidenceRow(
        "dive",
        "compass",
        "track",
        quantity,
        "m",
        1.0,
        ratio,
        ratio,
        acts=1.0,
        samples=100,
        role=role,
    )


def answer(
    ratio: float,
    drawn: float,
    *,
    scatter: tuple[float, ...] = SCATTER,
    drawn_scatter: tuple[float, ...] = SCATTER,
) -> CandidateAnswer:
    """Return the answer on dives with a ratio from the reference's heading, and one from a drawn heading."""
    dives = [
        [
            row("position", math.log(ratio) + step, Role.PRIMARY),
            row(DRAWN_HEADING, math.log(drawn) + drawn_step, Role.SHOWN),
        ]
        for step, drawn_step in zip(scatter, drawn_scatter, strict=True)
    ]
    return pooled_candidate("compass", "baseline", dives, len(dives))


@pytest.mark.parametrize(
    ("ratio", "drawn", "word"),
    [
        (0.8, 0.6, Verdict.BETTER),
        (1.3, 1.2, Verdict.WORSE),
        (1.0, 1.0, Verdict.EQUIVALENT),
        (1.9, 0.6, Verdict.MIXED),
        (0.8, 1.2, Verdict.MIXED),
        (1.0, 0.6, Verdict.MIXED),
        (0.8, 1.0, Verdict.MIXED),
    ],
)
def test_two_words_that_differ_are_mixed(ratio: float, drawn: float, word: Verdict) -> None:
    found = answer(ratio, drawn)
    assert found.verdict == word
    assert found.is_by_heading == (word == Verdict.MIXED)


@pytest.mark.parametrize(
    ("ratio", "drawn", "word"),
    [
        (0.8, 0.9, Verdict.BETTER),  # on the same side
        (0.8, 1.04, Verdict.BETTER),  # no different from 1
        (0.8, 1.06, Verdict.MIXED),  # beyond the band on the other side
        (1.3, 0.97, Verdict.WORSE),
        (1.3, 0.94, Verdict.MIXED),
    ],
)
def test_an_undecided_row_denies_a_word_from_beyond_the_band_on_the_other_side(
    ratio: float, drawn: float, word: Verdict
) -> None:
    assert answer(ratio, drawn, drawn_scatter=WIDE).verdict == word


def test_an_undecided_position_is_mixed_where_the_drawn_heading_decides_on_the_other_side() -> (
    None
):
    assert answer(1.1, 0.6, scatter=WIDE).verdict == Verdict.MIXED
    assert answer(0.95, 0.6, scatter=WIDE).verdict == Verdict.UNDECIDED


def test_the_drawn_heading_never_decides_alone() -> None:
    """It is no primary quantity: without a position that may decide there is no word."""
    dives = [[row(DRAWN_HEADING, math.log(0.6) + step, Role.SHOWN)] for step in SCATTER]
    assert pooled_candidate("compass", "baseline", dives, 5).verdict == Verdict.UNDECIDED


def test_both_ratios_of_a_mixed_answer_are_in_the_headline_and_the_start_below() -> None:
    found = answer(1.9, 0.6)
    assert headline(found) == (
        "MIXED, position 1.90 (1.86 .. 1.94) from the heading of the reference, smaller on 0 of 5 dives, "
        f"but {label(DRAWN_HEADING)} 0.60 (0.59 .. 0.61)"
    )
    (line,) = (
        line
        for line in answer_lines(found, start="heading of the reference (0.06 deg)")
        if "start: " in line
    )
    assert line == (
        "start: heading of the reference (0.06 deg); from a heading as uncertain as [initial]: "
        "position, drawn heading 0.60 (0.59 .. 0.61) better"
    )


def test_the_ratio_from_the_drawn_heading_stands_below_a_word_that_it_confirms() -> None:
    lines = answer_lines(answer(0.8, 0.6))
    assert "drawn" not in headline(answer(0.8, 0.6))
    assert any("position, drawn heading 0.60 (0.59 .. 0.61) better" in line for line in lines)


def test_the_start_of_several_dives_is_named_by_source() -> None:
    reference = [StartHeading(HeadingSource.REFERENCE, sd_deg) for sd_deg in (0.06, 0.3)]
    assert start_of(reference[:1]) == "heading of the reference (0.06 deg)"
    assert start_of(reference) == "heading of the reference (0.06 to 0.3 deg)"
    both = [*reference, StartHeading(HeadingSource.SENSOR, 2.0)]
    assert (
        start_of(both)
        == "heading of the reference (0.06 to 0.3 deg) on 2 dives, heading of the sensor (2 deg) on 1 dive"
    )
    assert start_of([]) == ""
