"""Messages of types whose definitions come with the tool, as bytes that rosbags wrote, in logs of MCAP."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from insdvl_replay.logs.formats.definitions import definition_text

START_NS = 1_700_000_000_000_000_000
Message = tuple[str, str, float, dict[str, Any]]
"""Topic, type, time in s, and what it holds; what is left out is zero."""
UUV = "uuv_sensor_ros_plugins_msgs"
UUV_COPIES = ("stonefish_ros", "stonefish_ros2", "mvp_msgs", "cola2_msgs")
"""Packages with the same fields, whose definitions do not come with the tool."""
OF_LOGS_ALONE = {
    "dvl_driver/msg/DVL": "std_msgs/Header header\nstring time\nfloat32[4] velocity\n",
    "mil_msgs/msg/VelocityMeasurements": "std_msgs/Header header\nVelocityMeasurement[] velocity_measurements\n"
    + "=" * 80
    + "\nMSG: mil_msgs/VelocityMeasurement\ngeometry_msgs/Vector3 direction\nfloat64 velocity\n",
}
"""What the reader needs of types whose definitions do not come with the tool."""


def text_of(type_name: str) -> str:
    """Return a type's definition: that of the tool, or where none comes with it, one that only the log has."""
    package = type_name.partition("/")[0]
    if package in UUV_COPIES:
        return definition_text(f"{UUV}/msg/DVL").replace(UUV, package)
    return OF_LOGS_ALONE.get(type_name) or definition_text(type_name)


def store_with(texts: Mapping[str, str]) -> Typestore:
    """Make a store of types that knows those of some texts as well as those of ROS 2 Humble."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for type_name, whole in texts.items():
        first, *others = whole.split("=" * 80 + "\nMSG: ")
        found = dict(get_types_from_msg(first, type_name))
        for text in others:
            name, _, fields = text.partition("\n")
            found |= get_types_from_msg(fields, name.replace("/", "/msg/"))
        store.register({name: fields for name, fields in found.items() if name not in store.types})
    return store


def serialised(store: Typestore, type_name: str, values: dict[str, Any]) -> bytes:
    """Have rosbags write a message."""
    return bytes(store.serialize_cdr(_made(store, type_name, values), type_name))


def _made(store: Typestore, type_name: str, values: dict[str, Any]) -> Any:
    fields = store.get_msgdef(type_name).fields
    unknown = values.keys() - {name for name, _ in fields}
    assert not unknown, f"{type_name} has no {unknown}"
    return store.types[type_name](
        **{name: _value(store, kind, values.get(name)) for name, kind in fields}
    )


def _value(store: Typestore, kind: tuple[int, Any], value: Any) -> Any:
    node, argument = kind
    if int(node) == 1:  # a primitive
        name = argument[0]
        return (
            ("" if name == "string" else np.dtype(name).type(0).item()) if value is None else value
        )
    if int(node) == 2:  # a structure
        return _made(store, argument, value or {})
    inner, length = argument
    if int(inner[0]) == 1 and inner[1][0] == "string":
        return [""] * length if value is None else value
    if int(inner[0]) == 1:
        return np.array(np.zeros(length) if value is None else value, dtype=inner[1][0])
    return [_value(store, inner, item) for item in (value if value is not None else [{}] * length)]


def header(time_s: float) -> dict[str, Any]:
    """Give a header with its stamp."""
    time_ns = START_NS + round(time_s * 1e9)
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": "link"}


def xyz(vector: Any) -> dict[str, float]:
    """Give a vector's components by name."""
    return dict(zip("xyz", np.asarray(vector, float).tolist(), strict=True))


def write_log(
    path: Path,
    messages: Iterable[Message],
    schema_name: str | None = None,
    texts: Mapping[str, str] | None = None,
) -> Path:
    """Write messages as rosbags serialises them.

    A schema name stands in the place of that of the type on ``/dvl``, texts in the place of the definitions of types.
    """
    messages = list(messages)
    types = {topic: type_name for topic, type_name, _, _ in messages}
    defined = {name: (texts or {}).get(name) or text_of(name) for name in types.values()}
    store = store_with(defined)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        ids = {}
        for topic, type_name in types.items():
            name = schema_name if schema_name and topic == "/dvl" else type_name
            schema = writer.register_schema(name, "ros2msg", defined[type_name].encode())
            ids[topic] = writer.register_channel(topic, "cdr", schema)
        for topic, type_name, time_s, values in messages:
            time_ns = START_NS + round(time_s * 1e9)
            writer.add_message(ids[topic], time_ns, serialised(store, type_name, values), time_ns)
        writer.finish()
    return path


def imu_messages(count: int = 200) -> list[Message]:
    """Give an IMU at rest but for a swing, forward-starboard-down, at 100 Hz."""
    return [
        (
            "/imu",
            "sensor_msgs/msg/Imu",
            0.01 * i,
            {
                "header": header(0.01 * i),
                "linear_acceleration": xyz((0.01 * np.sin(0.1 * i), 0.2, -9.8)),
                "angular_velocity": xyz((0.01, 0.02, 0.001 * i)),
            },
        )
        for i in range(count)
    ]
