"""Print results to stdout, everything else to stderr, and turn errors into messages."""

import inspect
import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

import typer

from insdvl_replay.core.errors import (
    LogError,
    Note,
    UserError,
    as_shown,
    counted,
    most_like,
    visible,
    visible_lines,
    without_commands,
)
from insdvl_replay.core.runtime import is_out_of_memory, memory_limit

INTERNAL_ERROR = 4
USAGE = 2
MOST_FINDINGS = 6  # lines; with that of the others and how to repeat it, these are eight

# typer exports no UsageError, and includes click since 0.20. This finds the class in both cases.
UsageError = typer.BadParameter.__mro__[1]
_PLAIN_WORDS: Final = (
    (r"Usage: .*", "missing command"),
    (r": Value error, ", ": "),
    (r"Input should be greater than or equal to", "must be at least"),
    (r"Input should be less than or equal to", "must be at most"),
    (r"Input should be greater than", "must be above"),
    (r"Input should be less than", "must be below"),
    (r"Input should be a valid integer.*", "needs a whole number"),
    (r"Input should be a valid number.*", "needs a number"),
)
"""Phrases of typer and its value checks, with plain ones. They differ between versions."""
_ALIKE_OPTIONS: Final = 0.75
"""Share of letters that a misspelled option has in common with the one that was meant."""


def write_stdout(text: str, *, commands: bool = False) -> None:
    """Write a result to stdout. If the reader has closed the pipe (``| head``), the work continues silently."""
    try:
        sys.stdout.write(text if commands else without_commands(text))
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def log_to_stderr(text: str) -> None:
    """Report something that is not a result, on one line."""
    with suppress(OSError):  # stderr is closed
        print(without_commands(visible(as_shown(text))), file=sys.stderr, flush=True)


def log_info(text: str) -> None:
    """Report something that the user may want to know."""
    log_to_stderr(f"info: {text}")


def log_notes(notes: Iterable[Note], *, verbose: bool, dive: str = "") -> None:
    """Report the warnings; all notes if verbose. Of several dives each names its own."""
    whose = f"{dive}: " if dive else ""
    for note in notes:
        if verbose or note.severity == "warning":
            log_to_stderr(f"{note.severity}: {whose}{note.text} [{note.code}]{_hinted(note.hint)}")


def log_failure(error: Exception, verbosity: int) -> int:
    """Print an error with its hint, with ``-vv`` also the traceback; return the exit code."""
    if verbosity >= 2:
        trace = "".join(traceback.format_exception(error))
        with suppress(OSError):
            print(
                without_commands(visible_lines(as_shown(trace))),
                end="",
                file=sys.stderr,
                flush=True,
            )
    code, message, hint = _explained(error)
    log_to_stderr(f"error: {message}{_hinted(hint)}")
    return code


def exit_code_of(error: Exception) -> int:
    """Return the exit code of an error."""
    code, _, _ = _explained(error)
    return code


def log_findings(notes: Iterable[Note], file: Path) -> None:
    """Print what was found or assumed of a vehicle without settings, or without a noise, warnings first."""
    findings = [note for note in notes if note.is_finding]
    for note in findings[:MOST_FINDINGS]:
        log_to_stderr(note.finding)
    if more := findings[MOST_FINDINGS:]:
        log_to_stderr(
            f"found: {counted(len(more), 'more setting')}, in the report and in {file.name}"
        )
    if findings and file.is_file():
        log_to_stderr(f"to repeat it: -c {shlex.quote(str(file))}")


def _hinted(hint: str) -> str:
    """Return the hint for the same line: scripts read the reason from the last line of stderr."""
    if hint:
        return f"; hint: {hint}"
    return ""


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
    if is_out_of_memory(error):
        return LogError.exit_code, *_not_enough_memory(str(error))
    if isinstance(error, OSError):
        found = (
            f"{error.filename or 'stdout'}: cannot be read or written: {error.strerror or error}"
        )
        return USAGE, found, "check the path, its permissions and the free disk space"
    return (
        INTERNAL_ERROR,
        f"internal error: {type(error).__name__}: {error}",
        "run it again with -vv and report the output, with that of `insdvl-replay --version`",
    )


def _option_meant(option: str, context: Any) -> str:
    """Return the option that was probably meant, with its value where the word is one: --json is --format json."""
    word = option.lstrip("-")
    parameters = context.command.params if context else []
    kinds = get_type_hints(inspect.unwrap(context.command.callback)) if parameters else {}
    for parameter in parameters:
        if word in _allowed_words(kinds.get(parameter.name)):
            return f"{max(parameter.opts, key=len)} {word}"
    names = {
        name.lstrip("-"): name
        for parameter in parameters
        for name in (*parameter.opts, *parameter.secondary_opts)
    }
    # Of short words many are alike by chance, as json and geojson are.
    found = most_like(
        word, [name for name in names if len(name) > 1], most=1, least=_ALIKE_OPTIONS
    )
    return names[found[0]] if found else ""


def _allowed_words(kind: Any) -> list[str]:
    """Return the words that a type allows, such as ``Literal["json", "csv"] | None``."""
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    return [word for inner in get_args(kind) for word in _allowed_words(inner)]


def _not_enough_memory(reason: str = "") -> tuple[str, str]:
    """Return the sentence and the hint for a lack of memory."""
    limit = memory_limit()
    within = "" if limit is None else f" within the limit of {limit / 1e6:.0f} MB"
    hint = (
        "use a machine with more memory"
        if limit is None
        else "raise the limit of this shell with `ulimit -v`"
    )
    return f"there is not enough memory{within}{f': {reason}' if reason else ''}", hint


def _explained_usage(error: Any) -> tuple[str, str]:
    """Return the message and the hint of an error of the parser."""
    text = " ".join(str(error.format_message()).split())
    for pattern, words in _PLAIN_WORDS:
        text = re.sub(pattern, words, text)
    context = getattr(error, "ctx", None)
    hint = f"`{context.command_path if context else 'insdvl-replay'} --help` lists commands, arguments and options"
    if option := getattr(error, "option_name", ""):
        text = re.sub(r" \(Possible options: .*\)| Did you mean .*\?", "", text)
        meant = _option_meant(option, context)
        hint = f"did you mean {meant}?" if meant else hint
    elif suggested := re.search(r"\. Did you mean '([^']+)'\?$", text):
        text = text[: suggested.start()]
        hint = f"did you mean {suggested[1]}?"
    elif choices := re.search(r"\.? Choose from: ", text):
        text, hint = text[: choices.start()], f"one of: {text[choices.end() :]}"
    return text[:1].lower() + text[1:].rstrip("."), hint
