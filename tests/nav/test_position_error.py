"""How errors of the position grow, against finite differences of the mechanisation on the rotating Earth."""

import numpy as np
import pytest
from instants import steady
from jacobian import assert_jacobian
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.earth import meridian_radius_m, normal_gravity
from insdvl_replay.nav.algebra import matrix, vector
from insdvl_replay.nav.earth_model import gravity_at, local_earth_at
from insdvl_replay.nav.error_model import (
    offset_n,
    position_growth,
    propagate_position_cov,
    without_error,
)
from insdvl_replay.nav.strapdown import Motion, NavState, propagate

POSITION = (0.9, 0.6, -300.0)
VELOCITY_N = np.array([12.0, -7.0, 3.0])  # fast, so that what goes with the velocity shows
MAT_NB = Rotation.from_euler("ZYX", [0.8, 0.1, -0.3]).as_matrix()
FORCE_B, RATE_B = (0.4, -0.3, -9.7), (0.02, -0.1, 0.3)
STILL = (0.0, 0.0, 0.0)
STEP_S = 1e-3


def moved_on(dp_n: Floats) -> tuple[NavState, Motion]:
    """One step of the mechanisation from a position that is off by ``dp_n``, m."""
    here = local_earth_at(POSITION[0], POSITION[2])
    position = without_error(POSITION, vector(-dp_n), here)
    place = local_earth_at(position[0], position[2])
    state = NavState(position, vector(VELOCITY_N), matrix(MAT_NB), STILL, STILL)
    readings = steady(FORCE_B, RATE_B)
    return propagate(state, readings, readings, STEP_S, place, gravity_at(place, position[2]))


def error_after(dp_n: Floats) -> Floats:
    """How far position, velocity and attitude are off after the step, relative to that from the right position."""
    (true, _), (state, _) = moved_on(np.zeros(3)), moved_on(dp_n)
    turn = Rotation.from_matrix(np.array(state.mat_nb) @ np.array(true.mat_nb).T).as_rotvec()
    apart_n = offset_n(
        state.position, true.position, local_earth_at(true.position[0], true.position[2])
    )
    return np.concatenate([apart_n, np.subtract(state.velocity_n, true.velocity_n), turn])


def gravity_by_north() -> float:
    """How normal gravity grows towards the pole, 1/s^2."""
    step = 1e-3
    more, less = (normal_gravity(POSITION[0] + sign * step, POSITION[2]) for sign in (1.0, -1.0))
    return float(more - less) / (2.0 * step * (meridian_radius_m(POSITION[0]) + POSITION[2]))


def test_growth_is_the_jacobian_of_the_mechanisation() -> None:
    state, motion = moved_on(np.zeros(3))
    growth = position_growth(state, motion, local_earth_at(POSITION[0], POSITION[2]), STEP_S)
    step_m = 1e4  # rates of 1e-12 an s and a metre need long ways to show

    def rates(dp_n: Floats) -> Floats:
        after = error_after(dp_n)
        return np.concatenate([after[:3] - dp_n, after[3:]]) / STEP_S

    analytic = np.vstack([growth.within, growth.to_velocity, growth.to_misalignment]) / STEP_S
    analytic[5, 0] += gravity_by_north()  # left out: 8e-9 / s^2, a 400th of what height does
    scale = np.array([*[1e-6] * 3, 1e-10, 1e-10, 1e-8, *[1e-13] * 3])[:, None]  # of T, of A, of B
    assert_jacobian(
        analytic / scale,
        lambda dp_n: rates(dp_n) / scale[:, 0],
        np.zeros(3),
        atol=0.05,
        step=step_m,
    )
    assert np.abs(analytic / scale).max(axis=1)[[0, 1, 3, 4, 5, 6, 8]].min() > 0.5


def test_vertical_channel_runs_away_as_gravity_falls() -> None:
    """2 g / R drives the height away, e-fold in 570 s."""
    state, motion = moved_on(np.zeros(3))
    growth = position_growth(state, motion, local_earth_at(POSITION[0], POSITION[2]), 1.0)
    assert 1.0 / np.sqrt(growth.to_velocity[2][2]) == pytest.approx(570.0, rel=0.01)


def test_an_error_taken_off_is_gone() -> None:
    place = local_earth_at(POSITION[0], POSITION[2])
    error_n = (30.0, -20.0, 4.0)
    off = without_error(POSITION, vector(-np.array(error_n)), place)
    np.testing.assert_allclose(offset_n(off, POSITION, place), error_n, rtol=1e-6)
    np.testing.assert_allclose(without_error(off, error_n, place), POSITION, rtol=0.0, atol=1e-11)


def test_covariance_is_propagated_as_the_matrices_say() -> None:
    n, first, dt = 17, 12, 0.5
    root = np.random.default_rng(3).normal(size=(n, n))
    P = root @ root.T
    state, motion = moved_on(np.zeros(3))
    growth = position_growth(state, motion, local_earth_at(POSITION[0], POSITION[2]), dt)
    Phi = np.eye(n)
    Phi[first : first + 3, :3] += dt * np.eye(3)
    Phi[first : first + 3, first : first + 3] += growth.within
    Phi[:3, first : first + 3] += growth.to_velocity
    Phi[3:6, first : first + 3] += growth.to_misalignment
    expected = Phi @ P @ Phi.T
    propagate_position_cov(P.ravel(), (0.0,) * n, first, growth)
    np.testing.assert_allclose(P, expected, rtol=1e-11)
    np.testing.assert_array_equal(P, P.T)
