"""How often the parts of dives that stand out are those in which one filter truly differs more than elsewhere.

`python benchmarks/where_worlds.py` writes the part of the page of results. Dives are surveys: straight legs, and turns
between them. In some worlds a filter is told a lever arm that is off, so that it is worse in turns alone. In others
two filters could be exchanged, or one has larger errors by the same factor in all parts of a dive, so that nothing may
stand out. Each dive is replayed once, and archives of six dives are drawn from them.
"""

import math
import pickle
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from judged import (
    WherePart,
    WhereRecord,
    classes_run_here,
    drawn_groups,
    where_over,
    where_record_of,
)
from numpy.typing import NDArray
from results import finish, judging_parser, machine, table, worker_processes
from scatter_filters import Case, PingNoise, Told, with_added, write_case
from scatter_worlds import (
    OTHER,
    SEA,
    SETTLED_S,
    Draw,
    Drawn,
    ScatterWorld,
    dive_of,
    exchanged,
    factors,
    histories_of,
    imus,
    mountings,
    reference_of,
    settings_of,
)
from scatter_worlds import Kind as PairKind
from sea_worlds import Sea

from insdvl_replay.core.config import Vector
from insdvl_replay.core.dive_columns import NS_PER_S, Dive, Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.reference_errors import reference_errors
from insdvl_replay.geometry.rotation import rpy_from_mat
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.trajectories import Scenario, Segment, Wave, turn

SEED: Final = 97_000_000
DIVES: Final = 24
"""Of each world."""
SIZE: Final = 6
"""Dives of an archive."""
GROUPS: Final = 40
"""Archives that are drawn from the dives of a world."""
DURATION_S: Final = 400.0
ALLOWED_ERRORS: Final = 3.0
BASELINE: Final = "baseline"
TURNS: Final = "turns"
LEG_S: Final = (35.0, 60.0)
TURN_DEG: Final = (60.0, 150.0)
TURN_RATES_DEGPS: Final = (5.0, 9.0)
TURNING_DEGPS: Final = 2.0
"""A vehicle turns while its heading changes faster, where the truth is measured."""


# --- Surveys.


@dataclass(frozen=True)
class Survey(Sea):
    """Dives along straight legs with turns between them, to both sides."""

    speed_change_mps: float = 0.05
    """Amplitude of the speed."""
    speed_period_s: float = 47.0
    climb_mps: float = 0.0
    """Amplitude of the vertical speed."""

    def drawn_motion(self, rng: np.random.Generator) -> Scenario:
        """Draw the legs and turns of one dive."""
        segments = list[Segment]()
        while sum(segment.duration_s for segment in segments) < self.duration_s:
            leg = Segment(float(rng.uniform(*LEG_S)))
            turn_deg = float(rng.choice((-1.0, 1.0)) * rng.uniform(*TURN_DEG))
            segments += [leg, turn(turn_deg, float(rng.uniform(*TURN_RATES_DEGPS)))]
        speed_mps = self.voyage.speed_mps + self.voyage.speed_sd_mps * rng.standard_normal()
        return Scenario(
            "legs and turns",
            self.duration_s,
            Wave(float(speed_mps), self.speed_change_mps, self.speed_period_s),
            tuple(segments),
            roll_deg=Wave(0.0, 1.0, float(rng.uniform(11.0, 23.0))),
            pitch_deg=Wave(0.0, 1.0, float(rng.uniform(17.0, 37.0))),
            heave_mps=Wave(0.0, self.climb_mps, 130.0),
        )


SURVEY: Final = Survey(
    SEA.voyage,
    SEA.grade,
    DURATION_S,
    dvl=SEA.dvl,
    reference=SEA.reference,
    imu_rate_hz=SEA.imu_rate_hz,
)
VARIED: Final = replace(
    SURVEY,
    dvl=replace(SEA.dvl, lost_spans=10, lost_s=(8.0, 25.0)),
    speed_change_mps=0.6,
    speed_period_s=147.0,
    climb_mps=0.2,
)
"""Dives that also climb, become faster and slower, and lose the bottom now and then."""


# --- What is drawn.


def lever_arms(name: str, lever_arm_m: Vector) -> Draw:
    """Tell a filter a lever arm that is off, the same in all dives."""

    def draw(reported: Dive, exact: Dive, _: np.random.Generator) -> Drawn:
        return Drawn(reported, exact, {name: Told(lever_arm_m=lever_arm_m)})

    return draw


def two_dvls(name: str, *, baseline_mps: float, own_mps: float) -> Draw:
    """Give both filters a DVL of their own, whose white noise comes beside what both have."""

    def draw(reported: Dive, exact: Dive, rng: np.random.Generator) -> Drawn:
        of_baseline, of_own = rng.integers(2**32, size=2).tolist()
        noise = PingNoise(own_mps, of_own, baseline_mps, of_baseline)
        pings = len(reported.dvl.time_ns)
        dvl = with_added(reported.dvl, noise.of_baseline_mps(pings))
        return Drawn(replace(reported, dvl=dvl), exact, {name: Told(ping_noise=noise)})

    return draw


# --- The worlds.

Kind = Literal["turns", "nothing", "shown"]
"""Turns must stand out; nothing may; or nothing is asked."""


class WhereWorld(NamedTuple):
    """A world, and what must stand out in it."""

    kind: Kind
    world: ScatterWorld


def _world(
    kind: Kind,
    name: str,
    draw: Draw,
    sd_mps: float = 0.008,
    *,
    sea: Sea = SURVEY,
    can_be_exchanged: bool = False,
) -> WhereWorld:
    of_pair: PairKind = "equal" if can_be_exchanged else "ensemble"
    config = settings_of(OTHER, sd_mps=sd_mps)
    return WhereWorld(kind, ScatterWorld(name, of_pair, config, draw, sea=sea))


def _equal(name: str, draw: Draw, sd_mps: float = 0.008, sea: Sea = SURVEY) -> WhereWorld:
    return _world("nothing", name, draw, sd_mps, sea=sea, can_be_exchanged=True)


WORLDS: Final = (
    _world("turns", "lever arm off by 0.2 m forward", lever_arms(OTHER, (0.2, 0.0, 0.0))),
    _world("turns", "lever arm off by 0.3 m to starboard", lever_arms(OTHER, (0.0, 0.3, 0.0))),
    _world("turns", "lever arm off by 0.4 m aft", lever_arms(OTHER, (-0.4, 0.0, 0.0))),
    _equal(
        "two DVLs of the same noise",
        two_dvls(OTHER, baseline_mps=0.01, own_mps=0.01),
        sd_mps=0.012,
    ),
    _equal("two IMUs", imus(OTHER, accel_mg=0.7, gyro_degph=2.0)),
    _equal("two mountings", mountings(OTHER, sd_deg=0.07)),
    _equal("dives that differ, s 0.3", factors(OTHER, ratio=1.0, log_sd=0.3)),
    _world("nothing", "all errors times 5", factors(OTHER, ratio=5.0, log_sd=0.0)),
    _world("nothing", "all errors times 1.5, s 0.3", factors(OTHER, ratio=1.5, log_sd=0.3)),
    _world(
        "shown",
        "noise of the DVL times 5",
        two_dvls(OTHER, baseline_mps=0.01, own_mps=0.05),
        sd_mps=0.012,
    ),
    _equal("varied dives, two IMUs", imus(OTHER, accel_mg=0.7, gyro_degph=2.0), sea=VARIED),
    _equal("varied dives, two mountings", mountings(OTHER, sd_deg=0.07), sea=VARIED),
    _equal("varied dives, s 0.3", factors(OTHER, ratio=1.0, log_sd=0.3), sea=VARIED),
)


# --- One dive.


class TrueParts(NamedTuple):
    """Root mean squares of the true horizontal velocity error of one filter in one dive, m/s."""

    in_turns: float
    in_legs: float


class JudgedDive(NamedTuple):
    """What the tool keeps of one dive, and the true errors by filter."""

    world: int
    number: int
    """Of what was drawn: where two filters are exchanged, two dives have the same number."""
    record: WhereRecord
    errors: dict[str, TrueParts]


class Task(NamedTuple):
    """One dive of a world."""

    world: int
    number: int
    seed: int
    is_exchanged: bool


def judged_dive(task: Task) -> JudgedDive:
    """Make a dive, replay it from its log, and measure what is true of it."""
    world = WORLDS[task.world].world
    drawn = dive_of(world, task.number, task.seed)
    if task.is_exchanged:
        drawn = exchanged(drawn, OTHER)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / f"dive_{task.number}.mcap"
        write_dive(log, drawn.reported)
        write_case(folder, Case(world.config, dict(drawn.told)), reference_of(drawn.exact))
        with classes_run_here():
            replay = replay_dive(read_checked_dive(log, world.config), world.config)
    errors = true_parts_of(world, drawn)
    return JudgedDive(task.world, task.number, where_record_of(replay, OTHER), errors)


def true_parts_of(world: ScatterWorld, drawn: Drawn) -> dict[str, TrueParts]:
    """Measure the errors of each filter in turns and in legs."""
    reference = reference_of(drawn.exact)
    turning = is_turning(drawn.exact)
    found = dict[str, TrueParts]()
    for name, history in histories_of(world, drawn).items():
        errors = reference_errors(history, reference)
        rows = np.searchsorted(reference.time_ns, errors.time_ns)
        in_turns = turning[rows]
        since_s = (errors.time_ns - reference.time_ns[0]) / NS_PER_S
        settled = since_s >= SETTLED_S
        velocity = errors.velocity_error_n[:, :2]
        found[name] = TrueParts(
            _rms(velocity[settled & in_turns]), _rms(velocity[settled & ~in_turns])
        )
    return found


def is_turning(exact: Dive) -> NDArray[np.bool_]:
    """Say of each row of the exact motion whether the vehicle turns, shape (k,)."""
    reference = reference_of(exact)
    heading = np.unwrap(rpy_from_mat(reference.mat_nb)[:, 2])
    time_s = (reference.time_ns - reference.time_ns[0]) / NS_PER_S
    rate_degps = np.gradient(heading, time_s) / DEG
    return np.asarray(np.abs(rate_degps) > TURNING_DEGPS)


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


# --- Archives.


class JudgedWorld(NamedTuple):
    """All that was said of the archives of one world."""

    of_kind: WhereWorld
    dives: Sequence[JudgedDive]
    archives: Sequence[Sequence[WherePart]]

    @property
    def independent(self) -> float:
        """Archives that have no dive in common."""
        return len(self.dives) / SIZE

    @property
    def spoken(self) -> int:
        """Archives in which any part stands out."""
        return sum(any(part.stands_out for part in archive) for archive in self.archives)

    @property
    def turns_found(self) -> int:
        """Archives in which turns stand out, and are said to be worse."""
        found = 0
        for archive in self.archives:
            turns = [part for part in archive if part.name == TURNS and part.stands_out]
            found += any(part.ratio > 1.0 for part in turns)
        return found

    @property
    def others_worse(self) -> int:
        """Archives in which another part is said to be worse."""
        found = 0
        for archive in self.archives:
            others = [part for part in archive if part.name != TURNS and part.stands_out]
            found += any(part.ratio > 1.0 for part in others)
        return found

    @property
    def true_ratios(self) -> str:
        """Geometric means of the true ratios of the velocity error, in turns and in legs."""
        logs = [
            np.log(np.divide(dive.errors[OTHER], dive.errors[BASELINE])) for dive in self.dives
        ]
        in_turns, in_legs = np.exp(np.mean(logs, axis=0)).tolist()
        return f"{in_turns:.2f} / {in_legs:.2f}"

    @property
    def reported(self) -> str:
        """Geometric means of the ratios that are reported, by part."""
        logs = dict[str, list[float]]()
        for archive in self.archives:
            for part in archive:
                if math.isfinite(part.ratio):
                    logs.setdefault(part.name, []).append(math.log(part.ratio))
        means = {name: math.exp(sum(found) / len(found)) for name, found in logs.items()}
        return ", ".join(f"{name} {mean:.2f}" for name, mean in means.items())


def judged_world(number: int, dives: Sequence[JudgedDive], groups: int, seed: int) -> JudgedWorld:
    """Draw archives of the dives of one world, none of which has a dive and its exchange."""
    drawn = drawn_groups([dive.number for dive in dives], SIZE, groups, seed)
    archives = list[Sequence[WherePart]]()
    for rows in drawn:
        archives.append(where_over([dives[row].record for row in rows]))
    return JudgedWorld(WORLDS[number], dives, archives)


# --- The page.

LEAST_FOUND_PCT: Final = 95.0
MOST_FALSE_PCT: Final = 5.0


class Rate(NamedTuple):
    """A row of the table of rates."""

    asks: str
    counted: int
    archives: int
    independent: float
    asked_pct: float
    is_least: bool = False

    @property
    def pct(self) -> float:
        """Share of the archives."""
        return 100.0 * self.counted / self.archives

    @property
    def is_met(self) -> bool:
        """Whether the share is as asked, but for the chance of so many independent archives."""
        share = self.asked_pct / 100.0
        error_pct = 100.0 * math.sqrt(share * (1.0 - share) / self.independent)
        if self.is_least:
            return self.pct >= self.asked_pct - ALLOWED_ERRORS * error_pct
        return self.pct <= self.asked_pct + ALLOWED_ERRORS * error_pct

    @property
    def text(self) -> str:
        """The row as it is written."""
        side = "at least" if self.is_least else "at most"
        star = "" if self.is_met else " *"
        return (
            f"| {self.asks} | {self.counted} of {self.archives} | {self.independent:.0f} | "
            f"{self.pct:.1f}{star} | {side} {self.asked_pct:g} |"
        )


def rates_of(worlds: Sequence[JudgedWorld]) -> list[Rate]:
    """Count over all worlds of a kind."""
    turns = [world for world in worlds if world.of_kind.kind == "turns"]
    nothing = [world for world in worlds if world.of_kind.kind == "nothing"]
    rates = list[Rate]()
    if turns:
        archives = sum(len(world.archives) for world in turns)
        independent = sum(world.independent for world in turns)
        found = sum(world.turns_found for world in turns)
        asks = "lever arm off, turns stand out as worse"
        rates.append(Rate(asks, found, archives, independent, LEAST_FOUND_PCT, is_least=True))
        others = sum(world.others_worse for world in turns)
        asks = "lever arm off, another part stands out as worse"
        rates.append(Rate(asks, others, archives, independent, MOST_FALSE_PCT))
    if nothing:
        archives = sum(len(world.archives) for world in nothing)
        independent = sum(world.independent for world in nothing)
        spoken = sum(world.spoken for world in nothing)
        asks = "no part differs from the others, any stands out"
        rates.append(Rate(asks, spoken, archives, independent, MOST_FALSE_PCT))
    return rates


def world_row(world: JudgedWorld) -> str:
    """Write the row of one world."""
    asked = {"turns": "turns", "nothing": "nothing", "shown": "not asked"}[world.of_kind.kind]
    said = Counter[str]()
    for archive in world.archives:
        said.update(part.name for part in archive if part.stands_out)
    words = ", ".join(f"{count} {name}" for name, count in said.most_common()) or "nothing"
    return (
        f"| {world.of_kind.world.name} | {asked} | {world.true_ratios} | {len(world.archives)} | "
        f"{words} | {world.reported} |"
    )


ABOUT: Final = (
    f"Surveys of {DURATION_S:g} s with tactical sensors: straight legs of {LEG_S[0]:g} to {LEG_S[1]:g} s and turns by "
    f"{TURN_DEG[0]:g} to {TURN_DEG[1]:g} deg. A filter is told a lever arm that is off; or two filters have sensors of "
    "their own, of the same kind, and could be exchanged; or all errors of one are larger by a factor, which may "
    "differ from dive to dive. Every other dive of exchangeable filters is the one before with both exchanged. A star "
    "marks what is not as asked."
)
OF_WORLDS: Final = (
    "What must stand out, the true ratio of the velocity error in turns and in legs, archives, parts that stand out "
    "in them, and the ratios that are reported, as geometric means over the archives."
)


def page(
    worlds: Sequence[JudgedWorld], dives: int, groups: int, took_s: float
) -> tuple[str, bool]:
    """Write the part of the page of results, and say whether all rates are as asked."""
    rates = rates_of(worlds)
    about = f"{dives} dives a world, of which {groups} archives of {SIZE} are drawn. {ABOUT}"
    lines = [
        *("# Judgement: where", "", about, ""),
        *table(("", "archives", "independent", "%", "asked [%]"), [rate.text for rate in rates]),
        *("", OF_WORLDS, ""),
        *table(
            ("world", "must stand out", "true ratios", "archives", "stand out", "reported"),
            [world_row(world) for world in worlds],
        ),
        *("", f"{machine()}; {took_s:.0f} s."),
    ]
    return "\n".join(lines), all(rate.is_met for rate in rates)


def tasks_of(worlds: Sequence[int], dives: int, seed: int) -> list[Task]:
    """Name all dives; of filters that could be exchanged every other one is the one before, exchanged."""
    found = list[Task]()
    for world in worlds:
        for row in range(dives):
            if WORLDS[world].world.can_be_exchanged:
                found.append(Task(world, row // 2, seed, is_exchanged=row % 2 == 1))
            else:
                found.append(Task(world, row, seed, is_exchanged=False))
    return found


def main() -> None:
    """Judge, print and write the page; exit with 1 if a rate is not as asked."""
    parser = judging_parser(__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="in each world")
    parser.add_argument("--groups", type=int, default=GROUPS)
    parser.add_argument(
        "--worlds", nargs="+", default=[""], help="those whose names hold one of these texts"
    )
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--keep", type=Path, help="store what was found in each dive")
    parser.add_argument("--kept", type=Path, help="judge what was stored, without replays")
    given = parser.parse_args()
    begun_s = time.monotonic()
    chosen = [
        number
        for number, of_kind in enumerate(WORLDS)
        if any(part in of_kind.world.name for part in given.worlds)
    ]
    if given.kept:
        dives = pickle.loads(given.kept.read_bytes())
    else:
        tasks = tasks_of(chosen, given.dives, given.seed)
        with worker_processes(given.jobs) as processes:
            dives = list(processes.map(judged_dive, tasks))
    if given.keep:
        given.keep.write_bytes(pickle.dumps(dives))
    worlds = list[JudgedWorld]()
    for number in chosen:
        of_world = [dive for dive in dives if dive.world == number]
        worlds.append(judged_world(number, of_world, given.groups, given.seed))
    part, all_met = page(worlds, given.dives, given.groups, time.monotonic() - begun_s)
    finish(part, is_whole=given.worlds == [""] and not given.print, all_met=all_met)


if __name__ == "__main__":
    main()
