"""How often `history LAKE` names the step at which a filter changed, and how often one where nothing changed.

`python benchmarks/history_worlds.py` writes the part of the page of results. A lake has the evidence of six versions of
a filter on the same dives. Its rows are those of one real replay, with ratios that are drawn: each dive has a ratio of
its own, which all versions share, and each version moves it a little. In some lakes one version is truly better or
worse than those before it, and stays so.
"""

import math
import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from judged import history_steps, lake_template, write_lake
from results import finish, judging_parser, machine, table, worker_processes

from insdvl_replay.core.dive_columns import Floats

SEED: Final = 61_000_000
LAKES: Final = 20
"""Of each world."""
VERSIONS: Final = 6
ALLOWED_ERRORS: Final = 3.0
MOST_FALSE_PCT: Final = 5.0
LEAST_FOUND_PCT: Final = 80.0


@dataclass(frozen=True)
class HistoryWorld:
    """Lakes that are drawn alike.

    Attributes
    ----------
    dives : int
        Of each version.
    dive_scatter : float
        Standard deviation of the log ratio from dive to dive, which all versions share.
    version_scatter : float
        The same of what each version of each dive has for itself.
    ratio : float
        Of the position error after the step over that before it; 1 where there is none.
    is_asked : bool
        Whether the step must be found in four of five lakes.
    """

    dives: int
    dive_scatter: float
    version_scatter: float
    ratio: float = 1.0
    is_asked: bool = False

    @property
    def name(self) -> str:
        """Say what is drawn."""
        step = "no step" if self.ratio == 1.0 else f"a step to {self.ratio:g}"
        scatters = f"s {self.dive_scatter:g} of dives, {self.version_scatter:g} of versions"
        return f"{step}, {self.dives} dives, {scatters}"


WORLDS: Final = (
    *(HistoryWorld(dives, 0.1, 0.0) for dives in (5, 8)),
    *(HistoryWorld(dives, 0.1, 0.05) for dives in (5, 8)),
    *(HistoryWorld(dives, 0.2, 0.1) for dives in (5, 8)),
    HistoryWorld(8, 0.5, 0.3),
    *(HistoryWorld(8, 0.1, 0.0, ratio, is_asked=True) for ratio in (0.8, 1.25)),
    *(HistoryWorld(8, 0.1, 0.05, ratio, is_asked=True) for ratio in (0.8, 1.25)),
    HistoryWorld(5, 0.1, 0.05, 0.5, is_asked=True),
    *(HistoryWorld(8, 0.2, 0.1, ratio) for ratio in (0.8, 1.25)),
)


def drawn_logs(world: HistoryWorld, step: int, rng: np.random.Generator) -> Floats:
    """Draw the log ratios of all versions and dives, shape (versions, dives); the step is at a version, from 0."""
    of_dives = world.dive_scatter * rng.standard_normal(world.dives)
    of_versions = world.version_scatter * rng.standard_normal((VERSIONS, world.dives))
    logs = of_dives + of_versions
    logs[step:] += math.log(world.ratio)
    return np.asarray(logs)


class JudgedLake(NamedTuple):
    """What the tool said of one lake."""

    world: int
    step: int
    """The version that truly changed, from 0; with a ratio of 1 none did."""
    said: tuple[int, ...]
    """Versions that the tool names."""

    @property
    def of_world(self) -> HistoryWorld:
        """How the lake was drawn."""
        return WORLDS[self.world]

    @property
    def is_found(self) -> bool:
        """Whether the true step is named."""
        return self.of_world.ratio != 1.0 and self.step in self.said

    @property
    def is_false(self) -> bool:
        """Whether a version is named that changed nothing."""
        if self.of_world.ratio == 1.0:
            return bool(self.said)
        return any(version != self.step for version in self.said)


class Task(NamedTuple):
    """One lake."""

    world: int
    number: int
    seed: int


def judged_lake(task: Task) -> JudgedLake:
    """Write a lake, and ask the tool for its history."""
    world = WORLDS[task.world]
    rng = np.random.default_rng((task.seed, zlib.crc32(world.name.encode()), task.number))
    step = int(rng.integers(1, VERSIONS))
    logs = drawn_logs(world, step, rng)
    with tempfile.TemporaryDirectory() as name:
        lake = Path(name) / "lake"
        write_lake(lake, lake_template(), logs)
        said = history_steps(lake)
    return JudgedLake(task.world, step, said)


# --- The page.


class Rate(NamedTuple):
    """A row of the table of rates."""

    asks: str
    counted: int
    lakes: int
    asked_pct: float
    is_least: bool = False

    @property
    def is_met(self) -> bool:
        """Whether the share is as asked, but for chance."""
        share = self.asked_pct / 100.0
        error = math.sqrt(share * (1.0 - share) * self.lakes)
        asked = share * self.lakes
        if self.is_least:
            return self.counted >= asked - ALLOWED_ERRORS * error
        return self.counted <= asked + ALLOWED_ERRORS * error

    @property
    def text(self) -> str:
        """The row as it is written."""
        side = "at least" if self.is_least else "at most"
        star = "" if self.is_met else " *"
        pct = 100.0 * self.counted / self.lakes
        return (
            f"| {self.asks} | {self.counted} of {self.lakes} | {pct:.1f}{star} | "
            f"{side} {self.asked_pct:g} |"
        )


def rates_of(lakes: Sequence[JudgedLake]) -> list[Rate]:
    """Count over all worlds of a kind."""
    still = [lake for lake in lakes if lake.of_world.ratio == 1.0]
    moved = [lake for lake in lakes if lake.of_world.ratio != 1.0]
    asked = [lake for lake in moved if lake.of_world.is_asked]
    found = list[Rate]()
    if still:
        false = sum(lake.is_false for lake in still)
        found.append(Rate("no step, any version is named", false, len(still), MOST_FALSE_PCT))
    if moved:
        false = sum(lake.is_false for lake in moved)
        found.append(Rate("a step, another version is named", false, len(moved), MOST_FALSE_PCT))
    if asked:
        right = sum(lake.is_found for lake in asked)
        asks = "a step of which s is a quarter at most, found"
        found.append(Rate(asks, right, len(asked), LEAST_FOUND_PCT, is_least=True))
    return found


def world_row(number: int, lakes: Sequence[JudgedLake]) -> str:
    """Write the row of one world."""
    of_world = [lake for lake in lakes if lake.world == number]
    found = sum(lake.is_found for lake in of_world)
    false = sum(lake.is_false for lake in of_world)
    right = "" if WORLDS[number].ratio == 1.0 else f"{found}"
    return f"| {WORLDS[number].name} | {len(of_world)} | {right} | {false} |"


ABOUT: Final = (
    f"A lake has {VERSIONS} versions of a filter on the same dives. Ratios of the position error are drawn: each dive "
    "has one of its own, which all versions share, and each version moves it by what scatters of versions. A step "
    "moves all dives from a drawn version on. A star marks what is not as asked."
)


def page(lakes: Sequence[JudgedLake], took_s: float) -> tuple[str, bool]:
    """Write the part of the page of results, and say whether all rates are as asked."""
    rates = rates_of(lakes)
    lines = [
        *("# Judgement: histories", "", ABOUT, ""),
        *table(("", "lakes", "%", "asked [%]"), [rate.text for rate in rates]),
        "",
        *table(
            ("world", "lakes", "step found", "another version named"),
            [world_row(number, lakes) for number in sorted({lake.world for lake in lakes})],
        ),
        *("", f"{machine()}; {took_s:.0f} s."),
    ]
    return "\n".join(lines), all(rate.is_met for rate in rates)


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as asked."""
    parser = judging_parser(__doc__)
    parser.add_argument("--lakes", type=int, default=LAKES, help="of each world")
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    begun_s = time.monotonic()
    tasks = list[Task]()
    for world in range(len(WORLDS)):
        tasks += [Task(world, number, given.seed) for number in range(given.lakes)]
    with worker_processes(given.jobs) as processes:
        lakes = list(processes.map(judged_lake, tasks))
    part, all_met = page(lakes, time.monotonic() - begun_s)
    finish(part, is_whole=not given.print, all_met=all_met)


if __name__ == "__main__":
    main()
