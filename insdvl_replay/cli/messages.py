"""What the tool prints: results to stdout, everything else to stderr."""

import io
import os
import sys
import traceback
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import typer

from insdvl_replay.cli.usage import usage_explained
from insdvl_replay.core.errors import LogError, Note, UserError
from insdvl_replay.core.plain_text import visible, visible_lines, without_commands
from insdvl_replay.core.runtime import Interruption, is_nearly_used_up

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


OUR_MISTAKE = 4

# typer exports no UsageError, and keeps click inside itself since 0.20: this finds the class wherever it lives.
UsageError = typer.BadParameter.__mro__[1]


def write_stdout(text: str, *, commands: bool = False) -> None:
    """Write a result to stdout."""
    sys.stdout.write(text if commands else without_commands(text))
    sys.stdout.flush()


def log_to_stderr(text: str) -> None:
    """Report something that is not a result, on one line."""
    print(without_commands(visible(text)), file=sys.stderr, flush=True)


def log_notes(notes: Iterable[Note], *, verbose: bool) -> None:
    """Report the warnings; all notes if verbose."""
    for note in notes:
        if verbose or note.severity == "warning":
            log_to_stderr(f"{note.severity}: {note.text} [{note.code}]{_hinted(note.hint)}")


def log_failure(error: Exception, verbosity: int) -> int:
    """Report what went wrong, in one sentence and a hint, and with ``-vv`` where in the code it arose.

    Raises
    ------
    Interruption
        There is one: what is interrupted as it is imported, or in a library that catches all, fails in ways of its own.
    """
    if Interruption.came:
        raise Interruption from error
    if verbosity >= 2:
        trace = "".join(traceback.format_exception(error))
        print(without_commands(visible_lines(trace)), end="", file=sys.stderr)
    code, message, hint = _explained(error)
    log_to_stderr(f"error: {message}{_hinted(hint)}")
    return code


def _hinted(hint: str) -> str:
    """Put the hint on the sentence's own line, since scripts take the last line of stderr for the reason."""
    return f"; hint: {hint}" if hint else ""


def typed_verbosity(arguments: Iterable[str]) -> int:
    """Count ``-v`` as it was typed, for failures outside a command."""
    short = (len(word) - 1 for word in arguments if word.startswith("-v") and set(word[1:]) == {"v"})
    return sum(short) + sum(word == "--verbose" for word in arguments)


def _explained(error: Exception) -> tuple[int, str, str]:
    if isinstance(error, UserError):
        return error.exit_code, error.message, error.hint
    if isinstance(error, UsageError):
        return _explained_usage(error)
    if isinstance(error, MemoryError) or is_nearly_used_up():
        found = f"there is not enough memory{f': {error}' if str(error) else ''}"
        return LogError.exit_code, found, "run it where a process may have more; `ulimit -v` shows a limit"
    return (
        OUR_MISTAKE,
        f"this is a mistake in insdvl-replay: {type(error).__name__}: {error}",
        "run it again with -vv and report what it prints, with the output of `insdvl-replay --version`",
    )


def _explained_usage(error: Exception) -> tuple[int, str, str]:
    """Bring the parser's errors into the form of all others."""
    context = getattr(error, "ctx", None)
    sentence, hint = usage_explained(
        str(error.format_message()),  # type: ignore[attr-defined]
        context.command_path if context is not None else "insdvl-replay",
        getattr(error, "option_name", ""),
        getattr(error, "possibilities", None) or (),
    )
    return 2, sentence, hint
