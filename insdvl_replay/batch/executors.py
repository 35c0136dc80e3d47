"""The same work on many items, wherever it is done, through ``concurrent.futures``.

`worker_processes` are workers here, `cluster` has those elsewhere.

A worker that dies takes what it held with it. Such items are tried once more, one at a time in a fresh worker, so that
the one that kills its worker is told from those that stood beside it.
"""

import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TypeVar

from insdvl_replay.core.errors import LogError

Item = TypeVar("Item")
Result = TypeVar("Result")


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
