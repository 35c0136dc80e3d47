"""A DVL in knots, ft/s or km/h: the unit is found by how far the reference moves, and by nothing less."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import unknown_logs

from insdvl_replay.calibration.found import Given
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ReferenceColumns
from insdvl_replay.core.units import VELOCITY_UNITS
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.inspection.automatic import find_settings
from insdvl_replay.inspection.roles import read_roles
from insdvl_replay.inspection.unit_by_track import TRACK_UNITS, unit_by_track
from insdvl_replay.logs import write_dive

FIX_SD_M = 0.5


@pytest.fixture(scope="module")
def turning() -> Dive:
    return unknown_logs.plain_dive("figure-eight", imu_rate_hz=50.0)


def fixes(dive: Dive, offset_m: Floats | None = None) -> ReferenceColumns:
    """Return positions of a receiver, once a second, and nothing else."""
    truth = dive.reference
    assert truth is not None
    step_s = float(np.median(np.diff(truth.time_ns))) * 1e-9
    rows = np.arange(0, len(truth.time_ns), max(round(1.0 / step_s), 1))
    moved_n = np.random.default_rng(5).normal(0.0, FIX_SD_M, (len(rows), 3))
    if offset_m is not None:
        moved_n[:, :2] += offset_m * (rows * step_s)[:, np.newaxis]
    return ReferenceColumns(
        truth.time_ns[rows],
        position=moved_position(truth.position[rows], moved_n),
        velocity_n=np.full((len(rows), 3), np.nan),
        mat_nb=np.full((len(rows), 3, 3), np.nan),
    )


def scaled(dive: Dive, scale: float) -> DvlColumns:
    assert dive.dvl.velocity_d is not None
    return replace(dive.dvl, velocity_d=scale * dive.dvl.velocity_d)


@pytest.mark.parametrize("unit", TRACK_UNITS)
@pytest.mark.parametrize("scale", [0.98, 1.0, 1.02])
def test_unit_is_found_by_positions(unit: str, scale: float, turning: Dive) -> None:
    pings = scaled(turning, scale / VELOCITY_UNITS[unit])
    assert unit_by_track(pings, fixes(turning)) == unit


def test_some_wrong_fixes_change_nothing(turning: Dive) -> None:
    reference = fixes(turning)
    reference.position[[20, 60, 61, 100], 0] += 1e-4
    assert unit_by_track(scaled(turning, 1.0 / VELOCITY_UNITS["kn"]), reference) == "kn"


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.04, 1.3, 1.7, 2.3])
def test_a_scale_is_no_unit(scale: float, turning: Dive) -> None:
    assert unit_by_track(scaled(turning, scale), fixes(turning)) is None


def test_a_current_is_no_unit(turning: Dive) -> None:
    """Positions that drift with the water, which the DVL does not see, spread the ratios."""
    pings = scaled(turning, 1.0 / VELOCITY_UNITS["kn"])
    assert unit_by_track(pings, fixes(turning, offset_m=np.array([0.5, -0.4]))) is None


def test_a_dive_that_goes_one_way_does_not_tell() -> None:
    """Against a current a vehicle is slower over ground than through the water all the time."""
    straight = unknown_logs.plain_dive("straight", imu_rate_hz=50.0)
    assert unit_by_track(scaled(straight, 1.0 / VELOCITY_UNITS["kn"]), fixes(straight)) is None


def test_velocities_stand_for_positions_that_are_unknown(turning: Dive) -> None:
    """As in an odometry whose origin nobody knows."""
    truth = turning.reference
    assert truth is not None
    moving = replace(truth, position=np.full_like(truth.position, np.nan))
    assert unit_by_track(scaled(turning, 1.0 / VELOCITY_UNITS["kn"]), moving) == "kn"
    assert unit_by_track(turning.dvl, moving) is None
    unknown = replace(moving, velocity_n=np.full_like(truth.velocity_n, np.nan))
    assert unit_by_track(scaled(turning, 1.0 / VELOCITY_UNITS["kn"]), unknown) is None


def in_knots(dive: Dive, path: Path) -> Path:
    pings = scaled(dive, 1.0 / VELOCITY_UNITS["kn"])
    write_dive(path, replace(dive, dvl=pings, reference=fixes(dive)))
    return path


def test_log_in_knots_is_read_in_knots(turning: Dive, tmp_path: Path) -> None:
    log = in_knots(turning, tmp_path / "knots.mcap")
    (dvl,) = read_roles(log, load_config(), allow_damaged=False).dvls
    assert dvl.unit == "kn"
    true_mps = turning.dvl.velocity_d
    assert true_mps is not None
    assert dvl.pings.velocity_d is not None
    np.testing.assert_allclose(dvl.pings.velocity_d, true_mps, atol=1e-5)


def test_unit_that_is_given_stays(turning: Dive, tmp_path: Path) -> None:
    log = in_knots(turning, tmp_path / "knots.mcap")
    given = load_config(overrides=["dvl.velocity_unit=m/s"])
    (dvl,) = read_roles(log, given, allow_damaged=False).dvls
    assert dvl.unit == ""


def test_unit_is_said_and_no_mounting_is_made_up(turning: Dive, tmp_path: Path) -> None:
    log = in_knots(turning, tmp_path / "knots.mcap")
    found = find_settings([[log]], Given(load_config()))
    assert found.config.dvl.velocity_unit == "kn"
    _, pitch_deg, heading_deg = found.config.dvl.mounting_rpy_deg
    assert abs(pitch_deg) < 5.0
    assert abs(heading_deg) < 5.0
    assert any("measures in kn" in one.text for one in found.notes)
