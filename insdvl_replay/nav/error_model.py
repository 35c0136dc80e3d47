"""The 12-state error model: how errors of the mechanisation grow.

F = [ -[(2 w_ie + w_en) x]   -[f_n x]     C   0 ]
    [          0            -[w_in x]     0   C ]
    [          0                0         0   0 ]
    [          0                0         0   0 ]

Equations (26) to (32) of Levy and Klein, with the rates of n where they print the gyro's output; see EQUATIONS.md.
"""

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.strapdown import Motion
from insdvl_replay.nav.vector_algebra import Vector, add, cross, rotate, scale, vector, write_vector


@compiled
def write_skew(matrix: Floats, row: int, column: int, sign: float, vector: Floats) -> None:
    """Write ``sign [vector x]`` into the 3 x 3 block of a matrix that starts at a row and a column."""
    x, y, z = sign * vector[0], sign * vector[1], sign * vector[2]
    matrix[row, column], matrix[row, column + 1], matrix[row, column + 2] = 0.0, -z, y
    matrix[row + 1, column], matrix[row + 1, column + 1], matrix[row + 1, column + 2] = z, 0.0, -x
    matrix[row + 2, column], matrix[row + 2, column + 1], matrix[row + 2, column + 2] = -y, x, 0.0


@compiled
def error_rate(
    motion: Motion, velocity_error: Vector, misalignment: Vector, accel_bias: Vector, gyro_bias: Vector
) -> tuple[Vector, Vector]:
    """Give the rates at which the errors of velocity and attitude grow, the first six rows of ``F dx``; biases stay.

    Parameters
    ----------
    motion : Motion
    velocity_error, misalignment : tuple of 3 float
        In n, m/s and rad.
    accel_bias, gyro_bias : tuple of 3 float
        In b, m/s^2 and rad/s.

    Returns
    -------
    tuple of 3 float, m/s^2
        Of the velocity error.
    tuple of 3 float, rad/s
        Of the misalignment.
    """
    coriolis = cross(velocity_error, add(motion.rate_ie_n, motion.rate_in_n))
    tilted = cross(misalignment, motion.force_n)
    velocity_error_rate = add(add(coriolis, tilted), rotate(motion.mat_nb, accel_bias))
    misalignment_rate = add(cross(misalignment, motion.rate_in_n), rotate(motion.mat_nb, gyro_bias))
    return velocity_error_rate, misalignment_rate


@compiled
def write_system_matrix(motion: Motion, F: Floats) -> None:
    """Write the system matrix F of the error state, whose columns are the rates of the single errors.

    Parameters
    ----------
    motion : Motion
    F : ndarray, shape (12, 12)
        Its first six rows are written; the others stay zero.
    """
    dx = np.zeros(12)
    for column in range(12):
        dx[column] = 1.0
        rates = error_rate(motion, vector(dx[0:3]), vector(dx[3:6]), vector(dx[6:9]), vector(dx[9:12]))
        write_vector(rates[0], F[0:3, column])
        write_vector(rates[1], F[3:6, column])
        dx[column] = 0.0


@compiled
def propagate_cov(P: Floats, motion: Motion, noise_density: Floats, dt: float) -> None:
    """Advance the covariance: ``P <- Phi P Phi' + Q`` with ``Phi = I + F dt``, in place.

    Since P is symmetric, Phi P Phi' = Phi (Phi P)', and both products let the columns of a matrix grow as errors do.
    Biases do not grow, so that the first product changes the upper six rows, and the second, of what is turned over,
    no more than the upper left block. P stays symmetric to the last bit.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance, advanced.
    motion : Motion
    noise_density : ndarray, shape (12,)
        Diagonal of the noise's spectral density; sensor noise is alike on all axes, so turning it with C changes
        nothing.
    dt : float
        Length of the interval, s.
    """
    entries = P.ravel()  # with the distance of the rows known, the compiler lets several columns grow at once
    for column in range(12):
        _write(entries, column, _grown(motion, _error(entries, column), dt))
    _transpose_what_has_grown(P)
    for column in range(6):
        _write(entries, column, _grown(motion, _error(entries, column), dt))
    for i in range(6):
        for j in range(i):
            P[i, j] = P[j, i]
    add_noise(P, noise_density, dt)


@compiled
def _grown(motion: Motion, dx: tuple[Vector, Vector, Vector, Vector], dt: float) -> tuple[Vector, Vector]:
    """Give the errors of velocity and attitude after an interval, ``dx + F dx dt``."""
    velocity_error_rate, misalignment_rate = error_rate(motion, dx[0], dx[1], dx[2], dx[3])
    return add(dx[0], scale(dt, velocity_error_rate)), add(dx[1], scale(dt, misalignment_rate))


@compiled
def _error(entries: Floats, column: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Read a column of a matrix with twelve columns, whose entries stand row by row."""
    return (
        (entries[column], entries[12 + column], entries[24 + column]),
        (entries[36 + column], entries[48 + column], entries[60 + column]),
        (entries[72 + column], entries[84 + column], entries[96 + column]),
        (entries[108 + column], entries[120 + column], entries[132 + column]),
    )


@compiled
def _write(entries: Floats, column: int, error: tuple[Vector, Vector]) -> None:
    """Write the upper half of a column."""
    entries[column], entries[12 + column], entries[24 + column] = error[0]
    entries[36 + column], entries[48 + column], entries[60 + column] = error[1]


@compiled
def _transpose_what_has_grown(P: Floats) -> None:
    """Turn the upper left block over, and copy the upper right one to the lower left."""
    for i in range(6):
        for j in range(i):
            P[i, j], P[j, i] = P[j, i], P[i, j]
    for i in range(6, 12):
        for j in range(6):
            P[i, j] = P[j, i]


@compiled
def add_noise(P: Floats, noise_density: Floats, dt: float) -> None:
    """Add what white noise of a spectral density leaves behind after an interval, ``P <- P + Q``, in place.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance.
    noise_density : ndarray, shape (12,)
        Diagonal of the spectral density.
    dt : float
        Length of the interval, s.
    """
    for i in range(12):
        P[i, i] += noise_density[i] * dt


def noise_density(
    accel_white_mps_rts: float,
    gyro_white_rad_rts: float,
    accel_bias_walk_mps2_rts: float,
    gyro_bias_walk_radps_rts: float,
) -> Floats:
    """Give the diagonal of the process noise's spectral density, diag(N_a^2, N_g^2, K_a^2, K_g^2).

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
