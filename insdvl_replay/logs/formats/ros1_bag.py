"""A .bag file, the log of ROS 1: its connections as channels, and the messages of its chunks as blocks of bytes.

A record is a header of named fields, and data. Messages are in chunks, behind each an index of its messages by
connection, and at the end of the bag all connections and what each chunk holds. After bytes that are no record nothing
is looked for: the format has no mark by which one is known.
Source: the format of version 2.0, http://wiki.ros.org/Bags/Format/2.0.
"""

from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Array, Integers, TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.log_file import (
    Chunk,
    ChunkedFile,
    DamageError,
    FileBytes,
    LogChannel,
    Messages,
    MessageTimes,
    damage_note,
    gather,
)

_MAGIC: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)  # kinds of records
_LONGEST_HEADER: Final = 1 << 20
_SHORTEST_HEADER: Final = 8  # bytes of the field that says the kind
_SHORTEST_OF_MESSAGE: Final = 38  # bytes of the fields op, conn and time
_MOST_OTHERS: Final = 1 << 16  # records of a chunk that are no messages: connections
_MOST_CHANNELS: Final = 1 << 16
_WORD: Final = np.dtype("<u4")
# Of the index of a chunk, and of what the end of the bag says of a chunk.
_ENTRY: Final = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("place", "<u4")])
_COUNT: Final = np.dtype([("connection", "<u4"), ("count", "<u4")])
Read = Callable[[int, int], memoryview]  # the bytes from a place to another


class _Record(NamedTuple):
    fields: dict[bytes, bytes]
    offset: int
    start: int  # of its data
    end: int

    @property
    def kind(self) -> int:
        return self.number(b"op", 1)

    def number(self, name: bytes, size: int) -> int:
        """Return a field that is a whole number of some bytes."""
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise DamageError(
                self.offset, f"a record has no field '{name.decode()}' of {size} bytes"
            )
        return int.from_bytes(value, "little")

    def text(self, name: bytes) -> str:
        """Return a field that is text; empty where there is none."""
        return self.fields.get(name, b"").decode("utf-8", "replace")


class BagFile(ChunkedFile):
    """A .bag of version 2.0, open for reading."""

    profile = "ros1"
    library = "rosbag"
    usually_opened = 1 << 26
    most_compressed = 64

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self._connections: dict[int, LogChannel] = {}
        self._found: dict[int, Messages] = {}  # by the chunk's place
        self._indexes: dict[int, list[_Record]] = {}
        with self.watched():
            self._read()
        self.chunk_count = len(self._chunks)
        self.compression = tuple(sorted({chunk.compression or "none" for chunk in self._chunks}))
        counts = self._counts()
        self.channels = tuple(
            replace(channel, messages=counts[channel.id]) for channel in self._connections.values()
        )

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong, or that the recorder did not close the bag."""
        if self.damages:
            return (damage_note(self.path.name, self.damages, self._losses()),)
        if not self.has_summary:
            return (note("log_summary open", name=self.path.name),)
        return ()

    def _read(self) -> None:
        """Go through the records of the file, and open its chunks."""
        found = self._records()
        headers = found[_BAG]
        if any(header.text(b"encryptor") for header in headers):
            hint = "decrypt it with its key: `rosbag decompress`"
            raise LogError("is encrypted", hint, self.path)
        if len(headers) != 1:
            self.damage(len(_MAGIC), f"the bag has {len(headers)} headers")
        ends = [header.fields.get(b"index_pos", b"") for header in headers]
        self.has_summary = any(end.strip(b"\0") for end in ends)
        for record in found[_CONNECTION]:
            with self.collected():
                self._take_connection(record, self.file.read(record.start, record.end))
        for record in found[_CHUNK]:
            with self.collected():
                self._chunks.append(_chunk(record))
        self._limit_size()
        for _ in self._contents(self._chunks):
            pass
        if self.has_summary:
            for info in found[_CHUNK_INFO]:
                with self.collected():
                    self._take_info(info)

    def _records(self) -> dict[int, list[_Record]]:
        """Return the records of the file by their kinds, up to its end or to bytes that are none; file the indexes."""
        found: dict[int, list[_Record]] = {kind: [] for kind in range(_BAG, _CONNECTION + 1)}
        place = len(_MAGIC)
        latest = -1  # place of the chunk that indexes are behind
        with self.collected():
            while place < len(self.file):
                record = _record_at(self.file.read, place, len(self.file))
                if record.kind == _INDEX and latest >= 0:
                    self._indexes[latest].append(record)
                elif record.kind not in found:
                    what = f"a record of kind {record.kind} is in the wrong place"
                    raise DamageError(place, what)
                else:
                    found[record.kind].append(record)
                    latest = place if record.kind == _CHUNK else -1
                    self._indexes[place] = []
                place = record.end
        if place < len(self.file):
            self._passed.append((place, len(self.file)))
        return found

    def _take_info(self, info: _Record) -> None:
        """Add to the messages that are announced what the end of the bag says of a chunk, and hold it against this."""
        entries = self._entries(info, _COUNT)
        ids = self._ids(entries["connection"].tolist())
        announced = Counter(dict(zip(ids, entries["count"].tolist(), strict=True)))
        self._announced = (self._announced or Counter()) + announced
        place = info.number(b"chunk_pos", 8)
        chunks = [chunk for chunk in self._chunks if chunk.start == place]
        if not any(chunk.counts == announced for chunk in chunks):
            what = "the end of the bag does not agree with one of its chunks"
            raise DamageError(info.offset, what)

    def _ids(self, connections: list[int]) -> list[int]:
        """Return the channels of connections; -1 where one is nowhere described."""
        ids = []
        for number in connections:
            channel = self._connections.get(number)
            ids.append(-1 if channel is None else channel.id)
        return ids

    def _take_connection(self, record: _Record, data: memoryview) -> None:
        """Make a channel of a connection; the same is in its chunk and at the end of the bag."""
        described = _Record(_fields(data, record.offset), record.offset, 0, 0)
        number = record.number(b"conn", 4)
        before = self._connections.get(number)
        channel = LogChannel(
            id=len(self._connections) if before is None else before.id,
            topic=record.text(b"topic"),
            type_name=described.text(b"type"),
            encoding="ros1",
            schema_encoding="ros1msg",
            messages=0,
            schema_data=described.fields.get(b"message_definition", b""),
            metadata={name: described.text(name.encode()) for name in ("md5sum", "callerid")},
        )
        if channel.id >= _MOST_CHANNELS:
            hint = "check the file: no vehicle records so many"
            raise LogError("has more than 65536 connections", hint, self.path)
        if self._connections.setdefault(number, channel) != channel:
            raise DamageError(record.offset, f"connection {number} is not the same in two places")

    def _find_messages(
        self,
        chunk: Chunk,
        buffer: memoryview,
        behind: memoryview,
    ) -> Messages:
        """Find the messages of an open chunk, and hold its indexes against them; those without connection are lost."""
        if chunk.start in self._found:
            return self._found[chunk.start]
        try:
            records, others = messages_in(buffer)
            for record in others:
                if record.kind == _CONNECTION:
                    self._take_connection(record, buffer[record.start : record.end])
        except DamageError as error:
            offset, what = error.damage
            raise DamageError(chunk.start, f"in the chunk, {offset} bytes on, {what}") from error
        indexes = self._indexes[chunk.start]
        with self.collected():
            named = sum(self._count_named(index, records) for index in indexes)
            if (indexes or self.has_summary) and named != records.connections.size:
                what = "the indexes of a chunk do not agree with its messages"
                raise DamageError(chunk.start, what)
        numbers, rows, counts = np.unique(
            records.connections, return_inverse=True, return_counts=True
        )
        ids = np.array(self._ids(numbers.tolist()), np.int64)
        for number in numbers[ids < 0].tolist():
            self.damage(chunk.start, f"messages are of connection {number}, which is not defined")
        chunk.counts = Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))
        messages = Messages(
            channel_ids=ids[rows],
            log_ns=records.time_ns,
            publish_ns=records.time_ns,
            starts=records.starts,
            sizes=records.sizes,
        )
        self._found[chunk.start] = messages.rows(messages.channel_ids >= 0)
        return self._found[chunk.start]

    def _count_named(self, index: _Record, records: "_MessageRecords") -> int:
        """Return how many messages an index names, 0 if it is not right about all messages of its connection."""
        entries = np.sort(self._entries(index, _ENTRY), order="place", kind="stable")
        is_own = records.connections == index.number(b"conn", 4)
        if not np.array_equal(entries["place"], records.places[is_own]):
            return 0
        time_ns = _time_ns(entries["sec"], entries["nanosec"])
        if not np.array_equal(time_ns, records.time_ns[is_own]):
            return 0
        return len(entries)

    def _listed(self, chunk: Chunk) -> MessageTimes | None:
        """Return channel and log time of the messages of a chunk, which was opened when the file was."""
        found = self._found[chunk.start]
        return MessageTimes(found.channel_ids, found.log_ns)

    def _entries(self, record: _Record, dtype: np.dtype[Any]) -> Array:
        """Read the entries of an index, (k,)."""
        count, rest = divmod(record.end - record.start, dtype.itemsize)
        if rest or record.number(b"count", 4) != count:
            raise DamageError(record.offset, f"a record does not have its {count} entries")
        return np.frombuffer(self.file.read(record.start, record.end), dtype)


def _chunk(record: _Record) -> Chunk:
    """Return the chunk that a record is."""
    return Chunk(
        record.offset,
        record.end,
        compression=record.text(b"compression").removeprefix("none"),
        data_start=record.start,
        data_size=record.end - record.start,
        size=record.number(b"size", 4),
    )


def _record_at(read: Read, place: int, end: int) -> _Record:
    """Read the record that starts at a place."""
    if end - place < 8:
        raise DamageError(place, f"{end - place} bytes are left where a record needs at least 8")
    size = int.from_bytes(read(place, place + 4), "little")
    left = end - place - 8
    if size > min(left, _LONGEST_HEADER):
        raise DamageError(place, f"a record says its header has {size} bytes; {left} are left")
    header = read(place + 4, place + 8 + size)
    start = place + 8 + size
    length = int.from_bytes(header[size:], "little")
    if length > end - start:
        raise DamageError(place, f"a record says it has {length} bytes; {end - start} are left")
    return _Record(_fields(header[:size], place), place, start, start + length)


def _fields(header: memoryview, place: int) -> dict[bytes, bytes]:
    """Read the named fields at a place of the file."""
    fields = {}
    start = 0
    while start < len(header):
        size = int.from_bytes(header[start : start + 4], "little")
        name, sign, value = bytes(header[start + 4 : start + 4 + size]).partition(b"=")
        if size > len(header) - start - 4 or not sign or name in fields:
            raise DamageError(place, "the header of a record has no named fields")
        fields[name] = value
        start += 4 + size
    return fields


def _time_ns(sec: Array, nanosec: Array) -> TimeNs:
    return np.asarray(sec.astype(np.int64) * NS_PER_S + nanosec)


class _MessageRecords(NamedTuple):
    """The records of an open chunk that are messages; each column is (k,)."""

    connections: Integers
    time_ns: TimeNs
    places: Integers  # where each record starts in the chunk
    starts: Integers  # where its payload starts
    sizes: Integers  # bytes of the payload


def messages_in(buffer: memoryview) -> tuple[_MessageRecords, list[_Record]]:
    """Find the messages of an open chunk, and its other records; a DamageError has the place in it."""
    places, starts, ends = _bounds(buffer)
    connections = np.full(places.size, -1, np.int64)
    time_ns = np.zeros(places.size, np.int64)
    others = []
    is_first = True
    for row in range(places.size):
        if connections[row] >= 0:
            continue
        record = _record_in(buffer, int(places[row]))
        if record.kind != _MESSAGE:
            others.append(record)
            if len(others) > _MOST_OTHERS:
                raise _too_many_others(int(places[row]))
            continue
        nanosec, sec = divmod(record.number(b"time", 8), 1 << 32)
        time_ns[row] = sec * NS_PER_S + nanosec
        connections[row] = record.number(b"conn", 4)
        if is_first:
            # Nearly all messages have headers that differ from the first in connection and time alone.
            alike = _alike(buffer, places, starts, row)
            connections[alike.rows] = alike.connections
            time_ns[alike.rows] = alike.time_ns
        is_first = False
    is_message = connections >= 0
    found = _MessageRecords(
        connections=connections[is_message],
        time_ns=time_ns[is_message],
        places=places[is_message],
        starts=starts[is_message],
        sizes=(ends - starts)[is_message],
    )
    return found, others


def _too_many_others(place: int) -> DamageError:
    return DamageError(place, f"more than {_MOST_OTHERS} records of a chunk are not messages")


def _record_in(buffer: memoryview, place: int) -> _Record:
    return _record_at(lambda first, last: buffer[first:last], place, len(buffer))


def _bounds(buffer: memoryview) -> Integers:
    """Return where each record of a buffer starts, where its data start, and where these end, (3, k)."""
    place = 0
    end = len(buffer)
    others = 0
    bounds = array("q")
    while place < end:
        # As `_record_at`, without the fields.
        size = int.from_bytes(buffer[place : place + 4], "little")
        start = place + 8 + size
        behind = start + int.from_bytes(buffer[start - 4 : start], "little")
        if not _SHORTEST_HEADER <= size <= _LONGEST_HEADER or start > end or behind > end:
            _record_in(buffer, place)
            raise DamageError(place, f"a record says its header has {size} bytes")
        if size < _SHORTEST_OF_MESSAGE:
            others += 1
            if others > _MOST_OTHERS:
                raise _too_many_others(place)
        bounds.extend((place, start, behind))
        place = behind
    return np.frombuffer(bounds, np.int64).reshape(-1, 3).T


class _Alike(NamedTuple):
    """Messages whose headers differ in connection and time alone."""

    rows: Integers
    connections: Array
    time_ns: TimeNs


def _alike(
    buffer: memoryview,
    places: Integers,
    starts: Integers,
    row: int,
) -> _Alike:
    """Find the messages whose headers are like that of one, by where records and their data start, (k,)."""
    size = int(starts[row] - places[row]) - 8
    rows = np.flatnonzero(starts - places == size + 8)
    headers = gather(buffer, places[rows] + 4, np.dtype((np.bytes_, size)))
    by_byte = headers.view(np.uint8).reshape(-1, size)
    first = int(np.searchsorted(rows, row))
    model = bytes(by_byte[first])
    connection = model.index(b"conn=") + len(b"conn=")
    time = model.index(b"time=") + len(b"time=")
    by_byte[:, connection : connection + 4] = 0
    by_byte[:, time : time + 8] = 0
    rows = rows[headers == headers[first]]
    at = places[rows] + 4
    sec = gather(buffer, at + time, _WORD)
    nanosec = gather(buffer, at + time + 4, _WORD)
    return _Alike(rows, gather(buffer, at + connection, _WORD), _time_ns(sec, nanosec))
