"""How many dives an hour a check replays on one process and on two, and how long the second takes, which replays none.

The dives are simulated into a temporary folder, which is removed in the end. Each check is made several times, in turn.
Processor time says what the work costs where others use the machine, too; a second process adds its start, not the time
of a dive.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

from results import machine, table, write_part

from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

ROUNDS = 5
GATES = """
dives = ["dives"]

[[gate]]
name = "vertical accelerometer bias converges"
table = "improvement"
row = "ba_z"
column = "improvement_pct"
min = 10.0
"""
KINDS = {
    "the first, one process": ("--results", "one"),
    "the first, two processes": ("--results", "two", "--jobs", "2"),
    "the second": ("--results", "one"),
}


class Took(NamedTuple):
    """What a check took: wall-clock time, and processor time of all its processes."""

    wall_s: float
    processor_s: float


def make_dives(folder: Path, dives: int, duration_s: float) -> None:
    """Simulate the dives and write the gates."""
    (folder / "gates.toml").write_text(GATES, "utf-8")
    (folder / "dives").mkdir()
    for seed in range(dives):
        dive = simulate_dive("straight", seed=seed, duration_s=duration_s)
        write_dive(folder / "dives" / f"dive_{seed:03d}.mcap", dive)


def check(folder: Path, *arguments: str) -> Took:
    """Time one check in a process of its own."""
    command = [sys.executable, "-m", "insdvl_replay", "check", "gates.toml", *arguments]
    before = os.times()
    start_s = time.perf_counter()
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    wall_s = time.perf_counter() - start_s
    after = os.times()
    used_s = (
        after.children_user + after.children_system - before.children_user - before.children_system
    )
    return Took(wall_s, used_s)


def usual_checks(folder: Path) -> dict[str, Took]:
    """Give the median wall-clock and processor time of each kind of check."""
    taken: dict[str, list[Took]] = {kind: [] for kind in KINDS}
    for _ in range(ROUNDS):
        for results in ("one", "two"):
            shutil.rmtree(folder / results, ignore_errors=True)
        for kind, arguments in KINDS.items():
            taken[kind].append(check(folder, *arguments))
    return {kind: Took(*map(median, zip(*each, strict=True))) for kind, each in taken.items()}


def report(dives: int, duration_s: float) -> str:
    """Measure, and make a part of the page of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_dives(folder, dives, duration_s)
        check(folder, "--results", "warm", "dives/dive_000.mcap")
        checks = usual_checks(folder)
    first_s = checks["the first, one process"].wall_s
    rows = [
        f"| {kind} | {took.wall_s:.2f} | {took.processor_s:.2f} | {3600.0 * dives / took.wall_s:.0f} "
        f"| {first_s / took.wall_s:.2f} x |"
        for kind, took in checks.items()
    ]
    lines = [
        f"# Batch: {dives} dives of {duration_s:g} s",
        "",
        f"A check of all of them against one gate, with all outputs; medians of {ROUNDS}, measured in turn. The second "
        "check of the same dives finds their results.",
        "",
        *table(
            ("check", "s", "s of processor time", "dives an hour", "against one process"), rows
        ),
        "",
        f"{machine()}; shared cores.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print and write the part of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dives", type=int, default=200)
    parser.add_argument("--duration", type=float, default=400.0, metavar="S")
    arguments = parser.parse_args()
    part = report(arguments.dives, arguments.duration)
    sys.stdout.write(part)
    write_part(part)


if __name__ == "__main__":
    main()
