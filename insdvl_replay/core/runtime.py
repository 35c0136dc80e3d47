"""What the program runs on, and what it is made of: cores, memory, whoever listens to its progress, its own sources.

Nothing here is slow to import; what starts the program needs some of it.
"""

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Final, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_AGAIN_S: Final = 0.2
"""After this a signal comes again that Python has told and not obeyed: telling it has ended by then."""
_MANY_OBJECTS: Final = 200_000
_LARGEST_LIBRARY: Final = 256 << 20
"""Address space that a library may ask for at once as it is loaded, and more."""
EVERYTHING: Final = ("**/*",)

_listener: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)
_step_listener: ContextVar[Callable[[str, int, int], None] | None] = ContextVar("step_listener", default=None)


class Interruption(KeyboardInterrupt):
    """The user, or the system, wants the work to end.

    A type of its own: where Python's passes through ``exec`` or ``eval``, as in the making of a dataclass, the
    interpreter remembers it, and ends by SIGINT although it was caught.
    """

    came = False


def coming_again(ending: type[BaseException]) -> "Callable[[sys.UnraisableHookArgs], None]":
    """Make a hook by which SIGTERM comes again where its exception did not end what runs.

    While Python lets an object go, it only tells an exception.
    """

    def hook(unraisable: "sys.UnraisableHookArgs") -> None:
        if issubclass(unraisable.exc_type, ending):
            again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGTERM))
            again.daemon = True
            again.start()
        else:
            sys.__unraisablehook__(unraisable)

    return hook


def collect_rarely() -> None:
    """Let Python look for objects that hold each other only after many new ones.

    The packages make some hundred thousand objects as they load, and all of them stay: to look through them at each
    thousandth would take a tenth of a short run.
    """
    gc.set_threshold(_MANY_OBJECTS)


def use_small_pages() -> None:
    """Keep numpy, which must not be loaded yet, from asking for huge pages, unless the user does.

    A virtual machine gives its large free pieces of memory back to its host, and waits long to have one again; small
    pages come from what it still has. Where memory is not shared so, the columns of an hour take milliseconds more.
    """
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")


def return_freed_memory() -> None:
    """Return to the system what was freed but is kept by the C library, some 80 MB after the reading of a long dive.

    glibc keeps freed blocks below others that are still in use; where there is no glibc, nothing is done.
    """
    if sys.platform == "linux":
        import ctypes  # not when the program starts, which needs none of it

        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def is_nearly_used_up() -> bool:
    """Return whether the limit of the address space, as `ulimit -v` sets it, has left too little to load a library.

    Then any failure may be one of memory: not all libraries say so.
    """
    try:
        import resource
    except ImportError:  # for want of the little that it takes itself, where the system has it at all
        return sys.platform != "win32"
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return limit != resource.RLIM_INFINITY and limit - _most_mapped() < _LARGEST_LIBRARY


def _most_mapped() -> int:
    """Return the most bytes of address space that this process has had; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text("ascii").splitlines()
    except (OSError, UnicodeDecodeError):
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmPeak:")), 0)


def each(work: Callable[[Item], Result], items: Iterable[Item], jobs: int | None = None) -> Iterator[Result]:
    """Do the work on each item, in threads, and yield the results in the order of the items.

    The compiled filter and numpy's long loops leave the interpreter to other threads while they run: nothing is copied
    to another process, and the filter is compiled once. An exception, an interruption included, ends it: what runs is
    finished, and nothing more is begun. At the same time run as many as there are cores, unless told otherwise.
    """
    from concurrent.futures import ThreadPoolExecutor  # which brings logging

    executor = ThreadPoolExecutor(jobs or os.cpu_count())
    try:
        yield from executor.map(work, items)
    finally:
        executor.shutdown(cancel_futures=True)


def begin(stage: str) -> None:
    """Report what begins, such as ``reading``, to whoever listens: all rooms can, without knowing of any terminal."""
    if (listener := _listener.get()) is not None:
        listener(stage)


def steps(stage: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield items, and report before each how many of them are done to whoever counts them.

    Work that converges may end before its last step.
    """
    for done, item in enumerate(items):
        if (listener := _step_listener.get()) is not None:
            listener(stage, done, len(items))
        yield item


@contextmanager
def step_listener(listener: Callable[[str, int, int], None]) -> Iterator[None]:
    """Call a listener with the stage, the steps done and all steps of what goes through `steps` inside the block."""
    token = _step_listener.set(listener)
    try:
        yield
    finally:
        _step_listener.reset(token)


@contextmanager
def progress_listener(listener: Callable[[str], None]) -> Iterator[None]:
    """Call a listener with the stages of all work inside the block. Work in other processes is reported to nobody."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@cache
def sources_digest(patterns: tuple[str, ...] = EVERYTHING) -> str:
    """Digest files of the package, by name and content: a development installation changes without its version.

    The patterns are seen from the package's folder; what Python compiles does not count. Of SHA-256 16 digits are
    returned.
    """
    import hashlib

    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted({path for pattern in patterns for path in package.glob(pattern)}):
        if path.is_file() and path.parent.name != "__pycache__":
            digest.update(f"{path.relative_to(package).as_posix()}\0{path.stat().st_size}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
