"""The columns of topics, read from a log block by block, every topic in the same pass."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import NS_PER_S
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.column_buffer import Filling
from insdvl_replay.logs.columns.merging import merged
from insdvl_replay.logs.columns.tables import RECORDER_STAMPS, Table, stamp_path
from insdvl_replay.logs.columns.topic_requirements import Source
from insdvl_replay.logs.container.blocks import Block
from insdvl_replay.logs.container.channel import LogChannel
from insdvl_replay.logs.container.parts import CHANNELS_OF_A_PART
from insdvl_replay.logs.container.recording import Recording
from insdvl_replay.logs.encoding.field_paths import FieldReader, split_paths
from insdvl_replay.logs.encoding.message_encodings import open_reader
from insdvl_replay.logs.encoding.partial_decode import Salvage


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
        messages += len(block)
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
    has_whole_times: bool = False

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
            for path, column in self.filling.items():
                is_recorders = path in RECORDER_STAMPS
                values = getattr(part, path)[:, None] if is_recorders else self._narrowed(path, fields[path])
                column.add(values)
            self.stretches.append((part.channel_id, len(part)))

    def _narrowed(self, path: str, values: NDArray[Any]) -> NDArray[Any]:
        """Make one number of a stamp's seconds and nanoseconds."""
        if path != stamp_path(self.source.stamp) or values.shape[1] != 2:
            return values
        self.has_whole_times = True
        return _nanoseconds(values)

    def table(self) -> Table:
        """Give what has been read."""
        unreadable, error = tuple(self.salvage.unreadable_ns), self.salvage.error
        if not all(self.filling.values()):
            raise error or LogError(f"{self.place}: has no messages", "the counts in the log's summary are wrong")
        read = {path: column.rows() for path, column in self.filling.items()}
        columns, channel_ids, repeats = merged(read, self.stretches)
        fault = error.message if error else ""
        known, files = next(iter(self.readers.values())).known, _files_of(channel_ids)
        table = Table(self.place, self.source, columns, unreadable, fault, repeats, known, files, self.has_whole_times)
        if unreadable and not self.log.allow_damaged:
            raise table.refusal()
        return table


def _files_of(channel_ids: NDArray[np.int64]) -> NDArray[np.int64] | None:
    files = channel_ids // CHANNELS_OF_A_PART
    return files if files.size and files.min() != files.max() else None


def _nanoseconds(stamps: NDArray[Any]) -> NDArray[np.int64]:
    """Make one number of seconds and nanoseconds, shape (k, 1); where they are missing 0, which is wrong in any log."""
    time_ns = stamps[:, :1] * NS_PER_S
    time_ns += stamps[:, 1:]
    return time_ns if time_ns.dtype == np.int64 else np.where(np.abs(time_ns) < 2.0**63, time_ns, 0.0).astype(np.int64)
