"""The command line in the process of the tests, where a process of its own is not what is tested."""

import contextlib
import io
import subprocess
from pathlib import Path

from insdvl_replay.cli import run_command_line


def done_here(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder, as a process would: a process takes a second to load what is loaded here."""
    words = [str(argument) for argument in arguments]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_command_line(words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())
