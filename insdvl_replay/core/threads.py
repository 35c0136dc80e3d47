"""The same work on many items, on all cores.

Threads, since the compiled filter and numpy's long loops leave the interpreter to others while they run: nothing is
copied to another process, and the filter is compiled once.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def each(work: Callable[[Item], Result], items: Iterable[Item], jobs: int | None = None) -> Iterator[Result]:
    """Do the work on each item, several at the same time, and give the results in the order of the items.

    An exception, an interruption included, ends it: what runs is finished, and nothing more is begun.

    Parameters
    ----------
    work : callable
        Takes an item. Changes nothing that others read.
    items : iterable
    jobs : int, optional
        How many at the same time; left out, as many as there are cores.

    Yields
    ------
    anything
        What the work gives.
    """
    executor = ThreadPoolExecutor(jobs or os.cpu_count())
    try:
        yield from executor.map(work, items)
    finally:
        executor.shutdown(cancel_futures=True)
