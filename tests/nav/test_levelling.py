"""The level from gravity, as well as it says: of vehicles that lie, go, turn and pitch, with sensors that err."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from insdvl_replay.core.config import Config, Dvl, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.evaluation.credibility import nees, state_errors
from insdvl_replay.geometry.earth import normal_gravity
from insdvl_replay.geometry.rotation import mat_from_vector, rpy_from_mat, vector_from_mat
from insdvl_replay.logs import read_dive
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.levelling import UNSEEN_MPS2
from insdvl_replay.preparation.alignment import Alignment, align
from insdvl_replay.preparation.prepared import prepare_dive, with_reference_at_imu
from insdvl_replay.preparation.replay import replay_dive, replay_log
from insdvl_replay.sim.dive import START_NS, add_errors, exact_dive
from insdvl_replay.sim.trajectories import HEADING_DEG, Scenario, Wave, turn
from insdvl_replay.studies.montecarlo import matched_errors

MOTIONS = {
    "lying": Scenario("at rest", 20.0, Wave(0.0)),
    "going": Scenario("straight on", 20.0, Wave(2.0)),
    "turning": Scenario(
        "in circles from the first second on", 20.0, Wave(2.0), (turn(720.0, 15.0),)
    ),
    "reeling": Scenario(
        "in circles, faster and slower, pitching and rolling",
        20.0,
        Wave(1.0, 0.5, 8.0),
        (turn(720.0, 15.0),),
        roll_deg=Wave(5.0, 10.0, 7.0),
        pitch_deg=Wave(-8.0, 10.0, 5.0),
    ),
}
ARM = (-1.0, 0.3, 0.5)
LEVEL = Initial(source="level", heading_deg=HEADING_DEG, latitude_deg=32.8)
SEEDS = 60
LEVEL_STATES = [3, 4, *range(6, 12)]
"""Misalignment about north and east, and the biases that it hangs together with."""


@pytest.fixture(autouse=True)
def scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("insdvl_replay.sim.dive.SCENARIOS", MOTIONS)


def exact(motion: str, **options: float) -> Dive:
    return exact_dive(
        motion, imu_rate_hz=100.0, reference_rate_hz=10.0, lever_arm_m=ARM, **options
    )


def levelled(dive: Dive, config: Config) -> Alignment:
    config = msgspec.structs.replace(
        config, dvl=msgspec.structs.replace(config.dvl, lever_arm_m=ARM)
    )
    end_ns = int(dive.imu.time_ns[-1])
    return align(replace(dive, reference=None), config, dvl_velocities(dive.dvl), START_NS, end_ns)


def start_errors(dive: Dive, found: Alignment) -> Floats:
    """Estimated minus true, in the order of the error states."""
    assert dive.reference is not None
    assert dive.truth is not None
    error = np.empty(12)
    error[DV] = found.start.velocity_n - dive.reference.velocity_n[0]
    error[PHI] = vector_from_mat(found.start.mat_nb @ dive.reference.mat_nb[0].T)
    error[BA] = dive.truth.accel_bias_b[0] - found.start.accel_bias_b
    error[BG] = dive.truth.gyro_bias_b[0] - found.start.gyro_bias_b
    return error


def biased(dive: Dive, accel_b: Floats, gyro_b: Floats) -> Dive:
    imu = replace(
        dive.imu,
        specific_force_b=dive.imu.specific_force_b + accel_b,
        angular_rate_b=dive.imu.angular_rate_b + gyro_b,
    )
    return replace(dive, imu=imu)


# --- Perfect sensors.


@pytest.mark.parametrize("motion", MOTIONS)
def test_perfect_sensors_find_level_and_velocity_however_the_vehicle_moves(motion: str) -> None:
    dive = exact(motion)
    error = start_errors(dive, levelled(dive, Config(initial=LEVEL)))
    np.testing.assert_allclose(error[PHI] / DEG, 0.0, atol=0.005)
    np.testing.assert_allclose(error[DV], 0.0, atol=2e-3)


def test_mean_force_alone_takes_a_turn_for_a_tilt() -> None:
    """What the DVL takes off: 2 m/s at 15 deg/s are 0.52 m/s^2, 3 deg."""
    dive = exact("turning")
    force_b = dive.imu.specific_force_b[300:1000].mean(axis=0)
    assert abs(np.arctan2(-force_b[1], -force_b[2])) > 2.9 * DEG


def test_earth_rate_is_taken_off_the_gyros() -> None:
    """Through 10 s the Earth turns by 0.04 deg: a gyro bias of its size, and of no other direction, does that harm."""
    dive = exact("lying")
    error = start_errors(dive, levelled(dive, Config(initial=LEVEL)))
    np.testing.assert_allclose(error[PHI] / DEG, 0.0, atol=1e-4)


# --- Biases.


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("axis", range(6))
def test_covariance_says_how_a_bias_tilts_the_level(motion: str, axis: int) -> None:
    """A regression of the misalignment on each bias, P_phi,b / P_b, is what one such bias does."""
    dive, config = exact(motion), Config(initial=LEVEL)
    bias = np.zeros(6)
    bias[axis] = 1.0 * MG if axis < 3 else 50.0 * DEG_PER_HOUR
    without = levelled(dive, config)
    tilted = levelled(biased(dive, bias[:3], bias[3:]), config)
    found = vector_from_mat(tilted.start.mat_nb @ without.start.mat_nb.T)[:2]
    cov, state = without.start.cov, BA.start + axis
    np.testing.assert_allclose(
        found, cov[3:5, state] / cov[state, state] * bias[axis], rtol=0.01, atol=2e-6
    )


def test_bias_of_a_vehicle_at_rest_tilts_it_as_the_closed_form_says() -> None:
    dive, accel_b = exact("lying"), np.array([3.0, -2.0, 1.0]) * MG
    without = levelled(dive, Config(initial=LEVEL)).start.mat_nb
    tilted = levelled(biased(dive, accel_b, np.zeros(3)), Config(initial=LEVEL)).start.mat_nb
    bias_n, gravity = without @ accel_b, normal_gravity(32.8 * DEG, -20.0)
    phi = Rotation.from_matrix(tilted @ without.T).as_rotvec()
    np.testing.assert_allclose(phi[:2], np.array([-bias_n[1], bias_n[0]]) / gravity, atol=5e-6)


def test_known_biases_do_not_tilt_the_level() -> None:
    accel_mg, gyro_degph = (3.0, -2.0, 1.0), (20.0, -30.0, 200.0)
    dive = biased(exact("reeling"), np.array(accel_mg) * MG, np.array(gyro_degph) * DEG_PER_HOUR)
    told = msgspec.structs.replace(LEVEL, accel_bias_mg=accel_mg, gyro_bias_degph=gyro_degph)
    phi = vector_from_mat(
        levelled(dive, Config(initial=told)).start.mat_nb
        @ levelled(exact("reeling"), Config(initial=LEVEL)).start.mat_nb.T
    )
    np.testing.assert_allclose(phi, 0.0, atol=1e-9)


# --- As uncertain as it says.


@pytest.mark.nightly
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("preset", ["fog", "mems"])
def test_levels_scatter_as_they_say(motion: str, preset: str) -> None:
    config = load_config(
        preset=preset, overrides=["initial.source=level", "initial.latitude_deg=32.8"]
    )
    config = msgspec.structs.replace(
        config,
        initial=msgspec.structs.replace(config.initial, heading_deg=HEADING_DEG),
        dvl=Dvl(velocity_sd_mps=0.02),
    )
    imu_errors, dvl_errors = matched_errors(config)
    dive, cos, sin = exact(motion), np.cos(HEADING_DEG * DEG), np.sin(HEADING_DEG * DEG)
    to_level_axes = np.array([[cos, sin], [-sin, cos]])
    standardised, squares = [], []
    for seed in range(SEEDS):
        run = add_errors(dive, imu_errors, dvl_errors, seed)
        found = levelled(run, config)
        error, cov = start_errors(run, found), found.start.cov
        roll_pitch_sd = np.sqrt(np.diagonal(to_level_axes @ cov[3:5, 3:5] @ to_level_axes.T))
        standardised.append(to_level_axes @ error[3:5] / roll_pitch_sd)
        squares.append(
            nees(error[None, LEVEL_STATES], cov[np.ix_(LEVEL_STATES, LEVEL_STATES)][None])[0]
        )
    rms = np.sqrt(np.mean(np.square(standardised), axis=0))
    assert ((rms > 0.7) & (rms < 1.4)).all()
    # The mean of 60 chi-squares of 8 has a standard deviation of 0.5; four of these.
    assert np.mean(squares) == pytest.approx(len(LEVEL_STATES), abs=2.1)


def test_noise_that_pings_show_counts_if_it_is_more_than_they_are_reported() -> None:
    dive = exact("going")
    errors = matched_errors(load_config(preset="fog"))
    loud = add_errors(dive, errors[0], replace(errors[1], beam_sd_mps=0.2), seed=3)
    told = load_config(preset="fog", overrides=["initial.source=level", "initial.heading_deg=30"])
    told = msgspec.structs.replace(
        told, initial=msgspec.structs.replace(told.initial, latitude_deg=32.8)
    )
    quiet_sd = levelled(dive, told).start.sd[PHI.start]
    sd = levelled(loud, told).start.sd[PHI.start]
    # 0.2 m/s in a beam are 0.28 m/s in each horizontal axis: 0.03 m/s^2 in the slope through ten pings, 0.18 deg.
    assert quiet_sd < 0.03 * DEG
    assert 0.08 * DEG < sd < 0.36 * DEG


def test_configured_misalignment_is_the_headings_alone() -> None:
    own = Initial(
        source="level", heading_deg=30.0, latitude_deg=32.8, misalignment_sd_deg=(9.0, 9.0, 4.0)
    )
    sd = levelled(exact("lying"), Config(initial=own)).start.sd / DEG
    gravity = normal_gravity(32.8 * DEG, -20.0)
    # 50 mg of prior bias, and 0.2 m/s/sqrt(s) through 1.2 / 9 s.
    level_deg = np.hypot(50.0 * MG, 0.20 * np.sqrt(1.2 / 9.0)) / gravity / DEG
    np.testing.assert_allclose(sd[PHI], [level_deg, level_deg, 4.0], rtol=0.01)


def test_velocity_of_the_dvl_errs_as_its_heading_does() -> None:
    sd_deg = (0.5, 0.5, 10.0)
    own = Initial(
        source="level",
        heading_deg=30.0,
        latitude_deg=32.8,
        misalignment_sd_deg=sd_deg,
        uncertainty="settings",
    )
    start = levelled(exact("going"), Config(initial=own)).start
    across = np.array([-np.sin(30.0 * DEG), np.cos(30.0 * DEG), 0.0])
    sd_mps = np.sqrt(across @ start.cov[DV, DV] @ across)
    assert sd_mps == pytest.approx(np.hypot(own.velocity_sd_mps, 2.0 * 10.0 * DEG), rel=1e-3)


# --- Where the DVL does not see.


@pytest.mark.parametrize("lost_s", [(0.0, 20.0), (1.0, 20.0)], ids=["no ping", "one ping"])
def test_level_without_pings_allows_for_what_nobody_saw(lost_s: tuple[float, float]) -> None:
    dive = exact_dive("turning", lever_arm_m=ARM, outages=[lost_s])
    if lost_s[0] == 0.0:
        whole = exact("turning")
        late = replace(whole.dvl, time_ns=whole.dvl.time_ns + 40_000_000_000)
        dive = replace(whole, dvl=late)
    found = levelled(dive, Config(initial=LEVEL))
    (note,) = (note for note in found.notes if note.code == "start_level_unaided")
    assert note.severity == "warning"
    roll_sd = found.start.sd[PHI.start]
    assert roll_sd > UNSEEN_MPS2 / 9.81
    assert np.abs(start_errors(dive, found)[3:5]).max() < 3.0 * roll_sd


def test_pause_of_the_imu_ends_the_levelling() -> None:
    dive = exact("turning")
    heard = (dive.imu.time_ns <= START_NS + 4_000_000_000) | (
        dive.imu.time_ns >= START_NS + 6_000_000_000
    )
    imu = replace(
        dive.imu,
        time_ns=dive.imu.time_ns[heard],
        specific_force_b=dive.imu.specific_force_b[heard],
        angular_rate_b=dive.imu.angular_rate_b[heard],
    )
    found = levelled(replace(dive, imu=imu), Config(initial=LEVEL))
    (note,) = (note for note in found.notes if note.code == "start_levelled")
    assert " 4 s" in note.text
    np.testing.assert_allclose(start_errors(dive, found)[3:5] / DEG, 0.0, atol=0.01)


def test_note_reports_the_level_and_its_uncertainty() -> None:
    found = levelled(exact("reeling"), Config(initial=LEVEL))
    roll_deg, pitch_deg, _ = rpy_from_mat(found.start.mat_nb) / DEG
    (note,) = (note for note in found.notes if note.code == "start_levelled")
    assert note.text.startswith(f"start roll {roll_deg:.2f} +- 2.")
    assert f"pitch {pitch_deg:.2f} +- 2." in note.text
    assert re.search(r" 10 s; heading 30 deg$", note.text)


# --- At sea.

# From the IMU to the DVL and to the point of the reference, as innovations and regressions of eight dives have them.
ARMS = ["dvl.lever_arm_m=[-0.071,-0.015,0.205]", "reference.lever_arm_m=[1.763,0.018,0.111]"]


@pytest.mark.nightly
@pytest.mark.parametrize("run", ["07", "09"])
def test_real_dives_are_levelled_as_their_reference_is_wherever_they_are_started(
    snapir: Path, run: str
) -> None:
    """In turns and on straight legs: the mean force alone errs by 1.2 and 4 deg in the mean square."""
    fog = load_config(preset="fog", overrides=ARMS)
    dive = with_reference_at_imu(read_dive(snapir / f"snapir_{run}.mcap", fog), fog)
    assert dive.reference is not None
    error_deg = []
    for row in range(5, 375, 10):
        heading_deg = rpy_from_mat(dive.reference.mat_nb[row])[2] / DEG
        start_s = (dive.reference.time_ns[row] - dive.imu.time_ns[0]) * 1e-9
        level = [
            "initial.source=level",
            f"initial.heading_deg={heading_deg}",
            f"span.start_s={start_s}",
        ]
        start = prepare_dive(
            dive, load_config(preset="fog", overrides=[*ARMS, *level])
        ).alignment.start
        error_deg.append(vector_from_mat(start.mat_nb @ dive.reference.mat_nb[row].T)[:2] / DEG)
    assert np.sqrt(np.mean(np.square(error_deg))) < 0.02


def test_level_start_keeps_the_positions_of_the_reference_comparable(snapir: Path) -> None:
    heading = ["initial.source=level", "initial.heading_deg=0"]
    replay = replay_log(
        snapir / "snapir_07.mcap", load_config(preset="fog", overrides=[*ARMS, *heading])
    )
    assert replay.dive.reference is not None
    np.testing.assert_allclose(
        replay.histories[0].position[0], replay.dive.reference.position[0], rtol=0.0, atol=1e-6
    )


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_matrix_of_a_rotation_vector_is_its_exponential(
    vector: tuple[float, float, float],
) -> None:
    np.testing.assert_allclose(
        mat_from_vector(np.array(vector)),
        Rotation.from_rotvec(vector).as_matrix(),
        rtol=0.0,
        atol=1e-14,
    )


@pytest.mark.nightly
def test_filter_is_nearly_as_sure_as_it_says_after_a_levelled_start() -> None:
    """The window's pings make the level and aid the filter again: it is somewhat too sure at first, not by much."""
    config = load_config("fog", overrides=["initial.source='level'", "initial.heading_deg=30"])
    config = msgspec.structs.replace(config, filters={"baseline": config.filters["baseline"]})
    exact, errors = (
        exact_dive("turning", duration_s=60.0, imu_rate_hz=50.0),
        matched_errors(config),
    )
    nees_by_run = []
    for seed in range(20):
        dive = add_errors(exact, *errors, seed)
        history = replay_dive(dive, config, keep_cov=True).histories[0]
        assert dive.reference is not None
        found = state_errors(history, dive.reference, dive.truth)
        rows = np.searchsorted(
            found.time_ns, dive.imu.time_ns[0] + np.array([10, 59]) * 1_000_000_000
        )
        nees_by_run.append(nees(found.error[rows], found.cov[rows]))
    early, late = np.mean(nees_by_run, axis=0)
    assert 9.0 < early < 20.0
    assert 9.0 < late < 17.0
