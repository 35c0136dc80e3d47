"""The command line: it parses, calls, prints and exits. Only this package prints and sets exit codes.

0 done; 1 a limit is exceeded; 2 usage or configuration; 3 a log or a stored result cannot be used; 4 internal error;
130 interrupted.
"""

import os
import signal
import sys
import warnings

from insdvl_replay.core.interrupts import handle_signals, interruptible, was_interrupted

TYPE_CHECKING = False  # as in `typing`, whose import would delay the handling of signals
if TYPE_CHECKING:
    from typing import NoReturn

INTERRUPTED = 130
LOST_OUTPUT = 2
NO_MEMORY = 3


def main() -> "NoReturn":
    """Run the command line and leave with its exit code."""
    handle_signals()
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: PTH123, SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: PTH123, SIM115
    try:
        with interruptible():
            code = _prepared_and_run()
    except KeyboardInterrupt:
        code = INTERRUPTED
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


def _prepared_and_run() -> int:
    # Imported here, so that signals are handled already.
    from insdvl_replay.core.processor import use_common_code
    from insdvl_replay.core.runtime import prepare_process

    use_common_code()  # the processes that this one starts inherit it
    prepare_process()
    # numpy's overflow warnings would point to lines of this package. Values that are not finite get a note or a status.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    return run_command_line(sys.argv[1:])


def run_command_line(arguments: list[str]) -> int:
    """Run one command, and return its exit code."""
    try:
        # Imported here, so that an interrupt during the import is reported, too.
        from insdvl_replay.cli.app import app
        from insdvl_replay.cli.messages import log_failure, typed_verbosity

        try:
            return int(app(arguments, prog_name="insdvl-replay", standalone_mode=False) or 0)
        except Exception as error:
            if was_interrupted():  # a library made another error of the interrupt
                return INTERRUPTED
            return log_failure(error, typed_verbosity(arguments))
    except SystemExit as leaving:  # shell completion exits this way
        return int(leaving.code or 0)
    except (ImportError, MemoryError, OSError):  # of the modules that would say so
        print(
            "error: there is not enough memory; hint: raise the limit with `ulimit -v`",
            file=sys.stderr,
        )
        return NO_MEMORY
    except KeyboardInterrupt:
        return INTERRUPTED
