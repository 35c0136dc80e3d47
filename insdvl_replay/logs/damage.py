"""Damage: where a file is not what the format says, and which messages are gone there."""

from dataclasses import dataclass

Span = tuple[int, int]
"""First and last log time, ns."""


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
