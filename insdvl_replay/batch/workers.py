"""The same work on many items: in this process, or in others that it starts and that end with it.

`cluster` has workers elsewhere; all of them are reached through ``concurrent.futures``.

A worker that dies takes what it held with it. Such items are tried once more, one at a time in a fresh worker, so that
the one that kills its worker is distinguished from those that ran beside it.
"""

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures.process import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.runtime import prepare_process

Item = TypeVar("Item")
Result = TypeVar("Result")

_THREADS_OF_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""The variables that set, before numpy is imported, on how many cores it multiplies matrices."""
_ENDED_WITHIN_S: Final = 5.0


class WorkerLostError(LogError):
    """A worker died over an item, twice (exit code 3)."""


@dataclass(frozen=True)
class Pool:
    """Workers that are at work."""

    executor: Executor
    in_flight: int  # items that they hold at a time; more than there are workers, so that none waits
    require_alive: Callable[[], None] = lambda: None  # raises an error when nothing more is to be expected of them
    look_every_s: float | None = None  # how often it is asked while no item gets done; None for never


@dataclass(frozen=True)
class Workers:
    """Where work is done."""

    open: Callable[[bool], AbstractContextManager[Pool]]  # gives a fresh pool, of a single worker if asked to
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)  # raised by a future whose worker died
    are_elsewhere: bool = False  # they may stand in other folders, on other machines


def do_each(
    work: Callable[[Item], Result], items: Sequence[Item], workers: Workers
) -> Generator[tuple[int, Result | Exception], None, None]:
    """Do the work on each item."""
    suspects = {}
    for place, outcome in _pass(work, dict(enumerate(items)), workers, alone=False):
        if isinstance(outcome, WorkerLostError):
            suspects[place] = items[place]
        else:
            yield place, outcome
    yield from _pass(work, suspects, workers, alone=True)


def _pass(
    work: Callable[[Item], Result], items: Mapping[int, Item], workers: Workers, *, alone: bool
) -> Iterator[tuple[int, Result | Exception]]:
    """Go through the items, with a fresh pool after every loss."""
    waiting = deque(items.items())
    while waiting:
        with workers.open(alone) as pool:
            running: dict[Future[Result], int] = {}
            whole = True
            while running or (waiting and whole):
                while waiting and whole and len(running) < pool.in_flight:
                    place, item = waiting.popleft()
                    running[_submitted(pool.executor, work, item)] = place
                done, _ = wait(running, pool.look_every_s, return_when=FIRST_COMPLETED)
                if not done:
                    pool.require_alive()
                for future in done:
                    outcome = _outcome(future, workers.lost)
                    whole = whole and not isinstance(outcome, WorkerLostError)
                    yield running.pop(future), outcome


def _submitted(executor: Executor, work: Callable[[Item], Result], item: Item) -> Future[Result]:
    try:
        return executor.submit(work, item)
    except BrokenExecutor as error:  # it broke since the last result
        future: Future[Result] = Future()
        future.set_exception(error)
        return future


def _outcome(future: Future[Result], lost: tuple[type[BaseException], ...]) -> Result | Exception:
    try:
        return future.result()
    except lost as error:
        return WorkerLostError(
            f"its worker died, and died again with nothing else to do: {error}",
            "a machine that runs out of memory kills, and code in the settings may: try it alone, with --jobs 1",
        )
    except Exception as error:
        # Else it would keep all that was read of its dive for as long as somebody keeps the error.
        traceback.clear_frames(error.__traceback__)
        return error


def local_workers(jobs: int, *, runs_code: bool = False) -> Workers:
    """Work in this process, or in several new ones: as many as jobs at the same time.

    The user's code runs in a new process. If it ends that process, its dive fails, and the command goes on.
    """
    if jobs == 1 and not runs_code:
        return Workers(lambda _alone: nullcontext(Pool(_InThisProcess(), 1)))
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


class _Processes(ProcessPoolExecutor):
    """Processes that a Ctrl-C at the terminal does not reach: their parent ends them."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if threading.current_thread() is not threading.main_thread():
            return super().submit(_do, fn, *args, **kwargs)
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a process that is started now will do
        try:
            return super().submit(_do, fn, *args, **kwargs)
        finally:
            signal.signal(signal.SIGINT, before or signal.SIG_DFL)


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
            process.join(_ENDED_WITHIN_S)
        executor.shutdown(wait=False, cancel_futures=True)
        raise


def _begin() -> None:
    """Prepare a new process for its work, before numpy is imported."""
    for name in _THREADS_OF_LIBRARIES:
        os.environ.setdefault(name, "1")  # the other cores belong to the other processes
    prepare_process()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # what is half written is removed on the way out
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    """Wait until the parent has ended, however it did, and end this worker: nobody else would."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(work: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
    """Do the work; a worker that is to end ends, where the pool would take that for the result."""
    try:
        return work(*args, **kwargs)
    except SystemExit:
        os._exit(1)
