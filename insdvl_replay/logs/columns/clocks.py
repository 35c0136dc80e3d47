"""The clocks that stamp the topics, and the order of a topic's messages.

The recorder's log time is the one clock that all topics share. Log time minus stamp is the offset of a topic's own
clock from it, plus the time that messages take. Two topics whose clocks differ in it cannot be replayed together.
Messages that overtake each other, or parts of a log that are joined in another order, are only put in their places. A
stamp that jumps while the log time goes on is wrong.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, distinct, find_runs, nanoseconds, seconds
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.topics import code_of

SAME_CLOCK_S: Final = 1.0  # messages are not under way for longer; clocks further apart are two clocks
LARGEST_JITTER_S: Final = 1.0  # what varies by more between stamp and recording is a drift or a jump
FEW_PLACES: Final = 5  # messages do not overtake more others than this
LEAP_S: Final = 3600.0  # stamps that run ahead of the log time by more at once are those of a clock that was set
_UNITS: Final = ((1, "nanoseconds"), (10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds"))
_UNIX_TIME_S: Final = 1e8  # the time since 1970 has been longer than this since 1973
_IN_STEP: Final = 0.2  # a recorder keeps step with the stamps better than this; units are 1000 apart

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]


def measure_clock(
    role: str, topic: str, stamp: str, time_ns: TimeNs, log_time_ns: TimeNs, latency_s: float = 0.0
) -> Clock:
    """Compare stamps, without the latency, with the times of recording, both of shape (k,), in the file's order."""
    # As arrays, whose sums go round at 2^64: log times behind 2^63 still give what they are behind.
    behind_ns = log_time_ns - time_ns
    first_ns = int(behind_ns[0])
    behind_ns -= first_ns
    low, median, high = (_percentile(behind_ns, percent) for percent in (5, 50, 95))
    steps_ns = np.subtract(time_ns[1:], time_ns[:-1], out=behind_ns[1:])  # in place: such arrays are large
    back_steps, repeats = int(np.count_nonzero(steps_ns < 0)), int(np.count_nonzero(steps_ns == 0))
    changes = len(distinct(time_ns)) - 1 if back_steps else steps_ns.size - repeats
    span_ns = int(time_ns.max()) - int(time_ns.min())
    return Clock(
        role=role,
        topic=topic,
        stamp=stamp,
        messages=len(time_ns),
        log_minus_stamp_s=(float(first_ns) + median) * 1e-9 - latency_s,
        spread_s=(high - low) * 1e-9,
        back_steps=back_steps,
        repeats=repeats,
        rate_hz=changes / (span_ns * 1e-9) if changes else None,
        latency_s=latency_s,
    )


def _percentile(values: TimeNs, percent: float) -> float:
    """Do what `numpy.percentile` does, which takes ten times as long for millions of whole numbers; reorder them."""
    place = percent / 100.0 * (values.size - 1)
    below = int(place)
    values.partition(below)
    low, high = int(values[below]), int(values[below + 1 :].min(initial=np.iinfo(np.int64).max))
    return low + (place - below) * (high - low) if place > below else float(low)


def clock_notes(place: str, clocks: Sequence[Clock], max_disagreement_s: float) -> tuple[Note, ...]:
    """Refuse to mix clocks that have nothing to do with each other, and say which of them are not the recorder's.

    The clock of the IMU is the first. Log time minus stamp may differ by so much between it and another role's, beyond
    the spread of both. A latency is how late a message was stamped, as of a fix that took seconds, or how far its clock
    is off, which it mends: one of the two clocks, with it taken off or without, has to be the IMU's.
    """

    def both_ways(clock: Clock) -> tuple[float, float]:
        return clock.log_minus_stamp_s, clock.log_minus_stamp_s + clock.latency_s

    def latencies(*clocks: Clock) -> str:
        return "".join(
            f"; {clock.role}.latency_s takes {clock.latency_s:g} s off the stamps"
            for clock in clocks
            if clock.latency_s
        )

    imu, *others = clocks
    offsets, unsteady = [], []
    for clock in clocks:
        code = code_of(clock.role)
        if min(map(abs, both_ways(clock))) > SAME_CLOCK_S + clock.spread_s:
            text = (
                f"{clock.topic}: log time minus stamp '{clock.stamp}' is {clock.log_minus_stamp_s:.3f} s in the "
                f"median, {clock.spread_s:.3f} s between its 5th and 95th percentile{latencies(clock)}"
            )
            offsets.append(Note(f"{code}_clock_offset", text, clock.messages))
        if clock.spread_s > LARGEST_JITTER_S:
            text = (
                f"{clock.topic}: the clock of its stamps runs unlike the recorder's: log time minus stamp varies by "
                f"{clock.spread_s:.3f} s between its 5th and 95th percentile"
            )
            hint = f'{clock.role}.stamp = "log_time"'
            unsteady.append(Note(f"{code}_clock_unsteady", text, clock.messages, Severity.WARNING, hint))
    apart = []
    for other in others:
        jitter_s = min(other.spread_s, LARGEST_JITTER_S) + min(imu.spread_s, LARGEST_JITTER_S)
        apart_s = min(abs(its - ours) for its in both_ways(other) for ours in both_ways(imu)) - jitter_s
        both = f"{imu.topic} and {other.topic}" if imu.topic != other.topic else f"imu and {other.role} of {imu.topic}"
        text = (
            f"{both} are stamped by different clocks: log time minus stamp is {imu.log_minus_stamp_s:.3f} s on the one "
            f"and {other.log_minus_stamp_s:.3f} s on the other{latencies(imu, other)}"
        )
        to_set = (f"--set {clock.role}.stamp=log_time" for clock in (imu, other) if clock.stamp != "log_time")
        by_recorder = f"{' '.join(to_set)} stamps both by the recorder"
        if apart_s > max_disagreement_s:
            hint = f"{by_recorder}; if they do belong together, raise clocks.max_disagreement_s"
            raise LogError(text, hint, place)
        if apart_s > SAME_CLOCK_S:
            text += "; clocks.max_disagreement_s allows it"
            apart.append(Note("clocks_apart", text, other.messages, Severity.WARNING, by_recorder))
    return (*offsets, *unsteady, *apart)


def stamp_unit(values: NDArray[Any], log_time_ns: TimeNs) -> tuple[int, str]:
    """Find the unit of stamps that are mere numbers, shape (k,): its nanoseconds, and its name.

    It shows in how far they run while the recorder's clock runs on, which holds for the time since power-up too. Where
    the recorder's clock does not keep step with them, because the log was written later, their size decides: it is
    taken for the time since 1970.
    """
    ran, recorded_s = float(values[-1]) - float(values[0]), float(log_time_ns[-1] - log_time_ns[0]) * 1e-9
    for unit in _UNITS:
        if abs(ran * unit[0] * 1e-9 - recorded_s) < _IN_STEP * recorded_s:
            return unit
    size = float(np.median(np.abs(values)))
    return next((unit for unit in _UNITS if size * unit[0] * 1e-9 >= _UNIX_TIME_S), _UNITS[-1])


@dataclass(frozen=True)
class Order:
    """In which order the rows of a topic are true."""

    rows: Rows  # in the order of time, without those that are stamped wrongly
    late: Rows  # that came after later ones, and were put in their places
    wrong: Rows  # whose stamps the recorder's clock contradicts, as they were recorded
    late_s: float  # how far a late row is behind the latest before it, at most
    jump_s: float  # how far the clock of the stamps jumped for good at most, by log time minus stamp around wrong ones


def find_order(time_ns: TimeNs, log_time_ns: TimeNs) -> Order:
    """Order messages by their stamps, leaving out those that cannot have been made when they are stamped.

    The largest number of messages whose stamps rise with the log time are right. A run of others is put among them if
    it is off by `FEW_PLACES` and `SAME_CLOCK_S` at most, and is wrong else. Where the stamps leap ahead by `LEAP_S`,
    only the longest part without a leap is right. Both times have shape (k,), in the order of the file.
    """
    ahead_ns = time_ns - log_time_ns
    # The extremes mostly tell that there is no leap.
    may_leap = bool(ahead_ns.size) and int(ahead_ns.max()) - int(ahead_ns.min()) > nanoseconds(LEAP_S)
    leaps = may_leap and bool(_leaps(time_ns, log_time_ns).any())
    if np.all(time_ns[1:] >= time_ns[:-1]) and not leaps:
        none = np.empty(0, np.int64)
        return Order(np.arange(time_ns.size), none, none, 0.0, 0.0)
    recorded = np.lexsort((time_ns, log_time_ns))
    bad, jump_s = _contradictions(time_ns[recorded], log_time_ns[recorded])
    wrong, kept = recorded[bad], np.sort(recorded[~bad])
    latest_ns = np.maximum.accumulate(time_ns[kept])
    is_late = time_ns[kept] < latest_ns
    return Order(
        rows=kept[np.argsort(time_ns[kept], kind="stable")],
        late=kept[is_late],
        wrong=wrong,
        late_s=float(seconds(latest_ns, time_ns[kept]).max(initial=0.0)),
        jump_s=jump_s,
    )


def _leaps(stamp_ns: TimeNs, log_time_ns: TimeNs) -> Mask:
    """Find which messages but the first are stamped long after the one before, though recorded soon after it."""
    return np.asarray(np.diff(stamp_ns - log_time_ns) > nanoseconds(LEAP_S))


def _contradictions(stamp_ns: TimeNs, log_time_ns: TimeNs) -> tuple[Mask, float]:
    """Find, for messages as they were recorded, which stamps are wrong, and how far their clock jumps for good."""
    rising = _rising(stamp_ns)
    others, bad = np.flatnonzero(~rising), ~rising
    # A run of others is wrong if one of it belongs far from its place among the rising ones.
    rising_ns, other_ns, places = stamp_ns[rising], stamp_ns[others], np.cumsum(rising, dtype=np.int64)[others]
    before_ns, after_ns = (rising_ns[np.clip(places + at, 0, rising_ns.size - 1)] for at in (-1, 0))
    off_s = np.maximum(seconds(before_ns, other_ns), seconds(other_ns, after_ns))
    far = (off_s > SAME_CLOCK_S) | (np.abs(np.searchsorted(rising_ns, other_ns) - places) > FEW_PLACES)
    starts = np.flatnonzero(np.diff(others, prepend=-2) > 1)
    bad[others] = np.repeat(np.logical_or.reduceat(far, starts), np.diff(starts, append=others.size))
    # Of parts between leaps, such as that before a clock was set, all but the longest are wrong.
    part = np.concatenate([[0], np.cumsum(_leaps(stamp_ns[~bad], log_time_ns[~bad]))])
    bad[~bad] = part != np.bincount(part).argmax()
    start, end = find_runs(bad)
    inside = (start > 0) & (end < bad.size)
    behind_ns = log_time_ns - stamp_ns
    jumps_s = seconds(behind_ns[end[inside]], behind_ns[start[inside] - 1])
    return bad, float(np.abs(jumps_s).max(initial=0.0))


def _rising(values: TimeNs) -> Mask:
    """Mark a longest subsequence that never falls."""
    rising: Mask = (values == np.maximum.accumulate(values)) & (values == np.minimum.accumulate(values[::-1])[::-1])
    # What is above all before it and below all behind it is part of any; the others are few in a log that is sound.
    loose = np.flatnonzero(~rising)
    lowest_ends: list[int] = []
    ends_at: list[int] = []
    before = np.full(loose.size, -1, np.int64)
    for i, value in enumerate(values[loose].tolist()):
        length = bisect_right(lowest_ends, value)
        before[i] = ends_at[length - 1] if length else -1
        lowest_ends[length : length + 1] = [value]
        ends_at[length : length + 1] = [i]
    last = ends_at[-1] if ends_at else -1
    while last >= 0:
        rising[loose[last]] = True
        last = int(before[last])
    return rising
