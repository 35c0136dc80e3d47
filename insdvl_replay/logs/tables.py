"""The columns of every topic that plays a role, in one pass through the log."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs
from insdvl_replay.errors import LogError, Note
from insdvl_replay.inventory import Clock
from insdvl_replay.logs.bag import Recording
from insdvl_replay.logs.chunks import Block
from insdvl_replay.logs.clocks import measure_clock, stamp_unit
from insdvl_replay.logs.container import LogChannel
from insdvl_replay.logs.encodings import open_reader
from insdvl_replay.logs.field_paths import Columns, FieldReader, split_paths
from insdvl_replay.logs.wishes import Source

_NS_PER_S: Final = 1_000_000_000
_RECORDER_STAMPS: Final = ("log_time", "publish_time")


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
    """

    place: str
    source: Source
    columns: Columns

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
                f"{self.source.role}.{quantity} must name a vector",
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
        time_ns = self.columns[stamp][:, 0] if stamp in _RECORDER_STAMPS else self._stamped(_stamp_path(stamp))
        if time_ns.size > 1 and time_ns.min() == time_ns.max():
            raise LogError(
                f"{self.place}: stamp '{stamp}' is {time_ns[0] / _NS_PER_S:.9f} s in each of {time_ns.size} messages",
                f'{self.source.role}.stamp = "log_time"',
            )
        return time_ns - round(self.source.latency_s * _NS_PER_S)

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

    def _stamped(self, path: str) -> TimeNs:
        values = self.columns[path]
        if values.shape[1] == 2:
            return np.asarray(values[:, 0] * _NS_PER_S + values[:, 1], np.int64)
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
    log : Log or Bag
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
    log : Log or Bag
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


def schema_notes(sources: Iterable[Source]) -> tuple[Note, ...]:
    """Say for which topics the log has no schema, so that a definition that comes with the tool was used.

    Parameters
    ----------
    sources : iterable of Source

    Returns
    -------
    tuple of Note
    """
    return tuple(
        Note("builtin_definition", f"{source.topic}: the log has no schema; that of {source.type_name} was assumed")
        for source in sources
        if source.channels[0].encoding == "cdr" and not all(channel.schema_text.strip() for channel in source.channels)
    )


def count_notes(tables: Iterable[Table]) -> tuple[Note, ...]:
    """Say where a log holds fewer or more messages than its summary announces.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    tuple of Note
    """
    notes = []
    for table in tables:
        announced, found = sum(channel.messages for channel in table.source.channels), len(table)
        if announced != found:
            text = f"{table.source.topic}: the log announces {announced} messages, and {found} are found"
            notes.append(Note("messages_missing", text, abs(announced - found), "warning"))
    return tuple(notes)


def stamp_notes(tables: Iterable[Table]) -> tuple[Note, ...]:
    """Say how stamps that are mere numbers were understood.

    Parameters
    ----------
    tables : iterable of Table

    Returns
    -------
    tuple of Note
    """
    notes = []
    for table in tables:
        source = table.source
        values = table.columns[_stamp_path(source.stamp)]
        if source.stamp not in _RECORDER_STAMPS and values.shape[1] == 1:
            unit = stamp_unit(values[:, 0], table.columns["log_time"][:, 0])[1]
            text = f"{source.topic}: stamp '{source.stamp}' was read as {unit}"
            notes.append(Note(f"{source.role}_stamp_unit", text))
    return tuple(notes)


@dataclass
class _Builder:
    """Collects the columns of one topic, block by block."""

    log: Recording
    source: Source
    readers: dict[int, FieldReader] = field(init=False)
    parts: dict[str, list[NDArray[Any]]] = field(init=False)

    def __post_init__(self) -> None:
        self.place = f"{self.log.path}: {self.source.topic}"
        fields = (path for paths in self.source.fields.values() for path in split_paths(paths))
        paths = dict.fromkeys([_stamp_path(self.source.stamp), "log_time", *fields])
        self.parts = {path: [] for path in paths}
        self.readers = {channel.id: self._reader(channel) for channel in self.source.channels}

    def _reader(self, channel: LogChannel) -> FieldReader:
        return open_reader(channel, [path for path in self.parts if path not in _RECORDER_STAMPS], self.place)

    def add(self, block: Block) -> None:
        """Read a block if it is of this topic."""
        reader = self.readers.get(block.channel_id)
        if reader is None:
            return
        recorder = {"log_time": block.log_time[:, None], "publish_time": block.publish_time[:, None]}
        columns = recorder | reader.columns(block)
        for path, parts in self.parts.items():
            parts.append(columns[path])

    def table(self) -> Table:
        """Put the blocks together, letting go of each column's parts as it goes."""
        if not all(self.parts.values()):
            raise LogError(f"{self.place}: has no messages", "the counts in the log's summary are wrong")
        return Table(self.place, self.source, {path: _stacked(self.parts.pop(path)) for path in list(self.parts)})


def _stamp_path(stamp: str) -> str:
    return "header.stamp" if stamp == "header" else stamp


def _stacked(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Put blocks below each other; where a sequence is shorter, it is filled up with NaN."""
    width = max(part.shape[1] for part in parts)
    filled = [
        part
        if part.shape[1] == width
        else np.pad(part.astype(np.float64), ((0, 0), (0, width - part.shape[1])), constant_values=np.nan)
        for part in parts
    ]
    return np.concatenate(filled)
