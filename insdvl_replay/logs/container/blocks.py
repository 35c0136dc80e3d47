"""The messages of a chunk, as columns, found without touching each of them.

The index records behind a chunk tell which channels have messages in it, so that others stay closed. Inside an open
chunk the records themselves are followed, and the index must agree with them. What stands in front of a payload is read
only where somebody asks for it, in one step for all messages.
Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, is_new
from insdvl_replay.core.errors import listed
from insdvl_replay.logs.container.chunks import Chunk, chunk_header, open_chunk
from insdvl_replay.logs.container.records import (
    MESSAGE_FIELDS_SIZE,
    Damage,
    DamageError,
    Records,
    Span,
    find_records,
    go_on,
    is_broken,
    joined,
    plausible_span,
    what_stands,
)

MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""What stands in front of the payload of a message record."""
_PLACES: Final = {name: (field[0], field[1]) for name, field in (MESSAGE.fields or {}).items()}


@dataclass(frozen=True)
class Block:
    """The messages of one channel in one chunk, in the order of the file.

    Where in the buffer, the bytes of the open chunk, their records start, shape (k,), and how long the contents of
    these are.
    """

    channel_id: int
    buffer: memoryview
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of messages."""
        return int(self.starts.size)

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Where in the buffer each message's payload starts, shape (k,)."""
        return self.starts + MESSAGE.itemsize

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """How many bytes each message's payload has, shape (k,)."""
        return self.lengths - MESSAGE_FIELDS_SIZE

    @cached_property
    def log_time(self) -> TimeNs:
        """When each message was recorded, shape (k,), ns."""
        return message_field(self.buffer, self.starts, "log_time")

    @cached_property
    def publish_time(self) -> TimeNs:
        """When each message was published, shape (k,), ns."""
        return message_field(self.buffer, self.starts, "publish_time")

    def part(self, rows: slice | NDArray[np.int64]) -> "Block":
        """Return some of the messages."""
        return replace(self, starts=self.starts[rows], lengths=self.lengths[rows])


@dataclass(frozen=True)
class TimedBlock(Block):
    """Messages of a container that has other records: their payloads start and are as long as told, and so their times.

    When each was recorded, shape (k,), ns; when it was published such a container does not tell.
    """

    time_ns: TimeNs

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Where in the buffer each message's payload starts, shape (k,)."""
        return self.starts

    @property
    def sizes(self) -> NDArray[np.int64]:
        """How many bytes each message's payload has, shape (k,)."""
        return self.lengths

    @property
    def log_time(self) -> TimeNs:
        """When each message was recorded, shape (k,), ns."""
        return self.time_ns

    @property
    def publish_time(self) -> TimeNs:
        """The same, for want of another."""
        return self.time_ns

    def part(self, rows: slice | NDArray[np.int64]) -> "TimedBlock":
        """Return some of the messages."""
        return replace(self, starts=self.starts[rows], lengths=self.lengths[rows], time_ns=self.time_ns[rows])


def by_channel(buffer: memoryview, records: Records) -> dict[int, Block]:
    """Part the messages among records by their channels."""
    messages = records.where(records.opcodes == Opcode.MESSAGE)
    ids = message_field(buffer, messages.starts, "channel_id")
    order = np.argsort(ids, kind="stable")
    ids, starts, lengths = ids[order], messages.starts[order], messages.lengths[order]
    edges = [*np.flatnonzero(is_new(ids)).tolist(), ids.size]
    blocks = [Block(int(ids[first]), buffer, starts[first:end], lengths[first:end]) for first, end in pairwise(edges)]
    return {block.channel_id: block for block in blocks}


def gather(buffer: memoryview | NDArray[np.uint8], offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy a structure of a dtype from many places of a buffer, shape (k,); each must end within the buffer."""
    if not offsets.size:
        return np.empty(0, dtype)
    places = len(buffer) - dtype.itemsize + 1
    # As mere bytes, structures are copied six times as fast.
    copied: Any = dtype if dtype.fields is None else (np.void, dtype.itemsize)
    windows: NDArray[Any] = np.ndarray((places,), copied, buffer, strides=(1,))
    return windows[offsets].view(dtype)


def message_field(buffer: memoryview, starts: NDArray[np.int64], name: str) -> NDArray[Any]:
    """Read a field of `MESSAGE` of the message records that start at some places, shape (k,)."""
    dtype, place = _PLACES[name]
    return gather(buffer, starts + place, dtype)


_INDEX: Final = struct.Struct("<HI")
_ENTRY: Final = np.dtype([("log_time", "<i8"), ("start", "<i8")])


def index_count(data: memoryview, offset: int, length: int) -> tuple[int, int]:
    """Read of which channel an index record is, and how many messages it names."""
    channel_id, size = _INDEX.unpack_from(data, offset)
    if size > length - _INDEX.size or size % _ENTRY.itemsize:
        raise DamageError(offset, f"an index record of {length} bytes says it has {size} bytes of entries")
    return channel_id, size // _ENTRY.itemsize


def index_entries(data: memoryview, offset: int, length: int) -> tuple[int, NDArray[Any]]:
    """Read an index record, whose content stands somewhere in the file.

    Returns
    -------
    int
        A channel.
    ndarray, shape (k,)
        Fields ``log_time``, ns, and ``start`` of the message record in the open chunk.
    """
    channel_id, count = index_count(data, offset, length)
    return channel_id, np.frombuffer(data, _ENTRY, count, offset + _INDEX.size)


@dataclass(frozen=True)
class Content:
    """The records of an open chunk: messages by channel, definitions of schemas and channels, and damages of it.

    Where bytes of it are no record, messages are lost between two log times.
    """

    buffer: memoryview
    blocks: dict[int, Block]
    definitions: Records
    damages: list[Damage]
    lost_span_ns: Span | None = None

    def counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        return Counter({channel_id: len(block) for channel_id, block in self.blocks.items()})

    def of(self, channel_ids: Iterable[int]) -> list[Block]:
        """Return the messages of some channels."""
        return [self.blocks[channel_id] for channel_id in sorted(self.blocks.keys() & channel_ids)]

    def log_times(self, channel_ids: Iterable[int]) -> TimeNs:
        """Return the log times of the messages of some channels, channel by channel; shape (k,), ns."""
        return np.concatenate([np.empty(0, np.int64), *(block.log_time for block in self.of(channel_ids))])


def read_chunk(data: memoryview, chunk: Chunk) -> Content:
    """Open a chunk and find its records."""
    return content_of(data, chunk, open_chunk(data, chunk))


def content_of(data: memoryview, chunk: Chunk, buffer: memoryview) -> Content:
    """Find the records of a chunk that is open."""
    records, passed = _find_all(buffer)
    if passed and not len(records):
        raise DamageError(chunk.offset, f"in the chunk no record is found: {passed[0][2]}")
    damages = [Damage(chunk.offset, f"in the chunk, {stop} bytes on, {reason}") for stop, _, reason in passed]
    gaps = [(start, stop) for start, stop, _ in passed] + [(len(buffer),) * 2] * (chunk.kind == "truncated")
    span_ns = _lost_span(data, chunk, buffer, records, gaps) if gaps else None
    definitions = records.where(records.opcodes < Opcode.MESSAGE)
    content = Content(buffer, by_channel(buffer, records), definitions, damages, span_ns)
    if chunk.indexes and chunk.kind == "intact":
        damages += _index_damages(data, chunk, content.blocks)
    return content


def _find_all(buffer: memoryview) -> tuple[Records, list[tuple[int, int, str]]]:
    """Find the messages of a chunk and the definitions before them; others, which nobody reads, are passed over."""
    batches: list[Records] = []
    passed: list[tuple[int, int, str]] = []
    place, end = 0, len(buffer)
    while place < end or not batches:
        batch, stop = find_records(buffer, place, end)
        if is_broken(batch, stop, end):
            broken, reason = stop, what_stands(buffer, stop, end)
            batch, stop = go_on(buffer, batch, stop, end)
            passed.append((broken, stop, reason))
        read = batch.opcodes <= Opcode.MESSAGE
        batches.append(batch if read.all() else batch.where(read))
        place = stop
    return batches[0] if len(batches) == 1 else joined(batches), passed


def _lost_span(
    data: memoryview,
    chunk: Chunk,
    buffer: memoryview,
    records: Records,
    gaps: list[tuple[int, int]],
) -> Span | None:
    """Return the log times between which messages are lost: those of the messages on both sides, else of the chunk."""
    starts = records.starts[records.opcodes == Opcode.MESSAGE]
    log_time = message_field(buffer, starts, "log_time")
    before = np.searchsorted(starts, gaps[0][0])
    behind = np.searchsorted(starts, gaps[-1][1])
    whole = chunk_header(data, chunk.offset, chunk.length).span_ns if chunk.kind != "unchunked" else None
    first_ns = int(log_time[before - 1]) if before else whole and whole[0]
    last_ns = int(log_time[behind]) if behind < len(starts) else whole and whole[1]
    if first_ns is None or last_ns is None:
        return None
    return plausible_span(min(first_ns, last_ns), max(first_ns, last_ns))


def _index_damages(data: memoryview, chunk: Chunk, blocks: dict[int, Block]) -> list[Damage]:
    """Compare the index of a chunk with the messages in it."""
    unnamed = dict(blocks)
    for offset, length in chunk.indexes:
        try:
            channel_id, entries = index_entries(data, offset, length)
        except DamageError as error:
            return [error.damage]
        block = blocks.get(channel_id)
        if not _names_all(entries, block):
            count = len(block or ())
            text = f"an index does not name the {count} messages of channel {channel_id} in its chunk"
            return [Damage(offset, text)]
        unnamed.pop(channel_id, None)
    if not unnamed:
        return []
    count, channels = sum(map(len, unnamed.values())), listed(map(str, unnamed))
    return [Damage(chunk.offset, f"no index of a chunk names {count} of its messages (channel {channels})")]


def _names_all(entries: NDArray[Any], block: Block | None) -> bool:
    """Return whether entries name all messages; some recorders name one more that they did not write any more."""
    if block is None:
        return not entries.size
    if np.array_equal(entries["start"], block.starts) and np.array_equal(entries["log_time"], block.log_time):
        return True
    if entries.size > len(block) + 1:
        return False
    nearest = np.minimum(np.searchsorted(block.starts, entries["start"]), len(block) - 1)
    right = (block.starts[nearest] == entries["start"]) & (block.log_time[nearest] == entries["log_time"])
    named = np.zeros(len(block), np.bool_)
    named[nearest[right]] = True
    return bool(named.all())
