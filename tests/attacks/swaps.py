"""Logs that are replaced, truncated, overwritten, appended to or deleted while they are read.

A result may be of the one log or of the other, or there is none; what it says of its log must be so.
"""

import hashlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

from base_logs import ROOT
from living import PATIENCE_S, half_written, hidden, started
from victim import INTERNAL_ERROR

DIVES = ROOT / "examples" / "archive" / "dives"
ONE, OTHER = DIVES / "lost_beam.mcap", DIVES / "survey.mcap"


def replace(log: Path) -> None:
    """Rename another log into its place."""
    new = log.with_name("new")
    shutil.copy(OTHER, new)
    new.replace(log)


def overwrite(log: Path) -> None:
    """Copy another log over it."""
    shutil.copyfile(OTHER, log)


def truncate(log: Path) -> None:
    """Keep the first half."""
    os.truncate(log, log.stat().st_size // 2)


def append(log: Path) -> None:
    """Write some more, as a recorder does."""
    with log.open("ab") as stream:
        stream.write(OTHER.read_bytes()[8:5000])


def delete(log: Path) -> None:
    """Remove it."""
    log.unlink()


SWAPS: tuple[Callable[[Path], None], ...] = (replace, overwrite, truncate, append, delete)


def _result(folder: Path) -> tuple[str, dict[str, bytes]] | None:
    """Give the digest that a result names, and its tables."""
    report = folder / "report.json"
    if not report.is_file():
        return None
    named = json.loads(report.read_text("utf-8"))["log"]
    return named["sha256"], {path.name: path.read_bytes() for path in folder.glob("*.csv")}


def _clean(folder: Path, log: Path) -> tuple[float, dict[str, bytes]]:
    victim = folder / "victim.mcap"
    shutil.copyfile(log, victim)
    start_s = time.monotonic()
    started(
        ["run", str(victim), "-o", str(folder / "clean"), "--force", "--rerun"], folder / "said"
    ).wait(PATIENCE_S)
    taken_s, result = time.monotonic() - start_s, _result(folder / "clean" / "victim")
    if result is None:
        raise SystemExit(
            f"{log}: the clean log gives no result: {(folder / 'said').read_text('utf-8')}"
        )
    return taken_s, result[1]


def attack(folder: Path, seeds: range) -> Iterator[tuple[str, str, str]]:
    """Change logs under the program's hands.

    Yields
    ------
    str, str, str
        Which change, the verdict, and what was seen.
    """
    folder.mkdir(exist_ok=True)
    _clean(folder, ONE)  # once for the compiled code
    tables = {}
    for log in (OTHER, ONE):
        taken_s, tables[hashlib.sha256(log.read_bytes()).hexdigest()] = _clean(folder, log)
    for seed in seeds:
        rng = Random(seed)
        swap, delay_s = rng.choice(SWAPS), rng.uniform(0.2, 0.9) * taken_s
        judged, seen = _swapped(folder, swap, delay_s, tables)
        yield (
            swap.__name__,
            judged,
            f"--seed {seed} --count 1: {swap.__name__} after {delay_s:.2f} s: {seen}",
        )


def _swapped(
    folder: Path, swap: Callable[[Path], None], delay_s: float, tables: dict[str, dict[str, bytes]]
) -> tuple[str, str]:
    log, results = folder / "victim.mcap", folder / "results"
    shutil.rmtree(results, ignore_errors=True)
    shutil.copyfile(ONE, log)
    process = started(["run", str(log), "-o", str(results)], folder / "said")
    time.sleep(delay_s)
    swap(log)
    try:
        code = process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return "hang", "still there"
    said = (folder / "said").read_text("utf-8", "replace").rstrip().rpartition("\n")[2][:160]
    return _judged(code, said, results, tables), f"exit {code}: {said}"


def _judged(code: int, said: str, results: Path, tables: dict[str, dict[str, bytes]]) -> str:
    if code < 0:
        return "killed by signal"
    if code == INTERNAL_ERROR:
        return "exit 4"
    if code:
        left = results.exists() and (half_written(results) or hidden(results))
        return "leftovers" if left else "ok" if said.startswith("error: ") else "no sentence"
    result = _result(results / "victim")
    if result is None:
        return "half written"
    digest, found = result
    return "ok" if found == tables.get(digest) else "digest of another log"
