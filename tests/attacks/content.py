"""What a log says, taken out of its file and put into a new one whose lengths, offsets and checksums are right.

Whatever is changed in between reaches the code behind the checks.
"""

import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

MAGIC = b"\x89MCAP0\r\n"
PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": lambda data: zstandard.ZstdCompressor(level=1).compress(data),
    "lz4": lz4.frame.compress,
}
MESSAGES_OF_A_CHUNK = 400


@dataclass
class Content:
    """The records of a log, without those that only say where others stand.

    Attributes
    ----------
    harm_chunk, harm_summary : callable, optional
        Changes the bytes of a chunk before they are packed and of the summary before its checksum is taken.
    """

    header: records.Header
    compression: str = "zstd"
    schemas: list[records.Schema] = field(default_factory=list)
    channels: list[records.Channel] = field(default_factory=list)
    messages: list[records.Message] = field(default_factory=list)
    others: list[records.McapRecord] = field(default_factory=list)
    harm_chunk: Callable[[int, bytes], bytes] | None = None
    harm_summary: Callable[[bytes], bytes] | None = None


def content_of(log: bytes) -> Content:
    """Take the records out of a log that is whole."""
    found = Content(records.Header("", ""))
    packed = StreamReader(BytesIO(log), emit_chunks=True).records
    found.compression = next(
        (one.compression for one in packed if isinstance(one, records.Chunk)), "zstd"
    )
    for record in StreamReader(BytesIO(log)).records:
        match record:
            case records.Header():
                found.header = record
            case records.Schema() if record not in found.schemas:
                found.schemas.append(record)
            case records.Channel() if record not in found.channels:
                found.channels.append(record)
            case records.Message():
                found.messages.append(record)
            case records.Attachment() | records.Metadata():
                found.others.append(record)
            case records.DataEnd():
                break
    return found


def record_bytes(record: Any) -> bytes:
    """Write one record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def file_of(content: Content) -> bytes:
    """Write a log with chunks, indexes, a summary and all checksums."""
    parts = [MAGIC, record_bytes(content.header)]
    place, indexes = sum(map(len, parts)), []
    first = [record_bytes(record) for record in (*content.schemas, *content.channels)]
    groups = range(0, max(len(content.messages), 1), MESSAGES_OF_A_CHUNK)
    for number, start in enumerate(groups):
        messages = content.messages[start : start + MESSAGES_OF_A_CHUNK]
        written, index = _chunk(
            content, number, b"" if number else b"".join(first), messages, place
        )
        parts.append(written)
        indexes.append(index)
        place += len(written)
    others = [(record, record_bytes(record)) for record in content.others]
    for record, written in others:
        parts.append(written)
        indexes.append(_index(record, place, len(written)))
        place += len(written)
    parts.append(record_bytes(records.DataEnd(zlib.crc32(b"".join(parts)))))
    return b"".join(
        [*parts, _end(content, [one for one in indexes if one], sum(map(len, parts))), MAGIC]
    )


def _chunk(
    content: Content, number: int, first: bytes, messages: list[records.Message], place: int
) -> tuple[bytes, records.ChunkIndex]:
    """Write a chunk and the message indexes behind it."""
    stood, parts, offset = dict[int, list[tuple[int, int]]](), [first], len(first)
    for message in messages:
        stood.setdefault(message.channel_id, []).append((message.log_time, offset))
        parts.append(record_bytes(message))
        offset += len(parts[-1])
    plain = b"".join(parts)
    if content.harm_chunk:
        plain = content.harm_chunk(number, plain)
    times = [message.log_time for message in messages] or [0]
    packed = PACKERS[content.compression](plain)
    span = {"message_start_time": min(times), "message_end_time": max(times)}
    size = {"compression": content.compression, "uncompressed_size": len(plain)}
    chunk = record_bytes(
        records.Chunk(data=packed, uncompressed_crc=zlib.crc32(plain), **size, **span)
    )
    offsets, behind = {}, b""
    for channel_id, entries in stood.items():
        offsets[channel_id] = place + len(chunk) + len(behind)
        behind += record_bytes(records.MessageIndex(channel_id, entries))
    index = records.ChunkIndex(
        chunk_length=len(chunk),
        chunk_start_offset=place,
        compressed_size=len(packed),
        message_index_length=len(behind),
        message_index_offsets=offsets,
        **size,
        **span,
    )
    return chunk + behind, index


def _index(record: records.McapRecord, place: int, length: int) -> records.McapRecord | None:
    if isinstance(record, records.Metadata):
        return records.MetadataIndex(place, length, record.name)
    if isinstance(record, records.Attachment):
        times = {"log_time": record.log_time, "create_time": record.create_time}
        size = {
            "data_size": len(record.data),
            "name": record.name,
            "media_type": record.media_type,
        }
        return records.AttachmentIndex(offset=place, length=length, **times, **size)
    return None


def _statistics(content: Content, chunks: int) -> records.Statistics:
    times = [message.log_time for message in content.messages] or [0]
    counts = Counter(message.channel_id for message in content.messages)
    return records.Statistics(
        attachment_count=sum(isinstance(record, records.Attachment) for record in content.others),
        channel_count=len(content.channels),
        channel_message_counts=dict(counts),
        chunk_count=chunks,
        message_count=len(content.messages),
        message_end_time=max(times),
        message_start_time=min(times),
        metadata_count=sum(isinstance(record, records.Metadata) for record in content.others),
        schema_count=len(content.schemas),
    )


def _end(content: Content, indexes: list[records.McapRecord], start: int) -> bytes:
    """Write the summary, where its groups stand, and the footer."""
    chunks = sum(isinstance(index, records.ChunkIndex) for index in indexes)
    groups = {
        Opcode.SCHEMA: content.schemas,
        Opcode.CHANNEL: content.channels,
        Opcode.STATISTICS: [_statistics(content, chunks)],
        Opcode.CHUNK_INDEX: [one for one in indexes if isinstance(one, records.ChunkIndex)],
        Opcode.ATTACHMENT_INDEX: [
            one for one in indexes if isinstance(one, records.AttachmentIndex)
        ],
        Opcode.METADATA_INDEX: [one for one in indexes if isinstance(one, records.MetadataIndex)],
    }
    summary, offsets = b"", b""
    for opcode, group in groups.items():
        written = b"".join(map(record_bytes, group))
        if written:
            offsets += record_bytes(
                records.SummaryOffset(opcode, start + len(summary), len(written))
            )
        summary += written
    if content.harm_summary:
        summary = content.harm_summary(summary)
    footer = record_bytes(records.Footer(start, start + len(summary), 0))
    checked = summary + offsets + footer[:-4]
    return checked + zlib.crc32(checked).to_bytes(4, "little")
