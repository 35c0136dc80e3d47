"""A DVL's mounting of any size is found from the motion alone, and not where the motion leaves it open."""

import numpy as np
import pytest

from insdvl_replay.calibration import fit
from insdvl_replay.calibration.fit import AXES, likeliest_mounting
from insdvl_replay.calibration.free_mounting import (
    CLEARLY,
    FreeMounting,
    LevelDvl,
    angle_between,
    down_of,
    free_mounting,
    velocities_of,
)
from insdvl_replay.calibration.innovations import ReadDive
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.sim.dive import simulate_dive

ONE_DEG = 1.0 * DEG


def turned_dive(rpy_deg: tuple[float, float, float], scenario: str = "calibration") -> Dive:
    return simulate_dive(
        scenario, seed=3, grade="tactical", duration_s=200.0, imu_rate_hz=25.0, dvl_rate_hz=2.0,
        lever_arm_m=(0.5, -0.2, 0.3), mounting_rpy_deg=rpy_deg, dvl_delay_s=0.13, dvl_scale=1.02,
    )  # fmt: skip


def fitted(dive: Dive) -> FreeMounting:
    found = free_mounting(dive.imu, *velocities_of(dive.dvl), AXES)
    assert found is not None
    return found


@pytest.mark.parametrize(
    "rpy_deg", [(0.0, 0.0, 135.0), (3.0, -4.0, 22.5), (178.0, 2.0, -70.0), (90.0, 0.0, 10.0)]
)
def test_any_rotation_is_found_with_unknown_arm_delay_and_scale(
    rpy_deg: tuple[float, float, float],
) -> None:
    found, true = fitted(turned_dive(rpy_deg)), mat_from_rpy(np.array(rpy_deg) * DEG)
    assert angle_between(found.mat, true) < ONE_DEG
    assert found.delay_s == pytest.approx(0.13, abs=0.03)
    assert (
        found.held_out_misfit(true, true @ mat_from_rpy(np.array([0.0, 0.0, 22.5]) * DEG))
        > CLEARLY
    )


def test_straight_line_excludes_no_turn_about_down() -> None:
    found = fitted(turned_dive((0.0, 0.0, 0.0), "straight"))
    for heading_deg in (-90.0, -22.5, 45.0):
        assert found.misfit(mat_from_rpy(np.array([0.0, 0.0, heading_deg]) * DEG)) < CLEARLY


def test_dvl_looks_down_where_motion_does_not_tell_it_from_one_upside_down() -> None:
    """A vehicle that never slips measures the same with both; level it is, since its roll is open too."""
    dive = turned_dive((0.0, 0.0, 60.0), "figure-eight")
    level = LevelDvl(fitted(dive), down_of(dive.imu))
    assert (
        angle_between(level.likeliest, mat_from_rpy(np.array([0.0, 0.0, 60.0]) * DEG)) < 4.0 * DEG
    )
    assert {round(level.tilt(mat)) for mat in level.minima} == {-1, 1}


def test_of_mountings_that_are_about_as_likely_the_first_that_looks_down_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that is on its side, 75 deg, does not look down, and one that is clearly less likely is not asked."""
    tried = [
        fit.TriedMounting((180.0, 0.0, 60.0), 100.0),
        fit.TriedMounting((75.0, 0.0, 0.0), 100.1),
        fit.TriedMounting((0.0, 0.0, 60.0), 100.2),
        fit.TriedMounting((0.0, 0.0, 0.0), 1000.0),
    ]
    monkeypatch.setattr(fit, "tried_mountings", lambda _: tried)
    assert likeliest_mounting([]) == (0.0, 0.0, 60.0)
    monkeypatch.setattr(fit, "tried_mountings", lambda _: [tried[0], tried[3]])
    assert likeliest_mounting([]) == (180.0, 0.0, 60.0)


@pytest.mark.nightly
@pytest.mark.parametrize("rpy_deg", [(0.0, 0.0, 33.0), (90.0, 20.0, -60.0), (0.0, 0.0, 90.0)])
def test_unknown_mounting_is_any_rotation(rpy_deg: tuple[float, float, float]) -> None:
    config = load_config("tactical")
    found = likeliest_mounting([ReadDive(turned_dive(rpy_deg), config)])
    apart = angle_between(*(mat_from_rpy(np.array(angles) * DEG) for angles in (found, rpy_deg)))
    assert apart < ONE_DEG
