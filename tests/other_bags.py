"""A log written again by rosbags in the containers and encodings of others: ROS 1 in MCAP, .db3 and .bag."""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from small_logs import written


@dataclass(frozen=True)
class Told:
    """A message of a log."""

    topic: str
    type_name: str
    log_time: int
    data: bytes


def told(log: bytes = b"") -> tuple[list[Told], Typestore, Typestore]:
    """Take the messages out of a log, in the order of its file, with the types of ROS 2 and of ROS 1 in it."""
    ros2, ros1, found = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC), []
    for schema, channel, message in make_reader(BytesIO(log or written())).iter_messages(log_time_order=False):
        assert schema
        first, *others = schema.data.decode().split("=" * 80 + "\n")
        texts = {schema.name: first} | {one.partition("\n")[0].removeprefix("MSG: "): one for one in others}
        for name, text in texts.items():
            full = name if "/msg/" in name else name.replace("/", "/msg/")
            known = get_types_from_msg(text.partition("\n")[2] if text.startswith("MSG:") else text, full)
            for store in (ros1, ros2):
                store.register({one: fields for one, fields in known.items() if one not in store.fielddefs})
        found.append(Told(channel.topic, schema.name, message.log_time, message.data))
    return found, ros2, ros1


def _topics(messages: list[Told]) -> dict[str, str]:
    return {one.topic: one.type_name for one in messages}


def ros1_mcap(log: bytes = b"") -> bytes:
    """Write it as `mcap convert` writes a .bag."""
    messages, ros2, ros1 = told(log)
    stream = BytesIO()
    writer = Writer(stream, chunk_size=15_000)
    writer.start(profile="ros1", library="tests")
    ids = {}
    for topic, type_name in _topics(messages).items():
        text = ros1.generate_msgdef(type_name)[0].encode()
        schema = writer.register_schema(type_name.replace("/msg/", "/"), "ros1msg", text)
        ids[topic] = writer.register_channel(topic, "ros1", schema)
    for one in messages:
        data = bytes(ros2.cdr_to_ros1(one.data, one.type_name))
        writer.add_message(ids[one.topic], one.log_time, data, one.log_time)
    writer.finish()
    return stream.getvalue()


def bag(path: Path, compression: str = "", log: bytes = b"") -> Path:
    """Write it as a .bag, its chunks compressed with `bz2`, `lz4` or nothing."""
    messages, ros2, ros1 = told(log)
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    with writer:
        topics = _topics(messages).items()
        connections = {topic: writer.add_connection(topic, name, typestore=ros1) for topic, name in topics}
        for one in messages:
            data = ros2.cdr_to_ros1(one.data, one.type_name)
            writer.write(connections[one.topic], one.log_time, bytes(data))
    return path


def db3(folder: Path, log: bytes = b"", *, humble: bool = False, plugin: str = "sqlite3") -> Path:
    """Write it as a bag folder with one part, of Iron with definitions, or of Humble without."""
    messages, ros2, _ = told(log)
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[plugin.upper()]) as writer:
        topics = _topics(messages).items()
        connections = {topic: writer.add_connection(topic, name, typestore=ros2) for topic, name in topics}
        for one in messages:
            writer.write(connections[one.topic], one.log_time, one.data)
    if humble:
        (part,) = folder.glob("*.db3")
        _as_of_humble(part)
    return folder


def _as_of_humble(part: Path) -> None:
    """Take out what Iron added; rosbags writes nothing older."""
    with sqlite3.connect(part) as base:
        for table in ("schema", "metadata", "message_definitions"):
            base.execute(f"DROP TABLE {table}")
        base.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    base.execute("VACUUM")
    base.close()


def parts_of(folder: Path) -> Iterator[Path]:
    """Go through the parts of a bag."""
    return (path for path in sorted(folder.iterdir()) if path.suffix in (".db3", ".mcap"))
