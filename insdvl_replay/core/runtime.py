"""Compiled code and its cache, threads, memory, and reports of progress.

numba notices a change in the file of a function, but not in the files of the functions that it calls. The cache
folder is therefore named after the digest of all compiled sources.

Environment
-----------
INSDVL_REPLAY_CACHE : folder for compiled code; default ``~/.cache/insdvl-replay``. It may be read-only, as in a
    container. The files are code: anyone who can write them can run code in every process that loads them.
NUMBA_DISABLE_JIT=1 : run the same functions as plain Python, to step through them with a debugger.
"""

import gc
import os
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar, cast

from insdvl_replay.core.processor import (
    LEVEL,
    compile_common_code,
    has_common_code,
)

Item = TypeVar("Item")
Result = TypeVar("Result")
_P = ParamSpec("_P")
_T = TypeVar("_T")
# Called with a stage such as ``reading``, the number of steps done, and of all steps; 0 and 0 at its start.
Listener = Callable[[str, int, int], None]

_MANY_OBJECTS: Final = 200_000
_COMPILED_SOURCES: Final = ("nav/*.py", "geometry/*.py", "core/runtime.py", "core/states.py")
# No C code calls the compiled functions, so no C entry points are made.
_NUMBA_OPTIONS: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "nogil": True,
    "no_cfunc_wrapper": True,
}
_to_inline: list[Callable[..., Any]] = []  # what the compiler has not been told of yet
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


LEAST_BYTES: Final = 640 << 20
"""Address space in which numpy and the compiler can be loaded. With less, their C libraries end the process."""
LEAST_TO_COMPILE_BYTES: Final = 832 << 20
"""Address space in which the filter can be compiled: with less, the compiler ends the process."""
_FULL: Final = 0.5  # share of the limit that is taken when a library that needs a hundred megabytes finds no room
# address space in which one thread multiplies matrices: each needs a buffer
_LITTLE: Final = 4 << 30
_OF_LIBRARIES: Final = (ImportError, OSError, RuntimeError, SystemError)
_COMPILER: Final = ("numba", "llvmlite")


def prepare_process() -> None:
    """Set up a process that will replay dives, before numpy is imported.

    The packages create some hundred thousand permanent objects at import. Collecting garbage at every thousandth would
    take a tenth of a short run. Huge pages are slow to get from the host of a virtual machine, so they are off unless
    the user asks for them.
    """
    gc.set_threshold(_MANY_OBJECTS)
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    limit = memory_limit()
    if limit is not None and limit < _LITTLE:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def memory_limit() -> int | None:
    """Return the limit of this process's address space in bytes (``ulimit -v``), None without one."""
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return None
    return limit


def require_memory(least_bytes: int = LEAST_BYTES) -> None:
    """Require that the limit of this process leaves room for the libraries, or for the compiler.

    Raises
    ------
    MemoryError
        The limit of the address space is below so many bytes.
    """
    limit = memory_limit()
    if limit is not None and limit < least_bytes:
        raise MemoryError(f"at least {least_bytes / 1e6:.0f} MB are needed")


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error is, or hides, a lack of memory.

    Compilers and loaders of libraries raise errors of their own where the limit of the process leaves no room.
    """
    if isinstance(error, MemoryError):
        return True
    limit = memory_limit()
    is_of_library = (
        isinstance(error, _OF_LIBRARIES) or type(error).__module__.partition(".")[0] in _COMPILER
    )
    if limit is None or not is_of_library or getattr(error, "errno", None) is not None:
        return False
    return _most_taken() > _FULL * limit


def _most_taken() -> int:
    """Return the most address space that this process had, in bytes; 0 where the system does not say."""
    with suppress(OSError, ValueError), Path("/proc/self/status").open() as lines:
        for line in lines:
            if line.startswith("VmPeak:"):
                return int(line.split()[1]) << 10
    return 0


def return_freed_memory() -> None:
    """Return freed memory that glibc keeps to the system, about 80 MB after reading a long dive."""
    if sys.platform == "linux":
        import ctypes  # imported here: not needed at program start

        if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
            trim(0)


def parallel_map(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    jobs: int | None = None,
    stop: Callable[[], None] = lambda: None,
) -> Generator[Result, None, None]:
    """Do the work on each item in threads, and yield the results in the order of the items.

    The compiled filter and numpy's long loops release the interpreter lock. After an exception or an interrupt,
    ``stop`` is called, running items are finished and no more are started. By default one thread per core is used.
    A single item is done in this thread.
    """
    todo = list(items)
    if len(todo) <= 1:
        yield from _one_by_one(work, todo, stop)
        return
    from concurrent.futures import ThreadPoolExecutor  # imports logging

    executor = ThreadPoolExecutor(jobs or os.cpu_count())
    try:
        yield from executor.map(work, todo)
    except BaseException:
        stop()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _one_by_one(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    stop: Callable[[], None],
) -> Iterator[Result]:
    try:
        for item in items:
            yield work(item)
    except BaseException:
        stop()
        raise


def report_stage(stage: str) -> None:
    """Report the start of a stage, such as ``reading``, to the listener."""
    if (listener := _listener.get()) is not None:
        listener(stage, 0, 0)


@contextmanager
def one_stage(stage: str) -> Iterator[None]:
    """Report a stage of which no part is a stage of its own; the progress of its parts is reported as ever."""
    listener = _listener.get()
    if listener is None:
        yield
        return
    listener(stage, 0, 0)

    def report_progress(part: str, done: int, total: int) -> None:
        if total:
            listener(part, done, total)

    with progress_listener(report_progress):
        yield


def track_progress(stage: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield items, and report before each how many are done. Work that converges may stop early."""
    for done, item in enumerate(items):
        if (listener := _listener.get()) is not None:
            listener(stage, done, len(items))
        yield item


@contextmanager
def progress_listener(listener: Listener) -> Iterator[None]:
    """Call a listener with the progress of all work inside the block. Other processes do not report."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@cache
def sources_digest(patterns: tuple[str, ...] = ("**/*",)) -> str:
    """Return 16 digits of the SHA-256 of the package's files, which change in development without its version."""
    import hashlib

    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    paths: set[Path] = set()
    for pattern in patterns:
        paths.update(package.glob(pattern))
    for path in sorted(paths):
        if path.is_file() and path.parent.name != "__pycache__":
            digest.update(
                f"{path.relative_to(package).as_posix()}\0{path.stat().st_size}\0".encode()
            )
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Return the folder of the code that is compiled from these sources."""
    from importlib.metadata import version  # takes a tenth of the time of --help

    base = os.environ.get("INSDVL_REPLAY_CACHE") or Path.home() / ".cache" / "insdvl-replay"
    return Path(base) / f"compiled-{sources_digest(_COMPILED_SOURCES)}-numba-{version('numba')}"


def cache_key() -> str:
    """Name the compiled code of this Python and processor, for stores that keep it between machines."""
    processor = LEVEL
    if not has_common_code():
        from llvmlite.binding import get_host_cpu_name  # numba's compiler, without numba

        processor = get_host_cpu_name()
    return f"{cache_folder().name}-{sys.implementation.cache_tag}-{processor}"


def cache_problem() -> str:
    """Return why each run has to compile the filter; empty if compiled code is available or can be stored."""
    folder = cache_folder()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        if is_warm():
            return ""
        return f"{folder.parent} cannot be written"
    return ""


def is_warm() -> bool:
    """Return whether the compiled filter is on disk already."""
    return any(cache_folder().rglob("filter._run-*.nbc"))


@cache
def _cache_class() -> Any:
    """Return numba's cache in our folder. Unreadable code is compiled again; a failed write is ignored."""
    from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator

    class Locator(UserProvidedCacheLocator):
        def __init__(self, function: Any, file: str) -> None:
            self._py_file = file
            self._lineno = function.__code__.co_firstlineno
            self._cache_path = str(cache_folder() / self._subfolder(Path(file)))

        def _subfolder(self, file: Path) -> str:
            """Name the package's own code alike wherever it is installed: its digest has named the folder already."""
            package = Path(__file__).parents[1]
            if file.is_relative_to(package):
                return "_".join(file.parent.relative_to(package.parent).parts)
            return str(self.get_suitable_cache_subpath(str(file)))  # type: ignore[no-untyped-call]

        @classmethod
        def from_function(cls, function: Any, file: str) -> Any:
            return cls(function, file)

        def ensure_cache_path(self) -> None:
            Path(self._cache_path).mkdir(parents=True, exist_ok=True)

    class Implementation(CompileResultCacheImpl):
        _locator_classes = [Locator]  # noqa: RUF012

    class CodeCache(FunctionCache):
        _impl_class = Implementation

        def load_overload(self: Any, sig: Any, target_context: Any) -> Any:
            try:
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            # A damaged pickle can raise anything; without its index it is written again.
            except Exception:
                with suppress(OSError):
                    self.flush()
                return None

        def save_overload(self: Any, sig: Any, data: Any) -> None:
            with suppress(OSError):
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    return CodeCache


def compiled(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Compile a function that Python calls, on its first call, and keep the machine code on disk."""
    import numba  # takes half a second, and `is_warm` does not need it
    from numba.core import config

    compile_common_code()
    while _to_inline:
        _register_inlined(_to_inline.pop())
    dispatcher: Any = numba.njit(**_NUMBA_OPTIONS)(function)
    if not getattr(config, "DISABLE_JIT", False):
        dispatcher._cache = _cache_class()(function)  # same as `cache=True`
    return cast(Callable[_P, _T], dispatcher)


def inlined(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Inline a function into the compiled functions that call it; called from Python, it is plain Python.

    As calls, many of them would pass dozens of numbers in memory, and the filter would be 25 % slower. With entry
    points for Python, compilation would take twice as long. The compiler learns of it once something is compiled, so
    that a process which compiles nothing, such as that of a user's class, does not load it.
    """
    if "numba" in sys.modules:
        _register_inlined(function)
    else:
        _to_inline.append(function)
    return function


def _register_inlined(function: Callable[..., Any]) -> None:
    from numba.extending import register_jitable

    register_jitable(forceinline=True, **_NUMBA_OPTIONS)(function)


def plain(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Return the Python function of a compiled one."""
    return cast(Callable[_P, _T], getattr(function, "py_func", function))


def is_compiled(function: Callable[..., Any]) -> bool:
    """Return whether compiled code can call a function of the user's."""
    return hasattr(function, "address")
