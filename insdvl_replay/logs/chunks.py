"""The chunks of an MCAP file: opened one at a time, checked, and their messages found without touching each of them.

An index record behind a chunk tells where in it the messages of a channel start; the headers at these places are
gathered at once and must agree. A chunk without index is searched record by record.
Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.columns import TimeNs

RECORD_HEADER_SIZE: Final = 9
"""Bytes in front of each record's content: its kind and its length."""

_RECORD: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQII")
_INDEX: Final = struct.Struct("<HI")
_MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
_MESSAGE_FIELDS_SIZE: Final = _MESSAGE.itemsize - RECORD_HEADER_SIZE


class DamageError(Exception):
    """Bytes that are not what the format says.

    Parameters
    ----------
    offset : int
        Where in the file.
    found : str
        What stands there.
    """

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.offset = offset
        self.found = found


@dataclass
class Chunk:
    """Where a chunk stands in the file.

    Attributes
    ----------
    offset, length : int
        Start and size of the record's content.
    indexes : list of (int, int)
        The same of the index records behind it, one for each channel.
    """

    offset: int
    length: int
    indexes: list[tuple[int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Block:
    """The messages of one channel in one chunk, in the order of the file.

    Attributes
    ----------
    channel_id : int
        Their channel.
    buffer : memoryview
        Bytes of the open chunk.
    offsets, sizes : ndarray, shape (k,)
        Where in the buffer each message's payload starts, and how many bytes it has.
    log_time, publish_time : ndarray, shape (k,)
        ns
    sequence : ndarray, shape (k,)
        As the recorder counted.
    """

    channel_id: int
    buffer: memoryview
    offsets: NDArray[np.int64]
    sizes: NDArray[np.int64]
    log_time: TimeNs
    publish_time: TimeNs
    sequence: NDArray[np.int64]


def gather(buffer: memoryview, offsets: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Copy a structure from many places of a buffer.

    Parameters
    ----------
    buffer : memoryview
    offsets : ndarray, shape (k,)
        Where each structure starts; each must end within the buffer.
    dtype : numpy.dtype

    Returns
    -------
    ndarray, shape (k,), of `dtype`
    """
    if not offsets.size:
        return np.empty(0, dtype)
    places = len(buffer) - dtype.itemsize + 1
    windows = np.ndarray((places,), dtype=(np.void, dtype.itemsize), buffer=buffer, strides=(1,))
    return windows[offsets].view(dtype)


def walk(data: memoryview, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Go from record to record.

    Parameters
    ----------
    data : memoryview
    start, end : int
        Where the first record starts and the last one ends.

    Yields
    ------
    opcode, start, length : int
        Kind of the record, and where its content stands.

    Raises
    ------
    DamageError
        A record does not fit between the one before it and the end.
    """
    while start < end:
        if end - start < RECORD_HEADER_SIZE:
            raise DamageError(start, f"{end - start} bytes are left where a record needs at least {RECORD_HEADER_SIZE}")
        opcode, length = _RECORD.unpack_from(data, start)
        content, room = start + RECORD_HEADER_SIZE, end - start - RECORD_HEADER_SIZE
        if opcode == 0 or length > room or (opcode == Opcode.MESSAGE and length < _MESSAGE_FIELDS_SIZE):
            raise DamageError(start, f"a record of kind {opcode} says it has {length} bytes; {room} are left")
        yield opcode, content, length
        start = content + length


def walk_chunk(content: memoryview, chunk: Chunk) -> Iterator[tuple[int, int, int]]:
    """Go from record to record of an open chunk, as `walk`; damage is told by the chunk's place in the file.

    Parameters
    ----------
    content : memoryview
        As `open_chunk` gives it.
    chunk : Chunk

    Yields
    ------
    opcode, start, length : int

    Raises
    ------
    DamageError
        As of `walk`.
    """
    try:
        yield from walk(content, 0, len(content))
    except DamageError as damage:
        raise DamageError(chunk.offset, f"in the chunk, {damage.offset} bytes on, {damage.found}") from damage


def open_chunk(data: memoryview, chunk: Chunk) -> memoryview:
    """Decompress a chunk, and check its length and checksum.

    Parameters
    ----------
    data : memoryview
        The file.
    chunk : Chunk

    Returns
    -------
    memoryview

    Raises
    ------
    DamageError
        The chunk is damaged or compressed in an unknown way.
    """
    size, crc, compression, packed = _chunk_fields(data, chunk)
    content = _decompressed(packed, compression, size, chunk.offset)
    if len(content) != size:
        raise DamageError(chunk.offset, f"a chunk opens to {len(content)} bytes where {size} were announced")
    # Zero means that the recorder computed no checksum.
    if crc and zlib.crc32(content) != crc:
        raise DamageError(chunk.offset, "the checksum of a chunk is not that of its bytes")
    return content


def _chunk_fields(data: memoryview, chunk: Chunk) -> tuple[int, int, str, memoryview]:
    record = data[chunk.offset : chunk.offset + chunk.length]
    if len(record) < _CHUNK.size:
        raise DamageError(chunk.offset, f"a chunk has {len(record)} bytes, too few for its own header")
    _, _, size, crc, name_size = _CHUNK.unpack_from(record)
    name_end = _CHUNK.size + name_size
    packed_size = int.from_bytes(record[name_end : name_end + 8], "little")
    packed = record[name_end + 8 :][:packed_size]
    if len(packed) != packed_size:
        raise DamageError(chunk.offset, f"a chunk says it has {packed_size} bytes; {len(packed)} are left")
    return size, crc, bytes(record[_CHUNK.size : name_end]).decode("ascii", "replace"), packed


def _decompressed(packed: memoryview, compression: str, size: int, offset: int) -> memoryview:
    try:
        if compression == "":
            return packed
        if compression == "zstd":
            return memoryview(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size))
        if compression == "lz4":
            return memoryview(lz4.frame.decompress(packed))
    except (zstandard.ZstdError, RuntimeError, MemoryError, OverflowError) as error:
        raise DamageError(offset, f"a {compression} chunk cannot be decompressed ({error})") from error
    raise DamageError(offset, f"a chunk is compressed with '{compression}', which is none of zstd, lz4 and nothing")


def chunk_blocks(data: memoryview, chunk: Chunk, channel_ids: Collection[int]) -> Iterator[Block]:
    """Find the messages of some channels in a chunk; one that holds none of them stays closed.

    Parameters
    ----------
    data : memoryview
        The file.
    chunk : Chunk
    channel_ids : collection of int

    Yields
    ------
    Block
        One for each wanted channel that has messages in the chunk.

    Raises
    ------
    DamageError
        The chunk or its index is damaged.
    """
    if not chunk.indexes:
        content = open_chunk(data, chunk)
        records = walk_chunk(content, chunk)
        found = [start - RECORD_HEADER_SIZE for opcode, start, _ in records if opcode == Opcode.MESSAGE]
        yield from blocks_of(content, np.array(found, np.int64), channel_ids)
        return
    indexes = [_index(data, *place) for place in chunk.indexes]
    wanted = [(channel_id, starts) for channel_id, _, starts in indexes if channel_id in channel_ids and starts.size]
    if wanted:
        content = open_chunk(data, chunk)
        for channel_id, starts in wanted:
            _check_index(content, chunk, channel_id, starts)
            yield _block(content, channel_id, np.sort(starts))


def chunk_times(data: memoryview, chunk: Chunk) -> Iterator[tuple[int, TimeNs]]:
    """Find the log times of a chunk's messages; one with an index stays closed.

    Parameters
    ----------
    data : memoryview
        The file.
    chunk : Chunk

    Yields
    ------
    int
        A channel.
    ndarray, shape (k,)
        ns

    Raises
    ------
    DamageError
        The index, or the chunk without one, is damaged.
    """
    if chunk.indexes:
        for place in chunk.indexes:
            channel_id, log_time, _ = _index(data, *place)
            yield channel_id, log_time
        return
    content = open_chunk(data, chunk)
    found = [start - RECORD_HEADER_SIZE for opcode, start, _ in walk_chunk(content, chunk) if opcode == Opcode.MESSAGE]
    headers = gather(content, np.array(found, np.int64), _MESSAGE)
    for channel_id in np.unique(headers["channel_id"]).tolist():
        yield channel_id, headers["log_time"][headers["channel_id"] == channel_id]


def blocks_of(buffer: memoryview, starts: NDArray[np.int64], channel_ids: Collection[int]) -> Iterator[Block]:
    """Part messages that no index names by their channels.

    Parameters
    ----------
    buffer : memoryview
    starts : ndarray, shape (k,)
        Where their records start.
    channel_ids : collection of int
        The wanted channels.

    Yields
    ------
    Block
    """
    found = gather(buffer, starts, _MESSAGE)["channel_id"]
    for channel_id in np.unique(found).tolist():
        if channel_id in channel_ids:
            yield _block(buffer, channel_id, starts[found == channel_id])


def _index(data: memoryview, offset: int, length: int) -> tuple[int, TimeNs, NDArray[np.int64]]:
    """Read an index record: a channel, the log times of its messages, and where they start in the chunk."""
    channel_id, size = _INDEX.unpack_from(data, offset) if length >= _INDEX.size else (0, length)
    if size > length - _INDEX.size or size % 16:
        raise DamageError(offset, f"an index record of {length} bytes says it has {size} bytes of entries")
    times_and_starts = np.frombuffer(data, "<i8", size // 8, offset + _INDEX.size)
    return channel_id, times_and_starts[::2], times_and_starts[1::2]


def _check_index(content: memoryview, chunk: Chunk, channel_id: int, starts: NDArray[np.int64]) -> None:
    """Refuse an index entry that points to anything but a whole message of the channel."""
    inside = starts[(starts >= 0) & (starts <= len(content) - _MESSAGE.itemsize)]
    headers = gather(content, inside, _MESSAGE)
    room = len(content) - inside - RECORD_HEADER_SIZE
    whole = (headers["length"] >= _MESSAGE_FIELDS_SIZE) & (headers["length"] <= room)
    right = (headers["opcode"] == Opcode.MESSAGE) & (headers["channel_id"] == channel_id) & whole
    wrong = starts.size - int(np.count_nonzero(right))
    if wrong:
        raise DamageError(
            chunk.offset, f"{wrong} of {starts.size} index entries of channel {channel_id} point to no message of it"
        )


def _block(buffer: memoryview, channel_id: int, starts: NDArray[np.int64]) -> Block:
    headers = gather(buffer, starts, _MESSAGE)
    return Block(
        channel_id=channel_id,
        buffer=buffer,
        offsets=starts + _MESSAGE.itemsize,
        sizes=headers["length"] - _MESSAGE_FIELDS_SIZE,
        log_time=headers["log_time"],
        publish_time=headers["publish_time"],
        sequence=headers["sequence"].astype(np.int64),
    )
