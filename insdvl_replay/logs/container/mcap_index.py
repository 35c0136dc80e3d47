"""What a file holds, found by one walk and held against its own summary.

Nothing is taken from the summary that the records do not confirm, and a chunk stays closed only where both agree on
what is in it.
"""

from bisect import bisect_left, insort
from collections.abc import Callable
from typing import Any

from mcap import records

from insdvl_replay.logs.container.chunk_messages import index_count, read_chunk
from insdvl_replay.logs.container.chunks import LARGEST_CHUNK, Chunk, chunk_header, most_opened, opened_size
from insdvl_replay.logs.container.damage import Damage, DamageError
from insdvl_replay.logs.container.record_form import RECORD_HEADER_SIZE
from insdvl_replay.logs.container.records import DATA_END_SIZE, MAGIC
from insdvl_replay.logs.container.scanner import McapIndex, RecordScanner, file_definition
from insdvl_replay.logs.container.summary import read_summary, summary_behind


def build_index(data: memoryview, release: Callable[[int, int], None]) -> McapIndex:
    """Find what a file holds."""
    summary = read_summary(data)
    mcap_index = McapIndex(summary, damages=dict.fromkeys(summary.damages))
    if (opening := bytes(data[: len(MAGIC)])) != MAGIC:
        mcap_index.add_damage(Damage(0, f"the opening bytes are '{opening.hex(' ')}', not those of an MCAP file"))
    RecordScanner(data, mcap_index, release).run()
    if mcap_index.data_end is not None and summary.message_count is None:
        mcap_index.displaced = summary_behind(data, mcap_index.data_end[0] + DATA_END_SIZE)
    for chunk in list(mcap_index.chunks.values()):
        _count_by_index(data, mcap_index, chunk)
    _drop_beyond_budget(data, mcap_index)
    _compare_chunks(data, mcap_index)
    _drop_copies(data, mcap_index)
    mcap_index.schemas |= _agreed(mcap_index, mcap_index.schemas, mcap_index.announced.schemas)
    mcap_index.channels |= _agreed(mcap_index, mcap_index.channels, mcap_index.announced.channels)
    for chunk in list(mcap_index.chunks.values()):
        if chunk.kind != "unchunked" and not _is_verified(mcap_index, chunk):
            _look_into(data, mcap_index, chunk)
            release(chunk.offset, chunk.offset + chunk.length)
    _check_channels(mcap_index)
    return mcap_index


def _count_by_index(data: memoryview, mcap_index: McapIndex, chunk: Chunk) -> None:
    """Count the messages of a chunk as its index tells; a chunk that cannot even be described is lost."""
    try:
        for place in chunk.indexes:
            channel_id, count = index_count(data, *place)
            if channel_id in chunk.counts:
                raise DamageError(place[0], f"a second index of a chunk names channel {channel_id}")
            chunk.counts[channel_id] = count
    except DamageError as damage:
        mcap_index.add_damage(Damage(damage.offset, damage.found))
        chunk.indexes.clear()
        chunk.counts.clear()
    try:
        if chunk.kind != "unchunked":
            chunk_header(data, chunk.offset, chunk.length)
    except DamageError as damage:
        mcap_index.drop_chunk(chunk, damage)


def _drop_beyond_budget(data: memoryview, mcap_index: McapIndex) -> None:
    """Leave closed what would make the whole file larger than any that was recorded: it would take hours to read."""
    most, total = most_opened(len(data), LARGEST_CHUNK), 0
    for chunk in list(mcap_index.chunks.values()):
        total += opened_size(data, chunk)
        if total > most:
            found = f"the chunks up to here open to {total} bytes, where a file of {len(data)} may hold {most}"
            mcap_index.drop_chunk(chunk, DamageError(chunk.offset, found))


def _compare_chunks(data: memoryview, mcap_index: McapIndex) -> None:
    """Hold the chunks against those that the summary names, and find those that the walk passed over."""
    named = mcap_index.summary.chunks
    if not named:
        return
    walked = {
        chunk.offset - RECORD_HEADER_SIZE: chunk for chunk in mcap_index.chunks.values() if chunk.kind != "unchunked"
    }
    places = sorted(mcap_index.chunks)
    for start, index in named.items():
        chunk = walked.get(start)
        if chunk is None:
            mcap_index.add_damage(Damage(start, "the summary names a chunk where none is found"))
            _add_passed_over(data, mcap_index, places, start, index)
        elif difference := _difference(data, chunk, index):
            mcap_index.add_damage(Damage(start, f"the summary does not agree with a chunk about {difference}"))
    for start in walked.keys() - named.keys():
        mcap_index.add_damage(Damage(start, "a chunk stands here that the summary does not name"))
    mcap_index.chunks = {place: mcap_index.chunks[place] for place in places}


def _add_passed_over(
    data: memoryview, mcap_index: McapIndex, places: list[int], start: int, index: records.ChunkIndex
) -> None:
    """Add a chunk that only the summary names, and its place to the sorted ones of all, where it overlaps no other."""
    offset, end = start + RECORD_HEADER_SIZE, start + index.chunk_length
    before = [mcap_index.chunks[place] for place in places[: bisect_left(places, end)][-1:]]
    if end > mcap_index.summary.end or any(start < chunk.offset + chunk.length for chunk in before):
        return
    try:
        header = chunk_header(data, offset, end - offset)
    except DamageError:
        return
    if header.compressed_start + header.compressed_size == end and header.size == index.uncompressed_size:
        mcap_index.add_chunk(Chunk(offset, end - offset))
        insort(places, offset)


def _difference(data: memoryview, chunk: Chunk, index: records.ChunkIndex) -> str:
    """Name what the summary and a chunk tell differently."""
    header = chunk_header(data, chunk.offset, chunk.length)
    places = {index_count(data, *place)[0]: place[0] - RECORD_HEADER_SIZE for place in chunk.indexes}
    told = {
        "its length": (index.chunk_length, chunk.length + RECORD_HEADER_SIZE),
        "its compression": (index.compression, header.compression),
        "its compressed size": (index.compressed_size, header.compressed_size),
        "its size": (index.uncompressed_size, header.size),
        "its first time": (index.message_start_time, header.first_ns),
        "its last time": (index.message_end_time, header.last_ns),
        "its index": (index.message_index_offsets or places, places),
    }
    return next((name for name, (one, other) in told.items() if one != other), "")


def _drop_copies(data: memoryview, mcap_index: McapIndex) -> None:
    """Leave out chunks that are copies of another one."""
    seen: dict[bytes, Chunk] = {}
    for chunk in [chunk for chunk in mcap_index.chunks.values() if chunk.kind == "intact"]:
        header = bytes(data[chunk.offset : chunk.offset + min(chunk.length, 64)])
        first = seen.setdefault(header, chunk)
        if first is not chunk and _bytes_of(data, first) == _bytes_of(data, chunk):
            mcap_index.add_damage(Damage(chunk.offset, f"the chunk is a copy of the one at byte {first.offset}"))
            del mcap_index.chunks[chunk.offset]


def _bytes_of(data: memoryview, chunk: Chunk) -> memoryview:
    return data[chunk.offset : chunk.offset + chunk.length]


def _agreed(mcap_index: McapIndex, found: dict[int, Any], repeated: dict[int, Any]) -> dict[int, Any]:
    """Choose between a definition and its repetition in the summary."""
    for id_ in found.keys() & repeated.keys():
        if found[id_] != repeated[id_]:
            kind = type(found[id_]).__name__.lower()
            text = f"{kind} {id_} is not the same among the messages and in the summary"
            mcap_index.add_damage(Damage(mcap_index.summary.end, text))
    return found | repeated if mcap_index.announced.checked else repeated | found


def _is_verified(mcap_index: McapIndex, chunk: Chunk) -> bool:
    """Return whether it is known without opening a chunk what is in it."""
    named = chunk.offset - RECORD_HEADER_SIZE in mcap_index.summary.chunks
    return named and bool(chunk.indexes) and all(_is_defined(mcap_index, channel_id) for channel_id in chunk.counts)


def _is_defined(mcap_index: McapIndex, channel_id: int) -> bool:
    channel = mcap_index.channels.get(channel_id)
    return channel is not None and (channel.schema_id == 0 or channel.schema_id in mcap_index.schemas)


def _look_into(data: memoryview, mcap_index: McapIndex, chunk: Chunk) -> None:
    try:
        content = read_chunk(data, chunk)
    except DamageError as damage:
        mcap_index.drop_chunk(chunk, damage)
        return
    mcap_index.trust(chunk, content)
    for opcode, start, length in content.definitions.rows():
        try:
            file_definition(mcap_index, content.buffer, opcode, start, length)
        except DamageError as damage:
            mcap_index.add_damage(Damage(chunk.offset, f"in the chunk, {damage.offset} bytes on, {damage.found}"))


def _check_channels(mcap_index: McapIndex) -> None:
    """Find messages of channels that no record defines."""
    for channel_id, count in mcap_index.counts.items():
        if channel_id not in mcap_index.channels:
            text = f"{count} messages are of channel {channel_id}, which is nowhere defined"
            mcap_index.add_damage(Damage(mcap_index.summary.end, text))
