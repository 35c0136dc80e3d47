"""How the benchmarks count words on drawn log ratios: with rules that are known to be right, wrong or late."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import rule_worlds
from judged import Found
from rule_worlds import (
    SHAPES,
    Tally,
    at_least,
    at_most,
    contradicts,
    family,
    looks,
    of_vehicles,
    pairs,
    pairs_row,
)

REPEATS = 300


def use_rule(
    monkeypatch: pytest.MonkeyPatch, word: Callable[[Sequence[float], float], str]
) -> None:
    """Let a rule of the test stand in for the tool's: a word of the log ratios and the level."""

    def over_dives(
        logs: Sequence[float], *, level: float = 0.95, vehicles: object = None, always: bool = True
    ) -> Found:
        said = word(logs, level)
        mean = math.exp(sum(logs) / len(logs))
        return Found(0.5 * mean, 2.0 * mean, said, said)

    monkeypatch.setattr(rule_worlds, "over_dives", over_dives)


def by_mean(logs: Sequence[float], _: float) -> str:
    """Believe every mean, however few dives made it."""
    return "better" if sum(logs) < 0.0 else "worse"


@pytest.mark.parametrize("shape", SHAPES)
def test_scatter_has_no_mean_and_a_standard_deviation_of_one(shape: str) -> None:
    drawn = SHAPES[shape](np.random.default_rng(1), (200_000,))
    assert drawn.mean() == pytest.approx(0.0, abs=0.01)
    assert drawn.std() == pytest.approx(1.0, abs=0.02)


def test_skewed_scatter_is_skewed() -> None:
    for shape, least in (("normal", -0.1), ("lognormal", 1.8), ("exponential", 1.8)):
        drawn = SHAPES[shape](np.random.default_rng(1), (200_000,))
        assert float(np.mean(drawn**3)) > least
    assert abs(float(np.mean(SHAPES["normal"](np.random.default_rng(1), (200_000,)) ** 3))) < 0.1


@pytest.mark.parametrize(
    ("word", "ratio", "is_false"),
    [
        ("better", 0.8, False),
        ("better", 0.97, True),
        ("better", 1.0 / 1.05, True),
        ("better", 1.2, True),
        ("worse", 1.2, False),
        ("worse", 1.03, True),
        ("worse", 1.05, True),
        ("equivalent", 1.0, False),
        ("equivalent", 1.04, False),
        ("equivalent", 0.9, True),
        ("undecided", 0.5, False),
    ],
)
def test_a_word_is_false_where_the_truth_contradicts_it(
    word: str, ratio: float, is_false: bool
) -> None:
    assert contradicts(word, math.log(ratio)) is is_false


def test_a_rule_that_believes_every_mean_is_wrong_on_all_equal_pairs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    use_rule(monkeypatch, by_mean)
    equal, changed = (pairs("normal", 0.1, 5, ratio, REPEATS) for ratio in (1.0, 0.8))
    assert equal.wrong == equal.archives == REPEATS
    assert equal.opposite == 0
    assert (changed.better, changed.worse, changed.opposite) == (REPEATS, 0, 0)
    assert equal.better == pytest.approx(REPEATS / 2, abs=4.0 * math.sqrt(REPEATS) / 2.0)
    assert not pairs_row("normal", 0.1, 5, REPEATS).is_met


def test_a_rule_that_says_nothing_finds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, lambda *_: "undecided")
    row = pairs_row("normal", 0.1, 5, REPEATS)
    assert not row.is_met
    assert "| 0.0 | 0.0 | 0.0 | 80 |" in row.text
    assert pairs_row("exponential", 0.1, 5, REPEATS).is_met


def test_an_interval_that_does_not_hold_the_truth_is_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    use_rule(monkeypatch, lambda *_: "undecided")
    assert pairs("normal", 0.1, 5, 1.0, REPEATS).missed == 0
    # Half to twice the mean, of one dive with a scatter of 1.
    share = pairs("normal", 1.0, 1, 1.0, 4000).missed / 4000
    assert share == pytest.approx(2.0 * 0.2441, abs=0.03)


def test_of_few_vehicles_the_truth_is_that_of_these(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, by_mean)
    for dives, share in (((50,), 0.5), ((50, 50, 50), 1.0)):
        # Vehicles differ so much that a vehicle's own ratio is nearly always beyond the margin.
        found = of_vehicles(dives, 0.01, 5.0, 1.0, REPEATS)
        is_of_these = len(dives) < 3
        assert found.wrong == (pytest.approx(0, abs=10) if is_of_these else REPEATS), share
        assert found.missed < 10 if is_of_these else found.missed > REPEATS // 2


def test_a_word_at_any_look_stays_said(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, lambda logs, _: "better" if len(logs) == 10 else "undecided")
    equal = looks(0.1, 1.0, 30, 20)
    assert (equal.false_by[8], equal.false_by[13], equal.false_by[30]) == (0, 20, 20)
    changed = looks(0.1, 0.8, 20, 20)
    assert (changed.found_by[8], changed.found_by[13], changed.false_by[20]) == (0, 20, 0)


def test_a_word_on_any_candidate_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    use_rule(monkeypatch, by_mean)
    equal = family(5, 3, 0.1, named=False, ratio=1.0, repeats=50)
    assert (equal.wrong, equal.others_wrong) == (50, 50)
    use_rule(
        monkeypatch,
        lambda logs, _: "better" if sum(logs) / len(logs) < math.log(0.9) else "undecided",
    )
    changed = family(2, 20, 0.05, named=True, ratio=0.8, repeats=50)
    assert (changed.found, changed.wrong) == (50, 0)


def test_the_named_candidate_has_a_level_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = list[float]()
    use_rule(monkeypatch, lambda _, level: levels.append(level) or "undecided")
    monkeypatch.setattr(
        rule_worlds,
        "level_of",
        lambda _, *, named, is_named: 0.95 if is_named or not named else 0.99,
    )
    family(3, 3, 0.1, named=True, ratio=1.0, repeats=2)
    assert levels == [0.95, 0.99, 0.99] * 2


def test_chance_is_allowed_for_and_no_more() -> None:
    tallied = Tally(
        archives=1000, better=60, worse=0, equivalent=0, wrong=60, opposite=0, missed=0
    )
    assert at_most(tallied, 60, 5.0)
    assert not at_most(tallied, 80, 5.0)
    assert at_least(tallied, 320, 35.0)
    assert not at_least(tallied, 290, 35.0)
