"""What a file holds and where, found by one walk over its records and held against its own summary.

After bytes that are no record the walk goes on at the next chunk that the summary names, or where the next records can
be made out. Nothing is taken from the summary that the records do not confirm, and a chunk stays closed only where both
agree on what is in it.
"""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from mcap import records
from mcap.opcode import Opcode

from insdvl_replay.logs.container.blocks import index_count, message_field, read_chunk
from insdvl_replay.logs.container.chunks import COMPRESSED, LARGEST_CHUNK, Chunk, chunk_header, most_opened, opened_size
from insdvl_replay.logs.container.mcap_index import McapIndex, read_summary, summary_behind
from insdvl_replay.logs.container.records import (
    DATA_END_SIZE,
    MAGIC,
    RECORD_HEADER_SIZE,
    Damage,
    DamageError,
    Records,
    attachment_at,
    find_records,
    go_on,
    is_broken,
    next_record,
    parsed,
    what_stands,
)


def build_index(data: memoryview, release: Callable[[int, int], None]) -> McapIndex:
    """Find what a file holds."""
    summary = read_summary(data)
    index = McapIndex(summary, damages=dict.fromkeys(summary.damages))
    if (opening := bytes(data[: len(MAGIC)])) != MAGIC:
        index.add_damage(Damage(0, f"the opening bytes are '{opening.hex(' ')}', not those of an MCAP file"))
    _RecordScanner(data, index, release).run()
    if index.data_end is not None and summary.message_count is None:
        index.displaced = summary_behind(data, index.data_end[0] + DATA_END_SIZE)
    for chunk in list(index.chunks.values()):
        _count_by_index(data, index, chunk)
    _drop_beyond_budget(data, index)
    _compare_chunks(data, index)
    _drop_copies(data, index)
    index.schemas |= index.agreed(index.schemas, index.announced.schemas)
    index.channels |= index.agreed(index.channels, index.announced.channels)
    for chunk in list(index.chunks.values()):
        if chunk.kind != "unchunked" and not index.is_verified(chunk):
            _look_into(data, index, chunk)
            release(chunk.offset, chunk.end)
    index.check_channels()
    return index


def _count_by_index(data: memoryview, index: McapIndex, chunk: Chunk) -> None:
    """Count the messages of a chunk as its index tells; a chunk that cannot even be described is lost."""
    try:
        for place in chunk.indexes:
            channel_id, count = index_count(data, *place)
            if channel_id in chunk.counts:
                raise DamageError(place[0], f"a second index of a chunk names channel {channel_id}")
            chunk.counts[channel_id] = count
    except DamageError as error:
        index.add_damage(error.damage)
        chunk.indexes.clear()
        chunk.counts.clear()
    try:
        if chunk.kind != "unchunked":
            chunk_header(data, chunk.offset, chunk.length)
    except DamageError as error:
        index.drop_chunk(chunk, error.damage)


def _drop_beyond_budget(data: memoryview, index: McapIndex) -> None:
    """Leave closed what would make the whole file larger than any that was recorded: it would take hours to read."""
    most, total = most_opened(len(data), LARGEST_CHUNK), 0
    for chunk in list(index.chunks.values()):
        total += opened_size(data, chunk)
        if total > most:
            found = f"the chunks up to here open to {total} bytes, where a file of {len(data)} may hold {most}"
            index.drop_chunk(chunk, Damage(chunk.offset, found))


def _compare_chunks(data: memoryview, index: McapIndex) -> None:
    """Hold the chunks against those that the summary names, and find those that the walk passed over."""
    named = index.summary.chunks
    if not named:
        return
    walked = {chunk.offset - RECORD_HEADER_SIZE: chunk for chunk in index.chunks.values() if chunk.kind != "unchunked"}
    places = sorted(index.chunks)
    for start, told in named.items():
        chunk = walked.get(start)
        if chunk is None:
            index.add_damage(Damage(start, "the summary names a chunk where none is found"))
            _add_passed_over(data, index, places, start, told)
        elif difference := _difference(data, chunk, told):
            index.add_damage(Damage(start, f"the summary does not agree with a chunk about {difference}"))
    for start in walked.keys() - named.keys():
        index.add_damage(Damage(start, "a chunk stands here that the summary does not name"))
    index.chunks = {place: index.chunks[place] for place in places}


def _add_passed_over(
    data: memoryview, index: McapIndex, places: list[int], start: int, told: records.ChunkIndex
) -> None:
    """Add a chunk that only the summary names, and its place to the sorted ones of all, where it overlaps no other."""
    offset, end = start + RECORD_HEADER_SIZE, start + told.chunk_length
    before = [index.chunks[place] for place in places[: bisect_left(places, end)][-1:]]
    if end > index.summary.end or any(start < chunk.end for chunk in before):
        return
    try:
        header = chunk_header(data, offset, end - offset)
    except DamageError:
        return
    if header.compressed_start + header.compressed_size == end and header.size == told.uncompressed_size:
        index.add_chunk(Chunk(offset, end - offset))
        insort(places, offset)


def _difference(data: memoryview, chunk: Chunk, told: records.ChunkIndex) -> str:
    """Name what the summary and a chunk tell differently."""
    header = chunk_header(data, chunk.offset, chunk.length)
    places = {index_count(data, *place)[0]: place[0] - RECORD_HEADER_SIZE for place in chunk.indexes}
    compared = {
        "its length": (told.chunk_length, chunk.length + RECORD_HEADER_SIZE),
        "its compression": (told.compression, header.compression),
        "its compressed size": (told.compressed_size, header.compressed_size),
        "its size": (told.uncompressed_size, header.size),
        "its first time": (told.message_start_time, header.first_ns),
        "its last time": (told.message_end_time, header.last_ns),
        "its index": (told.message_index_offsets or places, places),
    }
    return next((name for name, (one, other) in compared.items() if one != other), "")


def _drop_copies(data: memoryview, index: McapIndex) -> None:
    """Leave out chunks that are copies of another one."""
    seen: dict[bytes, Chunk] = {}
    for chunk in [chunk for chunk in index.chunks.values() if chunk.kind == "intact"]:
        header = bytes(data[chunk.offset : chunk.offset + min(chunk.length, 64)])
        first = seen.setdefault(header, chunk)
        if first is not chunk and data[first.offset : first.end] == data[chunk.offset : chunk.end]:
            index.add_damage(Damage(chunk.offset, f"the chunk is a copy of the one at byte {first.offset}"))
            del index.chunks[chunk.offset]


def _look_into(data: memoryview, index: McapIndex, chunk: Chunk) -> None:
    try:
        content = read_chunk(data, chunk)
    except DamageError as error:
        index.drop_chunk(chunk, error.damage)
        return
    index.trust(chunk, content)
    for opcode, start, length in content.definitions.rows():
        try:
            file_definition(index, content.buffer, opcode, start, length)
        except DamageError as error:
            found = f"in the chunk, {error.damage.offset} bytes on, {error.damage.found}"
            index.add_damage(Damage(chunk.offset, found))


_SUMMARY_ONLY: Final = (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)


class _RecordScanner:
    """The way through the data section."""

    def __init__(self, data: memoryview, index: McapIndex, release: Callable[[int, int], None]) -> None:
        self.data = data
        self.release = release
        self.index = index
        self.known_chunks = sorted(index.summary.chunks)
        self.latest = 0
        self.latest_chunk = Chunk(0, 0)

    def run(self) -> None:
        """Go from the first record to the end of the data section."""
        index, summary, place = self.index, self.index.summary, len(MAGIC)
        end = summary.start if summary.checked and summary.start else summary.end
        while place < end and index.data_end is None:
            batch, stop = find_records(self.data, place, end)
            if is_broken(batch, stop, end):
                index.add_damage(Damage(stop, what_stands(self.data, stop, end)))
                batch, stop = self.behind(batch, stop, end)
            self.take(batch)
            self.release(place, stop)
            place = stop
        if index.header is None:
            index.add_damage(Damage(len(MAGIC), "no header begins the log"))
        if index.data_end is None and summary.start is not None:
            index.add_damage(Damage(place, "no record ends the messages"))
        elif summary.start not in (None, place):
            index.add_damage(Damage(place, f"the footer says that the summary starts at byte {summary.start}"))

    def behind(self, batch: Records, stop: int, end: int) -> tuple[Records, int]:
        """Go on behind bytes that are no record."""
        if len(batch) and batch.opcodes[-1] == Opcode.CHUNK:
            chunk = self.chunk_at(int(batch.starts[-1]), end)
            if chunk and chunk.end != stop:
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
        return batch.where(slice(0)), chunk.end

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
        """File the records of a batch; messages in a row make one run. Private records between them do not count."""
        private = batch.opcodes > Opcode.DATA_END
        self.index.private += int(np.count_nonzero(private))
        batch = batch.where(~private)
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
            except DamageError as error:
                self.index.add_damage(error.damage)
                # What follows, such as further indexes, belongs to nothing that was filed before.
                self.latest = 0

    def _file(self, opcode: int, start: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            self._add(Chunk(start, length))
        elif opcode == Opcode.MESSAGE_INDEX:
            if self.latest not in (Opcode.CHUNK, Opcode.MESSAGE_INDEX):
                raise DamageError(start, "an index stands behind no chunk")
            self.latest_chunk.indexes.append((start, length))
        elif opcode in _SUMMARY_ONLY:
            raise DamageError(start, f"a record of kind {opcode} stands among the messages")
        else:
            self._file_other(opcode, start, length)

    def _add(self, chunk: Chunk) -> None:
        self.index.add_chunk(chunk)
        self.latest_chunk = chunk

    def _file_other(self, opcode: int, start: int, length: int) -> None:
        index = self.index
        if opcode == Opcode.HEADER:
            index.header = parsed(records.Header, self.data, start, length)
        elif opcode == Opcode.ATTACHMENT:
            attachment_at(self.data, start, length)
            index.attachments.append((start, length))
        elif opcode == Opcode.METADATA:
            parsed(records.Metadata, self.data, start, length)
            index.metadata.append((start, length))
        elif opcode == Opcode.DATA_END:
            crc = parsed(records.DataEnd, self.data, start, length).data_section_crc
            index.data_end = (start - RECORD_HEADER_SIZE, crc)
        else:
            file_definition(index, self.data, opcode, start, length)


def file_definition(index: McapIndex, data: memoryview, opcode: int, start: int, length: int) -> None:
    """File a schema or a channel; other records define nothing."""
    if opcode == Opcode.SCHEMA:
        schema = parsed(records.Schema, data, start, length)
        index.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = parsed(records.Channel, data, start, length)
        index.channels[channel.id] = channel
