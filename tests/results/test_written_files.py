"""Files and folders that are written: what they may replace, what they never do, and what a killed run leaves."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.results.folder import COMPLETE, DIVE_FILES, damaged_files, result_digest, result_file, result_folder
from insdvl_replay.results.workspace import clear_leftovers

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
    [("absent", "absent"), ("folder", "folder"), ("link", "symbolic links")],
)
def test_a_link_that_leads_to_no_file_is_refused_in_words(leads: str, named: str, force: bool, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link"
    link.symlink_to(leads)
    with pytest.raises(ConfigError) as refused:
        write(link, force=force)
    assert refused.value.message.startswith(f"{tmp_path}/link: ")
    assert named in refused.value.message
    assert refused.value.hint
    assert link.readlink() == Path(leads)


@pytest.mark.parametrize("name", ["a" * 255, "a" * 5000, "a" * 5000 + "/dive"])
def test_a_name_that_no_folder_can_have_is_told(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="File name too long"), result_folder(tmp_path / name):
        pass


def test_a_pipe_gets_nothing_of_what_failed(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(RuntimeError):
        write_half(pipe)
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.mark.parametrize("append", [False, True])
def test_the_descriptor_of_stdout_shares_its_place(append: bool, tmp_path: Path) -> None:
    """A file that is opened once more by its name would be written over by what is printed afterwards."""
    printed = tmp_path / "printed"
    printed.write_text("before\n")
    script = (
        "from pathlib import Path; from insdvl_replay.results.folder import result_file\n"
        "with result_file(Path('/dev/stdout'), force=True) as path: path.write_text('written\\n')\n"
        "print('printed')"
    )
    with printed.open("a" if append else "w") as stdout:
        subprocess.run([sys.executable, "-c", script], stdout=stdout, check=True, timeout=60)
    assert printed.read_text() == "before\n" * append + "written\nprinted\n"


def test_check_leaves_what_is_no_file_where_it_is(tmp_path: Path) -> None:
    gates = tmp_path / "gates.toml"
    gates.write_text((EXAMPLES / "gates.toml").read_text())
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    null = tmp_path / "null"
    null.symlink_to("/dev/null")
    command = ["check", str(gates), "--results", str(tmp_path / "checked"), "--format", "junit", "--output"]
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
    assert run_command_line(["check", str(gates), "--results", str(tmp_path / "checked"), option, str(link)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {option}: {link}: ")
    assert list(tmp_path.iterdir()) == [link]


# --- What may be replaced.


@pytest.mark.parametrize(
    "report", ["", "{", "[]", '{"tool": "x"}', '{"tool": {"name": "another-tool"}}', '{"results": [1, 2]}']
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
    sentence = f"{target}: holds {name}, which its result did not write, and is not replaced"
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


def written_while_another_run_writes(target: Path, words: tuple[str, str]) -> None:
    before = result_digest(target)
    with result_folder(target, force=True, before=before) as second:
        (second / COMPLETE).write_text(OURS % words[1])
        with result_folder(target, force=True, before=before) as first:
            (first / COMPLETE).write_text(OURS % words[0])


@pytest.mark.parametrize("old", [False, True])
def test_of_two_runs_at_once_the_second_to_finish_is_told(old: bool, tmp_path: Path) -> None:
    target = tmp_path / "dive"
    if old:
        written(target, "old")
    with pytest.raises(ConfigError, match="dive: "):
        written_while_another_run_writes(target, ("first", "second"))
    assert '"first"' in (target / COMPLETE).read_text()
    assert list(tmp_path.iterdir()) == [target]


def test_two_runs_at_once_with_one_result_are_both_done(tmp_path: Path) -> None:
    written_while_another_run_writes(tmp_path / "dive", ("same", "same"))
    assert list(tmp_path.iterdir()) == [tmp_path / "dive"]


@pytest.mark.parametrize("option", ["--output", "--summary-file"])
def test_no_folder_is_made_for_a_file(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "absent" / "gates.xml"
    assert run_command_line(["check", str(EXAMPLES / "gates.toml"), option, str(file)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {option}: {file}: ")
    assert said.endswith(f"; hint: mkdir -p {file.parent}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_is_a_named_pipe_is_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
        (folder / COMPLETE).write_text('{"tool": {"name": "insdvl-replay", "started_at": "now"}, "rmse": 0.1}')
        (folder / "improvement.csv").write_bytes(b"a,b\n1,2\n")
        (folder / "replay.mcap").write_bytes(bytes(range(256)) * 5000)
    return tmp_path / "dive"


def test_a_result_lists_the_digests_that_other_tools_find(result: Path) -> None:
    files = json.loads((result / COMPLETE).read_bytes())["files"]
    sums = "".join(f"{digest}  {name}\n" for name, digest in files.items() if name != COMPLETE)
    subprocess.run(["sha256sum", "--check", "--strict"], cwd=result, input=sums, text=True, check=True, timeout=60)
    assert sorted(files) == sorted(path.name for path in result.iterdir())
    assert damaged_files(result) == []


def test_the_time_of_day_does_not_count(result: Path) -> None:
    report = result / COMPLETE
    report.write_text(report.read_text().replace('"now"', '"later"'))
    assert damaged_files(result) == []


@pytest.mark.parametrize("data", [b"", b"a,b\n1,3\n", None])
def test_a_file_that_is_emptied_changed_or_gone_is_damaged(data: bytes | None, result: Path) -> None:
    (result / "improvement.csv").unlink()
    if data is not None:
        (result / "improvement.csv").write_bytes(data)
    assert damaged_files(result) == ["improvement.csv"]


@pytest.mark.parametrize(("old", "new"), [("0.1", "0.0"), ('"files"', '"flies"'), ('"replay.mcap"', '"replay2.mcap"')])
def test_a_report_that_is_changed_is_damaged(old: str, new: str, result: Path) -> None:
    report = result / COMPLETE
    text = report.read_text()
    assert old in text
    report.write_text(text.replace(old, new))
    assert COMPLETE in damaged_files(result)


# --- What killed runs leave.

KILLED = """
import os, signal, sys
from pathlib import Path
from insdvl_replay.results.folder import COMPLETE, result_folder

renamed, at = Path.rename, int(sys.argv[2])

def rename(path, target):
    global at
    at -= 1
    if at == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return renamed(path, target)

Path.rename = rename
with result_folder(Path(sys.argv[1]), force=True) as folder:
    (folder / COMPLETE).write_text('{"tool": {"name": "insdvl-replay"}, "word": "killed"}')
"""


def written(target: Path, word: str) -> None:
    with result_folder(target, force=True) as folder:
        (folder / COMPLETE).write_text(OURS % word)


def killed_at(target: Path, rename: int) -> None:
    command = [sys.executable, "-c", KILLED, str(target), str(rename)]
    assert subprocess.run(command, check=False, timeout=60).returncode == -signal.SIGKILL


@pytest.mark.parametrize("rename", [1, 2])
def test_a_killed_run_loses_no_older_result_and_is_cleared_after_a_day(rename: int, tmp_path: Path) -> None:
    target = tmp_path / "dive"
    written(target, "old")
    killed_at(target, rename)
    assert len(list(tmp_path.glob(".dive-*"))) == 1
    assert target.exists() == (rename == 1)
    clear_leftovers(tmp_path)
    assert '"old"' in (target / COMPLETE).read_text()
    (workspace,) = tmp_path.glob(".dive-*")
    os.utime(workspace, (0.0, time.time() - 90_000.0))
    clear_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == [target]


def test_the_next_run_asks_before_it_replaces_what_it_put_back(tmp_path: Path) -> None:
    target = tmp_path / "dive"
    written(target, "old")
    killed_at(target, 2)
    with pytest.raises(ConfigError, match="dive: exists"), result_folder(target):
        raise AssertionError
    assert '"old"' in (target / COMPLETE).read_text()


def test_a_living_run_is_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "dive"
    with result_folder(target, force=True) as first:
        (first / "half.csv").write_text("half")
        written(target, "of another run")
        clear_leftovers(tmp_path)
        assert (first / "half.csv").read_text() == "half"
        (first / "half.csv").unlink()
        (first / COMPLETE).write_text(OURS % "first")
    assert '"first"' in (target / COMPLETE).read_text()
    assert list(tmp_path.iterdir()) == [target]


def test_hidden_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / ".dive-backup_1").mkdir()
    (tmp_path / ".dive-backup_1" / "notes.txt").write_text("mine")
    (tmp_path / ".dive-12345678").mkdir()
    (tmp_path / ".ssh").mkdir()
    os.utime(tmp_path / ".dive-backup_1", (0.0, 0.0))
    written(tmp_path / "dive", "new")
    assert {path.name for path in tmp_path.iterdir()} == {".dive-backup_1", ".dive-12345678", ".ssh", "dive"}


def test_a_folder_whose_result_cannot_go_back_is_kept_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target, renamed = tmp_path / "dive", Path.rename
    written(target, "old")

    def fails(path: Path, new: Path) -> Path:
        if new == target:
            raise OSError(5, "Input/output error")
        return renamed(path, new)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(ConfigError, match="Input/output error"):
        written(target, "new")
    monkeypatch.undo()
    clear_leftovers(tmp_path)
    assert '"old"' in (target / COMPLETE).read_text()
