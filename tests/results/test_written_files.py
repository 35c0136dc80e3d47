"""Files and folders that are written: what they may replace, what they never do, and what a killed run leaves."""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.results.folder import (
    COMPLETE,
    DIVE_FILES,
    damaged_files,
    result_file,
    result_folder,
)

EXAMPLES = Path(__file__).parents[2] / "examples" / "archive"
TOOL = [sys.executable, "-m", "insdvl_replay"]
OURS = '{"tool": {"name": "insdvl-replay"}, "word": "%s"}'


def write(target: Path, text: str = "new", *, force: bool = False) -> None:
    with result_file(target, force=force) as path:
        path.write_text(text)


def write_half(target: Path) -> None:
    with result_file(target) as path:
        path.write_text("half")
        raise RuntimeError


# --- Where a file goes.


def test_a_named_pipe_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe, heard = tmp_path / "pipe", list[str]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    write(pipe)
    reader.join(timeout=10.0)
    assert heard == ["new"]
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_device_behind_a_link_is_written_to_and_stays(tmp_path: Path) -> None:
    link = tmp_path / "null"
    link.symlink_to("/dev/null")
    write(link)
    assert link.readlink() == Path("/dev/null")
    assert Path("/dev/null").is_char_device()
    assert list(tmp_path.iterdir()) == [link]


def test_a_link_to_a_file_stays_and_the_file_is_replaced_at_once(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    file, link = tmp_path / "store" / "gates.xml", tmp_path / "gates.xml"
    file.write_text("old")
    link.symlink_to(file)
    with pytest.raises(ConfigError, match=r"gates\.xml: exists"):
        write(link)
    with result_file(link, force=True) as path:
        path.write_text("new")
        assert file.read_text() == "old"
    assert link.readlink() == file
    assert file.read_text() == "new"
    assert sorted(tmp_path.rglob("*")) == sorted([link, file, file.parent])


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    ("leads", "named"),
    [("absent", "absent"), ("folder", "folder"), ("link", "does not exist")],
)
def test_a_link_that_leads_to_no_file_is_refused_in_words(
    leads: str, named: str, force: bool, tmp_path: Path
) -> None:
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link"
    link.symlink_to(leads)
    with pytest.raises(ConfigError) as refused:
        write(link, force=force)
    assert refused.value.message.startswith(f"{tmp_path}/link: ")
    assert named in refused.value.message
    assert refused.value.hint
    assert link.readlink() == Path(leads)


@pytest.mark.parametrize("name", ["a" * 5000, "a" * 5000 + "/dive"])
def test_a_name_that_no_folder_can_have_is_reported(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="File name too long"), result_folder(tmp_path / name):
        pass


def test_a_pipe_gets_nothing_of_what_failed(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(RuntimeError):
        write_half(pipe)
    assert list(tmp_path.iterdir()) == [pipe]


def test_check_leaves_what_is_no_file_where_it_is(tmp_path: Path) -> None:
    gates = tmp_path / "gates.toml"
    gates.write_text((EXAMPLES / "gates.toml").read_text())
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    null = tmp_path / "null"
    null.symlink_to("/dev/null")
    command = [
        "check",
        str(gates),
        "--results",
        str(tmp_path / "checked"),
        "--format",
        "junit",
        "--output",
    ]
    assert run_command_line([*command, str(null)]) in (0, 1)
    assert null.is_symlink()
    assert Path("/dev/null").is_char_device()


@pytest.mark.parametrize("option", ["--output", "--summary-file"])
@pytest.mark.parametrize("leads", ["absent/gates.xml", "link", "."])
def test_check_refuses_where_nothing_can_be_written_before_any_work(
    option: str, leads: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "link"
    link.symlink_to(leads)
    gates = EXAMPLES / "gates.toml"
    assert (
        run_command_line(
            ["check", str(gates), "--results", str(tmp_path / "checked"), option, str(link)]
        )
        == 2
    )
    assert capsys.readouterr().err.startswith(f"error: {option}: {link}: ")
    assert list(tmp_path.iterdir()) == [link]


# --- What may be replaced.


@pytest.mark.parametrize(
    "report",
    ["", "{", "[]", '{"tool": "x"}', '{"tool": {"name": "another-tool"}}', '{"results": [1, 2]}'],
)
def test_a_report_of_another_tool_makes_no_result(report: str, tmp_path: Path) -> None:
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / COMPLETE).write_text(report)
    with pytest.raises(ConfigError, match="thesis: "):
        written(thesis, "new")
    assert (thesis / COMPLETE).read_text() == report


@pytest.mark.parametrize("name", ["notes.txt", ".hidden", "improvement.csv", "filter_x.tum"])
def test_only_files_that_the_result_lists_are_removed(name: str, tmp_path: Path) -> None:
    target = tmp_path / "dive"
    written(target, "old")
    (target / name).write_text("mine")
    with pytest.raises(ConfigError) as refused:
        written(target, "new")
    sentence = f"{target}: is not replaced, because {name} is not a file of its result"
    assert refused.value.message == sentence
    assert (target / name).read_text() == "mine"
    assert '"old"' in (target / COMPLETE).read_text()
    (target / name).unlink()
    written(target, "new")
    assert '"new"' in (target / COMPLETE).read_text()


def written_while_others_write(target: Path) -> None:
    with result_folder(target, force=True) as folder:
        (folder / COMPLETE).write_text(OURS % "new")
        (target / "drawings").mkdir()
        (target / "thesis.tex").write_text("years of work")


def test_what_comes_while_a_result_is_made_is_not_removed(tmp_path: Path) -> None:
    target = tmp_path / "dive"
    written(target, "old")
    with pytest.raises(ConfigError, match=r"drawings .*1"):
        written_while_others_write(target)
    assert (target / "thesis.tex").read_text() == "years of work"


def test_a_result_of_an_early_version_is_replaced(tmp_path: Path) -> None:
    """Its report does not list its files, and one that was damaged says nothing at all."""
    target = tmp_path / "dive"
    for text in (OURS % "early", "", "{}"):
        target.mkdir(exist_ok=True)
        for name in DIVE_FILES:
            (target / name).write_text(text)
        written(target, "new")
        assert [path.name for path in target.iterdir()] == [COMPLETE]


@pytest.mark.parametrize("option", ["--output", "--summary-file"])
def test_no_folder_is_made_for_a_file(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "absent" / "gates.xml"
    assert run_command_line(["check", str(EXAMPLES / "gates.toml"), option, str(file)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {option}: {file}: ")
    assert said.endswith(f"; hint: mkdir -p {file.parent}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_is_a_named_pipe_is_not_waited_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "dive").mkdir()
    os.mkfifo(tmp_path / "dive" / COMPLETE)
    dive = next((EXAMPLES / "dives").glob("*.mcap"))
    command = ["check", str(EXAMPLES / "gates.toml"), str(dive), "--results", str(tmp_path)]
    (tmp_path / "dive").rename(tmp_path / dive.stem)
    assert run_command_line(command) == 2
    assert f"{tmp_path / dive.stem}: " in capsys.readouterr().err
    assert run_command_line(["compare", str(tmp_path), str(tmp_path)]) == 3
    assert "report.json: " in capsys.readouterr().err


# --- What is known to be whole.


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """A result of three files."""
    with result_folder(tmp_path / "dive") as folder:
        (folder / COMPLETE).write_text(
            '{"tool": {"name": "insdvl-replay", "started_at": "now"}, "rmse": 0.1}'
        )
        (folder / "improvement.csv").write_bytes(b"a,b\n1,2\n")
        (folder / "replay.mcap").write_bytes(bytes(range(256)) * 5000)
    return tmp_path / "dive"


def test_a_result_lists_the_digests_that_other_tools_find(result: Path) -> None:
    files = json.loads((result / COMPLETE).read_bytes())["files"]
    sums = "".join(f"{digest}  {name}\n" for name, digest in files.items() if name != COMPLETE)
    subprocess.run(
        ["sha256sum", "--check", "--strict"],
        cwd=result,
        input=sums,
        text=True,
        check=True,
        timeout=60,
    )
    assert sorted(files) == sorted(path.name for path in result.iterdir())
    assert damaged_files(result) == []


def test_the_time_of_day_does_not_count(result: Path) -> None:
    report = result / COMPLETE
    report.write_text(report.read_text().replace('"now"', '"later"'))
    assert damaged_files(result) == []


@pytest.mark.parametrize("data", [b"", b"a,b\n1,3\n", None])
def test_a_file_that_is_emptied_changed_or_gone_is_damaged(
    data: bytes | None, result: Path
) -> None:
    (result / "improvement.csv").unlink()
    if data is not None:
        (result / "improvement.csv").write_bytes(data)
    assert damaged_files(result) == ["improvement.csv"]


@pytest.mark.parametrize(
    ("old", "new"), [("0.1", "0.0"), ('"files"', '"flies"'), ('"replay.mcap"', '"replay2.mcap"')]
)
def test_a_report_that_is_changed_is_damaged(old: str, new: str, result: Path) -> None:
    report = result / COMPLETE
    text = report.read_text()
    assert old in text
    report.write_text(text.replace(old, new))
    assert COMPLETE in damaged_files(result)


# --- What killed runs leave.


def written(target: Path, word: str) -> None:
    with result_folder(target, force=True) as folder:
        (folder / COMPLETE).write_text(OURS % word)


def test_of_two_runs_at_once_a_whole_result_stays(tmp_path: Path) -> None:
    target = tmp_path / "dive"
    with result_folder(target, force=True) as first:
        (first / "half.csv").write_text("half")
        written(target, "of another run")
        assert (first / "half.csv").read_text() == "half"
        (first / "half.csv").unlink()
        (first / COMPLETE).write_text(OURS % "first")
    assert '"first"' in (target / COMPLETE).read_text()
    assert list(tmp_path.iterdir()) == [target]


def test_an_older_result_goes_back_where_a_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, renamed = tmp_path / "dive", Path.rename
    written(target, "old")

    def fails(path: Path, new: Path) -> Path:
        if path.name == "new":
            raise OSError(5, "Input/output error")
        return renamed(path, new)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(ConfigError, match="Input/output error"):
        written(target, "new")
    assert '"old"' in (target / COMPLETE).read_text()
    assert list(tmp_path.iterdir()) == [target]


def aged(folder: Path, hours: float) -> None:
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (0.0, time.time() - 3600.0 * hours))


def test_what_a_killed_run_left_is_removed_after_a_day_and_nothing_else(tmp_path: Path) -> None:
    names = {".insdvl-replay-killed", ".insdvl-replay-running", ".dive-backup", ".ssh"}
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "notes.txt").write_text("half")
        aged(tmp_path / name, 23.0 if name.endswith("running") else 25.0)
    written(tmp_path / "dive", "new")
    assert {path.name for path in tmp_path.iterdir()} == names - {".insdvl-replay-killed"} | {
        "dive"
    }


def test_a_run_of_days_that_still_writes_keeps_its_folder(tmp_path: Path) -> None:
    file = tmp_path / ".insdvl-replay-long" / "new" / "replay.mcap"
    file.parent.mkdir(parents=True)
    file.write_text("half")
    aged(file.parents[1], 25.0)
    os.utime(file)
    written(tmp_path / "dive", "new")
    assert file.exists()


def renamed_then_killed(path: Path, new: Path) -> None:
    if path.name != "dive" or "old" in path.parts:
        raise KeyboardInterrupt  # also on the way back: a killed run does not tidy up
    os.rename(path, new)  # noqa: PTH104


@pytest.mark.parametrize("word", ["old", "newer"])
def test_an_older_result_goes_back_after_a_kill_between_two_renames(
    word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "dive"
    written(target, "old")
    with monkeypatch.context() as killed:
        killed.setattr(Path, "rename", renamed_then_killed)
        killed.setattr(shutil, "rmtree", lambda *_, **__: None)
        with pytest.raises(KeyboardInterrupt):
            written(target, "new")
    (hidden,) = tmp_path.iterdir()
    if word == "newer":  # it was made again in the meantime
        written(target, "newer")
    aged(hidden, 25.0)
    written(tmp_path / "another", "new")
    assert f'"{word}"' in (target / COMPLETE).read_text()
    assert not hidden.exists()
