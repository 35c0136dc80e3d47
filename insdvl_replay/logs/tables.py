"""The columns of every topic that plays a role, in one pass through the log."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs
from insdvl_replay.errors import LogError, Note
from insdvl_replay.logs.cdr import CdrReader, Columns
from insdvl_replay.logs.chunks import Block
from insdvl_replay.logs.container import Log, LogChannel
from insdvl_replay.logs.roles import Source
from insdvl_replay.logs.ros2msg import definition_text, parse_definitions

_NS_PER_S: Final = 1_000_000_000
_RECORDER_STAMPS: Final = ("log_time", "publish_time")
_UNIX_UNITS: Final = ((1e17, 1, "nanoseconds"), (1e14, 10**3, "microseconds"), (1e11, 10**6, "milliseconds"))
"""From this size on a number of a stamp is taken to count these since 1970."""


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
        values = self.columns[path].astype(np.float64, copy=False)
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
        counted = values[:, 0] * _unit_of(values)[0]
        return counted if counted.dtype == np.int64 else np.rint(counted).astype(np.int64)


def read_tables(log: Log, sources: Sequence[Source]) -> list[Table]:
    """Read the columns of several topics.

    Parameters
    ----------
    log : Log
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
        if not all(channel.schema_text.strip() for channel in source.channels)
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
            text = f"{source.topic}: stamp '{source.stamp}' was read as {_unit_of(values)[1]}"
            notes.append(Note(f"{source.role}_stamp_unit", text))
    return tuple(notes)


@dataclass
class _Builder:
    """Collects the columns of one topic, block by block."""

    log: Log
    source: Source
    readers: dict[int, CdrReader] = field(init=False)
    parts: dict[str, list[NDArray[Any]]] = field(init=False)

    def __post_init__(self) -> None:
        self.place = f"{self.log.path}: {self.source.topic}"
        paths = dict.fromkeys([_stamp_path(self.source.stamp), *self.source.fields.values()])
        self.parts = {path: [] for path in paths}
        self.readers = {channel.id: self._reader(channel) for channel in self.source.channels}

    def _reader(self, channel: LogChannel) -> CdrReader:
        try:
            text = channel.schema_text if channel.schema_text.strip() else definition_text(channel.type_name)
            definitions = parse_definitions(channel.type_name, text)
        except LogError as error:
            raise LogError(f"{self.place}: {error.message}", error.hint) from error
        paths = [path for path in self.parts if path not in _RECORDER_STAMPS]
        return CdrReader(definitions, channel.type_name, paths, self.place)

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


def _unit_of(values: NDArray[Any]) -> tuple[int, str]:
    """Guess in which unit numbers count the time since 1970; small ones are seconds since anything."""
    size = float(np.nanmedian(np.abs(values)))
    return next(((factor, unit) for least, factor, unit in _UNIX_UNITS if size >= least), (_NS_PER_S, "seconds"))


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
