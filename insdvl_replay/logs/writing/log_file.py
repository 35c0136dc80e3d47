"""An MCAP file as it is written: head, chunks, summary.

The framing of each kind of record is the mcap library's; a chunk comes as bytes that somebody else has put together,
with the index of its messages as columns, so that nothing here is done message by message. The same content gives the
same bytes as that library's own writer. Source: https://mcap.dev/spec.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import BinaryIO, Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from insdvl_replay.core.dive_columns import TimeNs
from insdvl_replay.logs.container.records import MAGIC

_INDEX_ENTRY: Final = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


@dataclass(frozen=True)
class IndexedChunk:
    """Message records, as they stand in a chunk; channel, time and place in the data of each of them, shape (k,)."""

    data: bytes
    channel: NDArray[np.int64]
    time_ns: TimeNs
    offset: NDArray[np.int64]


class LogFile:
    """Writes a log from its head to its footer.

    Schemas and channels come before the first chunk, and are written at its beginning.
    """

    def __init__(self, stream: BinaryIO, profile: str, library: str) -> None:
        self._stream = stream
        self._compressor = zstandard.ZstdCompressor()
        self._registered = b""
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._message_counts: dict[int, int] = {}
        self._summary_crc = 0
        self._stream.write(MAGIC)
        self._write(Header(profile, library))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema and give its number."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._registered += _framed(schema)
        self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Register a channel and give its number."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._registered += _framed(channel)
        self._channels.append(channel)
        return channel.id

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset, length = self._write(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, content: bytes) -> None:
        """Write an attachment without a time."""
        record = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)
        offset, length = self._write(record)
        index = AttachmentIndex(
            offset=offset,
            length=length,
            create_time=0,
            log_time=0,
            data_size=len(content),
            name=name,
            media_type=media_type,
        )
        self._attachments.append(index)

    def registrations(self) -> bytes:
        """Return the records of schemas and channels, which stand at the beginning of the first chunk."""
        return self._registered

    def add_chunk(self, chunk: IndexedChunk) -> None:
        """Write a chunk with at least one message, compressed, and the index of its messages."""
        compressed = self._compressor.compress(chunk.data)
        first_ns, last_ns = int(chunk.time_ns[0]), int(chunk.time_ns[-1])
        record = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=first_ns,
            message_end_time=last_ns,
            uncompressed_crc=zlib_ng.crc32(chunk.data),
            uncompressed_size=len(chunk.data),
        )
        offset, length = self._write(record)
        index_offset, index_offsets = self._stream.tell(), {}
        for channel in _in_order_of_appearance(chunk.channel):
            index_offsets[channel] = self._stream.tell()
            rows = chunk.channel == channel
            self._stream.write(_message_index(channel, chunk.time_ns[rows], chunk.offset[rows]))
            self._message_counts[channel] = self._message_counts.get(channel, 0) + int(rows.sum())
        index = ChunkIndex(
            message_start_time=first_ns,
            message_end_time=last_ns,
            chunk_start_offset=offset,
            chunk_length=length,
            message_index_offsets=index_offsets,
            message_index_length=self._stream.tell() - index_offset,
            compression="zstd",
            compressed_size=len(compressed),
            uncompressed_size=len(chunk.data),
        )
        self._chunks.append(index)

    def finish(self) -> None:
        """Write what ends the data, the summary and the footer. The stream stays open."""
        self._write(DataEnd(0))
        summary_start = self._stream.tell()
        offsets = [self._write_group(opcode, records) for opcode, records in self._summary()]
        offsets_start = self._stream.tell()
        self._write_group(Opcode.SUMMARY_OFFSET, offsets)
        footer = Footer(summary_start=summary_start, summary_offset_start=offsets_start, summary_crc=0)
        # The checksum covers the summary and the footer up to the checksum itself.
        footer.summary_crc = zlib_ng.crc32(_framed(footer)[:-4], self._summary_crc)
        self._write(footer)
        self._stream.write(MAGIC)

    def _write_group(self, opcode: int, records: Sequence[McapRecord]) -> SummaryOffset:
        """Write a group of the summary; give its place."""
        start, data = self._stream.tell(), b"".join(map(_framed, records))
        self._stream.write(data)
        self._summary_crc = zlib_ng.crc32(data, self._summary_crc)
        return SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(data))

    def _summary(self) -> list[tuple[int, Sequence[McapRecord]]]:
        return [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._message_counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._message_counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            schema_count=len(self._schemas),
        )

    def _write(self, record: McapRecord) -> tuple[int, int]:
        """Write one record; give its place and length."""
        offset, data = self._stream.tell(), _framed(record)
        self._stream.write(data)
        return offset, len(data)


def _framed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _in_order_of_appearance(channels: NDArray[np.int64]) -> list[int]:
    numbers, first = np.unique(channels, return_index=True)
    return [int(number) for number in numbers[np.argsort(first)]]


def _message_index(channel: int, time_ns: TimeNs, offset: NDArray[np.int64]) -> bytes:
    entries = np.empty(len(time_ns), dtype=_INDEX_ENTRY)
    entries["log_time"], entries["offset"] = time_ns, offset
    head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
    return head + entries.tobytes()
