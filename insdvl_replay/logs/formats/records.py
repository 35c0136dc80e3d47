"""The records of an MCAP file: where they are, where they go on after bytes that are none, and what a chunk says.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Final, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from insdvl_replay.logs.formats.log_file import LARGEST_CHUNK, DamageError, FileBytes, most_opened

MAGIC: Final = b"\x89MCAP0\r\n"  # first and last bytes
HEADER_SIZE: Final = 9  # bytes in front of each record's content: its kind and its length
HEADER: Final = struct.Struct("<BQ")
# What a record of each kind must at least hold for its own fields; no record is of kind 0.
_LEAST: Final = (1 << 64, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
LAST_KNOWN: Final = 15  # kind that the specification knows
_FIRST_PRIVATE: Final = 128
MESSAGE: Final = np.dtype(
    [("opcode", "u1"), ("length", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<i8"), ("publish", "<i8")]
)  # in front of each payload
_PIECE: Final = 1 << 20


class ChunkHeader(NamedTuple):
    """What a chunk says of itself."""

    first_ns: int
    last_ns: int
    size: int  # bytes to which it opens
    crc: int  # of these; 0 where the recorder computed none
    compression: str
    data_start: int
    data_size: int


@dataclass(eq=False)
class Chunk:
    """A part of the file with messages: a chunk with the indexes behind it, or messages that are in no chunk."""

    start: int
    end: int  # of the chunk or of the last message
    header: ChunkHeader | None = None  # None where messages are in no chunk
    indexes: list[tuple[int, int]] = field(default_factory=list)  # start and length of each index behind it
    counts: Counter[int] = field(default_factory=Counter)  # messages by channel, as the indexes or the content say
    is_indexed: bool = True  # whether the indexes name all messages, as far as is known
    is_cut: bool = False

    @property
    def index_end(self) -> int:
        """Where the last of the indexes ends."""
        return self.indexes[-1][0] + self.indexes[-1][1] if self.indexes else self.end


def can_be_record(kind: int, length: int) -> bool:
    """Return whether a record of a kind can have a length."""
    return length >= _LEAST[kind] if kind < len(_LEAST) else kind >= _FIRST_PRIVATE


def walk(buffer: memoryview, room: int) -> tuple[NDArray[np.int64], int, int, bool]:
    """Find the records of a buffer, whose last one may go on behind it, up to `room` bytes.

    Return kind, start and length of the content of each, (k, 3), how many were of kinds that are not MCAP's own, where
    they end, and whether that is at bytes that are no record. A message before such bytes may have a false length, and
    is left out.
    """
    parts: list[NDArray[np.int64]] = []
    found: list[tuple[int, int, int]] = []
    place, others, before, patience, most = 0, 0, (0, 0), 0, 64
    # The head of each message must be in the buffer.
    is_broken, last = False, len(buffer) - (HEADER_SIZE if len(buffer) >= room else MESSAGE.itemsize)
    while place <= last:
        head = kind, length = HEADER.unpack_from(buffer, place)
        is_broken = length > room - place - HEADER_SIZE or not can_be_record(kind, length)
        if is_broken:
            break
        size, count = HEADER_SIZE + length, 1
        if head == before and patience == 0:
            # Messages of one sensor have one size: those that follow are looked at together.
            ahead = min((len(buffer) - place) // size, most)
            if ahead > 1:
                alike = np.ndarray((ahead,), "<u8", buffer, place + 1, (size,)) == length
                alike &= np.ndarray((ahead,), np.uint8, buffer, place, (size,)) == kind
                count = ahead if alike.all() else int(alike.argmin())
            most = min(max(64, 2 * count), 1 << 14)
            patience = 0 if count > 8 else 64
        if kind >= _FIRST_PRIVATE:
            others += count
        elif count > 1:
            run = np.empty((count, 3), np.int64)
            run[:] = kind, 0, length
            run[:, 1] = place + size * np.arange(count)
            parts += [np.array(found, np.int64).reshape(-1, 3), run]
            found = []
        else:
            found.append((kind, place, length))
        before, patience = head, max(patience - 1, 0)
        place += size * count
    records = np.array(found, np.int64).reshape(-1, 3)
    if parts:
        records = np.concatenate([*parts, records])
    is_broken |= len(buffer) >= room and place < room
    if is_broken and len(records) and records[-1, 0] == Opcode.MESSAGE:
        records = records[:-1]
    return records, others, place, is_broken


def what_is_there(data: memoryview, room: int) -> str:
    """State why no record can start where some bytes do, with so many left."""
    if room < HEADER_SIZE:
        return f"{room} bytes are left where a record needs at least {HEADER_SIZE}"
    kind, length = HEADER.unpack_from(data)
    if length > room - HEADER_SIZE:
        return f"a record of kind {kind} says it has {length} bytes; {room - HEADER_SIZE} are left"
    return f"{length} bytes under kind {kind} are no record"


def parsed(kind: Any, content: memoryview, offset: int) -> Any:
    """Parse the content of a record that is at an offset of the file."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError, EOFError) as error:
        raise DamageError(offset, f"a {kind.__name__} record of {len(content)} bytes cannot be parsed") from error


def next_record(file: FileBytes, place: int, end: int) -> int:
    """Return the next place where a record can be with another one, or the end, right behind it."""

    def fits(head: memoryview, place: int) -> int:
        """Return where a record at a place ends, 0 if none can be there."""
        if len(head) < HEADER_SIZE:
            return 0
        kind, length = HEADER.unpack_from(head)
        is_known = kind <= LAST_KNOWN and can_be_record(kind, length)
        return place + HEADER_SIZE + length if is_known and length <= end - place - HEADER_SIZE else 0

    for start in range(place, end, _PIECE):
        piece = file.read(start, min(start + _PIECE + HEADER_SIZE - 1, end))
        data = np.frombuffer(piece, np.uint8)
        count = max(len(data) - HEADER_SIZE + 1, 0)
        likely = (data[:count] > 0) & (data[:count] <= LAST_KNOWN)
        for byte in (6, 7, 8):  # the highest of a length are zero
            likely &= data[byte : byte + count] == 0
        for at in np.flatnonzero(likely).tolist():
            behind = fits(piece[at : at + HEADER_SIZE], start + at)
            if behind and (behind == end or fits(file.read(behind, behind + HEADER_SIZE), behind)):
                return start + at
    return end


def opened_start(data: memoryview, compression: str, size: int, offset: int) -> memoryview:
    """Decompress as much of a chunk as is left of it; some recorders write last of all to how much it opens."""
    room = min(most_opened(len(data)), LARGEST_CHUNK)
    size = min(size, room) if size else room
    try:
        if compression == "zstd":
            content = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        elif compression == "lz4":
            content = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        else:
            raise DamageError(offset, f"a chunk is compressed with '{compression}'")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise DamageError(offset, f"a {compression} chunk cannot be decompressed ({error})") from error
    if len(content) > size:
        raise DamageError(offset, f"a chunk opens to more than {size} bytes")
    return memoryview(content)
