"""How long the same IMU and DVL take to read in each encoding and container, against CDR in MCAP.

`make bench` runs this; it makes its logs in a temporary folder and removes them. Ratios are of medians of readings in
turn, each in a process of its own.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from reading import PER_IMU, dive, measured
from results import machine, table, write_part

ROOT = Path(__file__).resolve().parents[1]
sys.path[1:1] = [str(ROOT / "tests")]

import other_bags  # noqa: E402

from insdvl_replay.logs import write_dive  # noqa: E402

ROUNDS = 5
COLUMNS = ("log", "MB", "s", "against CDR in MCAP", "MB beyond columns")
GOAL = "ROS 1 in MCAP is to take at most 1.3 times as long."
CDR = "CDR in MCAP"
WRITERS: dict[str, Callable[[Path, bytes], Path]] = {
    "ROS 1 in MCAP": lambda folder, log: other_bags.ros1_mcap(folder / "ros1.mcap", log),
    ".db3": lambda folder, log: sqlite(folder, log),
    ".bag, lz4": lambda folder, log: other_bags.bag(folder / "lz4.bag", "lz4", log),
    ".bag, bz2": lambda folder, log: other_bags.bag(folder / "bz2.bag", "bz2", log),
}


def sqlite(folder: Path, log: bytes) -> Path:
    """Write the one part of a bag, without the folder around it."""
    bag = other_bags.ros2_bag(folder / "iron", log=log)
    return (bag / "iron.db3").rename(folder / "iron.db3")


def in_turn(logs: dict[str, Path]) -> dict[str, dict[str, float]]:
    """Read all logs, one after the other, several times; give the medians."""
    rounds = [
        {name: measured(path, "insdvl-replay") for name, path in logs.items()}
        for _ in range(ROUNDS)
    ]
    found = {}
    for name in logs:
        outcomes = [taken[name] for taken in rounds]
        if None in outcomes:
            raise RuntimeError(f"insdvl-replay cannot read the log '{name}'")
        found[name] = {key: median(one[key] for one in outcomes if one) for key in ("s", "mb")}
    return found


def report(messages: int, writers: dict[str, Callable[[Path, bytes], Path]]) -> str:
    """Measure everything and make a page of it."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        logs = {CDR: folder / "cdr.mcap"}
        write_dive(logs[CDR], dive(messages))
        log = logs[CDR].read_bytes()
        logs |= {kind: write(folder, log) for kind, write in writers.items()}
        write_dive(folder / "warm.mcap", dive(min(messages, 2000)))
        found = in_turn(logs)
        sizes = {kind: path.stat().st_size / 1e6 for kind, path in logs.items()}
    rows = [
        f"| {kind} | {sizes[kind]:.0f} | {one['s']:.2f} | {one['s'] / found[CDR]['s']:.2f} | {one['mb']:.0f} |"
        for kind, one in found.items()
    ]
    text = (
        f"{messages * PER_IMU:.0f} messages of an IMU at 400 Hz and a DVL at 4 Hz, read to clean columns. Medians "
        f"of {ROUNDS}, measured in turn, of wall-clock time. {machine()}; shared cores, warm cache: read the ratios. "
        f"{GOAL}"
    )
    return "\n".join(["# Encodings and containers", "", text, "", *table(COLUMNS, rows)]) + "\n"


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=2_000_000)
    parser.add_argument("--only", nargs="*", choices=WRITERS, default=list(WRITERS))
    arguments = parser.parse_args()
    page = report(arguments.messages, {kind: WRITERS[kind] for kind in arguments.only})
    sys.stdout.write(page)
    if arguments.only == list(WRITERS):
        write_part(page)


if __name__ == "__main__":
    main()
