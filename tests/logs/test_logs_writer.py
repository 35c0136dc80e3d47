"""Written logs: complete, in order, the same every time, and read in full by two readers that are not ours."""

import hashlib
import io
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from frames import frames
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from pyins.transform import lla_to_ned
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from insdvl_replay import __version__
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    TruthColumns,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG, MRAD
from insdvl_replay.core.tables import ConsistencyRow, ImprovementRow, Tables
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.logs.formats.definitions import definition_text
from insdvl_replay.logs.write import (
    ANGLE_DIGITS,
    VELOCITY_DIGITS,
    Batch,
    stamp,
    write_dive,
    write_log,
    write_replay,
)

START_NS = 1_654_675_200_123_456_789
S = 1_000_000_000
TILT, AZIMUTHS = 30.0 * DEG, np.array([45.0, 135.0, 225.0, 315.0]) * DEG
BEAMS_D = np.stack(
    [np.cos(AZIMUTHS) * np.sin(TILT), np.sin(AZIMUTHS) * np.sin(TILT), np.full(4, np.cos(TILT))],
    axis=-1,
)


@dataclass(frozen=True)
class Errors:
    time_ns: TimeNs
    position_error_ned_m: Floats
    velocity_error_n: Floats
    attitude_error_rad: Floats


def make_dive() -> Dive:
    rng = np.random.default_rng(5)
    imu_count = 5000
    time_ns = START_NS + np.arange(imu_count) * (S // 100)
    dvl_ns = time_ns[::100] + 1_234_567
    velocity_d = rng.normal(size=(len(dvl_ns), 3))
    beam_velocity = velocity_d @ BEAMS_D.T
    beam_velocity[3, 1] = np.nan
    beam_velocity[4, :2] = np.nan
    beam_velocity[5] = np.nan
    reference = ReferenceColumns(
        time_ns[::100],
        np.array([0.57, 0.61, -3.0]) + rng.normal(scale=1e-5, size=(len(dvl_ns), 3)),
        rng.normal(size=(len(dvl_ns), 3)),
        mat_from_rpy(rng.uniform(-1.0, 1.0, size=(len(dvl_ns), 3))),
    )
    reference.position[7] = np.nan
    truth = TruthColumns(time_ns[::1000], *rng.normal(size=(2, len(time_ns[::1000]), 3)))
    imu = ImuColumns(time_ns, *rng.normal(size=(2, imu_count, 3)))
    return Dive("north sea", imu, DvlColumns(dvl_ns, beam_velocity, BEAMS_D), reference, truth)


def make_history(name: str, seed: int) -> History:
    rng = np.random.default_rng(seed)
    k, m = 40, 30
    innovations = tuple(
        Innovations(
            measurement,
            unit,
            ("x", "y", "z"),
            START_NS + np.arange(m) * S,
            START_NS + np.arange(m) * S - S // 2,
            *rng.normal(size=(2, m, 3)),
            rng.uniform(0.1, 1.0, size=(m, 3)),
            rng.chisquare(3, size=m),
            rng.uniform(size=m) < 0.9,
            rng.normal(size=m),
            np.inf,
            5,
            np.zeros(m, dtype=bool),
        )
        for measurement, unit in (("velocity", "m/s"), ("acceleration", "m/s^2"))
    )
    return History(
        name,
        START_NS + np.arange(k) * S,
        np.ones(k, dtype=bool),
        np.array([0.57, 0.61, -3.0]) + rng.normal(scale=1e-5, size=(k, 3)),
        rng.normal(size=(k, 3)),
        mat_from_rpy(rng.uniform(-1.0, 1.0, size=(k, 3))),
        *rng.normal(scale=MG, size=(1, k, 3)),
        *rng.normal(scale=DEG_PER_HOUR, size=(1, k, 3)),
        rng.uniform(0.1, 1.0, size=(k, 12)),
        np.empty(0, dtype=np.int64),
        np.empty((0, 12, 12)),
        innovations,
    )


DIVE = make_dive()
HISTORIES = (make_history("baseline", 1), make_history("aided", 2))
ERRORS = Errors(START_NS + np.arange(5) * S, *np.random.default_rng(3).normal(size=(3, 5, 3)))
TABLES = Tables(
    improvement=[
        ImprovementRow("north sea", "aided", "phi_n", "mrad", 2.0, 1.0, 50.0, "improved"),
        ImprovementRow("b", "aided", "dv_n", "m/s", 0, 0, None, ""),
    ],
    convergence=[],
    reference_error=[],
    consistency=[
        ConsistencyRow(
            "Nordsee ü",
            "aided",
            "velocity",
            3,
            424,
            2,
            2.9,
            2.77,
            3.24,
            "consistent",
            0.01,
            0.1,
            "white",
        )
    ],
)
NO_TABLES = Tables([], [], [], [])
NOTES = (
    Note("imu_gaps", "2 gaps, the longest 0.7 s", 2, "warning", "--set imu.max_gap_s=1"),
    Note("x", "y"),
)
DVL = {
    "velocity": (START_NS + np.arange(4) * S, np.arange(12.0).reshape(4, 3)),
    "acceleration": (np.array([START_NS]), np.ones((1, 3))),
}
ORIGIN: dict[str, Any] = {
    "dive": replace(DIVE, sha256="ab" * 32),
    "config_toml": '[dvl]\ntopic = "/dvl"\n',
    "version": "1.2.3",
}


def write_example(path: Path) -> None:
    write_replay(
        path,
        histories=HISTORIES,
        dvl=DVL,
        errors={"aided": ERRORS},
        tables=TABLES,
        notes=NOTES,
        **ORIGIN,
    )


Decoded = dict[str, list[Any]]


@pytest.fixture(scope="module")
def dive_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dive") / "dive.mcap"
    write_dive(path, DIVE)
    return path


@pytest.fixture(scope="module")
def replay_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "replay.mcap"
    write_example(path)
    return path


@pytest.fixture(scope="module")
def dive_messages(dive_path: Path) -> Decoded:
    return decode(dive_path)


@pytest.fixture(scope="module")
def replay_messages(replay_path: Path) -> Decoded:
    return decode(replay_path)


def decode(path: Path) -> Decoded:
    """Read everything with mcap-ros2-support."""
    messages: Decoded = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            messages[channel.topic].append(message)
    return messages


def vectors(messages: list[Any], name: str) -> Floats:
    parts = name.split(".")
    for part in parts:
        messages = [getattr(message, part) for message in messages]
    return np.array([[v.x, v.y, v.z] if hasattr(v, "x") else v for v in messages])


def column(messages: list[Any], *names: str) -> Floats:
    return np.array([[getattr(message, name) for name in names] for message in messages])


# --- Any written log.


@pytest.mark.parametrize(
    "write", [lambda path: write_dive(path, DIVE), write_example], ids=["dive", "replay"]
)
def test_same_input_gives_the_same_bytes(write: Callable[[Path], None], tmp_path: Path) -> None:
    digests = set()
    for name in ("one.mcap", "two.mcap"):
        write(tmp_path / name)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.mcap", "two.mcap"]


def test_file_has_the_bytes_of_the_official_writer(tmp_path: Path) -> None:
    """Chunks, indexes, summary and checksums: all that is put together here by columns, several chunks of it."""
    rng = np.random.default_rng(11)
    batches = [
        Batch(
            "/slow",
            "sensor_msgs/msg/NavSatFix",
            np.arange(0, 900, 3),
            {"altitude": rng.normal(size=300)},
        ),
        Batch("/fast", "sensor_msgs/msg/Imu", np.arange(9000) // 10, {"header.frame_id": "imu"}),
        Batch(
            "/slow",
            "sensor_msgs/msg/NavSatFix",
            np.arange(5, 800, 5),
            {"header.frame_id": "a longer name"},
        ),
        Batch("/never", "sensor_msgs/msg/Imu", np.empty(0, dtype=np.int64), {}),
    ]
    write_log(
        tmp_path / "ours.mcap",
        batches,
        {"key": "value"},
        {"note.txt": ("text/plain", b"attached")},
    )
    ours = (tmp_path / "ours.mcap").read_bytes()
    assert make_reader(io.BytesIO(ours)).get_summary().statistics.chunk_count > 3

    theirs = io.BytesIO()
    writer = Writer(theirs)
    reader = make_reader(io.BytesIO(ours), validate_crcs=True)
    header, summary = reader.get_header(), reader.get_summary()
    writer.start(profile=header.profile, library=header.library)
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    registered = set()
    for channel in summary.channels.values():
        if channel.schema_id not in registered:
            schema = summary.schemas[channel.schema_id]
            registered.add(writer.register_schema(schema.name, schema.encoding, schema.data))
        writer.register_channel(
            channel.topic, channel.message_encoding, channel.schema_id, channel.metadata
        )
    for _, channel, message in reader.iter_messages():
        writer.add_message(channel.id, message.log_time, message.data, message.publish_time)
    writer.flush()
    for attachment in reader.iter_attachments():
        writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
    writer.finish()
    assert theirs.getvalue() == ours


@pytest.mark.parametrize("log", ["dive_path", "replay_path"])
def test_both_readers_decode_equal_values(log: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(log)
    ours = decode(path)
    theirs: Decoded = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            theirs[connection.topic].append(reader.deserialize(data, connection.msgtype))
    assert ours.keys() == theirs.keys()
    for topic in ours:
        assert len(ours[topic]) == len(theirs[topic])
        for one, other in zip(ours[topic][-50:], theirs[topic][-50:], strict=True):
            assert_same(one, other)


def assert_same(one: Any, other: Any) -> None:
    """Compare a message of mcap-ros2-support with one of rosbags."""
    if is_dataclass(other):
        for field in fields(other):
            if field.name.islower() and not field.name.startswith("__"):
                assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(other, list):
        for inner, other_inner in zip(one, other, strict=True):
            assert_same(inner, other_inner)
    else:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("log", ["dive_path", "replay_path"])
def test_messages_are_in_the_order_of_validity(log: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(log)
    times = []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, record, message in reader.iter_decoded_messages(log_time_order=False):
            time = message.header.stamp if hasattr(message, "header") else message.stamp
            assert record.log_time == record.publish_time == time.sec * S + time.nanosec
            times.append(record.log_time)
    assert times == sorted(times)


@pytest.mark.parametrize("log", ["dive_path", "replay_path"])
def test_logs_carry_all_that_viewers_need(log: str, request: pytest.FixtureRequest) -> None:
    with request.getfixturevalue(log).open("rb") as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
    assert (header.profile, header.library) == ("ros2", "insdvl-replay")
    assert summary is not None
    assert summary.statistics is not None
    assert (
        summary.statistics.message_count
        == sum(summary.statistics.channel_message_counts.values())
        > 0
    )
    assert all(
        index.compression == "zstd" and index.message_index_offsets
        for index in summary.chunk_indexes
    )
    for channel in summary.channels.values():
        assert channel.message_encoding == "cdr"
        assert "offered_qos_profiles" in channel.metadata
    for schema in summary.schemas.values():
        assert schema.encoding == "ros2msg"
        assert schema.data.decode() == definition_text(schema.name)
    assert len({schema.name for schema in summary.schemas.values()}) == len(summary.schemas)


def test_a_log_that_cannot_be_written_is_reported_to_the_caller(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "nowhere" / "dive.mcap", tmp_path / "file" / "dive.mcap"):
        with pytest.raises(OSError, match="directory"):
            write_dive(path, DIVE)


def test_a_failed_log_leaves_nothing_behind(tmp_path: Path) -> None:
    times = np.array([START_NS])
    batch = Batch(
        "/x", "std_msgs/msg/Header", times, {**stamp("stamp", times), "no_such_field": 1.0}
    )
    with pytest.raises(ValueError, match="no_such_field"):
        write_log(tmp_path / "x.mcap", [batch], {})
    assert not list(tmp_path.iterdir())


def test_times_that_ros_cannot_hold_are_refused(tmp_path: Path) -> None:
    for seconds in (-1, 2**31):
        times = np.array([seconds * S])
        with pytest.raises(LogError, match="does not fit a ROS stamp"):
            write_log(
                tmp_path / "x.mcap",
                [Batch("/x", "std_msgs/msg/Header", times, stamp("stamp", times))],
                {},
            )


def test_decreasing_times_are_refused(tmp_path: Path) -> None:
    times = np.array([S, 2 * S, S])
    with pytest.raises(ValueError, match="decrease"):
        write_log(
            tmp_path / "x.mcap",
            [Batch("/x", "std_msgs/msg/Header", times, stamp("stamp", times))],
            {},
        )


# --- A dive.


def test_imu_messages_hold_the_columns(dive_messages: Decoded) -> None:
    imu, messages = DIVE.imu, dive_messages["/imu"]
    np.testing.assert_array_equal(vectors(messages, "linear_acceleration"), imu.specific_force_b)
    np.testing.assert_array_equal(vectors(messages, "angular_velocity"), imu.angular_rate_b)
    np.testing.assert_array_equal(
        [m.header.stamp.sec * S + m.header.stamp.nanosec for m in messages], imu.time_ns
    )
    assert {m.header.frame_id for m in messages} == {"imu"}
    assert {m.orientation_covariance[0] for m in messages} == {-1.0}


def test_dvl_messages_hold_the_beams(dive_messages: Decoded) -> None:
    dvl, messages = DIVE.dvl, dive_messages["/dvl"]
    assert dvl.beam_velocity_mps is not None
    np.testing.assert_allclose(
        column(messages, "beam_velocity")[:, 0], dvl.beam_velocity_mps, rtol=1e-7
    )
    np.testing.assert_array_equal([[b.x, b.y, b.z] for b in messages[0].beam_unit_vec], BEAMS_D)
    assert [m.num_good_beams for m in messages[:7]] == [4, 4, 4, 3, 2, 0, 4]
    assert [m.beam_velocities_valid for m in messages[4:7]] == [True, False, True]
    assert {m.velocity_mode for m in messages} == {1}
    good = np.isfinite(dvl.beam_velocity_mps)
    ranges_z = column(messages, "range")[:, 0] * BEAMS_D[:, 2]
    np.testing.assert_allclose(ranges_z[good], 20.0, atol=1e-9)
    assert np.isnan(ranges_z[~good]).all()


def test_dvl_velocity_is_the_least_squares_solution(dive_messages: Decoded) -> None:
    beam_velocity = DIVE.dvl.beam_velocity_mps
    assert beam_velocity is not None
    velocity_d = vectors(dive_messages["/dvl"], "velocity")
    for row, solved in zip(beam_velocity, velocity_d, strict=True):
        good = np.isfinite(row)
        if good.sum() < 3:
            assert np.isnan(solved).all()
        else:
            exact = np.linalg.lstsq(BEAMS_D[good], row[good])[0]
            np.testing.assert_allclose(
                solved, exact, rtol=0.0, atol=0.501 * 10.0**-VELOCITY_DIGITS
            )


def test_reference_messages_hold_the_solution(dive_messages: Decoded) -> None:
    reference, messages = DIVE.reference, dive_messages["/reference"]
    assert reference is not None
    position = column(messages, "latitude_deg", "longitude_deg", "height_m") * [DEG, DEG, 1.0]
    np.testing.assert_allclose(position, reference.position, rtol=1e-15)
    assert np.isnan(position[7]).all()
    np.testing.assert_array_equal(vectors(messages, "velocity_ned_mps"), reference.velocity_n)
    rotation = Rotation.from_euler(
        "ZYX", column(messages, "heading_deg", "pitch_deg", "roll_deg"), degrees=True
    )
    np.testing.assert_allclose(
        rotation.as_matrix(), reference.mat_nb, rtol=0.0, atol=2.0 * 10.0**-ANGLE_DIGITS
    )


def test_truth_messages_hold_the_biases(dive_messages: Decoded) -> None:
    truth, messages = DIVE.truth, dive_messages["/truth/biases"]
    assert truth is not None
    np.testing.assert_array_equal(vectors(messages, "accel_bias_mps2"), truth.accel_bias_b)
    np.testing.assert_array_equal(vectors(messages, "gyro_bias_radps"), truth.gyro_bias_b)


def test_velocities_become_twists(tmp_path: Path) -> None:
    velocity_d = np.array([[1.0, 2.0, 3.0], [np.nan] * 3])
    dive = Dive(
        "x", DIVE.imu, DvlColumns(np.array([START_NS, START_NS + S]), velocity_d=velocity_d)
    )
    write_dive(tmp_path / "x.mcap", dive)
    messages = decode(tmp_path / "x.mcap")
    assert messages.keys() == {"/imu", "/dvl"}
    np.testing.assert_array_equal(vectors(messages["/dvl"], "twist.twist.linear"), velocity_d)
    assert np.isnan(vectors(messages["/dvl"], "twist.twist.angular")).all()


def test_a_dvl_without_four_beams_or_velocities_is_refused(tmp_path: Path) -> None:
    time_ns = np.array([START_NS])
    for dvl in (DvlColumns(time_ns), DvlColumns(time_ns, np.zeros((1, 3)), BEAMS_D[:3])):
        with pytest.raises(ValueError, match="beams"):
            write_dive(tmp_path / "x.mcap", Dive("x", DIVE.imu, dvl))


def test_dive_log_says_who_wrote_it_and_in_which_frames(dive_path: Path) -> None:
    with dive_path.open("rb") as stream:
        [record] = make_reader(stream).iter_metadata()
    assert record.name == "insdvl_replay"
    assert record.metadata["version"] == __version__
    assert record.metadata["frame.imu"].endswith("forward-starboard-down at the IMU")
    assert "time of validity" in record.metadata["stamps"]


# --- A replay.


def test_replay_has_the_topics_of_the_contract(replay_messages: Decoded) -> None:
    each = ["state", "sigma", "innovation/velocity", "innovation/acceleration", "odometry", "fix"]
    assert replay_messages.keys() == {
        *(f"/insdvl/{name}/{topic}" for name in ("baseline", "aided") for topic in each),
        "/insdvl/aided/error",
        "/insdvl/dvl/velocity",
        "/insdvl/dvl/acceleration",
        "/insdvl/reference/state",
        "/insdvl/reference/odometry",
        "/insdvl/table/improvement",
        "/insdvl/table/consistency",
        "/insdvl/notes",
    }


def test_reference_is_next_to_the_filters(replay_messages: Decoded) -> None:
    """As the log had it, inside the replay; poses from where the filters start."""
    reference, first = DIVE.reference, HISTORIES[0]
    assert reference is not None
    inside = (reference.time_ns >= first.time_ns[0]) & (reference.time_ns <= first.time_ns[-1])
    assert inside.any()
    states = replay_messages["/insdvl/reference/state"]
    position = column(states, "latitude_deg", "longitude_deg", "height_m") * [DEG, DEG, 1.0]
    np.testing.assert_allclose(position, reference.position[inside], rtol=1e-14)
    np.testing.assert_array_equal(
        vectors(states, "velocity_ned_mps"), reference.velocity_n[inside]
    )
    poses = replay_messages["/insdvl/reference/odometry"]
    whole = inside & np.all(list(reference.known.values()), axis=0)
    up_m = np.array([message.pose.pose.position.z for message in poses])
    np.testing.assert_allclose(
        up_m, reference.position[whole, 2] - first.position[0, 2], atol=1e-6
    )


@pytest.mark.parametrize("history", HISTORIES, ids=lambda history: str(history.filter))
def test_states_and_sigmas_are_in_shown_units(history: History, replay_messages: Decoded) -> None:
    states = replay_messages[f"/insdvl/{history.filter}/state"]
    position = column(states, "latitude_deg", "longitude_deg", "height_m") * [DEG, DEG, 1.0]
    np.testing.assert_allclose(position, history.position, rtol=1e-15)
    np.testing.assert_array_equal(vectors(states, "velocity_ned_mps"), history.velocity_n)
    np.testing.assert_allclose(
        vectors(states, "accel_bias_mg") * MG, history.accel_bias_b, rtol=1e-15
    )
    np.testing.assert_allclose(
        vectors(states, "gyro_bias_degph") * DEG_PER_HOUR, history.gyro_bias_b, rtol=1e-15
    )
    rotation = Rotation.from_euler(
        "ZYX", column(states, "heading_deg", "pitch_deg", "roll_deg"), degrees=True
    )
    np.testing.assert_allclose(rotation.as_matrix(), history.mat_nb, atol=1e-14)
    sigmas = replay_messages[f"/insdvl/{history.filter}/sigma"]
    np.testing.assert_allclose(column(sigmas, "dv_n_mps")[:, 0], history.sd[:, 0], rtol=1e-15)
    np.testing.assert_allclose(
        column(sigmas, "phi_d_mrad")[:, 0] * MRAD, history.sd[:, 5], rtol=1e-15
    )
    np.testing.assert_allclose(column(sigmas, "ba_y_mg")[:, 0] * MG, history.sd[:, 7], rtol=1e-15)
    np.testing.assert_allclose(
        column(sigmas, "bg_z_degph")[:, 0] * DEG_PER_HOUR, history.sd[:, 11], rtol=1e-15
    )


def test_errors_and_innovations_hold_the_columns(replay_messages: Decoded) -> None:
    errors = replay_messages["/insdvl/aided/error"]
    np.testing.assert_array_equal(vectors(errors, "position_ned_m"), ERRORS.position_error_ned_m)
    np.testing.assert_array_equal(vectors(errors, "velocity_ned_mps"), ERRORS.velocity_error_n)
    angles = column(errors, "roll_deg", "pitch_deg", "heading_deg") * DEG
    np.testing.assert_allclose(angles, ERRORS.attitude_error_rad, rtol=1e-15)
    for innovations in HISTORIES[1].innovations:
        messages = replay_messages[f"/insdvl/aided/innovation/{innovations.measurement}"]
        assert {message.unit for message in messages} == {innovations.unit}
        np.testing.assert_array_equal(vectors(messages, "measured"), innovations.measured)
        np.testing.assert_array_equal(vectors(messages, "innovation"), innovations.innovation)
        np.testing.assert_array_equal(vectors(messages, "sd"), innovations.sd)
        np.testing.assert_array_equal(column(messages, "nis")[:, 0], innovations.nis)
        np.testing.assert_array_equal(column(messages, "used")[:, 0], innovations.used)


def test_derived_velocity_and_acceleration_hold_the_columns(replay_messages: Decoded) -> None:
    np.testing.assert_array_equal(
        vectors(replay_messages["/insdvl/dvl/velocity"], "velocity_mps"), DVL["velocity"][1]
    )
    np.testing.assert_array_equal(
        vectors(replay_messages["/insdvl/dvl/acceleration"], "acceleration_mps2"), [[1, 1, 1]]
    )


def test_odometry_is_east_north_up_and_forward_port_up(tmp_path: Path) -> None:
    """Heading east, drifting north, rolled to starboard, from one corner of a box of 100 m to the other, 7 m deeper."""
    lla = np.array([[32.8, 34.9, -3.0], [32.8009, 34.9011, -10.0]])
    history = replace(
        HISTORIES[0],
        time_ns=HISTORIES[0].time_ns[:2],
        position=lla * [DEG, DEG, 1.0],
        velocity_n=np.array([[0.5, 2.0, 0.1]] * 2),
        mat_nb=mat_from_rpy(np.array([[0.1, 0.0, np.pi / 2.0]] * 2)),
        accel_bias_b=np.zeros((2, 3)),
        gyro_bias_b=np.zeros((2, 3)),
        sd=np.ones((2, 12)),
        innovations=(),
    )
    write_replay(
        tmp_path / "x.mcap",
        histories=[history],
        dvl={},
        errors={},
        tables=NO_TABLES,
        notes=(),
        **ORIGIN,
    )
    messages = decode(tmp_path / "x.mcap")["/insdvl/baseline/odometry"]
    position = vectors(messages, "pose.pose.position")
    north, east, _ = lla_to_ned(lla, lla[0])[1]
    np.testing.assert_allclose(position, [[0.0, 0.0, 0.0], [east, north, -7.0]], atol=2e-3)
    q = messages[0].pose.pose.orientation
    enu_flu = Rotation.from_quat([q.x, q.y, q.z, q.w])
    np.testing.assert_allclose(enu_flu.apply([1.0, 0.0, 0.0]), [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(
        enu_flu.apply([0.0, 1.0, 0.0]), [0.0, np.cos(0.1), np.sin(0.1)], atol=1e-12
    )
    velocity_flu = vectors(messages, "twist.twist.linear")
    np.testing.assert_allclose(enu_flu.apply(velocity_flu), [[2.0, 0.5, -0.1]] * 2, atol=1e-12)
    assert (messages[0].header.frame_id, messages[0].child_frame_id) == ("odom", "base_link")


def test_a_dvl_measurement_without_a_message_type_is_written_as_innovations_alone(
    tmp_path: Path,
) -> None:
    path = tmp_path / "x.mcap"
    write_replay(
        path,
        histories=HISTORIES,
        dvl={"beams": DVL["velocity"]},
        errors={},
        tables=NO_TABLES,
        notes=(),
        **ORIGIN,
    )
    assert not [topic for topic in decode(path) if topic.startswith("/insdvl/dvl/")]


def test_fix_holds_the_position(replay_messages: Decoded) -> None:
    fix = replay_messages["/insdvl/aided/fix"]
    position = column(fix, "latitude", "longitude", "altitude") * [DEG, DEG, 1.0]
    np.testing.assert_allclose(position, HISTORIES[1].position, rtol=1e-15)


def test_rows_hold_the_tables(replay_messages: Decoded) -> None:
    for name in ("improvement", "consistency"):
        table = frames(TABLES)[name]
        messages = replay_messages[f"/insdvl/table/{name}"]
        decoded = pd.DataFrame(
            [[getattr(m, c) for c in table.columns] for m in messages], columns=table.columns
        )
        texts = table.select_dtypes(exclude="number").columns
        expected = table.fillna(dict.fromkeys(texts, ""))
        pd.testing.assert_frame_equal(decoded, expected, check_dtype=False)
        assert {m.header.stamp.sec for m in messages} == {int(HISTORIES[0].time_ns[-1]) // S}


def test_notes_are_log_messages(replay_messages: Decoded) -> None:
    first, second = replay_messages["/insdvl/notes"]
    assert (first.level, second.level) == (30, 20)
    assert (first.name, first.msg) == (
        "north sea",
        "imu_gaps (2): 2 gaps, the longest 0.7 s hint: --set imu.max_gap_s=1",
    )


def test_replay_names_its_origin_and_keeps_its_configuration(replay_path: Path) -> None:
    with replay_path.open("rb") as stream:
        reader = make_reader(stream)
        [record] = reader.iter_metadata()
        [attachment] = reader.iter_attachments()
    assert record.metadata["version"] == "1.2.3"
    assert (record.metadata["log"], record.metadata["log_sha256"]) == ("north sea", "ab" * 32)
    assert (attachment.name, attachment.media_type) == ("config.toml", "application/toml")
    assert attachment.data == b'[dvl]\ntopic = "/dvl"\n'
    assert (attachment.log_time, attachment.create_time) == (0, 0)
