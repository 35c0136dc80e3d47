"""An MCAP file: which channels it has, and their messages as blocks of bytes, never a Python object for each of them.

A log is a row of records, most of them chunks that hold the messages. One walk over the record headers finds the
chunks, the schemas and the channels, whether or not the log closes with a summary.
Source: the MCAP specification, https://mcap.dev/spec.
"""

import hashlib
import mmap
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from insdvl_replay.columns import TimeNs
from insdvl_replay.errors import LogError
from insdvl_replay.logs.chunks import (
    RECORD_HEADER_SIZE,
    Block,
    Chunk,
    DamageError,
    blocks_of,
    chunk_blocks,
    chunk_times,
    open_chunk,
    walk,
    walk_chunk,
)

MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""

_OTHER_FORMATS: Final = {
    b"SQLite format 3": ("a ROS 2 bag in SQLite", "`ros2 bag convert` writes it as MCAP"),
    b"#ROSBAG V2.0": ("a ROS 1 bag", "`mcap convert in.bag out.mcap` writes it as MCAP"),
}


@dataclass(frozen=True)
class LogChannel:
    """One channel of a log; a topic may have several.

    Attributes
    ----------
    id : int
        Number that the messages carry.
    topic, type_name, encoding : str
        As the log names them.
    schema_encoding : str
        Language of the schema, ``ros2msg`` for ROS 2.
    schema_text : str
        The schema; may be empty.
    messages : int
        How many messages the log says or is found to hold.
    schema_data : bytes
        The schema as it stands in the log; protobuf's are no text.
    """

    id: int
    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    schema_text: str
    messages: int
    schema_data: bytes = b""


@dataclass
class _Survey:
    """What one walk over the records finds."""

    chunks: list[Chunk] = field(default_factory=list)
    loose_messages: list[int] = field(default_factory=list)
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    statistics: records.Statistics | None = None
    counts: Counter[int] = field(default_factory=Counter)


class Log:
    """An MCAP file, open for reading.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    path : Path
    channels : tuple of LogChannel

    Raises
    ------
    LogError
        The file cannot be opened, is no MCAP file, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._map = _mapped(path)
        self._data = memoryview(self._map)
        try:
            self._survey = _surveyed(self._data)
        except DamageError as damage:
            raise self._refusal(damage) from damage
        self.channels = tuple(_log_channel(channel, self._survey) for channel in self._survey.channels.values())

    def sha256(self) -> str:
        """Give the digest of the file's bytes."""
        digest = hashlib.sha256(self._data).hexdigest()
        self._release_pages()
        return digest

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed.

        Parameters
        ----------
        channel_ids : collection of int

        Yields
        ------
        Block

        Raises
        ------
        LogError
            A chunk is damaged or compressed in an unknown way.
        """
        try:
            for chunk in self._survey.chunks:
                yield from chunk_blocks(self._data, chunk, channel_ids)
                self._release_pages()
            yield from blocks_of(self._data, np.array(self._survey.loose_messages, np.int64), channel_ids)
        except DamageError as damage:
            raise self._refusal(damage) from damage

    def log_times(self) -> dict[int, TimeNs]:
        """Give the log times of all messages from the indexes; only chunks without one are opened.

        Returns
        -------
        dict of int to ndarray, shape (k,)
            By channel, in the order of the file; ns.

        Raises
        ------
        LogError
            An index, or a chunk without one, is damaged.
        """
        parts: dict[int, list[TimeNs]] = {channel.id: [np.empty(0, np.int64)] for channel in self.channels}
        try:
            for chunk in self._survey.chunks:
                for channel_id, times in chunk_times(self._data, chunk):
                    parts.setdefault(channel_id, []).append(times)
            for block in blocks_of(self._data, np.array(self._survey.loose_messages, np.int64), parts.keys()):
                parts[block.channel_id].append(block.log_time)
        except DamageError as damage:
            raise self._refusal(damage) from damage
        return {channel_id: np.concatenate(times) for channel_id, times in parts.items()}

    def _release_pages(self) -> None:
        """Keep what was read from counting as memory of this process; the system reads it again if need be."""
        if hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED)

    def _refusal(self, damage: DamageError) -> LogError:
        return LogError(
            f"{self.path}: is damaged at byte {damage.offset}: {damage.found}",
            f"`mcap recover {self.path.name} -o recovered.mcap` keeps what is whole",
        )


def _mapped(path: Path) -> mmap.mmap:
    if path.is_dir():
        inside = sorted(path.glob("*.mcap"))
        raise LogError(f"{path}: is a folder", f"name the log in it: {inside[0]}" if inside else "it has no .mcap file")
    try:
        with path.open("rb") as file:
            start = file.read(16)
            if not start:
                raise LogError(f"{path}: is empty (0 bytes)", "the recording never began, or the copy failed")
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}", "check the path") from error
    if not start.startswith(MAGIC):
        raise _not_mcap(path, start)
    return data


def _not_mcap(path: Path, start: bytes) -> LogError:
    for magic, (name, hint) in _OTHER_FORMATS.items():
        if start.startswith(magic):
            return LogError(f"{path}: is {name}, not an MCAP file", hint)
    return LogError(f"{path}: is not an MCAP file: it starts with bytes '{start[:8].hex(' ')}'", "name an .mcap file")


def _surveyed(data: memoryview) -> _Survey:
    end = len(data) - len(MAGIC)
    if end < len(MAGIC) or bytes(data[end:]) != MAGIC:
        raise DamageError(len(data), "the file ends without the closing bytes; it was cut or is still being written")
    survey = _Survey()
    for opcode, start, length in walk(data, len(MAGIC), end):
        if opcode == Opcode.CHUNK:
            survey.chunks.append(Chunk(start, length))
        elif opcode == Opcode.MESSAGE_INDEX and survey.chunks:
            survey.chunks[-1].indexes.append((start, length))
        else:
            _note_record(survey, data, opcode, start, length)
            if opcode == Opcode.MESSAGE:
                survey.loose_messages.append(start - RECORD_HEADER_SIZE)
    stated = survey.statistics.channel_message_counts if survey.statistics else None
    if stated is not None and stated.keys() <= survey.channels.keys():
        survey.counts = Counter(stated)
    else:
        _look_into_chunks(survey, data)
    return survey


def _look_into_chunks(survey: _Survey, data: memoryview) -> None:
    """Learn from the chunks what the missing summary would have told."""
    for chunk in survey.chunks:
        content = open_chunk(data, chunk)
        for opcode, start, length in walk_chunk(content, chunk):
            _note_record(survey, content, opcode, start, length)


def _note_record(survey: _Survey, data: memoryview, opcode: int, start: int, length: int) -> None:
    if opcode == Opcode.MESSAGE:
        survey.counts[int.from_bytes(data[start : start + 2], "little")] += 1
    elif opcode == Opcode.SCHEMA:
        schema = _parsed(records.Schema, data, start, length)
        survey.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = _parsed(records.Channel, data, start, length)
        survey.channels[channel.id] = channel
    elif opcode == Opcode.STATISTICS:
        survey.statistics = _parsed(records.Statistics, data, start, length)


def _parsed(kind: Any, data: memoryview, start: int, length: int) -> Any:
    try:
        return kind.read(ReadDataStream(BytesIO(data[start : start + length])))
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise DamageError(start, f"a {kind.__name__} record of {length} bytes cannot be parsed") from error


def _log_channel(channel: records.Channel, survey: _Survey) -> LogChannel:
    schema = survey.schemas.get(channel.schema_id)
    return LogChannel(
        id=channel.id,
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema_text=schema.data.decode("utf-8", "replace") if schema else "",
        messages=survey.counts[channel.id],
        schema_data=schema.data if schema else b"",
    )
