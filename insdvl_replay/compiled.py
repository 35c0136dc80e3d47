"""Compile loops with numba, and keep what was compiled on disk.

numba notices a change in the file of a function, but not in the files of the functions that it calls. The cache
therefore lies in a folder named after the digest of all compiled sources: other sources, other folder.

Environment
-----------
INSDVL_REPLAY_CACHE : folder for compiled code; default ``~/.cache/insdvl-replay``. Where it cannot be written, each
    process compiles for itself.
NUMBA_DISABLE_JIT=1 : run the same functions as plain Python, to step through them with a debugger.
"""

import os
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

from insdvl_replay.sources import sources_digest

_P = ParamSpec("_P")
_T = TypeVar("_T")


_SOURCES: Final = ("nav/*.py", "earth.py", "logs/record*.py")
"""Where compiled functions, and what they are made of, stand."""


def _cache_folder() -> str | None:
    try:
        base = os.environ.get("INSDVL_REPLAY_CACHE") or Path.home() / ".cache" / "insdvl-replay"
        folder = Path(base) / f"compiled-{sources_digest(_SOURCES)}-numba-{version('numba')}"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)
    except (OSError, RuntimeError):  # no place to write, or a user without a home
        return None


_FOLDER = _cache_folder()


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function on its first call and keep the machine code on disk."""
    import numba  # half a second, which whoever only asks whether the cache is warm must not wait
    from numba.core import config

    settings: Any = config  # numba reads the folder while it decorates
    before = settings.CACHE_DIR
    settings.CACHE_DIR = _FOLDER or before
    try:
        return cast(Callable[_P, _T], numba.njit(cache=_FOLDER is not None, error_model="numpy", nogil=True)(function))
    finally:
        settings.CACHE_DIR = before


def is_warm() -> bool:
    """Say whether the compiled filter waits on disk, so that a first run can explain what it waits for."""
    return _FOLDER is not None and any(Path(_FOLDER).rglob("*.nbc"))
