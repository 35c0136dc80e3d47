"""Other processors: simulated logs are the same bytes, tables the same numbers.

Libraries choose code by the processor, and what they compute differs in the last bit. Four processors are emulated.
On those with AVX2 the program makes the choice, and every byte is the same.
"""

import csv
import hashlib
import json
import math
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from processor_work import motion_digest
from processors import PROCESSORS, Processor

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.processor import has_common_code

pytestmark = pytest.mark.nightly

PROJECT = Path(__file__).parents[2]
FOLDERS = (PROJECT / "sample_logs", PROJECT / "examples" / "archive" / "dives")
LOGS = [path for folder in FOLDERS for path in sorted(folder.glob("*.mcap"))]
SIMULATE = [
    shlex.split(line)[1:]
    for script in (
        PROJECT / "sample_logs" / "make.sh",
        PROJECT / "examples" / "archive" / "make.sh",
    )
    for line in script.read_text("utf-8").splitlines()
    if line.startswith('"$program" simulate')
]
SAME = 1e-9
"""Share of a number in which it may differ: nine significant digits."""
SAME_FITTED = 1e-6
"""The same for the control, whose fitted noise can be next to nothing, and its covariance next to singular."""


@pytest.fixture(params=PROCESSORS)
def processor(request: pytest.FixtureRequest) -> Processor:
    return PROCESSORS[request.param]


def test_the_exact_motion_is_the_same_to_the_last_bit(processor: Processor) -> None:
    assert processor.run() == motion_digest()


def digests() -> dict[str, str]:
    lines = [
        line
        for folder in FOLDERS
        for line in (folder / "SHA256SUMS").read_text("utf-8").splitlines()
    ]
    return {name: digest for digest, name in (line.split() for line in lines)}


def test_every_simulated_dive_is_the_same_bytes(processor: Processor, tmp_path: Path) -> None:
    processor.run(
        *([*arguments, str(tmp_path / Path(place).name)] for *arguments, place in SIMULATE)
    )
    made = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in tmp_path.iterdir()
    }
    assert len(made) == len(LOGS) == 6
    assert made == digests()


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of all dives on this processor."""
    folder = tmp_path_factory.mktemp("here")
    assert run_command_line(replay_into(folder)) == 0
    return folder


def replay_into(folder: Path) -> list[str]:
    return ["run", *map(str, LOGS), "--control", "-o", str(folder)]


def cells(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Every cell of every table: its place, its filter, and its text."""
    for path in sorted(folder.rglob("*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            for number, row in enumerate(csv.DictReader(file), start=2):
                for column, text in row.items():
                    yield (
                        f"{path.relative_to(folder)}:{number} {column}",
                        row.get("filter", ""),
                        text,
                    )


def agree(one: str, other: str, share: float, column: str = "sd") -> bool:
    """Whether two cells hold the same: words and counts exactly, numbers but for a share of them.

    A percentage is the difference of two numbers, and may be next to nothing: that share of 1 % is let pass.
    """
    if one == other:
        return True
    if "." not in one + other:
        return False
    try:
        return math.isclose(
            float(one),
            float(other),
            rel_tol=share,
            abs_tol=share if column.endswith("_pct") else 0.0,
        )
    except ValueError:
        return False


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("1.0000000001", "1.0", True),
        ("1.00000001", "1.0", False),
        ("300", "301", False),
        ("white", "coloured", False),
        ("", "0.0", False),
        ("nan", "0.1", False),
    ],
)
def test_cells_agree_in_nine_digits_and_words_and_counts_exactly(
    one: str, other: str, same: bool
) -> None:
    assert agree(one, other, SAME) == same


@pytest.mark.all_starts
def test_tables_agree_in_nine_digits(processor: Processor, here: Path, tmp_path: Path) -> None:
    processor.run(replay_into(tmp_path))
    ours, theirs = list(cells(here)), list(cells(tmp_path))
    assert [place for place, _, _ in ours] == [place for place, _, _ in theirs]
    assert len(ours) > 5000
    assert [
        (place, one, other)
        for (place, filter_, one), (_, _, other) in zip(ours, theirs, strict=True)
        if not agree(one, other, SAME_FITTED if filter_ == "tuned" else SAME, place)
    ] == []


def files_without_tool(folder: Path) -> dict[str, bytes | dict[str, object]]:
    """Every file of results; of reports all but the block that says when, where and how fast they were made."""
    files: dict[str, bytes | dict[str, object]] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name == "report.json":
            report = json.loads(path.read_text("utf-8"))
            del report["tool"]
            files[name] = report
        elif path.is_file():
            files[name] = path.read_bytes()
    return files


@pytest.fixture(scope="module")
def by_choice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of all dives on this processor, with the machine code that the program chooses."""
    if not has_common_code():
        pytest.skip("this processor has no AVX2")
    folder = tmp_path_factory.mktemp("by_choice")
    command = [sys.executable, "-m", "insdvl_replay", *replay_into(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


@pytest.mark.parametrize("name", ["AVX2", "AVX2 of AMD"])
def test_every_byte_is_the_same_on_processors_with_avx2(
    name: str, by_choice: Path, tmp_path: Path
) -> None:
    """This one by the choice of the program, whatever it has, and others by that of the libraries."""
    PROCESSORS[name].run(replay_into(tmp_path))
    ours = files_without_tool(by_choice)
    theirs = files_without_tool(tmp_path)
    assert ours.keys() == theirs.keys()
    assert [name for name, content in ours.items() if content != theirs[name]] == []
