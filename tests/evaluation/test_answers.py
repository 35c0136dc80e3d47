"""The answer over several dives: which quantity decides, what its word is, what can warn, and what proves nothing."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
from made_verdicts import evidence_row

from insdvl_replay.core.tables import EvidenceRow, PooledRow
from insdvl_replay.core.words import ReasonCode
from insdvl_replay.evaluation.answers import (
    CandidateAnswer,
    pooled_candidate,
    primary_of,
)
from insdvl_replay.evaluation.interval import log_ratio_interval
from insdvl_replay.evaluation.sentences import acts_line, headline, plan_line

Dives = list[list[EvidenceRow]]
BETTER, EQUAL, WORSE, WIDE = (
    (0.70, 0.71, 0.72, 0.69), (1.0, 1.01, 0.99, 1.0), (1.40, 1.42, 1.38, 1.41), (0.5, 0.8, 1.1, 0.7)
)  # fmt: skip


def dives_of(ratios: Mapping[str, Sequence[float]], **changes: Any) -> Dives:
    """Return the rows of several dives, by quantity the ratio on each dive."""
    count = len(next(iter(ratios.values())))
    return [
        [evidence_row(name, values[i], **changes) for name, values in ratios.items()]
        for i in range(count)
    ]


def answer(dives: Dives, **given: Any) -> CandidateAnswer:
    return pooled_candidate("aided", "baseline", dives, len(dives), **given)


def verdict(ratios: Mapping[str, Sequence[float]], **changes: Any) -> str:
    return answer(dives_of(ratios, **changes)).verdict


def row_of(found: CandidateAnswer, quantity: str) -> PooledRow:
    return next(row for row in found.rows if row.quantity == quantity)


# --- The quantity that decides.


def having(*quantities: str, **roles: str) -> list[EvidenceRow]:
    """Return the rows of a dive that has these quantities."""
    return [evidence_row(name, 0.9, role=roles.get(name)) for name in quantities]


POSITION, BOTH, SHORT = (
    having("position", "outage_60s", "outage_30s"),
    ["outage_60s", "outage_30s"],
    "outage_30s",
)


@pytest.mark.parametrize(
    ("dives", "primary"),
    [
        ([POSITION] * 3, "position"),
        ([POSITION], "position"),
        ([POSITION] * 3 + [having(*BOTH)] * 3, "position"),
        ([POSITION] * 2 + [having(*BOTH)] * 2, "outage_60s"),
        ([POSITION] * 3 + [having(*BOTH)] * 4, "outage_60s"),
        ([POSITION, having(*BOTH)], "outage_60s"),
        ([having(*BOTH)] * 4, "outage_60s"),
        ([having(*BOTH)] * 4 + [having(SHORT)], "outage_30s"),
        ([having(*BOTH)] * 4 + [having("level")], ""),
        ([having("position", *BOTH, position="shown")] * 3, "outage_60s"),
        (
            [having("outage_60s", SHORT, outage_60s="secondary")] + [having(*BOTH)] * 3,
            "outage_30s",
        ),
        ([having("level", "drift_60s", "depth")] * 3, ""),
        ([], ""),
    ],
)
def test_logs_choose_what_decides(dives: Dives, primary: str) -> None:
    """Position with three dives of three or more and half of all; an outage row only where every dive has it."""
    assert primary_of(dives) == primary


def test_choice_does_not_depend_on_ratios() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        one, other, third = np.exp(rng.normal(0.0, 1.0, (3, 4)))
        dives = dives_of({"outage_30s": one, "position": other, "outage_60s": third})
        assert primary_of(dives) == "position"


def test_settings_are_respected_even_where_a_dive_lacks_what_they_name() -> None:
    assert primary_of([POSITION] * 3, "drift_60s") == "drift_60s"
    dives = dives_of({"position": WORSE, "drift_60s": BETTER})
    found = answer(dives, primary="drift_60s")
    assert (found.verdict, found.primary) == ("better", "drift_60s")
    lacking = answer(dives_of({"position": BETTER}), primary="drift_60s")
    assert (lacking.verdict, lacking.undecided) == ("undecided", ReasonCode.NO_PRIMARY)


# --- The word.


@pytest.mark.parametrize(
    ("ratios", "word"),
    [(BETTER, "better"), (EQUAL, "equivalent"), (WORSE, "worse"), (WIDE, "undecided")],
)
def test_verdict_is_the_word_of_the_primary_interval(ratios: tuple[float, ...], word: str) -> None:
    found = answer(dives_of({"position": ratios}))
    assert found.verdict == word
    row = row_of(found, "position")
    interval = log_ratio_interval(np.log(ratios))
    assert (row.ratio, row.low, row.high, row.p) == (
        interval.ratio,
        interval.low,
        interval.high,
        interval.p,
    )
    assert (row.low_always, row.high_always) == (interval.low_always, interval.high_always)
    assert (row.dives, row.dives_won, row.role) == (
        4,
        sum(ratio < 1.0 for ratio in ratios),
        "primary",
    )
    without = {
        "better": "better without DVL",
        "worse": "worse without DVL",
        "equivalent": "equivalent without DVL",
    }
    assert verdict({"outage_60s": ratios}) == without.get(word, word), (
        "words of an outage carry their object"
    )


@pytest.mark.parametrize("other", [BETTER, EQUAL, WORSE])
def test_no_other_row_makes_a_verdict(other: tuple[float, ...]) -> None:
    names = (
        "outage_60s",
        "drift_60s",
        "level",
        "heading",
        "velocity_along",
        "velocity_across",
        "drift_30s",
        "depth",
    )
    others = dict.fromkeys(names, other)
    assert verdict({"position": WIDE, **others}) == "undecided"
    assert verdict({"position": EQUAL, **others}) == "equivalent"
    assert verdict({"position": WORSE, **others}) == "worse"
    assert verdict(others) == {BETTER: "better without DVL", EQUAL: "equivalent without DVL"}.get(
        other, "worse without DVL"
    )
    assert (
        verdict({name: values for name, values in others.items() if name != "outage_60s"})
        == "undecided"
    )


@pytest.mark.parametrize(
    "warning", ["outage_60s", "drift_60s", "level", "heading", "velocity_along"]
)
def test_better_next_to_a_kind_that_is_worse_is_mixed_and_names_it(warning: str) -> None:
    found = answer(dives_of({"position": BETTER, warning: WORSE}))
    assert found.verdict == "mixed"
    assert [row.quantity for row in found.warnings] == [warning]
    assert headline(found).startswith("MIXED, position 0.70 (")
    assert headline(found).endswith("worse")
    assert (" but without the DVL " in headline(found)) == (warning == "outage_60s")


@pytest.mark.parametrize(
    "shown", ["drift_30s", "drift_100m", "depth", "depth_60s", "position_end", "outage_120s"]
)
def test_what_is_only_shown_does_not_warn(shown: str) -> None:
    found = answer(dives_of({"position": BETTER, shown: WORSE}))
    assert (found.verdict, found.warnings) == ("better", [])


def test_one_of_a_kind_warns_and_no_kind_warns_of_itself() -> None:
    found = answer(dives_of({"outage_60s": BETTER, "outage_30s": WORSE}))
    assert found.verdict == "better without DVL"
    both = answer(dives_of({"position": BETTER, "outage_60s": EQUAL, "outage_30s": WORSE}))
    assert both.verdict == "better"


def test_worse_and_undecided_name_what_is_better() -> None:
    worse = answer(dives_of({"position": WORSE, "outage_60s": BETTER}))
    assert [row.quantity for row in worse.warnings] == ["outage_60s"]
    assert "but without the DVL" in headline(worse)
    assert headline(worse).endswith("better")
    without = answer(dives_of({"outage_60s": WORSE, "level": BETTER}))
    assert "but level 0.70" in headline(without)
    undecided = answer(dives_of({"position": WIDE, "level": BETTER}))
    assert (undecided.verdict, [row.quantity for row in undecided.warnings]) == (
        "undecided",
        ["level"],
    )


def test_secondary_rows_share_the_error_of_one() -> None:
    """A row that is just worse alone is not among six; one that is surely worse is."""
    just = tuple(np.exp(np.log(1.25) + 0.09 * np.array([-1.0, 1.0, -1.0, 1.0])))
    names = ("outage_60s", "drift_60s", "level", "heading", "velocity_along")
    assert verdict({"position": BETTER, "velocity_across": just}) == "mixed"
    crowded = {"position": BETTER, "velocity_across": just, **dict.fromkeys(names, EQUAL)}
    found = answer(dives_of(crowded))
    assert found.verdict == "better"
    assert row_of(found, "velocity_across").level_pct == pytest.approx(100.0 - 5.0 / 6.0)
    assert row_of(found, "position").level_pct == pytest.approx(95.0), (
        "the primary row shares nothing with them"
    )
    assert verdict({**crowded, "velocity_across": WORSE}) == "mixed"


# --- How far a candidate acts.


def test_candidate_that_moves_no_error_by_a_hundredth_has_no_effect() -> None:
    """A proof, whatever the ratios of the dives look like, on one dive too."""
    for count in (1, 2, 4):
        ratios = {"position": WIDE[:count], "level": WORSE[:count]}
        assert verdict(ratios, acts=0.0099) == "no effect"
        assert verdict(ratios, acts=0.0101) == "equivalent"
        assert verdict(ratios, acts=0.047) == "equivalent"
        assert verdict(ratios, acts=0.048) != "equivalent"


def test_one_row_that_is_moved_takes_the_proof_away() -> None:
    dives = [[evidence_row("position", 1.0, acts=0.001), evidence_row("drift_30s", 1.0, acts=0.2)]]
    found = answer(dives)
    assert (found.verdict, found.undecided) == ("undecided", ReasonCode.ONE_DIVE)
    assert found.acting is not None
    assert found.acting.quantity == "drift_30s"


def test_an_error_that_is_moved_by_an_unknown_share_takes_the_proof_away() -> None:
    dives = dives_of({"position": (1.0,) * 3, "level": (1.0,) * 3}, acts=0.001)
    unknown = [
        msgspec.structs.replace(row, acts=None) if row.quantity == "level" else row
        for row in dives[1]
    ]
    assert answer([dives[0], unknown, dives[2]]).verdict != "no effect"


def test_one_dive_on_which_it_acts_takes_the_proof_away() -> None:
    dives = dives_of({"position": WIDE}, acts=0.001)
    dives[2] = [evidence_row("position", 1.1, acts=0.3)]
    found = answer(dives)
    assert found.verdict == "undecided"
    row = row_of(found, "position")
    assert (row.acts, row.acts_most) == (pytest.approx(0.001), pytest.approx(0.3))


def test_identical_results_say_the_likely_reason() -> None:
    said = headline(answer(dives_of({"position": (1.0,) * 3}, acts=0.0)))
    assert said.startswith("NO EFFECT, identical: ")
    assert "never updated" in said


def test_identical_on_most_dives_is_not_identical() -> None:
    dives = dives_of({"position": (1.0,) * 3}, acts=0.0)
    dives[2] = [evidence_row("position", 1.3, acts=0.4)]
    found = answer(dives)
    assert found.verdict == "undecided"
    said = "acts: identical on most dives; moves the track by up to 40 % of its error"
    assert acts_line(found) == said


# --- Noise of the reference.


def test_noise_of_the_reference_makes_no_filters_equivalent() -> None:
    """Errors that are the reference's own are equal for any two filters."""
    noisy = answer(dives_of({"position": EQUAL}, noise=0.6))
    assert (noisy.verdict, noisy.undecided) == ("undecided", ReasonCode.NOISE)
    assert verdict({"position": EQUAL}, noise=0.4) == "equivalent"
    assert verdict({"position": BETTER}, noise=0.6) == "better", (
        "a difference that is seen is seen"
    )
    assert verdict({"position": EQUAL}, noise=0.6, acts=0.02) == "equivalent", (
        "that is proved without the reference"
    )


# --- Few dives.


@pytest.mark.parametrize("ratio", [0.3, 0.86, 1.0, 3.0])
def test_one_dive_has_a_statement_and_no_verdict(ratio: float) -> None:
    found = answer(dives_of({"position": (ratio,), "level": (0.1,), "heading": (9.0,)}))
    assert (found.verdict, found.undecided) == ("undecided", ReasonCode.ONE_DIVE)
    assert found.warnings == [], "no other row has a word either"
    row = row_of(found, "position")
    assert np.isnan([row.low, row.high, row.p]).all()
    assert headline(found).startswith("on this dive position ")
    assert headline(found).endswith("; one dive cannot tell whether the next one will be")
    assert headline(found).islower() or "DVL" in headline(found)


def test_two_dives_have_no_verdict() -> None:
    found = answer(dives_of({"position": BETTER[:2]}))
    assert (found.verdict, found.undecided) == ("undecided", ReasonCode.FEW_DIVES)


def test_dives_without_the_primary_quantity_do_not_count() -> None:
    dives = dives_of({"position": BETTER[:2], "level": BETTER[:2]}) + dives_of(
        {"level": BETTER[:2]}
    )
    found = answer(dives, primary="position")
    assert (found.verdict, found.undecided) == ("undecided", ReasonCode.FEW_DIVES)
    assert row_of(found, "position").dives == 2
    assert row_of(found, "level").dives == 4


def test_half_of_the_dives_not_evaluated_is_not_evaluated() -> None:
    dives = dives_of({"position": BETTER[:3]})
    reasons = ["the DVL was off", "the DVL was off", "diverged"]
    found = pooled_candidate("aided", "baseline", dives, 6, reasons=reasons)
    assert (found.verdict, found.reason) == ("not evaluated", "the DVL was off")
    most = pooled_candidate("aided", "baseline", dives, 5, reasons=reasons[:2])
    assert (most.verdict, most.dives, most.evaluated) == ("better", 5, 3)


def test_several_candidates_take_a_wider_interval() -> None:
    just = tuple(np.exp(np.log(0.8) + 0.08 * np.array([-1.0, 1.0, -1.0, 1.0])))
    dives = dives_of({"position": just})
    assert answer(dives).verdict == "better"
    assert answer(dives, level=0.99).verdict == "undecided"


# --- Vehicles.


def test_two_vehicles_in_opposite_directions_are_mixed() -> None:
    dives = dives_of({"position": BETTER + WORSE})
    assert answer(dives, vehicles=["a"] * 4 + ["b"] * 4).verdict == "mixed"
    assert answer(dives).verdict == "undecided"
    assert answer(dives, vehicles=["a", "b"] * 4).verdict == "undecided", "each has both"


def test_two_vehicles_that_agree_have_the_common_word() -> None:
    found = answer(dives_of({"position": BETTER + BETTER}), vehicles=["a"] * 4 + ["b"] * 4)
    assert found.verdict == "better"


@pytest.mark.parametrize(
    ("vehicles", "said"),
    [
        (("a",) * 4 + ("b",) * 2 + ("c",) * 2, "of 8 dives of 3 vehicles"),
        (("a",) * 8, "of 8 dives of 1 vehicle"),
        (("a",) * 4 + ("",) * 4, "of 8 dives of 2 vehicles"),
    ],
)
def test_the_headline_counts_the_vehicles_as_the_rule_does(
    vehicles: Sequence[str], said: str
) -> None:
    """Dives of which nobody said the vehicle are those of one more."""
    found = answer(dives_of({"position": BETTER + BETTER}), vehicles=vehicles)
    assert headline(found).endswith(said)
    assert row_of(found, "position").vehicles == len(set(vehicles))


def test_the_headline_counts_no_vehicles_where_nobody_said_which_they_were() -> None:
    found = answer(dives_of({"position": BETTER}), vehicles=[""] * 4)
    assert headline(found).endswith("of 4 dives")


def test_three_vehicles_are_three_samples() -> None:
    """Twelve dives of which those of one vehicle are far better: the vehicles together are undecided."""
    ratios = tuple(
        ratio * factor for factor in (0.5, 0.95, 0.97) for ratio in (1.0, 1.01, 0.99, 1.0)
    )
    dives = dives_of({"position": ratios})
    assert answer(dives).verdict == "better"
    assert answer(dives, vehicles=["a"] * 4 + ["b"] * 4 + ["c"] * 4).verdict == "undecided"


# --- The second answer.


@pytest.mark.parametrize(
    ("ratios", "word"),
    [(BETTER, "sooner"), (EQUAL, "same"), (WORSE, "later"), (WIDE, "undecided")],
)
def test_convergence_has_a_word_of_its_own(ratios: tuple[float, ...], word: str) -> None:
    found = answer(
        dives_of({"position": EQUAL, "convergence_velocity": ratios, "convergence_level": WORSE})
    )
    assert (found.verdict, found.settling) == ("equivalent", word)
    assert found.settles is not None
    assert found.settles.quantity == "convergence_velocity"
    assert found.warnings == []


def test_filter_that_never_settles_on_a_dive_leaves_it_undecided() -> None:
    dives = dives_of({"position": EQUAL, "convergence_velocity": BETTER})
    never = evidence_row("convergence_velocity", math.nan)
    dives[1][1] = type(never)(
        **{**{name: getattr(never, name) for name in never.__struct_fields__}, "value": None}
    )
    found = answer(dives)
    assert found.settling == "undecided"


def test_values_are_those_of_the_dives_that_have_a_ratio() -> None:
    dives = dives_of({"position": EQUAL[:3], "convergence_velocity": (0.9, 0.8, 0.7)})
    seen = [10.0, 20.0, 100.0]
    for number, (dive, baseline) in enumerate(zip(dives, seen, strict=True)):
        ratio = dive[1].ratio
        assert ratio is not None
        value: float | None = ratio * baseline
        if number == 2:
            value = None
            ratio = math.nan
        dive[1] = msgspec.structs.replace(dive[1], baseline=baseline, value=value, ratio=ratio)
    row = row_of(answer(dives), "convergence_velocity")
    assert (row.dives, row.dives_won) == (2, 2)
    assert (row.baseline, row.value) == pytest.approx((15.0, 12.5))
    assert row.ratio == pytest.approx(math.sqrt(0.72))


def test_no_more_dives_are_won_than_count() -> None:
    row = row_of(answer(dives_of({"position": (0.0, 0.5, 0.6, 0.55)})), "position")
    assert (row.dives, row.dives_won) == (3, 3)
    assert row.value == pytest.approx(1.1)


# --- What was predicted.


@pytest.mark.parametrize(
    ("predicted_pct", "ratios", "acts", "prediction"),
    [
        (40.0, BETTER, 0.5, "confirmed"),
        (70.0, BETTER, 0.5, "not confirmed"),
        (40.0, WIDE, 0.5, "undecided"),
        (40.0, WORSE, 0.5, "not confirmed"),
        (40.0, WIDE, 0.1, "not confirmed"),
        (4.0, BETTER, 0.5, "undecided"),
        (-30.0, BETTER, 0.5, "undecided"),
    ],
)
def test_half_of_what_is_predicted_has_to_be_measured_with_its_interval(
    predicted_pct: float, ratios: tuple[float, ...], acts: float, prediction: str
) -> None:
    found = answer(dives_of({"position": ratios}, acts=acts), predicted_pct=[predicted_pct] * 4)
    assert found.prediction == prediction


def test_one_dive_confirms_nothing() -> None:
    assert answer(dives_of({"position": (0.3,)}), predicted_pct=[40.0]).prediction == "undecided"


def test_plan_says_what_these_dives_find() -> None:
    """Four dives with a scatter of 0.02 find some 8 %; those with 0.1 need more for 10 %."""
    precise = answer(dives_of({"position": tuple(np.exp([-0.02, 0.02, -0.02, 0.02]))}))
    assert "would show a change of 9 % in position in four of five cases." in plan_line(precise)
    rough = answer(dives_of({"position": tuple(np.exp([-0.1, 0.1, -0.1, 0.1]))}))
    assert "in four of five cases, while " in plan_line(rough)
    assert plan_line(rough).endswith("dives would show one of 10 %.")
