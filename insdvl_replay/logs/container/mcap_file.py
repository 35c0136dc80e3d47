"""An MCAP file: which channels it has, and their messages as blocks of bytes, never a Python object for each of them.

A file that is not what the format says is read as far as its bytes can be believed, with the places of its damage.
Source: the MCAP specification, https://mcap.dev/spec.
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np
from mcap import records

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.core.errors import Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.blocks import Block, Content, content_of, index_entries
from insdvl_replay.logs.container.chunks import Chunk, ChunkHeader, chunk_header, open_chunk, opened_size
from insdvl_replay.logs.container.log_file import LogFile
from insdvl_replay.logs.container.loss import COPY_AGAIN, chunk_span, damage_note
from insdvl_replay.logs.container.mapped_file import Digest, MappedFile, require_mcap
from insdvl_replay.logs.container.mcap_index import McapIndex
from insdvl_replay.logs.container.records import (
    Attachment,
    DamageError,
    Span,
    attachment_at,
    attachment_damages,
    described,
    parsed,
)
from insdvl_replay.logs.container.scanner import build_index

_AHEAD: Final = 3
"""Chunks that are opened while the one before is read."""
_MOST_OPEN: Final = 256 << 20
"""Bytes that they open to together, if they are more than one."""
_KEPT: Final = 16 << 20
"""Bytes of chunks that stay open, since samples of many topics are read from the same ones."""
_SAMPLED: Final = 2
"""Chunks with which a sample begins; were more kept, a long reading would not use the same memory again and again."""


class _ChunkReader:
    """Reads the chunks of a file, and tells its index which cannot be opened, and what is wrong inside others."""

    def __init__(self, file: MappedFile, index: McapIndex) -> None:
        self._file = file
        self._index = index
        self._kept: dict[int, Content] = {}
        self.opened: set[int] = set()

    def contents(self, chunks: Sequence[Chunk]) -> Iterator[Content]:
        """Go through chunks; those that cannot be opened are dropped."""
        first = {chunk.offset for chunk in chunks[:_SAMPLED]}
        ahead: deque[tuple[Chunk, Future[memoryview] | Content]] = deque()
        sizes: deque[int] = deque()
        opener = ThreadPoolExecutor(1)
        try:
            for chunk in chunks:
                sizes.append(opened_size(self._file.data, chunk))
                while ahead and (len(ahead) > _AHEAD or sum(sizes) > _MOST_OPEN):
                    yield from self._content(*ahead.popleft(), first)
                    sizes.popleft()
                kept = self._kept.get(chunk.offset)
                ahead.append((chunk, kept or opener.submit(open_chunk, self._file.data, chunk)))
            while ahead:
                yield from self._content(*ahead.popleft(), first)
        finally:
            # Who leaves may be the garbage collector, in the midst of the start of a thread: it must not wait for one.
            opener.shutdown(wait=False, cancel_futures=True)

    def _content(
        self, chunk: Chunk, opened: Future[memoryview] | Content, sampled: Collection[int]
    ) -> Iterator[Content]:
        self.opened.add(chunk.offset)
        if isinstance(opened, Content):
            yield opened
            return
        try:
            content = content_of(self._file.data, chunk, opened.result())
        except DamageError as error:
            self._index.drop_chunk(chunk, error.damage)
            return
        if content.damages:
            self._index.trust(chunk, content)
        if chunk.offset in sampled:
            self._keep(chunk, content)
        yield content
        end = max(start + length for start, length in [(chunk.offset, chunk.length), *chunk.indexes])
        self._file.release(chunk.offset, end)

    def _keep(self, chunk: Chunk, content: Content) -> None:
        """Keep a chunk open, and close those that were kept before it for want of room."""
        self._kept[chunk.offset] = content
        while sum(len(one.buffer) for one in self._kept.values()) > _KEPT:
            del self._kept[next(iter(self._kept))]


_END_OF_TIME_NS: Final = 2**63
"""Times are signed in numpy as in ROS, and unsigned in the format."""


class McapFile(LogFile):
    """An MCAP file, open for reading. Damage is collected; whether it is allowed is for the recording to say.

    Raises
    ------
    UnusableFileError
        It is no MCAP file.
    """

    def __init__(self, file: MappedFile) -> None:
        super().__init__(file)
        require_mcap(file)
        with self._file.watched():
            self._index = build_index(self._data, self._file.release)
        self._file.release(0, len(self._data))
        self.damages = self._index.damages
        self._reader = _ChunkReader(self._file, self._index)
        self.channels = tuple(
            described(channel, self._index.schemas.get(channel.schema_id), self._index.counts[channel.id])
            for channel in self._index.channels.values()
        )

    @property
    def profile(self) -> str:  # type: ignore[override]
        """What the recorder promises to follow, ``ros2`` for ROS 2."""
        return self._index.header.profile if self._index.header else ""

    @property
    def library(self) -> str:  # type: ignore[override]
        """What wrote the log."""
        return self._index.header.library if self._index.header else ""

    @property
    def has_summary(self) -> bool:  # type: ignore[override]
        """Whether the log closes with a summary that can be believed."""
        return self._index.summary.statistics is not None or bool(self._index.summary.chunks)

    @property
    def chunk_count(self) -> int:  # type: ignore[override]
        """How many chunks there are."""
        return len(self._chunk_headers())

    @property
    def compression(self) -> tuple[str, ...]:  # type: ignore[override]
        """The ways in which chunks are compressed, ``none`` for those that are not."""
        return tuple(sorted({header.compression or "none" for header in self._chunk_headers()}))

    @property
    def span_ns(self) -> Span | None:
        """First and last log time; None without messages."""
        spans = [span for chunk in self._index.chunks.values() if (span := chunk_span(self._data, chunk))]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def schemas(self) -> Mapping[int, records.Schema]:
        """The schemas by their numbers."""
        return self._index.schemas

    @property
    def metadata(self) -> Iterator[records.Metadata]:
        """The metadata records in the order of the file."""
        return (parsed(records.Metadata, self._data, *place) for place in self._index.metadata)

    @property
    def attachments(self) -> Iterator[Attachment]:
        """The attachments in the order of the file; their bytes are read on demand."""
        return (attachment_at(self._data, *place) for place in self._index.attachments)

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was found wrong or was passed over so far."""
        notes = []
        if self._index.damages:
            notes.append(damage_note(self.path.name, self._data, self._index))
        elif missing := self._index.missing:
            text = f"the summary of {self.path.name} announces {missing:+d} messages against what the log holds"
            hint = COPY_AGAIN
            notes.append(Note("log_summary", text, abs(missing), Severity.WARNING, hint))
        if (last_ns := self._last_ns()) >= _END_OF_TIME_NS:
            text = (
                f"the log times of {self.path.name} go on to {last_ns} ns since 1970; from 2^63 ns on, which is in the "
                "year 2262, they are no times that can be shown or compared with stamps"
            )
            hint = "the messages' own stamps are used where they have any; the recorder's clock was wrong"
            notes.append(Note("log_times_late", text, 1, Severity.WARNING, hint))
        if private := self._index.private:
            notes.append(Note("unknown_records", f"{private} records are of kinds that are not MCAP's own", private))
        return tuple(notes)

    def _last_ns(self) -> int:
        """Return the last log time as the statistics or else the chunks say, which count from 0 to 2^64."""
        if (stated := self._index.announced.statistics) is not None:
            return int(stated.message_end_time)
        return max((header.last_ns for header in self._chunk_headers()), default=0)

    def _chunk_headers(self) -> list[ChunkHeader]:
        chunks = (chunk for chunk in self._index.chunks.values() if chunk.kind != "unchunked")
        return [chunk_header(self._data, chunk.offset, chunk.length) for chunk in chunks]

    def digest(self) -> Digest:
        """Go over all bytes of the file. It changes nothing here, so that another thread can do it meanwhile."""
        section_end, section_crc = self._index.data_end or (0, 0)
        sha256, damages = self._file.digest(section_end, section_crc)
        return Digest(sha256, damages + attachment_damages(self._data, self._index.attachments))

    def add_damages(self, digest: Digest) -> None:
        """Note wrong checksums that only a whole pass can check."""
        for damage in digest.damages:
            self._index.add_damage(damage)

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed."""
        wanted = [chunk for chunk in self._index.chunks.values() if not chunk.counts.keys().isdisjoint(channel_ids)]
        for content in self._reader.contents(wanted):
            yield from content.of(channel_ids)

    def check_unopened(self) -> Iterator[None]:
        """Open the chunks that nobody has opened so far, one by one, for their checksums alone."""
        unopened = [chunk for chunk in self._index.chunks.values() if chunk.offset not in self._reader.opened]
        for _ in self._reader.contents([chunk for chunk in unopened if self._has_checksum(chunk)]):
            yield

    def _has_checksum(self, chunk: Chunk) -> bool:
        return chunk.kind == "intact" and chunk_header(self._data, chunk.offset, chunk.length).crc != 0

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages by channel, ns; only chunks without an index are opened."""
        parts: dict[int, list[TimeNs]] = {channel.id: [np.empty(0, np.int64)] for channel in self.channels}
        for chunk in self._index.chunks.values():
            for place in chunk.indexes:
                channel_id, entries = index_entries(self._data, *place)
                parts.setdefault(channel_id, []).append(entries["log_time"])
        for content in self._reader.contents([chunk for chunk in self._index.chunks.values() if not chunk.indexes]):
            for block in content.of(parts):
                parts[block.channel_id].append(block.log_time)
        return {channel_id: np.concatenate(times) for channel_id, times in parts.items()}

    def saved_times(self) -> Iterator[TimeNs]:
        """Read all that can be read and give the log times, a block of messages at a time; ns."""
        ids = self._index.channels.keys()
        for content in self._reader.contents(list(self._index.chunks.values())):
            yield from (block.log_time for block in content.of(ids))
