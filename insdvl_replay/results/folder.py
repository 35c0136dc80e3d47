"""Results appear all at once or not at all: they are written aside and renamed into place when complete."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import msgspec

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.plain_text import read_regular
from insdvl_replay.core.tables import TABLES
from insdvl_replay.results.workspace import (
    NAME_A_FILE,
    NEW,
    OLD,
    clear_leftovers,
    open_in_place,
    replaceable_file,
    workspace_beside,
)

REPORT: Final = "report.json"
"""The file that holds the list."""
NOT_JSON: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""Raised where bytes are decoded that are no JSON of ours: cut, of other letters, or nested without end."""
_MOST_BYTES: Final = 1 << 30
"""Of a file of a result that is read into memory: reports of long dives have some MB."""
_TIME_OF_DAY: Final = ("started_at", "elapsed_s")


def list_files(folder: Path) -> None:
    """Write into the report of a finished result which files it has, and the SHA-256 of each."""
    report = folder / REPORT
    content = msgspec.json.decode(report.read_bytes())
    files = {path.name: _digest(path) for path in sorted(folder.iterdir()) if path != report}
    content["files"] = files | {REPORT: _digest_of_report(content | {"files": files})}
    report.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")


def damaged_files(folder: Path) -> list[str]:
    """Name the files of a result that are not as they were written, or not there; the report alone if it lists none."""
    content = msgspec.json.decode(read_file(folder / REPORT))
    files: dict[str, str] = dict(content.get("files", {}))
    of_report = files.pop(REPORT, "")
    damaged = [name for name, digest in files.items() if not _is_whole(folder / name, digest)]
    content["files"] = files
    return damaged if _digest_of_report(content) == of_report else [REPORT, *damaged]


def result_digest(folder: Path) -> str:
    """Return the SHA-256 by which a result is known, without the time of day; empty where there is none."""
    try:
        return msgspec.json.decode(read_file(folder / REPORT), type=_Label).files.get(REPORT, "")
    except (OSError, *NOT_JSON):
        return ""


def read_file(path: Path) -> bytes:
    """Read a file of a result; see `read_regular`."""
    return read_regular(path, _MOST_BYTES)


def _is_whole(path: Path, digest: str) -> bool:
    return path.is_file() and _digest(path) == digest


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest_of_report(content: dict[str, Any]) -> str:
    tool = {key: value for key, value in content["tool"].items() if key not in _TIME_OF_DAY}
    return hashlib.sha256(msgspec.json.encode(content | {"tool": tool})).hexdigest()


COMPLETE = REPORT
"""The file by which a result folder is known, written last."""
PAGE = "report.html"
"""The page that shows a result."""
REPLAY_LOG = "replay.mcap"
"""The histories; what checks alone need does without."""
TRAJECTORY_FILE = "trajectory.npz"
"""Every filter once a second."""
LAYOUT_FILES = ("foxglove.json", "plotjuggler.xml")
"""How viewers show replay.mcap."""
DIVE_FILES = (
    *(f"{layout.name}.csv" for layout in TABLES),
    *(REPLAY_LOG, *LAYOUT_FILES, TRAJECTORY_FILE, "config.toml", "run.log", PAGE, COMPLETE),
)
"""All files of the result of a dive."""
TOOL = "insdvl-replay"
"""How a report says whose it is."""
REFERENCE_TRAJECTORY = "reference.tum"
"""The reference's trajectory, where trajectories are asked for."""


class _Label(msgspec.Struct):
    """As much of a report as tells whose it is and which files it has; early ones do not list them."""

    tool: dict[str, str | float | None]
    baseline: str = ""
    filters: dict[str, Any] = {}
    files: dict[str, str] = {}


def history_file(name: str, format_: str) -> str:
    """Name the file of a filter's whole history, in ``csv`` or ``parquet``."""
    return f"history_{name}.{format_}"


def trajectory_file(name: str) -> str:
    """Name the file of a filter's trajectory; no filter's name makes it that of the reference."""
    return f"filter_{name}.tum"


@contextmanager
def result_folder(target: Path, *, force: bool = False, before: str | None = None) -> Iterator[Path]:
    """Return a new folder to write into, which becomes the target when the block ends without an exception.

    On any exception, an interruption included, nothing of it remains, and an older result stays as it was. The report
    in it is made to list its files.

    Parameters
    ----------
    target : Path
        The result folder. Folders above it are made.
    force : bool
        Replace an older result.
    before : str, optional
        The `result_digest` of the older result that may be replaced; left out: of any.

    Yields
    ------
    Path
        An empty folder on the same file system.

    Raises
    ------
    ConfigError
        The target exists and must not be replaced, another run has written a different result there meanwhile, or the
        disk refuses.
    """
    clear_leftovers(target.parent)  # an older result may lie in them
    require_replaceable_folder(target, force=force)
    with workspace_beside(target) as workspace:
        yield workspace / NEW
        list_files(workspace / NEW)
        require_replaceable_folder(target, force=force)
        # What is moved aside first cannot change any more. If it is not replaced, the workspace puts it back.
        if target.exists():
            target.rename(workspace / OLD)
        may_replace = before is None or result_digest(workspace / OLD) in (before, result_digest(workspace / NEW))
        try:
            if may_replace:
                (workspace / NEW).rename(target)
        except OSError:
            if not target.exists():
                raise
            may_replace = False
        if not may_replace:
            raise ConfigError(
                f"{target}: another run has written a different result there meanwhile, which stays",
                "choose another folder with -o, or run it again",
            )


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Return a path to write to, which becomes the target when the block ends without an exception.

    Parameters
    ----------
    target : Path
        The file, or a link to it, which stays. What is no file, as a device or a named pipe, is never replaced: the
        bytes are written to it.
    force : bool
        Replace an older file.

    Yields
    ------
    Path
        A path on the same file system, where no file is yet.

    Raises
    ------
    ConfigError
        The target exists and must not be replaced, is a folder, a disk or a link that leads nowhere, its folder is not
        there, or the disk refuses.
    """
    require_replaceable_file(target, force=force)
    file = replaceable_file(target)
    if file is None:
        with _copied_into(target) as path:
            yield path
        return
    with workspace_beside(file) as workspace:
        yield workspace / NEW / file.name
        require_replaceable_file(target, force=force)
        (workspace / NEW / file.name).replace(file)


def require_replaceable_folder(target: Path, *, force: bool = False) -> None:
    """Raise a ConfigError if a result must not be written to a folder.

    With ``force`` an older result may be replaced, if the folder holds its files alone. Anything else that bears the
    name may not: it is somebody's work.
    """
    if not os.path.lexists(target):
        return
    own = _files_of_result(target)
    if own is None:
        raise ConfigError(f"{target}: exists and is not a result folder", "choose another folder with -o")
    if not force:
        raise ConfigError(f"{target}: exists", "choose another folder with -o, or replace it with --force")
    if foreign := sorted(path.name for path in target.iterdir() if path.name not in own or path.is_dir()):
        more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
        raise ConfigError(
            f"{target}: holds {foreign[0]}{more}, which its result did not write, and is not replaced",
            "move it elsewhere, or name another folder for the results",
        )


def is_result(folder: Path) -> bool:
    """Return whether a folder holds a result, so that the replay in it is no dive.

    Returns
    -------
    bool
        Also where its report is damaged, but not where it names another tool: that may lie beside logs.
    """
    if not (folder / COMPLETE).is_file():
        return False
    try:
        label = msgspec.json.decode((folder / COMPLETE).read_bytes(), type=_Label)
    except (OSError, *NOT_JSON):
        return True
    return label.tool.get("name", TOOL) == TOOL


def _files_of_result(folder: Path) -> Collection[str] | None:
    """Name the files that a result may have; None if there is none.

    A report that was damaged does not list them: a folder with all files of a dive's result is one nevertheless.
    """
    try:
        label = msgspec.json.decode(read_file(folder / COMPLETE), type=_Label)
    except (OSError, *NOT_JSON):
        label = _Label(tool={})
    if label.tool.get("name") == TOOL:
        trajectories = map(trajectory_file, [label.baseline, *label.filters])
        return {COMPLETE, *(label.files or {*DIVE_FILES, *trajectories, REFERENCE_TRAJECTORY})}
    needed = set(DIVE_FILES) - {
        REPLAY_LOG,
        *LAYOUT_FILES,
        TRAJECTORY_FILE,
    }  # which checks, and early versions, do without
    return DIVE_FILES if all((folder / name).is_file() for name in needed) else None


def require_replaceable_file(target: Path, *, force: bool = False) -> None:
    """Raise a ConfigError if a file cannot be written, or exists and may not be replaced."""
    file = replaceable_file(target)
    if file is not None and file.exists() and not force:
        raise ConfigError(f"{target}: exists", "choose another name, or replace it with --force")


@contextmanager
def _copied_into(target: Path) -> Iterator[Path]:
    """Return a path to write to, whose bytes go into what is there already when the block ends without an exception."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / target.name
            yield path
            with path.open("rb") as source, open_in_place(target) as sink:
                shutil.copyfileobj(source, sink)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror or error}", NAME_A_FILE) from error
