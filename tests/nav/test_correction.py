"""What a correction does to the covariance, against finite differences of the error that it has to leave alone."""

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.algebra import matrix, vector
from insdvl_replay.nav.earth_model import local_earth_at
from insdvl_replay.nav.error_model import layout_of
from insdvl_replay.nav.kalman import correct, keep_invariant_error
from insdvl_replay.nav.measurements import (
    VELOCITY,
    InsNow,
    Measurement,
    Memory,
    linearise,
    stacked,
)
from insdvl_replay.nav.strapdown import NavState

VELOCITY_N = np.array([1.2, -0.7, 0.3])
CHANGE_N = np.array([0.2, 0.3, -0.1])  # taken off the velocity
NOTHING = (0.0, 0.0, 0.0)
TWELVE_STATES = layout_of(())


def turned(phi: Floats) -> Floats:
    return Rotation.from_rotvec(phi).as_matrix()


def invariant_error(velocity_n: Floats, dx: Floats) -> Floats:
    """Give ``v_hat - C_hat C' v``: the velocity error that is left when the true dive is turned by the misalignment."""
    return velocity_n - turned(dx[PHI]) @ (velocity_n - dx[DV])


def expressed_about_the_corrected_velocity(dx: Floats) -> Floats:
    """Give the error about the corrected velocity that has the same invariant error as ``dx`` before."""
    after = VELOCITY_N - CHANGE_N
    true = turned(dx[PHI]).T @ (after - invariant_error(VELOCITY_N, dx))
    return np.concatenate([after - true, dx[3:]])


def transformation() -> Floats:
    T = np.eye(12)
    T[DV, PHI] = skew(CHANGE_N)
    return T


def random_cov(seed: int, n: int = 12) -> Floats:
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T


def test_transformation_leaves_the_invariant_error_alone() -> None:
    assert_jacobian(
        transformation(),
        expressed_about_the_corrected_velocity,
        np.zeros(12),
        atol=1e-9,
        step=1e-5,
    )


def test_covariance_is_transformed_as_the_matrices_say() -> None:
    P, T = random_cov(3), transformation()
    expected = T @ P @ T.T
    keep_invariant_error(P, vector(CHANGE_N))
    np.testing.assert_allclose(P, expected, rtol=1e-13)
    np.testing.assert_array_equal(P, P.T)


@pytest.mark.parametrize("degrees", [0.5, 20.0, 90.0])
def test_an_error_that_is_estimated_as_it_is_vanishes_whatever_its_size(degrees: float) -> None:
    """What H is exact for is ``v_hat - C_hat C' v``: told it and the misalignment, the state is the true one."""
    phi = np.deg2rad(degrees) * np.array([0.48, 0.6, 0.64])
    true_n, true_nb = np.array([1.9, -0.4, 0.2]), turned(np.array([0.3, -0.1, 2.0]))
    xi = np.array([4.0, -3.0, 0.5])
    off_n = turned(phi) @ true_n + xi
    dx = np.concatenate([xi - np.cross(off_n, phi), phi, np.zeros(6)])
    state = NavState(
        (0.57, 0.6, -20.0), vector(off_n), matrix(turned(phi) @ true_nb), NOTHING, NOTHING
    )
    corrected = correct(
        state, np.empty(0), random_cov(6), dx, TWELVE_STATES, local_earth_at(*state.position[::2])
    )
    np.testing.assert_allclose(corrected.velocity_n, true_n, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(corrected.mat_nb, true_nb, rtol=0.0, atol=1e-15)


def test_estimated_errors_are_taken_out_of_the_state() -> None:
    mat_nb = turned(np.array([0.3, -0.1, 2.0]))
    bias_b, P = (0.01, -0.02, 0.03), random_cov(4)
    state = NavState((0.57, 0.6, -20.0), vector(VELOCITY_N), matrix(mat_nb), bias_b, bias_b)
    dx = 0.03 * np.random.default_rng(5).normal(size=12)
    expected_cov = P.copy()
    expected_n = turned(dx[PHI]).T @ (VELOCITY_N - dx[DV] - np.cross(VELOCITY_N, dx[PHI]))
    corrected = correct(
        state, np.empty(0), P, dx, TWELVE_STATES, local_earth_at(*state.position[::2])
    )
    keep_invariant_error(expected_cov, vector(VELOCITY_N - corrected.velocity_n))
    np.testing.assert_array_equal(P, expected_cov)
    assert corrected.position == state.position
    np.testing.assert_allclose(corrected.velocity_n, expected_n, rtol=1e-13)
    np.testing.assert_allclose(corrected.mat_nb, turned(-dx[PHI]) @ mat_nb, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(corrected.accel_bias_b, bias_b + dx[BA], rtol=1e-14)
    np.testing.assert_allclose(corrected.gyro_bias_b, bias_b + dx[BG], rtol=1e-14)


def test_a_corrected_velocity_leaves_what_the_dvl_has_measured_of_scale_and_yaw() -> None:
    """H holds against finite differences elsewhere; H P H' about the corrected velocity is what it was before."""
    layout = layout_of(("dvl_scale", "dvl_yaw"))
    constants = np.array([0.03, 0.2])
    mat_nb = matrix(turned(np.array([0.3, -0.2, 2.0])))
    earth = local_earth_at(0.57, -20.0)
    reading = Measurement(
        "", "", VELOCITY, np.arange(1), np.zeros((1, 3)), np.eye(3)[None], np.ones(1, np.bool_)
    )

    def measured(velocity_n: Floats, P: Floats) -> Floats:
        nothing = np.zeros((1, 3))
        memory = Memory(nothing, nothing, nothing)
        ins = InsNow(
            (0.57, 0.6, -20.0),
            vector(velocity_n),
            mat_nb,
            NOTHING,
            memory,
            9.8,
            NOTHING,
            earth,
            NOTHING,
            constants,
        )
        z, H = np.empty(3), np.empty((3, 14))
        linearise(stacked([reading]), 0, 0, ins, layout, None, z, H)
        return H @ P @ H.T

    P = random_cov(7, 14)
    before = measured(VELOCITY_N, P)
    state = NavState((0.57, 0.6, -20.0), vector(VELOCITY_N), mat_nb, NOTHING, NOTHING)
    dx = np.concatenate([CHANGE_N, np.zeros(11)])
    corrected = correct(state, constants, P, dx, layout, earth)
    np.testing.assert_allclose(corrected.velocity_n, VELOCITY_N - CHANGE_N, rtol=1e-14)
    np.testing.assert_allclose(measured(np.array(corrected.velocity_n), P), before, rtol=1e-12)
