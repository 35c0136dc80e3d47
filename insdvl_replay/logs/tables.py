"""The columns of every topic that plays a role, in one pass through the log."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs
from insdvl_replay.errors import LogError
from insdvl_replay.inventory import Clock
from insdvl_replay.logs.channel import LogChannel
from insdvl_replay.logs.chunks import Block
from insdvl_replay.logs.clocks import measure_clock, stamp_unit
from insdvl_replay.logs.encodings import open_reader
from insdvl_replay.logs.field_errors import fields_hint
from insdvl_replay.logs.field_paths import Columns, FieldReader, Kinds, split_paths
from insdvl_replay.logs.filling import Filling
from insdvl_replay.logs.merging import merged
from insdvl_replay.logs.parts import CHANNELS_OF_A_PART
from insdvl_replay.logs.recording import Recording
from insdvl_replay.logs.refusal import refused
from insdvl_replay.logs.salvage import Salvage
from insdvl_replay.logs.wishes import Source

_NS_PER_S: Final = 1_000_000_000
RECORDER_STAMPS: Final = ("log_time", "publish_time")
"""Stamps that stand in no message."""


@dataclass(frozen=True)
class Table:
    """The messages of one topic, as the log has them: not sorted, not checked, in the log's units and axes.

    Attributes
    ----------
    place : str
        File and topic, for messages to the user.
    source : Source
    columns : dict of str to ndarray, shape (k, n)
        By field path; ``log_time`` and ``publish_time`` are the recorder's.
    unreadable_ns : tuple of int
        Log times of messages that are left out because they do not fit their schema.
    fault : str
        What is wrong with the first of these.
    repeats : int
        Messages that are left out because another channel or file holds them too.
    known : mapping of str to str
        Every path that the messages have, with the type of what is there.
    files : ndarray of int64, shape (k,), or None
        Number of the file from which each message is, where they are from several.
    has_whole_times : bool
        Whether the stamps were seconds and nanoseconds. Their column is nanoseconds, which takes half the memory.
    """

    place: str
    source: Source
    columns: Columns
    unreadable_ns: tuple[int, ...] = ()
    fault: str = ""
    repeats: int = 0
    known: Kinds = field(default_factory=dict)
    files: NDArray[np.int64] | None = None
    has_whole_times: bool = False

    def __len__(self) -> int:
        """Give the number of messages."""
        return len(next(iter(self.columns.values())))

    def __contains__(self, quantity: str) -> bool:
        """Tell whether the topic holds a quantity."""
        return quantity in self.source.fields

    def values(self, quantity: str, width: int | None = None) -> Floats:
        """Give a quantity as numbers.

        Parameters
        ----------
        quantity : str
            As `known_types` and the configuration name it.
        width : int, optional
            How many numbers each message must hold.

        Returns
        -------
        ndarray, shape (k, n)

        Raises
        ------
        LogError
            The field does not hold that many numbers.
        """
        path = self.source.fields[quantity]
        parts = [self.columns[part].astype(np.float64, copy=False) for part in split_paths(path)]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if width is not None and values.shape[1] != width:
            raise LogError(
                f"{self.place}: field '{path}' holds {values.shape[1]} numbers where {width} are needed",
                f"{self.source.role}.{quantity} must name {width} numbers; {fields_hint(self.known, path)}",
            )
        return values

    def column(self, quantity: str) -> Floats:
        """Give a quantity that is one number in each message.

        Parameters
        ----------
        quantity : str

        Returns
        -------
        ndarray, shape (k,)

        Raises
        ------
        LogError
            The field holds more than one number.
        """
        single: Floats = self.values(quantity, 1)[:, 0]
        return single

    def time_ns(self) -> TimeNs:
        """Give the times of validity.

        Returns
        -------
        ndarray, shape (k,)

        Raises
        ------
        LogError
            The stamp's field is no time, or the same in every message.
        """
        stamp = self.source.stamp
        time_ns = self.columns[stamp][:, 0] if stamp in RECORDER_STAMPS else self._stamped(stamp_path(stamp))
        if time_ns.size > 1 and time_ns.min() == time_ns.max():
            raise LogError(
                f"{self.place}: stamp '{stamp}' is {time_ns[0] / _NS_PER_S:.9f} s in each of {time_ns.size} messages",
                f'{self.source.role}.stamp = "log_time"',
            )
        latency_ns = round(self.source.latency_s * _NS_PER_S)
        return time_ns - latency_ns if latency_ns else time_ns

    @property
    def stamp_numbers(self) -> NDArray[Any] | None:
        """Stamps that are mere numbers, shape (k,); None where they are times."""
        values = self.columns[stamp_path(self.source.stamp)]
        is_time = self.source.stamp in RECORDER_STAMPS or self.has_whole_times or values.shape[1] != 1
        return None if is_time else values[:, 0]

    def clock(self) -> Clock:
        """Compare the times of validity with the times of recording.

        Returns
        -------
        Clock

        Raises
        ------
        LogError
            As of `time_ns`.
        """
        source = self.source
        return measure_clock(source.role, source.topic, source.stamp, self.time_ns(), self.columns["log_time"][:, 0])

    def refusal(self) -> LogError:
        """Give the error with which a log is refused of which messages cannot be read."""
        return refused([self.fault] * len(self.unreadable_ns), [self.columns["log_time"][:, 0]], "messages")

    def _stamped(self, path: str) -> TimeNs:
        values = self.columns[path]
        if self.has_whole_times:
            return values[:, 0]
        if values.shape[1] != 1:
            raise LogError(
                f"{self.place}: field '{path}' holds {values.shape[1]} numbers and is no time",
                f"{self.source.role}.stamp names a builtin_interfaces/Time or one number",
            )
        if not np.isfinite(values).all():
            raise LogError(
                f"{self.place}: stamp '{path}' is no number in {np.count_nonzero(~np.isfinite(values))} messages",
                f'{self.source.role}.stamp = "log_time"',
            )
        counted = values[:, 0] * stamp_unit(values[:, 0], self.columns["log_time"][:, 0])[0]
        return counted if counted.dtype == np.int64 else np.rint(counted).astype(np.int64)


def read_tables(log: Recording, sources: Sequence[Source]) -> list[Table]:
    """Read the columns of several topics.

    Parameters
    ----------
    log : Log or Parts
    sources : sequence of Source

    Returns
    -------
    list of Table
        In the order of the sources.

    Raises
    ------
    LogError
        A field is not there, or a message cannot be read.
    """
    builders = [_Builder(log, source) for source in sources]
    for block in log.blocks({channel.id for source in sources for channel in source.channels}):
        for builder in builders:
            builder.add(block)
    return [builder.table() for builder in builders]


def read_sample(log: Recording, source: Source, enough: int) -> Table:
    """Read the columns of a topic's first messages.

    Parameters
    ----------
    log : Log or Parts
    source : Source
    enough : int
        Stop after the block with which there are that many.

    Returns
    -------
    Table

    Raises
    ------
    LogError
        A field is not there, or a message cannot be read.
    """
    builder, messages = _Builder(log, source), 0
    for block in log.blocks({channel.id for channel in source.channels}):
        builder.add(block)
        messages += block.offsets.size
        if messages >= enough:
            break
    return builder.table()


@dataclass
class _Builder:
    """Collects the columns of one topic, block by block."""

    log: Recording
    source: Source
    readers: dict[int, FieldReader] = field(init=False)
    filling: dict[str, Filling] = field(init=False)
    stretches: list[tuple[int, int]] = field(default_factory=list)
    salvage: Salvage = field(default_factory=Salvage)

    def __post_init__(self) -> None:
        self.place = f"{self.log.path}: {self.source.topic}"
        fields = (path for paths in self.source.fields.values() for path in split_paths(paths))
        paths = dict.fromkeys([stamp_path(self.source.stamp), "log_time", *fields])
        announced = sum(channel.messages for channel in self.source.channels)
        self.filling = {path: Filling(announced) for path in paths}
        self.readers = {channel.id: self._reader(channel) for channel in self.source.channels}

    def _reader(self, channel: LogChannel) -> FieldReader:
        return open_reader(channel, [path for path in self.filling if path not in RECORDER_STAMPS], self.place)

    def add(self, block: Block) -> None:
        """Read a block if it is of this topic."""
        reader = self.readers.get(block.channel_id)
        if reader is None:
            return
        for part, fields in self.salvage.read(reader, block):
            recorder = {"log_time": part.log_time[:, None], "publish_time": part.publish_time[:, None]}
            columns = recorder | fields
            for path, column in self.filling.items():
                column.add(columns[path])
            self.stretches.append((part.channel_id, part.log_time.size))

    def table(self) -> Table:
        """Give what has been read."""
        unreadable, error = tuple(self.salvage.unreadable_ns), self.salvage.error
        if not all(self.filling.values()):
            raise error or LogError(f"{self.place}: has no messages", "the counts in the log's summary are wrong")
        read = {path: column.rows() for path, column in self.filling.items()}
        columns, channel_ids, repeats = merged(read, self.stretches)
        stamp, fault = stamp_path(self.source.stamp), error.message if error else ""
        has_whole_times = columns[stamp].shape[1] == 2
        if has_whole_times:
            columns[stamp] = _nanoseconds(columns[stamp])
        known, files = next(iter(self.readers.values())).known, _files_of(channel_ids)
        table = Table(
            self.place, self.source, columns, unreadable, fault, repeats, known, files, has_whole_times=has_whole_times
        )
        if unreadable and not self.log.allow_damaged:
            raise table.refusal()
        return table


def _files_of(channel_ids: NDArray[np.int64]) -> NDArray[np.int64] | None:
    files = channel_ids // CHANNELS_OF_A_PART
    return files if files.size and files.min() != files.max() else None


def _nanoseconds(stamps: NDArray[Any]) -> NDArray[np.int64]:
    """Make one number of seconds and nanoseconds, shape (k, 1)."""
    time_ns = stamps[:, :1] * _NS_PER_S
    time_ns += stamps[:, 1:]
    return time_ns.astype(np.int64, copy=False)


def stamp_path(stamp: str) -> str:
    """Give the field of a stamp; ``header`` is short for that of a ROS message.

    Parameters
    ----------
    stamp : str

    Returns
    -------
    str
    """
    return "header.stamp" if stamp == "header" else stamp
