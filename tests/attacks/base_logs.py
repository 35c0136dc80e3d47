"""The logs that are damaged: whole dives of the project, and short ones in every container and encoding."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import other_bags
import unknown_logs
from content import content_of, file_of
from mcap.writer import CompressionType, Writer

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

ROOT = Path(__file__).resolve().parents[2]
RECORDED = ROOT.parent / "shared" / "data" / "ros1"
SHORT_S = 8.0
ANSWERS = {
    "initial.heading_deg": "30.0",
    "initial.latitude_deg": "32.8",
    "imu.angular_rate_unit": '"rad/s"',
}
"""What a person knows of the dives in types of nobody."""
CONTAINERS = {
    "lz4": {"compression": CompressionType.LZ4},
    "loose": {"use_chunking": False, "enable_data_crcs": True},
    "bare": {"enable_crcs": False, "compression": CompressionType.NONE},
}

BAGS: dict[str, Callable[[Path, bytes], Path]] = {
    "ros1.mcap": other_bags.ros1_mcap,
    "bz2.bag": lambda path, log: other_bags.bag(path, "bz2", log),
    "lz4.bag": lambda path, log: other_bags.bag(path, "lz4", log),
    "iron.db3": lambda path, log: _part(other_bags.ros2_bag(path.with_suffix(""), log=log)),
    "humble.db3": lambda path, log: _part(
        other_bags.ros2_bag(path.with_suffix(""), log=log, humble=True)
    ),
}
"""The same dive as others record it. rosbags writes lz4 without the checksum that roscpp writes."""
PROTECTED = ("ros1.mcap", "bz2.bag")


def _part(folder: Path) -> Path:
    return folder / f"{folder.name}.db3"


@dataclass(frozen=True)
class Base:
    """A log that is whole.

    Attributes
    ----------
    path : Path
    protected : bool
        Whether a checksum stands over every message.
    settings : tuple of str
        Arguments of the command line without which it cannot be replayed.
    weight : int
        How often it is chosen.
    """

    path: Path
    protected: bool = True
    settings: tuple[str, ...] = ()
    weight: int = 4


def short_logs(folder: Path) -> list[Base]:
    """Write short dives into a folder."""
    folder.mkdir(exist_ok=True)
    known = folder / "known.mcap"
    write_dive(known, simulate_dive("straight", seed=1, duration_s=SHORT_S))
    found = [Base(known, weight=12)]
    for name, options in CONTAINERS.items():
        path = folder / f"{name}.mcap"
        path.write_bytes(_rewritten(known.read_bytes(), options))
        found.append(Base(path, protected=name != "bare", weight=6))
    for name, write in BAGS.items():
        path = write(folder / name, known.read_bytes())
        found.append(Base(path, protected=name in PROTECTED, weight=6))
    writers = {
        "cdr": unknown_logs.nested_cdr,
        "json": unknown_logs.bare_json,
        "protobuf": unknown_logs.protobuf,
    }
    return [*found, *(_unknown(folder, name, write) for name, write in writers.items())]


def recorded_logs(folder: Path) -> list[Base]:
    """Give a log that ROS 1 recorded, and what `mcap convert` made of it; none where ../shared is not there."""
    folder.mkdir(exist_ok=True)
    settings = folder / "recorded.toml"
    settings.write_text(
        '[imu]\naxes = "flu"\n[dvl]\naxes = "+z-y+x"\nlever_arm_m = [0.3, -0.5, 0.69]\n[reference]\n'
        'topic = "/rexrov2/pose_gt"\nvelocity_n = "twist.twist.linear"\n[initial]\nlatitude_deg = 38.0\n'
        "[evaluation]\nstarts = 1\n",
        "utf-8",
    )
    found = {name: RECORDED / f"rexrov2_simulated.{name}" for name in ("mcap", "bag")}
    return [
        Base(path, protected=name == "mcap", settings=("-c", str(settings)))
        for name, path in found.items()
        if path.is_file()
    ]


def all_logs(folder: Path) -> list[Base]:
    """Give the short dives, and the longer ones of the project less often."""
    archive = sorted((ROOT / "examples" / "archive" / "dives").glob("*.mcap"))
    samples = sorted((ROOT / "sample_logs").glob("*.mcap"))
    longer = [
        *(Base(path, weight=2) for path in archive),
        *(Base(path, weight=1) for path in samples),
    ]
    return [*short_logs(folder), *longer]


def _rewritten(data: bytes, options: dict[str, object]) -> bytes:
    content, stream = content_of(data), BytesIO()
    writer = Writer(stream, chunk_size=15_000, **options)
    writer.start(profile=content.header.profile, library="attacks")
    schemas = {
        one.id: writer.register_schema(one.name, one.encoding, one.data) for one in content.schemas
    }
    ids = {
        one.id: writer.register_channel(
            one.topic, one.message_encoding, schemas[one.schema_id], one.metadata
        )
        for one in content.channels
    }
    for message in content.messages:
        writer.add_message(
            ids[message.channel_id], message.log_time, message.data, message.publish_time
        )
    writer.finish()
    return stream.getvalue()


def _unknown(folder: Path, name: str, write: Callable[[Path, Dive], None]) -> Base:
    """Write a dive in types of nobody, with the settings that `inspect` proposes and a person completes."""
    path, settings = folder / f"{name}.mcap", folder / f"{name}.toml"
    write(path, unknown_logs.plain_dive("straight"))
    inventory = inspect_log(path, load_config())
    answers = {key: value for key, value in ANSWERS.items() if key in inventory.decisions}
    axes = {
        key: '"flu"' if key == "imu.axes" else '"frd"'
        for key in inventory.decisions
        if key.endswith(".axes")
    }
    settings.write_text(unknown_logs.decided(inventory, answers | axes), "utf-8")
    content = content_of(path.read_bytes())
    first_ns = content.messages[0].log_time
    kept = [message for message in content.messages if message.log_time - first_ns < SHORT_S * 1e9]
    path.write_bytes(
        file_of(replace(content, messages=sorted(kept, key=lambda message: message.log_time)))
    )
    return Base(path, settings=("-c", str(settings)))
