"""Each H against finite differences, the velocity's R, and the slope that the INS predicts over a window."""

from dataclasses import dataclass

import numpy as np
import pytest
from instants import steady
from jacobian import assert_jacobian
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.frames import beam_vectors, solve_beams
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.algebra import matrix, rotate_back, vector
from insdvl_replay.nav.dvl import (
    DvlVelocities,
    acceleration_measurement,
    slope_windows,
    velocity_cov,
    velocity_measurement,
)
from insdvl_replay.nav.earth_model import local_earth_at
from insdvl_replay.nav.error_model import layout_of
from insdvl_replay.nav.measurements import (
    PUBLISHED,
    VELOCITY,
    WINDOWED,
    InsNow,
    Measurement,
    Memory,
    linearise,
    stacked,
)
from insdvl_replay.nav.strapdown import NavState, propagate

VELOCITY_N = np.array([0.9, -0.4, 0.1])
MAT_NB = Rotation.from_euler("ZYX", [2.0, -0.1, 0.15]).as_matrix()
FORCE_B, RATE_NB_B = np.array([0.2, -0.1, -9.75]), np.array([0.01, -0.02, 0.3])
ARM_B = np.array([-1.8, -0.3, 0.2])
GRAVITY = 9.795
POSITION = (0.57, 0.6, -20.0)


def measurement(kind: int, window: int = 1) -> Measurement:
    return Measurement(
        "",
        "",
        kind,
        np.arange(window),
        np.zeros((window, 3)),
        np.tile(np.eye(3), (window, 1, 1)),
        np.ones(window, dtype=bool),
        velocity_weights=np.zeros((window, window)),
        interval_weights=np.zeros((window, window - 1)),
    )


def at_ping(dx: Floats) -> InsNow:
    """An INS whose errors are dx: estimated minus true."""
    return InsNow(
        POSITION,
        vector(VELOCITY_N + dx[:3]),
        matrix(Rotation.from_rotvec(dx[3:6]).as_matrix() @ MAT_NB),
        vector(FORCE_B + dx[6:9]),
        Memory((RATE_NB_B + dx[9:12])[None], (RATE_NB_B + dx[9:12])[None], np.zeros((1, 3))),
        GRAVITY,
        vector(ARM_B),
        local_earth_at(*POSITION[::2]),
        vector(RATE_NB_B + dx[9:12]),
        np.empty(0),
    )


def linearised(kind: int, dx: Floats) -> tuple[Floats, Floats]:
    z, H = np.empty(3), np.full((3, 12), np.nan)
    linearise(stacked([measurement(kind)]), 0, 0, at_ping(dx), layout_of(()), None, z, H)
    return z, H


@pytest.mark.parametrize("kind", [VELOCITY, PUBLISHED])
def test_jacobian_of_velocity_and_of_the_published_acceleration(kind: int) -> None:
    _, H = linearised(kind, np.zeros(12))
    assert_jacobian(H, lambda dx: linearised(kind, dx)[0], np.zeros(12), atol=1e-7, step=1e-4)


def body_acceleration(dx: Floats) -> Floats:
    """The rate of the body velocity, f + C' g - w x C' v, whose errors the windowed slope has."""
    ins = at_ping(dx)
    mat_bn, gravity_n = np.array(ins.mat_nb).T, np.array([0.0, 0.0, GRAVITY])
    turning = np.cross(ins.memory.rate_nb_b[0], mat_bn @ np.array(ins.velocity_n))
    return np.array(ins.specific_force_b) + mat_bn @ gravity_n - turning


def test_jacobian_of_the_windowed_acceleration() -> None:
    _, H = linearised(WINDOWED, np.zeros(12))
    assert_jacobian(H, body_acceleration, np.zeros(12), atol=1e-6, step=1e-4)


def test_the_signs_that_the_paper_prints_are_found_out() -> None:
    _, H = linearised(PUBLISHED, np.zeros(12))
    H[:, 3:6] *= -1.0
    with pytest.raises(AssertionError):
        assert_jacobian(
            H, lambda dx: linearised(PUBLISHED, dx)[0], np.zeros(12), atol=1e-7, step=1e-4
        )


@dataclass
class Ins:
    """A strapdown INS with errors, to carry body velocities over a window."""

    dx: Floats

    def body_velocities(self, times_s: Floats, rate_hz: float = 2000.0) -> Floats:
        mat_nb = matrix(Rotation.from_rotvec(self.dx[3:6]).as_matrix() @ MAT_NB)
        too_much = vector(-self.dx[6:9]), vector(-self.dx[9:12])
        state = NavState(POSITION, vector(VELOCITY_N + self.dx[:3]), mat_nb, *too_much)
        place = local_earth_at(state.position[0], state.position[2])
        found, readings = (
            [rotate_back(state.mat_nb, state.velocity_n)],
            steady(vector(FORCE_B), vector(RATE_NB_B)),
        )
        for length_s in np.diff(times_s):
            for _ in range(round(length_s * rate_hz)):
                state, _ = propagate(state, readings, readings, 1 / rate_hz, place, GRAVITY)
            found.append(rotate_back(state.mat_nb, state.velocity_n))
        return np.array(found)


def test_windowed_prediction_is_the_slope_of_what_the_ins_adds_and_its_jacobian_holds_over_a_window() -> (
    None
):
    times_s = np.array([0.0, 0.01, 0.025, 0.03])
    velocities = DvlVelocities(
        np.round(times_s * 1e9).astype(np.int64), np.zeros((4, 3)), np.tile(np.eye(3), (4, 1, 1)), np.eye(3),
        np.zeros(4, dtype=np.int64), np.full(4, np.nan), 0, 0,
    )  # fmt: skip
    windowed = acceleration_measurement(
        velocities, velocity_cov(velocities, 0.02), slope_windows(times_s, 4, 1, 1.0),
        kind=WINDOWED, sd_mps2=None, accel_white_mps_rts=0.2,
    )  # fmt: skip

    def slope(dx: Floats) -> Floats:
        body = Ins(dx).body_velocities(times_s)
        change = np.vstack([np.zeros(3), np.diff(body, axis=0)])
        rates_b = np.tile(RATE_NB_B, (4, 1))
        ins = at_ping(dx)._replace(memory=Memory(rates_b, rates_b, change))
        z, H = np.empty(3), np.full((3, 12), np.nan)
        linearise(stacked([windowed]), 0, 3, ins, layout_of(()), None, z, H)
        # A straight line through the body velocities themselves has the same slope.
        np.testing.assert_allclose(z, np.polyfit(times_s, body, 1)[0], atol=1e-9)
        slope.H = H  # type: ignore[attr-defined]
        return z

    slope(np.zeros(12))
    H = slope.H  # type: ignore[attr-defined]
    # The errors stand at the window's start here and grow to its middle: a gyro bias turns into misalignment meanwhile.
    H[:, 9:12] += MAT_NB.T @ skew(np.array([0.0, 0.0, GRAVITY])) @ MAT_NB * times_s[-1] / 2.0
    # Over 0.03 s at 17 deg/s the attitude turns by 0.5 deg; H stands at the window's end and is off by that much of g.
    assert_jacobian(H, slope, np.zeros(12), atol=0.3 * times_s[-1] * GRAVITY, step=1e-5)


def test_velocity_noise_is_isotropic_with_all_beams_and_worse_with_three() -> None:
    vectors = beam_vectors()
    beams = np.zeros((2, 4))
    beams[1, 2] = np.nan
    velocity, shape, residual = solve_beams(beams, vectors)
    velocities = DvlVelocities(
        np.arange(2), velocity, shape, shape[0], np.array([4, 3]), residual, 0, 0
    )
    full, three = velocity_cov(velocities, 0.02)
    np.testing.assert_allclose(full, 0.02**2 * np.eye(3), atol=1e-12)
    assert (np.linalg.eigvalsh(three) >= 0.02**2 * (1 - 1e-9)).all()
    np.testing.assert_allclose(velocity_cov(velocities, 0.01, for_one_beam=True), 0.01**2 * shape)


def test_acceleration_noise_comes_from_the_dvl_and_the_accelerometer() -> None:
    m, s, white = 6, 0.01, 0.002
    velocities = DvlVelocities(
        np.arange(m) * 1_000_000_000, np.zeros((m, 3)), np.tile(np.eye(3), (m, 1, 1)), np.eye(3),
        np.zeros(m, dtype=np.int64), np.full(m, np.nan), 0, 0,
    )  # fmt: skip
    made = acceleration_measurement(
        velocities, velocity_cov(velocities, s), slope_windows(np.arange(float(m)), 3, 1, 2.5),
        kind=WINDOWED, sd_mps2=None, accel_white_mps_rts=white,
    )  # fmt: skip
    # n = 3 at 1 Hz: c = (-1/2, 0, 1/2), W = (1/2, 1/2).
    np.testing.assert_allclose(made.cov[4], (s**2 / 2 + white**2 / 2) * np.eye(3))
    assert made.available.tolist() == [False, False, True, True, True, True]
    assert velocity_measurement(velocities, made.cov).available.all()
