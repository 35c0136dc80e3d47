"""One walk over the records of a file: what it holds and where, and where it is damaged.

After bytes that are no record the walk goes on at the next chunk that the summary names, or where the next records can
be made out.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.opcode import Opcode

from insdvl_replay.logs.container.attachments import attachment_at
from insdvl_replay.logs.container.blocks import message_field
from insdvl_replay.logs.container.chunk_messages import Content
from insdvl_replay.logs.container.chunks import COMPRESSED, Chunk, chunk_header
from insdvl_replay.logs.container.damage import Damage, DamageError, Loss
from insdvl_replay.logs.container.record_form import RECORD_HEADER_SIZE
from insdvl_replay.logs.container.records import (
    MAGIC,
    Records,
    find_records,
    go_on,
    is_broken,
    next_record,
    parsed,
    what_stands,
)
from insdvl_replay.logs.container.summary import Summary

_SUMMARY_ONLY: Final = (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)


@dataclass
class McapIndex:
    """What a file holds.

    Attributes
    ----------
    header : Header or None
        Profile and library of the recorder.
    chunks : dict of int to Chunk
        By their places; also the messages that stand in none.
    schemas, channels : dict of int
        By id.
    attachments, metadata : list of (int, int)
        Start and size of these records.
    data_end : (int, int) or None
        Where the data section ends, and the checksum of the bytes before.
    private : int
        Records of kinds that the format leaves to others.
    damages : dict of Damage to None
        Each once, in the order in which they are found.
    lost : list of Chunk
        Those that cannot be opened.
    passed : list of (int, int)
        Start and end of bytes in which no record was found.
    losses : dict of int to Loss
        Of messages inside chunks that can be opened, by the place of the chunk.
    displaced : Summary or None
        What stands behind the messages where the end of the file tells no summary.
    """

    summary: Summary
    header: records.Header | None = None
    chunks: dict[int, Chunk] = field(default_factory=dict)
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    metadata: list[tuple[int, int]] = field(default_factory=list)
    data_end: tuple[int, int] | None = None
    private: int = 0
    damages: dict[Damage, None] = field(default_factory=dict)
    lost: list[Chunk] = field(default_factory=list)
    passed: list[tuple[int, int]] = field(default_factory=list)
    losses: dict[int, Loss] = field(default_factory=dict)
    displaced: Summary | None = None

    @property
    def counts(self) -> Counter[int]:
        """Messages by channel."""
        total = Counter[int]()
        for chunk in self.chunks.values():
            total.update(chunk.counts)
        return total

    @property
    def announced(self) -> Summary:
        """What the recorder said of the whole, wherever it stands."""
        return self.displaced or self.summary

    @property
    def is_cut(self) -> bool:
        """Whether the end is gone with all that is said there of the whole."""
        return self.data_end is None and self.announced.message_count is None

    @property
    def missing(self) -> int | None:
        """How many of the announced messages are not found, where a number is announced."""
        announced = self.announced.message_count
        found = sum(count for channel_id, count in self.counts.items() if channel_id in self.channels)
        return None if announced is None else announced - found

    def add_damage(self, damage: Damage) -> None:
        """Note a damaged place, once."""
        self.damages.setdefault(damage)

    def add_chunk(self, chunk: Chunk) -> None:
        """File a chunk."""
        self.chunks[chunk.offset] = chunk

    def trust(self, chunk: Chunk, content: Content) -> None:
        """Believe the content of a chunk more than its index."""
        named = chunk.counts.total() if chunk.indexes else None
        chunk.counts = content.counts()
        for damage in content.damages:
            self.add_damage(damage)
        if content.lost_span_ns:
            missing = None if named is None else max(named - chunk.counts.total(), 0)
            self.losses.setdefault(chunk.offset, Loss(missing, content.lost_span_ns))
        if content.damages:
            chunk.indexes.clear()

    def drop_chunk(self, chunk: Chunk, damage: DamageError) -> None:
        """Note a chunk that cannot be read, and do without it."""
        self.add_damage(Damage(damage.offset, damage.found))
        del self.chunks[chunk.offset]
        self.lost.append(chunk)


class RecordScanner:
    """The way through the data section."""

    def __init__(self, data: memoryview, mcap_index: McapIndex, release: Callable[[int, int], None]) -> None:
        self.data = data
        self.release = release
        self.index = mcap_index
        self.known_chunks = sorted(mcap_index.summary.chunks)
        self.latest = 0
        self.latest_chunk = Chunk(0, 0)

    def run(self) -> None:
        """Go from the first record to the end of the data section."""
        mcap_index, place = self.index, len(MAGIC)
        end = (
            mcap_index.summary.start
            if mcap_index.summary.checked and mcap_index.summary.start
            else mcap_index.summary.end
        )
        while place < end and mcap_index.data_end is None:
            batch, stop = find_records(self.data, place, end)
            if is_broken(batch, stop, end):
                mcap_index.add_damage(Damage(stop, what_stands(self.data, stop, end)))
                batch, stop = self.behind(batch, stop, end)
            self.take(batch)
            self.release(place, stop)
            place = stop
        if mcap_index.header is None:
            mcap_index.add_damage(Damage(len(MAGIC), "no header begins the log"))
        if mcap_index.data_end is None and mcap_index.summary.start is not None:
            mcap_index.add_damage(Damage(place, "no record ends the messages"))
        elif mcap_index.summary.start not in (None, place):
            mcap_index.add_damage(
                Damage(place, f"the footer says that the summary starts at byte {mcap_index.summary.start}")
            )

    def behind(self, batch: Records, stop: int, end: int) -> tuple[Records, int]:
        """Go on behind bytes that are no record."""
        if len(batch) and batch.opcodes[-1] == Opcode.CHUNK:
            chunk = self.chunk_at(int(batch.starts[-1]), end)
            if chunk and chunk.offset + chunk.length != stop:
                return self.with_chunk(batch.where(slice(-1)), chunk)
        if chunk := self.chunk_at(stop, end):
            return self.with_chunk(batch, chunk)
        next_known = next((known for known in self.known_chunks if known > stop), end)
        kept, resumed = go_on(self.data, batch, stop, next_known)
        passed_from = stop if len(kept) == len(batch) else int(batch.starts[-1])
        self.index.passed.append((passed_from, resumed))
        return kept, resumed

    def with_chunk(self, batch: Records, chunk: Chunk) -> tuple[Records, int]:
        """File a chunk behind the records of a batch, and go on behind it."""
        self.take(batch)
        self._add(chunk)
        self.latest = Opcode.CHUNK
        return batch.where(slice(0)), chunk.offset + chunk.length

    def chunk_at(self, place: int, end: int) -> Chunk | None:
        """Find a chunk whose record has a wrong kind or length, but whose own fields tell where it ends."""
        start = place + RECORD_HEADER_SIZE
        if self.data[place] != Opcode.CHUNK and place not in self.index.summary.chunks:
            return None
        try:
            header = chunk_header(self.data, start, max(end - start, 0))
        except DamageError:
            return None
        stop = header.compressed_start + header.compressed_size
        if stop <= end and len(find_records(self.data, stop, end)[0]):
            return Chunk(start, stop - start)
        is_last = next_record(self.data, start, end) == end
        return Chunk(start, end - start, "truncated") if header.compression in COMPRESSED and is_last else None

    def take(self, batch: Records) -> None:
        """File the records of a batch; messages in a row make one run."""
        loose = batch.opcodes == Opcode.MESSAGE
        edges = np.flatnonzero(np.diff(loose)) + 1
        for rows in np.split(np.arange(len(batch)), edges):
            if rows.size and loose[rows[0]]:
                self._run_of_messages(batch, rows)
            elif rows.size:
                self._others(batch.where(rows))

    def _run_of_messages(self, batch: Records, rows: Any) -> None:
        start = int(batch.starts[rows[0]])
        stop = int(batch.starts[rows[-1]] + batch.lengths[rows[-1]]) + RECORD_HEADER_SIZE
        ids, counts = np.unique(message_field(self.data, batch.starts[rows], "channel_id"), return_counts=True)
        counted = Counter(dict(zip(ids.tolist(), counts.tolist(), strict=True)))
        self.index.add_chunk(Chunk(start, stop - start, "unchunked", counts=counted))
        self.latest = Opcode.MESSAGE

    def _others(self, batch: Records) -> None:
        for opcode, start, length in batch.rows():
            try:
                self._file(opcode, start, length)
                self.latest = opcode
            except DamageError as damage:
                self.index.add_damage(Damage(damage.offset, damage.found))
                # What follows, such as further indexes, belongs to nothing that was filed before.
                self.latest = 0

    def _file(self, opcode: int, start: int, length: int) -> None:
        mcap_index = self.index
        if opcode == Opcode.CHUNK:
            self._add(Chunk(start, length))
        elif opcode == Opcode.MESSAGE_INDEX:
            if self.latest not in (Opcode.CHUNK, Opcode.MESSAGE_INDEX):
                raise DamageError(start, "an index stands behind no chunk")
            self.latest_chunk.indexes.append((start, length))
        elif opcode in _SUMMARY_ONLY:
            raise DamageError(start, f"a record of kind {opcode} stands among the messages")
        elif opcode > Opcode.DATA_END:
            mcap_index.private += 1
        else:
            self._file_other(opcode, start, length)

    def _add(self, chunk: Chunk) -> None:
        self.index.add_chunk(chunk)
        self.latest_chunk = chunk

    def _file_other(self, opcode: int, start: int, length: int) -> None:
        mcap_index = self.index
        if opcode == Opcode.HEADER:
            mcap_index.header = parsed(records.Header, self.data, start, length)
        elif opcode == Opcode.ATTACHMENT:
            attachment_at(self.data, start, length)
            mcap_index.attachments.append((start, length))
        elif opcode == Opcode.METADATA:
            parsed(records.Metadata, self.data, start, length)
            mcap_index.metadata.append((start, length))
        elif opcode == Opcode.DATA_END:
            crc = parsed(records.DataEnd, self.data, start, length).data_section_crc
            mcap_index.data_end = (start - RECORD_HEADER_SIZE, crc)
        else:
            file_definition(mcap_index, self.data, opcode, start, length)


def file_definition(mcap_index: McapIndex, data: memoryview, opcode: int, start: int, length: int) -> None:
    """File a schema or a channel; other records define nothing."""
    if opcode == Opcode.SCHEMA:
        schema = parsed(records.Schema, data, start, length)
        mcap_index.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = parsed(records.Channel, data, start, length)
        mcap_index.channels[channel.id] = channel
