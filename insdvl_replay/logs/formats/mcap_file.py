"""An MCAP file: its channels, and their messages as blocks of bytes, never a Python object for each of them.

One walk over the records tells what the file holds: the indexes behind a chunk say which channels have messages in it,
so that others stay closed. In an open chunk the indexes say where messages are, and the records there must agree; the
summary at the end must agree with the whole. Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from io import BytesIO
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.errors import Note, listed
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.formats.log_file import (
    COPY_AGAIN,
    LARGEST_CHUNK,
    Block,
    Damage,
    DamageError,
    Digest,
    FileBytes,
    LogChannel,
    LogFile,
    UnusableFileError,
    damage_note,
    gather,
    most_opened,
    opened,
)
from insdvl_replay.logs.formats.records import (
    HEADER,
    HEADER_SIZE,
    MAGIC,
    MESSAGE,
    Chunk,
    ChunkHeader,
    can_be_record,
    next_record,
    opened_start,
    parsed,
    walk,
    what_is_there,
)

_ENTRY: Final = np.dtype([("log", "<i8"), ("start", "<i8")])  # of a message index
_MESSAGE_FIELDS: Final = MESSAGE.itemsize - HEADER_SIZE
_WINDOW, _LARGE_WINDOW = 4 << 10, 1 << 20  # bytes that the walk looks at at a time: among chunks, among messages
_AHEAD: Final = 3  # chunks that are opened while the one before is read
_MOST_OPEN: Final = 256 << 20  # bytes that they open to together, if they are more than one
_KEPT: Final = 16 << 20  # bytes of chunks that stay open, since samples of many topics are read from the same ones
_SAMPLED: Final = 2  # chunks with which a sample begins
_END_OF_TIME_NS: Final = 2**63  # times are signed in numpy as in ROS, and unsigned in the format
_LISTED: Final = 4  # topics that a note lists
_LONGEST_NS: Final = 10**15  # no recording covers more
_SUMMARY_ONLY: Final = (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
_DEFINITIONS: Final[dict[int, Any]] = {Opcode.SCHEMA: records.Schema, Opcode.CHANNEL: records.Channel}


class Content(NamedTuple):
    """The messages of an open chunk, in the order of the file."""

    buffer: memoryview
    starts: NDArray[np.int64]  # (k,) of their records
    heads: NDArray[Any]  # (k,) of MESSAGE

    def counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        ids, counts = np.unique(self.heads["channel"], return_counts=True)
        return Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))

    def blocks(self, channel_ids: Iterable[int]) -> Iterator[Block]:
        """Give the messages of some channels, channel by channel."""
        ids = self.heads["channel"].astype(np.int64)
        for channel_id in sorted(channel_ids):
            rows = np.flatnonzero(ids == channel_id)
            if rows.size:
                heads = self.heads[rows]
                yield Block(
                    channel_id,
                    self.buffer,
                    self.starts[rows] + MESSAGE.itemsize,
                    heads["length"] - _MESSAGE_FIELDS,
                    np.ascontiguousarray(heads["log"]),
                    np.ascontiguousarray(heads["publish"]),
                )


class McapFile(LogFile):
    """An MCAP file, open for reading."""

    def __init__(self, file: FileBytes) -> None:
        super().__init__(file)
        self.schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._chunks: list[Chunk] = []
        self.lost: list[Chunk] = []  # that cannot be opened
        self.passed: list[tuple[int, int]] = []  # start and end of bytes in which no record is found
        self.statistics: records.Statistics | None = None
        self.chunk_indexes: dict[int, records.ChunkIndex] = {}
        self._header: records.Header | None = None
        self._footer: tuple[int, records.Footer] | None = None  # where it is
        self._data_end: tuple[int, int] | None = None  # where it is, and the checksum of the bytes before
        self._private = 0
        self._kept: dict[int, Content] = {}
        self._opened: set[int] = set()
        self._attachments: list[tuple[int, int, int]] = []  # start and length without checksum, and this
        self.metadata: list[records.Metadata] = []
        self.attachments: list[records.AttachmentIndex] = []
        end = self._end()
        with self.watched():
            self._walk(end)
            self._limit_size()
            self._check_summary(end)
            self._look_into_chunks()
        header = self._header or records.Header("", "")
        self.profile, self.library = header.profile, header.library
        self.has_summary = self.statistics is not None or bool(self.chunk_indexes)
        headers = [chunk.header for chunk in self._chunks if chunk.header]
        self.chunk_count = len(headers)
        self.compression = tuple(sorted({header.compression or "none" for header in headers}))
        counts = self._counts()
        self.channels = tuple(
            LogChannel(
                id=channel.id,
                topic=channel.topic,
                type_name=schema.name if schema else "",
                encoding=channel.message_encoding,
                schema_encoding=schema.encoding if schema else "",
                messages=counts[channel.id],
                schema_data=schema.data if schema else b"",
                metadata=channel.metadata,
            )
            for channel in self._channels.values()
            for schema in [self.schemas.get(channel.schema_id)]
        )

    # --- What the file holds.

    def _end(self) -> int:
        """Return where the records end, and refuse a file that is no MCAP file."""
        size, magic = len(self.file), len(MAGIC)
        opening, closing = bytes(self.file.read(0, magic + HEADER_SIZE)), bytes(self.file.read(size - magic, size))
        if opening[:magic] != MAGIC:
            kind, length = HEADER.unpack(opening[magic:].ljust(HEADER_SIZE, b"\0"))
            # It may be that only its opening bytes are damaged.
            if closing != MAGIC and (kind != Opcode.HEADER or length > size or not can_be_record(kind, length)):
                what = f"is not an MCAP file, nor a bag: it starts with bytes '{opening[:8].hex(' ')}'"
                raise UnusableFileError(what, "name an .mcap, .db3 or .bag file", self.path)
            self._damage(0, f"the opening bytes are '{opening[:magic].hex(' ')}', not those of an MCAP file")
        if size < 2 * magic or closing != MAGIC:
            self._damage(size, "the file ends without the closing bytes; it was cut or is still being written")
            return size
        return size - magic

    def _damage(self, offset: int, found: str) -> None:
        self.damages.setdefault(Damage(offset, found))

    def _walk(self, end: int) -> None:
        """Go from the first record to the last one."""
        place, size = len(MAGIC), _WINDOW
        while place < end:
            window = self.file.read(place, min(place + size, end))
            found, others, stop, is_broken = walk(window, end - place)
            self._private += others
            is_message = found[:, 0] == Opcode.MESSAGE
            has_messages = bool(is_message.any())
            edges = [0, *(np.flatnonzero(np.diff(is_message)) + 1).tolist()] if has_messages else [0]
            for first, behind in pairwise([*edges, len(found)]):
                if has_messages and is_message[first:behind].any():
                    self._take_messages(window, place, found[first:behind])
                    continue
                for kind, start, length in found[first:behind].tolist():
                    with self.collected():
                        self._take(kind, place + start, length, window[start + HEADER_SIZE :])
            size = _LARGE_WINDOW if has_messages else _WINDOW
            if is_broken:
                self._damage(place + stop, what_is_there(window[stop:], end - place - stop))
                stop = int(found[-1, 1:].sum()) + HEADER_SIZE if len(found) else 0
                place = self._behind(place + stop, end)
            else:
                place += stop

    def _behind(self, place: int, end: int) -> int:
        """Go on behind bytes that are no record; a chunk without its end is the last thing that a recorder wrote."""
        following = next_record(self.file, place + 1, end)
        if following == end and self.file.read(place, place + 1) == bytes([Opcode.CHUNK]):
            with self.collected():
                header = self._chunk_header(place, end)
                if header.compression:
                    self._chunks.append(Chunk(place, end, header, is_cut=True))
                    return end
        self.passed.append((place, following))
        return following

    def _take_messages(self, window: memoryview, place: int, found: NDArray[np.int64]) -> None:
        ids, counts = np.unique(gather(window, found[:, 1] + HEADER_SIZE, np.dtype("<u2")), return_counts=True)
        counted = Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))
        end = place + int(found[-1, 1] + found[-1, 2]) + HEADER_SIZE
        self._chunks.append(Chunk(place + int(found[0, 1]), end, counts=counted))

    def _take(self, kind: int, start: int, length: int, content: memoryview) -> None:
        """File a record; of its content as much is given as is in the window."""
        begin, end = start + HEADER_SIZE, start + HEADER_SIZE + length
        if kind == Opcode.CHUNK:
            self._chunks.append(Chunk(start, end, self._chunk_header(start, end)))
        elif kind == Opcode.MESSAGE_INDEX:
            chunk = self._chunks[-1] if self._chunks else Chunk(0, 0)
            if chunk.index_end + HEADER_SIZE != begin or chunk.header is None:
                raise DamageError(start, "an index is behind no chunk")
            channel_id, size = struct.unpack_from("<HI", content)
            chunk.indexes.append((begin, length))
            if size > length - 6 or size % _ENTRY.itemsize or channel_id in chunk.counts:
                chunk.is_indexed = False
                raise DamageError(start, f"an index of {length} bytes says it has {size} bytes of channel {channel_id}")
            chunk.counts[channel_id] = size // _ENTRY.itemsize
        elif kind == Opcode.ATTACHMENT:
            self._take_attachment(begin, length)
        elif kind in _SUMMARY_ONLY and self._data_end is None:
            raise DamageError(start, f"a record of kind {kind} is among the messages")
        else:
            content = content[:length] if len(content) >= length else self.file.read(begin, end)
            if kind in _DEFINITIONS:
                self._take_definition(kind, content, start)
            elif kind == Opcode.HEADER:
                self._header = parsed(records.Header, content, start)
            elif kind == Opcode.METADATA:
                self.metadata.append(parsed(records.Metadata, content, start))
            elif kind == Opcode.DATA_END:
                self._data_end = (start, parsed(records.DataEnd, content, start).data_section_crc)
            elif kind == Opcode.STATISTICS:
                self.statistics = parsed(records.Statistics, content, start)
            elif kind == Opcode.CHUNK_INDEX:
                index = parsed(records.ChunkIndex, content, start)
                self.chunk_indexes[index.chunk_start_offset] = index
            elif kind == Opcode.FOOTER:
                self._footer = start, parsed(records.Footer, content, start)

    def _chunk_header(self, start: int, end: int) -> ChunkHeader:
        """Read the fields in front of a chunk's compressed bytes."""
        record = self.file.read(start + HEADER_SIZE, min(start + 128, end))
        try:
            first_ns, last_ns, size, crc, name_size = struct.unpack_from("<QQQII", record)
            name = bytes(record[32 : 32 + name_size]).decode("ascii", "replace")
            data_size = struct.unpack_from("<Q", record, 32 + name_size)[0]
        except struct.error as error:
            raise DamageError(start, f"a chunk has {len(record)} bytes, too few for its own header") from error
        return ChunkHeader(first_ns, last_ns, size, crc, name, start + HEADER_SIZE + 40 + name_size, data_size)

    def _take_definition(self, kind: int, content: memoryview, offset: int) -> None:
        """File a schema or a channel, which may be repeated in the summary and in chunks."""
        record = parsed(_DEFINITIONS[kind], content, offset)
        known: dict[int, Any] = self.schemas if kind == Opcode.SCHEMA else self._channels
        if known.setdefault(record.id, record) != record:
            what = f"{type(record).__name__.lower()} {record.id} is not the same in two places"
            raise DamageError(offset, what)

    def _take_attachment(self, begin: int, length: int) -> None:
        """Read an attachment's fields; its bytes are not touched."""
        try:
            stream = ReadDataStream(BytesIO(self.file.read(begin, begin + min(length, _LARGE_WINDOW))))
            log_ns, create_ns = stream.read8(), stream.read8()
            name, media_type, size = stream.read_prefixed_string(), stream.read_prefixed_string(), stream.read8()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise DamageError(begin, f"an attachment of {length} bytes cannot be parsed") from error
        if stream.count + size + 4 > length:
            raise DamageError(begin, f"an attachment says it has {size} bytes; its record has {length}")
        end = begin + stream.count + size
        found = records.AttachmentIndex(end - size, size, log_ns, create_ns, size, name, media_type)
        self.attachments.append(found)
        crc = int.from_bytes(self.file.read(end, end + 4), "little")
        self._attachments.append((begin, stream.count + size, crc))

    def _check_summary(self, end: int) -> None:
        """Hold the end of the file against what was found."""
        if self._header is None:
            self._damage(len(MAGIC), "no header begins the log")
        if self._data_end is None:
            if end < len(self.file):
                self._damage(end, "no record ends the messages")
            return
        summary_start = self._data_end[0] + HEADER_SIZE + 4
        if self._footer is None:
            self._damage(end, "no footer is in front of the closing bytes")
        else:
            footer_start, footer = self._footer
            if footer.summary_start not in (0, summary_start):
                self._damage(footer_start, f"the footer says that the summary starts at byte {footer.summary_start}")
            # The checksum covers the footer up to itself.
            covered = self.file.read(summary_start, footer_start + HEADER_SIZE + 16)
            if footer.summary_crc and zlib_ng.crc32(covered) != footer.summary_crc:
                self._damage(summary_start, "the checksum of the summary is not that of its bytes")
                self.statistics, self.chunk_indexes = None, {}
        starts = {chunk.start for chunk in self._chunks if chunk.header}
        for start in self.chunk_indexes.keys() - starts:
            self._damage(start, "the summary names a chunk where none is found")
        for start in starts - self.chunk_indexes.keys() if self.chunk_indexes else ():
            self._damage(start, "a chunk is here that the summary does not name")

    def _limit_size(self) -> None:
        """Leave out the chunks beyond what a file of this size may open to: a bomb would be read for hours."""
        most, total, kept = most_opened(len(self.file), LARGEST_CHUNK), 0, []
        for chunk in self._chunks:
            size = chunk.header.size if chunk.header else 0
            total += size if size <= most else 0  # a larger one is refused where it is opened
            if total > most:
                what = f"the chunks up to here open to {total} bytes, where a file of {len(self.file)} may hold {most}"
                self._damage(chunk.start, what)
                self.lost.append(chunk)
            else:
                kept.append(chunk)
        self._chunks = kept

    def _look_into_chunks(self) -> None:
        """Open the chunks of which it is not known what is in them, for definitions and counts."""
        for chunk in list(self._chunks):
            is_known = chunk.indexes and chunk.is_indexed and all(map(self._is_defined, chunk.counts))
            if chunk.header and not is_known:
                for content in self._contents([chunk]):
                    chunk.counts = content.counts()
        for channel_id, count in self._counts().items():
            if channel_id not in self._channels:
                what = f"{count} messages are of channel {channel_id}, which is nowhere defined"
                self._damage(len(self.file), what)

    def _is_defined(self, channel_id: int) -> bool:
        channel = self._channels.get(channel_id)
        return channel is not None and (channel.schema_id == 0 or channel.schema_id in self.schemas)

    def _counts(self) -> Counter[int]:
        """Count the messages of each channel."""
        return sum((chunk.counts for chunk in self._chunks), Counter[int]())

    # --- Chunks.

    def _contents(self, chunks: Collection[Chunk]) -> Iterator[Content]:
        """Open chunks, some ahead of who reads them; those that cannot be opened are lost."""
        sampled = {chunk.start for chunk in list(chunks)[:_SAMPLED]}
        ahead: deque[tuple[Chunk, Future[tuple[memoryview, memoryview]] | Content]] = deque()
        opener = ThreadPoolExecutor(1)
        try:
            for chunk in chunks:
                kept = self._kept.get(chunk.start)
                ahead.append((chunk, kept or opener.submit(self._open, chunk)))
                while len(ahead) > _AHEAD or (
                    len(ahead) > 1 and sum(one.header.size for one, _ in ahead if one.header) > _MOST_OPEN
                ):
                    yield from self._content(*ahead.popleft(), sampled)
            while ahead:
                yield from self._content(*ahead.popleft(), sampled)
        finally:
            # Who leaves may be the garbage collector, in the midst of the start of a thread: it must not wait for one.
            opener.shutdown(wait=False, cancel_futures=True)

    def _content(
        self, chunk: Chunk, found: Future[tuple[memoryview, memoryview]] | Content, sampled: Collection[int]
    ) -> Iterator[Content]:
        self._opened.add(chunk.start)
        if isinstance(found, Content):
            yield found
            return
        try:
            content = self._find_messages(chunk, *found.result())
        except DamageError as error:
            self.damages.setdefault(error.damage)
            self._chunks.remove(chunk)
            self.lost.append(chunk)
            return
        if chunk.start in sampled:
            self._kept[chunk.start] = content
            while sum(len(one.buffer) for one in self._kept.values()) > _KEPT:
                del self._kept[next(iter(self._kept))]
        yield content

    def _open(self, chunk: Chunk) -> tuple[memoryview, memoryview]:
        """Return the bytes of an open chunk, and those of the indexes behind it."""
        raw, header = self.file.read(chunk.start, chunk.index_end), chunk.header
        if header is None:
            return raw, raw[len(raw) :]
        data = raw[header.data_start - chunk.start : chunk.end - chunk.start]
        if chunk.is_cut:
            return opened_start(data, header.compression, header.size, chunk.start), raw[len(raw) :]
        if len(data) != header.data_size:
            what = f"a chunk says it has {header.data_size} compressed bytes; there are {len(data)}"
            raise DamageError(chunk.start, what)
        content = opened(data, header.compression, header.size, chunk.start, header.crc)
        return content, raw[chunk.end - chunk.start :]

    def _find_messages(self, chunk: Chunk, buffer: memoryview, behind: memoryview) -> Content:
        """Find the messages of an open chunk by its indexes, if the records agree with them, else record by record."""
        ids, entries = self._indexed(chunk, behind)
        order = np.argsort(entries["start"], kind="stable")
        starts, ids, log_ns = entries["start"][order], ids[order], entries["log"][order]
        inside = (starts >= 0) & (starts <= len(buffer) - MESSAGE.itemsize)
        heads = gather(buffer, np.where(inside, starts, 0), MESSAGE) if inside.any() else np.zeros(starts.size, MESSAGE)
        ends, follows = starts + HEADER_SIZE + heads["length"], np.append(starts, len(buffer))[1:]
        right = inside & (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == ids) & (heads["log"] == log_ns)
        right &= (heads["length"] >= _MESSAGE_FIELDS) & (ends <= follows)
        if chunk.indexes and right.all():
            gaps = [(0, int(starts[0]) if starts.size else len(buffer))]
            gaps += zip(ends[ends < follows].tolist(), follows[ends < follows].tolist(), strict=True)
            if all(self._take_between(chunk, buffer, *gap) for gap in gaps):
                return Content(buffer, starts, heads)
        return self._walked(chunk, buffer, starts[right], set(zip(ids.tolist(), starts.tolist(), strict=True)))

    def _indexed(self, chunk: Chunk, behind: memoryview) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Return what the indexes of a chunk say: the channel of each message, and its entry."""
        ids, parts = [0], [np.empty(0, _ENTRY)]
        for start, length in chunk.indexes:
            channel_id, size = struct.unpack_from("<HI", behind, start - chunk.end)
            parts.append(np.frombuffer(behind, _ENTRY, min(size, length - 6) // _ENTRY.itemsize, start - chunk.end + 6))
            ids.append(channel_id)
        return np.repeat(np.array(ids, np.int64), [part.size for part in parts]), np.concatenate(parts)

    def _take_between(self, chunk: Chunk, buffer: memoryview, start: int, end: int) -> bool:
        """Take the definitions between messages; return whether there is nothing else."""
        found, _, _, is_broken = walk(buffer[start:end], end - start)
        self._take_definitions(chunk, buffer[start:end], found)
        return not is_broken and not np.any(found[:, 0] == Opcode.MESSAGE)

    def _take_definitions(self, chunk: Chunk, buffer: memoryview, found: NDArray[np.int64]) -> None:
        for kind, start, length in found[found[:, 0] < Opcode.MESSAGE].tolist():
            if kind in _DEFINITIONS:
                content = buffer[start + HEADER_SIZE : start + HEADER_SIZE + length]
                with self.collected():
                    self._take_definition(kind, content, chunk.start)

    def _walked(
        self, chunk: Chunk, buffer: memoryview, right: NDArray[np.int64], named: set[tuple[int, int]]
    ) -> Content:
        """Find the messages of an open chunk record by record, up to bytes that are none, and those that indexes know.

        Some recorders name one message more for a channel than they wrote; what else they name wrongly is damage.
        """
        found, _, stop, is_broken = walk(buffer, len(buffer))
        self._take_definitions(chunk, buffer, found)
        starts = found[found[:, 0] == Opcode.MESSAGE, 1]
        if is_broken:
            what = what_is_there(buffer[stop:], len(buffer) - stop)
            if not len(found):
                raise DamageError(chunk.start, f"in the chunk no record is found: {what}")
            self._damage(chunk.start, f"in the chunk, {stop} bytes on, {what}")
            starts = np.union1d(starts, right[right >= (starts[-1] if starts.size else 0)])
        content = Content(buffer, starts, gather(buffer, starts, MESSAGE))
        if not chunk.indexes:
            return content
        there = set(zip(content.heads["channel"].tolist(), starts.tolist(), strict=True))
        extra = Counter(id_ for id_, _ in named - there)
        wrong = {id_ for id_, _ in there - named} | {id_ for id_, count in extra.items() if count > 1}
        if wrong:
            channels = listed(map(str, sorted(wrong)))
            self._damage(chunk.start, f"the indexes of a chunk do not name its messages of channel {channels}")
        if wrong or is_broken:
            chunk.counts, chunk.is_indexed = content.counts(), False
        return content

    # --- What a recording asks for.

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed."""
        for content in self._contents([one for one in self._chunks if not one.counts.keys().isdisjoint(channel_ids)]):
            yield from content.blocks(channel_ids)

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, (k,) ns; only chunks without an index are opened."""
        parts: dict[int, list[TimeNs]] = {channel.id: [np.empty(0, np.int64)] for channel in self.channels}
        for _, times in self.times_by_chunk():
            for channel_id, time_ns in times.items():
                parts.setdefault(channel_id, []).append(time_ns)
        return {channel_id: np.concatenate(times) for channel_id, times in parts.items()}

    def times_by_chunk(self) -> Iterator[tuple[Chunk, dict[int, TimeNs]]]:
        """Give each chunk with the log times of its messages by channel."""
        for chunk in list(self._chunks):
            if chunk.indexes and chunk.is_indexed:
                ids, entries = self._indexed(chunk, self.file.read(chunk.end, chunk.index_end))
                edges = np.flatnonzero(np.diff(ids)) + 1
                firsts = ids[np.concatenate([[0], edges])].tolist() if ids.size else []
                yield chunk, dict(zip(firsts, np.split(entries["log"], edges), strict=False))
            else:
                for content in self._contents([chunk]):
                    yield chunk, {block.channel_id: block.log_time for block in content.blocks(content.counts())}

    def saved_times(self) -> Iterator[TimeNs]:
        """Read all that can be read and give the log times, a block of messages at a time; ns."""
        for content in self._contents(list(self._chunks)):
            yield from (block.log_time for block in content.blocks(self._channels))

    def check_unopened(self) -> Iterator[None]:
        """Open the chunks that nobody has opened so far, one by one, for their checksums alone."""
        unopened = [one for one in self._chunks if one.header and one.header.crc and one.start not in self._opened]
        for _ in self._contents(unopened):
            yield

    def digest(self) -> Digest:
        """Go over all bytes of the file, and check the checksums of all messages and of attachments."""
        digest = self.file.digest(*(self._data_end or (0, 0)))
        for start, length, crc in self._attachments:
            found = 0
            for place in range(start, start + length, _LARGE_WINDOW):
                found = zlib_ng.crc32(self.file.read(place, min(place + _LARGE_WINDOW, start + length)), found)
            if crc and found != crc:
                digest.damages.append(Damage(start, "the checksum of an attachment is not that of its bytes"))
        return digest

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong so far."""
        notes = []
        missing = self.statistics.message_count - self._counts().total() if self.statistics else 0
        if self.damages:
            notes.append(damage_note(self.path.name, self.damages, self._losses()))
        elif missing:
            text = f"the summary of {self.path.name} announces {missing:+d} messages against what the log holds"
            notes.append(Note("log_summary", text, abs(missing), Severity.WARNING, COPY_AGAIN))
        headers = (chunk.header.last_ns for chunk in self._chunks if chunk.header)
        last_ns = self.statistics.message_end_time if self.statistics else max(headers, default=0)
        if last_ns >= _END_OF_TIME_NS:
            text = (
                f"the log times of {self.path.name} go on to {last_ns} ns since 1970; from 2^63 ns on, which is in the "
                "year 2262, they are no times that can be shown or compared with stamps"
            )
            hint = "the messages' own stamps are used where they have any; the recorder's clock was wrong"
            notes.append(Note("log_times_late", text, 1, Severity.WARNING, hint))
        if self._private:
            text = f"{self._private} records are of kinds that are not MCAP's own"
            notes.append(Note("unknown_records", text, self._private))
        return tuple(notes)

    def _losses(self) -> str:
        """State how many messages of each topic are lost, for how long it has none, and how many bytes are damaged."""
        topics = {channel.id: channel.topic for channel in self.channels}
        stated, bad = self.statistics, {(chunk.start, chunk.end) for chunk in self.lost} | set(self.passed)
        headers = [chunk.header for chunk in [*self._chunks, *self.lost] if chunk.header]
        spans = {(header.first_ns, header.last_ns) for header in headers}
        missing = [
            start
            for start, index in self.chunk_indexes.items()
            if (index.message_start_time, index.message_end_time) not in spans
        ]
        holes = sorted([start for start, _ in bad] + missing)
        last_ns = max((last for first, last in spans if 0 < first <= last < first + _LONGEST_NS), default=0)
        if stated:
            last_ns = stated.message_end_time
        # A topic is interrupted from its last message before damaged bytes to its first one behind them.
        found, latest_ns, gap_ns = Counter[str](), dict[str, int](), Counter[str]()
        interrupted: set[str] = set()
        for chunk, times in self.times_by_chunk():
            if holes and holes[0] <= chunk.start:
                interrupted = set(topics.values())
                holes = [hole for hole in holes if hole > chunk.start]
            by_topic: dict[str, list[TimeNs]] = {}
            for channel_id in times.keys() & topics:
                by_topic.setdefault(topics[channel_id], []).append(times[channel_id])
            for topic, parts in by_topic.items():
                time_ns = np.concatenate(parts)
                found[topic] += time_ns.size
                if topic in interrupted and time_ns.size:
                    since_ns = latest_ns.get(topic, stated.message_start_time if stated else int(time_ns.min()))
                    gap_ns[topic] += max(int(time_ns.min()) - since_ns, 0)
                    interrupted.discard(topic)
                latest_ns[topic] = max(latest_ns.get(topic, 0), int(time_ns.max(initial=0)))
        for topic in latest_ns if holes or self._data_end is None else interrupted & latest_ns.keys():
            gap_ns[topic] += max(last_ns - latest_ns[topic], 0)
        announced = Counter[str]()
        counts = stated.channel_message_counts if stated else sum((chunk.counts for chunk in self.lost), Counter[int]())
        for channel_id, count in counts.items():
            announced[topics.get(channel_id, "unknown channels")] += count
        lost = (announced - found if stated else announced).most_common()
        least = "" if stated else "at least "
        told = [f"{least}{count} messages of {topic} ({gap_ns[topic] * 1e-9:.3f} s)" for topic, count in lost]
        size = sum(end - start for start, end in bad)
        is_open = self._data_end is None and stated is None
        if not told and (stated or not (size or is_open)):
            told = ["no messages"]
        longest_s = max(gap_ns.values(), default=0) * 1e-9
        what = listed(told, _LISTED) or f"an unknown number of messages (at least {longest_s:.3f} s)"
        damaged = f", {size} bytes are damaged" if size else ""
        return f"{what} are lost{damaged}{'; nothing tells how long the recording went on' if is_open else ''}"
