"""How long a check of many dives takes: the first on one process and on two, and the second, which replays nothing.

The dives are simulated into a temporary folder, which is removed in the end. Each check is made several times, in turn,
and the fastest counts: what else the machine does only ever makes it slower. Processor time says what the work costs
where others use the machine, too; a second process adds its start, not the time of a dive.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

DIVES = 200
DURATION_S = 60.0
ROUNDS = 3
GATES = """
dives = ["dives"]

[[gate]]
name = "vertical accelerometer bias converges"
table = "improvement"
row = "ba_z"
column = "improvement_pct"
min = 10.0
"""


def make_archive(folder: Path) -> None:
    """Simulate the dives and write the gates."""
    (folder / "gates.toml").write_text(GATES, "utf-8")
    (folder / "dives").mkdir()
    for seed in range(DIVES):
        write_dive(
            folder / "dives" / f"dive_{seed:03d}.mcap", simulate_dive("straight", seed=seed, duration_s=DURATION_S)
        )


def seconds_of_check(folder: Path, *arguments: str) -> tuple[float, float]:
    """Give the wall-clock and the processor time of one check in a process of its own."""
    command = [sys.executable, "-m", "insdvl_replay", "check", "gates.toml", *arguments]
    before, start_s = os.times(), time.perf_counter()
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    wall_s, after = time.perf_counter() - start_s, os.times()
    return wall_s, after.children_user + after.children_system - before.children_user - before.children_system


def fastest_checks(folder: Path) -> dict[str, tuple[float, float]]:
    """Give the least wall-clock and the least processor time of each kind of check."""
    kinds = {
        "first, one process": ("--results", "one"),
        "first, two processes": ("--results", "two", "--jobs", "2"),
        "second": ("--results", "one"),
    }
    times: dict[str, list[tuple[float, float]]] = {label: [] for label in kinds}
    for _ in range(ROUNDS):
        for results in ("one", "two"):
            shutil.rmtree(folder / results, ignore_errors=True)
        for label, arguments in kinds.items():
            times[label].append(seconds_of_check(folder, *arguments))
    return {label: (min(wall for wall, _ in of), min(cpu for _, cpu in of)) for label, of in times.items()}


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_archive(folder)
        seconds_of_check(folder, "--results", "warm", "dives/dive_000.mcap")
        checks = fastest_checks(folder)
    lines = [
        f"{label:22} {wall_s:7.2f} s, {cpu_s:7.2f} s of processor time, {1e3 * cpu_s / DIVES:5.1f} ms a dive"
        for label, (wall_s, cpu_s) in checks.items()
    ]
    one_s, two_s, second_s = (wall_s for wall_s, _ in checks.values())
    lines.append(
        f"two processes: {one_s / two_s:.2f} x one; second check: {one_s / second_s:.1f} x faster than the first"
    )
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
