"""Opening a file as an MCAP file; what is none is refused by name."""

import mmap
import struct
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode

from insdvl_replay.errors import LogError
from insdvl_replay.logs.records import MAGIC, RECORD_HEADER_SIZE, can_be_record

_HEADER_CONTENT: Final = len(MAGIC) + RECORD_HEADER_SIZE
"""Where the content of the first record starts."""
_OTHER_FORMATS: Final = {
    b"SQLite format 3": ("a ROS 2 bag in SQLite", "`ros2 bag convert` writes it as MCAP"),
    b"#ROSBAG V2.0": ("a ROS 1 bag", "`mcap convert in.bag out.mcap` writes it as MCAP"),
    b"\x28\xb5\x2f\xfd": ("compressed as a whole with zstd", "`zstd -d {path}` unpacks it"),
}


class UnusableFileError(LogError):
    """A file of which neither the first bytes nor the last are those of an MCAP file."""


def mapped(path: Path) -> mmap.mmap:
    """Map an MCAP file into memory, also one of which the opening bytes are damaged.

    Parameters
    ----------
    path : Path

    Returns
    -------
    mmap

    Raises
    ------
    UnusableFileError
        The file is empty, or is no MCAP file.
    LogError
        It cannot be opened.
    """
    try:
        with path.open("rb") as file:
            start = file.read(16)
            if not start:
                hint = "the recording never began, or the copy failed"
                raise UnusableFileError(f"{path}: is empty (0 bytes)", hint)
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}", "check the path") from error
    if not start.startswith(MAGIC) and not _goes_on_like_mcap(data):
        raise _not_mcap(path, start)
    return data


def _goes_on_like_mcap(data: mmap.mmap) -> bool:
    """Tell whether a header stands behind the opening bytes, or the closing ones are there."""
    opcode, length = struct.unpack("<BQ", data[len(MAGIC) : _HEADER_CONTENT].ljust(RECORD_HEADER_SIZE, b"\0"))
    is_header = opcode == Opcode.HEADER and can_be_record(opcode, length) and length <= len(data) - _HEADER_CONTENT
    return is_header or data[-len(MAGIC) :] == MAGIC


def _not_mcap(path: Path, start: bytes) -> LogError:
    for magic, (name, hint) in _OTHER_FORMATS.items():
        if start.startswith(magic):
            return LogError(f"{path}: is {name}, not an MCAP file", hint.format(path=path))
    found = start[:8].hex(" ")
    return UnusableFileError(f"{path}: is not an MCAP file: it starts with bytes '{found}'", "name an .mcap file")
