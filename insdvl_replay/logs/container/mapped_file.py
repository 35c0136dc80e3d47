"""A log's bytes, as they were when it was opened: whoever changes the file meanwhile is found out.

Other programs may write to a log, cut it, put another file in its place or remove it. What was read by then is of no
file that ever was, so that the log is refused; so is a file that is no MCAP file, by the name of what it is.
"""

import errno
import mmap
import os
import stat
import struct
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Final

import numpy as np
from mcap.opcode import Opcode

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.records import MAGIC, RECORD_HEADER_SIZE, can_be_record
from insdvl_replay.logs.container.truncation import forget, keep_readable

_HINT: Final = "read it when nothing writes there any more, or read a copy of it"
_NOT_WAITING: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""A pipe that nobody writes to would be waited for without end."""


class UnusableFileError(LogError):
    """A file of which neither the first bytes nor the last are those of an MCAP file."""


class ChangedLogError(LogError):
    """A file is no longer what it was when it was opened."""


class MappedFile:
    """A file that is mapped into memory, and stays open so that its bytes can be told from those of any other.

    Attributes
    ----------
    data : memoryview
        Its bytes; zeros where the file was cut since.

    Raises
    ------
    UnusableFileError
        The file is empty.
    LogError
        It cannot be opened, or is no file but a pipe or a device.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY | _NOT_WAITING)
            try:
                self._before = os.fstat(self._descriptor)
                self._require_file()
                self._map = mmap.mmap(self._descriptor, self._before.st_size, access=mmap.ACCESS_READ)
            except BaseException:
                os.close(self._descriptor)
                raise
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            raise LogError(f"cannot be read: {reason}", "check the path", path) from error
        self.data = memoryview(self._map)
        address = np.frombuffer(self._map, np.uint8).ctypes.data
        weakref.finalize(self, forget, keep_readable(address, len(self._map), self._descriptor))

    def _require_file(self) -> None:
        if stat.S_ISDIR(self._before.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(self._before.st_mode):
            raise LogError("is a pipe or a device, not a file", "write it to a file, and name that", self.path)
        if not self._before.st_size:
            hint = "the recording never began, or the copy failed"
            raise UnusableFileError("is empty (0 bytes)", hint, self.path)

    def reopened(self) -> FileIO:
        """Give the same file for reading from its start to its end, once at a time, whatever bears its name by now."""
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        return FileIO(self._descriptor, closefd=False)

    def release(self, start: int, end: int) -> None:
        """Keep what was read from counting as memory of this process; the system reads it again if need be."""
        if hasattr(mmap, "MADV_DONTNEED"):
            page = start - start % mmap.PAGESIZE
            self._map.madvise(mmap.MADV_DONTNEED, page, end - page)

    def require_unchanged(self) -> None:
        """Refuse the file if it is no longer what it was."""
        if change := self._change():
            raise ChangedLogError(f"{change} while it was read", _HINT, self.path)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the file if it has changed by the end, above all if that made something inside fail."""
        try:
            yield
        except Exception:
            self.require_unchanged()
            raise
        self.require_unchanged()

    def _change(self) -> str:
        """Say in a few words what has become of the file; nothing if all is as it was."""
        before = self._before
        try:
            now, named = os.fstat(self._descriptor), self.path.stat()
        except FileNotFoundError:
            return "was removed"
        except OSError as error:
            return f"went away ({error.strerror})"
        if now.st_size != before.st_size:
            change = "was cut" if now.st_size < before.st_size else "grew"
            return f"{change} from {before.st_size} to {now.st_size} bytes"
        if now.st_mtime_ns != before.st_mtime_ns:
            return "was written to"
        return "" if os.path.samestat(before, named) else "was replaced by another file"


_HEADER_CONTENT: Final = len(MAGIC) + RECORD_HEADER_SIZE
"""Where the content of the first record starts."""
_OTHER_FORMATS: Final = {
    b"SQLite format 3": ("a ROS 2 bag in SQLite", "`ros2 bag convert` writes it as MCAP"),
    b"#ROSBAG V2.0": ("a ROS 1 bag", "`mcap convert in.bag out.mcap` writes it as MCAP"),
    b"\x28\xb5\x2f\xfd": ("compressed as a whole with zstd", "`zstd -d {path}` unpacks it"),
}


def mapped(path: Path) -> MappedFile:
    """Map an MCAP file into memory, also one of which the opening bytes are damaged."""
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
            return LogError(f"is {name}, not an MCAP file", hint.format(path=path), path)
    found = start[:8].hex(" ")
    return UnusableFileError(f"is not an MCAP file: it starts with bytes '{found}'", "name an .mcap file", path)
