"""F against finite differences of the nonlinear equations; the covariance against plain matrices."""

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.earth import (
    EARTH_RATE,
    meridian_radius_m,
    normal_gravity,
    transverse_radius_m,
)
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.algebra import matrix, vector
from insdvl_replay.nav.error_model import (
    error_rate,
    noise_density,
    over,
    propagate_cov,
    propagate_errors,
)
from insdvl_replay.nav.strapdown import Motion

LATITUDE, HEIGHT_M = 0.57, -20.0
VELOCITY_N = np.array([1.2, -0.7, 0.3])
FORCE_B, RATE_B = np.array([0.4, -0.3, -9.7]), np.array([0.02, -0.1, 0.3])
MAT_NB = Rotation.from_euler("ZYX", [0.8, 0.1, -0.3]).as_matrix()
W_IE = EARTH_RATE * np.array([np.cos(LATITUDE), 0.0, -np.sin(LATITUDE)])


def transport_rate(velocity_n: Floats) -> Floats:
    r_n, r_e = meridian_radius_m(LATITUDE) + HEIGHT_M, transverse_radius_m(LATITUDE) + HEIGHT_M
    return np.array(
        [velocity_n[1] / r_e, -velocity_n[0] / r_n, -velocity_n[1] * np.tan(LATITUDE) / r_e]
    )


def motion() -> Motion:
    rate_in_n = W_IE + transport_rate(VELOCITY_N)
    r_n, r_e = meridian_radius_m(LATITUDE) + HEIGHT_M, transverse_radius_m(LATITUDE) + HEIGHT_M
    curvature = (1.0 / r_e, 1.0 / r_n, np.tan(LATITUDE) / r_e)
    return Motion(
        vector(W_IE), vector(rate_in_n), vector(MAT_NB @ FORCE_B), matrix(MAT_NB), curvature
    )


def system_matrix() -> Floats:
    """Its columns are the rates of the single errors."""
    rates = [error_rate(motion(), *map(vector, dx.reshape(4, 3))) for dx in np.eye(12)]
    return np.vstack([np.reshape(rates, (12, 6)).T, np.zeros((6, 12))])


def nonlinear_error_rate(dx: Floats) -> Floats:
    """How an error grows: the equations at the estimate minus the equations at the truth, with the position known."""
    velocity, mat = VELOCITY_N + dx[:3], Rotation.from_rotvec(dx[3:6]).as_matrix() @ MAT_NB
    w_en = transport_rate(velocity)
    gravity = np.array([0.0, 0.0, normal_gravity(LATITUDE, HEIGHT_M)])
    velocity_dot = mat @ (FORCE_B + dx[6:9]) + gravity - np.cross(2 * W_IE + w_en, velocity)
    rate_true = MAT_NB @ RATE_B - W_IE - transport_rate(VELOCITY_N)
    rate = mat @ (RATE_B + dx[9:12]) - W_IE - w_en
    # C_hat = exp([phi x]) C: its rate is the difference of the rates of n against b, seen from the turned frame.
    phi_dot = rate - Rotation.from_rotvec(dx[3:6]).as_matrix() @ rate_true
    return np.concatenate([velocity_dot, phi_dot, np.zeros(6)])


def test_system_matrix_is_the_jacobian_of_the_equations() -> None:
    # What F leaves out is the Coriolis acceleration by the error of the transport rate: v / R = 2e-7.
    assert_jacobian(system_matrix(), nonlinear_error_rate, np.zeros(12), atol=3e-7, step=1e-5)


def test_misalignment_grows_with_the_velocity_error_by_the_curvature_of_the_earth() -> None:
    """1/R = 1.6e-7 is all there is to Schuler's period of 84 min, and far above what differences leave."""

    def misalignment_rate(dv: Floats) -> Floats:
        return nonlinear_error_rate(np.concatenate([dv, np.zeros(9)]))[3:6]

    assert_jacobian(system_matrix()[3:6, :3], misalignment_rate, np.zeros(3), atol=1e-13, step=1.0)


def test_errors_swing_with_schulers_period() -> None:
    """At rest and level, without the Earth's rotation: ``dv'' = -(g/R) dv``, 84.4 min."""
    gravity, radius_m = normal_gravity(LATITUDE, HEIGHT_M), meridian_radius_m(LATITUDE) + HEIGHT_M
    still = (0.0, 0.0, 0.0)
    level = Motion(
        still, still, (0.0, 0.0, -gravity), matrix(np.eye(3)), (0.0, 1.0 / radius_m, 0.0)
    )
    rates = [error_rate(level, *map(vector, dx.reshape(4, 3))) for dx in np.eye(12)[[0, 4]]]
    F = np.array([[rate[0][0], rate[1][1]] for rate in rates]).T
    period_s = 2.0 * np.pi / np.abs(np.linalg.eigvals(F).imag).max()
    assert period_s == pytest.approx(2.0 * np.pi * np.sqrt(radius_m / gravity), rel=1e-12)
    assert period_s / 60.0 == pytest.approx(84.4, abs=0.3)


def test_the_gyro_output_in_place_of_earth_rate_would_be_found() -> None:
    printed = system_matrix()
    printed[3:6, 3:6] = skew(MAT_NB @ RATE_B)
    with pytest.raises(AssertionError):
        assert_jacobian(printed, nonlinear_error_rate, np.zeros(12), atol=3e-7, step=1e-5)


def test_errors_grow_as_the_matrices_say() -> None:
    dx, dt = np.random.default_rng(4).normal(size=(12, 12)), 0.01
    expected = (np.eye(12) + system_matrix() * dt) @ dx
    propagate_errors(dx.ravel(), (0.0,) * 12, over(motion(), dt))
    np.testing.assert_allclose(dx, expected, rtol=1e-13)


def test_covariance_is_propagated_as_the_matrices_say() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(12, 12))
    P, F, dt = root @ root.T, system_matrix(), 0.01
    density = noise_density(0.2, 3.7e-5, 1e-6, 1e-10)
    Phi = np.eye(12) + F * dt
    expected = Phi @ P @ Phi.T + np.diag(density) * dt
    propagate_cov(P.ravel(), motion(), tuple(density), dt)
    np.testing.assert_allclose(P, expected, rtol=1e-13)
    np.testing.assert_array_equal(P, P.T)


def test_noise_density_is_the_square_of_each_sensors_noise() -> None:
    np.testing.assert_allclose(
        noise_density(2.0, 3.0, 4.0, 5.0), np.repeat([4.0, 9.0, 16.0, 25.0], 3)
    )
