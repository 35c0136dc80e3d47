"""The columns of topics, read from a log block by block, every topic in the same pass.

A block of which some messages do not fit their schema is read in halves, down to those that do.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.errors import LogError, error_context, listed
from insdvl_replay.logs.columns.order import merge_channels
from insdvl_replay.logs.columns.tables import MOST_SAMPLED, RECORDER_STAMPS, SAMPLED, Sampled, Table, stamp_path
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.recording import CHANNELS_OF_A_PART, Recording
from insdvl_replay.logs.container.records import LogChannel
from insdvl_replay.logs.encoding.fields import ROWS, Columns, FieldReader, open_reader, split_paths

_HOPELESS: Final = 1000
"""Where so many messages cannot be read, and fewer can, the schema is wrong and not the messages."""


@dataclass
class PartialDecoder:
    """Reads what can be read of a topic, and remembers the rest: their log times, and the first error."""

    where: tuple[str, str]
    readable: int = 0
    unreadable_ns: list[int] = field(default_factory=list)
    error: LogError | None = None

    def read(self, reader: FieldReader, block: Block) -> Iterator[tuple[Block, Columns]]:
        """Read a block, in halves and halves of halves where some of it cannot be read, part by part."""
        try:
            with error_context(*self.where):
                columns = reader.columns(block)
        except LogError as error:
            yield from self._halves(reader, block, error)
            return
        self.readable += len(block)
        yield block, columns

    def _halves(self, reader: FieldReader, block: Block, error: LogError) -> Iterator[tuple[Block, Columns]]:
        count = len(block)
        if count > 1:
            yield from self.read(reader, block.part(slice(None, count // 2)))
            yield from self.read(reader, block.part(slice(count // 2, None)))
            return
        self.error = self.error or error
        self.unreadable_ns.append(int(block.log_time[0]))
        if len(self.unreadable_ns) > max(_HOPELESS, self.readable):
            raise self.error


class ColumnBuffer:
    """A column that is not complete yet. As long as all rows are alike, it holds one of them.

    More rows than announced find room too.
    """

    def __init__(self, announced: int) -> None:
        self._announced = announced
        self._rows: NDArray[Any] = np.empty((0, 0), np.int64)
        self._count = 0

    def __len__(self) -> int:
        """Return the number of rows so far."""
        return self._count

    def add(self, values: NDArray[Any]) -> None:
        """Put rows, shape (k, n), below the others; shorter ones are filled up with NaN."""
        if not self._count:
            self._rows = values[:1].copy()
        if self._is_one_row and _are_all(values, self._rows):
            self._count += len(values)
        else:
            self._append(values)

    def rows(self) -> NDArray[Any]:
        """Return all rows, shape (k, n); where all are alike, as a view of one that cannot be written to."""
        if self._is_one_row:
            return np.broadcast_to(self._rows, (self._count, self._rows.shape[1]))
        return self._rows[: self._count]

    @property
    def _is_one_row(self) -> bool:
        return len(self._rows) == 1

    def _append(self, values: NDArray[Any]) -> None:
        count, needed, width = self._count, self._count + len(values), values.shape[1]
        uneven = width != self._rows.shape[1]
        dtype = np.dtype(np.float64) if uneven else np.result_type(self._rows.dtype, values.dtype)
        room = len(self._rows) if needed <= len(self._rows) else max(needed + needed // 2, self._announced)
        self._make_room((room, max(width, self._rows.shape[1])), dtype)
        self._rows[count:needed, :width] = values
        if uneven:
            self._rows[count:needed, width:] = np.nan
        self._count = needed

    def _make_room(self, shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        if (shape, dtype) == (self._rows.shape, self._rows.dtype):
            return
        filled = self.rows()
        # Component by component, as messages are read and as numpy goes through rows of three the fastest.
        self._rows = np.empty(shape, dtype, order="F")
        self._rows[: self._count, : filled.shape[1]] = filled
        if filled.shape[1] < shape[1]:
            self._rows[: self._count, filled.shape[1] :] = np.nan


def _are_all(values: NDArray[Any], row: NDArray[Any]) -> bool:
    """Return whether all rows are this one, NaN as NaN, and of its kind of number."""
    if values.dtype != row.dtype or values.shape[1] != row.shape[1]:
        return False
    same = values == row
    return bool(same.all() or np.all(same | (np.isnan(values) & np.isnan(row))))


def read_tables(log: Recording, sources: Sequence[Source]) -> list[Table]:
    """Read the columns of several topics, in the order of the sources."""
    builders = [_Builder(log, source) for source in sources]
    for block in log.blocks({channel.id for source in sources for channel in source.channels}):
        for builder in builders:
            builder.add(block)
    return [builder.table() for builder in builders]


def read_sample(log: Recording, source: Source, enough: int) -> Table:
    """Read the columns of a topic's first rows, up to the block with which there are enough."""
    builder = _Builder(log, source)
    for block in log.blocks({channel.id for channel in source.channels}):
        builder.add(block)
        if sum(count for _, count in builder.runs) >= enough:
            break
    return builder.table()


@dataclass
class _Builder:
    """Collects the columns of one topic, block by block."""

    log: Recording
    source: Source
    readers: dict[int, FieldReader] = field(init=False)
    buffers: dict[str, ColumnBuffer] = field(init=False)
    sampled: dict[str, ColumnBuffer] = field(init=False)
    every: int = field(init=False)
    runs: list[tuple[int, int]] = field(default_factory=list)
    decoder: PartialDecoder = field(init=False)
    has_whole_times: bool = False
    others: int = 0

    def __post_init__(self) -> None:
        self.where = (str(self.log.path), self.source.topic)
        self.decoder = PartialDecoder(self.where)
        announced = sum(channel.messages for channel in self.source.channels)
        self.every = max(1, math.ceil(announced / MOST_SAMPLED))
        every_message = [stamp_path(self.source.stamp), "log_time", *self._paths(sampled=False)]
        self.buffers = {path: ColumnBuffer(announced) for path in every_message}
        self.sampled = {path: ColumnBuffer(announced // self.every + 1) for path in self._paths(sampled=True)}
        self.readers = {channel.id: self._reader(channel) for channel in self.source.channels}

    def _paths(self, *, sampled: bool) -> list[str]:
        of_quantities = self.source.fields.items()
        return [path for name, paths in of_quantities if (name in SAMPLED) == sampled for path in split_paths(paths)]

    def _reader(self, channel: LogChannel) -> FieldReader:
        with error_context(*self.where):
            paths = [path for path in (self.buffers | self.sampled) if path not in RECORDER_STAMPS]
            return open_reader(channel, paths, self.source.element)

    def add(self, block: Block) -> None:
        """Read a block if it is of this topic."""
        reader = self.readers.get(block.channel_id)
        if reader is None:
            return
        for whole, fields in self.decoder.read(reader, block):
            part = whole.part(fields[ROWS][:, 0]) if ROWS in fields else whole
            self.others += len(whole) - len(part)
            if not len(part):
                continue
            self._add_sampled(fields)
            for path, column in self.buffers.items():
                is_recorders = path in RECORDER_STAMPS
                values = getattr(part, path)[:, None] if is_recorders else self._narrowed(path, fields[path])
                column.add(values)
            self.runs.append((part.channel_id, len(part)))

    def _add_sampled(self, fields: Columns) -> None:
        """Keep of some columns the rows whose numbers are multiples of ``every``."""
        chosen = slice(-len(self.buffers["log_time"]) % self.every, None, self.every)
        for path, column in self.sampled.items():
            if len(values := fields[path][chosen]):
                column.add(values)

    def _narrowed(self, path: str, values: NDArray[Any]) -> NDArray[Any]:
        """Make one number of a stamp's seconds and nanoseconds."""
        if path != stamp_path(self.source.stamp) or values.shape[1] != 2:
            return values
        self.has_whole_times = True
        return _nanoseconds(values)

    def table(self) -> Table:
        """Return what has been read."""
        unreadable, error = tuple(self.decoder.unreadable_ns), self.decoder.error
        if not all(self.buffers.values()):
            raise (
                error
                or self._lacks_element()
                or LogError("has no messages", "the counts in the log's summary are wrong", *self.where)
            )
        read = {path: column.rows() for path, column in self.buffers.items()}
        columns, channel_ids, rows = merge_channels(read, self.runs)
        count = len(self.buffers["log_time"])
        known, files = next(iter(self.readers.values())).known, _files_of(channel_ids)
        table = Table(
            self.where,
            self.source,
            columns,
            unreadable,
            error,
            0 if rows is None else count - len(rows),
            known,
            files,
            self.has_whole_times,
            self.others,
            self._sampled_of(rows, count),
        )
        if unreadable and not self.log.allow_damaged:
            raise table.damage_error()
        return table

    def _sampled_of(self, rows: NDArray[np.int64] | None, count: int) -> Sampled:
        columns = {path: column.rows() for path, column in self.sampled.items()}
        sampled = Sampled(columns, np.arange(0, count if columns else 0, self.every))
        return sampled if rows is None else sampled.among(rows, count)

    def _lacks_element(self) -> LogError | None:
        """State which elements there are where none is what was asked for."""
        element = self.source.element
        if element is None:
            return None
        seen = {texts for reader in self.readers.values() for texts in getattr(reader, "seen", ())}
        pairs = [f"{self.source.role}.frames = {toml_value(texts)}" for texts in sorted(seen)]
        what = (
            f"has no transform from {' to '.join(element.texts)}" if element.texts else "has transforms of many frames"
        )
        return LogError(what, f"it has {listed(pairs)}" if pairs else "its messages are empty", *self.where)


def _files_of(channel_ids: NDArray[np.int64]) -> NDArray[np.int64] | None:
    files = channel_ids // CHANNELS_OF_A_PART
    return files if files.size and files.min() != files.max() else None


def _nanoseconds(stamps: NDArray[Any]) -> NDArray[np.int64]:
    """Make one number of seconds and nanoseconds, shape (k, 1); where they are missing 0, which is wrong in any log."""
    time_ns = stamps[:, :1] * NS_PER_S
    time_ns += stamps[:, 1:]
    return time_ns if time_ns.dtype == np.int64 else np.where(np.abs(time_ns) < 2.0**63, time_ns, 0.0).astype(np.int64)
