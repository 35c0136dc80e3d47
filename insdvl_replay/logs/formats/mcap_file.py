"""An MCAP file: its channels, and their messages as blocks of bytes, never a Python object for each of them.

One walk over the records tells what the file holds: the indexes behind a chunk say which channels have messages in it,
so that others stay closed. In an open chunk the indexes say where messages are, and the records there must agree; the
summary at the end must agree with the whole. Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Mapping
from io import BytesIO
from itertools import pairwise
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from insdvl_replay.core.errors import Note, counted_clause, listed
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.formats.log_file import (
    COPY_AGAIN,
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
    UnusableFileError,
    damage_note,
    gather,
)

MAGIC: Final = b"\x89MCAP0\r\n"  # first and last bytes
HEADER_SIZE: Final = 9  # bytes in front of each record's content: its kind and its length
HEADER: Final = struct.Struct("<BQ")
# What a record of each kind must at least hold for its own fields; no record is of kind 0.
_LEAST: Final = (1 << 64, 8, 20, 14, 16, 22, 40, 6, 64, 36, 64, 46, 8, 20, 17, 4)
_LAST_KNOWN: Final = 15  # kind that the specification knows
_FIRST_PRIVATE: Final = 128
MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<i8"),
        ("publish", "<i8"),
    ]
)  # in front of each payload
_MESSAGE_FIELDS: Final = MESSAGE.itemsize - HEADER_SIZE
_ENTRY: Final = np.dtype([("log", "<i8"), ("start", "<i8")])  # of a message index
# bytes that the walk looks at at a time: among chunks, among messages
_WINDOW = 4 << 10
_LARGE_WINDOW = 1 << 20
_END_OF_TIME_NS: Final = 2**63  # times are signed in numpy as in ROS, and unsigned in the format
_CUT: Final = "the closing bytes are missing; the file was cut or is still being written"
_SUMMARY_ONLY: Final = (
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
_RECORDS: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.DATA_END: records.DataEnd,
}  # those that are read whole


def can_be_record(kind: int, length: int) -> bool:
    """Return whether a record of a kind can have a length."""
    if kind < len(_LEAST):
        return length >= _LEAST[kind]
    return kind >= _FIRST_PRIVATE


def walk(buffer: memoryview, room: int) -> tuple[NDArray[np.int64], int, int, bool]:
    """Find the records of a buffer, whose last one may go on behind it, up to `room` bytes.

    Return kind, start and length of the content of each, (k, 3), how many were of kinds that are not MCAP's own, where
    they end, and whether that is at bytes that are no record. A message before such bytes may have a false length, and
    is left out.
    """
    parts: list[NDArray[np.int64]] = []
    found: list[tuple[int, int, int]] = []
    place = 0
    others = 0
    before = (0, 0)
    patience = 0
    most = 64
    # The head of each message must be in the buffer.
    is_broken = False
    last = len(buffer) - (HEADER_SIZE if len(buffer) >= room else MESSAGE.itemsize)
    while place <= last:
        head = kind, length = HEADER.unpack_from(buffer, place)
        is_broken = length > room - place - HEADER_SIZE or not can_be_record(kind, length)
        if is_broken:
            break
        size = HEADER_SIZE + length
        count = 1
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
        before = head
        patience = max(patience - 1, 0)
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


def next_record(file: FileBytes, place: int, end: int) -> int:
    """Return the next place where a record can be with another one, or the end, right behind it."""

    def fits(head: memoryview, place: int) -> int:
        """Return where a record at a place ends, 0 if none can be there."""
        if len(head) < HEADER_SIZE:
            return 0
        kind, length = HEADER.unpack_from(head)
        is_known = kind <= _LAST_KNOWN and can_be_record(kind, length)
        fits = length <= end - place - HEADER_SIZE
        return place + HEADER_SIZE + int(length) if is_known and fits else 0

    for start in range(place, end, _LARGE_WINDOW):
        piece = file.read(start, min(start + _LARGE_WINDOW + HEADER_SIZE - 1, end))
        data = np.frombuffer(piece, np.uint8)
        count = max(len(data) - HEADER_SIZE + 1, 0)
        likely = (data[:count] > 0) & (data[:count] <= _LAST_KNOWN)
        for byte in (6, 7, 8):  # the highest of a length are zero
            likely &= data[byte : byte + count] == 0
        for at in np.flatnonzero(likely).tolist():
            behind = fits(piece[at : at + HEADER_SIZE], start + at)
            if behind and (behind == end or fits(file.read(behind, behind + HEADER_SIZE), behind)):
                return start + at
    return end


def log_channels(
    channels: Mapping[int, records.Channel],
    schemas: Mapping[int, records.Schema],
    counts: Mapping[int, int],
) -> tuple[LogChannel, ...]:
    """Return the channels of a file with their types and numbers of messages."""
    no_schema = records.Schema(id=0, name="", encoding="", data=b"")
    return tuple(
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
        for channel in channels.values()
        for schema in [schemas.get(channel.schema_id) or no_schema]
    )


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
        self._attachments: list[
            tuple[int, int, int]
        ] = []  # start and length without checksum, and this
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
        self.chunk_count, self.compression = len(compressed), tuple(sorted(set(compressed)))
        counts = self._counts()
        self.channels = log_channels(self._channels, self.schemas, counts)

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
                what = (
                    f"is not an MCAP file, nor a bag: it starts with bytes '{opening[:8].hex(' ')}'"
                )
                raise UnusableFileError(what, "give an .mcap, .db3 or .bag file", self.path)
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
            found, others, stop, is_broken = walk(window, end - place)
            self._private += others
            is_message = found[:, 0] == Opcode.MESSAGE
            edges = [0, *(np.flatnonzero(np.diff(is_message)) + 1).tolist(), len(found)]
            for first, behind in pairwise(edges if len(found) else ()):
                if is_message[first]:
                    ids = gather(window, found[first:behind, 1] + HEADER_SIZE, np.dtype("<u2"))
                    numbers, counts = (
                        values.tolist() for values in np.unique(ids, return_counts=True)
                    )
                    start = int(found[first, 1])
                    stops = int(found[behind - 1, 1:].sum()) + HEADER_SIZE
                    counted = Counter(dict(zip(numbers, counts, strict=True)))
                    self._chunks.append(
                        Chunk(place + start, place + stops, is_loose=True, counts=counted)
                    )
                    continue
                for kind, start, length in found[first:behind].tolist():
                    with self.collected():
                        self._take(kind, place + start, length, window[start + HEADER_SIZE :])
            size = _LARGE_WINDOW if is_message.any() else _WINDOW
            if not is_broken:
                place += stop
                continue
            what = what_is_there(window[stop:], end - place - stop)
            broken = place + stop
            place = place + (int(found[-1, 1:].sum()) + HEADER_SIZE if len(found) else 0)
            following = next_record(self.file, place + 1, end)
            if following == end and not self._is_closed:
                last = place
            else:
                self.damage(broken, what)
            if following < end or not self._take_cut_chunk(place, end):
                self._passed.append((place, following))
            place = following
        if not self._is_closed:
            self.damages = {Damage(last, _CUT): None, **self.damages}

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

    def _take(self, kind: int, start: int, length: int, content: memoryview) -> None:
        """File a record; of its content as much is given as is in the window."""
        begin = start + HEADER_SIZE
        end = start + HEADER_SIZE + length
        if kind == Opcode.CHUNK:
            self._chunks.append(self._chunk(start, end))
        elif kind == Opcode.MESSAGE_INDEX:
            chunk = self._chunks[-1] if self._chunks else Chunk(0, 0)
            if chunk.index_end != start or chunk.is_loose:
                raise DamageError(start, "an index does not follow a chunk")
            channel_id, size = struct.unpack_from("<HI", content)
            chunk.indexes.append((begin, end))
            if size > length - 6 or size % _ENTRY.itemsize or channel_id in chunk.counts:
                chunk.is_indexed = False
                raise DamageError(
                    start,
                    f"an index of {length} bytes says it has {size} bytes of channel {channel_id}",
                )
            chunk.counts[channel_id] = size // _ENTRY.itemsize
        elif kind == Opcode.ATTACHMENT:
            self._take_attachment(begin, length)
        elif kind in _SUMMARY_ONLY and Opcode.DATA_END not in self._only:
            raise DamageError(start, f"a record of kind {kind} is among the messages")
        elif kind in _RECORDS:
            self._take_record(
                kind,
                content[:length] if len(content) >= length else self.file.read(begin, end),
                start,
            )

    def _take_record(self, kind: int, content: memoryview, offset: int) -> None:
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
            raise DamageError(
                start, f"a chunk has {len(fields)} bytes, too few for its own header"
            ) from error
        data_start = start + HEADER_SIZE + 40 + name_size
        return Chunk(start, end, False, name, data_start, data_size, size, crc, (first_ns, last_ns))

    def _take_attachment(self, begin: int, length: int) -> None:
        """Read an attachment's fields; its bytes are not touched."""
        try:
            stream = ReadDataStream(
                BytesIO(self.file.read(begin, begin + min(length, _LARGE_WINDOW)))
            )
            log_ns = stream.read8()
            create_ns = stream.read8()
            name = stream.read_prefixed_string()
            media_type = stream.read_prefixed_string()
            size = stream.read8()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise DamageError(begin, f"an attachment of {length} bytes cannot be parsed") from error
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
        summary_start = self._only[Opcode.DATA_END][0] + HEADER_SIZE + 4
        is_right = True
        footer_start, footer = self._only.get(Opcode.FOOTER, (0, None))
        if footer is None:
            if self._is_closed:
                self.damage(end, "the footer before the closing bytes is missing")
        else:
            if footer.summary_start not in (0, summary_start):
                self.damage(
                    footer_start,
                    f"the footer says that the summary starts at byte {footer.summary_start}",
                )
            # The checksum covers the footer up to itself.
            covered = self.file.read(summary_start, footer_start + HEADER_SIZE + 16)
            if footer.summary_crc and zlib_ng.crc32(covered) != footer.summary_crc:
                self.damage(summary_start, "the checksum of the summary is wrong")
                is_right = False
                self._chunk_indexes = {}
        if is_right and (stated := self._record(Opcode.STATISTICS)) is not None:
            self._announced = Counter(stated.channel_message_counts)
            self._announced_ns = stated.message_start_time, stated.message_end_time
        starts = {chunk.start for chunk in [*self._chunks, *self._lost] if not chunk.is_loose}
        spans = {chunk.span_ns for chunk in [*self._chunks, *self._lost]}
        for start, index in self._chunk_indexes.items():
            if start not in starts:
                self.damage(start, "the summary has a chunk here, but there is none")
            if (index.message_start_time, index.message_end_time) not in spans:
                self._missing.append(start)
        for start in starts - self._chunk_indexes.keys() if self._chunk_indexes else ():
            self.damage(start, "there is a chunk here that is not in the summary")

    def _look_into_chunks(self) -> None:
        """Open the chunks of which it is not known what is in them, for definitions and counts."""
        for chunk in list(self._chunks):
            channels = [self._channels.get(channel_id) for channel_id in chunk.counts]
            is_defined = all(
                channel and (not channel.schema_id or channel.schema_id in self.schemas)
                for channel in channels
            )
            if not chunk.is_loose and not (chunk.indexes and chunk.is_indexed and is_defined):
                for content in self._contents([chunk]):
                    chunk.counts = content.counts()
        for channel_id, count in self._counts().items():
            if channel_id not in self._channels:
                clause = f"messages are of channel {channel_id}, which is not defined"
                self.damage(len(self.file), counted_clause(count, clause))

    # --- Chunks.

    def _find_messages(self, chunk: Chunk, buffer: memoryview, behind: memoryview) -> Messages:
        """Find the messages of an open chunk by its indexes, if the records agree with them, else record by record."""
        ids, log_ns, starts = self._entries(chunk, behind)
        order = np.argsort(starts, kind="stable")
        ids = ids[order]
        log_ns = log_ns[order]
        starts = starts[order]
        inside = (starts >= 0) & (starts <= len(buffer) - MESSAGE.itemsize)
        heads = (
            gather(buffer, np.where(inside, starts, 0), MESSAGE)
            if inside.any()
            else np.zeros(starts.size, MESSAGE)
        )
        ends = starts + HEADER_SIZE + heads["length"]
        follows = np.append(starts, len(buffer))[1:]
        right = (
            inside
            & (heads["opcode"] == Opcode.MESSAGE)
            & (heads["channel"] == ids)
            & (heads["log"] == log_ns)
        )
        right &= (heads["length"] >= _MESSAGE_FIELDS) & (ends <= follows)
        if chunk.indexes and right.all():
            gaps = [(0, int(starts[0]) if starts.size else len(buffer))]
            gaps += zip(
                ends[ends < follows].tolist(), follows[ends < follows].tolist(), strict=True
            )
            if not any(self._has_messages(chunk, buffer[start:end]) for start, end in gaps):
                return _messages(heads, starts)
        # Record by record, up to bytes that are none; behind them, those that the indexes know.
        found, _, stop, is_broken = walk(buffer, len(buffer))
        self._take_definitions(chunk, buffer, found)
        named = set(zip(ids.tolist(), starts.tolist(), strict=True))
        known = starts[right]
        starts = found[found[:, 0] == Opcode.MESSAGE, 1]
        if is_broken:
            what = what_is_there(buffer[stop:], len(buffer) - stop)
            if not len(found):
                raise DamageError(chunk.start, f"in the chunk no record is found: {what}")
            if not chunk.is_cut:
                self.damage(chunk.start, f"in the chunk, {stop} bytes on, {what}")
            starts = np.union1d(starts, known[known >= (starts[-1] if starts.size else 0)])
        content = Content(buffer, _messages(gather(buffer, starts, MESSAGE), starts))
        if chunk.indexes:
            # Some recorders name one message more for a channel than they wrote; what else is named wrongly is damage.
            there = set(zip(content.messages[0].tolist(), starts.tolist(), strict=True))
            extra = Counter(id_ for id_, _ in named - there)
            wrong = {id_ for id_, _ in there - named} | {
                id_ for id_, count in extra.items() if count > 1
            }
            if wrong:
                channels = listed(map(str, sorted(wrong)))
                self.damage(
                    chunk.start,
                    f"the indexes of a chunk do not agree with its messages of channel {channels}",
                )
            if wrong or is_broken:
                chunk.counts = content.counts()
                chunk.is_indexed = False
        return content.messages

    def _entries(self, chunk: Chunk, behind: memoryview) -> Messages:
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

    def _listed(self, chunk: Chunk) -> Messages | None:
        """Return channel and log time of the messages of a chunk, (3, k), as its indexes say."""
        if chunk.indexes and chunk.is_indexed:
            return self._entries(chunk, self.file.read(chunk.end, chunk.index_end))
        return None

    def _has_messages(self, chunk: Chunk, between: memoryview) -> bool:
        """Take the definitions between messages; return whether there are messages, or bytes that are no record."""
        found, _, _, is_broken = walk(between, len(between))
        self._take_definitions(chunk, between, found)
        return is_broken or bool(np.any(found[:, 0] == Opcode.MESSAGE))

    def _take_definitions(self, chunk: Chunk, buffer: memoryview, found: NDArray[np.int64]) -> None:
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
        for start, length, crc in self._attachments:
            found = 0
            for place in range(start, start + length, _LARGE_WINDOW):
                found = zlib_ng.crc32(
                    self.file.read(place, min(place + _LARGE_WINDOW, start + length)), found
                )
            if crc and found != crc:
                digest.damages.append(
                    Damage(start, "the checksum of an attachment is not that of its bytes")
                )
        return digest

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong so far."""
        notes = []
        missing = (
            self._record(Opcode.STATISTICS).message_count - self._counts().total()
            if self._announced_ns
            else 0
        )
        if self.damages:
            notes.append(damage_note(self.path.name, self.damages, self._losses()))
        elif missing:
            text = f"the summary of {self.path.name} announces {missing:+d} messages compared with the log"
            notes.append(Note("log_summary", text, abs(missing), Severity.WARNING, COPY_AGAIN))
        spans = (
            [self._announced_ns]
            if self._announced_ns
            else [chunk.span_ns for chunk in self._chunks]
        )
        last_ns = max((last for _, last in spans), default=0)
        if last_ns >= _END_OF_TIME_NS:
            text = (
                f"the log times of {self.path.name} go on to {last_ns} ns since 1970; from 2^63 ns on, which is in the "
                "year 2262, they are no times that can be shown or compared with stamps"
            )
            hint = "the recorder's clock was wrong; the stamps in the messages are used if there are any"
            notes.append(Note("log_times_late", text, 1, Severity.WARNING, hint))
        if self._private:
            text = f"{self._private} records are of kinds that are not MCAP's own"
            notes.append(Note("unknown_records", text, self._private))
        return tuple(notes)


def _messages(heads: NDArray[Any], starts: NDArray[np.int64]) -> Messages:
    """Return the messages whose heads begin at some places of a chunk."""
    columns = heads["channel"], heads["log"], heads["publish"], starts + MESSAGE.itemsize
    return np.stack([*columns, heads["length"] - _MESSAGE_FIELDS], dtype=np.int64)
