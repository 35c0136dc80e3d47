"""Damage: where a file is not what the format says, in what span messages may be gone, and the error that says so."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.columns import TimeNs, seconds
from insdvl_replay.core.errors import LogError

COPY_AGAIN: Final = "copy the log again from the recorder if it still has it"
"""What helps where messages are lost."""

Span = tuple[int, int]
"""First and last log time, ns."""

_LONGEST_NS: Final = 10**15
"""No recording covers more."""


@dataclass(frozen=True)
class Damage:
    """A damaged place: its offset in the file, and what stands there."""

    offset: int
    found: str


class DamageError(Exception):
    """Bytes that are not what the format says, at an offset in the file; ``found`` is what stands there."""

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.damage = Damage(offset, found)


@dataclass(frozen=True)
class Loss:
    """Messages that cannot be read: how many, and the log times between which they were; None where nothing tells."""

    messages: int | None
    span_ns: Span | None


def plausible_span(first_ns: int, last_ns: int) -> Span | None:
    """Return a span if it can be one."""
    return (first_ns, last_ns) if first_ns > 0 and 0 <= last_ns - first_ns < _LONGEST_NS else None


def damaged_file_error(faults: Sequence[LogError], saved: Iterable[TimeNs], places: str = "damaged places") -> LogError:
    """Make the error with which a damaged log is refused: where it is damaged, and what could be saved.

    Of the faults, at least one, the first is told and the others are counted; the log times of all messages that can be
    read are given in parts, ns.
    """
    first, *others = faults
    what = f"{first.what} ({len(others)} more {places})" if others else first.what
    times = np.concatenate([np.empty(0, np.int64), *saved])
    hint = "no message in it can be read; copy it again from the recorder"
    if times.size:
        span_s = float(seconds(times.max(), int(times.min())))
        hint = f"--allow-damaged uses the {span_s:.1f} s and {times.size} messages that can be read"
    return LogError(what, hint, *first.where)
