"""The command line: it parses, calls, prints and exits. Only this package prints and sets exit codes.

0 done; 1 a limit is exceeded; 2 usage or configuration; 3 a log or a stored result cannot be used; 4 internal error;
130 interrupted.
"""

import os
import signal
import sys
import warnings
from types import FrameType
from typing import NoReturn

from insdvl_replay.core.runtime import prepare_process

INTERRUPTED = 130
LOST_OUTPUT = 2


def main() -> NoReturn:
    """Run the command line and leave with its exit code."""
    signal.signal(signal.SIGTERM, _interrupt)
    prepare_process()
    # numpy's overflow warnings would point to lines of this package. Values that are not finite get a note or a status.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))  # noqa: PTH123, SIM115
    code = run_command_line(sys.argv[1:])
    # Under ``python -m``, an interruption within an `exec` would end Python with SIGINT; another one takes that back.
    exec("")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is exiting already; keep its exit code
    try:
        if code == INTERRUPTED:
            print("error: interrupted", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:  # already reported, or stderr is closed
        code = code or LOST_OUTPUT
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
    sys.exit(code)


def run_command_line(arguments: list[str]) -> int:
    """Run one command, and return its exit code."""
    try:
        # Imported here, so that an interrupt during the import is reported, too.
        from insdvl_replay.cli.app import app
        from insdvl_replay.cli.messages import log_failure, typed_verbosity

        try:
            return int(app(arguments, prog_name="insdvl-replay", standalone_mode=False) or 0)
        except Exception as error:
            return log_failure(error, typed_verbosity(arguments))
    except SystemExit as leaving:  # shell completion exits this way
        return int(leaving.code or 0)
    except KeyboardInterrupt:
        return INTERRUPTED


def _interrupt(_signal: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt
