"""IMUs and DVLs that are built in obliquely: found from arrays, with and without a reference."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.calibration.found import Given
from insdvl_replay.calibration.free_mounting import angle_between
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, ImuColumns
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import solve_beams
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.free_turns import in_body, turn_freely
from insdvl_replay.inspection.roles import dvl_note
from insdvl_replay.inspection.trials import Hypothesis, Trials, rpy_of, thinned, trial_config
from insdvl_replay.sim.dive import simulate_dive

ONE_DEG = 1.0 * DEG


def mat(*rpy_deg: float) -> np.ndarray:
    return np.asarray(mat_from_rpy(np.array(rpy_deg) * DEG))


def oblique(
    dvl_rpy_deg: tuple[float, float, float], imu_rpy_deg: tuple[float, float, float]
) -> Dive:
    """A dive whose DVL gives velocities, with the readings of an IMU that is turned in the body."""
    dive = simulate_dive(
        "calibration", seed=5, grade="tactical", duration_s=160.0, imu_rate_hz=25.0, dvl_rate_hz=2.0,
        mounting_rpy_deg=dvl_rpy_deg,
    )  # fmt: skip
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d, *_ = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)
    turn = mat(*imu_rpy_deg)
    imu = ImuColumns(
        dive.imu.time_ns, dive.imu.specific_force_b @ turn, dive.imu.angular_rate_b @ turn
    )
    dvl = replace(dive.dvl, beam_velocity_mps=None, beam_vectors_d=None, velocity_d=velocity_d)
    return replace(dive, imu=imu, dvl=dvl)


def found_in(dive: Dive, given: Given) -> tuple[Hypothesis, Trials]:
    trials = Trials(thinned(dive), trial_config(Config(), 32.8), Hypothesis(), given)
    turn_freely(trials, dive.dvl)
    found, _ = in_body(trials.found[0], dive, Config(), is_as_read=True)
    return found, trials


@pytest.mark.parametrize(
    ("dvl_rpy_deg", "imu_rpy_deg", "has_reference"),
    [((0.0, 0.0, 22.5), (0.0, 0.0, 0.0), False), ((0.0, 0.0, 0.0), (0.0, 30.0, 0.0), False),
     ((180.0, 0.0, 45.0), (-20.0, 10.0, 40.0), True)],
)  # fmt: skip
def test_oblique_mountings_are_found(
    dvl_rpy_deg: tuple[float, float, float],
    imu_rpy_deg: tuple[float, float, float],
    has_reference: bool,
) -> None:
    dive = oblique(dvl_rpy_deg, imu_rpy_deg)
    found, _ = found_in(dive if has_reference else replace(dive, reference=None), Given(Config()))
    assert angle_between(found.gyro_turn, mat(*imu_rpy_deg)) < ONE_DEG
    assert angle_between(mat(*found.rpy_deg), mat(*dvl_rpy_deg)) < ONE_DEG


def test_mounting_that_is_given_is_kept_and_tried() -> None:
    config = load_config(overrides=["dvl.mounting_rpy_deg=[0.0, 0.0, 135.0]"])
    given = Given(config, frozenset({"dvl.mounting_rpy_deg"}))
    found, trials = found_in(oblique((0.0, 0.0, 135.0), (0.0, 0.0, 0.0)), given)
    assert np.isfinite(trials.cost)
    assert found.rpy_deg == (0.0, 0.0, 135.0)
    assert found.axes == "frd"


@pytest.mark.parametrize(
    ("yaw_deg", "dvl_deg", "used_deg", "other_deg"),
    [(0.0, 40.0, 0.0, None), (90.0, 40.0, 90.0, 0.0), (180.0, 40.0, 180.0, 0.0), (90.0, 90.0, 0.0, 90.0)],
)  # fmt: skip
def test_body_of_an_imu_as_read_is_forward_where_only_the_dvl_shows_travel(
    yaw_deg: float, dvl_deg: float, used_deg: float, other_deg: float | None
) -> None:
    """An IMU that is yawed by quarters is turned to the travel; one whose DVL agrees about forward is not."""
    rng = np.random.default_rng(1)
    time_ns = np.arange(200, dtype=np.int64) * 10**8
    force_b = np.array([0.0, 0.0, -9.8]) + rng.normal(0.0, 0.1, (200, 3))
    velocity_b = np.array([1.0, 0.0, 0.0]) + rng.normal(0.0, 0.2, (200, 3))
    yaw, dvl = mat(0.0, 0.0, yaw_deg), mat(0.0, 0.0, dvl_deg)  # into the axes of the body
    dive = Dive(
        "", ImuColumns(time_ns, force_b @ yaw, rng.normal(0.0, 0.1, (200, 3))),
        DvlColumns(time_ns, velocity_d=velocity_b @ dvl),
    )  # fmt: skip
    as_read = Hypothesis(rpy_deg=rpy_of(yaw.T @ dvl))
    found, other = in_body(as_read, dive, Config(), is_as_read=True)
    assert angle_between(found.gyro_turn, mat(0.0, 0.0, used_deg)) < 1e-9
    assert angle_between(mat(*found.rpy_deg), mat(0.0, 0.0, used_deg) @ yaw.T @ dvl) < 1e-9
    assert (other is None) == (other_deg is None)
    if other is not None and other_deg is not None:
        assert angle_between(other.gyro_turn, mat(0.0, 0.0, other_deg)) < 1e-9


def test_each_other_mounting_is_named_once_and_the_one_that_is_used_is_not() -> None:
    last_bits_deg = 90.0 + 1e-12
    others_deg = [(0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 0.0, last_bits_deg)]
    found = dvl_note("/dvl", Hypothesis(), others_deg)
    assert found.severity == "warning"
    assert found.text.count("[0, 0, 90]") == 1
    assert found.text.count("[0, 0, 0]") == 1
    assert "fits" not in dvl_note("/dvl", Hypothesis(), others_deg[:1]).text
