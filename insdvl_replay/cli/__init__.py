"""The door: it parses, calls, prints and exits. Nothing else prints, and exit codes are made here alone.

0 done; 1 a limit is exceeded; 2 usage or configuration; 3 a log or a stored result cannot be used; 4 a mistake of ours;
130 interrupted. An interruption after the code is decided, as the interpreter ends, does not change it.
"""

import os
import signal
import sys
import threading
import warnings
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from insdvl_replay.core.runtime import Interruption, collect_rarely, coming_again, use_small_pages

INTERRUPTED = 130
LONGEST_SHUTDOWN_S = 5.0


def main() -> NoReturn:
    """Run the command line and leave with its exit code."""
    code, lost_output = INTERRUPTED, 0
    try:
        _listen()
        collect_rarely()
        use_small_pages()
        # numpy's word on overflows would point to lines of ours; what is not finite is told by notes and status words.
        warnings.filterwarnings("ignore", category=RuntimeWarning)
        code, lost_output = _run_with_outlets(sys.argv[1:])
        _listen_no_more()
    except KeyboardInterrupt:  # a second one, or one between two lines
        _listen_no_more()
    except Exception:
        if not Interruption.came:
            raise
    if code == INTERRUPTED:
        print("error: interrupted", file=sys.stderr, flush=True)
        # A pool of workers that was interrupted may find its own pipes closed as the interpreter ends: no word on that
        # stands behind the reason.
        sys.unraisablehook = lambda _: None
        # On its way out the interpreter waits for threads, and they, without end, for a worker that was ended while it
        # sent its result.
        forced_exit = threading.Timer(LONGEST_SHUTDOWN_S, os._exit, (code,))
        forced_exit.daemon = True
        with suppress(RuntimeError):  # there may be no room for one more thread
            forced_exit.start()
    sys.exit(max(code, lost_output))


def _run_with_outlets(arguments: list[str]) -> tuple[int, int]:
    """Run one command; return its exit code, and that of output which could not be written."""
    # Imported here, as all that takes long, so that an interruption meanwhile finds who listens.
    from insdvl_replay.cli.messages import open_outlets, report_lost_output

    out, err = open_outlets()
    code = run_command_line(arguments)
    return code, report_lost_output(out, err)


def run_command_line(arguments: list[str]) -> int:
    """Run one command."""
    try:
        # Imported here, so that an interruption during the import is told like any other.
        from insdvl_replay.cli.app import app
        from insdvl_replay.cli.messages import log_failure, typed_verbosity

        try:
            return int(app(arguments, prog_name="insdvl-replay", standalone_mode=False) or 0)
        except Exception as error:
            return log_failure(error, typed_verbosity(arguments))
    except SystemExit as leaving:
        # The completion of the shell leaves in this way.
        return int(leaving.code or 0)
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception:
        # What is interrupted as it is imported, or in a library that catches all, fails in ways of its own.
        if Interruption.came:
            return INTERRUPTED
        raise


def _listen() -> None:
    """Let Ctrl-C and SIGTERM interrupt, but for a Ctrl-C that whoever started the program lets it ignore."""
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = coming_again(KeyboardInterrupt)


def _listen_no_more() -> None:
    """Leave with the code that is decided: all is written, and the interpreter alone has yet to end."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _interrupt(_signal: int, _frame: FrameType | None) -> NoReturn:
    Interruption.came = True
    raise Interruption
