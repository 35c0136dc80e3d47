"""The net: what each command says of twelve dives, held to nine digits.

Usage: python tests/net/net.py --renew [CASE...], which stores anew what the commands say; git shows what has moved.
"""

import contextlib
import csv
import io
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from insdvl_replay.core.processor import use_common_code

# As the commands do it, so that the numbers that are stored are not those of one processor.
use_common_code()

import numpy as np  # noqa: E402
from rosbags.convert import convert  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

PROJECT: Final = Path(__file__).resolve().parents[2]
SHARED: Final = PROJECT.parent / "shared" / "data"
STORED: Final = Path(__file__).parent / "stored"
SAME: Final = 2e-9
"""Share of a number in which it may differ: nine digits, of the ten that are stored."""
LEAST: Final = 1e-9
LEAST_OF: Final = {"observability": 1e-8}
"""In the unit of a number: differences of numbers that are nearly the same, and singular vectors that hardly anything
determines, have fewer digits than that on which two processors agree."""
NUMBER: Final = re.compile(r"(-?\d+\.?\d*(?:e[-+]?\d+)?)")
TIMES: Final = 60
"""Every so many seconds of the trajectory are held."""
PASSED_OVER: Final = re.compile(r"^(tool\.|versions\.|files\.|log\.sha256|arguments\.jobs)")
"""Keys that differ between versions, machines and hours."""

Lines = list[str]
"""What is held, cell by cell: a key, and its values with tabs between them."""


# --- The dives.


def _bag(folder: Path) -> Path:
    """Write the recorded .bag as a .db3, as rosbags does."""
    made = folder / "rexrov2"
    convert(
        [SHARED / "ros1" / "rexrov2_simulated.bag"], made, "sqlite3", 9, None, "file",
        get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE), [], [], [], [],
    )  # fmt: skip
    return made / "rexrov2.db3"


def _cut(folder: Path) -> Path:
    """Break a log off in the middle of a chunk, as a recorder does that loses its power."""
    data, path = (PROJECT / "sample_logs" / "figure_eight.mcap").read_bytes(), folder / "cut.mcap"
    path.write_bytes(data[: len(data) * 6 // 10])
    return path


def _lies(path: Path) -> Callable[[Path], Path]:
    return lambda _folder: path


_ARCHIVE: Final = PROJECT / "examples" / "archive" / "dives"
_ROS_1: Final = ("-c", str(Path(__file__).parent / "rexrov2.toml"))
DIVES: Final[dict[str, tuple[Callable[[Path], Path], tuple[str, ...]]]] = {
    "straight": (_lies(PROJECT / "sample_logs" / "straight.mcap"), ()),
    "figure_eight": (_lies(PROJECT / "sample_logs" / "figure_eight.mcap"), ()),
    **{
        name: (_lies(_ARCHIVE / f"{name}.mcap"), ())
        for name in ("lost_beam", "outage", "survey", "transit")
    },
    "snapir_01": (
        _lies(SHARED / "snapir" / "snapir_01.mcap"),
        ("-c", str(PROJECT / "examples" / "snapir.toml"), "--preset", "fog", "--end", "300"),
    ),
    "auto_square": (
        _lies(SHARED / "blueye_x3" / "auto_square.mcap"),
        ("-c", str(PROJECT / "examples" / "blueye_x3.toml"), "--end", "200"),
    ),
    "run_1": (
        _lies(SHARED / "ufmil" / "run_1.mcap"),
        ("-c", str(PROJECT / "examples" / "ufmil.toml")),
    ),
    "rexrov2_bag": (_lies(SHARED / "ros1" / "rexrov2_simulated.bag"), _ROS_1),
    "rexrov2_db3": (_bag, _ROS_1),
    "cut": (_cut, ("--allow-damaged",)),
}
"""By name, what makes or finds each, and with which options it is read."""


RECORDED: Final = ("snapir_01", "auto_square", "run_1", "rexrov2_bag", "rexrov2_db3", "propose")
"""Cases on logs that are no part of the project, and may lie beside it."""


# --- What is held of each command.


def _said(*arguments: object, code: int = 0) -> tuple[str, str]:
    """Run the command line in this process, and return what it writes to stdout and stderr."""
    from insdvl_replay.cli import run_command_line

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        found = run_command_line([str(argument) for argument in arguments])
    if found != code:
        raise AssertionError(
            f"{' '.join(map(str, arguments))}: exit code {found}, {code} is held\n{err.getvalue()}"
        )
    return out.getvalue(), err.getvalue()


def _screen(said: tuple[str, str], folder: Path) -> Lines:
    """Return what stands on the screen, without the places of this machine."""
    text = "\n".join(said)
    for place, name in ((folder, "OUT"), (PROJECT, "PROJECT"), (SHARED, "SHARED")):
        text = text.replace(str(place), name)
    return [f"screen\t{line.rstrip()}" for line in text.splitlines() if line.strip()]


def _flat(value: Any, key: str = "") -> Iterator[str]:
    """Lay nested data out in lines: a table under the names of its columns, all else by dotted keys."""
    if PASSED_OVER.match(key):
        return
    if isinstance(value, dict):
        for name, one in value.items():
            yield from _flat(one, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
        columns = list(dict.fromkeys(name for one in value for name in one))
        yield "\t".join([f"{key}[]", *columns])
        for one in value:
            yield "\t".join([key, *(_cell(one.get(name)) for name in columns)])
    else:
        yield "\t".join([key, *(map(_cell, value) if isinstance(value, list) else [_cell(value)])])


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "nan" if math.isnan(value) else f"{value:.10g}" if value % 1.0 else f"{value:.1f}"
    if isinstance(value, str):
        return value.replace("\t", " ").replace("\n", " / ")
    return f"[{', '.join(map(_cell, value))}]" if isinstance(value, list) else json.dumps(value)


def _json(text: str, folder: Path, prefix: str = "") -> Lines:
    lines = _flat(json.loads(text), prefix)
    return [line.replace(str(folder), "OUT").replace(str(PROJECT), "PROJECT").replace(str(SHARED), "SHARED")
            for line in lines]  # fmt: skip


def _trajectory(path: Path) -> Lines:
    with np.load(path) as stored:
        names, columns, values = (
            stored["names"].tolist(),
            stored["columns"].tolist(),
            stored["values"],
        )
    rows = [
        {
            "filter": name,
            "second": second,
            **dict(zip(columns, values[i, second].tolist(), strict=True)),
        }
        for i, name in enumerate(names)
        for second in range(0, values.shape[1], TIMES)
    ]
    return list(_flat(rows, "trajectory"))


def _require_same_tables(folder: Path) -> None:
    """Raise if a CSV file says another thing than the report."""
    tables = json.loads((folder / "report.json").read_text("utf-8"))["tables"]
    for path in sorted(folder.glob("*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        told = [
            {name: "" if one is None else str(one) for name, one in row.items()}
            for row in tables[path.stem]
        ]
        if rows != told:
            raise AssertionError(f"{path.name} and report.json differ")


def _replayed(
    name: str, folder: Path, *options: str, into: str = "out"
) -> tuple[Path, tuple[str, str]]:
    make, given = DIVES[name]
    log = make(folder)
    said = _said("run", log, *given, *options, "--starts", 1, "-o", folder / into)
    return folder / into / log.stem, said


def _of_dive(name: str, folder: Path) -> Lines:
    """Hold a dive's inventory, its replay and its screens."""
    make, given = DIVES[name]
    settings = [word for word in given if not re.fullmatch(r"--end|\d+", word)]
    found, said = _replayed(name, folder)
    _require_same_tables(found)
    return [
        *_json(
            _said("inspect", make(folder / "again"), *settings, "--format", "json")[0],
            folder,
            "inspect",
        ),
        *_json((found / "report.json").read_text("utf-8"), folder),
        *_trajectory(found / "trajectory.npz"),
        *_screen(said, folder),
    ]


def _compare(folder: Path) -> Lines:
    """Hold a comparison of two dives with the same dives under other settings."""
    for name in ("straight", "outage"):
        _replayed(name, folder, "--end", "200", into="old")
        _replayed(
            name,
            folder,
            "--end",
            "200",
            "--set",
            "filters.aided.acceleration.window=5",
            into="new",
        )
    command = ("compare", folder / "old", folder / "new")
    return [
        *_json(_said(*command, "--format", "json")[0], folder),
        *_screen(_said(*command), folder),
    ]


def _check(folder: Path) -> Lines:
    """Hold the archive's gates, which hang on 16 starts in the pooled evidence alone."""
    gates = PROJECT / "examples" / "archive" / "gates.toml"
    said = _said("check", gates, "--results", folder / "checked", "--skip", "no dive speaks*")
    again = _said(
        "check",
        gates,
        "--results",
        folder / "checked",
        "--skip",
        "no dive speaks*",
        "--format",
        "json",
    )
    return [*_json(again[0], folder), *_screen(said, folder)]


def _calibrate(folder: Path) -> Lines:
    """Hold how the DVL of a dive is built in."""
    command = (
        "calibrate",
        PROJECT / "sample_logs" / "figure_eight.mcap",
        "-o",
        folder / "found.toml",
    )
    said = _said(*command, "--format", "json")
    settings = [
        f"toml\t{line}" for line in (folder / "found.toml").read_text("utf-8").splitlines()
    ]
    return [*_json(said[0], folder), *settings]


def _propose(folder: Path) -> Lines:
    """Hold the settings that are proposed for a log of which nothing is known."""
    log, place = SHARED / "ros1" / "rexrov2_simulated.bag", ("--set", "initial.latitude_deg=38.0")
    said = _said("inspect", log, *place, "--propose", folder / "found.toml")
    settings = [
        f"toml\t{line}" for line in (folder / "found.toml").read_text("utf-8").splitlines()
    ]
    return [*settings, *_screen(said, folder)]


def _study(*arguments: object) -> Callable[[Path], Lines]:
    def of_folder(folder: Path) -> Lines:
        said = _said("study", *arguments, "--format", "json", "-o", folder / "study")
        return _json(said[0], folder)

    return of_folder


CASES: Final[dict[str, Callable[[Path], Lines]]] = {
    **{name: (lambda folder, name=name: _of_dive(name, folder)) for name in DIVES},  # type: ignore[misc]
    "compare": _compare,
    "check": _check,
    "calibrate": _calibrate,
    "propose": _propose,
    "montecarlo": _study(
        "montecarlo", "figure-eight", "--runs", 3, "--duration", 120, "--jobs", 1
    ),
    "window": _study("window", PROJECT / "sample_logs" / "figure_eight.mcap", "--jobs", 1),
    "observability": _study(
        "observability", PROJECT / "sample_logs" / "figure_eight.mcap", "--end", 60
    ),
}


def lines_of(case: str) -> Lines:
    """Run a case, in a folder that is gone afterwards."""
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        (folder / "again").mkdir()
        return CASES[case](folder)


# --- What is stored.


def stored_lines(case: str) -> Lines:
    """Return what a case was when it was stored."""
    return (STORED / f"{case}.tsv").read_text("utf-8").splitlines()


def moved(was: Lines, now: Lines, least: float = LEAST) -> Lines:
    """State each line that is not as it was: words and counts exactly, numbers in nine digits, or by less than that."""
    found = [
        f"was {old!r}\nnow {new!r}"
        for old, new in zip(was, now, strict=False)
        if not _alike(old, new, least)
    ]
    return found + ([f"{len(was)} lines were, {len(now)} are"] if len(was) != len(now) else [])


def _alike(old: str, new: str, least: float) -> bool:
    """Compare the text between the numbers, and the numbers one by one."""
    olds, news = NUMBER.split(old), NUMBER.split(new)
    return len(olds) == len(news) and all(
        one == other or _near(one, other, least) for one, other in zip(olds, news, strict=True)
    )


def _near(old: str, new: str, least: float) -> bool:
    """Tell whether both are numbers, one of them not whole, that differ by rounding alone."""
    if not (NUMBER.fullmatch(old) and NUMBER.fullmatch(new) and re.search(r"[.e]", old + new)):
        return False
    return math.isclose(float(old), float(new), rel_tol=SAME, abs_tol=least)


def renew(cases: list[str]) -> None:
    """Store what the commands say now."""
    STORED.mkdir(exist_ok=True)
    for case in cases or CASES:
        if case in RECORDED and not SHARED.is_dir():
            print(f"{case}: its log is not here, and what is stored stays")  # noqa: T201
            continue
        began = time.process_time()
        (STORED / f"{case}.tsv").write_text("\n".join(lines_of(case)) + "\n", "utf-8")
        print(f"{case}: stored, {time.process_time() - began:.1f} s")  # noqa: T201


if __name__ == "__main__":
    sys.path.insert(0, str(PROJECT))
    if sys.argv[1:2] != ["--renew"]:
        sys.exit(__doc__)
    os.environ["COLUMNS"] = "10000"  # as in conftest.py
    renew(sys.argv[2:])
