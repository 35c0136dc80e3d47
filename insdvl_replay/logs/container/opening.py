"""Opening a file as an MCAP file; what is none is refused by name."""

import struct
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.mapped_file import MappedFile, UnusableFileError
from insdvl_replay.logs.container.records import MAGIC, RECORD_HEADER_SIZE, can_be_record

_HEADER_CONTENT: Final = len(MAGIC) + RECORD_HEADER_SIZE
"""Where the content of the first record starts."""
_OTHER_FORMATS: Final = {
    b"SQLite format 3": ("a ROS 2 bag in SQLite", "`ros2 bag convert` writes it as MCAP"),
    b"#ROSBAG V2.0": ("a ROS 1 bag", "`mcap convert in.bag out.mcap` writes it as MCAP"),
    b"\x28\xb5\x2f\xfd": ("compressed as a whole with zstd", "`zstd -d {path}` unpacks it"),
}


def mapped(path: Path) -> MappedFile:
    """Map an MCAP file into memory, also one of which the opening bytes are damaged.

    Parameters
    ----------
    path : Path

    Returns
    -------
    MappedFile

    Raises
    ------
    UnusableFileError
        The file is empty, or is no MCAP file.
    LogError
        It cannot be opened.
    """
    file = MappedFile(path)
    start = bytes(file.data[:16])
    if not start.startswith(MAGIC) and not _goes_on_like_mcap(file.data):
        raise _not_mcap(path, start)
    return file


def _goes_on_like_mcap(data: memoryview) -> bool:
    """Tell whether a header stands behind the opening bytes, or the closing ones are there."""
    opcode, length = struct.unpack("<BQ", bytes(data[len(MAGIC) : _HEADER_CONTENT]).ljust(RECORD_HEADER_SIZE, b"\0"))
    is_header = opcode == Opcode.HEADER and can_be_record(opcode, length) and length <= len(data) - _HEADER_CONTENT
    return is_header or bytes(data[-len(MAGIC) :]) == MAGIC


def _not_mcap(path: Path, start: bytes) -> LogError:
    for magic, (name, hint) in _OTHER_FORMATS.items():
        if start.startswith(magic):
            return LogError(f"{path}: is {name}, not an MCAP file", hint.format(path=path))
    found = start[:8].hex(" ")
    return UnusableFileError(f"{path}: is not an MCAP file: it starts with bytes '{found}'", "name an .mcap file")
