"""Beams whose directions contradict the velocity of the instrument are mended, or the velocity is used."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbag_messages import START_NS, header, imu_messages, write_log, xyz

from insdvl_replay.core.config import Config, Dvl
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.geometry.frames import beam_vectors, solve_beams
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.beam_directions import BeamVelocities, agreeing_directions

TIMES = 0.2 * np.arange(60)
TRUE_D = np.stack(
    [1.0 + 0.2 * np.sin(TIMES), 0.06 * np.cos(2.0 * TIMES), 0.04 * np.sin(3.0 * TIMES)], axis=1
)
A50 = beam_vectors(22.5, (135.0, 225.0, 315.0, 45.0))
JANUS = beam_vectors(30.0)
APL = "marine_acoustic_msgs/msg/Dvl"
Change = Callable[[int, dict[str, Any]], dict[str, Any]]


def message(i: int, true: Floats, told: Floats) -> dict[str, Any]:
    """Give a ping of an instrument with its true directions, and those that its messages tell."""
    return {
        "velocity_mode": 1,
        "velocity": xyz(TRUE_D[i]),
        "num_good_beams": 4,
        "beam_velocities_valid": True,
        "altitude": 4.0,
        "range": 4.0 / true[:, 2],
        "beam_unit_vec": [xyz(vector) for vector in told],
        "beam_velocity": true @ TRUE_D[i],
    }


def water_linked(i: int, true: Floats) -> dict[str, Any]:
    beams = [
        {"id": n, "velocity": true[n] @ TRUE_D[i], "distance": 4.3, "valid": True}
        for n in range(4)
    ]
    return {
        "velocity": xyz(TRUE_D[i]),
        "velocity_valid": True,
        "beams": beams,
        **validity("dvl_msgs/msg/DVL", i),
    }


def validity(type_name: str, i: int) -> dict[str, Any]:
    """Give the time of validity, us, to the type that has one."""
    return (
        {"time_of_validity": START_NS // 1000 + round(TIMES[i] * 1e6)}
        if type_name == "dvl_msgs/msg/DVL"
        else {}
    )


def written(folder: Path, type_name: str, pings: list[dict[str, Any]], **settings: Any) -> Dive:
    rows = [
        ("/dvl", type_name, time_s, {"header": header(time_s)} | ping)
        for time_s, ping in zip(TIMES.tolist(), pings, strict=True)
    ]
    path = write_log(folder / "dive.mcap", [*imu_messages(), *rows])
    return read_dive(path, Config(dvl=Dvl(**settings)))


def codes(dive: Dive) -> set[str]:
    return {note.code for note in dive.notes}


def velocities(dive: Dive) -> Floats:
    if dive.dvl.velocity_d is not None:
        return dive.dvl.velocity_d
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    return solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)[0]


@pytest.mark.parametrize(
    ("true", "told"),
    [
        (A50, beam_vectors(67.5, (135.0, 225.0, 315.0, 45.0))),  # sine and cosine swapped
        (A50, A50[:, [1, 0, 2]]),  # x and y swapped
        (A50, A50[[1, 0, 3, 2]]),  # beams in another order
        (A50, A50 * [1.0, -1.0, 1.0]),  # mirrored
        (A50, beam_vectors(25.0, (135.0, 225.0, 315.0, 45.0))),  # another tilt
        (A50, -np.ones((4, 3))),  # no directions
        (JANUS, np.tile([0.0, 0.0, 1.0], (4, 1))),
    ],
    ids=["tilt", "x and y", "order", "mirrored", "2.5 deg", "minus one", "all down"],
)
def test_velocity_is_right_whatever_directions_the_messages_tell(
    true: Floats, told: Floats, tmp_path: Path
) -> None:
    dive = written(tmp_path, APL, [message(i, true, told) for i in range(len(TIMES))])
    np.testing.assert_allclose(velocities(dive), TRUE_D, atol=2e-3)
    assert codes(dive) & {"dvl_beam_geometry", "dvl_beam_directions", "dvl_beams_unused"}
    assert "dvl_beam_contradiction" not in codes(dive)


def test_swapped_sine_and_cosine_keep_the_beams(tmp_path: Path) -> None:
    told = beam_vectors(67.5, (135.0, 225.0, 315.0, 45.0))
    dive = written(tmp_path, APL, [message(i, A50, told) for i in range(len(TIMES))])
    np.testing.assert_allclose(dive.dvl.beam_vectors_d, A50, atol=1e-6)


def test_order_of_a_type_that_tells_no_directions_is_found_or_not_needed(tmp_path: Path) -> None:
    dive = written(
        tmp_path,
        "dvl_msgs/msg/DVL",
        [water_linked(i, A50[[2, 3, 0, 1]]) for i in range(len(TIMES))],
    )
    np.testing.assert_allclose(velocities(dive), TRUE_D, atol=1e-6)
    odd = beam_vectors(28.0, (10.0, 100.0, 200.0, 290.0))
    dive = written(tmp_path, "dvl_msgs/msg/DVL", [water_linked(i, odd) for i in range(len(TIMES))])
    np.testing.assert_array_equal(dive.dvl.velocity_d, TRUE_D)
    assert "dvl_beams_unused" in codes(dive)


def test_directions_that_a_person_gives_stay(tmp_path: Path) -> None:
    dive = written(
        tmp_path,
        "dvl_msgs/msg/DVL",
        [water_linked(i, A50) for i in range(len(TIMES))],
        beam_tilt_deg=30.0,
    )
    np.testing.assert_allclose(
        dive.dvl.beam_vectors_d, beam_vectors(30.0, (135.0, 225.0, 315.0, 45.0)), atol=1e-12
    )
    assert "dvl_beam_contradiction" in codes(dive)


def test_velocity_in_north_and_east_is_not_used_for_the_beams(tmp_path: Path) -> None:
    pings = [message(i, JANUS, JANUS) for i in range(len(TIMES))]
    for i, ping in enumerate(pings):
        turn = 0.5 * TIMES[i]
        forward, starboard, down = TRUE_D[i]
        north = np.cos(turn) * forward - np.sin(turn) * starboard
        east = np.sin(turn) * forward + np.cos(turn) * starboard
        ping["velocity"] = xyz([north, east, down])
    dive = written(tmp_path, APL, pings)
    np.testing.assert_allclose(velocities(dive), TRUE_D, atol=1e-6)
    assert "dvl_beam_contradiction" in codes(dive)


def test_noise_of_the_beams_is_no_contradiction() -> None:
    rng = np.random.default_rng(3)
    along = TRUE_D @ A50.T + 0.02 * rng.standard_normal((len(TRUE_D), 4))
    pings = BeamVelocities.of_pings(along, along @ np.linalg.pinv(A50).T)
    assert pings.agree(A50)
    assert not pings.agree(beam_vectors(25.0, (135.0, 225.0, 315.0, 45.0)))
    assert not pings.agree(A50 * [1.0, -1.0, 1.0])
    assert agreeing_directions(pings, A50 * [-1.0, 1.0, 1.0], None) is not None


# Beams that are lost


def without(i: int, n: int, **values: float) -> dict[str, Any]:
    ping = message(i, A50, A50)
    beams = np.array(ping["beam_velocity"])
    beams[n] = values.get("velocity", 0.0)
    ranges = np.array(ping["range"])
    ranges[n] = values.get("range", ranges[n])
    return ping | {
        "beam_velocity": beams,
        "range": ranges,
        "num_good_beams": values.get("good", 4),
    }


@pytest.mark.parametrize(
    "lost",
    [
        {"range": -1.0},
        {"range": 0.0},
        {"range": np.nan},
        {"good": 3},
        {"range": -1.0, "velocity": 0.3},
    ],
    ids=["-1", "0", "NaN", "three good", "stale"],
)
def test_lost_beam_of_velocity_zero_is_missing(lost: dict[str, float], tmp_path: Path) -> None:
    pings = [
        without(i, i % 4, **lost) if i % 5 == 0 else message(i, A50, A50)
        for i in range(len(TIMES))
    ]
    dive = written(tmp_path, APL, pings)
    assert dive.dvl.beam_velocity_mps is not None
    missing = np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)).tolist()
    assert missing == [[i, i % 4] for i in range(0, len(TIMES), 5)]
    np.testing.assert_allclose(velocities(dive), TRUE_D, atol=1e-6)
    (note,) = [note for note in dive.notes if note.code == "dvl_lost_beams"]
    assert note.count == len(missing)


def test_ranges_that_are_not_measured_lose_no_beam(tmp_path: Path) -> None:
    dive = written(
        tmp_path, APL, [message(i, A50, A50) | {"range": np.zeros(4)} for i in range(len(TIMES))]
    )
    assert np.isfinite(dive.dvl.beam_velocity_mps).all()


@pytest.mark.parametrize(
    "name", ["dvl_msgs/msg/DVL", "waterlinked_a50_ros_driver/msg/DVL", "stonefish_ros2/msg/DVL"]
)
def test_beams_without_echo_of_other_types_are_missing(name: str, tmp_path: Path) -> None:
    key = "range" if name.startswith("stonefish") else "distance"
    pings = []
    for i in range(len(TIMES)):
        beams = [{"velocity": A50[n] @ TRUE_D[i], key: 4.3} for n in range(4)]
        beams[2] |= {"velocity": 0.0, key: (-1.0, 0.0, np.nan)[i % 3]} if i % 7 == 0 else {}
        extra: dict[str, Any] = {"altitude": 4.0}
        if key == "distance":
            extra = {"velocity_valid": True, **validity(name, i)}
            beams = [beam | {"valid": True} for beam in beams]
        pings.append({"velocity": xyz(TRUE_D[i]), "beams": beams} | extra)
    settings = {"beam_tilt_deg": 22.5, "beam_azimuth_deg": (135.0, 225.0, 315.0, 45.0)}
    dive = written(tmp_path, name, pings, **settings)
    assert dive.dvl.beam_velocity_mps is not None
    assert np.argwhere(np.isnan(dive.dvl.beam_velocity_mps)).tolist() == [
        [i, 2] for i in range(0, len(TIMES), 7)
    ]
    np.testing.assert_allclose(velocities(dive), TRUE_D, atol=1e-6)
