"""What long work is doing just now, told to whoever listens; nobody does, but for a terminal.

So all rooms can say it without knowing of any terminal, and work in other processes says it to nobody.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_listener: ContextVar[Callable[[str], None] | None] = ContextVar("listener", default=None)


def begin(stage: str) -> None:
    """Say what begins, such as ``reading``."""
    if (listener := _listener.get()) is not None:
        listener(stage)


@contextmanager
def told_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Have the stages of all work inside the block told."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
