"""A recorder whose clock was set during a recording: which part of the log has one clock, and is used."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Mask, TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS

# No recorder waits for longer in the middle of a dive: after a larger step its clock was set.
CLOCK_SET_NS: Final = TIME_UNITS_NS["d"]


@dataclass(frozen=True)
class OneClock:
    """The longest part of a recording whose clock was set."""

    first_ns: int  # log times of this part
    last_ns: int
    set_s: float  # after the first message, when the clock was set for the first time
    from_ns: int  # the last time before it, and the first one behind it
    to_ns: int
    unused: int  # messages of other parts

    def holds(self, log_time_ns: TimeNs) -> Mask:
        """Return which messages are of this part."""
        return np.asarray((log_time_ns >= self.first_ns) & (log_time_ns <= self.last_ns))

    @property
    def note(self) -> Note:
        """Report that the clock was set, and what is used."""
        before = np.datetime64(self.from_ns, "ns").astype("M8[s]")
        after = np.datetime64(self.to_ns, "ns").astype("M8[s]")
        length_s = (self.last_ns - self.first_ns) / NS_PER_S
        return note(
            "clock_set",
            self.unused,
            set_s=self.set_s,
            before=before,
            after=after,
            length_s=length_s,
        )


def spans_a_step(first_ns: int, last_ns: int) -> bool:
    """Return whether log times span so much that the clock may have been set."""
    return last_ns - first_ns > CLOCK_SET_NS


def one_clock(log_times: Sequence[TimeNs]) -> OneClock | None:
    """Find the longest part with one clock; None where it was not set. Times are in the order of the file, by channel.

    A clock is set by more than a day, forward or back.
    """
    known = [times for times in log_times if times.size]
    if not known:
        return None
    ordered = np.sort(np.concatenate(known))
    steps = np.flatnonzero(_between_ns(ordered[:-1], ordered[1:]) > CLOCK_SET_NS)
    if not steps.size:
        return None
    firsts = ordered[np.append(0, steps + 1)]
    lasts = ordered[np.append(steps, ordered.size - 1)]
    lengths_ns = _between_ns(firsts, lasts)
    longest = int(np.argmax(lengths_ns))
    # Of the channel with the most messages, the part of its first message was recorded first.
    often = max(known, key=len)
    part_of = np.searchsorted(firsts, often, "right") - 1
    begun = int(part_of[0])
    next_part = (begun + 1) % len(firsts)
    others = np.flatnonzero(part_of != begun)
    if others.size:
        next_part = int(part_of[others[0]])
    first_ns = int(firsts[longest])
    last_ns = int(lasts[longest])
    used = int(np.searchsorted(ordered, last_ns, "right") - np.searchsorted(ordered, first_ns))
    return OneClock(
        first_ns=first_ns,
        last_ns=last_ns,
        set_s=float(lengths_ns[begun]) / NS_PER_S,
        from_ns=int(lasts[begun]),
        to_ns=int(firsts[next_part]),
        unused=ordered.size - used,
    )


def _between_ns(earlier_ns: TimeNs, later_ns: TimeNs) -> NDArray[np.uint64]:
    """Return what lies between times. Damaged ones may be 600 years apart, which a signed number does not hold."""
    return np.asarray(later_ns.astype(np.uint64) - earlier_ns.astype(np.uint64))
