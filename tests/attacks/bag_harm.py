"""Bags that are no MCAP, damaged by their structure: pages and rows of SQLite, records and chunks of ROS 1."""

import bz2
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import fixed_harm
import lz4.frame
import raw_harm

SQLITE, ROSBAG = b"SQLite format 3\0", b"#ROSBAG V2.0\n"
NUMBERS = (0, 1, -1, 2**31, 2**62, 2**63 - 1, -(2**63))
_PLAIN = "flip_bit noise zeros ones cut_end cut_few cut_start zero_end cut_out insert_noise repeat_span swap_spans"
PLAIN = tuple(getattr(raw_harm, name) for name in (*_PLAIN.split(), "append_noise"))
"""Harms that know nothing of records."""

Harm = Callable[[bytes, Random], bytes]


def _over(data: bytes, start: int, new: bytes) -> bytes:
    return data[:start] + new + data[start + len(new) :]


# --- Pages of SQLite, https://www.sqlite.org/fileformat2.html


def _page(data: bytes, rng: Random) -> tuple[int, int]:
    """Give where one of the pages starts, and how large it is."""
    size = int.from_bytes(data[16:18], "big") or 4096
    return rng.randrange(max(len(data) // size, 1)) * size, size


def swap_pages(data: bytes, rng: Random) -> bytes:
    """Exchange two pages."""
    (one, size), (two, _) = _page(data, rng), _page(data, rng)
    first, second = data[one : one + size], data[two : two + size]
    return _over(_over(data, one, second), two, first)


def lose_page(data: bytes, rng: Random) -> bytes:
    """Read zeros, ones or an older page where one was."""
    (place, size), (other, _) = _page(data, rng), _page(data, rng)
    return _over(
        data, place, rng.choice((bytes(size), b"\xff" * size, data[other : other + size]))
    )


def change_page_head(data: bytes, rng: Random) -> bytes:
    """Damage what a page says of itself: its kind, free blocks, number of cells, and where these are."""
    place, _ = _page(data, rng)
    place += 100 * (place == 0) + rng.randrange(16)
    return _over(data, place, rng.randbytes(rng.choice((1, 2))))


def change_file_head(data: bytes, rng: Random) -> bytes:
    """Damage a field of the header of the file."""
    return _over(data, rng.randrange(16, 100), rng.randbytes(rng.choice((1, 4))))


def change_cell(data: bytes, rng: Random) -> bytes:
    """Damage the start of a cell: its size, its row, or the kinds of its columns."""
    place, _ = _page(data, rng)
    pointer = place + 100 * (place == 0) + 8 + 2 * rng.randrange(8)
    cell = place + int.from_bytes(data[pointer : pointer + 2], "big") + rng.randrange(8)
    return _over(data, min(cell, len(data) - 1), rng.randbytes(1))


PAGES = (swap_pages, lose_page, change_page_head, change_file_head, change_cell)


# --- Rows of SQLite


FORMATS = ("", "ros1", "protobuf", "json", b"\xff")
WORDS = ("float32", "[]", "wstring", "", "float64[4000000]")
COLUMNS = ("id", "topic_id", "timestamp", "data")
STATEMENTS: tuple[Callable[[Random], tuple[str, tuple[object, ...]]], ...] = (
    lambda rng: ("DELETE FROM messages WHERE id % ? = 1", (rng.choice((2, 3, 50)),)),
    lambda rng: ("DELETE FROM messages WHERE topic_id = ?", (rng.choice((1, 2)),)),
    lambda rng: ("DELETE FROM topics WHERE id = ?", (rng.choice((1, 2)),)),
    lambda rng: (
        "INSERT INTO messages SELECT id + 100000, topic_id, timestamp, data FROM messages WHERE id < 50",
        (),
    ),
    lambda rng: ("UPDATE messages SET id = 100000 - id", ()),
    lambda rng: ("UPDATE messages SET id = ? WHERE id = 7", (rng.choice(NUMBERS),)),
    lambda rng: (
        "UPDATE messages SET timestamp = ? WHERE id % 7 = 1",
        (rng.choice((*NUMBERS, "x", 1.5, b"y")),),
    ),
    lambda rng: (
        "UPDATE messages SET timestamp = timestamp + ?",
        (rng.choice((10**9, -(10**18), 10**17)),),
    ),
    lambda rng: (
        "UPDATE messages SET topic_id = ? WHERE id % 9 = 1",
        (rng.choice((1, 2, 77, -1, "z")),),
    ),
    lambda rng: (
        "UPDATE messages SET data = substr(data, 1, ?) WHERE id % 5 = 1",
        (rng.choice((0, 1, 4, 40, 300)),),
    ),
    lambda rng: (
        "UPDATE messages SET data = data || ? WHERE id % 5 = 1",
        (rng.randbytes(rng.choice((1, 3, 9))),),
    ),
    lambda rng: (
        "UPDATE messages SET data = ? WHERE id % 5 = 1",
        (rng.choice((b"", 5, "text", bytes(4000))),),
    ),
    lambda rng: ("UPDATE topics SET name = ?", (rng.choice(fixed_harm.TEXTS),)),
    lambda rng: ("UPDATE topics SET type = ?", (rng.choice((*fixed_harm.TEXTS, b"\xff\xfe", 3)),)),
    lambda rng: (
        "UPDATE topics SET serialization_format = ?",
        (rng.choice(("", "ros1", "protobuf", "json", b"\xff")),),
    ),
    lambda rng: ("UPDATE topics SET id = ? WHERE id = 1", (rng.choice((0, -1, 70000, 2**62)),)),
    lambda rng: (
        "UPDATE message_definitions SET encoding = ?",
        (rng.choice(("", "ros2idl", "ros1msg", 9)),),
    ),
    lambda rng: (
        "UPDATE message_definitions SET encoded_message_definition = replace(encoded_message_definition, ?, ?)",
        (
            rng.choice(("float64", "[9]", "string", "MSG", "=")),
            rng.choice(("float32", "[]", "wstring", "", "float64[4000000]")),
        ),
    ),
    lambda rng: (
        f"DROP TABLE {rng.choice(('messages', 'topics', 'message_definitions', 'schema'))}",
        (),
    ),
    lambda rng: ("DROP INDEX timestamp_idx", ()),
    lambda rng: (
        f"ALTER TABLE messages RENAME COLUMN {rng.choice(COLUMNS)} TO other",
        (),
    ),
    lambda rng: ("PRAGMA journal_mode = WAL", ()),
    lambda rng: (f"PRAGMA page_size = {rng.choice((512, 1024, 8192, 65536))}", ()),
)


def change_rows(data: bytes, rng: Random) -> bytes:
    """Let SQLite itself change what the bag says; a question that it refuses changes nothing."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        path.write_bytes(data)
        with closing(sqlite3.connect(path, isolation_level=None)) as base, suppress(sqlite3.Error):
            base.execute(*rng.choice(STATEMENTS)(rng))
            base.execute("VACUUM")
        return path.read_bytes()


# --- Records of ROS 1, http://wiki.ros.org/Bags/Format/2.0


def _records(data: bytes, start: int = len(ROSBAG)) -> list[tuple[int, int, int]]:
    """Give where records, their data and their ends are."""
    found = []
    while start + 8 <= len(data):
        behind = start + 8 + int.from_bytes(data[start : start + 4], "little")
        end = behind + int.from_bytes(data[behind - 4 : behind], "little")
        if end > len(data):
            break
        found.append((start, behind, end))
        start = end
    return found or [(0, min(8, len(data)), len(data))]


def drop_record(data: bytes, rng: Random) -> bytes:
    """Lose a whole record."""
    start, _, end = rng.choice(_records(data))
    return data[:start] + data[end:]


def repeat_record(data: bytes, rng: Random) -> bytes:
    """Write a whole record twice."""
    start, _, end = rng.choice(_records(data))
    return data[:end] + data[start:]


def swap_records(data: bytes, rng: Random) -> bytes:
    """Exchange two records."""
    (one, _, one_end), (two, _, two_end) = sorted(
        (rng.choice(_records(data)), rng.choice(_records(data)))
    )
    if one_end > two:
        return data
    return data[:one] + data[two:two_end] + data[one_end:two] + data[one:one_end] + data[two_end:]


def change_header(data: bytes, rng: Random) -> bytes:
    """Flip a bit of the header of a record, its lengths included."""
    start, behind, _ = rng.choice(_records(data))
    place = rng.randrange(start, behind)
    return _over(data, place, bytes([data[place] ^ 1 << rng.randrange(8)]))


def change_length(data: bytes, rng: Random) -> bytes:
    """Let a record say a wrong length of its header or of its data."""
    start, behind, _ = rng.choice(_records(data))
    return _over(
        data,
        rng.choice((start, behind - 4)),
        (rng.choice(raw_harm.LENGTHS) & 0xFFFFFFFF).to_bytes(4, "little"),
    )


RECORDS = (drop_record, repeat_record, swap_records, change_header, change_length)


def change_chunks(data: bytes, rng: Random) -> bytes:
    """Damage records inside a chunk, pack it again, and leave the indexes out as in a bag that was not closed."""
    harm, parts = rng.choice((*RECORDS, *PLAIN)), [ROSBAG]
    records = [
        one
        for one in _records(data)
        if b"op=\x05" in data[one[0] : one[1]] or b"op=\x03" in data[one[0] : one[1]]
    ]
    harmed = rng.choice(records[1:] or records)
    for start, behind, end in records:
        header, content = data[start + 4 : behind - 4], data[behind:end]
        if (start, behind, end) == harmed:
            # The records of a chunk start at its first byte.
            content = harm(ROSBAG + _unpacked(header, content), rng)[len(ROSBAG) :]
            size = header.index(b"size=") + 5 if b"size=" in header else 0
            header = _over(header, size, struct.pack("<I", len(content))) if size else header
            content = bz2.compress(content) if b"bz2" in header else content
            content = lz4.frame.compress(content) if b"lz4" in header else content
        if b"index_pos=" in header:
            header = _over(header, header.index(b"index_pos=") + 10, bytes(8))
        parts.append(
            struct.pack("<I", len(header)) + header + struct.pack("<I", len(content)) + content
        )
    return b"".join(parts)


def _unpacked(header: bytes, content: bytes) -> bytes:
    with suppress(OSError, RuntimeError, ValueError):
        return (
            bz2.decompress(content)
            if b"bz2" in header
            else lz4.frame.decompress(content)
            if b"lz4" in header
            else content
        )
    return content


RAW: dict[bytes, tuple[Harm, ...]] = {
    SQLITE: (*PLAIN, *PAGES, *PAGES),
    ROSBAG: (*PLAIN, *RECORDS, *RECORDS),
}
FIXED: dict[bytes, tuple[Harm, ...]] = {SQLITE: (change_rows,), ROSBAG: (change_chunks,)}


def harms_of(data: bytes) -> dict[str, tuple[Harm, ...]] | None:
    """Give the harms that fit a file by their kind; None for MCAP."""
    magic = next((one for one in RAW if data.startswith(one)), None)
    return None if magic is None else {"raw": RAW[magic], "fixed": FIXED[magic]}


def harmed(data: bytes, rng: Random, kind: str) -> tuple[str, bytes]:
    """Damage a bag in one place, and one time in four in two or three, as `raw_harm.harmed`."""
    names = []
    harms = (harms_of(data) or {})[kind]
    for _ in range(rng.choice((1, 1, 1, 1, 1, 1, 2, 3))):
        harm = rng.choice(harms)
        data = harm(data, rng) if len(data) > 200 else data
        names.append(harm.__name__)
    return " + ".join(names), data
