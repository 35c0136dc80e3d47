"""What the tool prints: results to stdout, everything else to stderr."""

import sys
import traceback
from collections.abc import Iterable

import typer

from insdvl_replay.core.errors import LogError, Note, UserError
from insdvl_replay.core.plain_text import visible, visible_lines, without_commands
from insdvl_replay.core.runtime import is_nearly_used_up

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
    """Report what went wrong, in one sentence and a hint, and with ``-vv`` where in the code it arose."""
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
    sentence = str(error.format_message()).strip().replace("\n", " ")  # type: ignore[attr-defined]
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "insdvl-replay"
    return 2, sentence[:1].lower() + sentence[1:].rstrip("."), f"`{command} --help` shows what it takes"
