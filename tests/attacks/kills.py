"""Signals at random moments: nothing is half written, nothing lives on, and the next run succeeds."""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

from base_logs import ROOT
from living import PATIENCE_S, half_written, hidden, started, waited

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
INTERRUPTED = 130
BARE = "ended by the bare signal"
"""Before or after the program: as Python starts it prints a traceback of its own modules."""


def commands(folder: Path) -> dict[str, list[str]]:
    """Give the commands that are tried, by name."""
    gates, results = str(folder / "gates.toml"), str(folder / "results")
    return {
        "run": ["run", str(folder / "dives" / "lost_beam.mcap"), "-o", results],
        "run --force": [
            "run",
            str(folder / "dives" / "lost_beam.mcap"),
            "-o",
            results,
            "--force",
            "--rerun",
        ],
        "check --jobs 2": ["check", gates, "--results", results, "--jobs", "2", "--rerun"],
        "check --update": ["check", gates, "--results", results, "--update"],
    }


def fresh(folder: Path) -> None:
    """Make an archive of two dives."""
    shutil.rmtree(folder, ignore_errors=True)
    archive = ROOT / "examples" / "archive"
    (folder / "dives").mkdir(parents=True)
    for name in ("lost_beam", "transit"):
        shutil.copy(archive / "dives" / f"{name}.mcap", folder / "dives")
    shutil.copytree(archive / "expected", folder / "expected")
    for settings in archive.glob("*.toml"):
        shutil.copy(settings, folder)


def durations(folder: Path) -> dict[str, float]:
    """Measure how long each command takes that nobody disturbs."""
    fresh(folder)
    taken_s = {}
    for name, command in commands(folder).items():
        start_s = time.monotonic()
        code = started(command, folder / "said").wait(PATIENCE_S)
        taken_s[name] = time.monotonic() - start_s
        if code:
            said = (folder / "said").read_text("utf-8", "replace")
            raise RuntimeError(f"{name} fails without any signal: {said}")
    return taken_s


def imports_s() -> float:
    """Measure how long a command imports, before it reads its first file."""
    start_s = time.monotonic()
    subprocess.run(
        [sys.executable, "-c", "import insdvl_replay.api, insdvl_replay.preparation.replay"],
        check=True,
    )
    return time.monotonic() - start_s


def attack(folder: Path, seeds: range) -> Iterator[tuple[str, str, str, str]]:
    """Kill commands.

    Yields
    ------
    str, str, str, str
        Which command, which signal, the verdict, and what was seen.
    """
    taken_s, importing_s = durations(folder), imports_s()
    for seed in seeds:
        rng = Random(seed)
        name, number = rng.choice(sorted(taken_s)), rng.choice(SIGNALS)
        delay_s, when = rng.uniform(0.0, taken_s[name]), ""
        if seed % 4 == 0:  # most moments are beyond the imports
            number, delay_s, when = signal.SIGINT, rng.uniform(0.0, importing_s), " in the imports"
        judged, seen = _killed(folder, name, number, delay_s)
        told = f"--seed {seed} --count 1: {name}, {number.name} after {delay_s:.2f} s: {seen}"
        yield name, f"{number.name}{when}", judged, told


def _killed(folder: Path, name: str, number: signal.Signals, delay_s: float) -> tuple[str, str]:
    fresh(folder)
    if name == "run --force":
        started(commands(folder)["run"], folder / "said").wait(PATIENCE_S)
    process = started(commands(folder)[name], folder / "said")
    time.sleep(delay_s)
    process.send_signal(number)
    try:
        code = process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return "hang", "still there"
    left = waited(process)
    said = (folder / "said").read_text("utf-8", "replace").rstrip().rpartition("\n")[2][:160]
    return _judged(
        folder, name, number, code, left
    ), f"exit {code}, {len(left)} processes left: {said}"


def _judged(folder: Path, name: str, number: signal.Signals, code: int, left: list[int]) -> str:
    if left:
        return "processes left"
    if half_written(folder / "results") or not all(
        map(_whole, (folder / "expected").glob("*.json"))
    ):
        return "half written"
    if (
        name == "run --force"
        and not (folder / "results" / "lost_beam").is_dir()
        and not hidden(folder)
    ):
        return "older result lost"
    if number == signal.SIGKILL:
        return _again(folder, name)
    said = (folder / "said").read_text("utf-8", "replace")
    if "Traceback (most recent call last)" in said:
        return "traceback" if str(ROOT / "insdvl_replay") in said else BARE
    if hidden(folder):
        return "leftovers"
    return {4: "exit 4", -number: BARE}.get(
        code, "ok" if code in (0, INTERRUPTED) else "other code"
    )


def _again(folder: Path, name: str) -> str:
    """Run the same again after a kill that nobody can answer."""
    code = started([*commands(folder)[name]], folder / "said").wait(PATIENCE_S)
    return "the next run fails" if code else "ok"


def _whole(path: Path) -> bool:
    try:
        return bool(json.loads(path.read_text("utf-8")))
    except ValueError:
        return False
