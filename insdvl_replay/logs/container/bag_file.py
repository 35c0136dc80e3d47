"""A .bag file, the log of ROS 1: its connections as channels, and the messages of its chunks as blocks of bytes.

All chunks are opened once to hold them against their indexes, then each again where it is read. After bytes that are no
record nothing is looked for: the format has no mark by which one is known.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container import bag_records
from insdvl_replay.logs.container.blocks import Block, TimedBlock
from insdvl_replay.logs.container.log_file import LogFile
from insdvl_replay.logs.container.loss import COPY_AGAIN, loss_text, places_note
from insdvl_replay.logs.container.mapped_file import MappedFile
from insdvl_replay.logs.container.records import Damage, DamageError, LogChannel

MAGIC: Final = b"#ROSBAG V2.0\n"
_MOST_CONNECTIONS: Final = 1 << 16
_USUALLY_OPENED: Final = 1 << 27
_MOST_COMPRESSED: Final = 64
"""Bags that open to more than usual are no more densely compressed than this: their records are walked one by one."""
_OTHERS: Final = 10_000
_SMALLEST: Final = 16
"""Records that are like no other may be so many, or as many as there is room for them in the file."""


class BagFile(LogFile):
    """A .bag of version 2.0, open for reading. Damage is collected; whether it is allowed is for the recording to say.

    Raises
    ------
    LogError
        It is encrypted.
    """

    profile = "ros1"
    library = "rosbag"

    def __init__(self, file: MappedFile) -> None:
        super().__init__(file)
        self.damages: dict[Damage, None] = {}
        self._records = defaultdict[int, list[bag_records.Record]](list)
        self._indexes = defaultdict[int, list[bag_records.Record]](list)
        self._connections: dict[int, LogChannel] = {}
        self._chunks: dict[int, tuple[bag_records.Record, bag_records.Messages]] = {}
        self._announced: int | None = None
        self._others_left = _OTHERS + len(self._data) // _SMALLEST
        with file.watched():
            self._walk()
            headers = self._records[bag_records.BAG]
            self.has_summary = any(header.fields.get(b"index_pos", b"").strip(b"\0") for header in headers)
            self._open_all()
            self._compare_with_end()
        file.release(0, len(self._data))
        self.chunk_count = len(self._chunks)
        self.compression = tuple(sorted({chunk.text(b"compression") for chunk, _ in self._chunks.values()}))
        times = self.log_times()
        self.channels = tuple(replace(one, messages=times[one.id].size) for one in self._connections.values())

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong, or that the recorder did not close the bag."""
        if self.damages:
            found, announced = sum(channel.messages for channel in self.channels), self._announced
            lost = loss_text([], None if announced is None else announced - found, is_cut=announced is None)
            return (places_note(self.path.name, self.damages, lost),)
        if not self.has_summary:
            text = f"{self.path.name} was not closed by its recorder: what came last may be missing"
            return (Note("log_summary", text, 1, Severity.WARNING, COPY_AGAIN),)
        return ()

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, shape (k,), ns."""
        parts = [
            np.empty((2, 0), np.int64),
            *(np.array([one.connections, one.time_ns]) for _, one in self._chunks.values()),
        ]
        connections, times = np.concatenate(parts, axis=1)
        order, numbers = np.argsort(connections, kind="stable"), np.array(list(self._connections), np.int64)
        first, end = (np.searchsorted(connections, edge, sorter=order).tolist() for edge in (numbers, numbers + 1))
        return {id_: times[order[slice(*edges)]] for id_, edges in enumerate(zip(first, end, strict=True))}

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed."""
        wanted = {number: channel.id for number, channel in self._connections.items() if channel.id in channel_ids}
        for chunk, messages in self._chunks.values():
            there = wanted.keys() & messages.counts().keys()
            buffer = bag_records.opened(self._data, chunk) if there else self._data
            for number in sorted(there):
                one = messages.of(number)
                yield TimedBlock(wanted[number], buffer, one.starts, one.sizes, one.time_ns)
            self._file.release(chunk.offset, chunk.end)

    def _walk(self) -> None:
        """Go through the records of the file, up to its end or to bytes that are none."""
        place, chunk = len(MAGIC), -1
        with self._collected():
            while place < len(self._data):
                record = bag_records.record_at(self._data, place)
                if record.op == bag_records.INDEX:
                    self._indexes[chunk].append(record)
                elif record.op not in range(bag_records.BAG, bag_records.CONNECTION + 1):
                    raise DamageError(place, f"a record of kind {record.op} stands where none belongs")
                else:
                    self._records[record.op].append(record)
                    chunk = place if record.op == bag_records.CHUNK else -1
                self._file.release(place, record.end)
                place = record.end
        if any(header.text(b"encryptor") for header in self._records[bag_records.BAG]):
            raise LogError("is encrypted", "where its key is, `rosbag decompress` writes it plain", self.path)

    def _open_all(self) -> None:
        """Find the connections, and the messages of all chunks; chunks that cannot be opened are left out."""
        for record in self._records[bag_records.CONNECTION]:
            with self._collected():
                self._note_connection(self._data, record, record.offset)
        most, total = max(_USUALLY_OPENED, _MOST_COMPRESSED * len(self._data)), 0
        for chunk in self._records[bag_records.CHUNK]:
            with self._collected():
                total += chunk.number(b"size", 4)
                if total > most:
                    raise DamageError(chunk.offset, f"the chunks up to here open to {total} bytes, of at most {most}")
                self._chunks[chunk.offset] = chunk, self._checked(chunk)
            self._file.release(chunk.offset, chunk.end)

    def _note_connection(self, buffer: memoryview, record: bag_records.Record, offset: int) -> None:
        """Make a channel of a connection; the same stands in its chunk and at the end of the bag."""
        told = bag_records.Record(bag_records.fields_of(buffer[record.start : record.end], offset), offset, 0, 0)
        number = record.number(b"conn", 4)
        channel = LogChannel(
            id=self._connections[number].id if number in self._connections else len(self._connections),
            topic=record.text(b"topic"),
            type_name=told.text(b"type"),
            encoding="ros1",
            schema_encoding="ros1msg",
            messages=0,
            schema_data=told.fields.get(b"message_definition", b""),
            metadata={name: told.text(name.encode()) for name in ("md5sum", "callerid")},
        )
        if self._connections.setdefault(number, channel) != channel:
            self.damages.setdefault(Damage(offset, f"connection {number} is not the same in two places"))
        if len(self._connections) > _MOST_CONNECTIONS:
            raise LogError(f"has more than {_MOST_CONNECTIONS} connections", "no vehicle records so many", self.path)

    def _checked(self, chunk: bag_records.Record) -> bag_records.Messages:
        """Open a chunk, and hold its index against the messages in it, of which those without connection are lost."""
        buffer = bag_records.opened(self._data, chunk)
        try:
            messages, others = bag_records.find_messages(buffer, self._others_left)
            self._others_left -= len(others)
            for record in (one for one in others if one.op == bag_records.CONNECTION):
                self._note_connection(buffer, record, chunk.offset)
        except DamageError as error:
            found = f"in the chunk, {error.damage.offset} bytes on, {error.damage.found}"
            raise DamageError(chunk.offset, found) from error
        for number in sorted(messages.counts().keys() - self._connections):
            found = f"messages are of connection {number}, which is nowhere described"
            self.damages.setdefault(Damage(chunk.offset, found))
        if self._indexes[chunk.offset] or self.has_summary:
            with self._collected():
                self._compare_with_index(chunk, messages)
        return messages

    def _compare_with_index(self, chunk: bag_records.Record, messages: bag_records.Messages) -> None:
        """Hold an index, which is in the order of time, against the messages of its chunk."""
        named = 0
        for index in self._indexes[chunk.offset]:
            entries = np.sort(bag_records.entries(self._data, index, bag_records.ENTRY), order="place", kind="stable")
            found = messages.of(index.number(b"conn", 4))
            times = bag_records.times_of(entries["sec"], entries["nanosec"])
            if np.array_equal(entries["place"], found.places) and np.array_equal(times, found.time_ns):
                named += times.size
        if named != messages.time_ns.size:
            raise DamageError(chunk.offset, "the indexes of a chunk do not name its messages")

    def _compare_with_end(self) -> None:
        """Hold what was found against what the header and the end of the bag say of the whole."""
        headers, infos = self._records[bag_records.BAG], self._records[bag_records.CHUNK_INFO]
        if len(headers) != 1:
            self.damages.setdefault(Damage(len(MAGIC), f"the bag has {len(headers)} headers"))
        if not self.has_summary:
            return
        chunks, ending = self._records[bag_records.CHUNK], [*self._records[bag_records.CONNECTION], *infos]
        start = min((record.offset for record in ending), default=len(self._data))
        announced = [("conn_count", 4, len(self._connections)), ("index_pos", 8, start)]
        announced += [("chunk_count", 4, len(found)) for found in (chunks, infos)]
        for name, size, found in announced:
            if headers[0].fields.get(name.encode()) != found.to_bytes(size, "little"):
                self.damages.setdefault(Damage(headers[0].offset, f"{name} in the header of the bag is not {found}"))
        for info in infos:
            with self._collected():
                counts = dict(bag_records.entries(self._data, info, bag_records.COUNT).tolist())
                self._announced = (self._announced or 0) + sum(counts.values())
                _, messages = self._chunks.get(info.number(b"chunk_pos", 8), (None, None))
                if messages is None or counts != messages.counts():
                    raise DamageError(info.offset, "the end of the bag does not agree with one of its chunks")

    @contextmanager
    def _collected(self) -> Iterator[None]:
        """Note a damaged place, and go on behind what it spoils."""
        try:
            yield
        except DamageError as error:
            self.damages.setdefault(error.damage)
