"""The messages of one topic as columns, read from a log block by block, and the clocks and the order of their stamps.

The recorder's log time is the one clock that all topics share. Log time minus stamp is the offset of a topic's own
clock from it, plus the time that messages take. Two topics whose clocks differ in it cannot be replayed together.
Messages that overtake each other, or parts of a log that are joined in another order, are only put in their places. A
stamp that jumps while the log time goes on is wrong.
"""

import math
import re
import sys
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Array,
    Floats,
    Integers,
    Mask,
    TimeNs,
    distinct,
    find_runs,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.dive_record import Clock
from insdvl_replay.core.errors import LogError, Note, counted, error_context, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.units import TIME_UNITS_NS
from insdvl_replay.logs.columns.topics import Source, code_of
from insdvl_replay.logs.formats.fields import (
    ROW,
    ROWS,
    TABLE,
    Columns,
    FieldReader,
    Kinds,
    fields_hint,
    split_paths,
)
from insdvl_replay.logs.formats.log_file import Block, LogChannel, damaged_file_error
from insdvl_replay.logs.formats.readers import column_of, open_reader
from insdvl_replay.logs.formats.recording import CHANNELS_OF_A_PART, Recording

Rows = Integers

RECORDER_STAMPS: Final = ("log_time", "publish_time")  # stamps that are in no message
# Quantities that change slowly, and are large.
SAMPLED: Final = ("pose_cov", "twist_cov", "position_cov", "position_cov_type")
# So many of their rows are kept, in all 7 MB of an odometry; of more messages, some.
MOST_SAMPLED: Final = 20_000
# As a stamp: of the rows of a table.
_RATE: Final = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?) ?Hz")
# As a stamp: a field, and the unit of its numbers.
_WITH_UNIT: Final = re.compile(rf"(.+?) ?\[({'|'.join(TIME_UNITS_NS)})\]")
_UNDER_WAY: Final = 1000  # messages at most that are under way from a sensor to the recorder
# Where so many messages cannot be read, and fewer can, the schema is wrong.
_HOPELESS: Final = 1000


def stamp_path(stamp: str) -> str:
    """Return the field of a stamp: of ``header`` that of a ROS message, of a rate such as ``100 Hz`` the row number."""
    if _RATE.fullmatch(stamp):
        return ROW
    with_unit = _WITH_UNIT.fullmatch(stamp)
    if with_unit:
        return with_unit[1]
    if stamp == "header":
        return "header.stamp"
    return stamp


@dataclass(frozen=True)
class Table:
    """The messages of one topic as the log has them: not sorted, not checked, in the log's units and axes."""

    where: tuple[str, str]  # file and topic, for messages to the user
    source: Source
    # By field path, (k, n); those of `SAMPLED` quantities have the sampled rows alone.
    columns: Columns
    # Log times of messages that are left out because they do not fit their schema.
    unreadable_ns: tuple[int, ...] = ()
    fault: LogError | None = None  # what is wrong with the first of these
    # Messages that are left out because another channel or file holds them too.
    duplicates: int = 0
    # Every path that the messages have, with the type of what is there.
    known: Kinds = field(default_factory=dict)
    files: Rows | None = None  # (k,), the file of each message, where they are from several
    has_whole_times: bool = False  # stamps were seconds and nanoseconds, and are nanoseconds
    others: int = 0  # messages without a row, less the rows that some messages have beyond one
    # Rows of the `SAMPLED` quantities.
    sampled: Rows = field(default_factory=lambda: np.empty(0, np.int64))
    # Where the recorder's clock was set, stamps of messages under way have the old one, and are off by more than this.
    old_clock_ns: int | None = None

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.columns["log_time"])

    def __contains__(self, quantity: str) -> bool:
        """Return whether the topic holds a quantity."""
        return quantity in self.source.fields

    def values(self, quantity: str, width: int | None = None) -> Floats:
        """Return the numbers of a quantity, shape (k, width); a LogError where there are more or fewer."""
        path = self.source.fields[quantity]
        parts = [self._numbers(part) for part in split_paths(path)]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if width is not None and values.shape[1] != width:
            raise LogError(
                f"field '{path}' has {values.shape[1]} numbers, but {width} are needed",
                f"set {self.source.role}.{quantity} to {width} numbers; {fields_hint(self.known, path)}",
                *self.where,
            )
        return values

    def _numbers(self, path: str) -> Floats:
        """Return the numbers at a path, (k, n), in the usual unit where the title of a column has another."""
        numbers = self.columns[path].astype(np.float64, copy=False)
        factor = self.source.factors.get(path, 1.0)
        if factor == 1.0:
            return numbers
        return numbers * factor

    def column(self, quantity: str) -> Floats:
        """Return a quantity that must be one number in each message, shape (k,)."""
        single: Floats = self.values(quantity, 1)[:, 0]
        return single

    @property
    def stamp_numbers(self) -> Array | None:
        """Stamps that are plain numbers, shape (k,); None where they are times."""
        stamp = self.source.stamp
        path = stamp_path(stamp)
        values = self.columns[path]
        if stamp in RECORDER_STAMPS or self.has_whole_times or values.shape[1] != 1:
            return None
        if _RATE.fullmatch(stamp) or _WITH_UNIT.fullmatch(stamp) or self.is_time_column(path):
            return None
        return values[:, 0]

    def is_time_column(self, path: str) -> bool:
        """Return whether a stamp without unit is the column of a table by which its rows have their log times."""
        if path != self.source.stamp or path in RECORDER_STAMPS or not self.source.channels:
            return False
        channel = self.source.channels[0]
        return bool(channel.time_column) and column_of(channel, path) == channel.time_column

    def time_ns(self) -> TimeNs:
        """Return the times of validity, shape (k,); a LogError where the stamp is no time, or always the same.

        What is measured over an interval, at whose end it is stamped, is valid in the middle of it.
        """
        stamp = self.source.stamp
        time_ns = self._stamps_ns()
        if self.old_clock_ns is not None:
            time_ns = with_one_clock(time_ns, self.columns["log_time"][:, 0], self.old_clock_ns)
        if time_ns.size > 1 and time_ns.min() == time_ns.max():
            text = f"stamp '{stamp}' is {time_ns[0] / NS_PER_S:.9f} s in each of {time_ns.size} messages"
            raise LogError(text, f'{self.source.role}.stamp = "log_time"', *self.where)
        if "interval_us" in self:
            interval_us = self.column("interval_us")
            possible = (interval_us >= 0.0) & (interval_us < 2.0**32)
            half_ns = np.where(possible, interval_us, 0.0) * 500.0
            time_ns = time_ns - np.rint(half_ns).astype(np.int64)
        latency_ns = nanoseconds(self.source.latency_s)
        if latency_ns:
            return time_ns - latency_ns
        return time_ns

    def _stamps_ns(self) -> TimeNs:
        """Return the times of the stamps as they are written, shape (k,)."""
        stamp = self.source.stamp
        path = stamp_path(stamp)
        values = self.columns[path]
        log_time_ns: TimeNs = self.columns["log_time"][:, 0]
        if self.is_time_column(path):
            return log_time_ns
        if stamp in RECORDER_STAMPS or self.has_whole_times:
            return np.asarray(values[:, 0])
        if values.shape[1] != 1:
            text = f"field '{path}' has {values.shape[1]} numbers and is no time"
            hint = f"set {self.source.role}.stamp to a builtin_interfaces/Time or one number"
            raise LogError(text, hint, *self.where)
        missing = int(np.count_nonzero(~np.isfinite(values)))
        if missing:
            text = f"stamp '{path}' is not a number in {counted(missing, 'message')}"
            raise LogError(text, f'{self.source.role}.stamp = "log_time"', *self.where)
        counted_ns = _counted_ns(stamp, values[:, 0], log_time_ns)
        if counted_ns.dtype != np.int64:
            counted_ns = np.rint(counted_ns).astype(np.int64)
        return counted_ns

    def clock(self) -> Clock:
        """Compare the stamps with the times of recording; what is measured over an interval has the middle of it."""
        source = self.source
        log_time_ns = self.columns["log_time"][:, 0]
        return measure_clock(
            source.role, source.topic, source.stamp, self.time_ns(), log_time_ns, source.latency_s
        )

    def damage_error(self) -> LogError:
        """Return the error with which a log is refused of which messages cannot be read."""
        faults = [self.fault] * len(self.unreadable_ns) if self.fault else []
        return damaged_file_error(faults, [self.columns["log_time"][:, 0]], "message")


def _counted_ns(stamp: str, numbers: Array, log_time_ns: TimeNs) -> Array:
    """Return the times of stamps that are plain numbers, (k,): of rows, in a unit, or in that which they show."""
    rate = _RATE.fullmatch(stamp)
    if rate:
        steps_ns = np.rint(numbers * (NS_PER_S / float(rate[1])))
        return np.asarray(int(log_time_ns.min()) + steps_ns.astype(np.int64))
    with_unit = _WITH_UNIT.fullmatch(stamp)
    if with_unit:
        # With pandas, which other logs do not need.
        from insdvl_replay.logs.formats.table_times import in_ns

        return in_ns(numbers, with_unit[2])
    unit_ns, _ = stamp_unit(numbers, log_time_ns)
    return np.asarray(numbers * unit_ns)


def with_one_clock(
    time_ns: TimeNs,
    log_time_ns: TimeNs,
    ahead_ns: int,
) -> TimeNs:
    """Return stamps, those of the clock before it was set moved to the usual time before their log times.

    They are ahead by more than so much, or far behind.
    """
    behind_ns = log_time_ns - time_ns
    usual_ns = int(np.median(behind_ns))
    is_old = behind_ns - usual_ns > nanoseconds(LEAP_S)
    is_old |= usual_ns - behind_ns > ahead_ns
    few = np.count_nonzero(is_old) <= _UNDER_WAY
    if few:
        return np.where(is_old, log_time_ns - usual_ns, time_ns)
    return time_ns


def read_tables(log: Recording, sources: Sequence[Source]) -> list[Table]:
    """Read the columns of several topics, in the order of the sources."""
    builders = [_Builder(log, source) for source in sources]
    channel_ids: set[int] = set()
    for source in sources:
        channel_ids.update(channel.id for channel in source.channels)
    for block in log.blocks(channel_ids):
        for builder in builders:
            builder.add(block)
    return [builder.table() for builder in builders]


def read_sample(log: Recording, source: Source, enough: int) -> Table:
    """Read the columns of a topic's first rows, up to the block with which there are enough."""
    builder = _Builder(log, source, enough)
    for block in log.blocks({channel.id for channel in source.channels}):
        builder.add(block)
        if builder.count >= enough:
            break
    return builder.table()


class Column:
    """A column that fills block by block; the log announces how many rows it will have.

    Where all rows are the same, one stands for all.
    """

    def __init__(self, announced: int) -> None:
        self._announced = announced
        self._first: Array = np.empty((1, 0), np.int64)
        self._rows: Array | None = None
        self._count = 0

    def add(self, values: Array) -> None:
        """Add rows, (k, n); whole numbers stay whole until others come, and shorter rows are filled up with NaN."""
        if not self._count:
            self._first = values[:1].copy()
        before = self.values()
        self._count += len(values)
        is_even = before.shape[1] == values.shape[1]
        is_alike = is_even and before.dtype == values.dtype
        if self._rows is None and is_alike and _all_are(values, self._first):
            return
        width = max(before.shape[1], values.shape[1])
        dtype = np.result_type(before, values) if is_even else np.dtype(np.float64)
        self._rows = self._with_room(before, width, dtype)
        _fill(self._rows[len(before) : self._count], values)

    def _with_room(
        self,
        before: Array,
        width: int,
        dtype: np.dtype[Any],
    ) -> Array:
        """Return the rows so far, copied where there is no room for more, or for numbers of another kind."""
        room = self._announced
        if self._rows is not None:
            is_alike = (width, dtype) == (before.shape[1], before.dtype)
            if is_alike and self._count <= len(self._rows):
                return self._rows
            room = 2 * len(before)
        # Component by component, as messages are read and as numpy goes through rows of three the fastest.
        rows = np.empty((max(self._count, room), width), dtype, order="F")
        _fill(rows[: len(before)], before)
        return rows

    def values(self) -> Array:
        """Return the rows so far."""
        if self._rows is None:
            return np.broadcast_to(self._first, (self._count, self._first.shape[1]))
        return self._rows[: self._count]


def _all_are(values: Array, first: Array) -> bool:
    """Return whether all rows are as one; the last mostly tells that they are not."""
    alike = np.broadcast_to(first, values.shape)
    if not np.array_equal(values[-1:], alike[-1:], equal_nan=True):
        return False
    return np.array_equal(values, alike, equal_nan=True)


def _fill(rows: Array, values: Array) -> None:
    rows[:, : values.shape[1]] = values
    if values.shape[1] < rows.shape[1]:
        rows[:, values.shape[1] :] = np.nan


class _Builder:
    """Collects the columns of one topic, block by block."""

    def __init__(
        self,
        log: Recording,
        source: Source,
        enough: int = sys.maxsize,
    ) -> None:
        self.log = log
        self.source = source
        self.where = (str(log.path), source.topic)
        announced = sum(channel.messages for channel in source.channels)
        self.every = max(1, math.ceil(announced / MOST_SAMPLED))
        self.count = 0
        self.seen = Counter[int]()  # messages by channel
        # Found before any message is read, since they look through the whole file themselves.
        self.clock = log.one_clock
        self.side = log.one_side
        self.others = 0
        self.has_whole_times = False
        self.runs: list[
            tuple[int, int]
        ] = []  # a channel, and how many messages in a row are of it
        self.unreadable_ns: list[int] = []
        self.fault: LogError | None = None
        self.sampled: set[str] = set()
        paths = [stamp_path(source.stamp), "log_time"]
        for quantity, joined in source.fields.items():
            paths += split_paths(joined)
            if quantity in SAMPLED:
                self.sampled.update(split_paths(joined))
        self.columns: dict[str, Column] = {}
        for path in paths:
            step = self.every if path in self.sampled else 1
            self.columns[path] = Column(min(announced, enough) // step + 1)
        self.readers = {channel.id: self._reader(channel) for channel in source.channels}

    def _reader(self, channel: LogChannel) -> FieldReader:
        with error_context(*self.where):
            paths = [path for path in self.columns if path not in RECORDER_STAMPS]
            return open_reader(channel, paths, self.source.element)

    def add(self, block: Block) -> None:
        """Read a block if it is of this topic."""
        if block.channel_id not in self.readers:
            return
        count = len(block)
        block = self._of_one_clock(block)
        self.others += count - len(block)
        if not len(block):
            return
        for whole, fields in self._readable(self.readers[block.channel_id], block):
            part = whole.part(fields[ROWS][:, 0]) if ROWS in fields else whole
            self.others += len(whole) - len(part)
            if not len(part):
                continue
            chosen = slice(-self.count % self.every, None, self.every)
            for path, column in self.columns.items():
                values = getattr(part, path)[:, None] if path in RECORDER_STAMPS else fields[path]
                if path == stamp_path(self.source.stamp) and values.shape[1] == 2:
                    self.has_whole_times = True
                    values = _whole_times_ns(values)
                if path in self.sampled:
                    values = values[chosen]
                if len(values):
                    column.add(values)
            self.runs.append((part.channel_id, len(part)))
            self.count += len(part)

    def _of_one_clock(self, block: Block) -> Block:
        """Return the messages of a block with the clock that is used. Rows of a side count among those of its part."""
        if self.clock is not None:
            block = block.part(np.flatnonzero(self.clock.holds(block.log_time)))
        if self.side is not None:
            first = self.seen[block.channel_id]
            self.seen[block.channel_id] += len(block)
            used = self.side.holds_rows(block.channel_id, first, block.log_time)
            block = block.part(np.flatnonzero(used))
        return block

    def _readable(self, reader: FieldReader, block: Block) -> Iterator[tuple[Block, Columns]]:
        """Read a block, in halves and halves of halves where some of it cannot be read, part by part."""
        try:
            with error_context(*self.where):
                columns = reader.columns(block)
        except LogError as error:
            if len(block) > 1:
                half = len(block) // 2
                yield from self._readable(reader, block.part(slice(None, half)))
                yield from self._readable(reader, block.part(slice(half, None)))
                return
            self.fault = self.fault or error
            self.unreadable_ns.append(int(block.log_time[0]))
            if len(self.unreadable_ns) > max(_HOPELESS, self.count + self.others):
                raise self.fault from None
        else:
            yield block, columns

    def table(self) -> Table:
        """Return what has been read; a LogError where some of it cannot be used."""
        if not self.count:
            raise self.fault or self._has_nothing()
        columns = {path: column.values() for path, column in self.columns.items()}
        sampled = {path: columns.pop(path) for path in self.sampled}
        columns, channel_ids, rows = merge_channels(columns, self.runs)
        sampled_rows = np.arange(0, self.count if sampled else 0, self.every)
        duplicates = 0
        if rows is not None:
            order, sampled_rows = rows_among(sampled_rows, rows, self.count)
            sampled = {path: values[order] for path, values in sampled.items()}
            duplicates = self.count - len(rows)
        table = Table(
            where=self.where,
            source=self.source,
            columns=columns | sampled,
            unreadable_ns=tuple(self.unreadable_ns),
            fault=self.fault,
            duplicates=duplicates,
            known=next(iter(self.readers.values())).known,
            files=_files_of(channel_ids),
            has_whole_times=self.has_whole_times,
            others=self.others,
            sampled=sampled_rows,
            old_clock_ns=_old_clock_ns(self.log),
        )
        if self.unreadable_ns and not self.log.allow_damaged:
            raise table.damage_error()
        if self.source.channels[0].encoding == TABLE and self.source.stamp not in RECORDER_STAMPS:
            # A table has no recorder: the column that the settings name takes its place.
            time_ns = table.time_ns() + nanoseconds(self.source.latency_s)
            return replace(table, columns={**table.columns, "log_time": time_ns[:, None]})
        return table

    def _has_nothing(self) -> LogError:
        """State that there are no messages, or which elements there are where none is what was asked for."""
        element = self.source.element
        if element is None:
            hint = "the counts in the log's summary are wrong"
            return LogError("has no messages", hint, *self.where)
        seen: set[tuple[str, ...]] = set()
        for reader in self.readers.values():
            seen.update(getattr(reader, "seen", ()))
        pairs = [f"{self.source.role}.frames = {toml_value(texts)}" for texts in sorted(seen)]
        asked = f"has no transform from {' to '.join(element.texts)}" if element.texts else ""
        hint = f"it has {listed(pairs)}" if pairs else "its messages are empty"
        return LogError(asked or "has transforms of many frames", hint, *self.where)


def _old_clock_ns(log: Recording) -> int | None:
    """Return how far stamps of a clock that was set are off at least; None where none was set."""
    if log.one_side is not None:
        return log.one_side.back_ns // 2
    if log.one_clock is not None:
        return nanoseconds(LEAP_S)
    return None


def _files_of(channel_ids: Rows) -> Rows | None:
    """Return the file of each message by its channel, (k,); None where all are of one."""
    files = channel_ids // CHANNELS_OF_A_PART
    if files.size and files.min() != files.max():
        return files
    return None


def _whole_times_ns(values: Array) -> Array:
    """Return times that are seconds and nanoseconds, (k, 2), as nanoseconds, (k, 1)."""
    time_ns = values[:, :1] * NS_PER_S + values[:, 1:]
    if time_ns.dtype != np.int64:
        # Where they are missing, time 0 is wrong in any log.
        time_ns = np.where(np.abs(time_ns) < 2.0**63, time_ns, 0.0).astype(np.int64)
    return np.asarray(time_ns)


def rows_among(some: Rows, rows: Rows, count: int) -> tuple[Rows, Rows]:
    """Find some rows of a table of so many among others: which there are, in the order of these, and their places."""
    place = np.full(count, -1, np.int64)
    place[rows] = np.arange(len(rows))
    order = np.argsort(place[some], kind="stable")
    order = order[place[some[order]] >= 0]
    return order, place[some[order]]


def merge_channels(
    columns: Columns, runs: Sequence[tuple[int, int]]
) -> tuple[Columns, Rows, Rows | None]:
    """Merge the messages of several channels by log time, each in its own order, and leave out repetitions.

    The runs are channels, and how many messages in a row are of each. Repetitions are messages that another channel
    holds too, with the same log time and values. Return the columns, the channel of each message (none where all are
    of one), and which messages these are (None where all are of one channel).
    """
    if len({channel_id for channel_id, _ in runs}) < 2:
        return columns, np.empty(0, np.int64), None
    channel_ids = np.repeat(*np.transpose(runs))
    # Sorted by the latest log time of its channel yet, no message moves against others of its channel.
    reached = np.empty(channel_ids.size, np.int64)
    log_time = columns["log_time"][:, 0]
    for channel_id in np.unique(channel_ids):
        own = channel_ids == channel_id
        reached[own] = np.maximum.accumulate(log_time[own])
    order = np.argsort(reached, kind="stable")
    columns = {path: values[order] for path, values in columns.items()}
    kept = np.flatnonzero(~repeated_rows(columns, channel_ids[order]))
    if len(kept) < len(order):
        columns = {path: values[kept] for path, values in columns.items()}
    return columns, channel_ids[order][kept], order[kept]


def repeated_rows(columns: Columns, origin: Rows) -> Mask:
    """Find which messages are as the one before, which is of another origin: another channel or file; shape (k,)."""
    log_time = columns["log_time"][:, 0]
    rows = 1 + np.flatnonzero((log_time[1:] == log_time[:-1]) & (origin[1:] != origin[:-1]))
    same = np.ones(rows.size, np.bool_)
    for values in columns.values():
        now = values[rows]
        before = values[rows - 1]
        same &= np.all((now == before) | (np.isnan(now) & np.isnan(before)), axis=1)
    repeated = np.zeros(origin.size, np.bool_)
    repeated[rows] = same
    return repeated


# --- Clocks.

# Messages are not under way for longer; clocks further apart are two clocks.
SAME_CLOCK_S: Final = 1.0
# What varies by more between stamp and recording is a drift or a jump.
LARGEST_JITTER_S: Final = 1.0
FEW_PLACES: Final = 5  # messages do not overtake more others than this
LEAP_S: Final = 3600.0  # stamps that run ahead of the log time by more at once are those of a clock that was set
_UNITS: Final = (
    (1, "nanoseconds"),
    (10**3, "microseconds"),
    (10**6, "milliseconds"),
    (10**9, "seconds"),
)
_UNIX_TIME_S: Final = 1e8  # the time since 1970 has been longer than this since 1973
# A recorder keeps step with the stamps better than this; units are 1000 apart.
_IN_STEP: Final = 0.2


def measure_clock(
    role: str,
    topic: str,
    stamp: str,
    time_ns: TimeNs,
    log_time_ns: TimeNs,
    latency_s: float = 0.0,
) -> Clock:
    """Compare stamps, without the latency, with the times of recording, both of shape (k,), in the file's order."""
    # As arrays, whose sums go round at 2^64: log times behind 2^63 still give what they are behind.
    behind_ns = log_time_ns - time_ns
    first_ns = int(behind_ns[0])
    behind_ns -= first_ns
    low, median, high = np.percentile(behind_ns, (5, 50, 95)).tolist()
    # In place: such arrays are large.
    steps_ns = np.subtract(time_ns[1:], time_ns[:-1], out=behind_ns[1:])
    back_steps = int(np.count_nonzero(steps_ns < 0))
    repeats = int(np.count_nonzero(steps_ns == 0))
    changes = steps_ns.size - repeats
    if back_steps:
        changes = len(distinct(time_ns)) - 1
    span_ns = int(time_ns.max()) - int(time_ns.min())
    return Clock(
        role=role,
        topic=topic,
        stamp=stamp,
        messages=len(time_ns),
        log_minus_stamp_s=round((float(first_ns) + median) * 1e-9 - latency_s, 12) + 0.0,
        spread_s=(high - low) * 1e-9,
        back_steps=back_steps,
        repeats=repeats,
        rate_hz=changes / (span_ns * 1e-9) if changes else None,
        latency_s=latency_s,
    )


def clock_notes(
    place: str, clocks: Sequence[Clock], max_disagreement_s: float
) -> tuple[Note, ...]:
    """Refuse to mix clocks that have nothing to do with each other, and say which of them are not the recorder's.

    The clock of the IMU is the first. Log time minus stamp may differ by so much between it and another role's, beyond
    the spread of both. A latency is how late a message was stamped, as of a fix that took seconds, or how far its clock
    is off, which it mends: one of the two clocks, with it taken off or without, has to be the IMU's.
    """

    imu, *others = clocks
    notes = [*map(_offset_note, clocks), *map(_unsteady_note, clocks)]
    notes += [_apart_note(place, imu, other, max_disagreement_s) for other in others]
    return tuple(note for note in notes if note is not None)


def _offset_note(clock: Clock) -> Note | None:
    """Note that stamps are not of the recorder's clock."""
    if min(map(abs, _both_ways(clock))) <= SAME_CLOCK_S + clock.spread_s:
        return None
    offset = note(
        f"{code_of(clock.role)}_clock_offset",
        clock.messages,
        stamp=clock.stamp,
        offset_s=clock.log_minus_stamp_s,
        spread_s=clock.spread_s,
        latency=_latency(clock),
    )
    return offset.about(clock.topic)


def _unsteady_note(clock: Clock) -> Note | None:
    """Note that the clock of the stamps drifts or jumps."""
    if clock.spread_s <= LARGEST_JITTER_S:
        return None
    unsteady = note(
        f"{code_of(clock.role)}_clock_unsteady",
        clock.messages,
        spread_s=clock.spread_s,
        role=clock.role,
    )
    return unsteady.about(clock.topic)


def _apart_note(
    place: str,
    imu: Clock,
    other: Clock,
    max_disagreement_s: float,
) -> Note | None:
    """Note that a clock is not that of the IMU; refuse it where it is too far off."""
    pairs = product(_both_ways(other), _both_ways(imu))
    jitter_s = min(other.spread_s, LARGEST_JITTER_S) + min(imu.spread_s, LARGEST_JITTER_S)
    apart_s = min(abs(theirs_s - ours_s) for theirs_s, ours_s in pairs) - jitter_s
    if apart_s <= min(max_disagreement_s, SAME_CLOCK_S):
        return None
    both = f"{imu.topic} and {other.topic}"
    if imu.topic == other.topic:
        both = f"imu and {other.role} of {imu.topic}"
    text = (
        f"{both} are stamped by different clocks: log time minus stamp is {imu.log_minus_stamp_s:.3f} s and "
        f"{other.log_minus_stamp_s:.3f} s{_latency(imu)}{_latency(other)}"
    )
    stamped = [clock for clock in (imu, other) if clock.stamp != "log_time"]
    to_set = " ".join(f"--set {clock.role}.stamp=log_time" for clock in stamped)
    allowed = note(
        "clocks_apart",
        other.messages,
        apart=text,
        settings=to_set,
    )
    if apart_s > max_disagreement_s:
        hint = f"{allowed.hint}; if the clocks are right, raise clocks.max_disagreement_s"
        raise LogError(text, hint, place)
    return allowed


def _both_ways(clock: Clock) -> tuple[float, float]:
    """Return log time minus stamp with the latency in it, and without; s."""
    return clock.log_minus_stamp_s, clock.log_minus_stamp_s + clock.latency_s


def _latency(clock: Clock) -> str:
    """State the latency that the settings subtract from the stamps, if there is one."""
    if not clock.latency_s:
        return ""
    return f"; {clock.role}.latency_s subtracts {clock.latency_s:g} s from the stamps"


def stamp_unit(values: Array, log_time_ns: TimeNs) -> tuple[int, str]:
    """Find the unit of stamps that are mere numbers, shape (k,): its nanoseconds, and its name.

    It shows in how far they run while the recorder's clock runs on, which holds for the time since power-up too. Where
    the recorder's clock does not keep step with them, because the log was written later, their size decides: it is
    taken for the time since 1970.
    """
    ran = float(values[-1]) - float(values[0])
    recorded_s = float(log_time_ns[-1] - log_time_ns[0]) * 1e-9
    for unit in _UNITS:
        # The last row of a table that is out of order may be earlier than its first.
        if abs(ran * unit[0] * 1e-9 - recorded_s) < _IN_STEP * abs(recorded_s):
            return unit
    size = float(np.median(np.abs(values)))
    for unit in _UNITS:
        if size * unit[0] * 1e-9 >= _UNIX_TIME_S:
            return unit
    return _UNITS[-1]


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
    leaps = False
    if ahead_ns.size and int(ahead_ns.max()) - int(ahead_ns.min()) > nanoseconds(LEAP_S):
        leaps = bool(_leaps(time_ns, log_time_ns).any())
    if np.all(time_ns[1:] >= time_ns[:-1]) and not leaps:
        none = np.empty(0, np.int64)
        return Order(np.arange(time_ns.size), none, none, 0.0, 0.0)
    recorded = np.lexsort((time_ns, log_time_ns))
    bad, jump_s = _contradictions(time_ns[recorded], log_time_ns[recorded])
    wrong = recorded[bad]
    kept = np.sort(recorded[~bad])
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
    others = np.flatnonzero(~rising)
    bad = ~rising
    # A run of others is wrong if one of it belongs far from its place among the rising ones.
    rising_ns = stamp_ns[rising]
    other_ns = stamp_ns[others]
    places = np.cumsum(rising, dtype=np.int64)[others]
    last = rising_ns.size - 1
    before_ns = rising_ns[np.clip(places - 1, 0, last)]
    after_ns = rising_ns[np.clip(places, 0, last)]
    off_s = np.maximum(seconds(before_ns, other_ns), seconds(other_ns, after_ns))
    off_places = np.abs(np.searchsorted(rising_ns, other_ns) - places)
    far = (off_s > SAME_CLOCK_S) | (off_places > FEW_PLACES)
    starts = np.flatnonzero(np.diff(others, prepend=-2) > 1)
    is_wrong = np.logical_or.reduceat(far, starts)
    bad[others] = np.repeat(is_wrong, np.diff(starts, append=others.size))
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
    highest_before = np.maximum.accumulate(values)
    lowest_behind = np.minimum.accumulate(values[::-1])[::-1]
    rising: Mask = (values == highest_before) & (values == lowest_behind)
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
