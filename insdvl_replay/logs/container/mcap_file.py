"""An MCAP file: which channels it has, and their messages as blocks of bytes, never a Python object for each of them.

A file that is not what the format says is refused with the place and what could be saved, or, if that is allowed, read
as far as its bytes can be believed.
Source: the MCAP specification, https://mcap.dev/spec.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from mcap import records

from insdvl_replay.core.columns import TimeNs
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.words import Severity
from insdvl_replay.logs.container.attachments import (
    Attachment,
    Digest,
    attachment_at,
    attachment_damages,
    checked_digest,
)
from insdvl_replay.logs.container.blocks import Block, described
from insdvl_replay.logs.container.chunk_messages import index_entries
from insdvl_replay.logs.container.chunk_reader import ChunkReader
from insdvl_replay.logs.container.chunks import Chunk, ChunkHeader, chunk_header
from insdvl_replay.logs.container.damage import COPY_AGAIN, Span, damaged_file_error
from insdvl_replay.logs.container.loss import chunk_span, damage_note
from insdvl_replay.logs.container.mapped_file import mapped
from insdvl_replay.logs.container.mcap_index import build_index
from insdvl_replay.logs.container.records import parsed

_END_OF_TIME_NS: Final = 2**63
"""Times are signed in numpy as in ROS, and unsigned in the format."""


class Log:
    """An MCAP file, open for reading.

    Parameters
    ----------
    allow_damaged : bool
        Read what can be believed of a damaged file.

    Raises
    ------
    LogError
        The file cannot be opened, is no MCAP file, or is damaged.
    """

    def __init__(self, path: Path, *, allow_damaged: bool = False) -> None:
        self.path = path
        self.allow_damaged = allow_damaged
        self._file = mapped(path)
        self._data = self._file.data
        with self._file.watched():
            self._index = build_index(self._data, self._file.release)
        self._file.release(0, len(self._data))
        self._reader = ChunkReader(self._file, self._index)
        self._raise_if_damaged()
        self.channels = tuple(
            described(channel, self._index.schemas.get(channel.schema_id), self._index.counts[channel.id])
            for channel in self._index.channels.values()
        )

    @property
    def profile(self) -> str:
        """What the recorder promises to follow, ``ros2`` for ROS 2."""
        return self._index.header.profile if self._index.header else ""

    @property
    def library(self) -> str:
        """What wrote the log."""
        return self._index.header.library if self._index.header else ""

    @property
    def has_summary(self) -> bool:
        """Whether the log closes with a summary that can be believed."""
        return self._index.summary.statistics is not None or bool(self._index.summary.chunks)

    @property
    def chunk_count(self) -> int:
        """How many chunks there are."""
        return len(self._chunk_headers())

    @property
    def compression(self) -> tuple[str, ...]:
        """The ways in which chunks are compressed, ``none`` for those that are not."""
        return tuple(sorted({header.compression or "none" for header in self._chunk_headers()}))

    @property
    def parts(self) -> tuple["Log", ...]:
        """The files of which the log consists: itself."""
        return (self,)

    @property
    def span_ns(self) -> Span | None:
        """First and last log time; None without messages."""
        spans = [span for chunk in self._index.chunks.values() if (span := chunk_span(self._data, chunk))]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def size_bytes(self) -> int:
        """How large the file is."""
        return len(self._data)

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

    def digests(self) -> list[Digest]:
        """Go over all bytes of the file. It changes nothing here, so that another thread can do it meanwhile."""
        section_end, section_crc = self._index.data_end or (0, 0)
        sha256, damages = checked_digest(self._file.reopened(), section_end, section_crc)
        return [Digest(sha256, damages + attachment_damages(self._data, self._index.attachments))]

    def sha256(self, digests: Sequence[Digest] | None = None) -> str:
        """Return the digest of the file's bytes, and note wrong checksums that only a whole pass can check."""
        (digest,) = digests or self.digests()
        for damage in digest.damages:
            self._index.add_damage(damage)
        self._raise_if_damaged()
        return digest.sha256

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuse the log if it has changed by the end since it was opened, above all if that made something fail."""
        with self._file.watched():
            yield

    def blocks(self, channel_ids: Collection[int]) -> Iterator[Block]:
        """Go through the messages of some channels, a chunk at a time; chunks without them stay closed."""
        wanted = [chunk for chunk in self._index.chunks.values() if not chunk.counts.keys().isdisjoint(channel_ids)]
        for content in self._reader.contents(wanted):
            self._raise_if_damaged()
            yield from content.of(channel_ids)
        self._raise_if_damaged()

    def check_unopened(self) -> None:
        """Open the chunks that nobody has opened so far, for their checksums alone."""
        unopened = [chunk for chunk in self._index.chunks.values() if chunk.offset not in self._reader.opened]
        for _ in self._reader.contents([chunk for chunk in unopened if self._has_checksum(chunk)]):
            self._raise_if_damaged()
        self._raise_if_damaged()

    def _has_checksum(self, chunk: Chunk) -> bool:
        return chunk.kind == "intact" and chunk_header(self._data, chunk.offset, chunk.length).crc != 0

    def log_times(self) -> dict[int, TimeNs]:
        """Return the log times of all messages from the indexes; only chunks without one are opened.

        Returns
        -------
        dict of int to ndarray, shape (k,)
            By channel, in the order of the file; ns.
        """
        parts: dict[int, list[TimeNs]] = {channel.id: [np.empty(0, np.int64)] for channel in self.channels}
        for chunk in self._index.chunks.values():
            for place in chunk.indexes:
                channel_id, entries = index_entries(self._data, *place)
                parts.setdefault(channel_id, []).append(entries["log_time"])
        for content in self._reader.contents([chunk for chunk in self._index.chunks.values() if not chunk.indexes]):
            for block in content.of(parts):
                parts[block.channel_id].append(block.log_time)
        self._raise_if_damaged()
        return {channel_id: np.concatenate(times) for channel_id, times in parts.items()}

    def faults(self) -> list[LogError]:
        """Return an error for each damaged place found so far."""
        return [LogError(f"is damaged at byte {one.offset}: {one.found}", "", self.path) for one in self._index.damages]

    def saved_times(self) -> Iterator[TimeNs]:
        """Read all that can be read and give the log times, a block of messages at a time; ns."""
        ids = self._index.channels.keys()
        for content in self._reader.contents(list(self._index.chunks.values())):
            yield from (block.log_time for block in content.of(ids))

    def damage_error(self) -> LogError | None:
        """Return the error with which the file would be refused, by the damage found so far."""
        faults = self.faults()
        return damaged_file_error(faults, self.saved_times()) if faults else None

    def _raise_if_damaged(self) -> None:
        if not self.allow_damaged and (error := self.damage_error()) is not None:
            self._file.require_unchanged()
            raise error
