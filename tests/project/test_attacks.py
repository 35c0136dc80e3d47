"""A sample of damaged logs; `make attack` tries thousands, and bombs, names, kills and swaps beside them."""

import json
import signal
import subprocess
import sys
from functools import partial
from io import BytesIO
from pathlib import Path
from random import Random

import fixed_harm
import pytest
import raw_harm
import victim
from content import content_of, file_of
from mcap.reader import make_reader
from small_logs import small_log, true_messages

ATTACK = Path(__file__).parents[1] / "attacks" / "attack.py"
MUTANTS = 300


def attacked(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Attack in a process of its own, which forks."""
    return subprocess.run(
        [sys.executable, str(ATTACK), *arguments], capture_output=True, text=True
    )


def row(name: str, printed: str) -> list[int]:
    """Read the numbers of a row of the table."""
    line = next(line for line in printed.splitlines() if line.startswith(f"| {name} |"))
    return [int(cell) for cell in line.strip("| ").split("|")[1:]]


def titles(printed: str) -> list[str]:
    """Read the titles of the columns of the table."""
    line = next(line for line in printed.splitlines() if line.startswith("|  |"))
    return [cell.strip() for cell in line.strip("| ").split("|")]


@pytest.mark.nightly
def test_damaged_logs_end_in_a_sentence_or_in_tables_that_say_what_is_lost() -> None:
    found = attacked("mutate", "--short", "--seed", "1000", "--count", str(MUTANTS), "--jobs", "1")
    assert found.returncode == 0, found.stdout + found.stderr
    assert sum(row("mutants", found.stdout)) == MUTANTS
    assert all(number > 10 for number in row("runs", found.stdout))
    # The sample reaches tables, not only refusals.
    assert sum(row("differs, noted", found.stdout)) > 10


@pytest.mark.nightly
def test_damaged_files_of_instruments_end_in_a_sentence_or_in_notes() -> None:
    found = attacked("formats", "--seed", "1000", "--count", "20", "--jobs", "1")
    assert found.returncode == 0, found.stdout + found.stderr
    noted = dict(zip(titles(found.stdout), row("differs, noted", found.stdout), strict=True))
    # Of a log that is compressed as a whole, little more than what is before the damage can be read.
    assert noted.pop("zstd") > 0
    assert all(number > 10 for number in noted.values()), noted


def ended(code: int, said: str = "", peak_mb: float = 300.0) -> victim.Ended:
    return victim.Ended(code, peak_mb, said)


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        (ended(0), "ok"),
        (ended(3, "warning: a\nerror: dive: no IMU was found in it\n"), "ok"),
        (ended(3, "error: dive: no IMU in /a\nb was found\n"), "no sentence"),
        (ended(3), "no sentence"),
        (ended(4, "error: internal error: KeyError: 1\n"), "exit 4"),
        (ended(1, "Traceback (most recent call last):\nKeyError: 1\n"), "traceback"),
        (ended(-signal.SIGBUS), "killed by signal"),
        (ended(-signal.SIGALRM), "hang"),
        (ended(-signal.SIGXCPU), "hang"),
        (ended(3, "error: dive: no IMU was found in it\n", peak_mb=2000.0), "memory"),
    ],
)
def test_each_bad_end_has_its_name(how: victim.Ended, expected: str) -> None:
    assert victim.verdict(how, clean_mb=250.0) == expected


def result(folder: Path, table: str, notes: list[dict[str, str]]) -> None:
    """Write what counts of a result into a folder below."""
    (folder / "dive").mkdir(parents=True)
    for name in victim.DIVE_FILES:
        (folder / "dive" / name).write_text(table, "utf-8")
    (folder / "dive" / "report.json").write_text(json.dumps({"notes": notes}), "utf-8")


CLEAN = victim.Result(
    {f"{name}": b"1.0" for name in victim.DIVE_FILES if name.endswith(".csv")}, {}
)
NOTE = {"code": "damaged", "text": "a chunk is lost"}


@pytest.mark.parametrize(
    ("table", "notes", "same_content", "expected"),
    [
        ("1.0", [], True, "ok"),
        ("1.1", [NOTE], True, "differs, noted"),
        ("1.1", [], False, "differs, other content"),
        ("1.1", [], True, "differs unnoted"),
    ],
)
def test_tables_that_differ_need_a_note(
    table: str, notes: list[dict[str, str]], same_content: bool, expected: str, tmp_path: Path
) -> None:
    result(tmp_path, table, notes)
    judged = victim.verdict_on_result(
        ended(0), tmp_path, CLEAN, protected=True, same_content=same_content
    )
    assert judged == expected


def test_what_is_left_of_a_result_is_a_defect(tmp_path: Path) -> None:
    result(tmp_path, "1.0", [])
    judge = partial(
        victim.verdict_on_result, folder=tmp_path, clean=CLEAN, protected=True, same_content=True
    )
    assert judge(ended(3)) == "leftovers"
    (tmp_path / "dive" / "report.json").unlink()
    assert judge(ended(0)) == "leftovers"


@pytest.mark.parametrize("kind", ["zstd", "lz4", "uncompressed"])
def test_a_log_put_together_again_says_the_same(kind: str) -> None:
    """The official reader checks the checksums, lengths and offsets of what was written."""
    log = file_of(content_of(small_log(kind, extras=True)))
    found = make_reader(BytesIO(log), validate_crcs=True).iter_messages()
    assert {
        (channel.topic, message.log_time, message.data) for _, channel, message in found
    } == true_messages()
    reader = make_reader(BytesIO(log), validate_crcs=True)
    assert [one.name for one in reader.iter_attachments()] == ["notes.txt"]
    assert [one.name for one in reader.iter_metadata()] == ["vehicle"]


@pytest.mark.parametrize("harm", [*raw_harm.HARMS], ids=lambda harm: harm.__name__)
def test_bytes_are_damaged_the_same_way_again(harm: raw_harm.Harm) -> None:
    log = small_log("zstd")
    harmed = [harm(log, Random(seed)) for seed in range(5)]
    assert harmed == [harm(log, Random(seed)) for seed in range(5)]
    assert any(one != log for one in harmed)


@pytest.mark.parametrize("harm", [*fixed_harm.HARMS], ids=lambda harm: harm.__name__)
def test_content_is_changed_the_same_way_again(harm: fixed_harm.Harm) -> None:
    def harmed(seed: int) -> bytes:
        content = content_of(small_log("zstd", extras=True))
        harm(content, Random(seed))
        return file_of(content)

    found = [harmed(seed) for seed in range(5)]
    assert found == [harmed(seed) for seed in range(5)]
    assert any(one != file_of(content_of(small_log("zstd", extras=True))) for one in found)
