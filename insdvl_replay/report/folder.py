"""Results appear all at once or not at all: they are written aside and renamed into place when complete."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from insdvl_replay.errors import ConfigError
from insdvl_replay.result_tables import TABLES

COMPLETE = "report.json"
"""The file by which a result folder is known, written last."""
PAGE = "report.html"
"""The page that shows a result."""
DIVE_FILES = (*(f"{layout.name}.csv" for layout in TABLES), "replay.mcap", "config.toml", "run.log", PAGE, COMPLETE)
"""All files of the result of a dive."""
REFERENCE_TRAJECTORY = "reference.tum"
"""The reference's trajectory, where trajectories are asked for."""


def trajectory_file(name: str) -> str:
    """Name the file of a filter's trajectory; no filter's name makes it that of the reference."""
    return f"filter_{name}.tum"


@contextmanager
def result_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Give a new folder to write into, which becomes the target when the block ends without an exception.

    On any exception, an interruption included, nothing of it remains, and an older result stays as it was.

    Parameters
    ----------
    target : Path
        The result folder. Folders above it are made.
    force : bool
        Replace an older result.

    Yields
    ------
    Path
        An empty folder on the same file system.

    Raises
    ------
    ConfigError
        The target exists and must not be replaced, or the disk refuses.
    """
    refuse_existing_folder(target, force=force)
    with _beside(target) as workspace:
        fresh = workspace / "new"
        fresh.mkdir()
        yield fresh
        refuse_existing_folder(target, force=force)
        _swap(fresh, target, old=workspace / "old")


@contextmanager
def result_file(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Give a path to write to, which becomes the target when the block ends without an exception.

    Parameters
    ----------
    target : Path
        The file. Folders above it are made.
    force : bool
        Replace an older file.

    Yields
    ------
    Path
        A path on the same file system, where no file is yet.

    Raises
    ------
    ConfigError
        The target exists and must not be replaced, or the disk refuses.
    """
    refuse_existing_file(target, force=force)
    with _beside(target) as workspace:
        yield workspace / target.name
        refuse_existing_file(target, force=force)
        (workspace / target.name).replace(target)


def refuse_existing_folder(target: Path, *, force: bool = False) -> None:
    """Raise a ConfigError if a result must not be written to a folder.

    With ``force`` an older result may be replaced. Anything else that bears the name may not: it is somebody's work.

    Parameters
    ----------
    target : Path
    force : bool
    """
    if not os.path.lexists(target):
        return
    if not (target / COMPLETE).is_file():
        raise ConfigError(f"{target}: exists and is not a result folder", "choose another folder with -o")
    if not force:
        raise ConfigError(f"{target}: exists", "choose another folder with -o, or replace it with --force")


def refuse_existing_file(target: Path, *, force: bool = False) -> None:
    """Raise a ConfigError if a file exists and may not be replaced.

    Parameters
    ----------
    target : Path
    force : bool
    """
    if target.is_dir():
        raise ConfigError(f"{target}: is a folder", "give the name of a file")
    if os.path.lexists(target) and not force:
        raise ConfigError(f"{target}: exists", "choose another name with -o, or replace it with --force")


@contextmanager
def _beside(target: Path) -> Iterator[Path]:
    """Give a hidden folder beside the target, on the same file system, and remove it with all it then holds."""
    made = [parent for parent in target.parents if not parent.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        workspace = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        try:
            yield workspace
        finally:
            try:
                shutil.rmtree(workspace, ignore_errors=True)
            finally:  # an interruption may come while it is removed
                shutil.rmtree(workspace, ignore_errors=True)
            for parent in made:
                with suppress(OSError):  # no longer empty, or never made
                    parent.rmdir()
    except OSError as error:
        raise ConfigError(
            f"{target}: cannot be written: {error.strerror or error}", "choose another place with -o"
        ) from error


def _swap(fresh: Path, target: Path, old: Path) -> None:
    """Put the new folder where the old one is; if that fails half-way, put the old one back."""
    try:
        if target.exists():
            target.rename(old)
        fresh.rename(target)
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        raise
