"""A log's bytes, as they were when it was opened: whoever changes the file meanwhile is found out.

Other programs may write to a log, cut it, put another file in its place or remove it. What was read by then is of no
file that ever was, so that the log is refused; so is a file that is no MCAP file, by the name of what it is.
"""

import ctypes
import errno
import hashlib
import mmap
import os
import signal
import stat
import struct
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from io import FileIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.container.other_formats import other_format
from insdvl_replay.logs.container.records import MAGIC, RECORD_HEADER_SIZE, Damage, can_be_record

_FIXED: Final = 0x10
"""MAP_FIXED, which Python does not name: on Linux, macOS and the BSDs alike."""
_MOST_IN_VAIN: Final = 1000
"""Faults without a further cut, such as those of threads that fault together, before they are left to the system."""


@dataclass
class Mapping:
    """Where a file stands in memory: how many bytes are still the file's, and whether some are zeros by now."""

    address: int
    size: int
    descriptor: int
    is_cut: bool = False

    def mend(self) -> bool:
        """Put zeros behind the end of the file; say whether there was a need."""
        try:
            left = os.fstat(self.descriptor).st_size
        except OSError:  # another thread has just closed it, since nobody reads it any more
            return False
        if left >= self.size:
            return False
        start, end = _whole_pages(left), _whole_pages(self.size)
        self.size, self.is_cut = left, True
        if start < end:
            flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _FIXED
            _library().mmap(self.address + start, end - start, mmap.PROT_READ, flags, -1, 0)
        return True


def _whole_pages(size: int) -> int:
    return -(-size // mmap.PAGESIZE) * mmap.PAGESIZE


@dataclass
class _Guard:
    """Answers SIGBUS for all mapped files. Python's own handlers come too late: the access is tried again at once."""

    mappings: list[Mapping] = field(default_factory=list)
    in_vain: int = 0
    entry: Any = None
    before: int | None = None

    def add(self, mapping: Mapping) -> None:
        self.mappings.append(mapping)
        if self.entry is None:
            self.entry = _handler_type()(self.answer)
            self.before = _library().signal(signal.SIGBUS, self.entry)

    def answer(self, _signal: int) -> None:
        """Mend what was cut; leave what no cut explains, such as a failing disk, to whoever answered before."""
        mappings = list(self.mappings)
        if any(mapping.mend() for mapping in mappings if mapping in self.mappings):
            return
        self.in_vain += 1
        if self.in_vain > _MOST_IN_VAIN or not any(mapping.is_cut for mapping in mappings):
            _library().signal(signal.SIGBUS, ctypes.cast(self.before or 0, _handler_type()))


_GUARD: Final = _Guard()


@cache
def _handler_type() -> Any:
    return ctypes.CFUNCTYPE(None, ctypes.c_int)


@cache
def _library() -> Any:
    """Return the C library, with the signatures of what is called."""
    library = ctypes.CDLL(None)
    library.mmap.restype = ctypes.c_void_p
    library.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, *(ctypes.c_int,) * 3, ctypes.c_long)
    library.signal.restype = ctypes.c_void_p
    library.signal.argtypes = (ctypes.c_int, _handler_type())
    return library


def keep_readable(address: int, size: int, descriptor: int) -> Mapping:
    """Let a mapped file read as zeros where it is cut, until `forget`."""
    mapping = Mapping(address, size, descriptor)
    if hasattr(signal, "SIGBUS"):  # Windows lets nobody cut a mapped file
        _GUARD.add(mapping)
    return mapping


def forget(mapping: Mapping) -> None:
    """Close a file that nobody reads any more."""
    if mapping in _GUARD.mappings:
        _GUARD.mappings.remove(mapping)
    os.close(mapping.descriptor)


_HINT: Final = "read it when nothing writes there any more, or read a copy of it"
_NOT_WAITING: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""A pipe that nobody writes to would be waited for without end."""
_PIECE: Final = 1 << 20


class Digest(NamedTuple):
    """What a pass over all bytes of a file gives: SHA-256 in hexadecimal, and checksums that are not of their bytes."""

    sha256: str
    damages: list[Damage]


class UnusableFileError(LogError):
    """A file of which nothing can be used: it is of no format that is read, or no part of it can be believed."""


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
            many = isinstance(error, OSError) and error.errno == errno.EMFILE
            hint = "each part of a dive stays open; raise the limit with `ulimit -n`" if many else "check the path"
            raise LogError(f"cannot be read: {reason}", hint, path) from error
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

    def digest(self, section_end: int, section_crc: int) -> Digest:
        """Digest all bytes from start to end, whatever bears the file's name by now, and check those of the messages.

        The file is read once in pieces, which takes no memory and leaves other threads alone.
        """
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        file, digest, piece = FileIO(self._descriptor, closefd=False), hashlib.sha256(), bytearray(_PIECE)
        crc, left = 0, section_end if section_crc else 0
        while count := file.readinto(piece):
            part = memoryview(piece)[:count]
            digest.update(part)
            if left > 0:
                crc = zlib_ng.crc32(part[:left], crc)
                left -= count
        text = "the checksum of all messages is not that of their bytes; some may be wrong"
        return Digest(digest.hexdigest(), [] if crc == section_crc else [Damage(section_end, text)])

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
        """State in a few words what has become of the file; nothing if all is as it was."""
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
    b"#ROSBAG V1": ("a bag of ROS 1 before 2010", "`rosbag fix` writes it as version 2.0"),
    b"\x28\xb5\x2f\xfd": ("compressed as a whole with zstd", "`zstd -d {path}` unpacks it"),
}


def require_mcap(file: MappedFile) -> None:
    """Refuse a file that is no MCAP file, which it is, too, if only its opening bytes are damaged."""
    start = bytes(file.data[:16])
    if not start.startswith(MAGIC) and not _goes_on_like_mcap(file.data):
        raise _not_mcap(file.path, start)


def _goes_on_like_mcap(data: memoryview) -> bool:
    """Return whether a header stands behind the opening bytes, or the closing ones are there."""
    opcode, length = struct.unpack("<BQ", bytes(data[len(MAGIC) : _HEADER_CONTENT]).ljust(RECORD_HEADER_SIZE, b"\0"))
    is_header = opcode == Opcode.HEADER and can_be_record(opcode, length) and length <= len(data) - _HEADER_CONTENT
    return is_header or bytes(data[-len(MAGIC) :]) == MAGIC


def _not_mcap(path: Path, start: bytes) -> LogError:
    other = other_format(path, start)
    if other is not None:
        return LogError(f"is {other.name}, which is not read", other.step, path)
    for magic, (name, hint) in _OTHER_FORMATS.items():
        if start.startswith(magic):
            return LogError(f"is {name}, which is not read", hint.format(path=path), path)
    found = start[:8].hex(" ")
    what = f"is not an MCAP file, nor a bag: it starts with bytes '{found}'"
    return UnusableFileError(what, "name an .mcap, .db3 or .bag file", path)
