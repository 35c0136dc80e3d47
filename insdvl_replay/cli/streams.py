"""Stdout and stderr: where one of them is full or closed, the output ends, and not the work."""

import io
import os
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

LOST_OUTPUT: Final = 2
"""Exit code of a run whose output was lost in part."""


class Outlet(io.RawIOBase):
    """A descriptor that takes whatever is written, and remembers why some of it was lost.

    Parameters
    ----------
    is_closed : bool
        It was closed by whoever started the program.

    Attributes
    ----------
    lost : str
        The reason; empty if all went out, or if the reader went away (``| head``), who wants no more.
    """

    def __init__(self, descriptor: int, *, is_closed: bool) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._is_closed = is_closed
        self._is_deserted = False
        self.lost = ""

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return os.isatty(self._descriptor)

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write what can be written. After something was lost nothing more is: half a table is worse than none."""
        if self._is_closed:
            self.lost = "it is closed"
        if not (self.lost or self._is_deserted):
            try:
                return os.write(self._descriptor, data)
            except BrokenPipeError:
                self._is_deserted = True
            except OSError as error:
                self.lost = error.strerror or str(error)
        return memoryview(data).nbytes


def open_outlets() -> tuple[Outlet, Outlet]:
    """Put outlets below stdout and stderr."""
    closed = sys.stdout is None, sys.stderr is None
    # Files that are opened later must not get the number of a closed stream, and what is meant for it.
    while (spare := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(spare, True)
    os.close(spare)
    out, err = (Outlet(number, is_closed=is_closed) for number, is_closed in zip((1, 2), closed, strict=True))
    sys.stdout = _as_text(out, sys.stdout, line_buffering=out.isatty())
    sys.stderr = _as_text(err, sys.stderr, line_buffering=True)
    return out, err


def _as_text(outlet: Outlet, stream: "io.TextIOBase | object", *, line_buffering: bool) -> io.TextIOWrapper:
    """Return an outlet as text, with the encoding of the stream whose place it takes."""
    encoding, errors = getattr(stream, "encoding", "utf-8"), getattr(stream, "errors", "backslashreplace")
    return io.TextIOWrapper(io.BufferedWriter(outlet), encoding, errors, line_buffering=line_buffering)


def report_lost_output(out: Outlet, err: Outlet) -> int:
    """Report on stderr what was lost of stdout, and return the exit code of that: 0 if nothing was lost."""
    sys.stdout.flush()
    if out.lost:
        print(f"error: stdout: cannot be written: {out.lost}; hint: `> FILE`, on a disk with room", file=sys.stderr)
    sys.stderr.flush()
    return LOST_OUTPUT if out.lost or err.lost else 0
