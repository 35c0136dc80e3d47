"""Known types of IMUs and references, as rosbags writes them: frames, flags, increments, stamps."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbag_messages import header, imu_messages, write_log, xyz
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Clocks, Config, Initial, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import LogError
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.topics import TYPES
from insdvl_replay.logs.formats.definitions import definition_text

TIMES = 0.1 * np.arange(20)
BOOT_US = 12_345_678
"""An autopilot counts from when it was switched on."""
FORCE = np.stack([0.1 * np.sin(TIMES), 0.2 * np.cos(TIMES), -9.8 + 0.1 * np.sin(TIMES)], axis=1)
RATE = np.stack([0.01 * np.sin(TIMES), 0.02 * np.cos(TIMES), 0.03 * TIMES], axis=1)
VELOCITY_N = np.stack([1.0 + TIMES, 0.5 - TIMES, 0.1 * TIMES], axis=1)
TURNS = Rotation.from_euler(
    "ZYX", np.stack([0.3 + 0.1 * TIMES, 0.05 * TIMES, 0.02 * TIMES], axis=1)
)
"""From the body, forward-starboard-down, to north-east-down."""
PLACE = Initial(latitude_deg=32.8, longitude_deg=35.0, height_m=-5.0)


def microseconds(time_s: float) -> int:
    return BOOT_US + round(time_s * 1e6)


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Dive]:
    def read_log(
        type_name: str,
        message: Callable[[int], dict[str, Any]],
        imu: Any = None,
        config: Config | None = None,
    ) -> Dive:
        pings = [
            (
                "/dvl",
                "geometry_msgs/msg/TwistStamped",
                time_s,
                {"header": header(time_s), "twist": {"linear": xyz(v)}},
            )
            for time_s, v in zip(TIMES.tolist(), VELOCITY_N, strict=True)
        ]
        others = [
            ("/it", type_name, time_s, message(i)) for i, time_s in enumerate(TIMES.tolist())
        ]
        path = write_log(
            tmp_path / "dive.mcap", [*(imu_messages() if imu is None else imu), *pings, *others]
        )
        return read_dive(path, config or Config())

    return read_log


def codes(dive: Dive) -> dict[str, int]:
    return {note.code: note.count for note in dive.notes}


# IMUs. Their clock has nothing to do with that of the DVL, which is refused unless it is allowed.


def any_clock() -> Config:
    return Config(clocks=Clocks(max_disagreement_s=2e9))


def test_increments_of_px4_are_divided_by_their_own_intervals_and_are_of_the_middle(
    read: Any,
) -> None:
    angle_us, velocity_us = 4000 + 10 * np.arange(20), 8000 + 20 * np.arange(20)

    def message(i: int) -> dict[str, Any]:
        return {
            "timestamp": microseconds(TIMES[i]) + 300,
            "timestamp_sample": microseconds(TIMES[i]),
            "delta_angle": RATE[i] * angle_us[i] * 1e-6,
            "delta_velocity": FORCE[i] * velocity_us[i] * 1e-6,
            "delta_angle_dt": int(angle_us[i]),
            "delta_velocity_dt": int(velocity_us[i]),
        }

    dive = read("px4_msgs/msg/VehicleImu", message, imu=[], config=any_clock())
    np.testing.assert_allclose(dive.imu.specific_force_b, FORCE, rtol=2e-7, atol=1e-7)
    np.testing.assert_allclose(dive.imu.angular_rate_b, RATE, rtol=2e-7, atol=1e-8)
    middle_us = BOOT_US + np.rint(TIMES * 1e6) - angle_us / 2
    np.testing.assert_array_equal(dive.imu.time_ns, np.rint(middle_us * 1e3).astype(np.int64))


def test_increments_over_no_time_are_no_readings(read: Any) -> None:
    def message(i: int) -> dict[str, Any]:
        interval = 0 if i == 4 else 4000
        return {
            "timestamp_sample": microseconds(TIMES[i]),
            "delta_angle": RATE[i] * 4e-3,
            "delta_velocity": FORCE[i] * 4e-3,
            "delta_angle_dt": interval,
            "delta_velocity_dt": interval,
        }

    dive = read("px4_msgs/msg/VehicleImu", message, imu=[], config=any_clock())
    np.testing.assert_allclose(
        dive.imu.specific_force_b, np.delete(FORCE, 4, axis=0), rtol=2e-7, atol=1e-7
    )
    assert codes(dive)["imu_not_finite"] == 1


def test_means_of_px4_are_of_the_middle_of_their_interval(read: Any) -> None:
    def message(i: int) -> dict[str, Any]:
        return {
            "timestamp": microseconds(TIMES[i]),
            "gyro_rad": RATE[i],
            "gyro_integral_dt": 5000,
            "accelerometer_m_s2": FORCE[i],
            "accelerometer_integral_dt": 5000,
        }

    dive = read("px4_msgs/msg/SensorCombined", message, imu=[], config=any_clock())
    np.testing.assert_allclose(dive.imu.specific_force_b, FORCE, rtol=1e-7)
    np.testing.assert_allclose(dive.imu.angular_rate_b, RATE, rtol=1e-7)
    np.testing.assert_array_equal(
        dive.imu.time_ns, np.rint((BOOT_US + TIMES * 1e6 - 2500) * 1e3).astype(np.int64)
    )


@pytest.mark.parametrize(
    ("name", "force", "rate"),
    [
        ("sbg_driver/msg/SbgImuData", "accel", "gyro"),
        ("vectornav_msgs/msg/CommonGroup", "imu_accel", "imu_rate"),
        ("vectornav_msgs/msg/ImuGroup", "uncompaccel", "uncompgyro"),
    ],
)
def test_imus_of_drivers(name: str, force: str, rate: str, read: Any) -> None:
    def message(i: int) -> dict[str, Any]:
        return {"header": header(TIMES[i]), force: xyz(FORCE[i]), rate: xyz(RATE[i])}

    dive = read(name, message, imu=[])
    np.testing.assert_allclose(dive.imu.specific_force_b, FORCE, rtol=1e-7)
    np.testing.assert_allclose(dive.imu.angular_rate_b, RATE, rtol=1e-7)
    # Beside the message that all write it is not asked which.
    assert len(read(name, message).imu.time_ns) == len(imu_messages())


def test_clock_of_an_autopilot_is_not_mixed_with_another(read: Any) -> None:
    message = {"gyro_rad": RATE[0], "accelerometer_m_s2": FORCE[0]}
    with pytest.raises(LogError, match="stamped by different clocks"):
        read(
            "px4_msgs/msg/SensorCombined",
            lambda i: message | {"timestamp": microseconds(TIMES[i])},
            imu=[],
        )


# References


def odometry(i: int, pose_frame: int = 1, velocity_frame: int = 1) -> dict[str, Any]:
    x, y, z, w = TURNS[i].as_quat().tolist()
    velocity = VELOCITY_N[i] if velocity_frame == 1 else TURNS[i].inv().apply(VELOCITY_N[i])
    return {
        "timestamp_sample": microseconds(TIMES[i]),
        "pose_frame": pose_frame,
        "q": np.array([w, x, y, z]),
        "velocity_frame": velocity_frame,
        "velocity": velocity,
    }


@pytest.mark.parametrize("velocity_frame", [1, 3])
def test_odometry_of_px4_by_its_frames(velocity_frame: int, read: Any) -> None:
    dive = read(
        "px4_msgs/msg/VehicleOdometry",
        lambda i: odometry(i, 1, velocity_frame),
        config=any_clock(),
    )
    np.testing.assert_allclose(dive.reference.mat_nb, TURNS.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(dive.reference.velocity_n, VELOCITY_N, atol=1e-6)


def test_odometry_of_px4_without_north_gives_neither_attitude_nor_velocity(read: Any) -> None:
    dive = read(
        "px4_msgs/msg/VehicleOdometry",
        lambda i: odometry(i, 2 if i == 5 else 1, 2 if i == 7 else 3),
        config=any_clock(),
    )
    assert np.flatnonzero(np.isnan(dive.reference.mat_nb).any(axis=(1, 2))).tolist() == [5]
    assert np.flatnonzero(np.isnan(dive.reference.velocity_n).any(axis=1)).tolist() == [5, 7]


def test_position_of_an_odometry_of_px4_is_from_the_initial_place_where_its_frame_has_a_north(
    read: Any,
) -> None:
    def message(i: int) -> dict[str, Any]:
        return odometry(i, 2 if i == 5 else 1) | {
            "position": TIMES[i] * np.array([3.0, -2.0, 1.0])
        }

    config = Config(clocks=Clocks(max_disagreement_s=2e9), initial=PLACE)
    dive = read("px4_msgs/msg/VehicleOdometry", message, config=config)
    expected = np.stack([3.0 * TIMES, -2.0 * TIMES], axis=1)
    expected[5] = np.nan
    np.testing.assert_allclose(moved_m(dive), expected, atol=1e-5)


def local(i: int) -> dict[str, Any]:
    north, east, down = (TIMES[i] * np.array([3.0, -2.0, 1.0])).tolist()
    return {
        "timestamp_sample": microseconds(TIMES[i]),
        "xy_valid": i != 3,
        "z_valid": True,
        "v_xy_valid": True,
        "v_z_valid": i != 4,
        "x": north,
        "y": east,
        "z": down,
        **dict(zip(("vx", "vy", "vz"), VELOCITY_N[i].tolist(), strict=True)),
    }


def local_config(**changes: Any) -> Config:
    return Config(
        clocks=Clocks(max_disagreement_s=2e9), reference=Reference(topic="/it"), **changes
    )


def test_local_position_of_px4_is_from_the_initial_place(read: Any) -> None:
    dive = read("px4_msgs/msg/VehicleLocalPosition", local, config=local_config(initial=PLACE))
    good = np.arange(20) != 3
    np.testing.assert_allclose(
        moved_m(dive)[good], np.stack([3.0 * TIMES, -2.0 * TIMES], axis=1)[good], atol=1e-5
    )
    np.testing.assert_allclose(dive.reference.position[good, 2], -5.0 - TIMES[good], atol=1e-6)
    assert np.isnan(dive.reference.position[3, :2]).all()
    assert np.flatnonzero(np.isnan(dive.reference.velocity_n).any(axis=1)).tolist() == [4]


def test_local_position_of_px4_is_from_its_own_origin_where_it_has_one(read: Any) -> None:
    def message(i: int) -> dict[str, Any]:
        return local(i) | {"xy_global": True, "ref_lat": 10.0, "ref_lon": 20.0, "ref_alt": 30.0}

    dive = read("px4_msgs/msg/VehicleLocalPosition", message, config=local_config(initial=PLACE))
    np.testing.assert_allclose(
        dive.reference.position[0], [np.deg2rad(10.0), np.deg2rad(20.0), 30.0], rtol=1e-12
    )


def pose_enu(i: int) -> dict[str, Any]:
    """Give the attitude, and a position that goes 3 m/s east, 2 m/s south and 1 m/s up."""
    to_flu, to_ned = (
        np.diag([1.0, -1.0, -1.0]),
        np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    )
    quaternion = Rotation.from_matrix(to_ned.T @ TURNS[i].as_matrix() @ to_flu).as_quat()
    return {
        "position": xyz(TIMES[i] * np.array([3.0, -2.0, 1.0])),
        "orientation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
    }


def moved_m(dive: Dive) -> np.ndarray:
    """Return how far north and east of the initial place the reference says it is."""
    place = np.tile([np.deg2rad(32.8), np.deg2rad(35.0), -5.0], (20, 1))
    return np.stack(north_east_m(dive.reference.position, place, place), axis=1)


def ros_odometry(i: int) -> dict[str, Any]:
    return {
        "header": header(TIMES[i]),
        "pose": {"pose": pose_enu(i)},
        "twist": {"twist": {"linear": xyz((1, 0, 0))}},
    }


def test_position_of_an_odometry_is_from_the_initial_place(read: Any) -> None:
    dive = read("nav_msgs/msg/Odometry", ros_odometry, config=Config(initial=PLACE))
    np.testing.assert_allclose(
        moved_m(dive), np.stack([-2.0 * TIMES, 3.0 * TIMES], axis=1), atol=1e-5
    )
    np.testing.assert_allclose(dive.reference.position[:, 2], -5.0 + TIMES, atol=1e-12)
    assert np.isnan(read("nav_msgs/msg/Odometry", ros_odometry).reference.position).all()


def test_position_of_an_odometry_that_is_always_zero_is_none(read: Any) -> None:
    """Some messages are about a velocity alone, others about a depth."""

    def message(i: int) -> dict[str, Any]:
        whole = ros_odometry(i)
        return whole | {
            "pose": {"pose": whole["pose"]["pose"] | {"position": xyz((0.0, 0.0, -3.0))}}
        }

    dive = read("nav_msgs/msg/Odometry", message, config=Config(initial=PLACE))
    assert np.isnan(dive.reference.position).all()
    np.testing.assert_allclose(dive.reference.mat_nb, TURNS.as_matrix(), atol=1e-12)


def test_position_of_an_odometry_is_left_for_that_of_a_receiver(tmp_path: Path) -> None:
    fix = {"latitude": 10.0, "longitude": 20.0, "altitude": 0.0}
    messages = [
        *imu_messages(),
        *(
            (
                "/dvl",
                "geometry_msgs/msg/TwistStamped",
                t,
                {"header": header(t), "twist": {"linear": xyz(v)}},
            )
            for t, v in zip(TIMES.tolist(), VELOCITY_N, strict=True)
        ),
        *(
            ("/it", "nav_msgs/msg/Odometry", t, ros_odometry(i))
            for i, t in enumerate(TIMES.tolist())
        ),
        *(
            ("/fix", "sensor_msgs/msg/NavSatFix", t + 0.05, {"header": header(t + 0.05), **fix})
            for t in TIMES.tolist()
        ),
    ]
    reference = read_dive(
        write_log(tmp_path / "dive.mcap", messages), Config(initial=PLACE)
    ).reference
    assert reference is not None
    placed = np.isfinite(reference.position[:, 0])
    assert np.count_nonzero(placed) == np.count_nonzero(~placed) == 20
    np.testing.assert_allclose(np.rad2deg(reference.position[placed, :2]), [[10.0, 20.0]] * 20)


@pytest.mark.parametrize("covariance", [False, True])
def test_pose_is_east_north_up_from_the_initial_place(covariance: bool, read: Any) -> None:
    def message(i: int) -> dict[str, Any]:
        pose = pose_enu(i)
        return {"header": header(TIMES[i]), "pose": {"pose": pose} if covariance else pose}

    name = f"geometry_msgs/msg/Pose{'WithCovariance' if covariance else ''}Stamped"
    dive = read(name, message, config=Config(reference=Reference(topic="/it"), initial=PLACE))
    np.testing.assert_allclose(dive.reference.mat_nb, TURNS.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(
        moved_m(dive), np.stack([-2.0 * TIMES, 3.0 * TIMES], axis=1), atol=1e-5
    )
    np.testing.assert_allclose(dive.reference.position[:, 2], -5.0 + TIMES, atol=1e-12)
    without = read(name, message, config=Config(reference=Reference(topic="/it")))
    assert np.isnan(without.reference.position).all()
    # Goals and set points are poses, too: none is taken unasked.
    assert read(name, message).reference is None


def test_fixes(read: Any) -> None:
    def gps_fix(i: int) -> dict[str, Any]:
        place = {"latitude": 32.0 + 1e-5 * i, "longitude": 35.0, "altitude": 3.0}
        return {"header": header(TIMES[i]), "status": {"status": -1 if i == 2 else 0}, **place}

    def sensor_gps(i: int) -> dict[str, Any]:
        place = {
            "latitude_deg": 32.0 + 1e-5 * i,
            "longitude_deg": 35.0,
            "altitude_ellipsoid_m": 3.0,
        }
        return {"timestamp": microseconds(TIMES[i]), "fix_type": 1 if i == 2 else 3, **place}

    expected = np.delete(np.deg2rad(32.0 + 1e-5 * np.arange(20)), 2)
    for name, message in (
        ("gps_msgs/msg/GPSFix", gps_fix),
        ("px4_msgs/msg/SensorGps", sensor_gps),
    ):
        dive = read(name, message, config=any_clock())
        np.testing.assert_allclose(dive.reference.position[:, 0], expected, rtol=1e-14)
        assert codes(dive)["reference_no_fix"] == 1


def test_every_type_has_a_definition_for_logs_without() -> None:
    for name in [
        name
        for group in ("imu", "imu_of_drivers", "odometry", "poses", "fix")
        for name in TYPES[group]
    ]:
        assert not re.match(r"(?!tf/)\w+/", name) or definition_text(name)
