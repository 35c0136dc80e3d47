"""What the program says, as text that stands in a golden file."""

import contextlib
import io
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.errors import Note, UserError, visible_lines

Cases = Iterator[tuple[str, str]]
"""Names of cases, and what is said in each."""


def refusal(call: Callable[..., Any], *arguments: Any, **keywords: Any) -> str:
    """Return kind, exit code, sentence and hint of the mistake that a call must end with."""
    try:
        call(*arguments, **keywords)
    except UserError as error:
        hint = f"\nhint: {error.hint}" if error.hint else ""
        return f"{type(error).__name__} {error.exit_code}: {error.message}{hint}"
    raise AssertionError("nothing was refused")


def noted(notes: Iterable[Note]) -> str:
    """Return what is said in each note, with code, severity and count."""
    return "\n".join(
        f"{note.severity} {note.code} [{note.count}]: {note.text}"
        + (f"\nhint: {note.hint}" if note.hint else "")
        for note in notes
    )


def spoken(folder: Path, *arguments: str) -> str:
    """Return exit code, stdout and stderr of a command that runs in this process, in a folder."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = run_command_line(list(arguments))
    return f"exit code {code}\n{out.getvalue()}{err.getvalue()}".rstrip("\n")


def golden_text(cases: Iterable[tuple[str, str]], folder: Path) -> str:
    """Join cases to the text of a golden file, without what differs from one machine to the next."""
    text = "\n".join(f"=== {name}\n{said}\n" for name, said in cases).replace(
        str(folder), "FOLDER"
    )
    text = re.sub(r"in line \d+ of \S+/", "in line N of ", text)
    return visible_lines(re.sub(r"(.)\1{99,}", r"\1...", text))
