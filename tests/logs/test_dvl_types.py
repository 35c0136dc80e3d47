"""Each known type of a DVL, as rosbags and protobuf's own library write it, gives the velocity that was put in."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer
from rosbag_messages import (
    OF_LOGS_ALONE,
    START_NS,
    UUV_COPIES,
    header,
    imu_messages,
    serialised,
    store_with,
    write_log,
    xyz,
)
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry import frames
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.topics import TYPES
from insdvl_replay.logs.formats.definitions import definition_text

TIMES = 0.1 * np.arange(20)
TRUE_D = np.stack(
    [1.0 + 0.1 * np.sin(TIMES), 0.1 * np.cos(2.0 * TIMES) + 0.2, 0.05 * np.cos(TIMES)], axis=1
)
"""Velocities forward-starboard-down at the times of the pings."""
JANUS = frames.beam_vectors(30.0, (45.0, 135.0, 225.0, 315.0))
A50 = frames.beam_vectors(22.5, (135.0, 225.0, 315.0, 45.0))
FLU = np.array([1.0, -1.0, -1.0])
Ping = Callable[[int], dict[str, Any]]


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Dive]:
    def read_pings(
        type_name: str, ping: Ping, schema_name: str | None = None, **settings: Any
    ) -> Dive:
        pings = [
            ("/dvl", type_name, float(TIMES[i]), {"header": header(TIMES[i])} | ping(i))
            for i in range(len(TIMES))
        ]
        path = write_log(tmp_path / "dive.mcap", [*imu_messages(), *pings], schema_name)
        return read_dive(path, Config(dvl=Dvl(**settings)))

    return read_pings


def by_velocity(dive: Dive) -> Any:
    assert dive.dvl.velocity_d is not None
    return dive.dvl.velocity_d


def by_beams(dive: Dive) -> Any:
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    return frames.solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0]


def codes(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


def apl(i: int) -> dict[str, Any]:
    return {
        "velocity_mode": 2 if i == 3 else 1,
        "velocity": xyz(TRUE_D[i]),
        "num_good_beams": 4,
        "beam_velocities_valid": True,
        "beam_unit_vec": [xyz(vector) for vector in JANUS],
        "beam_velocity": JANUS @ TRUE_D[i],
    }


def a50(i: int) -> dict[str, Any]:
    speeds = A50 @ TRUE_D[i]
    return {
        "time": 100.0,
        "velocity": xyz(TRUE_D[i]),
        "velocity_valid": True,
        "fom": 0.002,
        "beams": [
            {"id": n, "velocity": speeds[n], "valid": not (i == 3 and n == 1)} for n in range(4)
        ],
    }


@pytest.mark.parametrize(
    "name", ["acoustic_msgs/msg/Dvl", "acoustic_msgs/Dvl", "marine_acoustic_msgs/Dvl"]
)
def test_alias_with_and_without_msg_in_its_name(name: str, read: Any) -> None:
    dive = read("acoustic_msgs/msg/Dvl", apl, name)
    np.testing.assert_allclose(by_beams(dive), np.delete(TRUE_D, 3, axis=0), atol=1e-6)
    assert codes(dive)["dvl_water_track"] == 1


def test_water_linked(read: Any) -> None:
    dive = read("waterlinked_a50_ros_driver/msg/DVL", a50, "waterlinked_a50_ros_driver/DVL")
    np.testing.assert_allclose(by_beams(dive), TRUE_D, atol=1e-12)
    np.testing.assert_array_equal(np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)), [[3, 1]])
    np.testing.assert_array_equal(
        dive.dvl.time_ns, START_NS + np.rint(TIMES * 1e9).astype(np.int64)
    )


def test_early_water_linked_without_beams_and_figure_of_merit(tmp_path: Path) -> None:
    name = "waterlinked_a50_ros_driver/msg/DVL"
    early = definition_text(name).replace("DVLBeam[] beams\n", "").replace("float64 fom\n", "")
    pings = [
        (
            "/dvl",
            name,
            time_s,
            {"header": header(time_s), "velocity": xyz(TRUE_D[i]), "velocity_valid": i != 4},
        )
        for i, time_s in enumerate(TIMES.tolist())
    ]
    dive = read_dive(
        write_log(tmp_path / "early.mcap", [*imu_messages(), *pings], texts={name: early}),
        Config(),
    )
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, 4, axis=0), atol=1e-12)
    assert codes(dive)["dvl_invalid"] == 1


def test_the_altitude_is_the_instruments_else_that_of_its_beams(read: Any) -> None:
    own = read(
        "acoustic_msgs/msg/Dvl",
        lambda i: apl(i) | {"altitude": 0.0 if i == 5 else 4.0 + i, "range": [30.0] * 4},
    )
    expected = np.delete([np.nan if i == 5 else 4.0 + i for i in range(len(TIMES))], 3)
    np.testing.assert_array_equal(own.dvl.altitude_m, expected)

    def with_ranges(i: int) -> dict[str, Any]:
        ping = a50(i)
        for number, beam in enumerate(ping["beams"]):
            beam["distance"] = -1.0 if number == 2 else 10.0 + number
            if i == 7:
                beam["distance"] = 0.0
        return ping

    by_ranges = read("waterlinked_a50_ros_driver/msg/DVL", with_ranges)
    below_m = np.cos(np.deg2rad(22.5)) * (10.0 + 11.0 + 13.0) / 3.0
    known = np.arange(len(TIMES)) != 7
    np.testing.assert_allclose(by_ranges.dvl.altitude_m[known], below_m)
    assert np.isnan(by_ranges.dvl.altitude_m[7])
    part = by_ranges.dvl.rows(~known)
    assert len(part.altitude_m) == 1, "it is kept with its ping"


# The family of the UUV Simulator

UUV = [name for name, known in TYPES["dvl_beams"].items() if "beam_quaternions" in known.fields]


def quaternion_along(vector: Any) -> dict[str, float]:
    """Turn the x axis along a vector."""
    rotation = Rotation.align_vectors([vector], [[1.0, 0.0, 0.0]])[0]
    return dict(zip("xyzw", rotation.as_quat().tolist(), strict=True))


def as_the_simulator(quaternion: dict[str, float]) -> dict[str, float]:
    """Write the turn as the UUV Simulator does: its axis, of length 1, in the place of the vector part."""
    vector = np.array([quaternion[axis] for axis in "xyz"])
    return xyz(vector / np.linalg.norm(vector)) | {"w": quaternion["w"]}


def uuv(i: int, vectors: Any = JANUS, made: Any = quaternion_along) -> dict[str, Any]:
    speeds = vectors @ TRUE_D[i]
    return {
        "velocity": xyz(TRUE_D[i]),
        "velocity_covariance": [-1.0 if i == 5 else 1e-4] + [0.0] * 8,
        "altitude": -1.0 if i == 6 else 12.0,
        "beams": [
            {
                "range": 14.0,
                "velocity": speeds[n],
                "velocity_covariance": -1.0 if (i, n) == (7, 2) else 0.0,
                "pose": {"pose": {"orientation": made(vector)}},
            }
            for n, vector in enumerate(vectors)
        ],
    }


def test_family_has_its_names() -> None:
    packages = {name.partition("/")[0] for name in UUV}
    assert packages >= {
        "uuv_sensor_ros_plugins_msgs",
        "uuv_sensor_plugins_ros_msgs",
        "smarc_msgs",
        "stonefish_ros",
        "stonefish_ros2",
        "mvp_msgs",
        "dvl1000_ros",
    }


@pytest.mark.parametrize("name", [name for name in UUV if not name.startswith("dvl1000")])
def test_beams_of_the_family_point_where_their_poses_say(name: str, read: Any) -> None:
    """Beams are unlike any default: tilted by 30, 25, 20 and 30 deg at odd azimuths, so that only poses can tell."""
    vectors = np.concatenate(
        [frames.beam_vectors(30.0 - 5.0 * n, (10.0 + 90.0 * n,)) for n in range(3)] + [JANUS[3:]]
    )
    dive = read(name, lambda i: uuv(i, vectors))
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, vectors, atol=1e-12)
    np.testing.assert_allclose(by_beams(dive), np.delete(TRUE_D, [5, 6], axis=0), atol=1e-12)
    np.testing.assert_array_equal(np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)), [[5, 2]])
    assert codes(dive)["dvl_lost"] == codes(dive)["dvl_invalid"] == 1


def test_turns_that_the_simulator_writes_by_their_axis_are_understood(read: Any) -> None:
    made = lambda vector: as_the_simulator(quaternion_along(vector))  # noqa: E731
    dive = read("uuv_sensor_ros_plugins_msgs/msg/DVL", lambda i: uuv(i, JANUS, made))
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-9)


def test_velocities_are_used_where_a_simulator_leaves_its_beams_at_zero(read: Any) -> None:
    def ping(i: int) -> dict[str, Any]:
        values = uuv(i)
        return values | {"beams": [beam | {"velocity": 0.0} for beam in values["beams"]]}

    dive = read("uuv_sensor_ros_plugins_msgs/msg/DVL", ping)
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, [5, 6], axis=0), atol=1e-12)
    assert {"dvl_no_beams", "dvl_invalid", "dvl_lost"} <= codes(dive).keys()
    dive = read("stonefish_ros2/msg/DVL", lambda i: uuv(i) | {"beams": []})
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, [5, 6], axis=0), atol=1e-12)


def test_link_that_looks_down_with_its_x_axis_is_noticed_and_can_be_reported(read: Any) -> None:
    """As RexROV's: x down, y port, z forward."""
    to_link = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])

    def ping(i: int) -> dict[str, Any]:
        values = uuv(i, JANUS @ to_link.T)
        for n, beam in enumerate(values["beams"]):
            beam["velocity"] = float(JANUS[n] @ TRUE_D[i])
        return values | {"velocity": xyz(to_link @ TRUE_D[i])}

    assert "dvl_beams_not_down" in codes(read("mvp_msgs/msg/DVL", ping))

    def at_zero(i: int) -> dict[str, Any]:
        values = ping(i)
        return values | {"beams": [beam | {"velocity": 0.0} for beam in values["beams"]]}

    assert {"dvl_beams_not_down", "dvl_no_beams"} <= codes(
        read("mvp_msgs/msg/DVL", at_zero)
    ).keys()
    assert "dvl_beams_not_down" not in codes(read("mvp_msgs/msg/DVL", at_zero, axes="+z-y+x"))
    dive = read("mvp_msgs/msg/DVL", ping, axes="+z-y+x")
    assert "dvl_beams_not_down" not in codes(dive)
    np.testing.assert_allclose(by_beams(dive), np.delete(TRUE_D, [5, 6], axis=0), atol=1e-9)


# Others in CDR


def test_labust(read: Any) -> None:
    dive = read(
        "uuv_sensor_msgs/msg/DVL",
        lambda i: {
            "velocity": xyz(TRUE_D[i]),
            "velocity_reference": 2 if i == 4 else 3,
            "beam_ranges": [1.0] * 4,
        },
    )
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, 4, axis=0), atol=1e-12)
    assert codes(dive)["dvl_water_track"] == 1


def dave(i: int) -> dict[str, Any]:
    speeds, axes = JANUS @ TRUE_D[i], JANUS * FLU
    lost = [(i, n) == (2, 1) for n in range(4)]
    return {
        "type": "DVL_TYPE_PISTON",
        "target": {"type": "DVL_TARGET_BOTTOM", "range": 10.0},
        "velocity": {"twist": {"linear": xyz(TRUE_D[i] * FLU)}},
        "beams": [
            {
                "id": n,
                "reference": "DVL_REFERENCE_SHIP",
                "locked": not lost[n],
                "velocity": {} if lost[n] else {"twist": {"linear": xyz(axes[n] * speeds[n])}},
            }
            for n in range(4)
        ],
    }


def test_dave(read: Any) -> None:
    dive = read("dave_interfaces/msg/DVL", dave)
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-9)
    np.testing.assert_allclose(by_beams(dive), TRUE_D, atol=1e-9)
    np.testing.assert_array_equal(np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)), [[2, 1]])


def test_dave_at_rest_reports_no_directions(read: Any) -> None:
    dive = read(
        "dave_interfaces/msg/DVL",
        lambda i: {
            "velocity": {"twist": {"linear": xyz(1e-3 * TRUE_D[i] * FLU)}},
            "beams": [{"locked": True}] * 4,
        },
    )
    np.testing.assert_allclose(by_velocity(dive), 1e-3 * TRUE_D, atol=1e-12)


@pytest.mark.parametrize("number", [np.nan, -np.inf, 1e300])
def test_numbers_of_a_damaged_log_are_lost_or_refused_and_never_a_traceback(
    number: float, read: Any
) -> None:
    def damaged_dave(i: int) -> dict[str, Any]:
        values = dave(i)
        if i == 6:
            values["beams"][0]["velocity"] = {"twist": {"linear": xyz([number, number, number])}}
        return values

    def damaged_uuv(i: int) -> dict[str, Any]:
        values = uuv(i)
        for beam in values["beams"]:
            beam["pose"] = {"pose": {"orientation": xyz([number] * 3) | {"w": number}}}
        return values

    dive = read("dave_interfaces/msg/DVL", damaged_dave)
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-9)
    good = np.arange(20) != 6
    np.testing.assert_allclose(by_beams(dive)[good], TRUE_D[good], atol=1e-9)
    dive = read("mvp_msgs/msg/DVL", damaged_uuv)
    assert "dvl_beam_geometry" in codes(dive)


def test_mil(read: Any) -> None:
    def ping(i: int) -> dict[str, Any]:
        speeds = JANUS @ TRUE_D[i]
        return {
            "velocity_measurements": [
                {
                    "direction": xyz(JANUS[n] * FLU),
                    "velocity": np.nan if (i, n) == (3, 2) else float(speeds[n]),
                }
                for n in range(4)
            ]
        }

    dive = read("mil_msgs/msg/VelocityMeasurements", ping, "mil_msgs/VelocityMeasurements")
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-12)
    np.testing.assert_allclose(by_beams(dive), TRUE_D, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("nortek_dvl/msg/Dvl", "velocity"),
        ("riptide_msgs/msg/Dvl", "velocity"),
        ("nortek_dvl/msg/ButtomTrack", "speed"),
    ],
)
def test_nortek_by_sentences(name: str, field: str, read: Any) -> None:
    dive = read(name, lambda i: {field: xyz([-32.768] * 3 if i in (2, 3, 9) else TRUE_D[i])})
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, [2, 3, 9], axis=0), atol=1e-12)
    # They are no impossible velocities, of which a warning would be told.
    assert codes(dive) == {"dvl_not_finite": 3}


def test_the_least_16_bits_in_mm_per_s_stand_for_no_velocity(read: Any) -> None:
    dive = read(
        "nortek_dvl/msg/ButtomTrack",
        lambda i: {"speed": xyz([-32768.0] * 3 if i in (2, 3, 9) else 1e3 * TRUE_D[i])},
        velocity_unit="mm/s",
    )
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, [2, 3, 9], axis=0), atol=1e-12)
    # They are no impossible velocities, of which a warning would be told.
    assert codes(dive) == {"dvl_not_finite": 3}


def df21(i: int) -> dict[str, Any]:
    beam_bits, xyz_bits = (0b1011 if i == 2 else 0b1111), (0b0101 if i == 3 else 0b0111)
    values = dict(zip(("velX", "velY", "velZ1", "velZ2"), [*TRUE_D[i].tolist(), 9.0], strict=True))
    return values | {
        "status": xyz_bits << 12 | beam_bits,
        "velBeam": JANUS @ TRUE_D[i],
        "good_beams": 4,
    }


def test_nortek_df21_by_the_bits_of_its_status(read: Any) -> None:
    dive = read("ds_sensor_msgs/msg/NortekDF21", df21)
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, 3, axis=0), atol=1e-6)
    assert codes(dive)["dvl_invalid"] == 1
    dive = read("ds_sensor_msgs/msg/NortekDF21", df21, kind="beams", beam_tilt_deg=30.0)
    np.testing.assert_allclose(by_beams(dive), TRUE_D, atol=1e-6)
    np.testing.assert_array_equal(np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)), [[2, 2]])


def test_type_that_is_none_names_those_that_are(read: Any) -> None:
    with pytest.raises(LogError, match=r"gz\.msgs\.DVLVelocityTracking") as raised:
        read("geometry_msgs/msg/PoseStamped", lambda i: {})
    assert "stonefish_ros2/msg/DVL" in raised.value.message


def test_every_type_has_a_definition_for_logs_without() -> None:
    for name in {**TYPES["dvl_beams"], **TYPES["dvl_velocity"], **TYPES["dvl_if_named"]}:
        is_of_logs_alone = (
            name.partition("/")[0] in (*UUV_COPIES, "dvl1000_ros") or name in OF_LOGS_ALONE
        )
        assert "/" not in name or is_of_logs_alone or definition_text(name)


# Gazebo, in protobuf

GZ: dict[str, dict[str, Any]] = {
    "Time": {"sec": (2, "INT64"), "nsec": (3, "INT32")},
    "Header": {"stamp": (1, "Time")},
    "Vector3d": {
        "header": (1, "Header"),
        "x": (2, "DOUBLE"),
        "y": (3, "DOUBLE"),
        "z": (4, "DOUBLE"),
    },
    "DVLKinematicEstimate": {
        "reference": (1, "INT32"),
        "mean": (2, "Vector3d"),
        "covariance": (3, "DOUBLE*"),
    },
    "DVLRangeEstimate": {"mean": (1, "DOUBLE"), "variance": (2, "DOUBLE")},
    "DVLTrackingTarget": {
        "type": (1, "INT32"),
        "range": (2, "DVLRangeEstimate"),
        "position": (3, "Vector3d"),
    },
    "DVLBeamState": {
        "id": (1, "INT32"),
        "velocity": (2, "DVLKinematicEstimate"),
        "range": (3, "DVLRangeEstimate"),
        "rssi": (4, "DOUBLE"),
        "nsd": (5, "DOUBLE"),
        "locked": (6, "BOOL"),
    },
    "DVLVelocityTracking": {
        "header": (1, "Header"),
        "type": (2, "INT32"),
        "target": (3, "DVLTrackingTarget"),
        "velocity": (4, "DVLKinematicEstimate"),
        "beams": (5, "DVLBeamState*"),
        "status": (6, "INT32"),
    },
}
"""As gz-msgs@a9a203a numbers the fields; enumerations are INT32 on the wire."""


def test_gazebos_message_of_stanford(read: Any) -> None:
    def ping(i: int) -> dict[str, Any]:
        return {
            "target": {"type": 2 if i == 4 else 1, "range_mean": 3.0},
            "velocity": {"mean": xyz(TRUE_D[i]), "covariance": np.full(9, 0.1)},
            "beams": [
                {"id": n, "locked": True, "velocity": {"mean": xyz((0.1, 0.1, 0.1))}}
                for n in range(4)
            ],
        }

    dive = read("msgs/msg/DVLData", ping)
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, 4, axis=0), atol=1e-12)
    assert codes(dive)["dvl_water_track"] == 1


def test_teledyne_of_ucsd_if_named_by_the_recorders_time(read: Any) -> None:
    """Its driver fills no header; the numbers are of the bottom in a ship's axes here, and the fourth is an error."""

    def ping(i: int) -> dict[str, Any]:
        forward, starboard, down = TRUE_D[i]
        velocity = np.array([-starboard, -forward, down, 0.01]) if i != 3 else np.full(4, np.nan)
        return {"header": {}, "time": "20210101", "velocity": velocity}

    dive = read("dvl_driver/msg/DVL", ping, topic="/dvl", axes="-y-x+z")
    np.testing.assert_allclose(by_velocity(dive), np.delete(TRUE_D, 3, axis=0), atol=1e-7)
    assert dive.dvl.time_ns[0] == START_NS
    with pytest.raises(LogError, match="has no DVL"):
        read("dvl_driver/msg/DVL", ping)


def gazebo_file() -> FileDescriptorProto:
    described = FileDescriptorProto(name="gz/msgs/dvl.proto", package="gz.msgs", syntax="proto3")
    for name, fields in GZ.items():
        message = described.message_type.add(name=name)
        for field, (number, kind) in fields.items():
            one = kind.rstrip("*")
            repeated = (
                FieldDescriptorProto.LABEL_REPEATED
                if kind != one
                else FieldDescriptorProto.LABEL_OPTIONAL
            )
            is_message = one in GZ
            message.field.add(
                name=field,
                number=number,
                label=repeated,
                type=getattr(
                    FieldDescriptorProto, "TYPE_MESSAGE" if is_message else f"TYPE_{one}"
                ),
                type_name=f".gz.msgs.{one}" if is_message else None,
            )
    return described


def test_gazebo_in_protobuf(tmp_path: Path) -> None:
    pool, file, name = DescriptorPool(), gazebo_file(), "gz.msgs.DVLVelocityTracking"
    pool.Add(file)
    message_type: Any = GetMessageClass(pool.FindMessageTypeByName(name))
    path = write_log(tmp_path / "imu.mcap", imu_messages())
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        imu_type = "sensor_msgs/msg/Imu"
        store = store_with({})
        imu_id = writer.register_channel(
            "/imu",
            "cdr",
            writer.register_schema(imu_type, "ros2msg", definition_text(imu_type).encode()),
        )
        schema = writer.register_schema(
            name, "protobuf", FileDescriptorSet(file=[file]).SerializeToString()
        )
        dvl_id = writer.register_channel("/dvl", "protobuf", schema)
        for _, type_name, time_s, values in imu_messages():
            time_ns = START_NS + round(time_s * 1e9)
            writer.add_message(imu_id, time_ns, serialised(store, type_name, values), time_ns)
        for i, time_s in enumerate(TIMES):
            time_ns = START_NS + round(time_s * 1e9)
            message = message_type(**gazebo(i, time_ns))
            writer.add_message(dvl_id, time_ns + 5000, message.SerializeToString(), time_ns)
        writer.finish()
    dive = read_dive(path, Config())
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-9)
    np.testing.assert_allclose(by_beams(dive), np.delete(TRUE_D, 4, axis=0), atol=1e-9)
    np.testing.assert_array_equal(np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)), [[2, 1]])
    np.testing.assert_array_equal(dive.dvl.time_ns[:2], START_NS + np.array([0, 10**8]))
    assert codes(dive)["dvl_water_track"] == 1
    velocities = read_dive(path, Config(dvl=Dvl(kind="velocity")))
    np.testing.assert_allclose(by_velocity(velocities), np.delete(TRUE_D, 4, axis=0), atol=1e-12)


def gazebo(i: int, time_ns: int) -> dict[str, Any]:
    """As gz-sensors@028bd08 fills it: a lost beam has no velocity at all, and the axes of the beams look down, z up."""
    speeds, axes = JANUS @ TRUE_D[i], JANUS * FLU
    states: list[dict[str, Any]] = []
    for n in range(4):
        lost = (i, n) == (2, 1)
        velocity = {} if lost else {"velocity": {"reference": 2, "mean": xyz(axes[n] * speeds[n])}}
        states.append({"id": n, "locked": not lost, **velocity})
    return {
        "header": {"stamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}},
        "type": 1,
        "target": {"type": 2 if i == 4 else 1},
        "velocity": {"reference": 2, "mean": xyz(TRUE_D[i] * FLU)},
        "beams": states,
    }
