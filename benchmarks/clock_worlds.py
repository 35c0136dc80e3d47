"""How well an IMU's table and a DVL's file by an unrelated clock are brought together, where the truth is known.

Usage: PYTHONPATH=tests python benchmarks/clock_worlds.py [--worlds 20] [--only NUMBER]. Each world is a simulated
dive, written as `imu.csv` and `dvl.pd0` and read as a user reads them, without settings for the DVL. The clock of the
DVL is off by up to 500 s and 50 ppm; in one world of three, the IMU counts from its start. The PD0 file has hundredths
of a second, begins later and ends earlier than the table, and has its own compass or none. Dives that are straight or
at rest tell nothing: they must be refused, or taken as stamped with a warning where their stamps overlap.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
import pandas as pd
from instrument_logs import Told
from results import finish, machine, table
from teledyne_logs import pd0

from insdvl_replay.core.config import Config, Imu
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, TimeNs, seconds
from insdvl_replay.core.errors import UserError
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import beam_vectors, solve_beams
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.logs import file_clocks, read_dive
from insdvl_replay.logs.columns.clock_by_motion import clock_by_motion
from insdvl_replay.sim.dive import START_NS, simulate_dive
from insdvl_replay.sim.trajectories import SCENARIOS, Scenario, Segment, Wave, turn

HEADING: Final = "# Clocks of two files"
TRAJECTORIES: Final = ("lawnmower", "figure-eight", "calibration", "free turns")
UNCONFIRMED: Final = "file_clock_unconfirmed"
SILENT: Final = ("straight", "static")
GRADES: Final = ("tactical", "mems", "fog")
ROUNDS: Final = 8  # worlds of each trajectory and grade
SILENT_ROUNDS: Final = 4
DURATIONS_S: Final = (600.0, 900.0, 1500.0, 2400.0)
DVL_HZ: Final = (1.0, 2.0, 4.0, 8.0)
IMU_HZ: Final = (50.0, 100.0)
LARGEST_OFFSET_S: Final = 500.0
LARGEST_DRIFT: Final = 50e-6
MOST_SDS: Final = 3.0
CLOSE_S: Final = 0.010
TILT_DEG: Final = 30.0
AZIMUTHS_DEG: Final = (270.0, 90.0, 0.0, 180.0)  # of the beams of PD0
CENTISECOND_NS: Final = 10_000_000
SETTINGS: Final = Config(
    imu=Imu(
        topic="imu.csv",
        specific_force="acc_x, acc_y, acc_z",
        angular_rate="gyro_x, gyro_y, gyro_z",
    )
)

RIGHT = "right"
WRONG = "wrong"
REFUSED = "refused"
LEFT = "left as stamped"


@dataclass(frozen=True)
class World:
    """A dive, its instruments and their clocks."""

    number: int
    trajectory: str
    grade: str
    duration_s: float
    imu_hz: float
    dvl_hz: float
    has_compass: bool  # the DVL gives its own attitude
    has_dropouts: bool
    counts_from_start: bool  # the IMU, not the DVL
    offset_s: float  # of the DVL's clock, at the start of the dive
    drift: float

    @property
    def is_silent(self) -> bool:
        """Whether the motion tells nothing."""
        return self.trajectory in SILENT

    @property
    def text(self) -> str:
        """Say what matters of it."""
        words = [f"{self.trajectory}, {self.grade}, {self.duration_s:.0f} s"]
        words.append(f"{self.imu_hz:.0f} / {self.dvl_hz:.0f} Hz")
        if self.has_compass:
            words.append("compass")
        if self.has_dropouts:
            words.append("dropouts")
        if self.counts_from_start:
            words.append("IMU since its start")
        words.append(f"{self.offset_s:+.1f} s, {self.drift * 1e6:+.0f} ppm")
        return ", ".join(words)

    def by_dvl(self, time_ns: TimeNs) -> TimeNs:
        """Return times by the clock of the DVL."""
        ahead_s = self.offset_s + self.drift * seconds(time_ns, START_NS)
        return time_ns + np.rint(ahead_s * 1e9).astype(np.int64)

    def by_imu(self, time_ns: TimeNs) -> TimeNs:
        """Return times by the clock of the IMU."""
        if self.counts_from_start:
            return time_ns - START_NS
        return time_ns


def worlds() -> list[World]:
    """Draw all worlds; each number is a seed."""
    found: list[World] = []
    known = list(product(TRAJECTORIES, GRADES, range(ROUNDS)))
    known += product(SILENT, GRADES, range(SILENT_ROUNDS))
    for number, (trajectory, grade, round_number) in enumerate(known, 1):
        rng = np.random.default_rng((52, number))
        world = World(
            number=number,
            trajectory=trajectory,
            grade=grade,
            duration_s=float(rng.choice(DURATIONS_S)),
            imu_hz=float(rng.choice(IMU_HZ)),
            dvl_hz=float(rng.choice(DVL_HZ)),
            has_compass=round_number % 2 == 1,
            has_dropouts=round_number % 4 >= 2,
            counts_from_start=bool(rng.random() < 1.0 / 3.0),
            offset_s=float(rng.uniform(-LARGEST_OFFSET_S, LARGEST_OFFSET_S)),
            drift=float(rng.uniform(-LARGEST_DRIFT, LARGEST_DRIFT)),
        )
        found.append(world)
    return found


# --- The dive.


def scenario_of(world: World, rng: np.random.Generator) -> Scenario:
    """Return a course that goes on for the whole dive."""
    if world.trajectory == "free turns":
        return _free_turns(world.duration_s, rng)
    once = SCENARIOS[world.trajectory]
    length_s = sum(segment.duration_s for segment in once.segments)
    segments: tuple[Segment, ...] = ()
    if length_s:
        segments = once.segments * int(np.ceil(world.duration_s / length_s))
    return replace(once, about=world.trajectory, duration_s=world.duration_s, segments=segments)


def _free_turns(duration_s: float, rng: np.random.Generator) -> Scenario:
    """Draw legs and turns of any length, as a vehicle has that is steered by hand."""
    segments: list[Segment] = []
    length_s = 0.0
    while length_s < duration_s:
        leg = Segment(float(rng.uniform(5.0, 90.0)))
        angle_deg = float(rng.uniform(20.0, 200.0)) * float(rng.choice([-1.0, 1.0]))
        turning = turn(angle_deg, float(rng.uniform(4.0, 15.0)))
        segments += [leg, turning]
        length_s += leg.duration_s + turning.duration_s
    return Scenario(
        "free turns",
        duration_s,
        Wave(0.8, 0.1, float(rng.uniform(20.0, 60.0))),
        tuple(segments),
        roll_deg=Wave(0.0, 1.5, float(rng.uniform(4.0, 15.0))),
        pitch_deg=Wave(0.0, 1.5, float(rng.uniform(4.0, 20.0))),
        sway_mps=Wave(0.0, 0.03, float(rng.uniform(5.0, 40.0))),
    )


def _dropouts(world: World, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Draw spans without the bottom, some percent of the dive."""
    spans: list[tuple[float, float]] = []
    if not world.has_dropouts:
        return spans
    for start_s in np.sort(rng.uniform(0.0, world.duration_s - 70.0, 6)):
        spans.append((float(start_s), float(start_s + rng.uniform(2.0, 30.0))))
    return spans


def simulated(world: World, rng: np.random.Generator) -> Dive:
    """Return the dive, with a row of the reference at each ping."""
    arm_m = (
        float(rng.uniform(-0.6, 0.6)),
        float(rng.uniform(-0.2, 0.2)),
        float(rng.uniform(-0.2, 0.4)),
    )
    mounting_deg = (
        float(rng.normal(0.0, 2.0)),
        float(rng.normal(0.0, 2.0)),
        float(rng.uniform(-180.0, 180.0)),
    )
    return simulate_dive(
        scenario_of(world, rng),  # type: ignore[arg-type]  # as `exact_dive` takes it
        seed=world.number,
        grade=world.grade,
        imu_rate_hz=world.imu_hz,
        dvl_rate_hz=world.dvl_hz,
        outages=_dropouts(world, rng),
        lever_arm_m=arm_m,
        mounting_rpy_deg=mounting_deg,
        reference_at_pings=True,
    )


# --- Its files.


def write_imu(folder: Path, world: World, dive: Dive) -> Path:
    """Write the samples as a table."""
    imu = dive.imu
    columns = {"time [s]": world.by_imu(imu.time_ns) / 1e9}
    for axis, force, rate in zip("xyz", imu.specific_force_b.T, imu.angular_rate_b.T, strict=True):
        columns[f"acc_{axis} [m/s^2]"] = force
        columns[f"gyro_{axis} [rad/s]"] = rate
    path = folder / "imu.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def write_dvl(
    folder: Path,
    world: World,
    dive: Dive,
    rows: slice,
    rng: np.random.Generator,
) -> Path:
    """Write some of the pings as PD0, in the coordinates of its beams."""
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    assert dive.reference is not None
    velocity_d = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0][rows]
    beams_mps = velocity_d @ beam_vectors(TILT_DEG, AZIMUTHS_DEG).T
    time_ns = world.by_dvl(dive.dvl.time_ns[rows])
    written_ns = (time_ns + CENTISECOND_NS // 2) // CENTISECOND_NS * CENTISECOND_NS
    at_pings = dive.reference.rows(slice(1, None)).rows(rows)
    attitude = _compass(at_pings.mat_nb, rng)
    if not world.has_compass:
        attitude = np.broadcast_to(np.eye(3), attitude.shape)
    reference = replace(at_pings, time_ns=written_ns, mat_nb=attitude)
    dvl = DvlColumns(written_ns, velocity_d=velocity_d)
    by_dvl = replace(dive, dvl=dvl, reference=reference)
    path = folder / "dvl.pd0"
    path.write_bytes(b"".join(pd0(Told(by_dvl, written_ns, velocity_d, beams_mps))))
    return path


def _compass(mat_nb: Floats, rng: np.random.Generator) -> Floats:
    """Return attitudes as a compass has them: with noise, and a deviation that depends on the heading."""
    rpy = rpy_from_mat(mat_nb)
    rpy += np.radians(rng.normal(0.0, [0.1, 0.1, 0.2], rpy.shape))
    rpy[:, 2] += np.radians(1.5) * np.sin(rpy[:, 2] + rng.uniform(0.0, 2.0 * np.pi))
    return np.asarray(mat_from_rpy(rpy))


# --- What is made of them.


@dataclass(frozen=True)
class Outcome:
    """What was said of the clocks of a world, and how far that is off."""

    world: World
    word: str
    how: str = ""
    off_s: tuple[float, float, float] = (np.nan, np.nan, np.nan)  # at start, middle and end
    sds_s: tuple[float, float, float] = (np.nan, np.nan, np.nan)  # as stated
    took_s: float = 0.0

    @property
    def largest_off_s(self) -> float:
        """How far it is off where that is worst."""
        return float(np.max(np.abs(self.off_s)))

    @property
    def is_close(self) -> bool:
        """Whether it is right to 10 ms everywhere."""
        return self.largest_off_s <= CLOSE_S

    @property
    def is_silent_guess(self) -> bool:
        """Whether the stamps were taken as they are without a warning, although another clock may have made them."""
        return self.word == LEFT and UNCONFIRMED not in self.how

    @property
    def standardised(self) -> Floats:
        """Errors in stated standard errors, (3,)."""
        return np.asarray(np.array(self.off_s) / np.array(self.sds_s))


def outcome(world: World) -> Outcome:
    """Write the files of a world, and read them."""
    rng = np.random.default_rng((53, world.number))
    dive = simulated(world, rng)
    pings = len(dive.dvl.time_ns)
    rows = slice(
        int(pings * rng.uniform(0.0, 0.1)),
        int(pings * rng.uniform(0.9, 1.0)),
    )
    found: list[Any] = []

    def heard(*arguments: Any, **options: Any) -> Any:
        found.append(clock_by_motion(*arguments, **options))
        return found[-1]

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [
            write_imu(folder, world, dive),
            write_dvl(folder, world, dive, rows, rng),
        ]
        begun_s = time.process_time()
        try:
            with patch.object(file_clocks, "clock_by_motion", heard):
                read = read_dive(paths, SETTINGS)
        except UserError as error:
            took_s = time.process_time() - begun_s
            return Outcome(world, REFUSED, str(error), took_s=took_s)
    took_s = time.process_time() - begun_s
    true_ns = dive.dvl.time_ns[rows]
    three_ns = true_ns[[0, len(true_ns) // 2, -1]]
    stamps_ns = world.by_dvl(three_ns)
    if "file_clock" not in {note.code for note in read.notes}:
        off_s = seconds(stamps_ns - world.by_imu(three_ns), 0)
        warnings = {note.code for note in read.notes if note.severity == Severity.WARNING}
        how = ", ".join(sorted(warnings)) or "nothing is said"
        return Outcome(world, LEFT, how, off_s=_three(off_s), took_s=took_s)
    (clock,) = found
    off_s = seconds(clock.by_imu(stamps_ns) - world.by_imu(three_ns), 0)
    said = Outcome(
        world,
        RIGHT,
        " and ".join(clock.sources),
        off_s=_three(off_s),
        sds_s=(clock.largest_sd_s, clock.ahead_sd_s, clock.largest_sd_s),
        took_s=took_s,
    )
    if np.abs(said.standardised).max() > MOST_SDS:
        return replace(said, word=WRONG)
    return said


def _three(values: Floats) -> tuple[float, float, float]:
    start, middle, end = values.tolist()
    return start, middle, end


# --- Tables.

GROUP_COLUMNS: Final = (
    "worlds",
    "count",
    "right, within 3 sd",
    "within 10 ms",
    "wrong",
    "refused",
    "left as stamped",
    "error [ms], rms at start, middle, end",
    "largest [ms]",
    "error / stated sd, rms at start, middle, end",
)
WORLD_COLUMNS: Final = (
    "number",
    "world",
    "is",
    "error [ms] at start, middle, end",
    "stated sd [ms]",
    "by, or warnings",
    "s",
)


def _of_word(outcomes: Sequence[Outcome], word: str) -> list[Outcome]:
    return [said for said in outcomes if said.word == word]


def _rms(values: Floats) -> str:
    """Write the root mean squares of columns."""
    if not len(values):
        return ""
    return ", ".join(f"{value:.3g}" for value in np.sqrt(np.mean(values**2, axis=0)))


def group_row(name: str, outcomes: Sequence[Outcome]) -> str:
    """Write what became of some worlds."""
    aligned = _of_word(outcomes, RIGHT) + _of_word(outcomes, WRONG)
    off_ms = np.array([said.off_s for said in aligned]) * 1e3
    standardised = np.array([said.standardised for said in aligned])
    largest = f"{np.abs(off_ms).max():.3g}" if aligned else ""
    cells = [
        name,
        f"{len(outcomes)}",
        f"{len(_of_word(outcomes, RIGHT))}",
        f"{sum(said.is_close for said in aligned)}",
        f"{len(_of_word(outcomes, WRONG))}",
        f"{len(_of_word(outcomes, REFUSED))}",
        f"{len(_of_word(outcomes, LEFT))}",
        _rms(off_ms),
        largest,
        _rms(standardised),
    ]
    return f"| {' | '.join(cells)} |"


def group_rows(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Write the groups of worlds: by what the motion is, what the DVL has, and how good the IMU is."""
    telling = [said for said in outcomes if not said.world.is_silent]
    for trajectory in TRAJECTORIES:
        for has_compass in (True, False):
            some = []
            for said in telling:
                world = said.world
                if (world.trajectory, world.has_compass) == (trajectory, has_compass):
                    some.append(said)
            compass = "with" if has_compass else "without"
            yield group_row(f"{trajectory}, {compass} a compass", some)
    for grade in GRADES:
        yield group_row(f"all, {grade}", [said for said in telling if said.world.grade == grade])
    yield group_row("all", telling)
    silent = [said for said in outcomes if said.world.is_silent]
    yield group_row("straight and at rest: refused or warned of", silent)


def world_row(said: Outcome) -> str:
    """Write what became of one world."""
    off = ", ".join(f"{value * 1e3:+.1f}" for value in said.off_s)
    sds = ", ".join(f"{value * 1e3:.1f}" for value in said.sds_s)
    how = said.how
    if said.word == REFUSED:
        off = ""
        how = ""
    if said.word in (REFUSED, LEFT):
        sds = ""
    cells = [f"{said.world.number}", said.world.text, said.word, off, sds, how]
    return f"| {' | '.join(cells)} | {said.took_s:.1f} |"


def main() -> None:
    """Read all worlds, and write their table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=0, help="so many of them; 0 for all")
    parser.add_argument("--only", type=int, default=0, help="the world of this number")
    arguments = parser.parse_args()
    chosen = worlds()
    is_whole = not (arguments.worlds or arguments.only)
    if arguments.only:
        chosen = [world for world in chosen if world.number == arguments.only]
    elif arguments.worlds:
        chosen = chosen[:: max(1, len(chosen) // arguments.worlds)]
    begun_s = time.monotonic()
    outcomes: list[Outcome] = []
    for world in chosen:
        said = outcome(world)
        outcomes.append(said)
        sys.stderr.write(f"{world_row(said)}\n")
        if said.word == REFUSED:
            sys.stderr.write(f"{said.how}\n")
    telling = [said for said in outcomes if not said.world.is_silent]
    silent = [said for said in outcomes if said.world.is_silent]
    are_aligned = any(said.word in (RIGHT, WRONG) for said in silent)
    are_guessed = any(said.is_silent_guess for said in outcomes)
    all_met = not _of_word(telling, WRONG) and not are_aligned and not are_guessed
    lines = [
        HEADING,
        "",
        "An IMU's table and a DVL's PD0 file of the same dive by unrelated clocks, up to 500 s and 50 ppm apart; no "
        "settings of the DVL. *Right* is within three stated standard errors at the first ping, the middle one and "
        "the last; *left as stamped* is a dive whose stamps overlap and are taken as they are. Asked: none wrong, "
        "no straight dive or dive at rest aligned, and a warning wherever stamps are taken as they are.",
        "",
        *table(GROUP_COLUMNS, list(group_rows(outcomes))),
        "",
        "Each world:",
        "",
        *table(WORLD_COLUMNS, [world_row(said) for said in outcomes]),
        "",
        f"{machine()}; {time.monotonic() - begun_s:.0f} s.",
    ]
    finish("\n".join(lines), is_whole=is_whole, all_met=all_met)


if __name__ == "__main__":
    main()
