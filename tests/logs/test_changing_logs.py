"""A log that somebody changes while it is read is refused: what was read is of no file that ever was."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_logs import small_log

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import LogError
from insdvl_replay.inspection import survey
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read, read_dive

A_PAGE = 4096


def replace(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(small_log("lz4"))
    other.replace(path)


def replace_by_a_copy(path: Path) -> None:
    """Put the same bytes there, with the same times: the file is another one none the less."""
    before, copy = path.stat(), path.with_name("copy")
    copy.write_bytes(path.read_bytes())
    os.utime(copy, ns=(before.st_atime_ns, before.st_mtime_ns))
    copy.replace(path)


def overwrite(path: Path) -> None:
    os.utime(path, ns=(0, 0))
    with path.open("r+b") as file:
        file.seek(A_PAGE)
        file.write(b"other")


def append(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


def cut(path: Path) -> None:
    os.truncate(path, A_PAGE)


def cut_and_write_again(path: Path) -> None:
    """Do what ``cp`` over a file does."""
    path.write_bytes(path.read_bytes())


CHANGES: list[tuple[Callable[[Path], None], bool, str]] = [
    (replace, True, "was replaced by another file"),
    (replace_by_a_copy, False, "was replaced by another file"),
    (overwrite, False, "was written to"),
    (append, True, r"grew from \d+ to \d+ bytes"),
    (cut, False, rf"was cut from \d+ to {A_PAGE} bytes"),
    (cut, True, rf"was cut from \d+ to {A_PAGE} bytes"),
    (cut_and_write_again, True, "was written to"),
    (Path.unlink, False, "was removed"),
]
"""What happens to a log, whether damage of it is allowed, and what is said: the change in both cases."""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log of many pages, of which the first are read, and so kept, before it changes."""
    path = tmp_path / "dive.mcap"
    path.write_bytes(small_log("uncompressed"))
    os.utime(path, ns=(1, 1))
    return path


def changing(
    change: Callable[[Path], None], path: Path, work: Callable[..., Any]
) -> Callable[..., Any]:
    def changed(*arguments: Any, **options: Any) -> Any:
        change(path)
        return work(*arguments, **options)

    return changed


@pytest.mark.parametrize(("change", "allow_damaged", "sentence"), CHANGES)
def test_a_log_that_changes_before_its_messages_are_read_is_refused(
    log: Path,
    change: Callable[[Path], None],
    allow_damaged: bool,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(read, "read_tables", changing(change, log, read.read_tables))
    with pytest.raises(LogError, match=rf"dive\.mcap: {sentence} while it was read") as refusal:
        read_dive(log, Config(), allow_damaged=allow_damaged)
    assert "copy" in refusal.value.hint


def test_a_part_of_a_bag_that_changes_is_refused(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(read, "read_tables", changing(append, log, read.read_tables))
    with pytest.raises(LogError, match=r"dive\.mcap: grew"):
        read_dive(log.parent, Config())


def test_a_log_that_changes_while_it_is_inspected_is_refused(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log.write_bytes(small_log("no chunks"))
    monkeypatch.setattr(survey, "find_roles", changing(cut, log, survey.find_roles))
    with pytest.raises(LogError, match="while it was read"):
        inspect_log(log, Config())


def test_a_pipe_that_nobody_writes_to_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.mcap")
    with pytest.raises(LogError, match="is a pipe or a device, not a file"):
        read_dive(tmp_path / "log.mcap", Config())


def test_a_device_is_refused() -> None:
    with pytest.raises(LogError, match="is a pipe or a device, not a file"):
        read_dive(Path("/dev/null"), Config())


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs /proc (Linux)")
def test_a_file_that_the_system_makes_up_has_no_size() -> None:
    with pytest.raises(LogError, match=r"is empty \(0 bytes\)"):
        read_dive(Path("/proc/cpuinfo"), Config())
