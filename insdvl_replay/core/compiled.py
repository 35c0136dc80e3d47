"""Compile loops with numba, and keep what was compiled on disk.

numba notices a change in the file of a function, but not in the files of the functions that it calls. The cache
therefore lies in a folder named after the digest of all compiled sources: other sources, other folder.

Environment
-----------
INSDVL_REPLAY_CACHE : folder for compiled code; default ``~/.cache/insdvl-replay``. What ``insdvl-replay compile`` left
    there is used even where nothing can be written, as in a container; if nothing is there, each process compiles for
    itself. The files are code: who can write them runs what he likes in every process that loads them. A folder that
    others than the user and root own or can write is not used.
NUMBA_DISABLE_JIT=1 : run the same functions as plain Python, to step through them with a debugger.
"""

import atexit
import os
import shutil
import stat
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

from insdvl_replay.core.runtime import sources_digest

_P = ParamSpec("_P")
_T = TypeVar("_T")


_SOURCES: Final = (
    "nav/*.py",
    "geometry/*.py",
    "logs/container/records.py",
    "logs/**/*_loops.py",
    "core/compiled.py",
)
"""Where compiled functions, what they are made of, and how they are compiled, stand."""


_COMPILED_BYTES: Final = 1 << 20
"""About as large is the filter's code."""

# Nobody calls the compiled functions from C; the compiler need not make entries for it.
_OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def usual_folder() -> Path:
    """Return the folder in which the code of these sources is looked for, and kept if that can be."""
    base = os.environ.get("INSDVL_REPLAY_CACHE") or Path.home() / ".cache" / "insdvl-replay"
    return Path(base) / f"compiled-{sources_digest(_SOURCES)}-numba-{version('numba')}"


def _cache_folder() -> Path | None:
    try:
        folder = usual_folder()
    except RuntimeError:
        return None
    writable = can_write(folder)
    if not (_is_trusted(folder) and _is_trusted(folder.parent)):
        return None
    if writable:
        return folder
    return copied(folder) if _holds_code(folder) else None


def can_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, which is made if need be."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=stat.S_IRWXU, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_COMPILED_BYTES))  # a full disk lets files be made, too
            return True
    except OSError:
        return False


def _is_trusted(folder: Path) -> bool:
    """Return whether nobody but the user and root can put files into a folder, or folders where theirs stand."""
    if not folder.is_dir() or not hasattr(os, "geteuid"):
        return True
    found = folder.stat()
    by_all = found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX
    # Many systems give each user a group of his own, and let it write.
    by_others = found.st_mode & stat.S_IWGRP and found.st_gid not in (0, os.getegid())
    return found.st_uid in (0, os.geteuid()) and not by_all and not by_others


def copied(folder: Path) -> Path | None:
    """Copy a folder to where it can be written, since numba reads from no other; it is gone with the process."""
    try:
        copy = Path(tempfile.mkdtemp(prefix="insdvl-replay-"))
        atexit.register(shutil.rmtree, copy, ignore_errors=True)
        return Path(shutil.copytree(folder, copy, dirs_exist_ok=True))
    except OSError:
        return None


def _holds_code(folder: Path) -> bool:
    return any(folder.rglob("*.nbc"))


_FOLDER: Final = _cache_folder()


_NUMBA_SETTINGS: Final = threading.Lock()


def _kept(function: Callable[..., Any]) -> Any:
    """Return numba's cache for a function. What it cannot read is compiled again; what it cannot write is not kept."""
    from numba.core.caching import FunctionCache

    class KeptCode(FunctionCache):
        def load_overload(self: Any, sig: Any, target_context: Any) -> Any:
            try:
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except Exception:  # a damaged pickle raises anything; without its index it is written again
                with suppress(OSError):
                    self.flush()
                return None

        def save_overload(self: Any, sig: Any, data: Any) -> None:
            with suppress(OSError):
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    return KeptCode(function)  # type: ignore[no-untyped-call]


def kept_nowhere() -> str:
    """Say why compiled code cannot be kept; empty where it is."""
    if _FOLDER is not None:
        return ""
    try:
        folder = usual_folder().parent
    except RuntimeError:
        return "the user has no home folder"
    return f"{folder} cannot be written" if not can_write(usual_folder()) else f"others can write to {folder}"


def is_loaded() -> bool:
    """Return whether the compiler is loaded and switched on; else a few numbers are dealt with sooner without it."""
    settings = sys.modules.get("numba.core.config")
    return settings is not None and not getattr(settings, "DISABLE_JIT", True)


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function that Python calls, on its first call, and keep the machine code on disk."""
    import numba  # half a second, which whoever only asks whether the cache is warm must not wait
    from numba.core import config

    settings: Any = config  # numba reads the folder while it decorates
    with _NUMBA_SETTINGS:
        before = settings.CACHE_DIR
        settings.CACHE_DIR = str(_FOLDER or before)
        try:
            dispatcher = numba.njit(**_OPTIONS)(function)
            if _FOLDER is not None and not settings.DISABLE_JIT:
                dispatcher._cache = _kept(function)  # what `cache=True` does
            return cast(Callable[_P, _T], dispatcher)
        finally:
            settings.CACHE_DIR = before


def inlined(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Let a function become a part of the compiled ones that call it; where Python calls it, it is plain Python.

    As calls, many of them would hand dozens of numbers over in memory, and the filter would take a quarter longer; with
    entries for Python, it would take twice as long to compile.
    """
    from numba.extending import register_jitable

    return register_jitable(forceinline=True, **_OPTIONS)(function)


def plain(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Return what a compiled function was made of, to be run as it is."""
    return cast(Callable[_P, _T], getattr(function, "py_func", function))


def is_compiled(function: Callable[..., Any]) -> bool:
    """Return whether compiled code can call a function of the user's."""
    return hasattr(function, "address")


def is_warm() -> bool:
    """Return whether the compiled filter waits on disk, so that a first run can explain what it waits for."""
    return _FOLDER is not None and any(_FOLDER.rglob("filter._run-*.nbc"))


def cache_folder() -> Path | None:
    """Return the folder of the compiled code, or None where none can be kept."""
    return _FOLDER
