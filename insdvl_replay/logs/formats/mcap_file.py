"""An MCAP file: its channels, and their messages as blocks of bytes, never a Python object for each of them.

One walk over the records tells what the file holds: the indexes behind a chunk say which channels have messages in it,
so that others stay closed. In an open chunk the indexes say where messages are, and the records there must agree; the
summary at the end must agree with the whole. Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import Array, Integers
from insdvl_replay.core.errors import Note, counted_clause, listed
from insdvl_replay.core.notes import note
from insdvl_replay.logs.formats.log_file import (
    LARGEST_CHUNK,
    Chunk,
    ChunkedFile,
    Content,
    Damage,
    DamageError,
    Digest,
    FileBytes,
    LogChannel,
    Messages,
    MessageTimes,
    UnusableFileError,
    damage_note,
    gather,
)

MAGIC: Final = b"\x89MCAP0\r\n"  # first and last bytes
PARTS: Final = "insdvl_replay.parts"  # name of the metadata of a file without the chunks that have only pictures
HEADER_SIZE: Final = 9  # bytes in front of each record's content: its kind and its length
HEADER: Final = struct.Struct("<BQ")
# What a record of each kind must at least hold for its own fields; no record is of kind 0.
_LEAST: Final = (1 << 64, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
_LAST_KNOWN: Final = 15  # kind that the specification knows
_FIRST_PRIVATE: Final = 128
# In front of each payload.
MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<i8"),
        ("publish", "<i8"),
    ]
)
_MESSAGE_FIELDS: Final = MESSAGE.itemsize - HEADER_SIZE
_ENTRY: Final = np.dtype([("log", "<i8"), ("start", "<i8")])  # of a message index
# Bytes that the walk looks at at a time: among chunks, among messages.
_WINDOW: Final = 4 << 10
_LARGE_WINDOW: Final = 1 << 20
_END_OF_TIME_NS: Final = 2**63  # times are signed in numpy as in ROS, and unsigned in the format
_CUT: Final = "the closing bytes are missing; the file was cut or is still being written"
_SUMMARY_ONLY: Final = (
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
# Those that are read whole.
_RECORDS: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.DATA_END: records.DataEnd,
}


def can_be_record(kind: int, length: int) -> bool:
    """Return whether a record of a kind can have a length."""
    if kind < len(_LEAST):
        return length >= _LEAST[kind]
    return kind >= _FIRST_PRIVATE


class Walk(NamedTuple):
    """The records of a buffer, one behind the other."""

    records: Integers  # (k, 3): kind, and start and length of the content of each
    others: int  # of kinds that are not MCAP's own
    end: int  # where they end
    is_broken: bool  # whether bytes that are no record are there


def walk(buffer: memoryview, room: int) -> Walk:
    """Find the records of a buffer, whose last one may go on behind it, up to `room` bytes.

    A message before bytes that are no record may have a false length, and is left out.
    """
    parts: list[Integers] = []
    found: list[tuple[int, int, int]] = []
    place = 0
    others = 0
    before = (0, 0)
    patience = 0
    most = 64
    # The head of each message must be in the buffer.
    least = HEADER_SIZE if len(buffer) >= room else MESSAGE.itemsize
    is_broken = False
    while place <= len(buffer) - least:
        head = HEADER.unpack_from(buffer, place)
        kind, length = head
        is_broken = length > room - place - HEADER_SIZE or not can_be_record(kind, length)
        if is_broken:
            break
        count = 1
        if head == before and patience == 0:
            # Messages of one sensor have one size: those that follow are looked at together.
            count = _count_alike(buffer, place, head, most)
            most = min(max(64, 2 * count), 1 << 14)
            patience = 0 if count > 8 else 64
        if kind >= _FIRST_PRIVATE:
            others += count
        elif count > 1:
            parts += [_as_rows(found), _rows_alike(head, place, count)]
            found = []
        else:
            found.append((kind, place, length))
        before = head
        patience = max(patience - 1, 0)
        place += (HEADER_SIZE + length) * count
    records = np.concatenate([*parts, _as_rows(found)])
    is_broken |= len(buffer) >= room and place < room
    if is_broken and len(records) and records[-1, 0] == Opcode.MESSAGE:
        records = records[:-1]
    return Walk(records, others, place, is_broken)


def _count_alike(
    buffer: memoryview,
    place: int,
    head: tuple[int, int],
    most: int,
) -> int:
    """Count the records from a place on that have one head, up to some of them."""
    kind, length = head
    size = HEADER_SIZE + length
    ahead = min((len(buffer) - place) // size, most)
    if ahead <= 1:
        return 1
    alike = np.ndarray((ahead,), "<u8", buffer, place + 1, (size,)) == length
    alike &= np.ndarray((ahead,), np.uint8, buffer, place, (size,)) == kind
    return ahead if alike.all() else int(alike.argmin())


def _rows_alike(head: tuple[int, int], place: int, count: int) -> Integers:
    """Return records that have one head, one behind the other, as rows."""
    kind, length = head
    rows = np.empty((count, 3), np.int64)
    rows[:, 0] = kind
    rows[:, 1] = place + (HEADER_SIZE + length) * np.arange(count)
    rows[:, 2] = length
    return rows


def _as_rows(found: Sequence[tuple[int, int, int]]) -> Integers:
    return np.array(found, np.int64).reshape(-1, 3)


def _end_of(records: Integers) -> int:
    """Return where the last of some records ends; 0 without any."""
    if not len(records):
        return 0
    _, start, length = records[-1].tolist()
    return int(start + length) + HEADER_SIZE


def what_is_there(data: memoryview, room: int) -> str:
    """State why no record can start where some bytes do, with so many left."""
    if room < HEADER_SIZE:
        return f"{room} bytes are left where a record needs at least {HEADER_SIZE}"
    kind, length = HEADER.unpack_from(data)
    if length > room - HEADER_SIZE:
        return f"a record of kind {kind} says it has {length} bytes; {room - HEADER_SIZE} are left"
    return f"{length} bytes under kind {kind} are no record"


def next_record(file: FileBytes, place: int, end: int) -> int:
    """Return the next place where a record can be with another one, or the end, right behind it."""

    def end_of_record(head: memoryview, place: int) -> int:
        """Return where a record at a place ends, 0 if none can be there."""
        if len(head) < HEADER_SIZE:
            return 0
        kind, length = HEADER.unpack_from(head)
        if kind > _LAST_KNOWN or not can_be_record(kind, length):
            return 0
        if length > end - place - HEADER_SIZE:
            return 0
        return place + HEADER_SIZE + int(length)

    for start in range(place, end, _LARGE_WINDOW):
        piece = file.read(start, min(start + _LARGE_WINDOW + HEADER_SIZE - 1, end))
        data = np.frombuffer(piece, np.uint8)
        count = max(len(data) - HEADER_SIZE + 1, 0)
        likely = (data[:count] > 0) & (data[:count] <= _LAST_KNOWN)
        for byte in (6, 7, 8):  # the highest of a length are zero
            likely &= data[byte : byte + count] == 0
        for at in np.flatnonzero(likely).tolist():
            behind = end_of_record(piece[at : at + HEADER_SIZE], start + at)
            if behind == 0:
                continue
            if behind == end or end_of_record(file.read(behind, behind + HEADER_SIZE), behind):
                return start + at
    return end


def log_channels(
    channels: Mapping[int, records.Channel],
    schemas: Mapping[int, records.Schema],
    counts: Mapping[int, int],
) -> tuple[LogChannel, ...]:
    """Return the channels of a file with their types and numbers of messages."""
    no_schema = records.Schema(
        id=0,
        name="",
        encoding="",
        data=b"",
    )
    found = []
    for channel in channels.values():
        schema = schemas.get(channel.schema_id) or no_schema
        found.append(
            LogChannel(
                id=channel.id,
                topic=channel.topic,
                type_name=schema.name,
                encoding=channel.message_encoding,
                schema_encoding=schema.encoding,
                messages=counts.get(channel.id, 0),
                schema_data=schema.data,
                metadata=channel.metadata,
            )
        )
    return tuple(found)


class McapFile(ChunkedFile):
    """An MCAP file, open for reading."""

    usually_opened = LARGEST_CHUNK
    most_compressed = 256

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self.schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self.metadata: list[records.Metadata] = []
        self.attachments: list[records.AttachmentIndex] = []
        # Of each attachment: its start and length without the checksum, and this.
        self._attachments: list[tuple[int, int, int]] = []
        self._chunk_indexes: dict[int, records.ChunkIndex] = {}
        self._only: dict[int, tuple[int, Any]] = {}  # where the only record of a kind is, and this
        self._private = 0
        end = self._end()
        with self.watched():
            self._walk(end)
            self._limit_size()
            self._check_summary(end)
            self._look_into_chunks()
        header = self._record(Opcode.HEADER) or records.Header("", "")
        self.profile = header.profile
        self.library = header.library
        self.has_summary = self._announced is not None or bool(self._chunk_indexes)
        compressed = [chunk.compression or "none" for chunk in self._chunks if not chunk.is_loose]
        self.chunk_count = len(compressed)
        self.compression = tuple(sorted(set(compressed)))
        self.channels = log_channels(self._channels, self.schemas, self._counts())

    # --- What the file holds.

    def _record(self, kind: int) -> Any:
        """Return the only record of a kind, None where there is none."""
        return self._only.get(kind, (0, None))[1]

    def _end(self) -> int:
        """Return where the records end, and refuse a file that is no MCAP file."""
        size = len(self.file)
        magic = len(MAGIC)
        opening = bytes(self.file.read(0, magic + HEADER_SIZE))
        closing = bytes(self.file.read(size - magic, size))
        self._is_closed = size >= 2 * magic and closing == MAGIC
        if opening[:magic] != MAGIC:
            kind, length = HEADER.unpack(opening[magic:].ljust(HEADER_SIZE, b"\0"))
            # It may be that only its opening bytes are damaged.
            if closing != MAGIC and (
                kind != Opcode.HEADER or length > size or not can_be_record(kind, length)
            ):
                what = f"is not an MCAP file, nor a bag: it starts with bytes '{opening[:8].hex(' ')}'"
                raise UnusableFileError(
                    what,
                    "docs/inputs.md lists the logs, tables and files of instruments that are read",
                    self.path,
                )
            self.damage(
                0, f"the opening bytes are '{opening[:magic].hex(' ')}', not those of an MCAP file"
            )
        if self._is_closed:
            return size - magic
        return size

    def _walk(self, end: int) -> None:
        """Go from the first record to the last one."""
        place = len(MAGIC)
        size = _WINDOW
        last = end
        while place < end:
            window = self.file.read(place, min(place + size, end))
            found = walk(window, end - place)
            self._private += found.others
            self._take_all(window, place, found.records)
            has_messages = bool(np.any(found.records[:, 0] == Opcode.MESSAGE))
            size = _LARGE_WINDOW if has_messages else _WINDOW
            if not found.is_broken:
                place += found.end
                continue
            sound = place + _end_of(found.records)
            following = next_record(self.file, sound + 1, end)
            if following == end and not self._is_closed:
                last = sound
            else:
                what = what_is_there(window[found.end :], end - place - found.end)
                self.damage(place + found.end, what)
            if following < end or not self._take_cut_chunk(sound, end):
                self._passed.append((sound, following))
            place = following
        if not self._is_closed:
            self.damages = {Damage(last, _CUT): None, **self.damages}

    def _take_all(
        self,
        window: memoryview,
        place: int,
        found: Integers,
    ) -> None:
        """File the records of a window; messages that follow each other are as one chunk."""
        if not len(found):
            return
        is_message = found[:, 0] == Opcode.MESSAGE
        changes = np.flatnonzero(np.diff(is_message)) + 1
        for first, behind in pairwise([0, *changes.tolist(), len(found)]):
            if is_message[first]:
                self._chunks.append(_loose_chunk(window, place, found[first:behind]))
                continue
            for kind, start, length in found[first:behind].tolist():
                with self.collected():
                    self._take(kind, place + start, length, window[start + HEADER_SIZE :])

    def _take_cut_chunk(self, place: int, end: int) -> bool:
        """Take a chunk without its end, which is the last thing that a recorder wrote; return whether it is one."""
        if self.file.read(place, place + 1) == bytes([Opcode.CHUNK]):
            with self.collected():
                chunk = self._chunk(place, end)
                chunk.is_cut = True
                if chunk.compression:
                    self._chunks.append(chunk)
                    return True
        return False

    def _take(
        self,
        kind: int,
        start: int,
        length: int,
        content: memoryview,
    ) -> None:
        """File a record; of its content as much is given as is in the window."""
        begin = start + HEADER_SIZE
        if kind == Opcode.CHUNK:
            self._chunks.append(self._chunk(start, begin + length))
        elif kind == Opcode.MESSAGE_INDEX:
            self._take_index(start, length, content)
        elif kind == Opcode.ATTACHMENT:
            self._take_attachment(begin, length)
        elif kind in _SUMMARY_ONLY and Opcode.DATA_END not in self._only:
            raise DamageError(start, f"a record of kind {kind} is among the messages")
        elif kind in _RECORDS:
            if len(content) < length:
                content = self.file.read(begin, begin + length)
            self._take_record(kind, content[:length], start)

    def _take_index(
        self,
        start: int,
        length: int,
        content: memoryview,
    ) -> None:
        """Give the chunk before it an index of its messages of one channel."""
        chunk = self._chunks[-1] if self._chunks else Chunk(0, 0)
        if chunk.index_end != start or chunk.is_loose:
            raise DamageError(start, "an index does not follow a chunk")
        channel_id, size = struct.unpack_from("<HI", content)
        chunk.indexes.append((start + HEADER_SIZE, start + HEADER_SIZE + length))
        if size > length - 6 or size % _ENTRY.itemsize or channel_id in chunk.counts:
            chunk.is_indexed = False
            what = f"an index of {length} bytes says it has {size} bytes of channel {channel_id}"
            raise DamageError(start, what)
        chunk.counts[channel_id] = size // _ENTRY.itemsize

    def _take_record(
        self,
        kind: int,
        content: memoryview,
        offset: int,
    ) -> None:
        """Read a record whole; a schema or a channel may be repeated in the summary and in chunks."""
        try:
            record = _RECORDS[kind].read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, UnicodeDecodeError, EOFError) as error:
            what = f"a {_RECORDS[kind].__name__} record of {len(content)} bytes cannot be parsed"
            raise DamageError(offset, what) from error
        if kind == Opcode.METADATA:
            self.metadata.append(record)
        elif kind == Opcode.CHUNK_INDEX:
            self._chunk_indexes[record.chunk_start_offset] = record
        elif kind not in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._only[kind] = offset, record
        else:
            known: dict[int, Any] = self.schemas if kind == Opcode.SCHEMA else self._channels
            if known.setdefault(record.id, record) != record:
                what = f"{type(record).__name__.lower()} {record.id} is not the same in two places"
                raise DamageError(offset, what)

    def _chunk(self, start: int, end: int) -> Chunk:
        """Read the fields in front of a chunk's compressed bytes."""
        fields = self.file.read(start + HEADER_SIZE, min(start + 128, end))
        try:
            first_ns, last_ns, size, crc, name_size = struct.unpack_from("<QQQII", fields)
            name = bytes(fields[32 : 32 + name_size]).decode("ascii", "replace")
            data_size = struct.unpack_from("<Q", fields, 32 + name_size)[0]
        except struct.error as error:
            what = f"a chunk has {len(fields)} bytes, too few for its own header"
            raise DamageError(start, what) from error
        data_start = start + HEADER_SIZE + 40 + name_size
        return Chunk(
            start,
            end,
            compression=name,
            data_start=data_start,
            data_size=data_size,
            size=size,
            crc=crc,
            span_ns=(first_ns, last_ns),
        )

    def _take_attachment(self, begin: int, length: int) -> None:
        """Read an attachment's fields; its bytes are not touched."""
        try:
            fields = self.file.read(begin, begin + min(length, _LARGE_WINDOW))
            stream = ReadDataStream(BytesIO(fields))
            log_ns = stream.read8()
            create_ns = stream.read8()
            name = stream.read_prefixed_string()
            media_type = stream.read_prefixed_string()
            size = stream.read8()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise DamageError(
                begin, f"an attachment of {length} bytes cannot be parsed"
            ) from error
        if stream.count + size + 4 > length:
            raise DamageError(
                begin, f"an attachment says it has {size} bytes; its record has {length}"
            )
        end = begin + stream.count + size
        self.attachments.append(
            records.AttachmentIndex(end - size, size, log_ns, create_ns, size, name, media_type)
        )
        crc = int.from_bytes(self.file.read(end, end + 4), "little")
        self._attachments.append((begin, stream.count + size, crc))

    def _check_summary(self, end: int) -> None:
        """Hold the end of the file against what was found."""
        if Opcode.HEADER not in self._only:
            self.damage(len(MAGIC), "the log has no header")
        self._is_open_ended = Opcode.DATA_END not in self._only
        if self._is_open_ended:
            if self._is_closed:
                self.damage(end, "the record that ends the messages is missing")
            return
        if not self._check_footer(end):
            return
        stated = self._record(Opcode.STATISTICS)
        if stated is not None:
            self._announced = Counter(stated.channel_message_counts)
            self._announced_ns = stated.message_start_time, stated.message_end_time
        self._check_chunk_indexes()

    def _check_footer(self, end: int) -> bool:
        """Hold the footer against the summary; return whether the summary can be believed."""
        footer_start, footer = self._only.get(Opcode.FOOTER, (0, None))
        if footer is None:
            if self._is_closed:
                self.damage(end, "the footer before the closing bytes is missing")
            return True
        summary_start = self._only[Opcode.DATA_END][0] + HEADER_SIZE + 4
        if footer.summary_start not in (0, summary_start):
            what = f"the footer says that the summary starts at byte {footer.summary_start}"
            self.damage(footer_start, what)
        # The checksum covers the footer up to itself.
        covered = self.file.read(summary_start, footer_start + HEADER_SIZE + 16)
        if footer.summary_crc and zlib_ng.crc32(covered) != footer.summary_crc:
            self.damage(summary_start, "the checksum of the summary is wrong")
            self._chunk_indexes = {}
            return False
        return True

    def _check_chunk_indexes(self) -> None:
        """Hold the chunks that the summary lists against those that were found."""
        chunks = [*self._chunks, *self._lost]
        starts = {chunk.start for chunk in chunks if not chunk.is_loose}
        spans = {chunk.span_ns for chunk in chunks}
        for start, index in self._chunk_indexes.items():
            if start not in starts:
                self.damage(start, "the summary has a chunk here, but there is none")
            if (index.message_start_time, index.message_end_time) not in spans:
                self._missing.append(start)
        if self._chunk_indexes:
            for start in starts - self._chunk_indexes.keys():
                self.damage(start, "there is a chunk here that is not in the summary")

    def _is_known(self, chunk: Chunk) -> bool:
        """Return whether it is known without opening a chunk which messages it has, and how they are defined."""
        if chunk.is_loose:
            return True
        if not chunk.indexes or not chunk.is_indexed:
            return False
        for channel_id in chunk.counts:
            channel = self._channels.get(channel_id)
            if channel is None or (channel.schema_id and channel.schema_id not in self.schemas):
                return False
        return True

    def _look_into_chunks(self) -> None:
        """Open the chunks of which it is not known what is in them, for definitions and counts."""
        for chunk in list(self._chunks):
            if not self._is_known(chunk):
                for content in self._contents([chunk]):
                    chunk.counts = content.counts()
        for channel_id, count in self._counts().items():
            if channel_id not in self._channels:
                clause = f"messages are of channel {channel_id}, which is not defined"
                self.damage(len(self.file), counted_clause(count, clause))

    # --- Chunks.

    def _find_messages(
        self,
        chunk: Chunk,
        buffer: memoryview,
        behind: memoryview,
    ) -> Messages:
        """Find the messages of an open chunk by its indexes, if the records agree with them, else record by record."""
        entries = self._entries(chunk, behind)
        ids, log_ns, starts = entries[:, np.argsort(entries[2], kind="stable")]
        inside = (starts >= 0) & (starts <= len(buffer) - MESSAGE.itemsize)
        heads = np.zeros(starts.size, MESSAGE)
        if inside.any():
            heads = gather(buffer, np.where(inside, starts, 0), MESSAGE)
        ends = starts + HEADER_SIZE + heads["length"]
        right = inside & (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == ids)
        right &= (heads["log"] == log_ns) & (heads["length"] >= _MESSAGE_FIELDS)
        right &= ends <= np.append(starts, len(buffer))[1:]
        if chunk.indexes and right.all() and not self._has_others(chunk, buffer, starts, ends):
            return _messages(heads, starts)
        named = set(zip(ids.tolist(), starts.tolist(), strict=True))
        return self._find_by_record(chunk, buffer, named, starts[right])

    def _has_others(
        self,
        chunk: Chunk,
        buffer: memoryview,
        starts: Integers,
        ends: Integers,
    ) -> bool:
        """Take the definitions around messages; return whether other messages, or no records, are there."""
        before = np.append(0, ends)
        behind = np.append(starts, len(buffer))
        is_gap = before < behind
        for start, end in np.stack([before[is_gap], behind[is_gap]], axis=1).tolist():
            found = walk(buffer[start:end], end - start)
            self._take_definitions(chunk, buffer[start:end], found.records)
            if found.is_broken or np.any(found.records[:, 0] == Opcode.MESSAGE):
                return True
        return False

    def _find_by_record(
        self,
        chunk: Chunk,
        buffer: memoryview,
        named: set[tuple[int, int]],
        sound: Integers,
    ) -> Messages:
        """Find messages record by record, up to bytes that are none; behind them, those that the indexes know.

        The indexes name channel and place of messages, and those at some places are sound.
        """
        found = walk(buffer, len(buffer))
        self._take_definitions(chunk, buffer, found.records)
        starts = found.records[found.records[:, 0] == Opcode.MESSAGE, 1]
        if found.is_broken:
            what = what_is_there(buffer[found.end :], len(buffer) - found.end)
            if not len(found.records):
                raise DamageError(chunk.start, f"in the chunk no record is found: {what}")
            if not chunk.is_cut:
                self.damage(chunk.start, f"in the chunk, {found.end} bytes on, {what}")
            last = starts[-1] if starts.size else 0
            starts = np.union1d(starts, sound[sound >= last])
        content = Content(buffer, _messages(gather(buffer, starts, MESSAGE), starts))
        if not chunk.indexes:
            return content.messages
        there = set(zip(content.messages.channel_ids.tolist(), starts.tolist(), strict=True))
        wrong = _wrongly_named(named, there)
        if wrong:
            channels = listed(map(str, sorted(wrong)))
            what = f"the indexes of a chunk do not agree with its messages of channel {channels}"
            self.damage(chunk.start, what)
        if wrong or found.is_broken:
            chunk.counts = content.counts()
            chunk.is_indexed = False
        return content.messages

    def _entries(self, chunk: Chunk, behind: memoryview) -> Integers:
        """Return what the indexes of a chunk say: channel, log time and place in the chunk of each message, (3, k)."""
        parts = [np.empty((3, 0), np.int64)]
        for start, end in chunk.indexes:
            channel_id, size = struct.unpack_from("<HI", behind, start - chunk.end)
            count = min(size, end - start - 6) // _ENTRY.itemsize
            entries = np.frombuffer(behind, _ENTRY, count, start - chunk.end + 6)
            parts.append(
                np.stack([np.full(count, channel_id, np.int64), entries["log"], entries["start"]])
            )
        return np.concatenate(parts, axis=1)

    def _listed(self, chunk: Chunk) -> MessageTimes | None:
        """Return channel and log time of the messages of a chunk, as its indexes say."""
        if chunk.indexes and chunk.is_indexed:
            entries = self._entries(chunk, self.file.read(chunk.end, chunk.index_end))
            return MessageTimes(entries[0], entries[1])
        return None

    def _take_definitions(
        self,
        chunk: Chunk,
        buffer: memoryview,
        found: Integers,
    ) -> None:
        for kind, start, length in found[found[:, 0] < Opcode.MESSAGE].tolist():
            if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                with self.collected():
                    content = buffer[start + HEADER_SIZE : start + HEADER_SIZE + length]
                    self._take_record(kind, content, chunk.start)

    # --- What a recording asks for.

    def digest(self) -> Digest:
        """Go over all bytes of the file, and check the checksums of all messages and of attachments."""
        end, data_end = self._only.get(Opcode.DATA_END, (0, None))
        digest = self.file.digest(end, data_end.data_section_crc if data_end else 0)
        for start, length, stated in self._attachments:
            if stated and self._checksum(start, start + length) != stated:
                what = "the checksum of an attachment is not that of its bytes"
                digest.damages.append(Damage(start, what))
        return digest

    def _checksum(self, start: int, end: int) -> int:
        crc = 0
        for place in range(start, end, _LARGE_WINDOW):
            crc = zlib_ng.crc32(self.file.read(place, min(place + _LARGE_WINDOW, end)), crc)
        return crc

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong so far."""
        notes = []
        missing = 0
        spans = [chunk.span_ns for chunk in self._chunks]
        if self._announced_ns:
            missing = self._record(Opcode.STATISTICS).message_count - self._counts().total()
            spans = [self._announced_ns]
        if self.damages:
            notes.append(damage_note(self.path.name, self.damages, self._losses()))
        elif missing:
            count = abs(missing)
            notes.append(
                note(
                    "log_summary",
                    count,
                    name=self.path.name,
                    missing=missing,
                )
            )
        last_ns = max((last for _, last in spans), default=0)
        if last_ns >= _END_OF_TIME_NS:
            notes.append(
                note(
                    "log_times_late",
                    name=self.path.name,
                    last_ns=last_ns,
                )
            )
        if self._private:
            notes.append(note("unknown_records", self._private))
        notes += [_note_on_parts(record) for record in self.metadata if record.name == PARTS]
        return tuple(notes)


def _note_on_parts(record: records.Metadata) -> Note:
    """Say what was not fetched of a remote log."""
    described = record.metadata
    chunks = described.get("chunks", "")
    size = described.get("bytes", "")
    return note(
        "log_parts",
        int(chunks) if chunks.isdecimal() else 1,
        size_mb=int(size) / 1e6 if size.isdecimal() else 0.0,
        topics=described.get("topics", ""),
    )


def _messages(heads: Array, starts: Integers) -> Messages:
    """Return the messages whose heads begin at some places of a chunk."""
    return Messages(
        channel_ids=heads["channel"].astype(np.int64),
        log_ns=heads["log"].astype(np.int64),
        publish_ns=heads["publish"].astype(np.int64),
        starts=starts + MESSAGE.itemsize,
        sizes=(heads["length"] - _MESSAGE_FIELDS).astype(np.int64),
    )


def _loose_chunk(window: memoryview, place: int, found: Integers) -> Chunk:
    """Return messages that are in no chunk, of a window at a place of the file, as one."""
    ids = gather(window, found[:, 1] + HEADER_SIZE, np.dtype("<u2"))
    numbers, counts = np.unique(ids, return_counts=True)
    start = int(found[0, 1])
    return Chunk(
        place + start,
        place + _end_of(found),
        is_loose=True,
        counts=Counter(dict(zip(numbers.tolist(), counts.tolist(), strict=True))),
    )


def _wrongly_named(named: set[tuple[int, int]], there: set[tuple[int, int]]) -> set[int]:
    """Return the channels whose messages, each a channel and a place, are not those that the indexes name.

    Some recorders name one message more for a channel than they wrote; what else is named wrongly is damage.
    """
    wrong = {channel_id for channel_id, _ in there - named}
    extra = Counter(channel_id for channel_id, _ in named - there)
    for channel_id, count in extra.items():
        if count > 1:
            wrong.add(channel_id)
    return wrong
