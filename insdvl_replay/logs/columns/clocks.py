"""The clocks of a log: what stamps each topic, how it runs against the recorder's clock, and who may be mixed.

The recorder's log time is the one clock that all topics share. Log time minus stamp is what a topic's own clock is away
from it, plus the time that messages take; two topics whose clocks differ in it cannot be replayed together.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.channel import Clock
from insdvl_replay.core.columns import TimeNs, distinct
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity

SAME_CLOCK_S: Final = 1.0
"""Messages are not under way for longer than this; clocks further apart are two clocks."""
LARGEST_JITTER_S: Final = 1.0
"""What varies by more between stamp and recording is no jitter: the clock drifts, or jumps."""

_NS: Final = 1e-9
_UNITS: Final = ((1, "nanoseconds"), (10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds"))
_UNIX_TIME_S: Final = 1e8
"""The time since 1970 has been longer than this since 1973."""
_IN_STEP: Final = 0.2
"""A recorder that writes as messages come keeps step with their stamps better than this; units are 1000 apart."""


def measure_clock(role: str, topic: str, stamp: str, time_ns: TimeNs, log_time_ns: TimeNs) -> Clock:
    """Compare the stamps of a topic with the times at which it was recorded.

    Parameters
    ----------
    role, topic, stamp : str
        See `Clock`.
    time_ns : ndarray, shape (k,)
        Times of validity in the order of the file, k at least 1.
    log_time_ns : ndarray, shape (k,)
    """
    # As arrays, whose sums go round at 2^64: log times behind 2^63 still give what they are behind.
    behind_ns = log_time_ns - time_ns
    first_ns = int(behind_ns[0])
    behind_ns -= first_ns
    low, median, high = (_percentile(behind_ns, percent) for percent in (5, 50, 95))
    # Each such array of a long log is much new memory; this one has done its duty.
    steps_ns = np.subtract(time_ns[1:], time_ns[:-1], out=behind_ns[1:])
    back_steps, repeats = int(np.count_nonzero(steps_ns < 0)), int(np.count_nonzero(steps_ns == 0))
    changes = len(distinct(time_ns)) - 1 if back_steps else steps_ns.size - repeats
    span_ns = int(time_ns.max()) - int(time_ns.min())
    return Clock(
        role=role,
        topic=topic,
        stamp=stamp,
        messages=len(time_ns),
        log_minus_stamp_s=(float(first_ns) + median) * _NS,
        spread_s=(high - low) * _NS,
        back_steps=back_steps,
        repeats=repeats,
        rate_hz=changes / (span_ns * _NS) if changes else None,
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

    Parameters
    ----------
    place : str
        The file, for messages to the user.
    clocks : sequence of Clock
        Of all roles, that of the IMU first.
    max_disagreement_s : float
        How far log time minus stamp may differ between the IMU and another role, beyond the spread of both.

    Raises
    ------
    LogError
        Two roles are stamped by different clocks.
    """
    imu, *others = clocks
    notes = [_offset_note(clock) for clock in clocks if abs(clock.log_minus_stamp_s) > SAME_CLOCK_S + clock.spread_s]
    notes += [_unsteady_note(clock) for clock in clocks if clock.spread_s > LARGEST_JITTER_S]
    for other in others:
        jitter_s = min(other.spread_s, LARGEST_JITTER_S) + min(imu.spread_s, LARGEST_JITTER_S)
        apart_s = abs(other.log_minus_stamp_s - imu.log_minus_stamp_s) - jitter_s
        text = (
            f"{imu.topic} and {other.topic} are stamped by different clocks: log time minus stamp is "
            f"{imu.log_minus_stamp_s:.3f} s on the one and {other.log_minus_stamp_s:.3f} s on the other"
        )
        by_recorder = f"--set imu.stamp=log_time --set {other.role}.stamp=log_time stamps both by the recorder"
        if apart_s > max_disagreement_s:
            hint = f"{by_recorder}; if they do belong together, raise clocks.max_disagreement_s"
            raise LogError(text, hint, place)
        if apart_s > SAME_CLOCK_S:
            text += "; clocks.max_disagreement_s allows it"
            notes.append(Note("clocks_apart", text, other.messages, Severity.WARNING, by_recorder))
    return tuple(notes)


def stamp_unit(values: NDArray[Any], log_time_ns: TimeNs) -> tuple[int, str]:
    """Find in which unit a stamp that is a mere number counts.

    They tell it by how far they run while the recorder's clock runs on, which holds for the time since power-up too.
    Where the recorder's clock does not keep step with them, because the log was written later, their size has to do:
    it is taken for the time since 1970.

    Parameters
    ----------
    values : ndarray, shape (k,)
        Finite numbers.
    log_time_ns : ndarray, shape (k,)

    Returns
    -------
    factor : int
        Nanoseconds of one unit.
    """
    ran, recorded_s = float(values[-1]) - float(values[0]), float(log_time_ns[-1] - log_time_ns[0]) * _NS
    for unit in _UNITS:
        if abs(ran * unit[0] * _NS - recorded_s) < _IN_STEP * recorded_s:
            return unit
    size = float(np.median(np.abs(values)))
    return next((unit for unit in _UNITS if size * unit[0] * _NS >= _UNIX_TIME_S), _UNITS[-1])


def _unsteady_note(clock: Clock) -> Note:
    text = (
        f"{clock.topic}: the clock of its stamps runs unlike the recorder's: log time minus stamp varies by "
        f"{clock.spread_s:.3f} s between its 5th and 95th percentile"
    )
    return Note(
        f"{clock.role}_clock_unsteady", text, clock.messages, Severity.WARNING, f'{clock.role}.stamp = "log_time"'
    )


def _offset_note(clock: Clock) -> Note:
    text = (
        f"{clock.topic}: log time minus stamp '{clock.stamp}' is {clock.log_minus_stamp_s:.3f} s in the median, "
        f"{clock.spread_s:.3f} s between its 5th and 95th percentile"
    )
    return Note(f"{clock.role}_clock_offset", text, clock.messages)
