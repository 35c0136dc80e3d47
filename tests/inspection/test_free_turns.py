"""IMUs and DVLs that are built in obliquely: found from arrays, with and without a reference."""

from dataclasses import replace

import numpy as np
import pytest

from insdvl_replay.calibration.free_mounting import angle_between
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ImuColumns
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import solve_beams
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.inspection.free_turns import in_body, turn_freely
from insdvl_replay.inspection.proposal import Given
from insdvl_replay.inspection.trials import Hypothesis, Trials, thinned, trial_config
from insdvl_replay.sim.dive import simulate_dive

ONE_DEG = 1.0 * DEG


def mat(*rpy_deg: float) -> np.ndarray:
    return np.asarray(mat_from_rpy(np.array(rpy_deg) * DEG))


def oblique(dvl_rpy_deg: tuple[float, float, float], imu_rpy_deg: tuple[float, float, float]) -> Dive:
    """A dive whose DVL gives velocities, with the readings of an IMU that is turned in the body."""
    dive = simulate_dive(
        "calibration", seed=5, grade="tactical", duration_s=160.0, imu_rate_hz=25.0, dvl_rate_hz=2.0,
        mounting_rpy_deg=dvl_rpy_deg,
    )  # fmt: skip
    assert dive.dvl.beam_velocity_mps is not None
    assert dive.dvl.beam_vectors_d is not None
    velocity_d, *_ = solve_beams(dive.dvl.beam_velocity_mps, dive.dvl.beam_vectors_d)
    turn = mat(*imu_rpy_deg)
    imu = ImuColumns(dive.imu.time_ns, dive.imu.specific_force_b @ turn, dive.imu.angular_rate_b @ turn)
    dvl = replace(dive.dvl, beam_velocity_mps=None, beam_vectors_d=None, velocity_d=velocity_d)
    return replace(dive, imu=imu, dvl=dvl)


def found_in(dive: Dive, given: Given) -> tuple[Hypothesis, Trials]:
    trials = Trials(thinned(dive), trial_config(Config(), 32.8), Hypothesis(), given)
    turn_freely(trials, dive.dvl)
    return in_body(trials.found[0], dive, Config(), is_as_read=True), trials


@pytest.mark.parametrize(
    ("dvl_rpy_deg", "imu_rpy_deg", "has_reference"),
    [((0.0, 0.0, 22.5), (0.0, 0.0, 0.0), False), ((0.0, 0.0, 0.0), (0.0, 30.0, 0.0), False),
     ((180.0, 0.0, 45.0), (-20.0, 10.0, 40.0), True)],
)  # fmt: skip
def test_oblique_mountings_are_found(
    dvl_rpy_deg: tuple[float, float, float], imu_rpy_deg: tuple[float, float, float], has_reference: bool
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
