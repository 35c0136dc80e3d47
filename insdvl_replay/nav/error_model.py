"""The 12-state error model: how errors of the mechanisation grow.

F = [ -[(2 w_ie + w_en) x]   -[f_n x]     C   0 ]
    [          0            -[w_in x]     0   C ]
    [          0                0         0   0 ]
    [          0                0         0   0 ]

Equations (26) to (32) of Levy and Klein, with the rates of n where they print the gyro's output; see EQUATIONS.md.
"""

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.nav.compiled import compiled


@compiled
def write_skew(matrix: Floats, row: int, column: int, sign: float, vector: Floats) -> None:
    """Write ``sign [vector x]`` into the 3 x 3 block of a matrix that starts at a row and a column."""
    x, y, z = sign * vector[0], sign * vector[1], sign * vector[2]
    matrix[row, column], matrix[row, column + 1], matrix[row, column + 2] = 0.0, -z, y
    matrix[row + 1, column], matrix[row + 1, column + 1], matrix[row + 1, column + 2] = z, 0.0, -x
    matrix[row + 2, column], matrix[row + 2, column + 1], matrix[row + 2, column + 2] = -y, x, 0.0


@compiled
def write_system_matrix(rate_ie_n: Floats, rate_in_n: Floats, force_n: Floats, mat_nb: Floats, F: Floats) -> None:
    """Write the system matrix F of the error state.

    Parameters
    ----------
    rate_ie_n, rate_in_n : ndarray, shape (3,)
        Earth rate, and Earth rate plus transport rate, rad/s.
    force_n : ndarray, shape (3,)
        Specific force in n, m/s^2.
    mat_nb : ndarray, shape (3, 3)
        Attitude.
    F : ndarray, shape (12, 12)
        Its first six rows are written; the others stay zero.
    """
    coriolis_n = np.empty(3)
    for i in range(3):
        coriolis_n[i] = rate_ie_n[i] + rate_in_n[i]
    write_skew(F, 0, 0, -1.0, coriolis_n)
    write_skew(F, 0, 3, -1.0, force_n)
    write_skew(F, 3, 3, -1.0, rate_in_n)
    for i in range(3):
        for j in range(3):
            F[i, 6 + j] = mat_nb[i, j]
            F[3 + i, 9 + j] = mat_nb[i, j]


@compiled
def propagate_cov(P: Floats, F: Floats, noise_density: Floats, dt: float, FP: Floats) -> None:
    """Advance the covariance: ``P <- Phi P Phi' + Q`` with ``Phi = I + F dt``, in place.

    Multiplied out, ``P + (F P dt) + (F P dt)' + (F P dt) F' dt``, where only the first six rows of F are not zero; of
    these the upper three have columns 0 to 8, the lower three 3 to 5 and 9 to 11. P stays symmetric to the last bit.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance, advanced.
    F : ndarray, shape (12, 12)
        System matrix.
    noise_density : ndarray, shape (12,)
        Diagonal of the noise's spectral density; sensor noise is alike on all axes, so turning it with C changes
        nothing.
    dt : float
        Length of the interval, s.
    FP : ndarray, shape (6, 12)
        Room for F P dt.
    """
    _write_product(P, F, dt, FP)
    for i in range(6):
        for j in range(12):
            P[i, j] += FP[i, j]
            P[j, i] += FP[i, j]
    _add_second_order(P, F, dt, FP)
    add_noise(P, noise_density, dt)


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


@compiled
def _write_product(P: Floats, F: Floats, dt: float, FP: Floats) -> None:
    """Write the first six rows of F P dt, passing over the blocks of F that are zero."""
    for i in range(6):
        for j in range(12):
            FP[i, j] = 0.0
    for i in range(3):
        for k in range(9):
            _add_row(F[i, k] * dt, P, k, FP, i)
    for i in range(3, 6):
        for k in range(3):
            _add_row(F[i, 3 + k] * dt, P, 3 + k, FP, i)
            _add_row(F[i, 9 + k] * dt, P, 9 + k, FP, i)


@compiled
def _add_row(factor: float, P: Floats, k: int, FP: Floats, i: int) -> None:
    for j in range(12):
        FP[i, j] += factor * P[k, j]


@compiled
def _add_second_order(P: Floats, F: Floats, dt: float, FP: Floats) -> None:
    """Add (F P dt) F' dt, the same number to both triangles, passing over the blocks of F that are zero."""
    for i in range(6):
        for j in range(i + 1):
            product = 0.0
            if j < 3:
                for k in range(9):
                    product += FP[i, k] * F[j, k]
            else:
                for k in range(3):
                    product += FP[i, 3 + k] * F[j, 3 + k] + FP[i, 9 + k] * F[j, 9 + k]
            P[i, j] += product * dt
            if i != j:
                P[j, i] += product * dt


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
