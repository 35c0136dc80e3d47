"""The same work on many items: in this process, in several that end with it, or on a dask.distributed cluster.

A worker that dies takes the items that it held with it. They are tried once more, one at a time, so that the item that
kills its worker is known, and all others are done.
"""

import ctypes
import importlib
import logging
import multiprocessing
import os
import signal
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.extras import install_hint
from insdvl_replay.core.interrupts import was_interrupted
from insdvl_replay.core.runtime import is_out_of_memory, prepare_process

Item = TypeVar("Item")
Result = TypeVar("Result")
Submit = Callable[..., "Future[Any]"]
Pool = Callable[[bool], AbstractContextManager[tuple[Submit, int, Callable[[], bool]]]]
"""Opens workers, a single one if asked to: how work is handed to them, how many items they hold, if none does work."""

_THREADS_OF_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""The variables that set, before numpy is imported, on how many cores it multiplies matrices."""
_REACHED_WITHIN_S: Final = 10
_WORKERS_WITHIN_S: Final = 60
_ENDED_WITHIN_S: Final = 15
_ANSWERED_WITHIN_S: Final = 15
_PR_SET_PDEATHSIG: Final = 1
_SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Keeps the working folder off the path on which Python finds modules."""


class WorkerLostError(LogError):
    """A worker died over an item, twice (exit code 3)."""


def do_each(
    work: Callable[[Item], Result], items: Sequence[Item], pool: Pool | None
) -> Generator[tuple[int, Result | Exception], None, None]:
    """Do the work on each item, in this process if there is no pool; yield place and outcome as they are done.

    Items whose worker was lost are done again at the end, one at a time, so that the one that ends its worker is known.
    """
    if pool is None:
        for place, item in enumerate(items):
            yield place, _outcome(partial(work, item))
        return
    waiting = deque(range(len(items)))
    suspects = list[int]()
    alone = False
    while waiting or suspects:
        if not waiting:
            waiting.extend(suspects)
            suspects.clear()
            alone = True
        # Closed here, so that an interrupt in the end of workers is not lost.
        with closing(_until_a_loss(work, items, waiting, pool, alone=alone)) as outcomes:
            for place, outcome in outcomes:
                if isinstance(outcome, WorkerLostError) and not alone:
                    suspects.append(place)
                else:
                    yield place, outcome


def _until_a_loss(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    waiting: deque[int],  # places that are taken from it
    pool: Pool,
    *,
    alone: bool,
) -> Generator[tuple[int, Result | Exception], None, None]:
    """Do the work in fresh workers until none is left, or a worker is lost."""
    with pool(alone) as (submit, in_flight, is_idle):
        running = dict[Future[Result], int]()
        is_broken = False
        while running or (waiting and not is_broken):
            while waiting and not is_broken and len(running) < in_flight:
                place = waiting.popleft()
                running[_submitted(submit, work, items[place])] = place
            for future in _ended(running, is_idle):
                outcome = _outcome(future.result)
                is_broken = is_broken or isinstance(outcome, WorkerLostError)
                yield running.pop(future), outcome


def _submitted(
    submit: Callable[..., Future[Result]], work: Callable[[Item], Result], item: Item
) -> Future[Result]:
    try:
        return submit(work, item)
    except BrokenExecutor as error:  # since the last result
        future = Future[Result]()
        future.set_exception(error)
        return future


def _ended(
    running: Collection[Future[Result]], is_idle: Callable[[], bool]
) -> Collection[Future[Result]]:
    """Wait for the first that are done, or else cancelled.

    A worker of a cluster may die after its work, before its result arrives. Then no worker is busy, and no result will
    arrive: what runs is cancelled.
    """
    first = partial(wait, running, return_when=FIRST_COMPLETED)
    if not first(_ANSWERED_WITHIN_S).done and is_idle() and not first(_ANSWERED_WITHIN_S).done:
        for future in running:
            future.cancel()
    cancelled = [future for future in running if future.cancelled()]
    return cancelled or first().done


def _outcome(result: Callable[[], Result]) -> Result | Exception:
    try:
        return result()
    except Exception as error:
        if was_interrupted():  # a library made another error of the interrupt
            raise KeyboardInterrupt from error
        if (
            isinstance(error, BrokenExecutor | CancelledError)
            or type(error).__name__ == "KilledWorker"
        ):
            return WorkerLostError(
                f"its worker died, and died again with nothing else to do: {error}",
                "a machine that runs out of memory kills, and code in the settings may: "
                "try it with more memory, or without that code",
            )
        # Else it would keep all that was read of its dive for as long as somebody keeps the error.
        traceback.clear_frames(error.__traceback__)
        return error


def local_pool(jobs: int, *, runs_code: bool = False) -> Pool | None:
    """Return a pool of as many processes as jobs; none where this process does the work.

    The user's code runs in a new process: if it ends that process, its dive fails, and the command goes on.
    """
    if jobs == 1 and not runs_code:
        return None
    return partial(_processes, jobs)


@contextmanager
def _processes(jobs: int, alone: bool) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
    """Start processes; an exception, an interruption included, ends them with what they do."""
    context = multiprocessing.get_context("spawn")
    safe_path = os.environ.get(_SAFE_PATH)
    with _safe_start():  # a pool starts a process that keeps track of its semaphores
        executor = ProcessPoolExecutor(1 if alone else jobs, context, _begin, (safe_path,))
    before = set(multiprocessing.active_children())
    # When a worker dies, two threads of the pool may close one pipe. The second would print a traceback.
    queue: Any = vars(executor)["_call_queue"]
    report = queue._on_queue_feeder_error
    queue._on_queue_feeder_error = lambda error, item: (
        None
        if isinstance(error, OSError) and not hasattr(item, "work_id")
        else report(error, item)
    )
    try:
        in_flight = 1 if alone or jobs == 1 else 2 * jobs

        def submit(work: Callable[[Item], Result], item: Item) -> Future[Result]:
            with _safe_start():
                return executor.submit(_do, work, item)

        yield submit, in_flight, lambda: False
        executor.shutdown()
    except BaseException:
        ours = set(multiprocessing.active_children()) - before
        for process in ours:
            process.terminate()
        try:
            latest_s = time.monotonic() + _ENDED_WITHIN_S
            for process in ours:
                process.join(max(0.0, latest_s - time.monotonic()))
        finally:  # compiled code may swallow the exit that a worker is asked for
            for process in ours:
                if process.is_alive():
                    process.kill()
                    process.join()
        executor.shutdown(wait=False, cancel_futures=True)
        raise


@contextmanager
def _safe_start() -> Iterator[None]:
    """Let processes start without files of the working folder on their path, and without an interrupt.

    Before Python gives a new process the path of this one, it would import `pickle.py` beside the dives. An interrupt
    in a terminal reaches all processes, and would find the new ones among their imports; this one waits for it.
    """
    before = os.environ.get(_SAFE_PATH)
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        _set_safe_path(before)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _set_safe_path(value: str | None) -> None:
    """Set the variable as it was; programs of the user may need the folder that they are in."""
    if value is None:
        os.environ.pop(_SAFE_PATH, None)
    else:
        os.environ[_SAFE_PATH] = value


def _begin(safe_path: str | None) -> None:
    """Prepare a new process for its work, before numpy is imported."""
    _set_safe_path(safe_path)
    for name in _THREADS_OF_LIBRARIES:
        os.environ.setdefault(name, "1")  # the other cores belong to the other processes
    prepare_process()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _end)
    if sys.platform == "linux":
        # a worker ends with a parent that is killed
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        parent = multiprocessing.parent_process()
        if parent is None or not parent.is_alive():
            os._exit(1)


def _end(_signal: int, _frame: FrameType | None) -> NoReturn:
    """Remove what is half written on the way out; a pool that breaks asks its workers again, in the middle of it."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(1)


def _do(work: Callable[[Item], Result], item: Item) -> Result:
    """Do the work; a worker that is to end ends, where the pool would take that for the result."""
    try:
        return work(item)
    except SystemExit:
        os._exit(1)
    except Exception as error:
        # Only this process knows its limit of memory.
        if is_out_of_memory(error) and not isinstance(error, MemoryError):
            raise MemoryError(str(error)) from error
        raise


def cluster_pool(address: str) -> Pool:
    """Return the workers of a dask.distributed cluster that runs already, by its scheduler's address."""
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        text = f"--scheduler {address}: dask.distributed is not installed"
        raise ConfigError(text, install_hint("cluster")) from error
    # Its own logs would print, with tracebacks, what an error of ours says in a sentence.
    for name in ["distributed", "tornado", "asyncio", *logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    return partial(_cluster, distributed, address)


@contextmanager
def _cluster(
    distributed: Any, address: str, alone: bool
) -> Iterator[tuple[Submit, int, Callable[[], bool]]]:
    try:
        client = distributed.Client(address, timeout=_REACHED_WITHIN_S, set_as_default=False)
        client.wait_for_workers(1, timeout=_WORKERS_WITHIN_S)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"--scheduler {address}: cannot be reached: {error}",
            "`dask scheduler` prints the address it listens on, and `dask worker` adds a worker",
        ) from error
    executor = client.get_executor(pure=False)
    try:
        in_flight = 1 if alone else 2 * sum(client.ncores().values())
        yield executor.submit, in_flight, lambda: not any(client.processing().values())
    finally:
        executor.shutdown(wait=False)
        client.close(timeout=2)
