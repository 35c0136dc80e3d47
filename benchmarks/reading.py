"""How fast and in how much memory an IMU and a DVL are read from large logs, against three other readers.

`make bench` runs this; it makes its logs in a temporary folder and removes them. Every reader runs in a process of its
own. What counts are the ratios of one run, since they hardly depend on the machine.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from results import machine, table, write_part

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.runtime import prepare_process
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.formats.recording import open_recording

PER_IMU = 1.01
"""Messages for each one of the IMU."""
IMAGE = bytes(1_500_000)
READ = 500_000
DECODED = 100_000
"""Messages after which the slow readers are stopped; their speed is the same from the first to the last."""
ROUNDS = 5

KINDS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False},
}
WITH_CAMERA = 100_000
"""Messages of the IMU beside a camera."""
COLUMNS = (
    "log",
    "MB",
    "s",
    "k messages/s",
    *(f"against {name}" for name in ("mcap", "mcap-ros2-support", "rosbags")),
)
COLUMNS += ("MB beyond columns",)
GOALS = "At least 15 times mcap and 60 times mcap-ros2-support for zstd, and at most 250 MB beyond the columns kept."


def dive(messages: int) -> Dive:
    """Make a dive with an IMU at 400 Hz and a DVL at 4 Hz."""
    rng = np.random.default_rng(1)
    time_ns = 1_700_000_000_000_000_000 + 2_500_000 * np.arange(messages)
    force_b = np.round(rng.normal([0.0, 0.0, -9.8], 0.05, (messages, 3)), 4)
    imu = ImuColumns(time_ns, force_b, np.round(rng.normal(0.0, 0.01, (messages, 3)), 5))
    velocity_d = rng.normal([1.0, 0.0, 0.0], 0.1, (len(time_ns[::100]), 3))
    return Dive("dive", imu, DvlColumns(time_ns[::100], velocity_d=velocity_d))


def rewrite(source: Path, target: Path, images: int = 0, **options: Any) -> None:
    """Write a log again in another container, with camera images spread over it."""
    log = open_recording(source)
    with target.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2")
        ids = {}
        for channel in log.channels:
            schema = writer.register_schema(
                channel.type_name, channel.schema_encoding, channel.schema_data
            )
            ids[channel.id] = writer.register_channel(channel.topic, channel.encoding, schema)
        schema = writer.register_schema(
            "sensor_msgs/msg/CompressedImage", "ros2msg", b"uint8[] data\n"
        )
        camera = writer.register_channel("/camera", "cdr", schema)
        every = sum(channel.messages for channel in log.channels) // max(images, 1)
        count = 0
        for block in log.blocks(set(ids)):
            rows = zip(
                block.offsets.tolist(), block.sizes.tolist(), block.log_time.tolist(), strict=True
            )
            for offset, size, time_ns in rows:
                payload = bytes(block.buffer[offset : offset + size])
                writer.add_message(ids[block.channel_id], time_ns, payload, time_ns)
                count += 1
                if images and count % every == 0:
                    writer.add_message(camera, time_ns, IMAGE, time_ns)
        writer.finish()


def describe_bag(path: Path) -> Path:
    """Put beside a log what rosbags wants to know of it."""
    topics = [
        {
            "topic_metadata": {
                "name": channel.topic,
                "type": channel.type_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": "",
            },
            "message_count": channel.messages,
        }
        for channel in open_recording(path).channels
    ]
    bag = {
        "version": 5,
        "storage_identifier": "mcap",
        "relative_file_paths": [path.name],
        "duration": {"nanoseconds": 0},
        "starting_time": {"nanoseconds_since_epoch": 0},
        "message_count": sum(topic["message_count"] for topic in topics),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
    }
    (path.parent / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": bag}))
    return path.parent


def peak_mb() -> float:
    """Give the most memory that this process has had so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def with_insdvl_replay(path: Path) -> dict[str, float]:
    """Read and decode all of it, check it, and make clean columns, as the program does."""
    prepare_process()
    warm = path.with_name("warm.mcap")
    read_dive(warm, Config())
    before_mb = peak_mb()
    start_s = time.perf_counter()
    imu = read_dive(path, Config()).imu
    elapsed_s = time.perf_counter() - start_s
    kept_mb = (
        imu.time_ns.nbytes + imu.specific_force_b.nbytes + imu.angular_rate_b.nbytes
    ) / 2**20
    return {
        "messages": len(imu.time_ns) * PER_IMU,
        "s": elapsed_s,
        "mb": max(peak_mb() - before_mb - kept_mb, 0.0),
    }


def counted(items: Iterator[Any], most: int) -> dict[str, float]:
    """Go through messages and time it."""
    start_s = time.perf_counter()
    count = 0
    for _ in islice(items, most):
        count += 1
    return {"messages": count, "s": time.perf_counter() - start_s}


TOPICS = ["/imu", "/dvl"]


def with_mcap(path: Path) -> dict[str, float]:
    """Go through the first messages, not decoded."""
    with path.open("rb") as stream:
        return counted(make_reader(stream).iter_messages(topics=TOPICS), READ)


def with_mcap_ros2(path: Path) -> dict[str, float]:
    """Decode the first messages."""
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return counted(reader.iter_decoded_messages(topics=TOPICS), DECODED)


def with_rosbags(path: Path) -> dict[str, float]:
    """Decode the first messages."""
    from rosbags.highlevel import AnyReader

    with AnyReader([describe_bag(path)]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in TOPICS]
        messages = reader.messages(connections=wanted)
        return counted(
            (reader.deserialize(data, one.msgtype) for one, _, data in messages), DECODED
        )


READERS: dict[str, Callable[[Path], dict[str, float]]] = {
    "insdvl-replay": with_insdvl_replay,
    "mcap": with_mcap,
    "mcap-ros2-support": with_mcap_ros2,
    "rosbags": with_rosbags,
}


def measured(path: Path, reader: str) -> dict[str, float] | None:
    """Run a reader in a process of its own; None if it cannot read the log."""
    prepare_process()  # as the program does, before it loads numpy
    command = [sys.executable, __file__, "--reader", reader, str(path)]
    result = subprocess.run(command, capture_output=True, text=True)
    return json.loads(result.stdout) if result.returncode == 0 else None


def in_turn(path: Path) -> dict[str, dict[str, float] | None]:
    """Let all readers read a log, one after the other, several times; give the medians."""
    rounds = [{reader: measured(path, reader) for reader in READERS} for _ in range(ROUNDS)]
    found: dict[str, dict[str, float] | None] = {}
    for reader in READERS:
        outcomes = [outcome for taken in rounds if (outcome := taken[reader])]
        found[reader] = (
            {key: median(one[key] for one in outcomes) for key in outcomes[0]}
            if outcomes
            else None
        )
    return found


def row(name: str, path: Path) -> str:
    """Measure all readers on one log."""
    outcomes = in_turn(path)
    ours = outcomes.pop("insdvl-replay")
    if ours is None:
        raise RuntimeError(f"insdvl-replay cannot read the log '{name}'")
    speed = ours["messages"] / ours["s"]
    ratios = [
        f"{speed / (outcome['messages'] / outcome['s']):.0f} x" if outcome else "cannot"
        for outcome in outcomes.values()
    ]
    cells = [
        name,
        f"{path.stat().st_size / 1e6:.0f}",
        f"{ours['s']:.2f}",
        f"{speed / 1e3:.0f}",
        *ratios,
    ]
    return f"| {' | '.join([*cells, format(ours['mb'], '.0f')])} |"


def logs(folder: Path, messages: int, camera_gb: float) -> Iterator[tuple[str, Path]]:
    """Make one log after the other; only one is there at a time."""
    source = folder / "source" / "dive.mcap"
    source.parent.mkdir()
    write_dive(source, dive(messages))
    for kind, options in KINDS.items():
        yield (
            kind,
            _made(
                folder / kind,
                messages,
                lambda path, chosen=options: rewrite(source, path, **chosen),
            ),
        )
    write_dive(source, dive(min(messages, WITH_CAMERA)))
    images = int(camera_gb * 1e9 / len(IMAGE))
    bare = {"compression": CompressionType.NONE, "enable_crcs": False}
    name = f"none, with a camera, {camera_gb:g} GB"
    yield (
        name,
        _made(folder / "camera", messages, lambda path: rewrite(source, path, images, **bare)),
    )


def _made(folder: Path, messages: int, write: Callable[[Path], None]) -> Path:
    for older in folder.parent.glob("*/log.mcap"):
        older.unlink()
    folder.mkdir()
    write(folder / "log.mcap")
    write_dive(folder / "warm.mcap", dive(min(messages, 2000)))
    return folder / "log.mcap"


def report(messages: int, camera_gb: float) -> str:
    """Measure everything and make a page of it."""
    with TemporaryDirectory() as folder:
        rows = [row(name, path) for name, path in logs(Path(folder), messages, camera_gb)]
    title = [
        "# Reading",
        "",
        f"{messages * PER_IMU:.0f} messages in chunks of 1 MiB, `sensor_msgs/Imu` at 400 Hz and a DVL at 4 Hz; "
        f"{min(messages, WITH_CAMERA) * PER_IMU:.0f} of them in the log with a camera. insdvl-replay checks every "
        "checksum, digests the file and gives clean columns; mcap goes through the messages without decoding them; the "
        "other two decode them.",
        "",
        f"Medians of {ROUNDS}, measured in turn, of wall-clock time. {machine()}; shared cores, warm cache: read the "
        f"ratios. {GOALS}",
        "",
    ]
    return "\n".join([*title, *table(COLUMNS, rows)]) + "\n"


def main() -> None:
    """Measure, print and write the page; or run one reader."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=2_000_000)
    parser.add_argument("--camera-gb", type=float, default=3.0)
    parser.add_argument("--reader", choices=READERS)
    parser.add_argument("log", nargs="?", type=Path)
    arguments = parser.parse_args()
    if arguments.reader:
        sys.stdout.write(json.dumps(READERS[arguments.reader](arguments.log)))
        return
    page = report(arguments.messages, arguments.camera_gb)
    sys.stdout.write(page)
    write_part(page)


if __name__ == "__main__":
    main()
