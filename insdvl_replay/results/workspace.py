"""Hidden folders in which results are written aside, and what becomes of those of killed runs."""

import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from insdvl_replay.core.errors import ConfigError

NAME_A_FILE = "give the name of a file"


def replaceable_file(target: Path) -> Path | None:
    """Follow links to the file that a path stands for, whether it is there yet or not.

    Returns
    -------
    Path or None
        What a new file may be renamed to. None for a device, a named pipe, a socket or a descriptor of this process
        (``/dev/stdout``), which are written to in place: others hold them open, and a file of their name is no use.

    Raises
    ------
    ConfigError
        A folder, a disk, a link that leads nowhere, or a name in a folder that is not there.
    """
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        if target.is_symlink():
            leads = target.readlink()
            raise ConfigError(f"{target}: is a link to {leads}, which is not there", f"rm {target}") from None
        if not target.parent.is_dir():
            folder = target.parent
            raise ConfigError(f"{target}: there is no folder {folder}", f"mkdir -p {folder}") from None
        return target
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}", NAME_A_FILE) from error
    if stat.S_ISDIR(mode):
        raise ConfigError(f"{target}: is a {'link to a ' * target.is_symlink()}folder", NAME_A_FILE)
    if stat.S_ISBLK(mode):
        raise ConfigError(f"{target}: is a disk", NAME_A_FILE)
    return target.resolve() if stat.S_ISREG(mode) and _descriptor(target) is None else None


def open_in_place(target: Path) -> BinaryIO:
    """Open what is there, without making or emptying a file of its name."""
    number = _descriptor(target)
    return os.fdopen(os.open(target, os.O_WRONLY) if number is None else os.dup(number), "wb")


def _descriptor(target: Path) -> int | None:
    """Return the number of the descriptor of this process that a path stands for, as ``/dev/stdout`` does for 1."""
    own = {Path("/dev/fd").resolve(), Path("/proc/self/fd").resolve()}
    while True:
        folder = target.parent.resolve()
        if folder in own and target.name.isdecimal():
            return int(target.name)
        if not target.is_symlink():
            return None
        target = folder / target.readlink()


NEW: Final = "insdvl-replay.new"
"""What is written, inside a workspace."""
OLD: Final = "insdvl-replay.old"
"""The older result, while the new one takes its place."""

_WORKSPACE: Final = re.compile(r"\.(?P<target>.+)-[a-z0-9_]{8}", re.DOTALL)
_LEFT_FOR_S: Final = 86_400.0
"""What nobody has changed for a day was left by a killed run."""


@contextmanager
def workspace_beside(target: Path) -> Iterator[Path]:
    """Return a hidden folder beside the target, on the same file system, and remove it with all it then holds.

    What killed runs left in the same place is cleared first.
    """
    try:
        made = [parent for parent in target.parents if not parent.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        clear_leftovers(target.parent)
        workspace = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        try:
            (workspace / NEW).mkdir()
            yield workspace
        finally:
            _put_back(workspace, target)
            shutil.rmtree(workspace, ignore_errors=True)
            for parent in made:
                with suppress(OSError):  # no longer empty, or never made
                    parent.rmdir()
    except OSError as error:
        raise ConfigError(
            f"{target}: cannot be written: {error.strerror or error}", "choose another place with -o"
        ) from error


def clear_leftovers(folder: Path) -> None:
    """Put back the older results that killed runs had moved aside, and remove their workspaces after a day."""
    with suppress(OSError):  # it is not there, or may not be read
        for entry in list(os.scandir(folder)):
            match = _WORKSPACE.fullmatch(entry.name)
            if match and entry.is_dir(follow_symlinks=False):
                with suppress(OSError):
                    _clear(Path(entry.path), folder / match["target"])


def _clear(workspace: Path, target: Path) -> None:
    if {path.name for path in workspace.iterdir()} <= {NEW, OLD}:  # else it is somebody else's
        _put_back(workspace, target)
        if time.time() - workspace.stat().st_mtime > _LEFT_FOR_S:
            shutil.rmtree(workspace, ignore_errors=True)


def _put_back(workspace: Path, target: Path) -> None:
    """Put the older result back if nothing took its place."""
    if os.path.lexists(workspace / OLD) and not os.path.lexists(target):
        (workspace / OLD).rename(target)
