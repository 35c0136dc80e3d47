"""Mapped files that another program cuts: what is gone reads as zeros, where the system would kill the process.

To touch a mapped page behind the end of its file raises SIGBUS in the thread that does. The handler maps zeros in place
of the pages that are gone, and the thread goes on. That a file was cut is found out as it is compared with what it was.
Source: POSIX.1-2017, mmap(): "references within the address range ... following the end of an object".
"""

import ctypes
import mmap
import os
import signal
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

_FIXED: Final = 0x10
"""MAP_FIXED, which Python does not name: on Linux, macOS and the BSDs alike."""
_MOST_IN_VAIN: Final = 1000
"""Faults without a further cut, such as those of threads that fault together, before they are left to the system."""


@dataclass
class Mapping:
    """Where a file stands in memory.

    Attributes
    ----------
    address : int
        Of its first byte.
    size : int
        Bytes that are mapped and still the file's.
    is_cut : bool
        Whether some of them are zeros by now.
    """

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
    """Give the C library, with the signatures of what is called."""
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
