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
from insdvl_replay.logs.container.records import DATA_END_SIZE, MAGIC, RECORD_HEADER_SIZE
from insdvl_replay.logs.container.scanner import Anatomy, Walk, file_definition
from insdvl_replay.logs.container.summary import read_summary, summary_behind


def anatomy_of(data: memoryview, release: Callable[[int, int], None]) -> Anatomy:
    """Find what a file holds.

    Parameters
    ----------
    data : memoryview
        The file.
    release : callable
        Is told the start and end of bytes that are not needed for now.

    Returns
    -------
    Anatomy
    """
    summary = read_summary(data)
    anatomy = Anatomy(summary, damages=dict.fromkeys(summary.damages))
    if (opening := bytes(data[: len(MAGIC)])) != MAGIC:
        anatomy.mark(Damage(0, f"the opening bytes are '{opening.hex(' ')}', not those of an MCAP file"))
    Walk(data, anatomy, release).run()
    if anatomy.data_end is not None and summary.message_count is None:
        anatomy.displaced = summary_behind(data, anatomy.data_end[0] + DATA_END_SIZE)
    for chunk in list(anatomy.chunks.values()):
        _count_by_index(data, anatomy, chunk)
    _lose_beyond_budget(data, anatomy)
    _compare_chunks(data, anatomy)
    _drop_copies(data, anatomy)
    anatomy.schemas |= _agreed(anatomy, anatomy.schemas, anatomy.announced.schemas)
    anatomy.channels |= _agreed(anatomy, anatomy.channels, anatomy.announced.channels)
    for chunk in list(anatomy.chunks.values()):
        if chunk.kind != "loose" and not _is_vouched_for(anatomy, chunk):
            _look_into(data, anatomy, chunk)
            release(chunk.offset, chunk.offset + chunk.length)
    _check_channels(anatomy)
    return anatomy


def _count_by_index(data: memoryview, anatomy: Anatomy, chunk: Chunk) -> None:
    """Count the messages of a chunk as its index tells; a chunk that cannot even be described is lost."""
    try:
        for place in chunk.indexes:
            channel_id, count = index_count(data, *place)
            if channel_id in chunk.counts:
                raise DamageError(place[0], f"a second index of a chunk names channel {channel_id}")
            chunk.counts[channel_id] = count
    except DamageError as damage:
        anatomy.mark(Damage(damage.offset, damage.found))
        chunk.indexes.clear()
        chunk.counts.clear()
    try:
        if chunk.kind != "loose":
            chunk_header(data, chunk.offset, chunk.length)
    except DamageError as damage:
        anatomy.lose(chunk, damage)


def _lose_beyond_budget(data: memoryview, anatomy: Anatomy) -> None:
    """Leave closed what would make the whole file larger than any that was recorded: it would take hours to read."""
    most, total = most_opened(len(data), LARGEST_CHUNK), 0
    for chunk in list(anatomy.chunks.values()):
        total += opened_size(data, chunk)
        if total > most:
            found = f"the chunks up to here open to {total} bytes, where a file of {len(data)} may hold {most}"
            anatomy.lose(chunk, DamageError(chunk.offset, found))


def _compare_chunks(data: memoryview, anatomy: Anatomy) -> None:
    """Hold the chunks against those that the summary names, and find those that the walk passed over."""
    named = anatomy.summary.chunks
    if not named:
        return
    walked = {chunk.offset - RECORD_HEADER_SIZE: chunk for chunk in anatomy.chunks.values() if chunk.kind != "loose"}
    places = sorted(anatomy.chunks)
    for start, index in named.items():
        chunk = walked.get(start)
        if chunk is None:
            anatomy.mark(Damage(start, "the summary names a chunk where none is found"))
            _add_passed_over(data, anatomy, places, start, index)
        elif difference := _difference(data, chunk, index):
            anatomy.mark(Damage(start, f"the summary does not agree with a chunk about {difference}"))
    for start in walked.keys() - named.keys():
        anatomy.mark(Damage(start, "a chunk stands here that the summary does not name"))
    anatomy.chunks = {place: anatomy.chunks[place] for place in places}


def _add_passed_over(
    data: memoryview, anatomy: Anatomy, places: list[int], start: int, index: records.ChunkIndex
) -> None:
    """Add a chunk that only the summary names, and its place to the sorted ones of all, where it overlaps no other."""
    offset, end = start + RECORD_HEADER_SIZE, start + index.chunk_length
    before = [anatomy.chunks[place] for place in places[: bisect_left(places, end)][-1:]]
    if end > anatomy.summary.end or any(start < chunk.offset + chunk.length for chunk in before):
        return
    try:
        header = chunk_header(data, offset, end - offset)
    except DamageError:
        return
    if header.packed_start + header.packed_size == end and header.size == index.uncompressed_size:
        anatomy.add(Chunk(offset, end - offset))
        insort(places, offset)


def _difference(data: memoryview, chunk: Chunk, index: records.ChunkIndex) -> str:
    """Name what the summary and a chunk tell differently."""
    header = chunk_header(data, chunk.offset, chunk.length)
    places = {index_count(data, *place)[0]: place[0] - RECORD_HEADER_SIZE for place in chunk.indexes}
    told = {
        "its length": (index.chunk_length, chunk.length + RECORD_HEADER_SIZE),
        "its compression": (index.compression, header.compression),
        "its compressed size": (index.compressed_size, header.packed_size),
        "its size": (index.uncompressed_size, header.size),
        "its first time": (index.message_start_time, header.first_ns),
        "its last time": (index.message_end_time, header.last_ns),
        "its index": (index.message_index_offsets or places, places),
    }
    return next((name for name, (one, other) in told.items() if one != other), "")


def _drop_copies(data: memoryview, anatomy: Anatomy) -> None:
    """Leave out chunks that are copies of another one."""
    seen: dict[bytes, Chunk] = {}
    for chunk in [chunk for chunk in anatomy.chunks.values() if chunk.kind == "whole"]:
        header = bytes(data[chunk.offset : chunk.offset + min(chunk.length, 64)])
        first = seen.setdefault(header, chunk)
        if first is not chunk and _bytes_of(data, first) == _bytes_of(data, chunk):
            anatomy.mark(Damage(chunk.offset, f"the chunk is a copy of the one at byte {first.offset}"))
            del anatomy.chunks[chunk.offset]


def _bytes_of(data: memoryview, chunk: Chunk) -> memoryview:
    return data[chunk.offset : chunk.offset + chunk.length]


def _agreed(anatomy: Anatomy, found: dict[int, Any], repeated: dict[int, Any]) -> dict[int, Any]:
    """Choose between a definition and its repetition in the summary."""
    for id_ in found.keys() & repeated.keys():
        if found[id_] != repeated[id_]:
            kind = type(found[id_]).__name__.lower()
            text = f"{kind} {id_} is not the same among the messages and in the summary"
            anatomy.mark(Damage(anatomy.summary.end, text))
    return found | repeated if anatomy.announced.checked else repeated | found


def _is_vouched_for(anatomy: Anatomy, chunk: Chunk) -> bool:
    """Tell whether it is known without opening a chunk what is in it."""
    named = chunk.offset - RECORD_HEADER_SIZE in anatomy.summary.chunks
    return named and bool(chunk.indexes) and all(_is_defined(anatomy, channel_id) for channel_id in chunk.counts)


def _is_defined(anatomy: Anatomy, channel_id: int) -> bool:
    channel = anatomy.channels.get(channel_id)
    return channel is not None and (channel.schema_id == 0 or channel.schema_id in anatomy.schemas)


def _look_into(data: memoryview, anatomy: Anatomy, chunk: Chunk) -> None:
    try:
        content = read_chunk(data, chunk)
    except DamageError as damage:
        anatomy.lose(chunk, damage)
        return
    anatomy.accept(chunk, content)
    for opcode, start, length in content.definitions.rows():
        try:
            file_definition(anatomy, content.buffer, opcode, start, length)
        except DamageError as damage:
            anatomy.mark(Damage(chunk.offset, f"in the chunk, {damage.offset} bytes on, {damage.found}"))


def _check_channels(anatomy: Anatomy) -> None:
    """Find messages of channels that no record defines."""
    for channel_id, count in anatomy.counts.items():
        if channel_id not in anatomy.channels:
            text = f"{count} messages are of channel {channel_id}, which is nowhere defined"
            anatomy.mark(Damage(anatomy.summary.end, text))
