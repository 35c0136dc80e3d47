"""How long the program itself takes, and how much memory: its start, a dive, the first run, and dives of many hours.

`make bench` runs this; it makes its logs in a temporary folder and removes them. Every measurement is a process of its
own; what is compared is measured in turn. Name sections to measure only these.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory, gettempdir, mkdtemp
from typing import Any, NamedTuple

from results import machine, table, write_part

ROUNDS = 5
PROGRAM = (sys.executable, "-m", "insdvl_replay")
PARTS = "import pandas, numba, scipy.special, mcap, rich, typer"
GOALS = {
    "start": "`--help` in 0.2 s, and 3 times what Python and typer take.",
    "dive": "1.5 s with a preset and 4 s without settings, for a dive of 424 s at 100 Hz.",
    "first": "15 s for the first run on a machine, which compiles.",
    "growth": "15 s of processor time and 600 MB for 9 h at 100 Hz, 45 s and 1 GB for 24 h, 12 s and 600 MB for 1 h "
    "at 1 kHz.",
}


class Length(NamedTuple):
    """A dive of which the growth is measured; those of a day are run but once."""

    name: str
    duration_s: float
    imu_rate_hz: float
    rounds: int

    @property
    def columns_mb(self) -> float:
        """What times and readings of the IMU take."""
        return self.duration_s * self.imu_rate_hz * 7 * 8 / 2**20


LENGTHS = (
    Length("424 s at 100 Hz", 424.0, 100.0, ROUNDS),
    Length("1 h at 100 Hz", 3600.0, 100.0, ROUNDS),
    Length("3 h at 100 Hz", 10_800.0, 100.0, ROUNDS),
    Length("9 h at 100 Hz", 32_400.0, 100.0, ROUNDS),
    Length("24 h at 100 Hz", 86_400.0, 100.0, 1),
    Length("1 h at 1 kHz", 3600.0, 1000.0, ROUNDS),
    Length("24 h at 400 Hz", 86_400.0, 400.0, 1),
)
STAGES = {
    "fitting the noise": "noise",
    "reading the log": "reading",
    "running the filters": "filters",
    "running the filters from random starts": "random starts",
    "DVL outage test": "outage test",
    "judging the filters": "judging",
    "writing the results": "writing",
    "drawing the report": "page",
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


def simulated(log: Path, scenario: str, duration_s: float, imu_rate_hz: float = 100.0) -> Path:
    """Write a dive, in a process that gives its memory back."""
    code = (
        "import sys; from pathlib import Path; from insdvl_replay.logs import write_dive; "
        "from insdvl_replay.sim.dive import simulate_dive; log, scenario, *numbers = sys.argv[1:]; "
        "duration_s, imu_rate_hz = map(float, numbers); "
        "write_dive(Path(log), simulate_dive(scenario, seed=1, duration_s=duration_s, imu_rate_hz=imu_rate_hz))"
    )
    subprocess.run(
        [sys.executable, "-c", code, str(log), scenario, str(duration_s), str(imu_rate_hz)],
        check=True,
    )
    return log


def run_of(log: Path) -> tuple[str, ...]:
    """Give the arguments that replay a log with all outputs."""
    return ("run", str(log), "-o", str(log.parent / "out"), "--force", "--rerun")


def start(_: Path) -> list[str]:
    """Measure the start of the program beside that of what it is made of."""
    commands = {
        "`python -c pass`": (sys.executable, "-c", "pass"),
        "`python -c 'import typer'`": (sys.executable, "-c", "import typer"),
        "`insdvl-replay --help`": (*PROGRAM, "--help"),
        "`insdvl-replay schema report`": (*PROGRAM, "schema", "report"),
    }
    return used_rows(
        in_turn({name: lambda one=one: used_by(one) for name, one in commands.items()}, ROUNDS)
    )


def dive(folder: Path) -> list[str]:
    """Measure the replay of a short dive beside the start of what it is made of."""
    log = simulated(folder / "dive.mcap", "straight", 424.0)
    commands = {
        f"`python -c '{PARTS}'`": (sys.executable, "-c", PARTS),
        "`run`, 424 s": (*PROGRAM, *run_of(log)),
        "`run --preset fog`, 424 s": (*PROGRAM, *run_of(log), "--preset", "fog"),
    }
    used_by(commands["`run`, 424 s"])
    return used_rows(
        in_turn({name: lambda one=one: used_by(one) for name, one in commands.items()}, ROUNDS)
    )


def first(folder: Path) -> list[str]:
    """Measure a run, and compiling alone, without any compiled code."""
    log = simulated(folder / "dive.mcap", "straight", 424.0)

    def cold(*arguments: str) -> Used:
        return used_by((*PROGRAM, *arguments), INSDVL_REPLAY_CACHE=mkdtemp(dir=folder))

    contenders = {
        "`run`, 424 s, the first": lambda: cold(*run_of(log)),
        "`compile`": lambda: cold("compile"),
    }
    return used_rows(in_turn(contenders, ROUNDS))


def used_rows(medians: dict[str, Used]) -> list[str]:
    """Make a row of each process."""
    least_s = min(used.processor_s for used in medians.values())
    return [
        f"| {name} | {used.processor_s:.2f} | {used.processor_s / least_s:.1f} x | {used.peak_mb:.0f} |"
        for name, used in medians.items()
    ]


MOVING = "calibration"
"""A scenario of which the vehicle rolls, pitches and sways for ever; that of others goes straight on at their end."""


def growth(folder: Path, rounds: int = ROUNDS, most_hours: float = math.inf) -> list[str]:
    """Measure dives of more and more samples, each by its stages."""
    lengths = [length for length in LENGTHS if length.duration_s <= 3600.0 * most_hours]
    runs: dict[Length, list[dict[str, Any]]] = {length: [] for length in lengths}
    logs = {
        length: simulated(
            folder / f"{length.name}.mcap", MOVING, length.duration_s, length.imu_rate_hz
        )
        for length in lengths
    }
    for number in range(rounds):
        for length in (length for length in lengths if number < length.rounds):
            runs[length].append(
                json.loads(
                    subprocess.check_output(staged(logs[length]), stderr=subprocess.DEVNULL)
                )
            )
    return [grown_row(length, of_length) for length, of_length in runs.items()]


def grown_row(length: Length, runs: list[dict[str, Any]]) -> str:
    """Lay the stages of a dive side by side."""
    cells = [length.name, f"{length.columns_mb:.0f}"]
    cells.append(f"{median(run['peak_mb'] for run in runs):.0f}")
    cells.append(f"{median(run['whole_s'] for run in runs):.1f}")
    cells.append(f"{median(sum(run['stages'].values()) for run in runs):.1f}")
    cells += [
        f"{median(run['stages'].get(stage, 0.0) for run in runs):.2f}"
        for stage in ("start", *STAGES.values())
    ]
    return f"| {' | '.join(cells)} |"


def staged(log: Path) -> list[str]:
    """Give the command that runs a log and says what its stages took."""
    return [sys.executable, __file__, "--stages", *run_of(log)]


def run_by_stages(arguments: list[str]) -> None:
    """Run the program here, and print what each stage took of processor time, and the whole of time and memory."""
    begin_s = time.perf_counter()
    spent = dict[str, float]()
    current = ["start", 0.0]

    def end_stage(following: str, _done: int, total: int) -> None:
        if total:
            return
        stage, since_s = current
        now_s = time.process_time()
        name = STAGES.get(stage, stage)
        spent[name] = spent.get(name, 0.0) + now_s - since_s
        current[:] = [following, now_s]

    from insdvl_replay.core.processor import use_common_code
    from insdvl_replay.core.runtime import prepare_process

    use_common_code()
    prepare_process()
    from insdvl_replay.cli import run_command_line
    from insdvl_replay.core.runtime import progress_listener

    with redirect_stdout(StringIO()), progress_listener(end_stage):
        code = run_command_line(arguments)
    end_stage("", 0, 0)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    used = {
        "stages": spent,
        "whole_s": time.process_time(),
        "wall_s": time.perf_counter() - begin_s,
        "peak_mb": peak_mb,
    }
    sys.stdout.write(json.dumps(used))
    sys.exit(code)


USED = "seconds of processor time of all threads, and the most memory."
USED_COLUMNS = ("what", "s", "against the first", "MB")
GROWTH_COLUMNS = (
    "dive",
    "MB of the IMU's columns",
    "MB at most",
    "s",
    "sum of stages",
    "start",
    *STAGES.values(),
)
SECTIONS: dict[str, tuple[Callable[[Path], list[str]], tuple[str, ...], str]] = {
    "start": (start, USED_COLUMNS, USED),
    "dive": (dive, USED_COLUMNS, USED),
    "first": (first, USED_COLUMNS, USED),
    "growth": (
        growth,
        GROWTH_COLUMNS,
        "all outputs, two filters, sixteen starts, the DVL outage test, a ping a second and a reference of 5 Hz; the "
        "most memory, and seconds of processor time of all threads, in all and by stage. Those of a day are run once.",
    ),
}


def report(section: str, rounds: int, most_hours: float) -> str:
    """Measure a section and make a part of the page of it."""
    measure, columns, what = SECTIONS[section]
    if measure is growth:
        measure = partial(growth, rounds=rounds, most_hours=most_hours)
    with TemporaryDirectory() as folder:
        rows = measure(Path(folder))
    medians = f"Medians of {rounds}, measured in turn: " if rounds > 1 else "Measured once: "
    lines = [
        f"# Whole run: {section}",
        "",
        f"{medians}{what}",
        "",
        *table(columns, rows),
        "",
        f"{machine()}; shared cores. At most {GOALS[section]}",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print and write the parts of the page."""
    if sys.argv[1:2] == ["--stages"]:
        run_by_stages(sys.argv[2:])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "sections",
        nargs="*",
        metavar="SECTION",
        help=f"of {', '.join(SECTIONS)}; all if none is named",
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="of the growth")
    parser.add_argument("--hours", type=float, default=math.inf, help="longest dive of the growth")
    asked = parser.parse_args()
    # Without byte code, each start compiles the modules of an editable install.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ.setdefault("PYTHONPYCACHEPREFIX", str(Path(gettempdir()) / "whole_run_byte_code"))
    for section in asked.sections or SECTIONS:
        part = report(section, asked.rounds if section == "growth" else ROUNDS, asked.hours)
        sys.stdout.write(part + "\n")
        write_part(part)


if __name__ == "__main__":
    main()
