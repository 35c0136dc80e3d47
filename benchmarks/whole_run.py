"""How long the program itself takes, and how much memory: its start, a dive, the first run, and dives of many hours.

`make bench` runs this; it makes its logs in a temporary folder and removes them. Every measurement is a process of its
own; what is compared is measured in turn. Name sections to measure only these.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory, mkdtemp
from typing import NamedTuple

from results import machine, table, write_part

ROUNDS = 5
PROGRAM = (sys.executable, "-m", "insdvl_replay")
HOURS = (1.0, 3.0, 9.0)
GOALS = {
    "start": "`--help` in 0.2 s, and 3 times what Python and typer take.",
    "dive": "3 s for a dive of 424 s at 100 Hz.",
    "first": "15 s for the first run on a machine, which compiles.",
    "growth": "15 s and 600 MB for 9 h at 100 Hz; memory grows with the columns.",
}


class Used(NamedTuple):
    """What a process took."""

    processor_s: float
    peak_mb: float


def used_by(command: Sequence[str], **environment: str) -> Used:
    """Run a command to its end."""
    process = subprocess.Popen(command, env=os.environ | environment, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}")
    return Used(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def in_turn(contenders: dict[str, Callable[[], Used]], rounds: int) -> dict[str, Used]:
    """Give the medians of what each took."""
    taken: dict[str, list[Used]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            taken[name].append(contender())
    return {name: Used(*map(median, zip(*each, strict=True))) for name, each in taken.items()}


def simulated(log: Path, scenario: str, duration_s: float) -> Path:
    """Write a dive at 100 Hz."""
    subprocess.run([*PROGRAM, "simulate", scenario, "-o", str(log), "--duration", str(duration_s)], check=True)
    return log


def run_of(log: Path) -> tuple[str, ...]:
    """Give the command that replays a log with all outputs."""
    return (*PROGRAM, "run", str(log), "-o", str(log.parent / "out"), "--force", "--rerun")


def start(_: Path, rounds: int) -> dict[str, Used]:
    """Measure the start of the program beside that of what it is made of."""
    commands = {
        "`python -c pass`": (sys.executable, "-c", "pass"),
        "`python -c 'import typer'`": (sys.executable, "-c", "import typer"),
        "`insdvl-replay --help`": (*PROGRAM, "--help"),
        "`insdvl-replay schema report`": (*PROGRAM, "schema", "report"),
    }
    return in_turn({name: lambda command=command: used_by(command) for name, command in commands.items()}, rounds)


def dive(folder: Path, rounds: int) -> dict[str, Used]:
    """Measure the replay of a short dive."""
    log = simulated(folder / "dive.mcap", "straight", 424.0)
    used_by(run_of(log))
    return in_turn({"`run`, 424 s": lambda: used_by(run_of(log))}, rounds)


def first(folder: Path, rounds: int) -> dict[str, Used]:
    """Measure a run, and compiling alone, without any compiled code."""
    log = simulated(folder / "dive.mcap", "straight", 424.0)

    def cold(command: Sequence[str]) -> Used:
        return used_by(command, INSDVL_REPLAY_CACHE=mkdtemp(dir=folder))

    contenders = {
        "`run`, 424 s, the first": lambda: cold(run_of(log)),
        "`compile`": lambda: cold([*PROGRAM, "compile"]),
    }
    return in_turn(contenders, rounds)


def growth(folder: Path, rounds: int) -> dict[str, Used]:
    """Measure dives of some hours."""
    logs = {
        f"`run`, {hours:g} h": simulated(folder / f"{hours:g}.mcap", "lawnmower", 3600.0 * hours) for hours in HOURS
    }
    used_by(run_of(next(iter(logs.values()))))
    return in_turn({name: lambda log=log: used_by(run_of(log)) for name, log in logs.items()}, rounds)


SECTIONS = {"start": start, "dive": dive, "first": first, "growth": growth}


def report(section: str, rounds: int) -> str:
    """Measure a section and make a part of the page of it."""
    with TemporaryDirectory() as folder:
        medians = SECTIONS[section](Path(folder), rounds)
    rows = [f"| {name} | {used.processor_s:.2f} | {used.peak_mb:.0f} |" for name, used in medians.items()]
    lines = [
        f"# Whole run: {section}",
        "",
        f"Medians of {rounds}, measured in turn: seconds of processor time of all threads, and the most memory.",
        "",
        *table(("what", "s", "MB"), rows),
        "",
        f"{machine()}; shared cores. At most {GOALS[section]}",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print and write the parts of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}; all if none is named"
    )
    parser.add_argument("--quick", action="store_true", help="measure everything once, and leave the page as it is")
    arguments = parser.parse_args()
    for section in arguments.sections or SECTIONS:
        part = report(section, 1 if arguments.quick else ROUNDS)
        sys.stdout.write(part + "\n")
        if not arguments.quick:
            write_part(part)


if __name__ == "__main__":
    main()
