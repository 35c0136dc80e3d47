"""The mechanisation against the differential equations, integrated by scipy."""

from dataclasses import dataclass

import numpy as np
from instants import steady
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.geometry.earth import (
    EARTH_RATE,
    meridian_radius_m,
    normal_gravity,
    transverse_radius_m,
)
from insdvl_replay.nav.algebra import add, matrix, vector
from insdvl_replay.nav.earth_model import gravity_at, local_earth_at, local_earth_near
from insdvl_replay.nav.strapdown import NavState, propagate
from insdvl_replay.nav.timeline import build_timeline, first_node, is_last, next_node

START = np.array([0.57, 0.61, -20.0, 1.1, -0.4, 0.2])
NOTHING = (0.0, 0.0, 0.0)
FORCE_TOO_LARGE_BY, RATE_TOO_LARGE_BY = (0.02, -0.01, 0.03), (1e-3, -2e-3, 3e-3)


@dataclass
class Motion:
    """Smooth readings of a vehicle that turns, rolls and speeds up."""

    def force_b(self, t: float) -> Floats:
        return np.array([0.3 * np.sin(0.4 * t), 0.2 * np.cos(0.3 * t), -9.79 + 0.1 * np.sin(t)])

    def rate_b(self, t: float) -> Floats:
        return np.array([0.05 * np.sin(t), 0.03 * np.cos(0.7 * t), 0.3 * np.sin(0.2 * t)])


def derivative(t: float, state: Floats, motion: Motion) -> Floats:
    """The equations as a textbook prints them, in vector notation and with numpy's cross product."""
    (latitude, _, height), velocity, mat = state[:3], state[3:6], state[6:].reshape(3, 3)
    r_n, r_e = meridian_radius_m(latitude) + height, transverse_radius_m(latitude) + height
    w_ie = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    w_en = np.array([velocity[1] / r_e, -velocity[0] / r_n, -velocity[1] * np.tan(latitude) / r_e])
    gravity = np.array([0.0, 0.0, normal_gravity(latitude, height)])
    velocity_dot = mat @ motion.force_b(t) + gravity - np.cross(2 * w_ie + w_en, velocity)
    mat_dot = (
        np.cross(motion.rate_b(t), mat, axisa=0, axisb=1, axisc=1) * -1.0
        - np.cross(w_ie + w_en, mat.T).T
    )
    position_dot = [velocity[0] / r_n, velocity[1] / (r_e * np.cos(latitude)), -velocity[2]]
    return np.concatenate([position_dot, velocity_dot, mat_dot.ravel()])


def mechanised(
    motion: Motion, mat: Floats, rate_hz: float, duration_s: float
) -> tuple[Floats, Floats, Floats]:
    time_s = np.arange(int(duration_s * rate_hz) + 1) / rate_hz
    force_b, rate_b = np.array([(motion.force_b(t), motion.rate_b(t)) for t in time_s]).swapaxes(
        0, 1
    )
    imu = ImuColumns(np.rint(time_s * 1e9).astype(np.int64), force_b, rate_b)
    nothing = np.empty(0, np.int64)
    timeline = build_timeline(imu, nothing, nothing, 0, int(imu.time_ns[-1]))
    state = NavState(vector(START[:3]), vector(START[3:]), matrix(mat), NOTHING, NOTHING)
    place, now = local_earth_at(state.position[0], state.position[2]), first_node(timeline)
    while not is_last(timeline, now):
        before, now = now, next_node(timeline, now)
        place = local_earth_near(state.position, place)
        gravity = gravity_at(place, state.position[2])
        state, _ = propagate(
            state, before.readings, now.readings, now.time_s - before.time_s, place, gravity
        )
    return np.array(state.position), np.array(state.velocity_n), np.array(state.mat_nb)


def test_mechanisation_follows_the_differential_equations() -> None:
    """What is left at 50 Hz is the Earth's, which is computed anew every 0.6 m."""
    motion, mat = Motion(), Rotation.from_euler("ZYX", [1.0, 0.1, -0.2]).as_matrix()
    start = np.concatenate([START, mat.ravel()])
    truth = solve_ivp(
        derivative, (0.0, 40.0), start, args=(motion,), rtol=1e-12, atol=1e-13, max_step=0.05
    ).y[:, -1]
    position, velocity, attitude = mechanised(motion, mat, 50.0, 40.0)
    np.testing.assert_allclose(position[:2], truth[:2], rtol=0.0, atol=1e-3 / 6.4e6)  # 1 mm
    np.testing.assert_allclose(position[2], truth[2], rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(attitude, truth[6:].reshape(3, 3), rtol=0.0, atol=2e-7)
    assert np.linalg.norm(velocity - truth[3:6]) < 5e-5
    _, _, coarse = mechanised(motion, mat, 10.0, 40.0)
    np.testing.assert_allclose(coarse, truth[6:].reshape(3, 3), rtol=0.0, atol=1e-6)


def test_attitude_stays_a_rotation() -> None:
    _, _, mat = mechanised(Motion(), np.eye(3), 50.0, 60.0)
    np.testing.assert_allclose(mat @ mat.T, np.eye(3), rtol=0.0, atol=1e-12)


def test_a_resting_imu_with_known_biases_stays_at_rest() -> None:
    latitude = 0.57
    gravity = normal_gravity(latitude, 0.0)
    state = NavState(
        (latitude, 0.0, 0.0), NOTHING, matrix(np.eye(3)), FORCE_TOO_LARGE_BY, RATE_TOO_LARGE_BY
    )
    rate = EARTH_RATE * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
    place = local_earth_at(latitude, 0.0)
    for _ in range(10_000):
        force_read, rate_read = (
            add((0.0, 0.0, -gravity), state.accel_bias_b),
            add(vector(rate), state.gyro_bias_b),
        )
        readings = steady(force_read, rate_read)
        state, _ = propagate(state, readings, readings, 0.01, place, gravity_at(place, 0.0))
    np.testing.assert_allclose(state.velocity_n, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.mat_nb, np.eye(3), atol=1e-10)
    assert (state.accel_bias_b, state.gyro_bias_b) == (FORCE_TOO_LARGE_BY, RATE_TOO_LARGE_BY)
