"""Logs of a few hundred messages in every kind of container, as bytes, and the tools to damage them."""

from collections.abc import Iterator
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.logs import write_dive
from insdvl_replay.logs.formats.recording import Recording
from insdvl_replay.sim.dive import simulate_dive

START_NS = 1_700_000_000_000_000_000
IMU_MESSAGES, DVL_MESSAGES = 500, 25
MESSAGES = IMU_MESSAGES + DVL_MESSAGES
SPAN_S = (IMU_MESSAGES - 1) * 0.01

Message = tuple[str, int, bytes]
"""Topic, log time and payload."""

CONTAINERS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "no checksums": {"enable_crcs": False},
    "bare": {"enable_crcs": False, "compression": CompressionType.NONE},
    "no index": {"index_types": IndexType.NONE},
    "no message index": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "no summary": {
        "use_statistics": False,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_summary_offsets": False,
        "index_types": IndexType.MESSAGE,
    },
    "nothing repeated": {"repeat_channels": False, "repeat_schemas": False},
    "no chunks": {"use_chunking": False, "enable_data_crcs": True},
    "no chunks, no checksums": {"use_chunking": False, "enable_crcs": False},
    "all checksums": {"enable_data_crcs": True},
}


@cache
def written() -> bytes:
    """Write 5 s of a dive, with an IMU at 100 Hz and a DVL with velocities at 5 Hz."""
    rng = np.random.default_rng(8)
    time_ns = START_NS + 10_000_000 * np.arange(IMU_MESSAGES)
    imu = ImuColumns(
        time_ns,
        rng.normal([0.0, 0.0, -9.8], 0.05, (IMU_MESSAGES, 3)),
        rng.normal(0, 0.01, (500, 3)),
    )
    dvl = DvlColumns(
        time_ns[::20] + 1000, velocity_d=rng.normal([1.0, 0.0, 0.0], 0.1, (DVL_MESSAGES, 3))
    )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, Dive("dive", imu, dvl))
        return path.read_bytes()


@cache
def simulated() -> bytes:
    """Write 20 s of a simulated dive, which can be replayed as it is."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "dive.mcap"
        write_dive(path, simulate_dive("straight", seed=3, duration_s=20.0))
        return path.read_bytes()


@cache
def small_log(kind: str, extras: bool = False) -> bytes:
    """Write the same messages in another container, with two channels on each topic.

    `extras` adds an attachment and a metadata record.
    """
    stream = BytesIO()
    writer = Writer(stream, chunk_size=15_000, **CONTAINERS[kind])
    writer.start(profile="ros2", library="tests")
    channels: dict[tuple[str, int], int] = {}
    for i, (schema, channel, message) in enumerate(
        make_reader(BytesIO(written())).iter_messages()
    ):
        assert schema
        key = (channel.topic, i % 2)
        if key not in channels:
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[key] = writer.register_channel(channel.topic, "cdr", schema_id)
        writer.add_message(channels[key], message.log_time, message.data, message.publish_time)
    if extras:
        writer.add_attachment(1, 2, "notes.txt", "text/plain", b"calm sea")
        writer.add_metadata("vehicle", {"name": "unknown"})
    writer.finish()
    return stream.getvalue()


def messages(log: Recording) -> list[Message]:
    """Read all messages."""
    topics = {channel.id: channel.topic for channel in log.channels}
    return [
        (topics[block.channel_id], int(time_ns), bytes(block.buffer[offset : offset + size]))
        for block in log.blocks(set(topics))
        for offset, size, time_ns in zip(block.offsets, block.sizes, block.log_time, strict=True)
    ]


@cache
def true_messages() -> frozenset[Message]:
    """Give the messages as the official reader finds them."""
    found = make_reader(BytesIO(written())).iter_messages()
    return frozenset(
        (channel.topic, message.log_time, message.data) for _, channel, message in found
    )


def records(data: bytes, kind: int) -> list[tuple[int, int]]:
    """Find the records of a kind: where their headers start and where they end."""
    return [(start, end) for opcode, start, end in _all_records(data) if opcode == kind]


def _all_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    start = 8
    while start < len(data) - 8:
        end = start + 9 + int.from_bytes(data[start + 1 : start + 9], "little")
        yield data[start], start, end
        start = end


def changed(data: bytes, place: int, new: bytes) -> bytes:
    """Write over some bytes."""
    return data[:place] + new + data[place + len(new) :]


def flipped(data: bytes, place: int, bit: int = 0) -> bytes:
    """Flip one bit."""
    return changed(data, place, bytes([data[place] ^ (1 << bit)]))
