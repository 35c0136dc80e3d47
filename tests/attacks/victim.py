"""One command on one log in a forked child, and what is to be said of how it went.

The child shares all that this process has imported and compiled; it is forked from `ready`.
"""

import contextlib
import json
import os
import resource
import signal
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from insdvl_replay.cli import run_command_line
from insdvl_replay.results.folder import DIVE_FILES

LIMIT_S = 30
"""Processor time that a command may take; others may use the machine, too."""
PATIENCE_S = 180
"""After which a command is taken to wait for what never comes."""
BEYOND_MB = 400.0
"""Memory that a damaged log may take beyond what the clean one took."""
ADDRESS_SPACE = 6 << 30
"""Protects the machine, not the verdict: what takes more has failed already."""
INTERNAL_ERROR = 4
DEFECTS = (
    *(
        "traceback",
        "exit 4",
        "hang",
        "memory",
        "killed by signal",
        "leftovers",
        "no sentence",
        "differs unnoted",
    ),
)
HARMLESS = ("differs, unprotected", "differs, other content", "differs, noted", "ok")


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
        The exit code, or minus the number of the signal that ended it.
    peak_mb : float
    said : str
        All of its stderr.
    """

    code: int
    peak_mb: float
    said: str


@dataclass(frozen=True)
class Result:
    """What a command left behind.

    Attributes
    ----------
    tables : dict of str to bytes
        Content of each CSV.
    notes : dict of str to str
        Texts of the notes by code.
    """

    tables: dict[str, bytes]
    notes: dict[str, str]


def ready(commands: list[list[str]]) -> None:
    """Prepare this process as the program prepares itself, and load all that the commands need."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    for command in commands:
        with (
            contextlib.redirect_stdout(StringIO()),
            contextlib.redirect_stderr(StringIO()) as said,
        ):
            code = run_command_line(command)
        if code:
            raise SystemExit(f"the clean log fails: {' '.join(command)}: {said.getvalue()}")


def run_forked(
    command: list[str] | Callable[[], int], said: Path, printed: Path = Path(os.devnull)
) -> Ended:
    """Run a command, or a function that returns an exit code, in a forked child, which the system ends in time."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _live(command, said, printed)
    _, status, usage = os.wait4(child, 0)
    return Ended(
        os.waitstatus_to_exitcode(status),
        usage.ru_maxrss / 1024,
        said.read_text("utf-8", "replace"),
    )


def _live(command: list[str] | Callable[[], int], said: Path, printed: Path) -> None:
    """Be the child."""
    signal.alarm(PATIENCE_S)
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S + 1))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    try:
        for number, path in ((1, printed), (2, said)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        code = command() if callable(command) else run_command_line(command)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    finally:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(INTERNAL_ERROR)


def last_line(said: str) -> str:
    """Return the start of the last line that was said, which is that of an error."""
    return said.rstrip("\n").rpartition("\n")[2][:300]


def result_of(folder: Path) -> Result | None:
    """Read a result; None where there is none that is whole."""
    if not all((folder / name).is_file() for name in DIVE_FILES):
        return None
    notes: dict[str, str] = {}
    for note in json.loads((folder / "report.json").read_text("utf-8"))["notes"]:
        notes[note["code"]] = notes.get(note["code"], "") + note["text"]
    return Result({path.name: path.read_bytes() for path in folder.glob("*.csv")}, notes)


def verdict(ended: Ended, clean_mb: float) -> str:
    """Judge how a command ended, whatever it left."""
    if ended.code in (-signal.SIGALRM, -signal.SIGXCPU, -signal.SIGKILL):
        return "hang"
    if ended.peak_mb > clean_mb + BEYOND_MB:
        return "memory"
    if ended.code < 0:
        return "killed by signal"
    if "Traceback (most recent call last)" in ended.said:
        return "traceback"
    if ended.code == INTERNAL_ERROR:
        return "exit 4"
    last = ended.said.rstrip("\n").rpartition("\n")[2]
    if ended.code and not (last.startswith("error: ") and len(last) > len("error: ") + 10):
        return "no sentence"
    return "ok"


def verdict_on_result(
    ended: Ended, folder: Path, clean: Result, *, protected: bool, same_content: bool
) -> str:
    """Judge what `run` left: a whole result of what the clean log says, or nothing at all.

    Parameters
    ----------
    ended : Ended
    folder : Path
        Where results were to lie; held nothing before.
    clean : Result
        Of the log that is whole.
    protected : bool
        Whether a checksum stands over every message.
    same_content : bool
        Whether the log still says what the clean one says, wherever its bytes are whole.
    """
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    if ended.code:
        return "leftovers" if found else "ok"
    result = result_of(found[0]) if len(found) == 1 else None
    if result is None:
        return "leftovers"
    if result.tables == clean.tables:
        return "ok"
    if result.notes.items() - clean.notes.items():
        return "differs, noted"
    if not same_content:
        return "differs, other content"
    return "differs unnoted" if protected else "differs, unprotected"
