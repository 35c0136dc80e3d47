"""Dives as tables, damaged by the hundred, each replayed in a forked child, and how often it went how."""

import gc
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import mkdtemp

from made_tables import SECTIONS, Tables, simulated, tables_of
from table_harm import ENDINGS, written
from victim import (
    DEFECTS,
    HARMLESS,
    Ended,
    Result,
    last_line,
    ready,
    result_of,
    run_forked,
    verdict,
    verdict_on_result,
)

from insdvl_replay.geometry.frames import solve_beams

SPAN_NS = 50_000_000_000
OF_DATA = ("table", "imu", "dvl", "reference", "log", "joined", "clock", "gap")
SEARCHED = 0.15
"""Share of the mutants that are replayed without settings."""
SETTINGS = """
[imu]
topic = "{imu}"
specific_force = "acc_x, acc_y, acc_z"
angular_rate = "gyro_x, gyro_y, gyro_z"
[dvl]
topic = "{dvl}"
velocity = "vel_x, vel_y, vel_z"
[reference]
topic = "{reference}"
latitude = "latitude"
longitude = "longitude"
height = "height"
velocity_n = "v_north, v_east, v_down"
roll = "roll"
pitch = "pitch"
heading = "yaw"
angle_unit = "rad"
[evaluation]
starts = 1
"""


@dataclass(frozen=True)
class Clean:
    """A dive of whole tables: how it is read, what it gives, and the memory that takes."""

    ending: str
    settings: Path
    result: Result
    peak_mb: float


@dataclass(frozen=True)
class Outcome:
    """How one command on one mutant went."""

    seed: int
    ending: str
    harms: str
    command: str
    verdict: str
    said: str

    def line(self) -> str:
        """Say it in one line that can be searched and repeated."""
        last = last_line(self.said)
        return f"{self.verdict}: --seed {self.seed} --count 1: {self.ending}, {self.harms}, {self.command}: {last!r}"


def short_tables() -> Tables:
    """Return the tables of a short dive, with the velocities of its DVL."""
    dive = simulated()
    tables = tables_of(dive)
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0]
    velocities = {
        f"Vel {axis} [m/s]": column for axis, column in zip("xyz", velocity_d.T, strict=True)
    }
    tables["dvl"] = {"Time [ns]": tables["dvl"]["Time [ns]"], **velocities}
    last_ns = tables["imu"]["Time [ns]"][0] + SPAN_NS
    shortened: Tables = {}
    for name, table in tables.items():
        kept = table["Time [ns]"] <= last_ns
        shortened[name] = {title: column[kept] for title, column in table.items()}
    return shortened


def command(path: Path, output: Path, settings: Path | None) -> list[str]:
    """Return the command on tables, with settings or without."""
    return [
        "run",
        str(path),
        "-o",
        str(output),
        *(["-c", str(settings)] if settings else ["--starts", "1"]),
    ]


def prepared(folder: Path) -> list[Clean]:
    """Replay the whole tables in every format, here once so that all is loaded, and in a child."""
    cleans = []
    for ending in ENDINGS:
        place = folder / f"clean_{ending}"
        place.mkdir(parents=True)
        _, path = written(short_tables(), place / "dive", ending, None)
        settings = place / "settings.toml"
        at = {
            name: f"{name}.{ending}" if path.is_dir() else f"dive.{ending}/{name}"
            for name in SECTIONS
        }
        settings.write_text(SETTINGS.format(**at))
        ready([command(path, place / "warm", settings), command(path, place / "searched", None)])
        ended = run_forked(command(path, place / "results", settings), folder / "said")
        result = result_of(place / "results" / "dive")
        if result is None:
            raise SystemExit(f"{path}: the clean tables give no result: {ended.said}")
        searched = run_forked(command(path, place / "results_searched", None), folder / "said")
        cleans.append(Clean(ending, settings, result, max(ended.peak_mb, searched.peak_mb)))
    gc.freeze()
    return cleans


def attempt(seed: int, cleans: list[Clean], folder: Path) -> Outcome:
    """Make one mutant and replay it."""
    rng = Random(seed)
    clean = rng.choice(cleans)
    searched = rng.random() < SEARCHED
    output = folder / "results"
    try:
        harms, path = written(short_tables(), folder / "dive", clean.ending, rng)
        ended = run_forked(
            command(path, output, None if searched else clean.settings), folder / "said"
        )
        judged = verdict(ended, clean.peak_mb)
        if judged == "ok" and not searched:
            judged = _judged(ended, output, clean.result, harms)
    finally:
        shutil.rmtree(folder / "dive", ignore_errors=True)
        shutil.rmtree(output, ignore_errors=True)
    return Outcome(seed, clean.ending, harms, "run" if searched else "run -c", judged, ended.said)


def _judged(ended: Ended, output: Path, clean: Result, harms: str) -> str:
    """Judge what `run` left; only notes of what was read count, since those on filters change with any number."""
    judged = verdict_on_result(ended, output, clean, protected=True, same_content=_is_noted(harms))
    found = result_of(output / "dive")
    if judged != "differs, noted" or found is None:
        return judged
    added = {
        code for code, _ in found.notes.items() - clean.notes.items() if code.startswith(OF_DATA)
    }
    if added:
        return judged
    return "differs unnoted" if _is_noted(harms) else "differs, other content"


def _is_noted(harms: str) -> bool:
    """Return whether a loss or change by such harm can be seen in the tables: other numbers in a column cannot."""
    unseen = (
        "exchanged",
        "times ",
        " is ",
        " as ",
        "bytes",
        "texts in cells",
        "more cells",
        " at each end",
        "rows of",
    )
    return not any(word in harms for word in unseen)


class _Work:
    """What a worker holds: forked with it, never sent."""

    cleans: list[Clean]
    folder: Path


def _attempts_of(seeds: list[int]) -> list[Outcome]:
    folder = Path(mkdtemp(dir=_Work.folder))
    found = [attempt(seed, _Work.cleans, folder) for seed in seeds]
    shutil.rmtree(folder)
    return found


def campaign(seeds: range, jobs: int, folder: Path) -> Iterator[Outcome]:
    """Try all seeds; say each defect as it is found."""
    _Work.cleans, _Work.folder = prepared(folder), folder
    portions = [list(seeds[i : i + 10]) for i in range(0, len(seeds), 10)]
    with ProcessPoolExecutor(jobs, get_context("fork")) as pool:
        for outcomes in pool.map(_attempts_of, portions):
            for outcome in outcomes:
                if outcome.verdict in DEFECTS:
                    sys.stdout.write(outcome.line() + "\n")
                    sys.stdout.flush()
                yield outcome


def rows(outcomes: list[Outcome]) -> list[str]:
    """Count outcomes by verdict and format."""
    counts = Counter((outcome.verdict, outcome.ending) for outcome in outcomes)
    tried = Counter(outcome.ending for outcome in outcomes)
    lines = [("mutants", [tried[ending] for ending in ENDINGS])]
    lines += [
        (name, [counts[name, ending] for ending in ENDINGS]) for name in (*DEFECTS, *HARMLESS)
    ]
    return [f"| {name} | {' | '.join(map(str, numbers))} |" for name, numbers in lines]
