"""A chunk of an MCAP file: where it stands, what it says of itself, and its content decompressed and checked.

Source: the MCAP specification, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, Literal

import lz4.frame
import zstandard
from zlib_ng import zlib_ng

from insdvl_replay.logs.container.records import DamageError, Span, plausible_span

_CHUNK: Final = struct.Struct("<QQQII")
COMPRESSED: Final = ("zstd", "lz4")
"""The ways of compression that the format knows."""
_PIECE: Final = 16 << 20
"""Bytes of a cut chunk that are decompressed at a time."""

LARGEST_CHUNK: Final = 1 << 30
"""Bytes to which a chunk may open; recorders write some megabytes, and several chunks are open at a time."""
_USUAL_SIZE: Final = 64 << 20
_MOST_COMPRESSED: Final = 256
"""Chunks larger than usual are taken at their word only if they are not compressed more densely than this."""


def most_opened(compressed_size: int, usual: int = _USUAL_SIZE) -> int:
    """Return the bytes to which compressed bytes may open: what is usual, or more where there are more of them."""
    return max(usual, _MOST_COMPRESSED * compressed_size)


@dataclass
class Chunk:
    """A part of the file that holds messages.

    Attributes
    ----------
    offset, length : int
        Start and size of the record's content, or of the records themselves where they stand in no chunk.
    kind : {'intact', 'truncated', 'unchunked'}
        A chunk, a chunk whose end is missing, or messages that stand in no chunk.
    indexes : list of (int, int)
        Start and size of the index records behind the chunk, one for each channel.
    counts : Counter of int
        Messages by channel, as the index or the content says.
    """

    offset: int
    length: int
    kind: Literal["intact", "truncated", "unchunked"] = "intact"
    indexes: list[tuple[int, int]] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    @property
    def end(self) -> int:
        """Where its content ends."""
        return self.offset + self.length


@dataclass(frozen=True)
class ChunkHeader:
    """What a chunk says of itself: the span of its log times, bytes and checksum of what is in it, and how to open it.

    The checksum is 0 where the recorder computed none.
    """

    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str
    compressed_start: int
    compressed_size: int

    @property
    def span_ns(self) -> Span | None:
        """The span of the log times, if it can be so."""
        return plausible_span(self.first_ns, self.last_ns)


def chunk_header(data: memoryview, offset: int, room: int) -> ChunkHeader:
    """Read the fields in front of a chunk's compressed bytes."""
    record = data[offset : offset + room]
    if len(record) < _CHUNK.size:
        raise DamageError(offset, f"a chunk has {len(record)} bytes, too few for its own header")
    first_ns, last_ns, size, crc, name_size = _CHUNK.unpack_from(record)
    name_end = _CHUNK.size + name_size
    if name_end + 8 > len(record):
        raise DamageError(offset, f"a chunk says the name of its compression has {name_size} bytes")
    name = bytes(record[_CHUNK.size : name_end]).decode("ascii", "replace")
    compressed_size = int.from_bytes(record[name_end : name_end + 8], "little")
    return ChunkHeader(first_ns, last_ns, size, crc, name, offset + name_end + 8, compressed_size)


def opened_size(data: memoryview, chunk: Chunk) -> int:
    """Return the bytes that an open chunk takes: none where it is not compressed, or says more than can be."""
    if chunk.kind == "unchunked":
        return 0
    header = chunk_header(data, chunk.offset, chunk.length)
    most = room_of(chunk.end - header.compressed_start)
    if chunk.kind == "truncated":
        return _size_of_truncated(header, most)
    return header.size if header.compression and header.size <= most else 0


def open_chunk(data: memoryview, chunk: Chunk) -> memoryview:
    """Decompress a chunk, and check its length and checksum."""
    if chunk.kind == "unchunked":
        return data[chunk.offset : chunk.end]
    header = chunk_header(data, chunk.offset, chunk.length)
    compressed = data[header.compressed_start : chunk.end]
    if chunk.kind == "truncated":
        return _decompressed_start(compressed, header, chunk.offset)
    if len(compressed) != header.compressed_size:
        found = f"a chunk says it has {header.compressed_size} compressed bytes; there are {len(compressed)}"
        raise DamageError(chunk.offset, found)
    content = decompressed(compressed, header.compression, header.size, chunk.offset)
    of_size(content, header.size, chunk.offset)
    if header.crc and zlib_ng.crc32(content) != header.crc:
        raise DamageError(chunk.offset, "the checksum of a chunk is not that of its bytes")
    return content


def of_size(content: memoryview, size: int, offset: int) -> memoryview:
    """Return what a chunk that stands somewhere opens to, which must be as many bytes as announced."""
    if len(content) != size:
        raise DamageError(offset, f"a chunk opens to {len(content)} bytes where {size} were announced")
    return content


def decompressed(compressed: memoryview, compression: str, size: int, offset: int) -> memoryview:
    """Decompress the bytes of a chunk that stands somewhere, or give them where they are not compressed."""
    if compression and size > room_of(len(compressed)):
        raise DamageError(offset, f"a chunk of {len(compressed)} compressed bytes says it opens to {size}")
    try:
        if compression == "":
            return compressed
        if compression == "zstd":
            if zstandard.frame_content_size(compressed) not in (-1, size):
                raise DamageError(offset, f"a zstd chunk does not open to the {size} bytes that it announces")
            return memoryview(zstandard.ZstdDecompressor().decompress(compressed, max_output_size=size))
        if compression == "lz4":
            return _decompressed_lz4(compressed, size, offset)
    except (zstandard.ZstdError, RuntimeError, OverflowError) as error:
        raise DamageError(offset, f"a {compression} chunk cannot be decompressed ({error})") from error
    raise DamageError(offset, f"a chunk is compressed with '{compression}', which is none of zstd, lz4 and nothing")


def _decompressed_start(compressed: memoryview, header: ChunkHeader, offset: int) -> memoryview:
    """Decompress as much as the bytes that are left give; what opens to too much is counted first, and never held."""
    size = _size_of_truncated(header, room_of(len(compressed)))
    try:
        opened = 0
        for piece in _pieces(compressed, header.compression):
            opened += len(piece)
            _require_end(opened <= size, size, offset)
        content, filled = bytearray(opened), 0
        for piece in _pieces(compressed, header.compression):
            content[filled : filled + len(piece)] = piece
            filled += len(piece)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise DamageError(offset, f"a {header.compression} chunk cannot be decompressed ({error})") from error
    return memoryview(content).toreadonly()


def _pieces(compressed: memoryview, compression: str) -> Iterator[bytes]:
    """Decompress a frame, or the start of one that is cut, a piece at a time."""
    if compression == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(compressed)
        while piece := reader.read(_PIECE):
            yield piece
        return
    decompressor = lz4.frame.LZ4FrameDecompressor()
    yield decompressor.decompress(compressed, max_length=_PIECE)
    while not (decompressor.eof or decompressor.needs_input):
        yield decompressor.decompress(b"", max_length=_PIECE)


def room_of(compressed_size: int) -> int:
    """Return the bytes to which those of one chunk may open."""
    return min(most_opened(compressed_size), LARGEST_CHUNK)


def _size_of_truncated(header: ChunkHeader, most: int) -> int:
    """Return the bytes to which a cut chunk opens at most; some recorders write last of all what it is."""
    return min(header.size, most) if header.size else most


def _decompressed_lz4(compressed: memoryview, size: int, offset: int) -> memoryview:
    """Decompress a frame, or the start of one that is cut, to at most a size."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    content = decompressor.decompress(compressed, max_length=size)
    _require_end(decompressor.eof or decompressor.needs_input, size, offset)
    return memoryview(content)


def _require_end(is_all: bool, size: int, offset: int) -> None:
    if not is_all:
        raise DamageError(offset, f"a chunk opens to more than {size} bytes")
