"""Files that are small and open to much, made of records laid out by hand."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
START_NS = 1_700_000_000_000_000_000
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, DATA_END, PRIVATE = (
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    15,
    200,
)


def record(kind: int, content: bytes) -> bytes:
    """Frame a record."""
    return struct.pack("<BQ", kind, len(content)) + content


def text(value: str) -> bytes:
    """Give a string behind its length."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def schema(number: int, name: str, definition: bytes, encoding: str = "ros2msg") -> bytes:
    """Make a schema record."""
    data = struct.pack("<I", len(definition)) + definition
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + data)


def channel(number: int, schema_number: int, topic: str, encoding: str = "cdr") -> bytes:
    """Make a channel record."""
    head = struct.pack("<HH", number, schema_number)
    return record(CHANNEL, head + text(topic) + text(encoding) + struct.pack("<I", 0))


def message(number: int, payload: bytes, time_ns: int = START_NS) -> bytes:
    """Make a message record."""
    return record(MESSAGE, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + payload)


def index(number: int, entries: Sequence[tuple[int, int]]) -> bytes:
    """Make the index record of a channel: log times and places in the open chunk."""
    packed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
    return record(INDEX, struct.pack("<HI", number, len(packed)) + packed)


def chunk(
    packed: bytes, size: int, compression: str, span_ns: tuple[int, int] = (START_NS, START_NS)
) -> bytes:
    """Make a chunk record without checksum."""
    head = struct.pack("<QQQI", *span_ns, size, 0) + text(compression)
    return record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def log(body: bytes) -> bytes:
    """Put a head and an end without summary around records."""
    end = record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC
    return MAGIC + record(HEADER, text("ros2") + text("tests")) + body + end


def zstd_zeros(size: int) -> bytes:
    """Compress zeros, a piece at a time, without saying how many."""
    return _zeros(zstandard.ZstdCompressor().compressobj(), size)


def lz4_zeros(size: int) -> bytes:
    """Compress zeros, a piece at a time, without saying how many."""
    compressor = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    return bytes(compressor.begin()) + _zeros(compressor, size)


def _zeros(compressor: Any, size: int) -> bytes:
    piece = bytes(1 << 22)
    return (
        b"".join(compressor.compress(piece) for _ in range(size // len(piece)))
        + compressor.flush()
    )


def write(path: Path, data: bytes) -> Path:
    """Write a file and give its path."""
    path.write_bytes(data)
    return path
