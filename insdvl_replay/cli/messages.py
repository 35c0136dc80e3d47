"""What the tool prints: results to stdout, everything else to stderr; and what an error is told as."""

import os
import re
import sys
import traceback
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final

import typer

from insdvl_replay.core.errors import LogError, Note, UserError, nearest, visible, visible_lines, without_commands

INTERNAL_ERROR = 4
USAGE = 2

# typer exports no UsageError, and keeps click inside itself since 0.20: this finds the class wherever it lives.
UsageError = typer.BadParameter.__mro__[1]
_IN_OUR_WORDS: Final = (
    (r"Usage: .*", "missing command"),
    (r": Value error, ", ": "),
    (r"Input should be greater than or equal to", "has to be at least"),
    (r"Input should be less than or equal to", "has to be at most"),
    (r"Input should be greater than", "has to be above"),
    (r"Input should be less than", "has to be below"),
    (r"Input should be a valid integer.*", "needs a whole number"),
    (r"Input should be a valid number.*", "needs a number"),
)
"""Parts of sentences of typer and of what it checks values by, which changed from version to version."""


def write_stdout(text: str, *, commands: bool = False) -> None:
    """Write a result to stdout. Where the reader went away (``| head``) the work goes on in silence."""
    try:
        sys.stdout.write(text if commands else without_commands(text))
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def log_to_stderr(text: str) -> None:
    """Report something that is not a result, on one line."""
    with suppress(OSError):  # nobody is left to report to
        print(without_commands(visible(text)), file=sys.stderr, flush=True)


def log_notes(notes: Iterable[Note], *, verbose: bool) -> None:
    """Report the warnings; all notes if verbose."""
    for note in notes:
        if verbose or note.severity == "warning":
            log_to_stderr(f"{note.severity}: {note.text} [{note.code}]{_hinted(note.hint)}")


def log_failure(error: Exception, verbosity: int) -> int:
    """Report what went wrong, in one sentence and a hint, and with ``-vv`` where in the code it arose."""
    if verbosity >= 2:
        trace = "".join(traceback.format_exception(error))
        with suppress(OSError):
            print(without_commands(visible_lines(trace)), end="", file=sys.stderr, flush=True)
    code, message, hint = _explained(error)
    log_to_stderr(f"error: {message}{_hinted(hint)}")
    return code


def _hinted(hint: str) -> str:
    """Put the hint on the sentence's own line, since scripts take the last line of stderr for the reason."""
    return f"; hint: {hint}" if hint else ""


def typed_verbosity(arguments: Iterable[str]) -> int:
    """Count ``-v`` as it was typed, for failures outside a command."""
    short = (len(word) - 1 for word in arguments if re.fullmatch("-v+", word))
    return sum(short) + sum(word == "--verbose" for word in arguments)


def _explained(error: Exception) -> tuple[int, str, str]:
    """Return exit code, sentence and hint."""
    if isinstance(error, UserError):
        return error.exit_code, error.message, error.hint
    if isinstance(error, UsageError):
        return USAGE, *_explained_usage(error)
    if isinstance(error, OSError):
        found = f"{error.filename or 'stdout'}: cannot be read or written: {error.strerror or error}"
        return USAGE, found, "check the path, its permissions, and the room on its disk"
    if isinstance(error, MemoryError):
        found = f"there is not enough memory{f': {error}' if str(error) else ''}"
        return LogError.exit_code, found, "run it where a process may have more; `ulimit -v` shows a limit"
    return (
        INTERNAL_ERROR,
        f"this is a mistake in insdvl-replay: {type(error).__name__}: {error}",
        "run it again with -vv and report what it prints, with the output of `insdvl-replay --version`",
    )


def _explained_usage(error: Any) -> tuple[str, str]:
    """Bring the parser's errors into the form of all others."""
    told = " ".join(str(error.format_message()).split())
    for pattern, words in _IN_OUR_WORDS:
        told = re.sub(pattern, words, told)
    context = getattr(error, "ctx", None)
    hint = f"`{context.command_path if context else 'insdvl-replay'} --help` shows what it takes"
    if option := getattr(error, "option_name", ""):
        told = re.sub(r" \(Possible options: .*\)| Did you mean .*\?", "", told)
        meant = nearest(option, getattr(error, "possibilities", None) or ())
        hint = f"did you mean {meant}?" if meant else hint
    elif suggested := re.search(r"\. Did you mean '([^']+)'\?$", told):
        told, hint = told[: suggested.start()], f"did you mean {suggested[1]}?"
    elif choices := re.search(r"\.? Choose from: ", told):
        told, hint = told[: choices.start()], f"one of: {told[choices.end() :]}"
    return told[:1].lower() + told[1:].rstrip("."), hint
