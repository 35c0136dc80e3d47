"""The Kalman update in Joseph form, for measurements of m components. It knows neither time nor sensors.

Inner loops run along the n states, as memory does. The loops are written out: the matrices are small, and the compiler
makes less of library calls. Source: Groves, chapter 3; for NIS, Bar-Shalom, Li and Kirubarajan, "Estimation with
Applications to Tracking and Navigation", chapter 5.

Measurement noise that is not what it is said to be: innovations tell its size, or outliers are expected among them.

adaptive    R <- b R, f <- f + ((z' z - H P H') / R - f) / 30, from 0.1 to 10: by the innovations until this one;
            var(f) <- (29/30)^2 var(f) + 2 (S / R)^2 / 30^2, by S of a noise as it is said to be,
            b = f - 9 var(f) / (f - 1), or 1 within three sd: what of f is more than chance
student-t   R <- f R, f = max(1, (nu + NIS) / (nu + m + 3 sqrt(2 m))), nu = 10: for this innovation alone

Source: Sage and Husa, "Adaptive filtering with unknown prior statistics", 1969, with a window and limits as follow-ups
have them; James and Stein, "Estimation with quadratic loss", 1961, for what is believed of the factor; Roth, Oezkan and
Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", 2013, of which this is the first
step, in ratio to what it does at three sd of the NIS, where outliers begin. Without these two, clean dives drift by 2
to 6 % more; with them, by less than 1 %, see `benchmarks/noise.py`.

Take the estimated errors out of the navigation state, and carry the covariance along to the corrected state.

What a velocity in b measures is exactly the velocity error that is left when the true dive is turned by the
misalignment, ``xi = v_hat - C_hat C' v``, for misalignments of any size; its first order is ``dv + v x phi``. What
``K z`` estimates is therefore taken out as ``v <- exp(-[phi x]) (v - xi)``. To take ``dv`` off instead leaves
``1/2 phi x (phi x v)`` behind, which after an outage is more than the filter allows for.

The errors are counted from the estimate, so that a correction moves the point from which they are counted. Which
heading error looks like which velocity error depends on the velocity: turned as a whole about down, a dive looks the
same to DVL and IMU, and ``dv = -v x phi`` goes with the turn ``phi``. A filter that corrects v and leaves P as it was
takes the difference between the old and the new v for a sight of the heading. The same holds of the DVL's scale and
yaw: what they read too much looks like a velocity that is as much larger, or turned, and the more the v is.

Source: Barrau and Bonnabel, "The Invariant Extended Kalman Filter as a Stable Observer"; see
equations/kalman_filter.md.
"""

import math
from typing import Final

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import Matrix, Vector, add, compose, cross, rotate, rotation_from_vector, scale, subtract
from insdvl_replay.nav.earth_model import Place
from insdvl_replay.nav.error_model import StateLayout, without_error
from insdvl_replay.nav.strapdown import NavState


@inlined
def multiply(A: Floats, B: Floats, product: Floats) -> None:
    """Write ``A B``; ``product`` is neither of them."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            product[i, j] = 0.0
        for k in range(A.shape[1]):
            factor = A[i, k]
            for j in range(B.shape[1]):
                product[i, j] += factor * B[k, j]


@inlined
def innovation_cov(P: Floats, H: Floats, R: Floats, HP: Floats, S: Floats) -> None:
    """Write the covariance of the innovation, ``S = H P H' + R``.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
        Symmetric.
    HP : ndarray, shape (m, n)
        Written: H P.
    S : ndarray, shape (m, m)
        Written, symmetric.
    """
    multiply(H, P, HP)
    for i in range(H.shape[0]):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(H.shape[1]):
                total += HP[i, k] * H[j, k]
            S[i, j] = S[j, i] = total


@inlined
def cholesky(S: Floats, L: Floats) -> None:
    """Write the lower triangle L with ``L L' = S``; NaN where S is not positive definite. Both have shape (m, m)."""
    for i in range(S.shape[0]):
        for j in range(i):
            rest = S[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = rest / L[j, j]
        square = S[i, i]
        for k in range(i):
            square -= L[i, k] * L[i, k]
        L[i, i] = math.sqrt(square) if square > 0.0 else math.nan


@inlined
def normalised_square(L: Floats, innovation: Floats, standardised: Floats) -> float:
    """Return ``z' S^-1 z``, the NIS, and write ``L^-1 z``: innovations in standard deviations, uncorrelated.

    Parameters
    ----------
    L : ndarray, shape (m, m)
        Of `cholesky`.
    innovation : ndarray, shape (m,)
    standardised : ndarray, shape (m,)
        Written.
    """
    total = 0.0
    for i in range(L.shape[0]):
        rest = innovation[i]
        for k in range(i):
            rest -= L[i, k] * standardised[k]
        standardised[i] = rest / L[i, i]
        total += standardised[i] * standardised[i]
    return total


@inlined
def transposed_gain(HP: Floats, L: Floats, KT: Floats) -> None:
    """Solve ``S K' = H P`` for the gain, with the Cholesky factor of S and without inverting it.

    Parameters
    ----------
    HP : ndarray, shape (m, n)
    L : ndarray, shape (m, m)
    KT : ndarray, shape (m, n)
        Written: K'.
    """
    for i in range(HP.shape[0]):
        for j in range(HP.shape[1]):
            KT[i, j] = HP[i, j]
    _substitute_forward(L, KT)
    _substitute_backward(L, KT)


@inlined
def _substitute_forward(L: Floats, X: Floats) -> None:
    """Write ``L^-1 X`` in the place of X, shape (m, n)."""
    for i in range(X.shape[0]):
        for k in range(i):
            for j in range(X.shape[1]):
                X[i, j] -= L[i, k] * X[k, j]
        for j in range(X.shape[1]):
            X[i, j] /= L[i, i]


@inlined
def _substitute_backward(L: Floats, X: Floats) -> None:
    """Write ``L'^-1 X`` in the place of X, shape (m, n)."""
    for i in range(X.shape[0] - 1, -1, -1):
        for k in range(i + 1, X.shape[0]):
            for j in range(X.shape[1]):
                X[i, j] -= L[k, i] * X[k, j]
        for j in range(X.shape[1]):
            X[i, j] /= L[i, i]


@inlined
def update_cov(P: Floats, H: Floats, R: Floats, HP: Floats, KT: Floats, rest: Floats) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``B = P (I - K H)'`` it is ``B + K (R K' - H B)``; if K is the gain, the bracket vanishes but for rounding.
    Multiplied out in this way, no product is of two matrices of n columns and rows.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    HP : ndarray, shape (m, n)
        H P; used up.
    KT : ndarray, shape (m, n)
        K'.
    rest : ndarray, shape (m, n)
        Written: the bracket.
    """
    _subtract_transposed_product(HP, KT, P, rest[0])
    multiply(H, P, rest)
    multiply(R, KT, HP)
    for i in range(H.shape[0]):
        for j in range(H.shape[1]):
            rest[i, j] -= HP[i, j]
    _subtract_transposed_product(KT, rest, P, HP[0])
    for i in range(P.shape[0]):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@inlined
def _subtract_transposed_product(A: Floats, B: Floats, total: Floats, row: Floats) -> None:
    """Subtract ``A' B``, row by row; ``row`` is written."""
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            row[j] = A[0, i] * B[0, j]
        for k in range(1, A.shape[0]):
            for j in range(B.shape[1]):
                row[j] += A[k, i] * B[k, j]
        for j in range(B.shape[1]):
            total[i, j] -= row[j]


FIXED: Final = 0
ADAPTIVE: Final = 1
STUDENT_T: Final = 2

WINDOW: Final = 30.0
"""Innovations after which a step of the noise is followed but for a third."""
FLOOR: Final = 0.1
CEILING: Final = 10.0
"""Limits of the factor: a noise further off is a fault of the settings."""
CHANCE_SD: Final = 3.0
"""How far off may be by chance, in standard deviations: so far the noise is what it is said to be."""
DEGREES_OF_FREEDOM: Final = 10.0
"""Of Student's t: with 4 clean dives drift by 2 % more, with 20 outliers are let in further."""


@inlined
def outlier_factor(nis: float, size: int) -> float:
    """Return by how much R is larger than said where Student's t of an innovation of so many components has it."""
    by_chance = size + CHANCE_SD * math.sqrt(2.0 * size)
    return max(1.0, (DEGREES_OF_FREEDOM + nis) / (DEGREES_OF_FREEDOM + by_chance))


@inlined
def found_factor(found: float, believed: float, z: Floats, S: Floats, R: Floats, share: float) -> float:
    """Return how large R is by an innovation more; S was made with ``R``, which holds the factor believed until now.

    Of the square of one that a gate has rejected only as large a ``share`` counts as would have passed. Without these a
    noise that grows would never be found; with all of them an outlier would be taken for noise.
    """
    seen, size = 0.0, len(z)
    for i in range(size):
        seen += (share * z[i] * z[i] - (S[i, i] - R[i, i])) / (R[i, i] / believed)
    return min(CEILING, max(FLOOR, found + (seen / size - found) / WINDOW))


@inlined
def chance_var(var: float, believed: float, S: Floats, R: Floats) -> float:
    """Return the variance of what is found of a noise as it was said to be, by an innovation more.

    After an outage an innovation tells of the INS, and what it does to the factor is forgotten no sooner than this. The
    limits of the factor are its own.
    """
    of_one, size = 0.0, len(R)
    for i in range(size):
        of_one += 2.0 * ((S[i, i] - R[i, i]) / (R[i, i] / believed) + 1.0) ** 2
    kept = 1.0 - 1.0 / WINDOW
    return min(((CEILING - 1.0) / CHANCE_SD) ** 2, kept * kept * var + of_one / (size * WINDOW) ** 2)


@inlined
def believed_factor(found: float, var: float) -> float:
    """Return what is left of a factor beyond what innovations of a noise as it was said to be would find by chance."""
    excess = found - 1.0
    if excess**2 <= CHANCE_SD**2 * var:
        return 1.0
    return found - CHANCE_SD**2 * var / excess


@inlined
def correct(state: NavState, constants: Floats, P: Floats, dx: Floats, layout: StateLayout, place: Place) -> NavState:
    """Take ``dx`` out of position, velocity and attitude, add it to biases and constants; errors return to zero.

    Parameters
    ----------
    constants : ndarray, shape (c,)
        Of the sensors, changed in place.
    P : ndarray, shape (n, n)
        Covariance after the update, carried along.
    dx : ndarray, shape (n,)
        ``K z``.

    Returns
    -------
    NavState
        Corrected.
    """
    misalignment, before_n = (dx[3], dx[4], dx[5]), state.velocity_n
    invariant_error = add((dx[0], dx[1], dx[2]), cross(before_n, misalignment))
    turn_back = rotation_from_vector(scale(-1.0, misalignment))
    velocity_n, mat_nb = rotate(turn_back, subtract(before_n, invariant_error)), compose(turn_back, state.mat_nb)
    keep_invariant_error(P, subtract(before_n, velocity_n))
    _keep_what_the_dvl_reads(P, subtract(before_n, velocity_n), mat_nb, constants, layout)
    position, at = state.position, layout.position
    if at >= 0:
        position = without_error(position, (dx[at], dx[at + 1], dx[at + 2]), place)
    for i in range(len(constants)):
        constants[i] += dx[layout.constants + i]
    return NavState(
        position,
        velocity_n,
        mat_nb,
        add(state.accel_bias_b, (dx[6], dx[7], dx[8])),
        add(state.gyro_bias_b, (dx[9], dx[10], dx[11])),
    )


@inlined
def keep_invariant_error(P: Floats, velocity_change_n: Vector) -> None:
    """Express the covariance about the corrected velocity: ``P <- T P T'`` with ``dv <- dv + velocity_change x phi``.

    It leaves the covariance of ``dv + v x phi`` as it was, the velocity error that the update has told something of.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance, changed in its rows and columns of dv.
    velocity_change_n : tuple of 3 float
        What was taken off the velocity, m/s.
    """
    x, y, z = velocity_change_n
    for j in range(P.shape[0]):
        north, east, down = P[3, j], P[4, j], P[5, j]
        P[0, j] += y * down - z * east
        P[1, j] += z * north - x * down
        P[2, j] += x * east - y * north
    for j in range(P.shape[0]):
        north, east, down = P[j, 3], P[j, 4], P[j, 5]
        P[j, 0] += y * down - z * east
        P[j, 1] += z * north - x * down
        P[j, 2] += x * east - y * north
    for i in range(3):
        for j in range(i):
            P[i, j] = P[j, i]


@inlined
def _keep_what_the_dvl_reads(
    P: Floats, velocity_change_n: Vector, mat_nb: Matrix, constants: Floats, layout: StateLayout
) -> None:
    """Do as `keep_invariant_error` for ``dv - v k / (1 + k_hat) + C e_z x v psi``, of which a DVL's velocities tell."""
    if layout.dvl_scale >= 0:
        factor = 1.0 + constants[layout.dvl_scale - layout.constants]
        _add_to_velocity_error(P, layout.dvl_scale, scale(-1.0 / factor, velocity_change_n))
    if layout.dvl_yaw >= 0:
        down_n = (mat_nb[0][2], mat_nb[1][2], mat_nb[2][2])
        _add_to_velocity_error(P, layout.dvl_yaw, cross(down_n, velocity_change_n))


@inlined
def _add_to_velocity_error(P: Floats, state: int, share: Vector) -> None:
    """Express the covariance with ``dv <- dv + share x`` of one state x."""
    for i in range(3):
        for j in range(P.shape[0]):
            P[i, j] += share[i] * P[state, j]
    for i in range(3):
        for j in range(P.shape[0]):
            P[j, i] += share[i] * P[j, state]
    for i in range(3):
        for j in range(i):
            P[i, j] = P[j, i]
