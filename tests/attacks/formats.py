"""Files of instruments, damaged by the hundred, each replayed in a forked child with the log of what it lacks."""

import gc
import json
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import raw_harm
import zstandard
from instrument_logs import Told, told, write_rest, write_whole
from instrument_writers import FORMATS, Written, velocities_of_teledyne
from moos_logs import alog, whole
from victim import (
    DEFECTS,
    HARMLESS,
    Result,
    last_line,
    ready,
    result_of,
    run_forked,
    verdict,
    verdict_on_result,
)

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import UserError
from insdvl_replay.logs import read_dive

LINE_ENDS = re.compile(rb"[\r\n]+")
LINES = (
    b"",
    b"$",
    b"*",
    b"{",
    b"}",
    b",,,,",
    b"wrz,",
    b"$PNORBT7,",
    b"$DVEXT,T,",
    b":BI,",
    b'{"type":"velocity"',
    b"0" * 5000,
)
"""What may stand where a line should."""


ALOG_SETTINGS = """
[imu]
topic = "IMU"
specific_force = "IMU_ACC_X, IMU_ACC_Y, IMU_ACC_Z"
angular_rate = "IMU_GYRO_X, IMU_GYRO_Y, IMU_GYRO_Z"

[dvl]
topic = "DVL"
velocity = "DVL_VEL_X, DVL_VEL_Y, DVL_VEL_Z"
"""


def moos(dive: Told) -> bytes:
    """Write a log of MOOS."""
    return whole(alog(dive.dive)).encode()


def packed(dive: Told) -> bytes:
    """Write a log that is compressed as a whole."""
    with TemporaryDirectory() as folder:
        plain = write_whole(Path(folder), replace(dive.dive, reference=None)).read_bytes()
    return zstandard.ZstdCompressor(write_checksum=True).compress(plain)


KINDS = {
    **FORMATS,
    "alog": Written(
        "mission.alog", moos, velocities_of_teledyne, 1e-12, has_imu=True, is_protected=False
    ),
    "zstd": Written("dive.mcap.zstd", packed, Told.of_velocities, 1e-12, has_imu=True),
}
SETTINGS = {"alog": ALOG_SETTINGS}
"""What names the columns of a format, where its types do not."""


@dataclass(frozen=True)
class Clean:
    """A whole file of an instrument: what it gives with the log of what it lacks, and the memory that takes."""

    kind: str
    known: Written
    content: bytes
    rest: Path
    settings: Path
    result: Result
    columns: dict[str, Any]
    peak_mb: float


@dataclass(frozen=True)
class Outcome:
    """How one command on one mutant went."""

    seed: int
    kind: str
    harms: str
    command: str
    verdict: str
    said: str

    def line(self) -> str:
        """Say it in one line that can be searched and repeated."""
        last = last_line(self.said)
        what = f"--seed {self.seed} --count 1 --only {self.kind}: {self.harms}, {self.command}"
        return f"{self.verdict}: {what}: {last!r}"


def commands(
    path: Path,
    rest: Path,
    settings: Path,
    output: Path,
) -> dict[str, list[str]]:
    """Give the commands that are tried, by name."""
    dive = ["--one-dive", str(path), str(rest)]
    if settings.stat().st_size:
        dive += ["-c", str(settings)]
    run = ["run", *dive, "-o", str(output), "--starts", "1"]
    return {
        "run": run,
        "run --allow-damaged": [*run, "--allow-damaged"],
        "inspect": ["inspect", *dive],
    }


def prepared(only: str, folder: Path) -> list[Clean]:
    """Replay the whole file of each format, here once so that all is loaded, and in a child."""
    cleans = []
    for kind, known in KINDS.items():
        if only not in kind:
            continue
        place = folder / f"clean_{kind}"
        place.mkdir(parents=True)
        dive = known.said(told())
        content = known.write(dive if known.has_imu else told())
        (place / known.name).write_bytes(content)
        rest = write_rest(place, dive.dive, imu=not known.has_imu)
        settings = place / "vehicle.toml"
        settings.write_text(SETTINGS.get(kind, ""))
        tried = commands(place / known.name, rest, settings, place / "results")
        warm = commands(place / known.name, rest, settings, place / "warm")
        ready([warm["run"], warm["inspect"]])
        ended = run_forked(tried["run"], folder / "said")
        found = [path for path in (place / "results").iterdir() if path.is_dir()]
        result = result_of(found[0]) if found else None
        if result is None:
            raise SystemExit(f"{kind}: the clean file gives no result: {ended.said}")
        output = place / "columns"
        read(place / known.name, rest, settings, False, output)
        columns = json.loads(output.read_text())
        cleans.append(Clean(kind, known, content, rest, settings, result, columns, ended.peak_mb))
    gc.freeze()
    return cleans


# --- Damage.


def _lines(content: bytes, rng: Random) -> bytes:
    """Leave out, repeat, exchange or replace some lines."""
    lines = content.split(b"\n")
    for _ in range(rng.choice((1, 2, 30))):
        place = rng.randrange(len(lines))
        how = rng.randrange(5)
        if how == 0:
            del lines[place]
        elif how == 1:
            lines.insert(place, lines[rng.randrange(len(lines))])
        elif how == 2:
            lines[place] = rng.choice(LINES)
        elif how == 3:
            lines[place] = lines[place][: rng.randrange(len(lines[place]) + 1)]
        else:
            lines[place] += lines[rng.randrange(len(lines))]
        if not lines:
            return b"\n"
    return b"\n".join(lines)


def _ends(content: bytes, rng: Random) -> bytes:
    """Write other line ends."""
    return content.replace(b"\r\n", rng.choice((b"\n", b"\r", b" ", b"\n\n", b"\0")))


def _numbers(content: bytes, rng: Random) -> bytes:
    """Write another number over digits, as long or longer."""
    places = [place for place in range(len(content)) if 0x30 <= content[place] <= 0x39]
    for place in sorted(rng.choices(places or [0], k=rng.choice((1, 5, 200))), reverse=True):
        new = rng.choice((b"9", b"-", b"e999", b"9" * 400, b"nan", b"inf", b"", b"1e300", b","))
        content = content[:place] + new + content[place + 1 :]
    return content


HARMS = (
    *(_lines, _lines, _ends, _numbers),
    *(raw_harm.flip_bit, raw_harm.noise, raw_harm.zeros, raw_harm.ones, raw_harm.cut_end),
    *(raw_harm.cut_few, raw_harm.cut_start, raw_harm.zero_end, raw_harm.cut_out),
    *(raw_harm.insert_noise, raw_harm.repeat_span, raw_harm.swap_spans, raw_harm.append_noise),
)


def harmed(content: bytes, rng: Random) -> tuple[str, bytes]:
    """Damage a file once or several times; say how."""
    names = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        harm = rng.choice(HARMS)
        if len(content) > 16:
            content = harm(content, rng) or b"\0"
        names.append(harm.__name__)
    return " ".join(names), content


def attempts(seed: int, cleans: Sequence[Clean], folder: Path) -> Iterator[Outcome]:
    """Make one mutant of each format and read it; every tenth goes through the commands, too."""
    for clean in cleans:
        harms, content = harmed(clean.content, Random(f"{seed} {clean.kind}"))
        path = folder / clean.known.name
        path.write_bytes(content)
        whole_lines = set(clean.content.split(b"\r\n"))
        lines = LINE_ENDS.split(content)
        # Whole lines that are left out or repeated leave no trace, and so does a cut at the end of a line.
        same_content = not set(lines) <= whole_lines
        same_content &= not ("cut" in harms and {lines[0], lines[-1]} <= whole_lines)
        same_content &= "_numbers" not in harms and "_lines" not in harms
        for allow in (False, True):
            output = folder / "columns"
            reading = partial(read, path, clean.rest, clean.settings, allow, output)
            ended = run_forked(reading, folder / "said")
            judged = verdict(ended, clean.peak_mb)
            if judged == "ok" and not ended.code:
                judged = _judged(json.loads(output.read_text()), clean, same_content=same_content)
            output.unlink(missing_ok=True)
            yield Outcome(seed, clean.kind, harms, f"read {allow}", judged, ended.said)
        if seed % 10:
            continue
        for name, command in commands(
            path, clean.rest, clean.settings, folder / "results"
        ).items():
            ended = run_forked(command, folder / "said")
            judged = verdict(ended, clean.peak_mb)
            if judged == "ok" and name != "inspect":
                judged = verdict_on_result(
                    ended,
                    folder / "results",
                    clean.result,
                    protected=clean.known.is_protected,
                    same_content=same_content,
                )
            shutil.rmtree(folder / "results", ignore_errors=True)
            yield Outcome(seed, clean.kind, harms, name, judged, ended.said)


def read(
    path: Path,
    rest: Path,
    settings: Path,
    allow: bool,
    output: Path,
) -> int:
    """Read a file with the log of what it lacks, and write a digest of its columns, and its notes."""
    try:
        dive = read_dive([path, rest], load_config(file=settings), allow_damaged=allow)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 3
    digest = sha256()
    dvl = dive.dvl
    for values in (dvl.time_ns, dvl.beam_velocity_mps, dvl.velocity_d, *vars(dive.imu).values()):
        if values is not None:
            digest.update(values.tobytes())
    notes: dict[str, str] = {}
    for note in dive.notes:
        notes[note.code] = notes.get(note.code, "") + note.text
    output.write_text(json.dumps({"digest": digest.hexdigest(), "notes": notes}))
    return 0


def _judged(found: dict[str, Any], clean: Clean, *, same_content: bool) -> str:
    """Judge the columns of a mutant by those of the whole file."""
    if found["digest"] == clean.columns["digest"]:
        return "ok"
    if found["notes"].items() - clean.columns["notes"].items():
        return "differs, noted"
    if not same_content:
        return "differs, other content"
    return "differs unnoted" if clean.known.is_protected else "differs, unprotected"


class _Work:
    """What a worker holds: forked with it, never sent."""

    cleans: list[Clean]
    folder: Path


def _attempts_of(seeds: list[int]) -> list[Outcome]:
    folder = Path(mkdtemp(dir=_Work.folder))
    found: list[Outcome] = []
    for seed in seeds:
        found += attempts(seed, _Work.cleans, folder)
    shutil.rmtree(folder)
    return found


def campaign(seeds: range, only: str, jobs: int, folder: Path) -> Iterator[Outcome]:
    """Try all seeds; say each defect as it is found."""
    # Children end without the steps that remove what they have unpacked.
    tempfile.tempdir = str(folder)
    _Work.cleans = prepared(only, folder)
    _Work.folder = folder
    portions = [list(seeds[i : i + 5]) for i in range(0, len(seeds), 5)]
    with ProcessPoolExecutor(jobs, get_context("fork")) as pool:
        for outcomes in pool.map(_attempts_of, portions):
            for outcome in outcomes:
                if outcome.verdict in DEFECTS:
                    sys.stdout.write(outcome.line() + "\n")
                    sys.stdout.flush()
                yield outcome


def rows(outcomes: Sequence[Outcome]) -> tuple[tuple[str, ...], list[str]]:
    """Count outcomes by verdict and format: the columns of a table, and its rows."""
    kinds = sorted({outcome.kind for outcome in outcomes})
    counts = Counter((outcome.verdict, outcome.kind) for outcome in outcomes)
    tried = Counter(outcome.kind for outcome in outcomes)
    lines = [("runs", [tried[kind] for kind in kinds])]
    for name in (*DEFECTS, *HARMLESS):
        lines.append((name, [counts[name, kind] for kind in kinds]))
    told_rows = [f"| {name} | {' | '.join(map(str, numbers))} |" for name, numbers in lines]
    return ("", *kinds), told_rows
