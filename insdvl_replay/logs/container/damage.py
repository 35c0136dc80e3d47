"""Damage: where a file is not what the format says, and which messages are gone there."""

from dataclasses import dataclass
from typing import Final

Span = tuple[int, int]
"""First and last log time, ns."""

_LONGEST_NS: Final = 10**15
"""No recording covers more."""


class DamageError(Exception):
    """Bytes that are not what the format says.

    Parameters
    ----------
    offset : int
        Where in the file.
    found : str
        What stands there.
    """

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.offset = offset
        self.found = found


@dataclass(frozen=True)
class Damage:
    """A damaged place.

    Attributes
    ----------
    offset : int
        Where in the file.
    found : str
        What stands there.
    """

    offset: int
    found: str


@dataclass(frozen=True)
class Loss:
    """Messages that cannot be read.

    Attributes
    ----------
    messages : int or None
        How many; None where nothing tells.
    span_ns : (int, int) or None
        Log times between which they were; None where nothing tells.
    """

    messages: int | None
    span_ns: Span | None


def plausible_span(first_ns: int, last_ns: int) -> Span | None:
    """Give a span if it can be one.

    Parameters
    ----------
    first_ns, last_ns : int

    Returns
    -------
    (int, int) or None
        None where it ends before it begins, or is longer than any dive.
    """
    return (first_ns, last_ns) if first_ns > 0 and 0 <= last_ns - first_ns < _LONGEST_NS else None
