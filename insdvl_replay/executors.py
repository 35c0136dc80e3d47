"""The same work on many items, in this process, in others, or on a cluster, through ``concurrent.futures``.

A worker that dies takes what it held with it. Such items are tried once more, one at a time in a fresh worker, so that
the one that kills its worker is told from those that stood beside it.
"""

import importlib
import logging
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures.process import ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

from insdvl_replay.errors import ConfigError, LogError
from insdvl_replay.memory import collect_rarely

Item = TypeVar("Item")
Result = TypeVar("Result")

_THREADS_OF_LIBRARIES: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""How numpy is told, before it is imported, on how many cores to multiply matrices."""
_GRACE_S: Final = 3
"""How long a worker gets to remove what it has half written."""

_REACHED_WITHIN_S: Final = 10.0
"""How long a cluster may take to answer at first."""
_LOOK_EVERY_S: Final = 2.0
_LEFT_WITHIN_S: Final = 2.0


class WorkerLostError(LogError):
    """A worker died over an item, twice (exit code 3)."""


@dataclass(frozen=True)
class Pool:
    """Workers that are at work.

    Attributes
    ----------
    executor : Executor
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
        How a future says that its worker died.
    are_elsewhere : bool
        They may stand in other folders, on other machines.
    """

    open: Callable[[bool], AbstractContextManager[Pool]]
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)
    are_elsewhere: bool = False


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


@dataclass(frozen=True)
class Cluster:
    """A dask.distributed cluster that runs already.

    Attributes
    ----------
    address : str
        Of its scheduler, such as ``tcp://host:8786``.
    patience_s : float
        How long it may be without a worker or an answer.
    """

    address: str
    patience_s: float


def cluster_workers(cluster: Cluster) -> Workers:
    """Work on a cluster.

    Parameters
    ----------
    cluster : Cluster

    Returns
    -------
    Workers

    Raises
    ------
    ConfigError
        dask.distributed is not installed.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ImportError as error:
        raise ConfigError(
            f"--scheduler {cluster.address}: dask.distributed is not installed", "pip install 'insdvl-replay[cluster]'"
        ) from error
    _silence("distributed", "tornado", "asyncio")
    return Workers(
        lambda alone: _cluster(distributed, cluster, alone=alone),
        (CancelledError, distributed.KilledWorker),
        are_elsewhere=True,
    )


def _silence(*libraries: str) -> None:
    """Keep libraries from telling on stderr, with tracebacks, what is told here in a sentence."""
    for name in [*libraries, *logging.root.manager.loggerDict]:
        if name.partition(".")[0] in libraries:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def do_each(
    work: Callable[[Item], Result], items: Sequence[Item], workers: Workers
) -> Generator[tuple[int, Result | Exception], None, None]:
    """Do the work on each item.

    Parameters
    ----------
    work : callable
        Can be imported by name. It should be the same to do it twice.
    items : sequence
    workers : Workers

    Yields
    ------
    int
        Place of an item, in the order in which they are done.
    anything or Exception
        What the work gave or raised; `WorkerLostError` for an item whose worker died, and died again when the item was
        alone with it.

    Raises
    ------
    ConfigError
        The cluster cannot be reached, or has no workers and gets none.
    """
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
        return executor.submit(_do, work, item)
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


@contextmanager
def _processes(jobs: int) -> Iterator[Pool]:
    """Spawn processes; an exception, an interruption included, ends them with what they do."""
    executor = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin)
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


def _do(work: Callable[[Item], Result], item: Item) -> Result:
    """Do the work; if the parent wants the worker to end, end it and not the item alone."""
    try:
        return work(item)
    except _Leaving:
        os._exit(1)


@contextmanager
def _cluster(distributed: Any, cluster: Cluster, *, alone: bool) -> Iterator[Pool]:
    try:
        client = distributed.Client(cluster.address, timeout=_REACHED_WITHIN_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"--scheduler {cluster.address}: cannot be reached: {error}",
            "`dask scheduler` prints the address it listens on",
        ) from error
    health = _Health(client, cluster)
    executor = client.get_executor(pure=False)
    try:
        yield Pool(executor, 1 if alone else 2 * max(1, health.threads()), health.require, _LOOK_EVERY_S)
    finally:
        executor.shutdown(wait=False)
        client.close(timeout=_LEFT_WITHIN_S)


class _Health:
    """Tells a cluster that takes long from one that will never be done.

    Parameters
    ----------
    client : distributed.Client
    cluster : Cluster
    """

    def __init__(self, client: Any, cluster: Cluster) -> None:
        self.client = client
        self.cluster = cluster
        self.well_at_s = time.monotonic()

    def threads(self) -> int:
        """Ask how many items can be done at a time; -1 where there is no answer."""
        try:
            return sum(self.client.sync(self.client.scheduler.ncores, callback_timeout=_LOOK_EVERY_S).values())
        except (OSError, TimeoutError):
            return -1

    def require(self) -> None:
        """Raise a ConfigError if there has been no worker, or no answer, for too long."""
        threads = self.threads()
        if threads > 0:
            self.well_at_s = time.monotonic()
        elif time.monotonic() - self.well_at_s > self.cluster.patience_s:
            found = "has no workers" if threads == 0 else "does not answer"
            raise ConfigError(
                f"--scheduler {self.cluster.address}: {found}, for {self.cluster.patience_s:g} s",
                "`dask worker` adds one; --scheduler-patience waits longer",
            )
