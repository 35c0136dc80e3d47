"""Simulated dives: the motion is exact, the errors are of the size asked for, and the bytes come again."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pyins.sim
import pyins.transform
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Dive, DvlColumns, Floats, ReferenceColumns, seconds
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.earth import (
    EARTH_RATE,
    meridian_radius_m,
    normal_gravity,
    transverse_radius_m,
)
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.sim.dive import START_NS, add_errors, exact_dive, simulate_dive
from insdvl_replay.sim.sensor_errors import (
    GRADES,
    DvlErrors,
    ImuErrors,
    LostBeam,
    beam_vectors_d,
    quantise,
)
from insdvl_replay.sim.trajectories import (
    RAMP_S,
    SCENARIOS,
    START,
    Segment,
    Trajectory,
    Wave,
    sine_and_cosine,
    turn,
)

WHITE = ImuErrors(accel_white_mps_rts=0.02, gyro_white_rad_rts=3e-4)
REPEATABLE = settings(derandomize=True, deadline=None)
SILENT_DVL = DvlErrors(
    beam_sd_mps=0.0, beam_bias_sd_mps=0.0, beam_scale_sd=0.0, beam_quantum_mps=0.0
)


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def beams_of(dive: Dive) -> Floats:
    assert dive.dvl.beam_velocity_mps is not None
    return dive.dvl.beam_velocity_mps


# --- The scenarios have the paper's figures.


@pytest.mark.parametrize(
    ("name", "duration_s", "speed_mps", "mean_rate_degps", "peak_rate_degps"),
    [
        ("straight", 424.0, 2.0, 0.0, 0.0),
        ("figure-eight", 394.0, 0.9, 1.41, 17.0),
        ("lawnmower", 1500.0, 0.6 / 3.6, 0.48, 15.0),
        ("static", 300.0, 0.0, 0.0, 0.0),
    ],
)
def test_scenario_has_the_papers_figures(
    name: str, duration_s: float, speed_mps: float, mean_rate_degps: float, peak_rate_degps: float
) -> None:
    scenario = SCENARIOS[name]
    time_s = np.arange(0.0, scenario.duration_s, 0.01)
    turn_rate_degps = np.abs(scenario.rpy_rate(time_s)[:, 2]) / DEG
    assert scenario.duration_s == duration_s
    assert scenario.velocity_b(time_s)[:, 0].mean() == pytest.approx(speed_mps, abs=1e-4)
    assert turn_rate_degps.mean() == pytest.approx(mean_rate_degps, abs=0.005)
    assert turn_rate_degps.max() == pytest.approx(peak_rate_degps, abs=0.01)


def test_figure_eight_is_two_loops_that_meet_at_the_crossing() -> None:
    scenario = SCENARIOS["figure-eight"]
    time_s = np.arange(0.0, 394.0, 0.1)
    position = Trajectory(scenario, 394.0).at(time_s).position - START
    north_m = position[:, 0] * meridian_radius_m(START[0])
    east_m = position[:, 1] * transverse_radius_m(START[0]) * np.cos(START[0])
    turning = np.abs(scenario.rpy_rate(time_s)[:, 2]) > 1.0 * DEG
    assert time_s[turning][0] == pytest.approx(100.0, abs=1.0)
    heading_degps = scenario.rpy_rate(time_s)[:, 2] / DEG
    assert 0.1 * heading_degps[time_s < 178.0].sum() == pytest.approx(277.8, abs=0.1)
    assert 0.1 * heading_degps[time_s >= 178.0].sum() == pytest.approx(-277.8, abs=0.1)
    first = (time_s > 50.0) & (time_s < 95.0)
    halfway = (time_s > 160.0) & (time_s < 196.0)
    apart_m = np.hypot(
        north_m[first][:, None] - north_m[halfway], east_m[first][:, None] - east_m[halfway]
    )
    assert apart_m.min() < 0.1, "the way from one loop to the other crosses the first leg"


def test_lawnmower_turns_ever_sharper() -> None:
    turns = [segment for segment in SCENARIOS["lawnmower"].segments if segment.turn_deg]
    assert [abs(segment.peak_rate) / DEG for segment in turns] == pytest.approx(
        [6.0, 9.0, 12.0, 15.0]
    )
    assert [segment.turn_deg for segment in turns] == [180.0, -180.0, 180.0, -180.0]


# --- Formulae and their derivatives belong together.


def assert_derivative(
    value: Callable[[Floats], Floats], rate: Callable[[Floats], Floats], time_s: float
) -> None:
    step_s = 1e-4
    around = np.array([time_s - step_s, time_s + step_s])
    slope = np.diff(value(around), axis=0)[0] / (2.0 * step_s)
    np.testing.assert_allclose(slope, rate(np.array([time_s]))[0], atol=1e-6)


@REPEATABLE
@given(name=st.sampled_from(sorted(SCENARIOS)), time_s=st.floats(0.0, 1600.0))
def test_rates_are_derivatives(name: str, time_s: float) -> None:
    scenario = SCENARIOS[name]
    assert_derivative(scenario.rpy, scenario.rpy_rate, time_s)
    assert_derivative(scenario.velocity_b, scenario.velocity_rate_b, time_s)


@REPEATABLE
@given(angle_deg=st.floats(1.0, 360.0), to_port=st.booleans(), rate_degps=st.floats(1.0, 30.0))
def test_turn_turns_by_its_angle(angle_deg: float, to_port: bool, rate_degps: float) -> None:
    angle_deg = -angle_deg if to_port else angle_deg
    segment = turn(angle_deg, rate_degps)
    ends = segment.heading_change(
        np.array([-5.0, 0.0, segment.duration_s, segment.duration_s + 100.0])
    )
    np.testing.assert_allclose(ends, [0.0, 0.0, angle_deg * DEG, angle_deg * DEG], atol=1e-12)
    area, _ = quad(
        lambda t: segment.heading_rate(np.array([t]))[0], 0.0, segment.duration_s, limit=200
    )
    assert area == pytest.approx(angle_deg * DEG, abs=1e-6)


def test_turn_rate_has_no_corner() -> None:
    time_s = np.linspace(-1.0, 12.0, 130_001)
    acceleration = np.gradient(Segment(10.0, 90.0).heading_rate(time_s), time_s)
    peak = 1.5 * Segment(10.0, 90.0).peak_rate / RAMP_S
    assert np.abs(acceleration).max() == pytest.approx(peak, rel=1e-3)
    assert np.abs(np.diff(acceleration)).max() < 1e-3 * peak


def test_wave_swings_about_its_mean() -> None:
    wave = Wave(2.0, 0.5, 10.0)
    np.testing.assert_allclose(
        wave.value(np.array([0.0, 2.5, 5.0, 7.5])), [2.0, 2.5, 2.0, 1.5], atol=1e-12
    )


@REPEATABLE
@given(
    angle=st.floats(-1e6, 1e6)
    | st.integers(-600_000, 600_000).map(lambda quarters: quarters * np.pi / 2.0)
)
def test_sines_are_those_of_the_library_to_the_last_bit_or_two(angle: float) -> None:
    sine, cosine = sine_and_cosine(np.array([angle]))
    assert sine[0] == pytest.approx(math.sin(angle), rel=0.0, abs=3e-16)
    assert cosine[0] == pytest.approx(math.cos(angle), rel=0.0, abs=3e-16)


# --- Perfect sensors: mechanising their readings gives the motion back.


def mechanise(dive: Dive) -> tuple[Floats, Floats, Floats]:
    """Integrate by Runge-Kutta over pairs of IMU intervals: position, velocity, and the attitude as nine numbers."""
    reference = reference_of(dive)
    force, rate = dive.imu.specific_force_b, dive.imu.angular_rate_b
    step_s = 2.0 * float(dive.imu.time_ns[1] - dive.imu.time_ns[0]) * 1e-9
    state = np.concatenate(
        [reference.position[0], reference.velocity_n[0], reference.mat_nb[0].ravel()]
    )
    states = [state]
    for k in range(0, len(force) - 2, 2):
        k1 = state_rate(state, force[k], rate[k])
        k2 = state_rate(state + 0.5 * step_s * k1, force[k + 1], rate[k + 1])
        k3 = state_rate(state + 0.5 * step_s * k2, force[k + 1], rate[k + 1])
        k4 = state_rate(state + step_s * k3, force[k + 2], rate[k + 2])
        state = state + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        states.append(state)
    history = np.array(states)
    return history[:, :3], history[:, 3:6], history[:, 6:].reshape(-1, 3, 3)


def state_rate(state: Floats, force_b: Floats, rate_b: Floats) -> Floats:
    (latitude, _, height_m), (north, east, down), mat = (
        state[:3],
        state[3:6],
        state[6:].reshape(3, 3),
    )
    radius_n, radius_e = (
        meridian_radius_m(latitude) + height_m,
        transverse_radius_m(latitude) + height_m,
    )
    earth = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    transport = np.array([east / radius_e, -north / radius_n, -east * np.tan(latitude) / radius_e])
    gravity = np.array([0.0, 0.0, normal_gravity(latitude, height_m)])
    velocity_rate = mat @ force_b + gravity - skew(2.0 * earth + transport) @ state[3:6]
    mat_rate = mat @ skew(rate_b) - skew(earth + transport) @ mat
    position_rate = [north / radius_n, east / (radius_e * np.cos(latitude)), -down]
    return np.concatenate([position_rate, velocity_rate, mat_rate.ravel()])


def test_mechanised_readings_give_the_motion_back() -> None:
    dive = exact_dive("figure-eight", imu_rate_hz=40.0, reference_rate_hz=20.0)
    reference = reference_of(dive)
    position, velocity_n, mat_nb = mechanise(dive)
    metres = [meridian_radius_m(START[0]), transverse_radius_m(START[0]) * np.cos(START[0]), 1.0]
    np.testing.assert_allclose((position - reference.position) * metres, 0.0, atol=1e-3)
    np.testing.assert_allclose(velocity_n, reference.velocity_n, atol=1e-5)
    np.testing.assert_allclose(mat_nb, reference.mat_nb, atol=1e-6)


def test_pyins_feels_the_same() -> None:
    """Its IMU comes from splines in the inertial frame, which round the corners of the turns' jerk a little."""
    time_s = np.arange(0.0, 394.0, 0.02)
    motion = Trajectory(SCENARIOS["figure-eight"], 394.0).at(time_s)
    rpy_deg = Rotation.from_matrix(motion.mat_nb).as_euler("ZYX", degrees=True)[:, ::-1]
    start_lla = [START[0] / DEG, START[1] / DEG, START[2]]
    trajectory, imu = pyins.sim.generate_imu(time_s, start_lla, rpy_deg, motion.velocity_n)
    force_error = imu[["accel_x", "accel_y", "accel_z"]].to_numpy() - motion.specific_force_b
    rate_error = imu[["gyro_x", "gyro_y", "gyro_z"]].to_numpy() - motion.angular_rate_b
    np.testing.assert_allclose(force_error, 0.0, atol=1e-4)
    np.testing.assert_allclose(rate_error, 0.0, atol=5e-5)
    np.testing.assert_allclose(np.median(force_error, axis=0), 0.0, atol=5e-7)
    np.testing.assert_allclose(np.median(rate_error, axis=0), 0.0, atol=1e-9)
    metres = [111e3, 93e3, 1.0]
    np.testing.assert_allclose(
        (trajectory[["lat", "lon", "alt"]] - motion.position / [DEG, DEG, 1.0]) * metres,
        0.0,
        atol=2e-6,
    )


def test_vehicle_at_rest_feels_gravity_and_the_earth() -> None:
    dive = exact_dive("static", duration_s=10.0)
    mat_nb = Rotation.from_euler("ZYX", [30.0, 0.0, 0.0], degrees=True)
    earth_n = EARTH_RATE * np.array([np.cos(START[0]), 0.0, -np.sin(START[0])])
    np.testing.assert_allclose(dive.imu.specific_force_b[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        dive.imu.specific_force_b[:, 2], -normal_gravity(START[0], START[2]), atol=1e-12
    )
    np.testing.assert_allclose(
        dive.imu.angular_rate_b, np.tile(mat_nb.inv().apply(earth_n), (1001, 1)), atol=1e-15
    )
    np.testing.assert_array_equal(beams_of(dive), 0.0)


# --- Sampling.


def test_reference_starts_with_the_imu_and_pings_fall_between_samples() -> None:
    dive = exact_dive("straight")
    reference = reference_of(dive)
    assert dive.imu.time_ns[0] == reference.time_ns[0] == START_NS
    assert dive.imu.time_ns[-1] == reference.time_ns[-1] == START_NS + 424 * 10**9
    assert len(dive.imu.time_ns) == 42_401
    assert len(dive.dvl.time_ns) == 424
    assert not np.isin(dive.dvl.time_ns, dive.imu.time_ns).any()
    np.testing.assert_array_equal(np.diff(dive.dvl.time_ns), 10**9)


def test_duration_cuts_and_extends() -> None:
    whole, cut, longer = (exact_dive("figure-eight", duration_s=s) for s in (None, 120.0, 420.0))
    np.testing.assert_allclose(
        cut.imu.specific_force_b, whole.imu.specific_force_b[:12_001], atol=1e-12
    )
    np.testing.assert_allclose(
        longer.imu.angular_rate_b[:39_401], whole.imu.angular_rate_b, atol=1e-14
    )
    assert SCENARIOS["figure-eight"].rpy_rate(np.array([400.0, 419.0]))[:, 2].tolist() == [
        0.0,
        0.0,
    ]


def test_long_dive_does_not_show_its_blocks() -> None:
    fast, slow = (
        exact_dive("straight", duration_s=11_000.0, imu_rate_hz=hz) for hz in (10.0, 5.0)
    )
    np.testing.assert_allclose(
        fast.imu.specific_force_b[::2], slow.imu.specific_force_b, atol=1e-12
    )
    np.testing.assert_array_equal(fast.imu.time_ns[::2], slow.imu.time_ns)


# --- The DVL.


def test_beams_see_the_velocity_of_the_dvls_own_place() -> None:
    """Compare with the place of the DVL in the Earth's frame, differenced between two instants."""
    lever_arm_m, mounting_rpy_deg, half_s = (1.2, -0.4, 0.3), (2.0, -3.0, 44.0), 0.005
    dive = exact_dive("figure-eight", lever_arm_m=lever_arm_m, mounting_rpy_deg=mounting_rpy_deg)
    course = Trajectory(SCENARIOS["figure-eight"], 395.0)
    mat_bd = Rotation.from_euler("ZYX", mounting_rpy_deg[::-1], degrees=True).as_matrix()
    ping_s = seconds(dive.dvl.time_ns, START_NS)

    def place_and_axes(time_s: Floats) -> tuple[Floats, Floats]:
        motion = course.at(time_s)
        lla = motion.position / [DEG, DEG, 1.0]
        mat_eb = pyins.transform.mat_en_from_ll(lla[:, 0], lla[:, 1]) @ motion.mat_nb
        return pyins.transform.lla_to_ecef(lla) + mat_eb @ lever_arm_m, mat_eb @ mat_bd

    velocity_e = (place_and_axes(ping_s + half_s)[0] - place_and_axes(ping_s - half_s)[0]) / (
        2.0 * half_s
    )
    velocity_d = np.einsum("kji,kj->ki", place_and_axes(ping_s)[1], velocity_e)
    np.testing.assert_allclose(beams_of(dive), velocity_d @ beam_vectors_d().T, atol=1e-5)


def test_beams_point_down_and_around() -> None:
    vectors = beam_vectors_d()
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-11)
    np.testing.assert_allclose(np.degrees(np.arccos(vectors[:, 2])), 30.0, atol=1e-9)
    np.testing.assert_allclose(
        np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0])) % 360, [45, 135, 225, 315], atol=1e-9
    )


@REPEATABLE
@given(start_s=st.floats(0.0, 59.0), length_s=st.floats(0.1, 30.0), beam=st.integers(0, 3))
def test_beams_are_lost_when_asked_and_only_then(
    start_s: float, length_s: float, beam: int
) -> None:
    end_s = start_s + length_s
    lost = exact_dive(
        "static", duration_s=60.0, imu_rate_hz=1.0, lost_beams=[LostBeam(beam, start_s, end_s)]
    )
    out = exact_dive("static", duration_s=60.0, imu_rate_hz=1.0, outages=[(start_s, end_s)])
    ping_s = seconds(out.dvl.time_ns, START_NS)
    within = (ping_s >= start_s) & (ping_s < end_s)
    np.testing.assert_array_equal(np.isnan(beams_of(lost)[:, beam]), within)
    assert np.isnan(beams_of(lost)).sum() == within.sum()
    np.testing.assert_array_equal(np.isnan(beams_of(out)), np.repeat(within[:, None], 4, axis=1))


def test_lost_beams_stay_lost_with_errors_and_leave_the_others_draws_alone() -> None:
    whole = simulate_dive("straight", duration_s=60.0)
    holed = simulate_dive(
        "straight", duration_s=60.0, outages=[(10.0, 20.0)], lost_beams=[LostBeam(2, 30.0, 40.0)]
    )
    seen = np.isfinite(beams_of(holed))
    assert (~seen).sum() == 4 * 10 + 10
    np.testing.assert_array_equal(beams_of(holed)[seen], beams_of(whole)[seen])


@cache
def long_line() -> Dive:
    return exact_dive("straight", duration_s=2000.0, imu_rate_hz=1.0)


def dvl_error(errors: DvlErrors, seed: int = 5) -> tuple[Floats, Floats]:
    exact = long_line()
    return beams_of(add_errors(exact, ImuErrors(), errors, seed)) - beams_of(exact), beams_of(
        exact
    )


def test_dvl_noise_bias_and_scale_are_of_their_size() -> None:
    noise, _ = dvl_error(replace(SILENT_DVL, beam_sd_mps=0.004))
    assert noise.std() == pytest.approx(0.004, rel=0.04)  # 8000 draws: 0.8 % is one sigma
    assert np.corrcoef(noise.T)[0, 1] == pytest.approx(0.0, abs=0.1)
    biases = np.array(
        [
            dvl_error(replace(SILENT_DVL, beam_bias_sd_mps=0.001), seed)[0][[0, -1]]
            for seed in range(40)
        ]
    )
    np.testing.assert_allclose(biases[:, 0], biases[:, 1], atol=1e-15)
    assert biases[:, 0].std() == pytest.approx(0.001, rel=0.2)  # 160 draws: 5.6 %
    assert (np.ptp(biases[:, 0], axis=1) > 1e-6).all(), "every beam has its own"
    error, exact = dvl_error(replace(SILENT_DVL, beam_scale_sd=0.01))
    scales = error / exact
    np.testing.assert_allclose(scales, np.tile(scales[0], (len(scales), 1)), atol=1e-12)
    assert 0.001 < np.abs(scales[0]).max() < 0.04
    assert np.ptp(scales[0]) > 0.001, "every beam has its own"


def test_default_dvl_is_6_mm_per_second_in_each_horizontal_axis() -> None:
    sd_mps = DvlErrors().beam_sd_mps * np.sqrt(
        np.diag(np.linalg.inv(beam_vectors_d().T @ beam_vectors_d()))
    )
    assert sd_mps[0] == pytest.approx(0.006, abs=1e-4)
    assert sd_mps[1] == pytest.approx(0.006, abs=1e-4)


# --- The IMU's errors.


@pytest.fixture(scope="module")
def static_hour() -> Dive:
    return exact_dive("static", duration_s=3600.0, imu_rate_hz=50.0, reference_rate_hz=1.0)


@pytest.mark.parametrize("tau_s", [1, 10])
def test_white_noise_has_its_density_at_every_averaging_time(
    static_hour: Dive, tau_s: int
) -> None:
    """The Allan deviation of white noise is N / sqrt(tau)."""
    noisy = add_errors(static_hour, WHITE, SILENT_DVL, seed=2)
    noises = np.hstack([noisy.imu.specific_force_b, noisy.imu.angular_rate_b])
    np.testing.assert_allclose(
        np.corrcoef(noises.T), np.eye(6), atol=0.02
    )  # 180,000 draws: 0.0024 is one sigma
    for reading, exact, density in (
        (noisy.imu.specific_force_b, static_hour.imu.specific_force_b, WHITE.accel_white_mps_rts),
        (noisy.imu.angular_rate_b, static_hour.imu.angular_rate_b, WHITE.gyro_white_rad_rts),
    ):
        noise = (reading - exact)[:180_000]
        means = noise.reshape(-1, 50 * tau_s, 3).mean(axis=1)
        allan = np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2))
        assert allan == pytest.approx(
            density / np.sqrt(tau_s), rel=0.1
        )  # 1080 means: 2.6 % is one sigma
        assert noise.std() == pytest.approx(density * np.sqrt(50.0), rel=0.01)


def test_bias_starts_with_its_sd_and_walks_as_the_root_of_time() -> None:
    exact = exact_dive("static", duration_s=40.0, imu_rate_hz=10.0)
    errors = ImuErrors(
        accel_bias_sd_mps2=0.03,
        gyro_bias_sd_radps=2e-5,
        accel_bias_walk_mps2_rts=1e-3,
        gyro_bias_walk_radps_rts=1e-6,
    )
    truths = [add_errors(exact, errors, SILENT_DVL, seed).truth for seed in range(300)]
    accel = np.array([truth.accel_bias_b for truth in truths if truth])
    gyro = np.array([truth.gyro_bias_b for truth in truths if truth])
    # 900 draws each: 2.4 % is one sigma.
    assert accel[:, 0].std() == pytest.approx(0.03, rel=0.1)
    assert gyro[:, 0].std() == pytest.approx(2e-5, rel=0.1)
    for row, after_s in ((50, 10.0), (200, 40.0)):
        assert (accel[:, row] - accel[:, 0]).std() == pytest.approx(1e-3 * after_s**0.5, rel=0.1)
        assert (gyro[:, row] - gyro[:, 0]).std() == pytest.approx(1e-6 * after_s**0.5, rel=0.1)


def test_truth_is_the_bias_in_the_readings() -> None:
    errors = ImuErrors(
        accel_bias_sd_mps2=0.03, gyro_bias_sd_radps=2e-5, accel_bias_walk_mps2_rts=1e-3
    )
    exact = exact_dive("figure-eight", duration_s=150.0)
    dive = add_errors(exact, errors, SILENT_DVL, seed=4)
    assert dive.truth is not None
    at = np.searchsorted(dive.imu.time_ns, dive.truth.time_ns)
    force_error = dive.imu.specific_force_b - exact.imu.specific_force_b
    rate_error = dive.imu.angular_rate_b - exact.imu.angular_rate_b
    np.testing.assert_allclose(force_error[at], dive.truth.accel_bias_b, atol=1e-9)
    np.testing.assert_allclose(rate_error[at], dive.truth.gyro_bias_b, atol=1e-13)


def test_exact_dive_has_no_bias() -> None:
    truth = exact_dive("static", duration_s=1.0).truth
    assert truth is not None
    assert not truth.accel_bias_b.any()
    assert not truth.gyro_bias_b.any()


def test_grades_get_worse_and_their_quanta_hide_below_the_noise() -> None:
    fog, tactical, mems = (GRADES[name] for name in ("fog", "tactical", "mems"))
    assert fog.gyro_bias_sd_radps / DEG_PER_HOUR == pytest.approx(0.01)
    assert tactical.accel_bias_sd_mps2 / MG == pytest.approx(1.0)
    for better, worse in ((fog, tactical), (tactical, mems)):
        assert better.gyro_bias_sd_radps < worse.gyro_bias_sd_radps
        assert better.gyro_white_rad_rts < worse.gyro_white_rad_rts
        assert better.accel_bias_sd_mps2 < worse.accel_bias_sd_mps2
        assert better.accel_white_mps_rts < worse.accel_white_mps_rts
    for grade in GRADES.values():
        assert grade.accel_quantum_mps2 < 0.5 * grade.accel_white_mps_rts * 10.0
        assert grade.gyro_quantum_radps < 0.5 * grade.gyro_white_rad_rts * 10.0


@REPEATABLE
@given(value=st.floats(-20.0, 20.0), quantum=st.sampled_from([2.0**-20, 2.0**-13, 1e-4]))
def test_quantised_values_are_near_multiples(value: float, quantum: float) -> None:
    rounded = float(quantise(np.array([value]), quantum)[0])
    assert abs(rounded - value) <= 0.5 * quantum * (1.0 + 1e-9)
    assert rounded / quantum == pytest.approx(round(rounded / quantum), abs=1e-6)


# --- The same bytes again.


def all_bytes(dive: Dive) -> bytes:
    reference, truth, dvl = reference_of(dive), dive.truth, dive.dvl
    assert truth is not None
    arrays = [
        dive.imu.time_ns,
        dive.imu.specific_force_b,
        dive.imu.angular_rate_b,
        dvl.time_ns,
        beams_of(dive),
    ]
    arrays += [beam_vectors_d(), reference.position, reference.velocity_n, reference.mat_nb]
    return b"".join(
        np.ascontiguousarray(a).tobytes() for a in (*arrays, truth.accel_bias_b, truth.gyro_bias_b)
    )


def test_same_seed_same_bytes_other_seed_other_noise() -> None:
    first, again, other = (
        simulate_dive("figure-eight", seed=seed, duration_s=150.0) for seed in (7, 7, 8)
    )
    assert all_bytes(first) == all_bytes(again)
    assert (first.imu.specific_force_b != other.imu.specific_force_b).mean() > 0.5
    assert (beams_of(first) != beams_of(other)).mean() > 0.5
    np.testing.assert_array_equal(reference_of(first).position, reference_of(other).position)


def test_sensors_draw_from_streams_of_their_own() -> None:
    quiet, loud = (
        simulate_dive("straight", duration_s=20.0, dvl_errors=DvlErrors(beam_sd_mps=sd))
        for sd in (0.0, 1.0)
    )
    np.testing.assert_array_equal(quiet.imu.specific_force_b, loud.imu.specific_force_b)
    tactical = simulate_dive("straight", duration_s=20.0, grade="tactical")
    np.testing.assert_array_equal(
        beams_of(tactical), beams_of(simulate_dive("straight", duration_s=20.0))
    )


def test_last_bit_of_another_machines_sine_does_not_show() -> None:
    exact = exact_dive("figure-eight", duration_s=150.0)
    imu = replace(
        exact.imu,
        specific_force_b=np.nextafter(exact.imu.specific_force_b, np.inf),
        angular_rate_b=np.nextafter(exact.imu.angular_rate_b, np.inf),
    )
    beams: DvlColumns = replace(exact.dvl, beam_velocity_mps=np.nextafter(beams_of(exact), np.inf))
    there = add_errors(replace(exact, imu=imu, dvl=beams), GRADES["fog"], DvlErrors(), seed=1)
    assert all_bytes(there) == all_bytes(add_errors(exact, GRADES["fog"], DvlErrors(), seed=1))


# --- What cannot be simulated.


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"scenario": "figure-eigth"}, "'figure-eigth'.*; .*figure-eight"),
        ({"grade": "mens"}, "'mens'.*; .*mems"),
        ({"duration_s": -1.0}, "duration .*-1 s"),
        ({"duration_s": float("nan")}, "duration .*nan s"),
        ({"duration_s": 0.005}, "IMU.*longer duration"),
        ({"imu_rate_hz": 0.0}, "IMU rate .*0 Hz"),
        ({"dvl_rate_hz": -2.0}, "DVL rate .*-2 Hz"),
        ({"reference_rate_hz": float("inf")}, "reference rate .*inf Hz"),
        ({"outages": [(20.0, 10.0)]}, "20 s .*10 s"),
        ({"lost_beams": [LostBeam(4, 0.0, 1.0)]}, "beam 4 .*0 to 3"),
        (
            {"duration_s": 300.0, "lost_beams": [LostBeam(0, 400.0, 500.0)]},
            "400 s .*500 s .*300 s.*longer duration",
        ),
        ({"duration_s": 300.0, "outages": [(-20.0, 0.0)]}, "-20 s .*0 s .*longer duration"),
        ({"seed": -3}, "seed .*-3.*for example 3"),
        ({"lever_arm_m": (1.0, 2.0)}, r"lever arm .*\(1.0, 2.0\)"),
        ({"lever_arm_m": (float("nan"), 0.0, 0.0)}, "lever arm .*nan"),
        ({"mounting_rpy_deg": (0.0, float("inf"), 0.0)}, "mounting .*inf"),
    ],
)
def test_impossible_dives_are_refused(arguments: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        simulate_dive(**{"scenario": "static", "duration_s": 10.0, **arguments})  # type: ignore[arg-type]
    assert re.search(named, f"{caught.value.message}; {caught.value.hint}")


def test_errors_need_an_exact_dive_with_beams() -> None:
    exact = exact_dive("static", duration_s=1.0)
    with pytest.raises(ValueError, match="truth"):
        add_errors(replace(exact, truth=None), ImuErrors(), SILENT_DVL, seed=1)
    with pytest.raises(ValueError, match="beams"):
        add_errors(
            replace(exact, dvl=DvlColumns(exact.dvl.time_ns)), ImuErrors(), SILENT_DVL, seed=1
        )
