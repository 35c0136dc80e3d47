"""Logs become clean columns: against outside decoders, against what was written, and refused where damaged."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as RosWriter
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl, Imu, Reference
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    ImuColumns,
    ReferenceColumns,
    TruthColumns,
)
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.columns.imu import in_frd
from insdvl_replay.logs.formats.definitions import definition_text
from insdvl_replay.preparation.prepared import read_checked_dive

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real logs in ../shared/data are not here"
)

IMU, DVL, TWIST = (
    "sensor_msgs/msg/Imu",
    "marine_acoustic_msgs/msg/Dvl",
    "geometry_msgs/msg/TwistStamped",
)
ODOMETRY, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix"
START_NS = 1_700_000_000_000_000_000
TILT, AZIMUTH = np.deg2rad(30.0), np.deg2rad([45.0, 135.0, 225.0, 315.0])
JANUS = np.stack(
    [np.cos(AZIMUTH) * np.sin(TILT), np.sin(AZIMUTH) * np.sin(TILT), np.full(4, np.cos(TILT))],
    axis=1,
)


def header(time_s: float) -> dict[str, Any]:
    time_ns = START_NS + round(time_s * 1e9)
    return {
        "stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9},
        "frame_id": "somewhere",
    }


def xyz(vector: Any) -> dict[str, float]:
    return dict(zip("xyz", np.asarray(vector, float).tolist(), strict=True))


def imu(
    time_s: float, force: Any = (0.1, 0.2, -9.8), rate: Any = (0.01, 0.02, 0.03)
) -> tuple[str, str, float, dict]:
    message = {
        "header": header(time_s),
        "linear_acceleration": xyz(force),
        "angular_velocity": xyz(rate),
    }
    return "/imu", IMU, time_s, message


def twist(
    time_s: float, velocity: Any = None, topic: str = "/dvl"
) -> tuple[str, str, float, dict]:
    linear = xyz((1.0, 0.1, time_s) if velocity is None else velocity)
    return topic, TWIST, time_s, {"header": header(time_s), "twist": {"linear": linear}}


def ping(time_s: float, **changes: Any) -> tuple[str, str, float, dict]:
    message = {
        "header": header(time_s),
        "velocity_mode": 1,
        "velocity": xyz((1.0, 0.1, 0.01 * time_s)),
        "altitude": 10.0,
        "num_good_beams": 4,
        "beam_ranges_valid": True,
        "beam_velocities_valid": True,
        "beam_unit_vec": [xyz(vector) for vector in JANUS],
        "range": [10.0 / np.cos(TILT)] * 4,
        "beam_velocity": (JANUS @ [1.0, 0.1, 0.01 * time_s]).tolist(),
    }
    return "/dvl", DVL, time_s, message | changes


def write(path: Path, messages: list[tuple[str, str, float, dict]]) -> Path:
    with path.open("wb") as stream:
        writer = RosWriter(stream)
        schemas = {
            name: writer.register_msgdef(name, definition_text(name)) for _, name, _, _ in messages
        }
        for topic, name, time_s, message in messages:
            time_ns = START_NS + round(time_s * 1e9)
            writer.write_message(
                topic, schemas[name], message, log_time=time_ns, publish_time=time_ns + 1
            )
        writer.finish()
    return path


@pytest.fixture
def log(tmp_path: Path) -> Any:
    return lambda messages: write(tmp_path / "dive.mcap", messages)


def good(dvl: Any = twist) -> list[tuple[str, str, float, dict]]:
    return [imu(0.01 * i, (0.001 * i, 0.2, -9.8)) for i in range(100)] + [
        dvl(0.1 * i) for i in range(10)
    ]


def counts(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


# Roles


def test_ambiguous_and_missing_roles_are_named(log: Any) -> None:
    with pytest.raises(LogError, match=r"/dvl and /other could each be the dvl\.topic"):
        read_dive(log([*good(), twist(0.5, topic="/other")]), Config())
    with pytest.raises(LogError, match=r"has no DVL.*it has sensor_msgs/msg/Imu"):
        read_dive(log([imu(0.0), imu(0.1)]), Config())
    with pytest.raises(LogError, match="has no IMU"):
        read_dive(log([twist(0.0), twist(0.1)]), Config())
    with pytest.raises(LogError, match=r"no messages on topic '/dvk'") as raised:
        read_dive(log(good()), Config(dvl=Dvl(topic="/dvk")))
    assert 'dvl.topic = "/dvl"' in raised.value.hint
    with pytest.raises(LogError, match=r"is not known as a type for dvl\.topic"):
        read_dive(log(good()), Config(dvl=Dvl(topic="/imu")))


def test_field_paths_read_any_type(log: Any) -> None:
    settings = Imu(
        topic="/imu", specific_force="angular_velocity", angular_rate="linear_acceleration"
    )
    dive = read_dive(
        log(good()), Config(imu=settings, dvl=Dvl(topic="/imu", velocity="angular_velocity"))
    )
    np.testing.assert_array_equal(dive.imu.specific_force_b[0], [0.01, 0.02, 0.03])
    assert dive.dvl.velocity_d is not None
    np.testing.assert_array_equal(dive.dvl.velocity_d, [[0.01, 0.02, 0.03]])
    assert counts(dive)["dvl_same_values"] == 99


# Units, axes and times


@pytest.mark.parametrize("axes", ["frd", "flu", "+y+x-z", "-z-x-y"])
def test_axes_are_signed_permutations(axes: str) -> None:
    rows = {"frd": "+x+y+z", "flu": "+x-y-z"}.get(axes, axes)
    unit = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
    matrix = np.array(
        [np.array(unit[rows[2 * i + 1]]) * (1 if rows[2 * i] == "+" else -1) for i in range(3)]
    )
    vectors = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_array_equal(in_frd(vectors, axes, "imu.axes"), vectors @ matrix.T)


def test_axes_that_are_none_are_refused() -> None:
    for axes in ("", "ned", "+x+y", "+x+x+z", "xyz", "+x+y+z+z"):
        with pytest.raises(ConfigError, match="is no set of axes"):
            in_frd(np.zeros((1, 3)), axes, "imu.axes")


def test_units_and_axes_of_the_imu(log: Any) -> None:
    path = log([imu(0.1 * i, (0.0, 0.1, 1.0), (0.0, 90.0, 0.0)) for i in range(15)] + good()[100:])
    settings = Imu(specific_force_unit="g", angular_rate_unit="deg/s", axes="flu")
    dive = read_dive(path, Config(imu=settings))
    np.testing.assert_allclose(
        dive.imu.specific_force_b[0], [0.0, -0.980665, -9.80665], rtol=1e-15
    )
    np.testing.assert_allclose(dive.imu.angular_rate_b[0], [0.0, -np.pi / 2, 0.0], rtol=1e-15)
    assert {"imu_gravity"} <= counts(read_checked_dive(path, Config())).keys()


def test_stamp_sources_and_latency(log: Any) -> None:
    path = log(good())
    for stamp, shift in (("header", 0), ("log_time", 0), ("publish_time", 1), ("header.stamp", 0)):
        dive = read_dive(path, Config(imu=Imu(stamp=stamp, latency_s=0.25)))
        assert dive.imu.time_ns[0] == START_NS - 250_000_000 + shift
    with pytest.raises(LogError, match=r"has no field 'stamp'"):
        read_dive(path, Config(imu=Imu(stamp="stamp")))
    with pytest.raises(
        LogError, match=r"'header.stamp.sec' is 1700000000.0+ s in each of 100 messages"
    ):
        read_dive(path, Config(imu=Imu(stamp="header.stamp.sec")))


@pytest.mark.parametrize(
    ("factor", "unit"), [(1.0, "seconds"), (1e3, "milliseconds"), (1e6, "microseconds")]
)
def test_stamp_that_is_a_number_is_understood_by_its_size(
    factor: float, unit: str, log: Any
) -> None:
    times_s = 1.7e9 + 0.25 * np.arange(8)
    messages = [
        imu(0.1 * i, rate=(time_s * factor, 0.0, 0.0)) for i, time_s in enumerate(times_s.tolist())
    ]
    dive = read_dive(log([*messages, *good()[100:]]), Config(imu=Imu(stamp="angular_velocity.x")))
    np.testing.assert_array_equal(dive.imu.time_ns, np.rint(times_s * 1e9).astype(np.int64))
    assert any(note.code == "imu_stamp_unit" and unit in note.text for note in dive.notes)


# Clean-up


def test_every_loss_of_the_imu_is_counted(log: Any) -> None:
    order = [0, 1, 3, 2, 4, 5, 5, 6, 7, 90, 91]
    messages = [imu(0.01 * i, (0.01 * i, 0.0, -9.8)) for i in order] + [
        imu(0.08, (np.nan, 0.0, -9.8))
    ]
    dive = read_dive(log([*messages, *good()[100:]]), Config())
    assert counts(dive) == {
        "imu_out_of_order": 2,
        "imu_not_finite": 1,
        "imu_repeats": 1,
        "imu_gaps": 1,
    }
    np.testing.assert_allclose(
        100.0 * dive.imu.specific_force_b[:, 0], [0, 1, 2, 3, 4, 5, 6, 7, 90, 91]
    )
    assert np.all(np.diff(dive.imu.time_ns) > 0)
    assert any("0.830 s" in note.text and note.severity == "warning" for note in dive.notes)


def test_covariance_of_minus_one_means_not_measured(log: Any) -> None:
    messages = [imu(0.01 * i) for i in range(3)]
    messages[1][3]["angular_velocity_covariance"] = [-1.0] + [0.0] * 8
    assert counts(read_dive(log([*messages, *good()[100:]]), Config()))["imu_not_finite"] == 1


def test_upside_down_imu_is_noticed(log: Any) -> None:
    path = log([imu(0.01 * i, (0.0, 0.0, 9.8)) for i in range(150)] + good()[100:])
    assert "imu_upside_down" in counts(read_checked_dive(path, Config()))
    assert "imu_upside_down" not in counts(read_checked_dive(path, Config(imu=Imu(axes="flu"))))


# The DVL


def test_beams_of_the_message_are_used(log: Any) -> None:
    lost = (JANUS @ [1.0, 0.0, 0.0]).tolist()
    lost[2] = np.nan
    pings = [
        ping(0.0),
        ping(0.2, beam_velocity=lost),
        ping(0.3, velocity_mode=2),
        ping(0.4, beam_velocities_valid=False),
        ping(0.5),
        ping(0.6, beam_velocity=(JANUS @ [1.0, 0.1, 0.005]).tolist()),
    ]
    dive = read_dive(log(good()[:100] + pings), Config())
    assert counts(dive) == {"dvl_water_track": 1, "dvl_invalid": 1, "dvl_same_values": 1}
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, rtol=1e-15)
    expected = np.array([JANUS @ [1.0, 0.1, 0.0], lost, JANUS @ [1.0, 0.1, 0.005]])
    np.testing.assert_array_equal(dive.dvl.beam_velocity_mps, expected.astype(np.float32))


@pytest.mark.parametrize(
    ("vectors", "sentence"),
    [
        (np.full((4, 3), -1.0), "their lengths are 1.732"),
        (JANUS[:, [2, 0, 1]], "altitude over range is 0.866"),
    ],
)
def test_beam_vectors_that_cannot_be_true_are_replaced(
    vectors: Any, sentence: str, log: Any
) -> None:
    path = log(
        good()[:100]
        + [ping(0.1 * i, beam_unit_vec=[xyz(vector) for vector in vectors]) for i in range(5)]
    )
    dive = read_dive(path, Config())
    assert dive.dvl.beam_vectors_d is not None
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, JANUS, atol=1e-15)
    assert any(note.code == "dvl_beam_geometry" and sentence in note.text for note in dive.notes)
    settings = Dvl(beam_tilt_deg=22.5, beam_azimuth_deg=(0.0, 90.0, 180.0, 270.0))
    dive = read_dive(path, Config(dvl=settings))
    sine, cosine = np.sin(np.pi / 8), np.cos(np.pi / 8)
    expected = [[sine, 0, cosine], [0, sine, cosine], [-sine, 0, cosine], [0, -sine, cosine]]
    assert dive.dvl.beam_vectors_d is not None
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, expected, atol=1e-15)
    assert counts(dive) == {"dvl_beam_contradiction": 5}
    with pytest.raises(ConfigError, match="has 4 beams, but the geometry has 3"):
        read_dive(path, Config(dvl=Dvl(beam_azimuth_deg=(0.0, 120.0, 240.0))))


def test_velocity_of_the_message_on_demand_and_without_beams(log: Any) -> None:
    expected = [[1.0, 0.1, 0.01 * 0.1 * i] for i in range(5)]
    path = log(good()[:100] + [ping(0.1 * i) for i in range(5)])
    dive = read_dive(path, Config(dvl=Dvl(kind="velocity", velocity_unit="cm/s")))
    np.testing.assert_allclose(dive.dvl.velocity_d, 0.01 * np.array(expected), rtol=1e-15)
    path = log(good()[:100] + [ping(0.1 * i, beam_velocities_valid=False) for i in range(5)])
    dive = read_dive(path, Config())
    np.testing.assert_allclose(dive.dvl.velocity_d, expected, rtol=1e-15)
    assert counts(dive) == {"dvl_no_beams": 5}
    with pytest.raises(LogError, match=r"no message of 5 can be used.*no valid beam"):
        read_dive(path, Config(dvl=Dvl(kind="beams")))
    with pytest.raises(LogError, match="has no beam_velocity"):
        read_dive(log(good()), Config(dvl=Dvl(kind="beams")))


# The reference and the truth


def odometry(time_s: float, quat: Any, velocity: Any) -> tuple[str, str, float, dict]:
    orientation = dict(zip("xyzw", np.asarray(quat).tolist(), strict=True))
    message = {"header": header(time_s), "pose": {"pose": {"orientation": orientation}}}
    return "/odom", ODOMETRY, time_s, message | {"twist": {"twist": {"linear": xyz(velocity)}}}


def fix(time_s: float, longitude: float, status: int = 0) -> tuple[str, str, float, dict]:
    message = {
        "header": header(time_s),
        "status": {"status": status},
        "latitude": 32.5,
        "longitude": longitude,
    }
    return "/fix", FIX, time_s, message | {"altitude": -12.0}


def test_enu_odometry_and_fix_become_one_reference(log: Any) -> None:
    # Heading east, nose up 10 deg: against east-north-up no yaw, and -10 deg about the port axis.
    quat = Rotation.from_euler("ZYX", [0.0, -10.0, 0.0], degrees=True).as_quat()
    messages = [odometry(0.0, quat, (2.0, 0.3, 0.0)), odometry(0.5, quat, (2.0, 0.3, 0.0))]
    fixes = [fix(0.0, 190.0), fix(0.25, 180.0), fix(0.75, 10.0, status=-1)]
    dive = read_dive(log([*good(), *messages, *fixes]), Config())
    reference = dive.reference
    assert reference is not None
    assert (reference.time_ns - START_NS).tolist() == [0, 250_000_000, 500_000_000]
    np.testing.assert_allclose(
        reference.position[:2],
        [np.deg2rad([32.5, -170.0, 1]), np.deg2rad([32.5, 180.0, 1])] * np.array([1, 1, 0])
        + [0, 0, -12.0],
        rtol=1e-15,
    )
    assert np.isnan(reference.position[2]).all()
    assert np.isnan(reference.mat_nb[1]).all()
    expected = mat_from_rpy(np.deg2rad([0.0, 10.0, 90.0]))
    np.testing.assert_allclose(reference.mat_nb[[0, 2]], [expected, expected], atol=1e-15)
    np.testing.assert_allclose(reference.velocity_n[0], expected @ [2.0, -0.3, 0.0], atol=1e-15)
    assert counts(dive) == {"reference_no_fix": 1}
    ned = read_dive(
        log([*good(), *messages]), Config(reference=Reference(axes="ned_frd"))
    ).reference
    assert ned is not None
    assert not ned.has_position
    np.testing.assert_allclose(ned.mat_nb[0], Rotation.from_quat(quat).as_matrix(), atol=1e-15)


def test_odometry_of_the_dvl_is_no_reference(log: Any) -> None:
    messages = [odometry(0.1 * i, (0, 0, 0, 1), (1.0, 0.1 * i, 0.0)) for i in range(3)]
    dive = read_dive(log([*good()[:100], *messages]), Config(dvl=Dvl(topic="/odom", axes="flu")))
    assert dive.reference is None
    np.testing.assert_allclose(dive.dvl.velocity_d, [[1.0, -0.1 * i, 0.0] for i in range(3)])


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    time_ns = START_NS + 10_000_000 * np.arange(200)
    imu_columns = ImuColumns(
        time_ns, rng.normal([0, 0, -9.8], 0.1, (200, 3)), rng.normal(size=(200, 3))
    )
    dvl_columns = DvlColumns(time_ns[::20], rng.normal(size=(10, 4)), JANUS)
    angles = rng.uniform(-1.0, 1.0, (20, 3))
    position = rng.uniform([-1.5, -3.1, -100.0], [1.5, 3.1, 0.0], (20, 3))
    reference = ReferenceColumns(
        time_ns[::10], position, rng.normal(size=(20, 3)), mat_from_rpy(angles)
    )
    truth = TruthColumns(time_ns[::100], rng.normal(size=(2, 3)), rng.normal(size=(2, 3)))
    path = tmp_path / "written.mcap"
    write_dive(path, Dive("written", imu_columns, dvl_columns, reference, truth))
    dive = read_dive(path, Config())
    assert (dive.name, dive.notes) == ("written", ())
    np.testing.assert_array_equal(dive.imu.time_ns, time_ns)
    np.testing.assert_array_equal(dive.imu.specific_force_b, imu_columns.specific_force_b)
    np.testing.assert_array_equal(dive.imu.angular_rate_b, imu_columns.angular_rate_b)
    assert dive.dvl.beam_velocity_mps is not None
    assert dvl_columns.beam_velocity_mps is not None
    np.testing.assert_array_equal(
        dive.dvl.beam_velocity_mps, dvl_columns.beam_velocity_mps.astype(np.float32)
    )
    assert dive.reference is not None
    np.testing.assert_allclose(dive.reference.position, position, rtol=1e-14)
    np.testing.assert_array_equal(dive.reference.velocity_n, reference.velocity_n)
    np.testing.assert_allclose(dive.reference.mat_nb, reference.mat_nb, atol=1e-14)
    assert dive.truth is not None
    np.testing.assert_array_equal(dive.truth.accel_bias_b, truth.accel_bias_b)
    np.testing.assert_array_equal(dive.truth.gyro_bias_b, truth.gyro_bias_b)
    roles = {channel.topic: channel.role for channel in dive.channels}
    assert roles == {
        "/imu": "imu",
        "/dvl": "dvl",
        "/reference": "reference",
        "/truth/biases": "truth",
    }


OWN_WAY = ("snapir_11", "snapir_12")
"""Dives whose reference does not go as far by its velocity as by its positions."""


@pytest.mark.nightly
@needs_data
@pytest.mark.parametrize(
    "name",
    [
        "snapir_01",
        *(
            pytest.param(f"snapir_{run:02d}", marks=pytest.mark.nightly)
            for run in (2, 5, 7, 8, 9, 11, 12)
        ),
    ],
)
def test_real_dive_agrees_with_the_official_decoder(name: str) -> None:
    path = DATA / "snapir" / f"{name}.mcap"
    decoded: dict[str, list[Any]] = {
        "/imu": [],
        "/dvl/velocity": [],
        "/ins/odometry": [],
        "/ins/fix": [],
    }
    with path.open("rb") as stream:
        for _, channel, _, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            decoded[channel.topic].append(message)
    dive = read_checked_dive(path, Config())
    assert [note.code for note in dive.notes] == ["reference_scale"] * (name in OWN_WAY)
    _assert_columns(dive.imu.time_ns, decoded["/imu"], _stamp_ns)
    _assert_columns(
        dive.imu.specific_force_b, decoded["/imu"], lambda m: _vector(m.linear_acceleration)
    )
    _assert_columns(
        dive.imu.angular_rate_b, decoded["/imu"], lambda m: _vector(m.angular_velocity)
    )
    _assert_columns(dive.dvl.time_ns, decoded["/dvl/velocity"], _stamp_ns)
    _assert_columns(
        dive.dvl.velocity_d, decoded["/dvl/velocity"], lambda m: _vector(m.twist.twist.linear)
    )
    reference = dive.reference
    assert reference is not None
    _assert_columns(reference.time_ns, decoded["/ins/odometry"], _stamp_ns)
    position = np.array(
        [
            [np.deg2rad(m.latitude), np.deg2rad(m.longitude), m.altitude]
            for m in decoded["/ins/fix"]
        ]
    )
    np.testing.assert_allclose(reference.position, position, rtol=1e-15)
    quats = [m.pose.pose.orientation for m in decoded["/ins/odometry"]]
    mat_enu = Rotation.from_quat([(q.x, q.y, q.z, q.w) for q in quats]).as_matrix()
    mat_nb = mat_enu[:, [1, 0, 2]] * np.array([[1], [1], [-1]]) * np.array([1, -1, -1])
    np.testing.assert_allclose(reference.mat_nb, mat_nb, atol=1e-14)
    twist = np.array([_vector(m.twist.twist.linear) for m in decoded["/ins/odometry"]])
    velocity_enu = np.einsum("kij,kj->ki", mat_enu, twist)
    np.testing.assert_allclose(
        reference.velocity_n, velocity_enu[:, [1, 0, 2]] * [1, 1, -1], atol=1e-14
    )


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def _vector(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _assert_columns(columns: Any, messages: list[Any], value: Any) -> None:
    np.testing.assert_array_equal(columns, [value(message) for message in messages])
