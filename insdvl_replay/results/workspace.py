"""Hidden folders in which results are written aside, and what becomes of those of killed runs.

A run holds a lock in its folder, which the system lets go when the run ends, however it ends: unlike the number of a
process this is true for containers and for machines that share a disk. A folder whose lock is free is nobody's.
"""

import errno
import fcntl
import os
import re
import shutil
import stat
import tempfile
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
        A folder, a disk, or a link that leads nowhere.
    """
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        if target.is_symlink():
            leads = target.readlink()
            raise ConfigError(f"{target}: is a link to {leads}, which is not there", f"rm {target}") from None
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


NEW: Final = "new"
"""What is written, inside a workspace."""
OLD: Final = "old"
"""The older result, while the new one takes its place."""
LOCK: Final = "insdvl-replay.lock"

_WORKSPACE: Final = re.compile(r"\.(?P<target>.+)-[a-z0-9_]{8}", re.DOTALL)
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""How a file system says that it knows no locks."""


@contextmanager
def workspace_beside(target: Path) -> Iterator[Path]:
    """Return a hidden folder beside the target, on the same file system, and remove it with all it then holds.

    What killed runs left in the same place is cleared first.
    """
    try:
        made = [parent for parent in target.parents if not parent.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        clear_leftovers(target.parent)
        workspace, lock = _new_workspace(target)
        try:
            (workspace / NEW).mkdir()
            yield workspace
        finally:
            _leave(workspace, target, lock)
            for parent in made:
                with suppress(OSError):  # no longer empty, or never made
                    parent.rmdir()
    except OSError as error:
        raise ConfigError(
            f"{target}: cannot be written: {error.strerror or error}", "choose another place with -o"
        ) from error


def clear_leftovers(folder: Path) -> None:
    """Remove the workspaces of killed runs, and put back the older results that they had moved aside.

    Parameters
    ----------
    folder : Path
        In which results lie. Nothing that a living run holds is touched, nor what this program did not make.
    """
    with suppress(OSError):  # it is not there, or may not be read
        for entry in list(os.scandir(folder)):
            match = _WORKSPACE.fullmatch(entry.name)
            if match and entry.is_dir(follow_symlinks=False):
                _clear(Path(entry.path), folder / match["target"])


def _clear(workspace: Path, target: Path) -> None:
    with suppress(OSError):  # no lock in it, or one of somebody else
        lock = _hold(workspace / LOCK, os.O_RDWR)
        if lock is not None:
            _leave(workspace, target, lock)


def _new_workspace(target: Path) -> tuple[Path, int | None]:
    """Make a workspace and hold its lock; None where the file system has no locks, and nobody clears it."""
    while True:
        workspace = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        try:
            lock = _hold(workspace / LOCK, os.O_RDWR | os.O_CREAT)
        except OSError as error:
            (workspace / LOCK).unlink(missing_ok=True)
            if error.errno in _NO_LOCKS:
                return workspace, None
            workspace.rmdir()
            raise
        if lock is not None:  # else it was cleared before it was locked
            return workspace, lock


def _hold(path: Path, flags: int) -> int | None:
    """Hold a lock until its descriptor is closed; None if somebody else does, or has removed its file."""
    try:
        lock = os.open(path, flags, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(lock), path.stat()):
            return lock
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        os.close(lock)
        raise
    os.close(lock)
    return None


def _leave(workspace: Path, target: Path, lock: int | None) -> None:
    try:
        _close(workspace, target)
    finally:  # an interruption may come while it is removed
        try:
            _close(workspace, target)
        finally:
            if lock is not None:
                os.close(lock)
                with suppress(OSError):  # NFS keeps a removed file in its folder while somebody has it open
                    workspace.rmdir()


def _close(workspace: Path, target: Path) -> None:
    """Put the older result back if nothing took its place, and remove the workspace, its lock last."""
    if os.path.lexists(workspace / OLD) and not os.path.lexists(target):
        (workspace / OLD).rename(target)
    for part in (NEW, OLD, "."):
        shutil.rmtree(workspace / part, ignore_errors=True)
