"""Run the command line with ``python -m insdvl_replay``."""

# ruff: noqa: E402
import _signal  # type: ignore[import-not-found]

# until they are handled
_signal.pthread_sigmask(_signal.SIG_BLOCK, {_signal.SIGINT, _signal.SIGTERM})

import os
import sys

# Python looks for modules in the working folder first, which may hold files of others, beside dives.
_first = os.path.realpath(sys.path[0])
_own = os.path.realpath(os.path.join(os.path.dirname(__file__), os.pardir))  # noqa: PTH118, PTH120
if _first == os.path.realpath(os.curdir) and _first != _own and not sys.flags.safe_path:
    del sys.path[0]

from insdvl_replay.cli import main

main()
