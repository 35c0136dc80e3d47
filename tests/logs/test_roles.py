"""Types known by name give the right columns; two candidates are named."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl, Imu, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.definitions import definition_text

Message = tuple[str, str, float, dict[str, Any]]
START_NS = 1_700_000_000_000_000_000
IMU, WATER_LINKED, NUCLEUS = (
    "sensor_msgs/msg/Imu",
    "dvl_msgs/msg/DVL",
    "interfaces/msg/BottomTrack",
)
TILT, AZIMUTHS = np.deg2rad(22.5), np.deg2rad([135.0, 225.0, 315.0, 45.0])
A50 = np.stack(
    [np.cos(AZIMUTHS) * np.sin(TILT), np.sin(AZIMUTHS) * np.sin(TILT), np.full(4, np.cos(TILT))],
    axis=1,
)
VELOCITY_D = np.array([0.8, -0.2, 0.05])


def time(time_s: float) -> dict[str, int]:
    time_ns = START_NS + round(time_s * 1e9)
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def header(time_s: float) -> dict[str, Any]:
    return {"stamp": time(time_s), "frame_id": ""}


def xyz(vector: Any) -> dict[str, float]:
    return dict(zip("xyz", np.asarray(vector, float).tolist(), strict=True))


def imu(time_s: float, topic: str = "/imu") -> Message:
    force = xyz((0.1, 0.2, -9.8))
    rate = xyz((0.01, 0.02, 0.01 * np.sin(time_s)))
    return (
        topic,
        IMU,
        time_s,
        {"header": header(time_s), "linear_acceleration": force, "angular_velocity": rate},
    )


def water_linked(time_s: float, lost: Sequence[int] = (), **changes: Any) -> Message:
    velocity_d = VELOCITY_D * (1.0 + 0.01 * time_s)
    along = A50 @ velocity_d
    message = {
        "header": header(time_s + 0.1),
        "time": 200.0,
        "velocity": xyz(velocity_d),
        "velocity_valid": True,
        "beams": [
            {"id": i, "velocity": along[i], "distance": 9.0, "valid": i not in lost}
            for i in range(4)
        ],
        "time_of_validity": (START_NS + round(time_s * 1e9)) // 1000,
        "form": "json",
    }
    return "/dvl", WATER_LINKED, time_s, message | changes


def nucleus(time_s: float, **changes: Any) -> Message:
    message: dict[str, Any] = {"system_timestamp": time(time_s)}
    message |= {f"{axis}_velocity_valid": True for axis in "xyz"}
    message |= {
        f"velocity_{axis}": v for axis, v in zip("xyz", (0.5, 0.25, 0.125 * time_s), strict=True)
    }
    message |= {f"beam_{i}_velocity_valid": True for i in (1, 2, 3)}
    message |= {f"velocity_beam_{i}": 0.25 * i + 0.125 * time_s for i in (1, 2, 3)}
    return "/nucleus", NUCLEUS, time_s, message | changes


def write(path: Path, messages: Sequence[Message], texts: dict[str, str] | None = None) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        names = dict.fromkeys(name for _, name, _, _ in messages)
        schemas = {
            name: writer.register_msgdef(name, (texts or {}).get(name) or definition_text(name))
            for name in names
        }
        for topic, name, time_s, message in messages:
            time_ns = START_NS + round(time_s * 1e9)
            writer.write_message(
                topic, schemas[name], message, log_time=time_ns, publish_time=time_ns
            )
        writer.finish()
    return path


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Dive]:
    def read(messages: Sequence[Message], config: Config | None = None, **texts: str) -> Dive:
        everything = [*(imu(0.01 * i) for i in range(100)), *messages]
        return read_dive(write(tmp_path / "dive.mcap", everything, texts), config or Config())

    return read


def counts(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


# DVLs


def test_water_linked_beams_geometry_and_time_of_validity(read: Callable[..., Dive]) -> None:
    dive = read(
        [water_linked(0.0), water_linked(0.2, lost=[1]), water_linked(0.4, lost=[0, 1, 2, 3])]
    )
    assert dive.dvl.beam_vectors_d is not None
    assert dive.dvl.beam_velocity_mps is not None
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, A50, atol=1e-15)
    np.testing.assert_array_equal(dive.dvl.time_ns, START_NS + np.array([0, 200_000_000]))
    np.testing.assert_allclose(dive.dvl.beam_velocity_mps[0], A50 @ VELOCITY_D, rtol=1e-15)
    np.testing.assert_array_equal(
        np.isnan(dive.dvl.beam_velocity_mps[1]), [False, True, False, False]
    )
    assert counts(dive)["dvl_invalid"] == 1


def test_fields_that_a_schema_lacks_are_done_without(read: Callable[..., Dive]) -> None:
    older = definition_text(WATER_LINKED).replace("int64 time_of_validity\n", "")
    dive = read([water_linked(0.0), water_linked(0.2)], **{WATER_LINKED: older})
    np.testing.assert_array_equal(
        dive.dvl.time_ns, START_NS + np.array([100_000_000, 300_000_000])
    )


@pytest.mark.parametrize(
    ("written", "near"), [("speed", ""), ("velocty", "near: velocty, beams[*].velocty; ")]
)
def test_the_fields_that_are_needed_and_lacking_are_named(
    written: str, near: str, read: Callable[..., Dive]
) -> None:
    without = definition_text(WATER_LINKED).replace("velocity\n", f"{written}\n")
    with pytest.raises(LogError) as raised:
        read([water_linked(0.0), water_linked(0.2)], **{WATER_LINKED: without})
    said = raised.value.what
    lacking = "but its schema lacks velocity, beams[*].velocity"
    assert said.endswith(f"is of type dvl_msgs/msg/DVL, {lacking}")
    assert raised.value.hint.startswith(near or "for other types: ")
    assert 'dvl.velocity = "field.path"' in raised.value.hint


def test_invalid_velocities_are_dropped_however_plausible(read: Callable[..., Dive]) -> None:
    pings = [water_linked(0.0), water_linked(0.2, velocity_valid=False), water_linked(0.4)]
    dive = read(pings, Config(dvl=Dvl(kind="velocity")))
    assert dive.dvl.velocity_d is not None
    assert len(dive.dvl.velocity_d) == 2
    assert counts(dive)["dvl_invalid"] == 1


def test_beams_that_do_not_make_the_velocity_are_noted(read: Callable[..., Dive]) -> None:
    pings = [water_linked(0.0), water_linked(0.2)]
    assert "dvl_beam_contradiction" not in counts(read(pings))
    dive = read(pings, Config(dvl=Dvl(beam_tilt_deg=30.0)))
    (note,) = [note for note in dive.notes if note.code == "dvl_beam_contradiction"]
    assert note.severity == "warning"
    assert "dvl.beam_tilt_deg" in note.hint


def test_three_beams_need_a_geometry_and_then_serve(read: Callable[..., Dive]) -> None:
    pings = [
        nucleus(0.0),
        nucleus(0.5, beam_2_velocity_valid=False),
        nucleus(1.0, y_velocity_valid=False),
    ]
    by_velocity = read(pings)
    np.testing.assert_array_equal(
        by_velocity.dvl.velocity_d, [[0.5, 0.25, 0.0], [0.5, 0.25, 0.0625]]
    )
    with pytest.raises(ConfigError, match="has 3 beams, but the geometry has 4") as raised:
        read(pings, Config(dvl=Dvl(kind="beams")))
    assert "dvl.beam_azimuth_deg" in raised.value.hint
    settings = Dvl(kind="beams", beam_tilt_deg=20.0, beam_azimuth_deg=(0.0, 120.0, 240.0))
    dive = read(pings, Config(dvl=settings))
    np.testing.assert_array_equal(
        dive.dvl.beam_velocity_mps,
        [[0.25, 0.5, 0.75], [0.3125, np.nan, 0.8125], [0.375, 0.625, 0.875]],
    )


def test_coordinates_decide_what_the_raw_velocities_of_deep_submergence_mean(
    read: Callable[..., Dive],
) -> None:
    name = "ds_sensor_msgs/msg/Dvl"
    text = "geometry_msgs/Vector3 velocity\nfloat32[4] raw_velocity\nuint8 velocity_mode\nuint8 coordinate_mode\n"
    text += f"{'=' * 80}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    pings = [
        (
            "/ds",
            name,
            0.1 * i,
            {
                "velocity": xyz((i, 2, 3)),
                "raw_velocity": [i, 5, 6, 7],
                "velocity_mode": 1,
                **extra,
            },
        )
        for i, extra in enumerate(
            ({"coordinate_mode": 1}, {"coordinate_mode": 0}, {"coordinate_mode": 3})
        )
    ]
    velocities, beams = (
        read(pings, **{name: text}),
        read(pings, Config(dvl=Dvl(kind="beams")), **{name: text}),
    )
    np.testing.assert_array_equal(velocities.dvl.velocity_d, [[0.0, 2.0, 3.0]])
    np.testing.assert_array_equal(beams.dvl.beam_velocity_mps, [[1.0, 5.0, 6.0, 7.0]])
    assert counts(velocities)["dvl_coordinates"] == counts(beams)["dvl_coordinates"] == 2


def test_flags_and_velocities_that_do_not_fit_are_refused(read: Callable[..., Dive]) -> None:
    settings = Dvl(beam_valid="velocity_valid")
    with pytest.raises(LogError, match="has 4 beam velocities, but 1 validity flags"):
        read([water_linked(0.0), water_linked(0.2)], Config(dvl=settings))


def test_unknown_types_tell_validity_by_path(read: Callable[..., Dive]) -> None:
    name = "my_msgs/msg/Log"
    text = "float32[4] along\nuint8[4] ok\nuint8 fine\nfloat32 vx\nfloat32 vy\nfloat32 vz\n"
    pings = [
        (
            "/mine",
            name,
            0.1 * i,
            {"along": [i, 1, 2, 3], "ok": [1, 1, i % 2, 1], "fine": i, "vx": i, "vy": 2, "vz": 3},
        )
        for i in range(4)
    ]
    beams = read(
        pings,
        Config(dvl=Dvl(topic="/mine", beam_velocity="along", beam_valid="ok")),
        **{name: text},
    )
    assert beams.dvl.beam_velocity_mps is not None
    np.testing.assert_array_equal(
        np.isnan(beams.dvl.beam_velocity_mps[:, 2]), [True, False, True, False]
    )
    np.testing.assert_array_equal(beams.dvl.time_ns, START_NS + np.arange(4) * 10**8)
    velocities = read(
        pings, Config(dvl=Dvl(topic="/mine", velocity="vx, vy, vz", valid="fine")), **{name: text}
    )
    np.testing.assert_array_equal(velocities.dvl.velocity_d, [[i, 2.0, 3.0] for i in (1, 2, 3)])
    assert counts(velocities)["dvl_invalid"] == 1


# IMUs


def test_nucleus_imu(tmp_path: Path) -> None:
    readings = [
        (
            "/n",
            "interfaces/msg/IMU",
            0.01 * i,
            {"system_timestamp": time(0.01 * i), "accelerometer_z": -9.75, "gyro_x": i / 1024},
        )
        for i in range(100)
    ]
    dive = read_dive(
        write(tmp_path / "dive.mcap", [*readings, water_linked(0.0), water_linked(0.2)]), Config()
    )
    np.testing.assert_array_equal(dive.imu.specific_force_b, np.tile([0.0, 0.0, -9.75], (100, 1)))
    np.testing.assert_array_equal(dive.imu.angular_rate_b[:, 0], np.arange(100) / 1024)


def test_scale_and_axes_of_the_accelerometers_alone(read: Callable[..., Dive]) -> None:
    settings = Imu(specific_force_axes="-x-y+z", specific_force_scale=0.98, angular_rate_scale=0.5)
    dive = read([water_linked(0.0), water_linked(0.2)], Config(imu=settings, dvl=Dvl()))
    np.testing.assert_allclose(
        dive.imu.specific_force_b[0], [-0.1 / 0.98, -0.2 / 0.98, -10.0], rtol=1e-15
    )
    np.testing.assert_allclose(dive.imu.angular_rate_b[0], [0.02, 0.04, 0.0], rtol=1e-15)
    with pytest.raises(ConfigError, match=r'imu\.specific_force_axes = "up"'):
        read([water_linked(0.0)], Config(imu=Imu(specific_force_axes="up")))


def test_all_candidates_are_named_with_the_key(read: Callable[..., Dive]) -> None:
    with pytest.raises(LogError, match=r"/imu and /second could each be the imu\.topic") as raised:
        read([*(imu(0.01 * i, "/second") for i in range(9)), water_linked(0.0)])
    assert raised.value.hint == 'imu.topic = "/imu" or imu.topic = "/second"'


# References


def test_ixblue_angles_and_axes(read: Callable[..., Dive]) -> None:
    solutions = [
        (
            "/ins",
            "ixblue_ins_msgs/msg/Ins",
            0.5 * i,
            {
                "header": header(0.5 * i),
                "latitude": 43.0,
                "longitude": 354.0,
                "altitude": -20.0,
                "heading": 350.0,
                "roll": 10.0,
                "pitch": 5.0,
                "speed_vessel_frame": xyz((1.0, 0.5, 0.25)),
            },
        )
        for i in range(3)
    ]
    reference = read([*solutions, water_linked(0.0), water_linked(0.2)]).reference
    assert reference is not None
    np.testing.assert_allclose(np.rad2deg(reference.position[0, :2]), [43.0, -6.0], atol=1e-12)
    mat_nb = Rotation.from_euler("ZYX", [350.0, -5.0, 10.0], degrees=True).as_matrix()
    np.testing.assert_allclose(reference.mat_nb[0], mat_nb, atol=1e-12)
    np.testing.assert_allclose(reference.velocity_n[0], mat_nb @ [1.0, -0.5, -0.25], atol=1e-12)


def test_geographic_pose_gives_position_and_attitude(read: Callable[..., Dive]) -> None:
    east = dict(zip("xyzw", Rotation.identity().as_quat().tolist(), strict=True))
    position = {"latitude": 43.0, "longitude": 5.0, "altitude": -3.0}
    poses = [
        ("/pose", "geographic_msgs/msg/GeoPoseStamped", 0.5 * i,
         {"header": header(0.5 * i), "pose": {"position": position, "orientation": east}})
        for i in range(3)
    ]  # fmt: skip
    reference = read([*poses, water_linked(0.0), water_linked(0.2)]).reference
    assert reference is not None
    np.testing.assert_allclose(
        reference.position[0], [np.deg2rad(43.0), np.deg2rad(5.0), -3.0], rtol=1e-14
    )
    np.testing.assert_allclose(reference.mat_nb[0][:, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert not reference.has_velocity
    named = Config(reference=Reference(topic="/pose"))
    assert read([*poses, water_linked(0.0), water_linked(0.2)], named).reference is not None
