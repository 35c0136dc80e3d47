"""Damaged logs by the thousand, each replayed in a forked child, and how often it went how."""

import gc
import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import bag_harm
import fixed_harm
import raw_harm
from base_logs import Base
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

CLEAN = ("run", "inspect --deep")
"""What is tried on clean logs; `--allow-damaged` changes nothing there."""
COLUMNS = ("", "raw", "raw, no checksums", "fixed", "fixed, no checksums")
HARMED = {"raw": raw_harm.harmed, "fixed": fixed_harm.harmed}


@dataclass(frozen=True)
class Clean:
    """What the whole log gives: its tables, and the most memory that each command takes."""

    base: Base
    result: Result
    peak_mb: float


@dataclass(frozen=True)
class Outcome:
    """How one command on one mutant went."""

    seed: int
    kind: str
    protected: bool
    base: str
    harms: str
    command: str
    verdict: str
    said: str

    def line(self) -> str:
        """Say it in one line that can be searched and repeated."""
        last = last_line(self.said)
        what = f"{self.base}, {self.kind} {self.harms}, {self.command}"
        return f"{self.verdict}: --seed {self.seed} --count 1: {what}: {last!r}"


def commands(log: Path, base: Base, output: Path) -> dict[str, list[str]]:
    """Give the commands that are tried, by name."""
    run = ["run", str(log), "-o", str(output), *base.settings]
    inspect = ["inspect", str(log), "--deep", *base.settings]
    return {
        "run": run,
        "run --allow-damaged": [*run, "--allow-damaged"],
        "inspect --deep": inspect,
    }


def prepared(bases: list[Base], folder: Path) -> list[Clean]:
    """Replay the clean logs, here once so that all is loaded, and in children to see what they take."""
    cleans = []
    for number, base in enumerate(bases):
        log, output = _log(folder / f"clean_{number}"), folder / f"clean_{number}" / "results"
        shutil.copy(base.path, log)
        ready(
            [
                command
                for name, command in commands(log, base, folder / f"warm_{number}").items()
                if name in CLEAN
            ]
        )
        tried = commands(log, base, output)
        ended = [run_forked(tried[name], folder / "said") for name in CLEAN]
        result = result_of(output / log.stem)
        if result is None:
            raise SystemExit(f"{base.path}: the clean log gives no result: {ended[0].said}")
        cleans.append(Clean(base, result, max(one.peak_mb for one in ended)))
    gc.freeze()  # so that children, looking for garbage, do not copy all that is there
    return cleans


def _log(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder / "log.mcap"


def mutant(seed: int, cleans: list[Clean]) -> tuple[Clean, str, str, bytes]:
    """Give the mutant of a seed: of which log, of which kind, what was done, and its bytes."""
    rng = Random(seed)
    clean = rng.choices(cleans, [one.base.weight for one in cleans])[0]
    kind = "raw" if rng.random() < 0.6 else "fixed"
    data = clean.base.path.read_bytes()
    harms, data = (
        bag_harm.harmed(data, rng, kind) if bag_harm.harms_of(data) else HARMED[kind](data, rng)
    )
    return clean, kind, harms, data


def attempts(seed: int, cleans: list[Clean], folder: Path) -> Iterator[Outcome]:
    """Make one mutant and try the commands on it; every third also sees `inspect --deep`."""
    clean, kind, harms, data = mutant(seed, cleans)
    log, output = _log(folder), folder / "results"
    log.write_bytes(data)
    for name, command in commands(log, clean.base, output).items():
        if name == "inspect --deep" and seed % 3:
            continue
        ended = run_forked(command, folder / "said")
        judged = _judged(ended, name, clean, output, kind)
        if judged == "ok" and {path.name for path in folder.iterdir()} - {
            "log.mcap",
            "said",
            "results",
        }:
            judged = "leftovers"
        shutil.rmtree(output, ignore_errors=True)
        protected, base = clean.base.protected, clean.base.path.name
        yield Outcome(seed, kind, protected, base, harms, name, judged, ended.said)


def _judged(ended: Ended, name: str, clean: Clean, output: Path, kind: str) -> str:
    judged = verdict(ended, clean.peak_mb)
    if judged != "ok" or name.startswith("inspect"):
        return judged
    protected = clean.base.protected
    return verdict_on_result(
        ended, output, clean.result, protected=protected, same_content=kind == "raw"
    )


class _Work:
    """What a worker holds: forked with it, never sent."""

    cleans: list[Clean]
    folder: Path


def _attempts_of(seeds: list[int]) -> list[Outcome]:
    folder = Path(mkdtemp(dir=_Work.folder))
    found = [outcome for seed in seeds for outcome in attempts(seed, _Work.cleans, folder)]
    shutil.rmtree(folder)
    return found


def campaign(
    bases: list[Base], seeds: range, jobs: int, folder: Path, keep: Path | None
) -> list[Outcome]:
    """Try all seeds; say each defect as it is found, and keep its mutant if there is a place for it."""
    _Work.cleans, _Work.folder = prepared(bases, folder), folder
    found: list[Outcome] = []
    start_s, portions = (
        time.monotonic(),
        [list(seeds[i : i + 10]) for i in range(0, len(seeds), 10)],
    )
    with ProcessPoolExecutor(jobs, get_context("fork")) as pool:
        for number, outcomes in enumerate(pool.map(_attempts_of, portions)):
            found += outcomes
            for outcome in outcomes:
                if outcome.verdict in DEFECTS:
                    sys.stdout.write(outcome.line() + "\n")
                    sys.stdout.flush()
                    _kept(outcome, keep)
            if number % 20 == 19:
                spent_s = time.monotonic() - start_s
                sys.stderr.write(
                    f"{10 * number + 10} of {len(seeds)} mutants in {spent_s:.0f} s\n"
                )
    return found


def _kept(outcome: Outcome, keep: Path | None) -> None:
    if keep:
        keep.mkdir(parents=True, exist_ok=True)
        (keep / f"{outcome.seed}.mcap").write_bytes(mutant(outcome.seed, _Work.cleans)[3])


def rows(outcomes: list[Outcome]) -> list[str]:
    """Count outcomes by verdict, kind and whether checksums stand over the messages."""
    columns = [(kind, protected) for kind in HARMED for protected in (True, False)]
    counts = Counter((outcome.verdict, outcome.kind, outcome.protected) for outcome in outcomes)
    mutants = {(outcome.kind, outcome.protected, outcome.seed) for outcome in outcomes}
    tried = Counter((kind, protected) for kind, protected, _ in mutants)
    runs = Counter((outcome.kind, outcome.protected) for outcome in outcomes)
    lines = [
        ("mutants", [tried[column] for column in columns]),
        ("runs", [runs[column] for column in columns]),
    ]
    lines += [
        (name, [counts[name, *column] for column in columns]) for name in (*DEFECTS, *HARMLESS)
    ]
    return [f"| {name} | {' | '.join(map(str, numbers))} |" for name, numbers in lines]
