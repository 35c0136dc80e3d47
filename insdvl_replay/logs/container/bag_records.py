"""The records of a .bag, the log of ROS 1, and the messages of a chunk as columns.

A record is a header of named fields, and data. Messages stand in chunks, behind each an index of its messages by
connection, and at the end of the bag all connections and what each chunk holds.
Source: the format of version 2.0, http://wiki.ros.org/Bags/Format/2.0.
"""

import bz2
import struct
from array import array
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs
from insdvl_replay.logs.container.blocks import gather
from insdvl_replay.logs.container.chunks import decompressed, of_size, room_of
from insdvl_replay.logs.container.records import DamageError

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
"""Kinds of records."""
_LONGEST_HEADER: Final = 1 << 20
_LENGTH: Final = struct.Struct("<I")
_WORD: Final = np.dtype("<u4")
ENTRY: Final = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("place", "<u4")])
COUNT: Final = np.dtype([("connection", "<u4"), ("count", "<u4")])


@dataclass(frozen=True)
class Record:
    """A record: its fields, where it starts, and where its data starts and ends."""

    fields: dict[bytes, bytes]
    offset: int
    start: int
    end: int

    @property
    def op(self) -> int:
        """Of which kind it is."""
        return self.number(b"op", 1)

    def number(self, name: bytes, size: int) -> int:
        """Return a field that is a whole number of some bytes."""
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise DamageError(self.offset, f"a record has no field '{name.decode()}' of {size} bytes")
        return int.from_bytes(value, "little")

    def text(self, name: bytes) -> str:
        """Return a field that is text; empty where there is none."""
        return self.fields.get(name, b"").decode("utf-8", "replace")


def record_at(data: memoryview, place: int) -> Record:
    """Read the record that starts at a place."""
    start, end = _bounds(data, place)
    return Record(fields_of(data[place + 4 : start - 4], place), place, start, end)


def _bounds(data: memoryview, place: int) -> tuple[int, int]:
    """Return where the data of a record starts and ends."""
    left = len(data) - place - 8
    if left < 0:
        raise DamageError(place, f"{left + 8} bytes are left where a record needs at least 8")
    head = _LENGTH.unpack_from(data, place)[0]
    if head > min(left, _LONGEST_HEADER):
        raise DamageError(place, f"a record says its header has {head} bytes; {left} are left")
    start = place + 8 + head
    size = _LENGTH.unpack_from(data, start - 4)[0]
    if size > len(data) - start:
        raise DamageError(place, f"a record says it has {size} bytes; {len(data) - start} are left")
    return start, start + size


def fields_of(header: memoryview, place: int) -> dict[bytes, bytes]:
    """Read named fields, which stand at a place of the file."""
    fields, start = {}, 0
    while start < len(header):
        size = _LENGTH.unpack_from(header, start)[0] if len(header) - start >= 4 else len(header)
        name, sign, value = bytes(header[start + 4 : start + 4 + size]).partition(b"=")
        if size > len(header) - start - 4 or not sign or name in fields:
            raise DamageError(place, "the header of a record is none of named fields")
        fields[name] = value
        start += 4 + size
    return fields


def opened(data: memoryview, chunk: Record) -> memoryview:
    """Decompress a chunk."""
    compressed, size, compression = data[chunk.start : chunk.end], chunk.number(b"size", 4), chunk.text(b"compression")
    if compression != "bz2":
        content = decompressed(compressed, compression.removeprefix("none"), size, chunk.offset)
        return of_size(content, size, chunk.offset)
    if size > room_of(len(compressed)):
        raise DamageError(chunk.offset, f"a chunk of {len(compressed)} compressed bytes says it opens to {size}")
    try:
        content = memoryview(bz2.BZ2Decompressor().decompress(compressed, size + 1))
    except OSError as error:
        raise DamageError(chunk.offset, f"a bz2 chunk cannot be decompressed ({error})") from error
    return of_size(content, size, chunk.offset)


def entries(data: memoryview, record: Record, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read the entries of an index of a chunk, or of what the end of the bag says of one, shape (k,)."""
    count, rest = divmod(record.end - record.start, dtype.itemsize)
    if rest or record.number(b"count", 4) != count:
        raise DamageError(record.offset, f"a record does not have the {count} entries that it says")
    return np.frombuffer(data, dtype, count, record.start)


def times_of(sec: NDArray[Any], nanosec: NDArray[Any]) -> TimeNs:
    """Make one number of seconds and nanoseconds."""
    return np.asarray(sec.astype(np.int64) * NS_PER_S + nanosec)


@dataclass(frozen=True)
class Messages:
    """The messages of a chunk, in the order of their connections and then in its own, shape (k,).

    Their connections, times, ns, where their records and where their payloads start, and how long these are.
    """

    connections: NDArray[np.int64]
    time_ns: TimeNs
    places: NDArray[np.int64]
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]

    def of(self, connection: int) -> "Messages":
        """Return those of one connection."""
        first, end = np.searchsorted(self.connections, (connection, connection + 1))
        return Messages(*(column[first:end] for column in vars(self).values()))

    def counts(self) -> dict[int, int]:
        """Count them by connection."""
        connections, counts = np.unique(self.connections, return_counts=True)
        return dict(zip(connections.tolist(), counts.tolist(), strict=True))


def find_messages(buffer: memoryview, most: int) -> tuple[Messages, list[Record]]:
    """Find the messages and the other records, `most` at most, of an open chunk; a DamageError has the place in it."""
    place, bounds = 0, array("q")
    while place < len(buffer):
        start, end = _bounds(buffer, place)
        bounds.extend((place, start, end))
        place = end
    places, starts, ends = np.array(bounds, np.int64).reshape(-1, 3).T
    told, others, is_tried = np.full((2, places.size), -1), [], False
    for row in range(places.size):
        if told[0, row] >= 0:
            continue
        record = record_at(buffer, int(places[row]))
        others.append(record)
        if len(others) > most:
            raise DamageError(record.offset, "there are more records than a recorder writes that are like no other")
        if record.op == MESSAGE:
            nanosec, sec = divmod(record.number(b"time", 8), 1 << 32)
            told[:, row] = record.number(b"conn", 4), sec * NS_PER_S + nanosec
            if not is_tried:
                # Nearly all messages have headers of one form, and are read together.
                _read_alike(buffer, places, starts, row, told)
            is_tried = True
    rows = np.flatnonzero(told[0] >= 0)
    rows = rows[np.argsort(told[0, rows], kind="stable")]
    return Messages(told[0, rows], told[1, rows], places[rows], starts[rows], (ends - starts)[rows]), others


def _read_alike(
    buffer: memoryview, places: NDArray[np.int64], starts: NDArray[np.int64], first: int, told: NDArray[np.int64]
) -> None:
    """Tell connections and times, shape (2, k), of the messages whose headers differ from the first in these alone."""
    size = int(starts[first] - places[first]) - 8
    rows = np.flatnonzero(starts - places == size + 8)
    headers = gather(buffer, places[rows] + 4, np.dtype((np.void, size))).view(np.uint8).reshape(-1, size)
    header = headers[np.searchsorted(rows, first)]
    connection, time = (bytes(header).index(name) + len(name) for name in (b"conn=", b"time="))
    varies = np.isin(np.arange(size), [*range(connection, connection + 4), *range(time, time + 8)])
    rows = rows[(headers[:, ~varies] == header[~varies]).all(axis=1)]
    at = places[rows] + 4
    told[0, rows] = gather(buffer, at + connection, _WORD)
    told[1, rows] = times_of(gather(buffer, at + time, _WORD), gather(buffer, at + time + 4, _WORD))
