"""What a log holds of one topic that plays a role, as columns, and the clock that stamps it.

The recorder's log time is the one clock that all topics share. Log time minus stamp is what a topic's own clock is away
from it, plus the time that messages take; two topics whose clocks differ in it cannot be replayed together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs, distinct, nanoseconds
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.columns.topic_requirements import Source, code_of
from insdvl_replay.logs.container.loss import damaged_file_error
from insdvl_replay.logs.encoding.fields import Columns, Kinds, fields_hint, split_paths

SAME_CLOCK_S: Final = 1.0
"""Messages are not under way for longer than this; clocks further apart are two clocks."""
LARGEST_JITTER_S: Final = 1.0
"""What varies by more between stamp and recording is no jitter: the clock drifts, or jumps."""
_NS: Final = 1e-9
_NS_PER_US: Final = 1000.0
_UNITS: Final = ((1, "nanoseconds"), (10**3, "microseconds"), (10**6, "milliseconds"), (10**9, "seconds"))
_UNIX_TIME_S: Final = 1e8
"""The time since 1970 has been longer than this since 1973."""
_IN_STEP: Final = 0.2
"""A recorder that writes as messages come keeps step with their stamps better than this; units are 1000 apart."""


def measure_clock(role: str, topic: str, stamp: str, time_ns: TimeNs, log_time_ns: TimeNs) -> Clock:
    """Compare the stamps of a topic with the times of its recording, both of shape (k,), in the file's order."""
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

    The clock of the IMU is the first. Log time minus stamp may differ by so much between it and another role's, beyond
    the spread of both. A latency is how late a message was stamped, as of a fix that took seconds, or how far its clock
    is off, which it mends: one of the two clocks, with it taken off or without, has to be the IMU's.
    """
    imu, *others = clocks
    notes = [
        _offset_note(clock) for clock in clocks if min(map(abs, _both_ways(clock))) > SAME_CLOCK_S + clock.spread_s
    ]
    notes += [_unsteady_note(clock) for clock in clocks if clock.spread_s > LARGEST_JITTER_S]
    for other in others:
        jitter_s = min(other.spread_s, LARGEST_JITTER_S) + min(imu.spread_s, LARGEST_JITTER_S)
        apart_s = min(abs(one - another) for one in _both_ways(other) for another in _both_ways(imu)) - jitter_s
        both = f"{imu.topic} and {other.topic}" if imu.topic != other.topic else f"imu and {other.role} of {imu.topic}"
        text = (
            f"{both} are stamped by different clocks: log time minus stamp is "
            f"{imu.log_minus_stamp_s:.3f} s on the one and {other.log_minus_stamp_s:.3f} s on the other"
            f"{_latency_words(imu, other)}"
        )
        to_set = (f"--set {clock.role}.stamp=log_time" for clock in (imu, other) if clock.stamp != "log_time")
        by_recorder = f"{' '.join(to_set)} stamps both by the recorder"
        if apart_s > max_disagreement_s:
            hint = f"{by_recorder}; if they do belong together, raise clocks.max_disagreement_s"
            raise LogError(text, hint, place)
        if apart_s > SAME_CLOCK_S:
            text += "; clocks.max_disagreement_s allows it"
            notes.append(Note("clocks_apart", text, other.messages, Severity.WARNING, by_recorder))
    return tuple(notes)


def _both_ways(clock: Clock) -> tuple[float, float]:
    """Return log time minus stamp, s, as the log has it, and with the latency taken off the stamps."""
    return clock.log_minus_stamp_s, clock.log_minus_stamp_s + clock.latency_s


def _latency_words(*clocks: Clock) -> str:
    """Say what is taken off the stamps, of which the log knows nothing."""
    return "".join(
        f"; {clock.role}.latency_s takes {clock.latency_s:g} s off the stamps" for clock in clocks if clock.latency_s
    )


def stamp_unit(values: NDArray[Any], log_time_ns: TimeNs) -> tuple[int, str]:
    """Find in which unit a stamp that is a mere number counts: its nanoseconds, and its name.

    They tell it by how far they run, shape (k,), while the recorder's clock runs on, which holds for the time since
    power-up too. Where the recorder's clock does not keep step with them, because the log was written later, their size
    has to do: it is taken for the time since 1970.
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
        f"{code_of(clock.role)}_clock_unsteady",
        text,
        clock.messages,
        Severity.WARNING,
        f'{clock.role}.stamp = "log_time"',
    )


def _offset_note(clock: Clock) -> Note:
    text = (
        f"{clock.topic}: log time minus stamp '{clock.stamp}' is {clock.log_minus_stamp_s:.3f} s in the median, "
        f"{clock.spread_s:.3f} s between its 5th and 95th percentile{_latency_words(clock)}"
    )
    return Note(f"{code_of(clock.role)}_clock_offset", text, clock.messages)


RECORDER_STAMPS: Final = ("log_time", "publish_time")
"""Stamps that stand in no message."""


SAMPLED: Final = ("pose_cov", "twist_cov")
"""Quantities that change slowly, and are large: what a solution says of its errors."""
MOST_SAMPLED: Final = 20_000
"""So many of their rows are kept, in all 7 MB of an odometry; of more messages, evenly some."""


@dataclass(frozen=True)
class Sampled:
    """What is kept of the quantities in `SAMPLED`.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (s, n)
        By field path.
    rows : ndarray of int64, shape (s,)
        Rows of the table from which they are, in the order of the columns.
    """

    columns: Columns
    rows: NDArray[np.int64]

    def among(self, rows: NDArray[np.int64], count: int) -> "Sampled":
        """Keep what is among some rows of a table that had so many, numbered by their places in these."""
        place = np.full(count, -1, np.int64)
        place[rows] = np.arange(len(rows))
        order = np.argsort(place[self.rows], kind="stable")
        order = order[place[self.rows[order]] >= 0]
        return Sampled({path: values[order] for path, values in self.columns.items()}, place[self.rows[order]])


@dataclass(frozen=True)
class Table:
    """The messages of one topic, as the log has them: not sorted, not checked, in the log's units and axes.

    Attributes
    ----------
    where : (str, str)
        File and topic, for messages to the user.
    columns : dict of str to ndarray, shape (k, n)
        By field path; ``log_time`` and ``publish_time`` are the recorder's.
    unreadable_ns : tuple of int
        Log times of messages that are left out because they do not fit their schema.
    fault : LogError or None
        What is wrong with the first of these.
    duplicates : int
        Messages that are left out because another channel or file holds them too.
    known : mapping of str to str
        Every path that the messages have, with the type of what is there.
    files : ndarray of int64, shape (k,), or None
        Number of the file from which each message is, where they are from several.
    others : int
        Messages without a row, less the rows that some messages have beyond one.
    has_whole_times : bool
        Whether the stamps were seconds and nanoseconds. Their column is nanoseconds, which takes half the memory.
    sampled : Sampled
        The quantities that stand in evenly chosen messages alone.
    """

    where: tuple[str, str]
    source: Source
    columns: Columns
    unreadable_ns: tuple[int, ...] = ()
    fault: LogError | None = None
    duplicates: int = 0
    known: Kinds = field(default_factory=dict)
    files: NDArray[np.int64] | None = None
    has_whole_times: bool = False
    others: int = 0
    sampled: Sampled = field(default_factory=lambda: Sampled({}, np.empty(0, np.int64)))

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(next(iter(self.columns.values())))

    def __contains__(self, quantity: str) -> bool:
        """Return whether the topic holds a quantity."""
        return quantity in self.source.fields

    def values(self, quantity: str, width: int | None = None) -> Floats:
        """Return a quantity as numbers, shape (k, n); a LogError where each message must hold more or fewer.

        One of `SAMPLED` has the shape (s, n).
        """
        path, columns = self.source.fields[quantity], self.sampled.columns if quantity in SAMPLED else self.columns
        parts = [columns[part].astype(np.float64, copy=False) for part in split_paths(path)]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if width is not None and values.shape[1] != width:
            raise LogError(
                f"field '{path}' holds {values.shape[1]} numbers where {width} are needed",
                f"{self.source.role}.{quantity} must name {width} numbers; {fields_hint(self.known, path)}",
                *self.where,
            )
        return values

    def column(self, quantity: str) -> Floats:
        """Return a quantity that must be one number in each message, shape (k,)."""
        single: Floats = self.values(quantity, 1)[:, 0]
        return single

    def time_ns(self) -> TimeNs:
        """Return the times of validity, shape (k,); a LogError where the stamp is no time, or always the same.

        What is measured over an interval, at whose end it is stamped, is valid in the middle of it.
        """
        stamp = self.source.stamp
        time_ns = self.columns[stamp][:, 0] if stamp in RECORDER_STAMPS else self._stamped(stamp_path(stamp))
        if time_ns.size > 1 and time_ns.min() == time_ns.max():
            raise LogError(
                f"stamp '{stamp}' is {time_ns[0] / NS_PER_S:.9f} s in each of {time_ns.size} messages",
                f'{self.source.role}.stamp = "log_time"',
                *self.where,
            )
        latency_ns = nanoseconds(self.source.latency_s)
        if "interval_us" in self:
            interval_us = self.column("interval_us")
            possible = (interval_us >= 0.0) & (interval_us < 2.0**32)
            half_ns = np.rint(np.where(possible, interval_us, 0.0) * (_NS_PER_US / 2.0)).astype(np.int64)
            time_ns = time_ns - half_ns
        return time_ns - latency_ns if latency_ns else time_ns

    @property
    def stamp_numbers(self) -> NDArray[Any] | None:
        """Stamps that are mere numbers, shape (k,); None where they are times."""
        values = self.columns[stamp_path(self.source.stamp)]
        is_time = self.source.stamp in RECORDER_STAMPS or self.has_whole_times or values.shape[1] != 1
        return None if is_time else values[:, 0]

    def clock(self) -> Clock:
        """Compare the stamps with the times of recording; what is measured over an interval has the middle of it."""
        source = self.source
        clock = measure_clock(source.role, source.topic, source.stamp, self.time_ns(), self.columns["log_time"][:, 0])
        by_log_s = clock.log_minus_stamp_s - source.latency_s
        return replace(clock, log_minus_stamp_s=by_log_s, latency_s=source.latency_s)

    def damage_error(self) -> LogError:
        """Return the error with which a log is refused of which messages cannot be read."""
        faults = [self.fault] * len(self.unreadable_ns) if self.fault else []
        return damaged_file_error(faults, [self.columns["log_time"][:, 0]], "messages")

    def _stamped(self, path: str) -> TimeNs:
        values = self.columns[path]
        if self.has_whole_times:
            return values[:, 0]
        if values.shape[1] != 1:
            raise LogError(
                f"field '{path}' holds {values.shape[1]} numbers and is no time",
                f"{self.source.role}.stamp names a builtin_interfaces/Time or one number",
                *self.where,
            )
        if not np.isfinite(values).all():
            raise LogError(
                f"stamp '{path}' is no number in {np.count_nonzero(~np.isfinite(values))} messages",
                f'{self.source.role}.stamp = "log_time"',
                *self.where,
            )
        counted = values[:, 0] * stamp_unit(values[:, 0], self.columns["log_time"][:, 0])[0]
        return counted if counted.dtype == np.int64 else np.rint(counted).astype(np.int64)


def stamp_path(stamp: str) -> str:
    """Return the field of a stamp; ``header`` is short for that of a ROS message."""
    return "header.stamp" if stamp == "header" else stamp
