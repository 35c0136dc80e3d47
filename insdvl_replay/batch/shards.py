"""The dives that each of several machines replays, and the noise that all of them have together.

A shard sees the paths of all dives. It replays its own, and reads a few others where the noise of all is fitted.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.batch.fitted_noise import is_alike, with_fitted_noise
from insdvl_replay.batch.found import Fetch, FoundDive
from insdvl_replay.batch.jobs import ReplayJob
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.core.errors import ConfigError, NaturalKey, natural_key

Plan = Callable[[Sequence[FoundDive]], list[ReplayJob]]
"""Plans the replays of dives, a job for each."""

MOST_SHARDS: Final = 99_999
_SHARD: Final = re.compile(r"(\d{1,5})/(\d{1,5})")


@dataclass(frozen=True)
class Shard:
    """One of several equal shares of the dives."""

    number: int = 1  # from 1
    shards: int = 1  # how many there are

    def __str__(self) -> str:
        """Return it as an option has it."""
        return f"{self.number}/{self.shards}"

    @property
    def is_one(self) -> bool:
        """Whether there can be such a shard."""
        return 1 <= self.number <= self.shards <= MOST_SHARDS

    def places(self, dives: Sequence[FoundDive]) -> list[int]:
        """Return the places of its dives among all: of four shards the first has the dives 1, 5, 9 and so on.

        They are counted by their names. So neither the order in which they are given matters, nor the machine.
        """
        names = [_from_its_end(dive) for dive in dives]
        ordered = sorted(range(len(dives)), key=names.__getitem__)
        return sorted(ordered[self.number - 1 :: self.shards])


ALL_DIVES: Final = Shard()


def _from_its_end(dive: FoundDive) -> list[NaturalKey]:
    """Return the parts of a path from its end: folders count where names are the same, and the root last."""
    parts = dive.name_giver.absolute().parts
    return [natural_key(part) for part in reversed(parts)]


def parse_shard(text: str) -> Shard:
    """Read a shard such as ``2/4``; anything else is a ConfigError."""
    match = _SHARD.fullmatch(text)
    if match is not None:
        shard = Shard(int(match[1]), int(match[2]))
        if shard.is_one:
            return shard
    raise ConfigError(
        f"--shard {text}: is not a part such as 1/4", "--shard 1/4, --shard 2/4 and so on"
    )


@dataclass(frozen=True)
class Share:
    """The dives of a shard among those of all shards."""

    shard: Shard
    jobs: Sequence[ReplayJob]  # of all dives
    own: frozenset[int]  # places of the dives that the shard replays
    read: frozenset[int]  # places of the dives that it reads, which a noise is fitted to

    @property
    def own_jobs(self) -> list[ReplayJob]:
        """The replays of the shard."""
        return [self.jobs[place] for place in sorted(self.own)]


def plan_share(
    shard: Shard,
    dives: Sequence[FoundDive],
    own: frozenset[int],  # places of the dives of the shard
    fetch: Fetch,
    plan: Plan,
) -> Share:
    """Plan the replays of a shard, and fetch those of its dives that are remote."""
    found = list(dives)
    read = own
    missing = own
    while missing:
        places = sorted(missing)
        fetched = fetch([found[place] for place in places])
        for place, dive in zip(places, fetched, strict=True):
            found[place] = dive
        # One that cannot be had makes way for the next.
        missing = _deciding(plan(found), own) - read
        read |= missing
    return Share(shard, plan(found), own, read)


def _deciding(jobs: Sequence[ReplayJob], own: frozenset[int]) -> frozenset[int]:
    """Return the places of the dives by which the noise of a shard's dives is fitted."""
    from insdvl_replay.calibration.fitted_noise import MOST_DIVES  # heavy

    deciding = set[int]()
    known = list[ReplayJob]()
    for place in sorted(own):
        job = jobs[place]
        is_open = job.error is None and bool(job.options.config.noise.fit)
        if not is_open or any(is_alike(job, other) for other in known):
            continue
        known.append(job)
        alike = [number for number, other in enumerate(jobs) if is_alike(other, job)]
        deciding.update(alike[:MOST_DIVES])
    return frozenset(deciding)


def with_noise_of_all(share: Share, how: Replaying) -> list[ReplayJob]:
    """Return the replays of a shard with the noise that a run over all dives fits."""
    places = sorted(share.read)
    fitted = with_fitted_noise([share.jobs[place] for place in places], how)
    jobs = []
    for place, job in zip(places, fitted, strict=True):
        if place in share.own:
            jobs.append(job)
    return jobs
