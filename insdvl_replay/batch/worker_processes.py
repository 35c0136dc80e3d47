"""Workers on this machine: this process itself, or others that it starts and that end with it."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import ProcessPoolExecutor
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

from insdvl_replay.batch.executors import Pool, Workers
from insdvl_replay.core.runtime import collect_rarely

Result = TypeVar("Result")

_THREADS_OF_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""How numpy is told, before it is imported, on how many cores to multiply matrices."""
_GRACE_S: Final = 3
"""How long a worker gets to remove what it has half written."""


def local_workers(jobs: int) -> Workers:
    """Work in this process, or in several new ones.

    Parameters
    ----------
    jobs : int
        How many at the same time.

    Returns
    -------
    Workers
    """
    if jobs == 1:
        return Workers(lambda _alone: _here())
    return Workers(lambda alone: _processes(1 if alone else jobs))


class _InThisProcess(Executor):
    """Do the work at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def _here() -> Iterator[Pool]:
    yield Pool(_InThisProcess(), 1)


class _Processes(ProcessPoolExecutor):
    """Processes each of which ends as a whole when the parent wants it to, and not the item alone."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return super().submit(_do, fn, *args, **kwargs)


@contextmanager
def _processes(jobs: int) -> Iterator[Pool]:
    """Spawn processes; an exception, an interruption included, ends them with what they do."""
    executor = _Processes(jobs, multiprocessing.get_context("spawn"), _begin)
    before = set(multiprocessing.active_children())
    try:
        yield Pool(executor, 1 if jobs == 1 else 2 * jobs)
        executor.shutdown()
    except BaseException:
        ours = set(multiprocessing.active_children()) - before
        for process in ours:
            process.terminate()
        for process in ours:
            process.join(2 * _GRACE_S)
        executor.shutdown(wait=False, cancel_futures=True)
        raise


def _begin() -> None:
    """Prepare a new process for its work, before numpy is imported."""
    for name in _THREADS_OF_LIBRARIES:
        os.environ.setdefault(name, "1")  # the other cores belong to the other processes
    collect_rarely()
    _obey_the_parent_alone()
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _obey_the_parent_alone() -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the parent, and let its word end the work tidily."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)


def _end_with_the_parent() -> None:
    """Wait until the parent is gone, however it ended, and end this worker: nobody would ever again."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_GRACE_S)
        os._exit(1)  # compiled code may leave Python no moment for its handler


class _Leaving(SystemExit):
    """The parent wants this worker to end: what is half written is removed on the way out."""


def _leave(_signal: int, _frame: FrameType | None) -> NoReturn:
    signal.alarm(_GRACE_S)  # ends the process where the exception is caught by someone on its way
    raise _Leaving


def _do(work: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
    """Do the work; if the parent wants the worker to end, end it."""
    try:
        return work(*args, **kwargs)
    except _Leaving:
        os._exit(1)
