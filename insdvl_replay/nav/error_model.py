"""The error model: how errors of the mechanisation grow. These are the twelve states; `position_error` has three more.

F = [ -[(2 w_ie + w_en) x]   -[f_n x]     C   0 ]        D dv = w_en of the velocity dv
    [         -D            -[w_in x]     0   C ]
    [          0                0         0   0 ]
    [          0                0         0   0 ]

Equations (26) to (32) of Levy and Klein, with the rates of n where they print the gyro's output, and with D, which lets
velocity and misalignment swing with Schuler's period; see equations/error_model.md.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.local_earth import transport_rate_n
from insdvl_replay.nav.state_layout import TWELVE
from insdvl_replay.nav.strapdown import Motion
from insdvl_replay.nav.vector_algebra import Vector, add, cross, rotate, scale, scale_matrix, subtract

EACH_OF_TWELVE: Final = (0.0,) * TWELVE
"""A number for each of the twelve states."""


@inlined
def error_rate(
    motion: Motion, velocity_error: Vector, misalignment: Vector, accel_bias: Vector, gyro_bias: Vector
) -> tuple[Vector, Vector]:
    """Return how fast the errors of velocity and attitude grow, the first six rows of ``F dx``; biases stay."""
    coriolis = cross(velocity_error, add(motion.rate_ie_n, motion.rate_in_n))
    tilted = cross(misalignment, motion.force_n)
    velocity_error_rate = add(add(coriolis, tilted), rotate(motion.mat_nb, accel_bias))
    turned = subtract(cross(misalignment, motion.rate_in_n), transport_rate_n(motion.curvature, velocity_error))
    return velocity_error_rate, add(turned, rotate(motion.mat_nb, gyro_bias))


@inlined
def propagate_errors(dx: Floats, motion: Motion, dt: float) -> None:
    """Let errors of the twelve states grow over an interval: ``dx <- Phi dx`` with ``Phi = I + F dt``, in place.

    Parameters
    ----------
    dx : ndarray, shape (144,)
        Twelve errors, each a column of twelve states, row by row. Of an array of one dimension the compiler knows where
        each entry stands, and lets several columns grow at once.
    dt : float
        Length of the interval, s.
    """
    _grow_columns(dx, EACH_OF_TWELVE, over(motion, dt))


@inlined
def propagate_cov(P: Floats, motion: Motion, noise_density: tuple[float, ...], dt: float) -> None:
    """Advance the covariance: ``P <- Phi P Phi' + Q`` with ``Phi = I + F dt``, in place.

    In ``Phi P`` the columns of P have grown as errors do, and in ``(Phi P) Phi'`` its rows have grown so, too. States
    from the biases on do not grow: the second step changes no more than the upper left block, and symmetry gives the
    lower half of that. P stays symmetric to the last bit.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance of the n states, row by row, advanced.
    noise_density : tuple of n float
        Diagonal of the noise's spectral density; sensor noise is alike on all axes, so turning it with C changes
        nothing. The compiler knows its length, and with it that of every loop.
    dt : float
        Length of the interval, s.
    """
    n, step = len(noise_density), over(motion, dt)
    _grow_columns(P, noise_density, step)
    for row in range(0, 3 * n, n):
        velocity_error, misalignment = grown(step, entries(P, row, 1))
        P[row], P[row + 1], P[row + 2] = velocity_error
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for row in range(3 * n, 6 * n, n):
        _, misalignment = grown(step, entries(P, row, 1))
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for i in range(6):
        for j in range(i):
            P[n * i + j] = P[n * j + i]
        for j in range(6, n):
            P[n * j + i] = P[n * i + j]
    for i in range(n):
        P[(n + 1) * i] += noise_density[i] * dt


@inlined
def fade(P: Floats, row: int, kept: float) -> None:
    """Let a state that is a Gauss-Markov process forget its value but for a share, in its row and column of P."""
    for i in range(P.shape[0]):
        P[row, i] *= kept
        P[i, row] *= kept


@inlined
def over(motion: Motion, dt: float) -> Motion:
    """Return what a motion comes to in an interval; since F is linear in it, the F of that is ``F dt``."""
    return Motion(
        scale(dt, motion.rate_ie_n),
        scale(dt, motion.rate_in_n),
        scale(dt, motion.force_n),
        scale_matrix(dt, motion.mat_nb),
        scale(dt, motion.curvature),
    )


@inlined
def _grow_columns(dx: Floats, each_state: tuple[float, ...], step: Motion) -> None:
    n = len(each_state)  # a number for the compiler, which as an argument it would not be
    for column in range(n):
        velocity_error, misalignment = grown(step, entries(dx, column, n))
        dx[column], dx[n + column], dx[2 * n + column] = velocity_error
        dx[3 * n + column], dx[4 * n + column], dx[5 * n + column] = misalignment


@inlined
def entries(P: Floats, first: int, apart: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Read the twelve states of a column of P, whose entries stand n apart, or of a row, which stand side by side."""
    return (
        (P[first], P[first + apart], P[first + 2 * apart]),
        (P[first + 3 * apart], P[first + 4 * apart], P[first + 5 * apart]),
        (P[first + 6 * apart], P[first + 7 * apart], P[first + 8 * apart]),
        (P[first + 9 * apart], P[first + 10 * apart], P[first + 11 * apart]),
    )


@inlined
def grown(step: Motion, dx: tuple[Vector, Vector, Vector, Vector]) -> tuple[Vector, Vector]:
    """Return the errors of velocity and attitude after an interval, ``dx + F dt dx``."""
    velocity_error_growth, misalignment_growth = error_rate(step, dx[0], dx[1], dx[2], dx[3])
    return add(dx[0], velocity_error_growth), add(dx[1], misalignment_growth)


@inlined
def add_noise(P: Floats, n: int, noise_density: Floats, dt: float) -> None:
    """Add what white noise leaves behind in the twelve states after an interval, ``P <- P + Q``, in place.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance, row by row.
    noise_density : ndarray, shape (12,)
        Diagonal of the spectral density.
    dt : float
        Length of the interval, s.
    """
    for i in range(TWELVE):
        P[(n + 1) * i] += noise_density[i] * dt


def noise_density(
    accel_white_mps_rts: float,
    gyro_white_rad_rts: float,
    accel_bias_walk_mps2_rts: float,
    gyro_bias_walk_radps_rts: float,
) -> Floats:
    """Return the diagonal of the process noise's spectral density, diag(N_a^2, N_g^2, K_a^2, K_g^2).

    Parameters
    ----------
    accel_white_mps_rts, gyro_white_rad_rts : float
        White noise of the readings, m/s/sqrt(s) and rad/sqrt(s).
    accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts : float
        Random walk of the biases, m/s^2/sqrt(s) and rad/s/sqrt(s).

    Returns
    -------
    ndarray, shape (12,)
    """
    densities = [accel_white_mps_rts, gyro_white_rad_rts, accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts]
    return np.repeat(np.square(densities), 3)
