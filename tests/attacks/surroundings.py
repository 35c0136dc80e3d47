"""Settings, folders, files and other runs around a dive that mean harm, each tried once on the command line."""

import json
import os
import resource
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.writer import CompressionType, Writer

LIMIT_S = 180.0
"""A command that takes longer hangs."""
CODE = "import os\nopen('imported', 'w').close()\nos._exit(0)\n"
OWN = "filters.own.aiding=['velocity', 'stranger:Filter']"
GATE = '[[gate]]\nname = "any"\ntable = "improvement"\nrow = "ba_z"\ncolumn = "improvement_pct"\nmin = -1e9\n'
Outcome = tuple[str, str, str]
"""What was done, the verdict, what was seen."""


def attack(folder: Path, clean: bytes) -> Iterator[Outcome]:
    """Try all; ``clean`` is a short dive."""
    for number, tried in enumerate(
        (_code, _solutions, _two_runs, _names, _writing, _cache, _slow), 1
    ):
        place = folder / f"{number}"
        place.mkdir()
        (place / "dive.mcap").write_bytes(clean)
        yield from tried(place)


def _ended(
    folder: Path, *arguments: str, limit: Callable[[], None] | None = None
) -> tuple[int, float, str]:
    """Run a command; its exit code, processor seconds and last line on stderr. -1 where it hangs."""
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{Path(__file__).parents[2]}"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "insdvl_replay", *arguments]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, timeout=LIMIT_S, check=False, preexec_fn=limit
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return -1, LIMIT_S, "hangs"
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = done.stderr.decode("utf-8", "replace").strip()
    return done.returncode, after.ru_utime - before.ru_utime, said.splitlines()[-1] if said else ""


def _judged(what: str, code: int, said: str, wanted: int, word: str = "") -> Outcome:
    ok = code == wanted and word in said
    return what, "ok" if ok else f"exit {code}", said


def _code(folder: Path) -> Iterator[Outcome]:
    (folder / "stranger.py").write_text(CODE)
    (folder / "gates.toml").write_text(GATE)
    check = ["check", "gates.toml", "dive.mcap", "--set", OWN]
    for command in (
        ["run", "dive.mcap", "--set", OWN],
        ["calibrate", "dive.mcap", "--set", OWN],
        check,
    ):
        code, _, said = _ended(folder, *command)
        yield _judged(f"1 code in settings, `{command[0]}`", code, said, 2, "--allow-code")
    for command in (["inspect", "--deep", "dive.mcap", "--set", OWN], ["config", "--set", OWN]):
        code, _, said = _ended(folder, *command)
        yield _judged(f"1 code in settings, `{command[0]}`", code, said, 0)
    yield "1 code was imported", "imported" if (folder / "imported").exists() else "ok", ""
    code, _, said = _ended(folder, *check, "--allow-code")
    yield _judged("1 `os._exit(0)` in a check", code, said, 3, "its process ended twice")


def _solutions(folder: Path) -> Iterator[Outcome]:
    (folder / "zero.tum").symlink_to("/dev/zero")
    os.mkfifo(folder / "pipe.tum")
    (folder / "late.tum").write_text("1e99999999 0 0 0 0 0 0 1\n")
    (folder / "nan.tum").write_text("nan nan nan nan nan nan nan nan\n")
    (folder / "nothing.tum").write_text("1000.0 nan nan nan nan nan nan nan\n")
    (folder / "secret.tum").write_text("root:secret\n")
    for name, wanted in (
        ("zero", 2),
        ("pipe", 2),
        ("late", 3),
        ("nan", 3),
        ("nothing", 3),
        ("secret", 3),
    ):
        code, _, said = _ended(
            folder, "run", "dive.mcap", "--set", f"filters.own.solution='{name}.tum'"
        )
        found = "quoted" if "root:secret" in said else ""
        yield _judged(
            f"2 solution, {name}", code, found or said, wanted, "" if not found else "never"
        )


def _two_runs(folder: Path) -> Iterator[Outcome]:
    command = [sys.executable, "-m", "insdvl_replay", "run", "dive.mcap", "--starts"]
    runs = [subprocess.Popen([*command, starts], cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
            for starts in ("1", "2")]  # fmt: skip
    said = [run.communicate(timeout=LIMIT_S)[1].decode() for run in runs]
    codes = [run.returncode for run in runs]
    kept = json.loads((folder / "replay" / "dive" / "report.json").read_text())["config"][
        "evaluation"
    ]["starts"]
    is_reported = sorted(codes) == [0, 2] and kept == 1 + codes.index(0)
    yield (
        "3 two runs at once",
        "ok" if is_reported else f"exits {codes}, {kept} kept",
        " ".join(said)[-200:],
    )


def _names(folder: Path) -> Iterator[Outcome]:
    shutil.copy(folder / "dive.mcap", os.fsencode(folder) + b"/bad\xff.mcap")
    code, _, said = _ended(folder, "run", ".", "-o", "out")
    done = (folder / "out" / "dive" / "report.json").is_file()
    yield _judged("4 a name that is not UTF-8", code if done else -2, said, 3, "not UTF-8")


def _full() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))


def _writing(folder: Path) -> Iterator[Outcome]:
    _ended(folder, "run", "dive.mcap", "--starts", "1")
    code, _, said = _ended(
        folder, "figure", "replay/dive", "error", "-o", "error.pdf", limit=_full
    )
    yield _judged("5 figure on a full disk", code, said, 2, "cannot be written")
    (folder / "gates.toml").write_text(GATE)
    (folder / "checked" / "dive").mkdir(parents=True)
    os.mkfifo(folder / "checked" / "dive" / "report.json")
    code, _, said = _ended(folder, "check", "gates.toml", "dive.mcap")
    yield _judged("5 report.json is a pipe", code, said, 2)
    shutil.copy(folder / "dive.mcap", folder / "other.mcap")
    (folder / "thesis").write_text("years of work")
    for name in ("index.html", "summary.csv", "answers.csv", "evidence.csv", "where.csv"):
        (folder / "replay" / name).symlink_to("../thesis")
        code, _, said = _ended(folder, "run", "dive.mcap", "other.mcap", "--force")
        (folder / "replay" / name).unlink()
        yield _judged(f"5 a link {name}", code, said, 2, "is not replaced")
    code, _, said = _ended(
        folder, "check", "gates.toml", "dive.mcap", "--output", "absent/deep/gates.xml"
    )
    made = (folder / "absent").exists()
    yield _judged("5 --output in no folder", -2 if made else code, said, 2, "does not exist")


def _cache(folder: Path) -> Iterator[Outcome]:
    (folder / "file").touch()
    done = subprocess.run(
        [sys.executable, "-m", "insdvl_replay", "run", "dive.mcap", "--starts", "1"],
        cwd=folder, env=os.environ | {"INSDVL_REPLAY_CACHE": str(folder / "file")}, capture_output=True, check=False,
    )  # fmt: skip
    said = done.stderr.decode()
    is_reported = done.returncode == 0 and "warning: compiled code cannot be stored" in said
    yield (
        "6 a cache that cannot be written",
        "ok" if is_reported else f"exit {done.returncode}",
        said[-200:],
    )


def _slow(folder: Path) -> Iterator[Outcome]:
    _, base_s, _ = _ended(folder, "inspect", "dive.mcap")
    for what, least_s, make in (
        ("channels", 20.0, _channels),
        ("wide JSON", 4.0, _wide),
        ("private", 4.0, _private),
    ):
        make(folder / "large.mcap")
        start_s = time.monotonic()
        code, took_s, said = _ended(folder, "inspect", "large.mcap", "--allow-damaged")
        seen = f"{took_s - base_s:.1f} s of the processor, {time.monotonic() - start_s:.1f} s"
        yield (
            f"7 {what}",
            "ok" if code == 0 and took_s - base_s < least_s else "slow",
            f"{seen} {said}",
        )


def _channels(path: Path) -> None:
    """Write 4000 channels of a message each."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        for number in range(4000):
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, number, b"\0\1\0\0" + struct.pack("<d", 1.0), number)
        writer.finish()


def _wide(path: Path) -> None:
    """Write ten messages of 363 kB, of 12000 structures each."""
    message = json.dumps(
        {f"field_{number:05}": {"value": number} for number in range(12_000)}
    ).encode()
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel(
            "/wide", "json", writer.register_schema("wide", "jsonschema", b"{}")
        )
        for number in range(10):
            writer.add_message(channel, number, message, number)
        writer.finish()


def _private(path: Path) -> None:
    """Write 80,000 records of somebody's own, between as many messages."""
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        channel = writer.register_channel("/t", "cdr", schema)
        for number in range(80_000):
            writer.add_message(channel, number, b"\0\1\0\0" + struct.pack("<d", 1.0), number)
            file.write(b"\xf0" + struct.pack("<Q", 1) + b"x")
