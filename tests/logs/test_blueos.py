"""What BlueOS records: files of types without those in them, thousands of topics, an IMU that is too slow."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbag_messages import START_NS, imu_messages, serialised, store_with

from insdvl_replay.core.config import Config, Dvl
from insdvl_replay.core.errors import LogError
from insdvl_replay.document.render import render
from insdvl_replay.inspection.inventory import inspection_result, inventory_tables
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.definitions import definition_text, definitions_of

IMU_TYPE = "sensor_msgs/msg/Imu"
BARE = definition_text(IMU_TYPE).split("=" * 80)[0]
FIELDS = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag", "time_usec")
NAMES = ("RAW_IMU", "ATTITUDE", *(f"MESSAGE_{n}" for n in range(60)))


def blueos(path: Path, *, with_imu: bool) -> Path:
    """Write MAVLink as mavlink-server does, a topic for each message and one for each field; CDR by the bare file."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name in NAMES:
            topics = {
                f"mavlink/1/1/{name}": b'{"header": {"system_id": 1}, "message": {"xacc": NaN}}'
            }
            topics |= {f"mavlink/1/1/{name}/{field}": b"5" for field in FIELDS}
            for topic, data in topics.items():
                channel = writer.register_channel(topic, "json", 0)
                for i in range(3):
                    writer.add_message(
                        channel, START_NS + 500_000_000 * i, data, START_NS + 500_000_000 * i
                    )
        if with_imu:
            schema = writer.register_schema(IMU_TYPE, "ros2msg", BARE.encode())
            channel = writer.register_channel("imu", "cdr", schema)
            store = store_with({})
            for _, _, time_s, values in imu_messages():
                time_ns = START_NS + round(time_s * 1e9)
                writer.add_message(channel, time_ns, serialised(store, IMU_TYPE, values), time_ns)
        schema = writer.register_schema("geometry_msgs/msg/TwistStamped", "jsonschema", b"{}")
        channel = writer.register_channel("dvl", "json", schema)
        for i in range(20):
            stamp = {"sec": START_NS // 10**9, "nanosec": 100_000_000 * i % 10**9}
            stamp["sec"] += i // 10
            ping = {
                "header": {"stamp": stamp},
                "twist": {"linear": {"x": 1.0 + 0.01 * i, "y": 0.0, "z": 0.0}},
            }
            time_ns = START_NS + 100_000_000 * i
            writer.add_message(channel, time_ns, json.dumps(ping).encode(), time_ns)
        writer.finish()
    return path


def test_types_that_a_schema_lacks_are_those_of_the_program(tmp_path: Path) -> None:
    dive = read_dive(blueos(tmp_path / "recorder.mcap", with_imu=True), Config())
    expected = [values["angular_velocity"]["z"] for _, _, _, values in imu_messages()]
    np.testing.assert_array_equal(dive.imu.angular_rate_b[:, 2], expected)
    assert len(dive.dvl.time_ns) == 20
    (note,) = (note for note in dive.notes if note.code == "builtin_definition")
    assert "geometry_msgs/msg/Quaternion" in note.text
    assert "std_msgs/msg/Header" in note.text


@pytest.mark.parametrize("text", ["", IMU_TYPE, "sensor_msgs/Imu\n", f"MSG: {IMU_TYPE}"])
@pytest.mark.parametrize("language", ["ros2msg", "ros2idl"])
def test_schema_that_holds_its_name_alone_is_that_of_the_program(text: str, language: str) -> None:
    assert definitions_of(IMU_TYPE, text, "cdr", language) == definitions_of(
        IMU_TYPE, definition_text(IMU_TYPE), "cdr"
    )


def test_type_that_nobody_defines_is_still_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="uses pkg/msg/Unknown in pkg/msg/A and does not define it"):
        definitions_of("pkg/msg/A", "std_msgs/Header header\nUnknown thing", "cdr")


def test_thousands_of_topics_are_folded_for_people_and_whole_for_scripts(tmp_path: Path) -> None:
    inventory = inspect_log(blueos(tmp_path / "recorder.mcap", with_imu=True), Config())
    (table,) = (table for table in inventory_tables(inventory) if table.title.startswith("Topics"))
    shown: list[Any] = [row[0][0] for row in table.rows]
    assert len(inventory.topics) == len(NAMES) * 11 + 2
    assert "mavlink/1/1/RAW_IMU/*" in shown
    assert {"imu", "dvl"} <= set(shown)
    assert "mavlink/1/1/RAW_IMU/xacc" not in shown
    assert len(shown) == len(NAMES) + 3  # the messages themselves are folded, too
    (folded,) = (row for row in table.rows if row[0][0] == "mavlink/1/1/RAW_IMU/*")
    assert folded[0][1] == "  10 topics, json"
    assert folded[2] == "30"
    assert render(inspection_result(inventory), "csv").count("mavlink/1/1/RAW_IMU/") == 10


def test_imu_of_telemetry_is_too_slow_and_the_file_with_all_of_it_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="mavlink/1/1/RAW_IMU is telemetry and too slow") as raised:
        read_dive(blueos(tmp_path / "recorder.mcap", with_imu=False), Config())
    assert ".BIN" in raised.value.hint
    assert "LOG_REPLAY" in raised.value.hint


def vision(i: int, velocity: tuple[float, float, float]) -> dict[str, bytes]:
    """Give what the DVL's extension of BlueOS sends, by its templates."""
    time_us, confidence = (125_000 + 1000 * i, 0.0 if i == 5 else 97.5)
    way = [speed * time_us * 1e-6 for speed in velocity]
    delta = {
        "type": "VISION_POSITION_DELTA",
        "time_usec": 0,
        "time_delta_usec": time_us,
        "angle_delta": [0, 0, 0.01],
    }
    speed = {
        "type": "VISION_SPEED_ESTIMATE",
        "usec": 1000 * i,
        **dict(zip("xyz", velocity, strict=True)),
    }
    found = {}
    for message in (delta | {"position_delta": way, "confidence": confidence}, speed):
        topic = f"mavlink/255/0/{message['type']}"
        found[topic] = json.dumps({"header": {"system_id": 255}, "message": message}).encode()
        found[f"{topic}/time_usec"] = b"0"
    return found


def test_ways_of_a_dvl_in_mavlink_are_velocities(tmp_path: Path) -> None:
    velocities = [(1.0 + 0.1 * i, 0.2 - 0.01 * i, 0.01 * i) for i in range(20)]
    path = tmp_path / "recorder.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(
            "imu", "cdr", writer.register_schema(IMU_TYPE, "ros2msg", BARE.encode())
        )
        store = store_with({})
        for _, _, time_s, values in imu_messages():
            time_ns = START_NS + round(time_s * 1e9)
            writer.add_message(channel, time_ns, serialised(store, IMU_TYPE, values), time_ns)
        ids = {
            topic: writer.register_channel(topic, "json", 0) for topic in vision(0, velocities[0])
        }
        for i, velocity in enumerate(velocities):
            for topic, data in vision(i, velocity).items():
                writer.add_message(
                    ids[topic], START_NS + 100_000_000 * i, data, START_NS + 100_000_000 * i
                )
        writer.finish()
    dive = read_dive(path, Config())
    kept = [i for i in range(20) if i != 5]
    assert dive.dvl.velocity_d is not None
    np.testing.assert_allclose(
        dive.dvl.velocity_d, np.array(velocities)[kept], rtol=1e-12, atol=1e-15
    )
    np.testing.assert_array_equal(dive.dvl.time_ns, START_NS + 100_000_000 * np.array(kept))
    assert {note.code: note.count for note in dive.notes}["dvl_invalid"] == 1
    named = read_dive(path, Config(dvl=Dvl(topic="mavlink/255/0/VISION_SPEED_ESTIMATE")))
    assert named.dvl.velocity_d is not None
    np.testing.assert_allclose(named.dvl.velocity_d, velocities, rtol=1e-12)
