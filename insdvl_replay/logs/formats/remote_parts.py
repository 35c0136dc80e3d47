"""The part of a remote MCAP file that a replay can use: a shorter MCAP file without the chunks that have only pictures.

The chunk indexes of the summary say which channels have messages in a chunk. Chunks are copied as they are, so their
checksums hold. Schemas and channels are those of the summary, which is written anew for the copied chunks; a metadata
record says what was left out. Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from dataclasses import replace as changed
from pathlib import Path
from typing import BinaryIO, Final

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from zlib_ng import zlib_ng

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.formats.log_file import LogChannel
from insdvl_replay.logs.formats.mcap_file import HEADER, HEADER_SIZE, MAGIC, PARTS, walk

Read = Callable[[int, int], bytes]
"""Reads the bytes between two places of the remote file."""
LEAST_BYTES: Final = 16 << 20  # A shorter log is fetched whole.
_MOST_OF_LOG: Final = 0.75  # A larger share is not worth more requests.
_GAP_BYTES: Final = 16 << 10  # What is between two chunks is fetched with them if it is shorter.
_PIECE_BYTES: Final = 8 << 20  # of one request
_AT_ONCE: Final = 8  # requests
_HEAD_BYTES: Final = 4 << 10  # that have the header
_SLACK_BYTES: Final = 64 << 10  # of records between the chunks that no index lists
_MOST_METADATA: Final = 1 << 20
_MOST_OF_CHUNK: Final = 64 << 20  # bytes; a log with longer chunks is fetched whole
_INDEX_ENTRY: Final = 16  # bytes of a message index for each message
# Types that no sensor of a replay has, without ``msg``: pictures, clouds, and what is drawn.
_PICTURES: Final = frozenset(
    {
        *("sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo"),
        *("sensor_msgs/PointCloud", "sensor_msgs/PointCloud2", "sensor_msgs/LaserScan"),
        *("sensor_msgs/MultiEchoLaserScan", "stereo_msgs/DisparityImage"),
        *("theora_image_transport/Packet", "ffmpeg_image_transport_msgs/FFMPEGPacket"),
        *("marine_acoustic_msgs/RawSonarImage", "marine_acoustic_msgs/ProjectedSonarImage"),
        *("visualization_msgs/Marker", "visualization_msgs/MarkerArray"),
        *("visualization_msgs/ImageMarker", "nav_msgs/OccupancyGrid"),
        *("foxglove/RawImage", "foxglove/CompressedImage", "foxglove/CompressedVideo"),
        *("foxglove/PointCloud", "foxglove/LaserScan", "foxglove/Grid"),
        *("foxglove/CameraCalibration", "foxglove/ImageAnnotations", "foxglove/SceneUpdate"),
    }
)


def is_picture(type_name: str) -> bool:
    """Return whether messages of a type are of no use to a replay."""
    return type_name.replace("/msg/", "/").replace(".", "/") in _PICTURES


@dataclass(frozen=True)
class LogSummary:
    """What the end of an MCAP file says of the whole."""

    size_bytes: int
    start: int  # of its records in the file
    content: bytes  # its records
    channels: tuple[LogChannel, ...]
    statistics: records.Statistics
    chunks: tuple[records.ChunkIndex, ...]
    metadata: tuple[records.MetadataIndex, ...]
    attachments: tuple[records.AttachmentIndex, ...]


@dataclass(frozen=True)
class Parts:
    """What is fetched of a remote file, and what is not."""

    definitions: bytes  # the records of schemas and channels
    chunks: Sequence[records.ChunkIndex]  # that are fetched
    metadata: Sequence[records.MetadataIndex]
    left_out: Sequence[records.ChunkIndex]
    topics: Sequence[str]  # that are in those
    counts: tuple[int, int]  # of schemas and channels

    @property
    def bytes_of_chunks(self) -> int:
        """The length of the chunks that are fetched, with their message indexes."""
        return sum(map(_length, self.chunks))


def parts_of(summary: LogSummary) -> Parts | None:
    """Choose what is fetched of a file; None where all of it is: where that is not much more, or not all is indexed."""
    if not _lists_all(summary):
        return None
    pictures = {channel.id for channel in summary.channels if is_picture(channel.type_name)}
    needed = []
    left_out = []
    missing = set[int]()
    for chunk in sorted(summary.chunks, key=lambda chunk: chunk.chunk_start_offset):
        inside = chunk.message_index_offsets.keys()
        if inside and inside <= pictures:
            left_out.append(chunk)
            missing.update(inside)
        else:
            needed.append(chunk)
    definitions, counts = _definitions(summary.content)
    found = Parts(
        definitions,
        needed,
        summary.metadata,
        left_out,
        sorted(channel.topic for channel in summary.channels if channel.id in missing),
        counts,
    )
    if found.bytes_of_chunks > _MOST_OF_LOG * summary.size_bytes:
        return None
    return found


def _lists_all(summary: LogSummary) -> bool:
    """Return whether all chunks are listed, of a usual size, and little is outside of what is."""
    metadata = sum(record.length for record in summary.metadata)
    attachments = sum(record.length for record in summary.attachments)
    lengths = list(map(_length, summary.chunks))
    others = summary.start - sum(lengths) - metadata - attachments
    is_complete = len(lengths) == summary.statistics.chunk_count > 0
    is_usual = max(lengths, default=0) <= _MOST_OF_CHUNK and metadata <= _MOST_METADATA
    return is_complete and is_usual and others <= len(summary.content) + _SLACK_BYTES


def _length(chunk: records.ChunkIndex) -> int:
    return chunk.chunk_length + chunk.message_index_length


def _definitions(summary: bytes) -> tuple[bytes, tuple[int, int]]:
    """Return the records of schemas and channels as they are, and how many there are of each."""
    found = []
    counts = Counter[int]()
    for kind, start, length in walk(memoryview(summary), len(summary)).records.tolist():
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            counts[kind] += 1
            found.append(summary[start : start + HEADER_SIZE + length])
    return b"".join(found), (counts[Opcode.SCHEMA], counts[Opcode.CHANNEL])


# --- Fetching and writing.


def write_parts(file: Path, parts: Parts, read: Read) -> None:
    """Fetch the parts of a remote file, and write them as an MCAP file of their own."""
    with file.open("wb") as stream:
        writer = _Writer(stream, parts)
        writer.begin(read(0, _HEAD_BYTES))
        for start, content in _contents(parts, read):
            writer.add(start, content)
        writer.end()


def _contents(parts: Parts, read: Read) -> Iterator[tuple[int, bytes]]:
    """Yield place and bytes of each chunk and metadata record in order; near ones come by one request."""
    spans = [(chunk.chunk_start_offset, _length(chunk)) for chunk in parts.chunks]
    spans += [(record.offset, record.length) for record in parts.metadata]
    spans.sort()
    runs = list(_runs(spans))
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        # Only so many requests are ahead of what is written.
        ahead = []
        for run in runs:
            ahead.append((run, pool.submit(_read_run, run, read)))
            if len(ahead) == _AT_ONCE:
                first, content = ahead.pop(0)
                yield from _cut(first, content.result())
        for run, content in ahead:
            yield from _cut(run, content.result())


Run = list[tuple[int, int]]
"""Places and lengths of records that are fetched by one request."""


def _runs(spans: Sequence[tuple[int, int]]) -> Iterator[Run]:
    """Yield the records that are near each other."""
    run: Run = []
    for start, length in spans:
        if run and (start > _end(run) + _GAP_BYTES or start + length - run[0][0] > _PIECE_BYTES):
            yield run
            run = []
        run.append((start, length))
    if run:
        yield run


def _end(run: Run) -> int:
    start, length = run[-1]
    return start + length


def _read_run(run: Run, read: Read) -> bytes:
    begin, _ = run[0]
    return read(begin, _end(run))


def _cut(run: Run, content: bytes) -> Iterator[tuple[int, bytes]]:
    begin, _ = run[0]
    for start, length in run:
        yield start, content[start - begin : start - begin + length]


class _Writer:
    """Writes an MCAP file of the chunks of another one."""

    def __init__(self, stream: BinaryIO, parts: Parts) -> None:
        self._stream = stream
        self._parts = parts
        self._chunks = {chunk.chunk_start_offset: chunk for chunk in parts.chunks}
        self._indexes: list[records.ChunkIndex] = []
        self._counts = Counter[int]()

    def begin(self, head: bytes) -> None:
        """Write the header of the remote file, whose first bytes are given, and the definitions."""
        self._stream.write(MAGIC)
        kind, length = HEADER.unpack_from(head, len(MAGIC))
        end = len(MAGIC) + HEADER_SIZE + length
        if kind == Opcode.HEADER and end <= len(head):
            self._stream.write(head[len(MAGIC) : end])
        else:
            self._stream.write(_record(records.Header("", "")))
        self._stream.write(self._parts.definitions)

    def add(self, start: int, content: bytes) -> None:
        """Write what was at a place of the remote file."""
        chunk = self._chunks.get(start)
        kind, length = HEADER.unpack_from(content)
        if chunk is None:
            _require(kind == Opcode.METADATA and length + HEADER_SIZE == len(content), start)
        else:
            _require(kind == Opcode.CHUNK and length + HEADER_SIZE == chunk.chunk_length, start)
            self._count(content[chunk.chunk_length :], start)
            shift = self._stream.tell() - start
            offsets = {id_: at + shift for id_, at in chunk.message_index_offsets.items()}
            self._indexes.append(
                changed(
                    chunk,
                    chunk_start_offset=start + shift,
                    message_index_offsets=offsets,
                )
            )
        self._stream.write(content)

    def _count(self, indexes: bytes, start: int) -> None:
        """Count the messages of a chunk by the indexes behind it."""
        found = walk(memoryview(indexes), len(indexes))
        _require(not found.is_broken, start)
        for kind, place, _ in found.records.tolist():
            if kind == Opcode.MESSAGE_INDEX:
                id_, size = struct.unpack_from("<HI", indexes, place + HEADER_SIZE)
                self._counts[id_] += size // _INDEX_ENTRY

    def end(self) -> None:
        """Write what was left out, and the summary."""
        left_out = self._parts.left_out
        described = {
            "chunks": str(len(left_out)),
            "bytes": str(sum(map(_length, left_out))),
            "topics": ", ".join(self._parts.topics),
        }
        self._stream.write(_record(records.Metadata(name=PARTS, metadata=described)))
        self._stream.write(_record(records.DataEnd(data_section_crc=0)))
        start = self._stream.tell()
        schemas, channels = self._parts.counts
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=channels,
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._indexes),
            message_count=self._counts.total(),
            message_end_time=max((chunk.message_end_time for chunk in self._indexes), default=0),
            message_start_time=min(
                (chunk.message_start_time for chunk in self._indexes), default=0
            ),
            metadata_count=len(self._parts.metadata) + 1,
            schema_count=schemas,
        )
        listed = [_record(record) for record in (statistics, *self._indexes)]
        summary = b"".join([self._parts.definitions, *listed])
        footer = _record(
            records.Footer(summary_start=start, summary_offset_start=0, summary_crc=0)
        )
        checked = summary + footer[:-4]  # its own checksum is last
        self._stream.write(checked + struct.pack("<I", zlib_ng.crc32(checked)) + MAGIC)


def _record(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _require(is_right: bool, place: int) -> None:
    if not is_right:
        text = f"at byte {place} is not the record that its summary lists"
        raise LogError(text, "fetch the log by other means, and run it from the file")
