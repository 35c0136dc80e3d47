"""Steps of a ratio over the versions of a candidate: where it changed.

Each version is compared with the first one since the last step, by the dives that both have. A step is named if the
interval of this change leaves the band, by the rule of every verdict.

The versions share the error of one: the k-th comparison has 6 / (pi k)^2 of it. These shares sum to one over however
many versions there will be, so that in at most one of twenty histories without any change a step is ever named. Half of
a share is for looks while dives are still added: the interval for every look (`interval.quantile_always`). The other
half is for the one look at all dives: Student's interval, once the later version has all dives of the earlier one, and
none of these came after the later version began.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.quantities import FEWEST_DIVES
from insdvl_replay.core.words import EvidenceVerdict
from insdvl_replay.evaluation.interval import (
    LEVEL,
    Interval,
    log_ratio_interval,
    word_of_interval,
)

_SUM_OF_SHARES: Final = math.pi**2 / 6.0
_STEPS: Final = (EvidenceVerdict.BETTER, EvidenceVerdict.WORSE)


@dataclass(frozen=True)
class Version:
    """What a version of a candidate did on its dives."""

    name: str
    log_ratios: Mapping[str, float]  # candidate over baseline, by dive
    vehicles: Mapping[str, str]  # by dive; empty: nobody said
    started_at: Mapping[str, str]  # of the replay, by dive; texts in the order of time

    @property
    def interval(self) -> Interval:
        """The interval of its ratio."""
        return self.interval_on([*self.log_ratios])

    def interval_on(self, dives: Sequence[str]) -> Interval:
        """Return the interval of its ratio on some dives."""
        logs = [self.log_ratios[dive] for dive in dives]
        return log_ratio_interval(logs, vehicles=[self.vehicles[dive] for dive in dives])


@dataclass(frozen=True)
class Change:
    """A version against an earlier one, on the dives that both have."""

    before: Version
    ratio_before: float
    ratio_after: float
    ratio: float  # of after over before
    low: float  # its interval
    high: float
    dives: int
    is_for_every_look: bool  # dives may still be added to it
    word: EvidenceVerdict

    @property
    def is_step(self) -> bool:
        """Whether it leaves the band."""
        return self.word in _STEPS


@dataclass(frozen=True)
class Step:
    """Where a ratio changed."""

    version: Version  # from which on it is another one
    change: Change  # that shows it
    seen_at: Version  # the later side of the change; a later version where the first one alone could not tell


@dataclass(frozen=True)
class History:
    """All versions of a candidate."""

    versions: Sequence[Version]  # in the order of time
    changes: Sequence[Change | None]  # of each; None where there is no earlier one to compare with
    steps: Sequence[Step]


def history_of(versions: Sequence[Version], level: float = LEVEL) -> History:
    """Compare the versions of a candidate, and find its steps.

    Parameters
    ----------
    versions : sequence of Version
        All versions, in the order of time.
    level : float
        Confidence for all comparisons together.
    """
    changes = list[Change | None]()
    steps = list[Step]()
    since_step = list[Version]()
    compared = 0
    for version in versions:
        change = None
        before = _most_in_common(since_step, version)
        since_step.append(version)
        if before is not None:
            compared += 1
            change = _change(before, version, level_of_comparison(compared, level))
            if change.is_step:
                first = _first_of_new(since_step, since_step.index(before))
                steps.append(Step(since_step[first], change, version))
                del since_step[:first]
        changes.append(change)
    return History(versions, changes, steps)


def _first_of_new(versions: Sequence[Version], earliest: int) -> int:
    """Return where a step is most likely: where the versions before it and from it on differ most.

    ``earliest`` is the version that the last one differs from, so that the step comes after it.
    """
    last = versions[-1]
    means = []
    for version in versions[earliest:]:
        logs = [version.log_ratios[dive] for dive in _common(version, last)]
        means.append(sum(logs) / len(logs) if logs else math.nan)
    best = len(means) - 1
    most = 0.0
    for first in range(1, len(means)):
        contrast = _contrast(means[:first], means[first:])
        if contrast > most:
            best = first
            most = contrast
    return earliest + best


def _contrast(before: Sequence[float], after: Sequence[float]) -> float:
    """Return how far two groups of means differ, as a sum of squares; versions without common dives are left out."""
    old = [mean for mean in before if math.isfinite(mean)]
    new = [mean for mean in after if math.isfinite(mean)]
    if not old or not new:
        return 0.0
    difference = sum(new) / len(new) - sum(old) / len(old)
    return difference**2 * len(old) * len(new) / (len(old) + len(new))


def level_of_comparison(number: int, level: float = LEVEL) -> float:
    """Return the confidence of a comparison by its number, from 1 on, so that all together err as seldom as one.

    Each has two intervals with this confidence: that for every look, and that for the look at all dives.
    """
    return 1.0 - 0.5 * (1.0 - level) / (_SUM_OF_SHARES * number**2)


def _most_in_common(versions: Sequence[Version], later: Version) -> Version | None:
    """Return the version with the most dives in common, the first of several; None if none has enough of them."""
    best = None
    most = FEWEST_DIVES - 1
    for version in versions:
        common = len(_common(version, later))
        if common > most:
            best = version
            most = common
    return best


def _common(before: Version, after: Version) -> list[str]:
    """Return the dives on which both have a ratio."""
    found = []
    for dive, ratio in before.log_ratios.items():
        if math.isfinite(ratio) and math.isfinite(after.log_ratios.get(dive, math.nan)):
            found.append(dive)
    return found


def _change(before: Version, after: Version, level: float) -> Change:
    dives = _common(before, after)
    logs = [after.log_ratios[dive] - before.log_ratios[dive] for dive in dives]
    vehicles = [after.vehicles[dive] for dive in dives]
    interval = log_ratio_interval(logs, vehicles=vehicles, level=level, level_always=level)
    is_whole = _has_all_dives(before, after)
    low = interval.low if is_whole else interval.low_always
    high = interval.high if is_whole else interval.high_always
    if not any(logs):  # The same numbers: nothing that a dive shows has changed.
        low = 1.0
        high = 1.0
    return Change(
        before,
        before.interval_on(dives).ratio,
        after.interval_on(dives).ratio,
        interval.ratio,
        low,
        high,
        interval.dives,
        not is_whole,
        word_of_interval(low, high),
    )


def _has_all_dives(before: Version, after: Version) -> bool:
    """Return whether the later version has all dives of the earlier one, which got none since the later one began."""
    if not before.log_ratios.keys() <= after.log_ratios.keys():
        return False
    return max(before.started_at.values()) <= min(after.started_at.values())
