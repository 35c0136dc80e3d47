"""A reference of a type of nobody: its fields by path, with their units and axes, give what a known type gives."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import DEG
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.sim.dive import simulate_dive

Message = dict[str, Any]
Rows = Callable[[ReferenceColumns, int], Message]
ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FLU = np.diag([1, -1, -1])


def by_angles(reference: ReferenceColumns, row: int) -> Message:
    """Write degrees, a depth, a velocity north-east-down, and roll, pitch and heading."""
    latitude, longitude, height = reference.position[row].tolist()
    yaw, pitch, roll = (
        Rotation.from_matrix(reference.mat_nb[row]).as_euler("ZYX", degrees=True).tolist()
    )
    north, east, down = reference.velocity_n[row].tolist()
    return {
        "lat": latitude / DEG, "lon": longitude / DEG, "z": -height, "vn": north, "ve": east, "vd": down,
        "r": roll, "p": pitch, "h": yaw % 360.0,
    }  # fmt: skip


def by_quaternion(reference: ReferenceColumns, row: int) -> Message:
    """Write radians, a height, a velocity east-north-up, and a quaternion from forward-port-up to east-north-up."""
    latitude, longitude, height = reference.position[row].tolist()
    quaternion = Rotation.from_matrix(ENU @ reference.mat_nb[row] @ FLU).as_quat()
    return {
        "lat": latitude, "lon": longitude, "h": height, "v": (ENU @ reference.velocity_n[row]).tolist(),
        "q": dict(zip("xyzw", quaternion.tolist(), strict=True)),
    }  # fmt: skip


ANGLES = [
    "latitude=lat",
    "longitude=lon",
    "depth=z",
    "velocity_n=vn, ve, vd",
    "roll=r",
    "pitch=p",
    "heading=h",
]
QUATERNION = [
    "latitude=lat", "longitude=lon", "height=h", "velocity_n=v", "quaternion=q", "angle_unit=rad", "axes=enu_flu"
]  # fmt: skip


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("figure-eight", seed=2, duration_s=60.0)


def foreign_log(dive: Dive, rows: Rows, path: Path) -> Path:
    """Write a dive whose reference is JSON without a schema."""
    assert dive.reference is not None
    write_dive(path, dive)
    own = path.with_name("foreign.mcap")
    with path.open("rb") as stream, own.open("wb") as file:
        writer, ids = Writer(file), dict[str, int]()
        writer.start()
        for schema, channel, message in make_reader(stream).iter_messages(topics=["/imu", "/dvl"]):
            assert schema
            if channel.topic not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            writer.add_message(
                ids[channel.topic], message.log_time, message.data, message.publish_time
            )
        solution = writer.register_channel("nav/out", "json", 0)
        for row, time_ns in enumerate(dive.reference.time_ns.tolist()):
            writer.add_message(
                solution, time_ns, json.dumps(rows(dive.reference, row)).encode(), time_ns
            )
        writer.finish()
    return own


def settings(named: list[str]) -> list[str]:
    return ["reference.topic=nav/out", *(f"reference.{setting}" for setting in named)]


@pytest.mark.parametrize(
    ("rows", "named"),
    [(by_angles, ANGLES), (by_quaternion, QUATERNION), (by_quaternion, QUATERNION[:-1])],
)
def test_fields_give_what_a_known_type_gives(
    rows: Rows, named: list[str], dive: Dive, tmp_path: Path
) -> None:
    log = foreign_log(dive, rows, tmp_path / "dive.mcap")
    known = read_dive(tmp_path / "dive.mcap", load_config()).reference
    found = read_dive(log, load_config(overrides=settings(named))).reference
    assert known is not None
    assert found is not None
    np.testing.assert_array_equal(found.time_ns, known.time_ns)
    np.testing.assert_allclose(found.position[:, :2], known.position[:, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.position[:, 2], known.position[:, 2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.velocity_n, known.velocity_n, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.mat_nb, known.mat_nb, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("named", "sentence", "hint"),
    [
        (["latitude=lat"], "has latitude, but no longitude", "reference.longitude"),
        (["roll=r", "heading=h"], "has heading and roll, but no pitch", "reference.pitch"),
        (
            ["latitude=lat", "longitude=lon", "angle_unit=rad"],
            "latitudes are beyond the poles",
            "reference.angle_unit",
        ),
        (["latitude=lat", "longitude=lom"], "lom", "lon"),
    ],
)
def test_fields_that_say_nothing_are_refused(
    named: list[str], sentence: str, hint: str, dive: Dive, tmp_path: Path
) -> None:
    log = foreign_log(dive, by_angles, tmp_path / "dive.mcap")
    with pytest.raises(LogError, match=sentence) as refused:
        read_dive(log, load_config(overrides=settings(named)))
    assert hint in refused.value.hint


def test_inspect_proposes_the_fields(dive: Dive, tmp_path: Path) -> None:
    log = foreign_log(dive, by_angles, tmp_path / "dive.mcap")
    inventory = inspect_log(log, load_config())
    assert not inventory.remaining
    proposed = tmp_path / "proposed.toml"
    proposed.write_text(inventory.configuration, "utf-8")
    reference = load_config(file=proposed).reference
    chosen = {
        name: getattr(reference, name)
        for name in ("topic", "latitude", "longitude", "velocity_n", "stamp")
    }
    assert chosen == {
        "topic": "nav/out", "latitude": "lat", "longitude": "lon", "velocity_n": "vn, ve, vd", "stamp": "log_time"
    }  # fmt: skip
    assert "reference.topic" in inventory.decisions


def partly(reference: ReferenceColumns, row: int) -> Message:
    """Write a position with an altitude above the bottom, half an attitude and half a velocity."""
    message = by_angles(reference, row)
    return {
        "lat": message["lat"],
        "lon": message["lon"],
        "altitude": 12.0,
        "roll": 0.1,
        "vel_north": 1.0,
        "depth": 3.0,
    }


def test_inspect_proposes_no_altitude_as_height_and_no_half_attitude(
    dive: Dive, tmp_path: Path
) -> None:
    inventory = inspect_log(foreign_log(dive, partly, tmp_path / "dive.mcap"), load_config())
    proposed = tomllib.loads(inventory.configuration)["reference"]
    assert proposed.keys() == {"topic", "latitude", "longitude", "depth", "angle_unit", "stamp"}


def test_fields_without_a_topic_are_not_ignored(dive: Dive, tmp_path: Path) -> None:
    log = foreign_log(dive, by_angles, tmp_path / "dive.mcap")
    with pytest.raises(LogError, match="has no topic for the reference") as refused:
        read_dive(
            log, load_config(overrides=["reference.latitude=lat", "reference.longitude=lon"])
        )
    assert 'reference.topic = "/topic"' in refused.value.hint
