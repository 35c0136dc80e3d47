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
    """What a log says: the types of its topics, in both languages, and its messages in the order of its file."""

    log: bytes
    types: dict[str, str]
    ros2: Typestore
    ros1: Typestore

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Go through topics, log times and payloads."""
        for _, channel, message in make_reader(BytesIO(self.log)).iter_messages(
            log_time_order=False
        ):
            yield channel.topic, message.log_time, message.data

    def messages_of_ros1(self) -> Iterator[tuple[str, int, bytes]]:
        """Go through the same in the encoding of ROS 1."""
        for topic, time_ns, data in self.messages():
            yield topic, time_ns, bytes(self.ros2.cdr_to_ros1(data, self.types[topic]))


def told(log: bytes = b"") -> Told:
    """Find what a log in CDR says, or a short dive."""
    found = Told(
        log or written(), {}, get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
    )
    summary = make_reader(BytesIO(found.log)).get_summary()
    assert summary
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        found.types[channel.topic] = schema.name
        for name, text in _sections(schema.name, schema.data.decode()):
            known = get_types_from_msg(text, name)
            for store in (found.ros1, found.ros2):
                store.register(
                    {one: fields for one, fields in known.items() if one not in store.fielddefs}
                )
    return found


def _sections(name: str, text: str) -> Iterator[tuple[str, str]]:
    first, *others = text.split("=" * 80 + "\n")
    yield name, first
    for other in others:
        heading, _, section = other.partition("\n")
        yield heading.removeprefix("MSG: ").replace("/", "/msg/"), section


def ros1_mcap(path: Path, log: bytes = b"") -> Path:
    """Write it as `mcap convert` writes a .bag."""
    found = told(log)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1", library="tests")
        ids = {}
        for topic, type_name in found.types.items():
            text = found.ros1.generate_msgdef(type_name)[0].encode()
            schema = writer.register_schema(type_name.replace("/msg/", "/"), "ros1msg", text)
            ids[topic] = writer.register_channel(topic, "ros1", schema)
        for topic, time_ns, data in found.messages_of_ros1():
            writer.add_message(ids[topic], time_ns, data, time_ns)
        writer.finish()
    return path


def bag(path: Path, compression: str = "", log: bytes = b"") -> Path:
    """Write it as a .bag, its chunks compressed with `bz2`, `lz4` or nothing."""
    found, writer = told(log), rosbag1.Writer(path)
    if compression:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    with writer:
        items = found.types.items()
        connections = {
            topic: writer.add_connection(topic, name, typestore=found.ros1)
            for topic, name in items
        }
        for topic, time_ns, data in found.messages_of_ros1():
            writer.write(connections[topic], time_ns, data)
    return path


def ros2_bag(
    folder: Path, plugin: str = "sqlite3", log: bytes = b"", *, humble: bool = False
) -> Path:
    """Write it as a bag folder with one part, `sqlite3` or `mcap`, of Iron with definitions, or of Humble without."""
    found = told(log)
    with rosbag2.Writer(
        folder, version=9, storage_plugin=rosbag2.StoragePlugin[plugin.upper()]
    ) as writer:
        items = found.types.items()
        connections = {
            topic: writer.add_connection(topic, name, typestore=found.ros2)
            for topic, name in items
        }
        for topic, time_ns, data in found.messages():
            writer.write(connections[topic], time_ns, data)
    if humble:
        _as_of_humble(folder / f"{folder.name}.db3")
    return folder


def _as_of_humble(part: Path) -> None:
    """Take out what Iron added; rosbags writes nothing older."""
    base = sqlite3.connect(part)
    for table in ("schema", "metadata", "message_definitions"):
        base.execute(f"DROP TABLE {table}")
    base.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    base.execute("VACUUM")
    base.close()
