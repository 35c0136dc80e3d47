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
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures.process import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing import resource_tracker
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

from insdvl_replay.core.errors import LogError
from insdvl_replay.core.runtime import collect_rarely, coming_again

Item = TypeVar("Item")
Result = TypeVar("Result")

_ENDINGS: Final = (signal.SIGINT, signal.SIGTERM)
_THREADS_OF_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""The variables that set, before numpy is imported, on how many cores it multiplies matrices."""
_GRACE_S: Final = 3
"""How long a worker gets to remove what it has half written."""


class WorkerLostError(LogError):
    """A worker died over an item, twice (exit code 3)."""


@dataclass(frozen=True)
class Pool:
    """Workers that are at work.

    Attributes
    ----------
    in_flight : int
        How many items they hold at a time; more than there are workers, so that none waits.
    require_alive : callable
        Raises an error when nothing more is to be expected of them.
    look_every_s : float or None
        How often it is asked while no item gets done; None for never.
    """

    executor: Executor
    in_flight: int
    require_alive: Callable[[], None] = lambda: None
    look_every_s: float | None = None


@dataclass(frozen=True)
class Workers:
    """Where work is done.

    Attributes
    ----------
    open : callable
        Gives a fresh `Pool`, of a single worker if asked to.
    lost : tuple of exception types
        What a future raises whose worker died.
    are_elsewhere : bool
        They may stand in other folders, on other machines.
    """

    open: Callable[[bool], AbstractContextManager[Pool]]
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    are_elsewhere: bool = False


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
            "a machine that runs out of memory kills; try it alone, with --jobs 1",
        )
    except Exception as error:
        # Else it would keep all that was read of its dive for as long as somebody keeps the error.
        traceback.clear_frames(error.__traceback__)
        return error


def local_workers(jobs: int) -> Workers:
    """Work in this process, or in several new ones: as many as jobs at the same time."""
    if jobs == 1:
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
    """Processes each of which ends as a whole when the parent wants it to, and not the item alone."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with _signals_held():
            return super().submit(_do, fn, *args, **kwargs)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Obey a signal only when the processes that are being started know what to do, and all of them are known here.

    One that has not read yet what it is for would complain, with a traceback, that nobody tells it any more.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {number: signal.signal(number, lambda got, _frame: held.append(got)) for number in _ENDINGS}
    masked = _block_for_those_that_start()
    try:
        yield
    finally:
        if masked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)  # none, where Python did not set it
    for got in held:
        signal.raise_signal(got)


def _block_for_those_that_start() -> Collection[int] | None:
    """Block the signals in this thread, from which a new process has it until `_begin`; return what was blocked."""
    if not hasattr(signal, "pthread_sigmask"):
        return None
    resource_tracker.ensure_running()  # as it starts, it lets signals through again
    return signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)


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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all processes; the parent ends them
    signal.signal(signal.SIGTERM, _end_at_once)
    sys.unraisablehook = coming_again(_Leaving)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDINGS)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    """Wait until the parent has ended, however it did, and end this worker: nobody else would."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_GRACE_S)
        os._exit(1)  # compiled code may leave Python no moment for its handler


class _Leaving(SystemExit):
    """The parent wants this worker to end: what is half written is removed on the way out."""


def _end_at_once(_signal: int, _frame: FrameType | None) -> NoReturn:
    """End a worker that has nothing to do: there is nothing to remove, and an exception would end in a traceback."""
    os._exit(1)


def _leave(_signal: int, _frame: FrameType | None) -> NoReturn:
    signal.alarm(_GRACE_S)  # ends the process where the exception is caught by someone on its way
    raise _Leaving


def _do(work: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
    """Do the work; if the parent wants the worker to end, end it."""
    try:
        signal.signal(signal.SIGTERM, _leave)
        return work(*args, **kwargs)
    except _Leaving:
        os._exit(1)
    finally:
        signal.signal(signal.SIGTERM, _end_at_once)
