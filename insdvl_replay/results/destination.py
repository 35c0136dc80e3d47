"""What stands where a file is to be written: nothing, a file, a link to one, or something that is never replaced."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

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
    """Give the number of the descriptor of this process that a path stands for, as ``/dev/stdout`` does for 1."""
    own = {Path("/dev/fd").resolve(), Path("/proc/self/fd").resolve()}
    while True:
        folder = target.parent.resolve()
        if folder in own and target.name.isdecimal():
            return int(target.name)
        if not target.is_symlink():
            return None
        target = folder / target.readlink()
