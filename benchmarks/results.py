"""The page of results: one part for each benchmark, each written anew by its own."""

import argparse
import fcntl
import multiprocessing
import os
import platform
import re
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

RESULTS = Path(__file__).with_name("RESULTS.md")


def machine() -> str:
    """Say on which machine, when and of which commit this is."""
    where = f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, numpy {version('numpy')}"
    commit = _git("rev-parse", "--short=8", "HEAD") or "not in git"
    changed = (
        ", changed since"
        if _git("status", "--porcelain", "--", "*.py", "../insdvl_replay")
        else ""
    )
    return f"{where}; {datetime.now(UTC):%Y-%m-%d}, {commit}{changed}"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(RESULTS.parent), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def table(columns: tuple[str, ...], rows: list[str]) -> list[str]:
    """Give the lines of a table of rows that are written already."""
    return [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|", *rows]


def judging_parser(description: str | None) -> argparse.ArgumentParser:
    """Return the parser of a benchmark that judges in several processes; each adds what it asks for itself."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--print", action="store_true", help="print only, and leave the page as it is"
    )
    return parser


def worker_processes(jobs: int) -> ProcessPoolExecutor:
    """Start processes of one thread each: their libraries would start one for each core."""
    for library in ("OPENBLAS", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    return ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"))


def finish(part: str, *, is_whole: bool, all_met: bool) -> NoReturn:
    """Print a part, keep it if nothing was left out, and end with 1 if a rate is not as asked."""
    if is_whole:
        write_part(part)
    sys.stdout.write(f"{part}\n")
    raise SystemExit(int(not all_met))


def write_part(part: str) -> None:
    """Put a part in the place of the older one with the same heading, or after all others.

    Parameters
    ----------
    part : str
        Begins with its heading, ``# Title``.
    """
    heading = part.partition("\n")[0]
    with RESULTS.open("a+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # two benchmarks may write at the same time
        file.seek(0)
        parts = re.split(r"^(?=# )", file.read(), flags=re.MULTILINE)
        kept = {older.partition("\n")[0]: older.strip() for older in parts if older.strip()}
        file.truncate(0)
        file.write("\n\n".join({**kept, heading: part.strip()}.values()) + "\n")
