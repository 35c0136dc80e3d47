"""Small files that ask for much: what they unpack to, what their types describe, and how many things they name."""

import bz2
import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import lz4.frame
import zstandard
from content import MAGIC, Content, content_of, file_of, record_bytes
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from mcap import records
from table_bombs import TABLE_BOMBS
from victim import Ended, run_forked, verdict

from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

PIECE = bytes(16 << 20)
UNPACKED = 3 << 30
START_NS = 1_700_000_000_000_000_000


def _packed(compression: str, pieces: int, piece: bytes = PIECE) -> bytes:
    """Compress many times the same, without holding it."""
    if compression == "zstd":
        packer = zstandard.ZstdCompressor().compressobj()
        return b"".join([packer.compress(piece) for _ in range(pieces)] + [packer.flush()])
    frame = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    return b"".join(
        [frame.begin(), *(frame.compress(piece) for _ in range(pieces)), frame.flush()]
    )


def _chunk(compression: str, says: int, packed: bytes) -> bytes:
    return record_bytes(records.Chunk(compression, packed, START_NS, START_NS, 0, says))


def _bare(*parts: bytes) -> bytes:
    """Write a log that has no summary."""
    end = record_bytes(records.DataEnd(0)) + record_bytes(records.Footer(0, 0, 0)) + MAGIC
    return b"".join([MAGIC, record_bytes(records.Header("ros2", "attacks")), *parts, end])


def honest(compression: str) -> bytes:
    """Unpack to as much as is said."""
    return _bare(_chunk(compression, UNPACKED, _packed(compression, UNPACKED // len(PIECE))))


def liar(compression: str) -> bytes:
    """Unpack to more than is said."""
    return _bare(_chunk(compression, 1 << 20, _packed(compression, UNPACKED // len(PIECE))))


def cut(compression: str) -> bytes:
    """End within a chunk that unpacks to much."""
    chunk = _chunk(compression, UNPACKED, _packed(compression, UNPACKED // len(PIECE)))
    return (MAGIC + record_bytes(records.Header("ros2", "attacks")) + chunk)[:-20]


def many_chunks() -> bytes:
    """Have a hundred chunks, each of what one may hold."""
    record = b"\x80" + ((64 << 20) - 9).to_bytes(8, "little") + bytes((64 << 20) - 9)
    return _bare(*[_chunk("zstd", len(record), zstandard.ZstdCompressor().compress(record))] * 100)


def empty_chunks() -> bytes:
    """Have many chunks with nothing in them."""
    return _bare(*[_chunk("", 0, b"")] * 10_000)


def private_records() -> bytes:
    """Fill a chunk with records of nobody."""
    many = (b"\x80" + bytes(8)) * ((64 << 20) // 9)
    return _bare(_chunk("zstd", len(many), zstandard.ZstdCompressor().compress(many)))


def _imu_log(
    text: bytes,
    encoding: str = "ros2msg",
    name: str = "sensor_msgs/msg/Imu",
    data: bytes = bytes(400),
) -> bytes:
    """Write messages of a type that is described so."""
    content = Content(records.Header("ros2", "attacks"))
    message_encoding = {"ros2msg": "cdr", "": "json"}.get(encoding, encoding)
    content.schemas = [records.Schema(1, text, encoding, name)] if encoding else []
    content.channels = [records.Channel(1, "/imu", message_encoding, {}, len(content.schemas))]
    times = [START_NS + 10_000_000 * number for number in range(50)]
    content.messages = [records.Message(1, time_ns, data, time_ns, 0) for time_ns in times]
    return file_of(content)


def _levels(first: str, levels: int, each: int) -> bytes:
    """Describe a type whose fields double, or more, with each level."""
    parts = [first]
    for level in range(levels):
        fields = "".join(f"a/L{level + 1} f{number}\n" for number in range(each))
        parts.append(f"MSG: a/L{level}\n{fields}")
    parts.append(f"MSG: a/L{levels}\nfloat64 x\n")
    return f"\n{'=' * 80}\n".join(parts).encode()


def exponential_ros() -> bytes:
    """Describe 10^9 fields in a few lines."""
    return _imu_log(_levels("a/L0 root\n", 9, 10))


def deep_ros() -> bytes:
    """Nest types 3000 deep."""
    return _imu_log(_levels("a/L0 root\n", 3000, 1))


def long_array(length: str) -> bytes:
    """Describe an array of structures that no message could hold, in the type of the IMU of a whole dive."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, simulate_dive("straight", seed=1, duration_s=8.0))
        content = content_of(path.read_bytes())
    place = next(
        place
        for place, schema in enumerate(content.schemas)
        if schema.name == "sensor_msgs/msg/Imu"
    )
    schema = content.schemas[place]
    more = f"geometry_msgs/Vector3[{length}] v\n".encode()
    content.schemas[place] = replace(schema, data=more + schema.data)
    return file_of(content)


def long_numbers() -> bytes:
    """Give an array a length of 5000 digits."""
    return _imu_log(b"float64[" + b"9" * 5000 + b"] v\n")


def _protobuf(levels: int, each: int, *, mutual: bool) -> bytes:
    file = FileDescriptorProto(name="a.proto", package="a", syntax="proto3")
    for level in range(levels):
        message = file.message_type.add(name=f"L{level}")
        message.field.add(name="x", number=1, label=1, type=1)
        inner = range(levels) if mutual else [level + 1] * each if level + 1 < levels else []
        for number, other in enumerate(inner):
            message.field.add(
                name=f"f{number}", number=number + 2, label=1, type=11, type_name=f".a.L{other}"
            )
    return _imu_log(FileDescriptorSet(file=[file]).SerializeToString(), "protobuf", "a.L0", b"")


def _json(value: str) -> bytes:
    return _imu_log(b"", "", "", value.encode())


def many_channels() -> bytes:
    """Have 2000 IMUs, each with one message."""
    content = Content(records.Header("ros2", "attacks"))
    content.schemas = [records.Schema(1, b"float64 x\n", "ros2msg", "sensor_msgs/msg/Imu")]
    content.channels = [
        records.Channel(number, f"/imu{number}", "cdr", {}, 1) for number in range(1, 2001)
    ]
    content.messages = [
        records.Message(number, START_NS + number, bytes(400), START_NS, 0)
        for number in range(1, 2001)
    ]
    return file_of(content)


def many_metadata() -> bytes:
    """Have 50 000 records of metadata."""
    content = Content(records.Header("ros2", "attacks"))
    content.others = [
        records.Metadata("insdvl_replay", {"a": str(number)}) for number in range(50_000)
    ]
    return file_of(content)


def packed_records(record: bytes) -> bytes:
    """Fill chunks of a .bag with one record again and again."""
    many = record * ((60 << 20) // len(record))
    told = {"op": b"\5", "compression": b"bz2", "size": len(many).to_bytes(4, "little")}
    chunk = bag_record(told, bz2.compress(many))
    header = {"op": b"\3", "index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    return b"#ROSBAG V2.0\n" + bag_record(header, b"") + 30 * chunk


def bag_record(fields: dict[str, bytes], data: bytes) -> bytes:
    """Write a record of a .bag."""
    told = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(len(one).to_bytes(4, "little") + one for one in told)
    return len(header).to_bytes(4, "little") + header + len(data).to_bytes(4, "little") + data


def sqlite_bag(messages: str) -> bytes:
    """Make a .db3 whose table of messages is something else."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bomb.db3"
        with closing(sqlite3.connect(path)) as base:
            base.executescript(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
                f"INSERT INTO topics VALUES(1, '/imu', 'sensor_msgs/msg/Imu', 'cdr'); {messages}"
            )
        return path.read_bytes()


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
PLAIN_COLUMNS = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER"
BOMBS: dict[str, Callable[[], bytes]] = {
    **{
        f"{kind} {how.__name__}": lambda kind=kind, how=how: how(kind)
        for kind in ("zstd", "lz4")
        for how in (honest, liar, cut)
    },
    "100 chunks of 64 MB": many_chunks,
    "10 000 empty chunks": empty_chunks,
    "7 million private records": private_records,
    "ros2msg, 10^9 fields": exponential_ros,
    "ros2msg, 3000 deep": deep_ros,
    "ros2msg, array of 10^6 structures": lambda: long_array("1000000"),
    "ros2msg, array of 2^32 structures": lambda: long_array("4294967295"),
    "ros2msg, array of 5000 digits": long_numbers,
    "protobuf, 12 types of each other": lambda: _protobuf(12, 0, mutual=True),
    "protobuf, 10^9 fields": lambda: _protobuf(9, 10, mutual=False),
    "protobuf, 3000 deep": lambda: _protobuf(3000, 1, mutual=False),
    "JSON, 100 000 deep": lambda: _json("[" * 100_000 + "]" * 100_000),
    "JSON, 5000 digits": lambda: _json('{"a": ' + "9" * 5000 + "}"),
    "JSON, 20 000 names": lambda: _json(
        json.dumps({f"name_{number}": number for number in range(20_000)})
    ),
    "2000 channels": many_channels,
    "50 000 metadata": many_metadata,
    "bag of 10^8 small records": lambda: packed_records(bag_record({"op": b"\x63"}, b"")),
    "bag of 10^7 messages": lambda: packed_records(
        bag_record({"op": b"\2", "conn": bytes(4), "time": bytes(8)}, b"")
    ),
    "db3, messages without end": lambda: sqlite_bag(
        f"CREATE VIEW messages AS {ENDLESS} SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(9) AS data FROM n"
    ),
    "db3, messages that grow as they are read": lambda: sqlite_bag(
        f"CREATE TABLE messages({PLAIN_COLUMNS}, data BLOB AS (zeroblob(900000000)));"
        "INSERT INTO messages(id, topic_id, timestamp) VALUES(1, 1, 1), (2, 1, 2)"
    ),
    "db3, a check that takes long": lambda: sqlite_bag(
        f"CREATE TABLE messages({PLAIN_COLUMNS}, data BLOB, CHECK (length(hex(zeroblob(400000000))) > 0));"
        "PRAGMA ignore_check_constraints = 1; INSERT INTO messages VALUES(1, 1, 1, x'00'), (2, 1, 2, x'00')"
    ),
}


def _write_apart(log: Path, make: Callable[[], bytes]) -> None:
    """Write a file in a child, since the system counts what its making took as memory of later children, too."""
    child = os.fork()
    if child == 0:
        try:
            log.write_bytes(make())
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    if status:
        raise SystemExit(f"{log} could not be made")


def attack(folder: Path, clean_mb: float, only: str) -> Iterator[tuple[str, str, str, Ended, Any]]:
    """Try each bomb with each command.

    Yields
    ------
    str, str, str
        Which bomb, which command, and the verdict.
    Ended
    int
        Bytes of the file.
    """
    for name in filter(lambda name: only in name, BOMBS | TABLE_BOMBS):
        log = folder / f"bomb{Path(name).suffix if name in TABLE_BOMBS else '.mcap'}"
        _write_apart(log, (BOMBS | TABLE_BOMBS)[name])
        size = log.stat().st_size
        run = ["run", str(log), "-o", str(folder / "results")]
        for command in (run, [*run, "--allow-damaged"], ["inspect", str(log)]):
            ended = run_forked(command, folder / "said")
            yield (
                name,
                " ".join(one for one in command if "/" not in one and one != "-o"),
                verdict(ended, clean_mb),
                ended,
                size,
            )
        log.unlink()
