"""`inspect --format`: each format says what the JSON says, and no line of a table is broken."""

import csv
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

BLOCKS = ("topics", "roles", "clocks", "notes", "blockers")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "dive|1.mcap"
    write_dive(path, simulate_dive("straight", duration_s=20.0, seed=1))
    return path


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert run_command_line(["inspect", *arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def blocks(text: str) -> dict[str, list[dict[str, str]]]:
    """Read the tables of a CSV by their names."""
    tables: dict[str, list[dict[str, str]]] = {}
    for block in text.split("\n\n"):
        rows = list(csv.DictReader(block.splitlines()))
        tables.setdefault(rows[0]["table"], []).extend(rows)
    return tables


@pytest.mark.parametrize("settings", [[], ["--deep", "--set", "imu.topic=/nowhere"], ["--deep"]])
def test_csv_holds_what_the_json_holds(
    log: Path, settings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    found: dict[str, Any] = json.loads(printed(capsys, str(log), *settings, "--format", "json"))
    tables = blocks(printed(capsys, str(log), *settings, "--format", "csv"))
    assert {name: len(rows) for name, rows in tables.items() if name in BLOCKS} == {
        name: len(found[name]) for name in BLOCKS if found[name]
    }
    for row, topic in zip(tables["topics"], found["topics"], strict=True):
        assert (row["topic"], int(row["messages"])) == (topic["topic"], topic["messages"])
        assert float(row["rate_hz"]) == topic["rate_hz"]
    assert int(tables["file"][0]["size_bytes"]) == found["log"]["size_bytes"]
    assert ("pings" in tables) == (found["pings"] is not None)


def test_csv_of_two_logs_names_each(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(log.read_bytes())
    tables = blocks(printed(capsys, str(log), str(other), "--format", "csv"))
    assert [row["log"] for row in tables["file"]] == [log.name, other.name]


def test_markdown_has_a_row_on_one_line_for_each_topic(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = json.loads(printed(capsys, str(log), "--format", "json"))
    text = printed(capsys, str(log), "--format", "md")
    (table,) = re.findall(r"\*\*Topics.*?\*\*\n\n((?:\|.*\n)+)", text)
    header, _, *rows = table.splitlines()
    assert header.startswith("| topic type, encoding | role | messages |")
    for row, topic in zip(rows, found["topics"], strict=True):
        assert row.startswith(f"| {topic['topic']}<br>")
        assert f"| {topic['messages']} |" in row
    assert "--deep" in text.split("\n\n")[1]


def test_markdown_gives_the_settings_to_start_from_as_a_block(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["--set", "imu.topic=/nowhere"]
    found = json.loads(printed(capsys, str(log), *settings, "--format", "json"))
    text = printed(capsys, str(log), *settings, "--format", "md")
    assert re.findall(r"```toml\n(.*?)```", text, re.DOTALL) == [found["configuration"]]


def test_latex_has_as_many_cells_in_every_row_as_columns(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(capsys, str(log), "--format", "latex")
    column = r"(?:[lr]|p\{25mm\}|S\[.+?\])"
    tables = re.findall(
        rf"\\begin\{{tabular\}}\{{({column}+)\}}\n(.*?)\\end\{{tabular\}}", text, re.DOTALL
    )
    assert len(tables) >= 3
    for alignment, body in tables:
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert {line.count(" & ") for line in rows} == {len(re.findall(column, alignment)) - 1}


def test_the_first_lines_say_whether_a_log_can_be_replayed_and_how(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, command, *_ = printed(capsys, str(log)).splitlines()
    assert first.startswith(f"{log.name} can be replayed by its first messages")
    assert command == f"insdvl-replay run {shlex.quote(str(log))}"
    deep = printed(
        capsys, str(log), "--deep", "--preset", "fog", "--set", "dvl.scale=1.01"
    ).splitlines()
    assert deep[:2] == [
        f"{log.name} can be replayed:",
        f"insdvl-replay run {shlex.quote(str(log))} --preset fog --set dvl.scale=1.01",
    ]


def test_the_first_lines_of_a_log_with_blockers_are_why_and_what_to_do(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = printed(capsys, str(log), "--set", "imu.topic=/nowhere").splitlines()
    assert re.fullmatch(
        rf"{re.escape(log.name)} cannot be replayed as it is \(\d blockers?\): .*/nowhere.*",
        nowhere[0],
    )
    assert nowhere[1].startswith(("insdvl-replay inspect ", "To do: "))


def test_a_page_starts_with_the_answer(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(capsys, str(log), "--format", "html")
    assert (
        text.index("can be replayed")
        < text.index("insdvl-replay run ")
        < text.index("the only topic of a known type")
    )
    shutil.copy(log, tmp_path / "other.mcap")
    assert (
        run_command_line(["inspect", str(log), str(tmp_path / "other.mcap"), "--format", "html"])
        == 2
    )
    assert capsys.readouterr().err.startswith("error: --format html: ")
