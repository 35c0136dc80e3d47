"""Steps over versions: planted ones are named, and hardly ever one that is not there."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from made_versions import first_dives, made_versions
from scipy.special import stdtrit

from insdvl_replay.core.words import EvidenceVerdict
from insdvl_replay.evaluation.interval import BAND, LEVEL, log_ratio_interval, quantile_always
from insdvl_replay.evaluation.steps import Version, history_of, level_of_comparison

SIX = [0.0] * 6
AT_V3 = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]


def planted(size: float) -> list[float]:
    """Return the changes of six versions, of which the fourth is larger by a share."""
    return [math.log(1.0 + size) * is_new for is_new in AT_V3]


def steps_of(versions: Sequence[Version]) -> list[str]:
    """Return the names of the versions at which a step is."""
    return [step.version.name for step in history_of(versions).steps]


def ever_named(seed: int, changes: Sequence[float], dives: int, jitter: float) -> bool:
    """Return whether a step is named in any look at a growing archive, after each dive and each version."""
    versions = made_versions(seed, changes, dives=dives, jitter=jitter)
    return any(history_of(first_dives(versions, count)).steps for count in range(3, dives + 1))


def named_too_often(seeds: int, dives: int, jitter: float) -> int:
    """Count histories with a step, of which none has one: without change, and with one as large as the band."""
    named = 0
    at_edge = [0.0, *[math.log(BAND)] * 5]
    for seed in range(seeds):
        named += ever_named(seed, SIX, dives, jitter)
        named += ever_named(seed, at_edge, dives, jitter)
    return named


# --- Rates.


def test_six_equal_versions_have_no_step() -> None:
    assert named_too_often(15, dives=10, jitter=0.05) <= 1


@pytest.mark.nightly
@pytest.mark.parametrize("jitter", [0.02, 0.05, 0.1, 0.3])
@pytest.mark.parametrize("dives", [6, 12, 20])
def test_in_at_most_one_of_twenty_histories_without_change_a_step_is_named(
    dives: int, jitter: float
) -> None:
    assert named_too_often(100, dives, jitter) <= 200 / 20


@pytest.mark.parametrize(("dives", "size"), [(8, 0.3), (12, 0.2), (20, 0.15)])
def test_a_planted_step_is_named_at_its_version(dives: int, size: float) -> None:
    found = []
    for seed in range(40):
        found.append(steps_of(made_versions(seed, planted(size), dives=dives)))
        found.append(steps_of(made_versions(seed, planted(1.0 / (1.0 + size) - 1.0), dives=dives)))
    assert found.count(["v3"]) >= 0.95 * len(found)
    assert all(names in (["v3"], []) for names in found)


# --- The rule.


def test_a_step_has_ratio_interval_and_both_sides() -> None:
    versions = made_versions(1, planted(0.2))
    found = history_of(versions)
    (step,) = found.steps
    logs = [
        versions[3].log_ratios[dive] - versions[0].log_ratios[dive]
        for dive in versions[0].log_ratios
    ]
    change = step.change
    assert step.version is versions[3]
    assert step.seen_at is versions[3]
    assert change.before is versions[0]
    assert change.word == EvidenceVerdict.WORSE
    assert change.ratio == pytest.approx(math.exp(np.mean(logs)))
    assert change.ratio_after / change.ratio_before == pytest.approx(change.ratio)
    level = level_of_comparison(3)
    half = stdtrit(11, 0.5 + 0.5 * level) * np.std(logs, ddof=1) / math.sqrt(12)
    assert change.low == pytest.approx(math.exp(np.mean(logs) - half))
    assert change.high == pytest.approx(math.exp(np.mean(logs) + half))
    assert not change.is_for_every_look
    assert [change is None for change in found.changes] == [True, *[False] * 5]
    last = found.changes[-1]
    assert last is not None
    assert last.before is versions[3], "the first one since the step"


def test_shares_of_the_error_sum_to_that_of_one() -> None:
    shares = [1.0 - level_of_comparison(number) for number in range(1, 100_000)]
    assert 2.0 * sum(shares) == pytest.approx(1.0 - LEVEL, rel=1e-4)
    assert 2.0 * sum(shares) < 1.0 - LEVEL
    assert shares == sorted(shares, reverse=True)


def test_a_step_that_its_first_version_cannot_show_is_named_at_this_version() -> None:
    versions = made_versions(1, planted(0.2))
    few = dict(list(versions[3].log_ratios.items())[:3])
    versions[3] = replace(versions[3], log_ratios=few)
    found = history_of(versions)
    (step,) = found.steps
    assert (step.version.name, step.seen_at.name) == ("v3", "v4")
    last = found.changes[-1]
    assert last is not None
    assert last.before.name == "v4", "which has the most dives in common"


def test_slow_changes_add_up_to_a_step() -> None:
    creeping = [0.04 * number for number in range(6)]
    versions = made_versions(1, creeping, jitter=0.01)
    (step, *_) = history_of(versions).steps
    assert step.change.before.name == "v0"
    assert step.change.low > BAND


def test_the_same_numbers_are_equivalent_on_however_few_dives() -> None:
    (first, *_) = made_versions(1, SIX, dives=3)
    same = replace(first, name="v1")
    (_, change) = history_of([first, same]).changes
    assert change is not None
    assert change.word == EvidenceVerdict.EQUIVALENT
    assert (change.low, change.high) == (1.0, 1.0)


def test_versions_without_three_common_dives_are_not_compared() -> None:
    first, second = made_versions(1, [0.0, 1.0], dives=5)
    others = {f"other {dive}": ratio for dive, ratio in second.log_ratios.items()}
    others |= dict(list(second.log_ratios.items())[:2])
    apart = Version("apart", others, dict.fromkeys(others, ""), dict.fromkeys(others, "2026"))
    found = history_of([first, apart])
    assert found.changes == [None, None]
    assert not found.steps
    diverged = dict.fromkeys(second.log_ratios, math.inf)
    assert history_of([first, replace(second, log_ratios=diverged)]).changes[1] is None


def test_while_dives_may_still_be_added_the_interval_is_for_every_look() -> None:
    first, second = made_versions(1, [0.0, 0.3], dives=8)
    logs = [second.log_ratios[dive] - first.log_ratios[dive] for dive in first.log_ratios]
    level = level_of_comparison(1)
    error = np.std(logs, ddof=1) / math.sqrt(8)
    added = {**first.started_at, "dive 7": "2026-12-31"}
    (_, later) = history_of([replace(first, started_at=added), second]).changes
    some = dict(list(second.log_ratios.items())[:7])
    (_, fewer) = history_of([first, replace(second, log_ratios=some)]).changes
    (_, whole) = history_of([first, second]).changes
    assert later is not None
    assert fewer is not None
    assert whole is not None
    assert later.is_for_every_look
    assert fewer.is_for_every_look
    assert not whole.is_for_every_look
    assert math.log(later.high / later.ratio) == pytest.approx(error * quantile_always(8, level))
    assert later.high > whole.high
    assert fewer.dives == 7


def test_vehicles_are_the_samples_of_a_change() -> None:
    first, second = made_versions(1, [0.0, 0.5], dives=9)
    vehicles = {dive: f"vehicle {number % 3}" for number, dive in enumerate(first.log_ratios)}
    versions = [replace(each, vehicles=vehicles) for each in (first, second)]
    (_, change) = history_of(versions).changes
    assert change is not None
    logs = [second.log_ratios[dive] - first.log_ratios[dive] for dive in first.log_ratios]
    level = level_of_comparison(1)
    expected = log_ratio_interval(logs, vehicles=[*vehicles.values()], level=level)
    assert (change.ratio, change.low, change.high) == expected[:3]
    assert expected.vehicles == 3
