"""The Kalman update: the gain and the covariance in Joseph form, adaptive noise, and the correction of the state.

Inner loops run along the n states, as memory does. They are written out, because the matrices are small and the
compiler makes less of library calls. Source: Groves, chapter 3; for NIS, Bar-Shalom, Li and Kirubarajan, "Estimation
with Applications to Tracking and Navigation", chapter 5.
"""

import math
from typing import Final

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import (
    Vector,
    add,
    compose,
    cross,
    rotate,
    rotation_from_vector,
    scale,
    subtract,
)
from insdvl_replay.nav.earth_model import LocalEarth
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
def innovation_cov(
    P: Floats,
    H: Floats,
    R: Floats,
    HP: Floats,
    S: Floats,
) -> None:
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
    """Return the NIS, ``z' S^-1 z``, with L of `cholesky`; write ``L^-1 z``, uncorrelated and in standard deviations.

    Parameters
    ----------
    L : ndarray, shape (m, m)
    innovation, standardised : ndarray, shape (m,)
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
    """Solve ``S K' = H P`` for the gain with the Cholesky factor of S; HP and KT have shape (m, n), L (m, m)."""
    m, n = HP.shape
    for i in range(m):
        for j in range(n):
            KT[i, j] = HP[i, j]
    for i in range(m):
        for k in range(i):
            for j in range(n):
                KT[i, j] -= L[i, k] * KT[k, j]
        for j in range(n):
            KT[i, j] /= L[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            for j in range(n):
                KT[i, j] -= L[k, i] * KT[k, j]
        for j in range(n):
            KT[i, j] /= L[i, i]


@inlined
def update_cov(
    P: Floats,
    H: Floats,
    R: Floats,
    HP: Floats,
    KT: Floats,
    rest: Floats,
) -> None:
    """Update the covariance in place, ``P <- (I - K H) P (I - K H)' + K R K'``, and keep it symmetric.

    With ``B = P (I - K H)'`` it is ``B + K (R K' - H B)``. If K is the gain, the bracket vanishes but for rounding.
    In this form, no product is of two matrices of n columns and rows.

    Parameters
    ----------
    P : ndarray, shape (n, n)
    H, KT : ndarray, shape (m, n)
    R : ndarray, shape (m, m)
    HP : ndarray, shape (m, n)
        H P; used up.
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
def _subtract_transposed_product(
    A: Floats,
    B: Floats,
    total: Floats,
    row: Floats,
) -> None:
    """Subtract ``A' B`` row by row; ``row`` is written."""
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            row[j] = A[0, i] * B[0, j]
        for k in range(1, A.shape[0]):
            for j in range(B.shape[1]):
                row[j] += A[k, i] * B[k, j]
        for j in range(B.shape[1]):
            total[i, j] -= row[j]


# Measurement noise that the settings do not have right
#
# adaptive    R <- b R, f <- f + ((z' z - H P H') / R - f) / 30, from 0.1 to 10: by the innovations until this one;
#             var(f) <- (29/30)^2 var(f) + 2 (S / R)^2 / 30^2, by S of the noise of the settings,
#             b = f - 9 var(f) / (f - 1), or 1 within three sd: what of f is more than chance
# student-t   R <- f R, f = max(1, (nu + NIS) / (nu + m + 3 sqrt(2 m))), nu = 10: for this innovation alone
#
# Source: Sage and Husa, "Adaptive filtering with unknown prior statistics", 1969, with a window and limits as later
# papers have them; James and Stein, "Estimation with quadratic loss", 1961, for the factor that is used; Roth, Oezkan
# and Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", 2013, of which this is the
# first step, relative to its effect at three sd of the NIS, where outliers begin. Without these two, clean dives drift
# by 2 to 6 % more; with them, by less than 1 %, see `benchmarks/noise.py`.

FIXED, ADAPTIVE, STUDENT_T = range(3)

WINDOW: Final = 30.0
"""Innovations after which a third of a step of the noise is left to find."""
FLOOR: Final = 0.1
CEILING: Final = 10.0
"""Limits of the factor: a noise further off is a fault of the settings."""
CHANCE_SD: Final = 3.0
"""Within so many standard deviations the noise is taken to be that of the settings."""
DEGREES_OF_FREEDOM: Final = 10.0
"""Of Student's t: with 4, clean dives drift by 2 % more; with 20, outliers have more effect."""


@inlined
def outlier_factor(nis: float, size: int) -> float:
    """Return the factor of R by Student's t, for an innovation of ``size`` components."""
    by_chance = size + CHANCE_SD * math.sqrt(2.0 * size)
    return max(1.0, (DEGREES_OF_FREEDOM + nis) / (DEGREES_OF_FREEDOM + by_chance))


@inlined
def found_factor(
    found: float,
    used: float,
    z: Floats,
    S: Floats,
    R: Floats,
    share: float,
) -> float:
    """Return the factor of R after one more innovation; S was made with R, which holds the factor used until now.

    ``share`` is the part of the innovation's square that counts. For one that a gate has rejected, it is the part that
    would have passed: without these, a noise that grows would never be found; with all of them, an outlier would be
    taken for noise.
    """
    seen, size = 0.0, len(z)
    for i in range(size):
        seen += (share * z[i] * z[i] - (S[i, i] - R[i, i])) / (R[i, i] / used)
    return min(CEILING, max(FLOOR, found + (seen / size - found) / WINDOW))


@inlined
def chance_var(
    var: float,
    used: float,
    S: Floats,
    R: Floats,
) -> float:
    """Return the variance by chance of the factor found, after one more innovation.

    After an outage an innovation depends on the INS. Its effect on the factor is forgotten no sooner than this. The
    limits of the factor are its own.
    """
    fresh, size = 0.0, len(R)
    for i in range(size):
        fresh += 2.0 * ((S[i, i] - R[i, i]) / (R[i, i] / used) + 1.0) ** 2
    kept = 1.0 - 1.0 / WINDOW
    return min(
        ((CEILING - 1.0) / CHANCE_SD) ** 2, kept * kept * var + fresh / (size * WINDOW) ** 2
    )


@inlined
def significant_factor(found: float, var: float) -> float:
    """Return the part of a factor that is more than chance."""
    excess = found - 1.0
    if excess**2 <= CHANCE_SD**2 * var:
        return 1.0
    return found - CHANCE_SD**2 * var / excess


# Correction of the state
#
# A velocity in b measures exactly the velocity error that is left when the true dive is turned by the misalignment,
# xi = v_hat - C_hat C' v, for misalignments of any size. Its first order is dv + v x phi. So the estimate K z is taken
# out as v <- exp(-[phi x]) (v - xi). Taking dv off instead leaves 1/2 phi x (phi x v), which after an outage is more
# than the filter allows for.
#
# The errors are counted from the estimate, so that a correction moves the point from which they are counted. Which
# heading error looks like which velocity error depends on the velocity: turned as a whole about down, a dive looks the
# same to DVL and IMU, and dv = -v x phi goes with the turn phi. A filter that corrects v and leaves P unchanged takes
# the difference of the old and the new v for information on the heading. The same holds for the DVL's scale and yaw,
# whose effect on the velocity grows with it.
#
# Source: Barrau and Bonnabel, "The Invariant Extended Kalman Filter as a Stable Observer";
# docs/equations/kalman_filter.md.


@inlined
def correct(
    state: NavState,
    constants: Floats,
    P: Floats,
    dx: Floats,
    layout: StateLayout,
    earth: LocalEarth,
) -> NavState:
    """Take ``dx`` out of position, velocity and attitude, and add it to biases and constants.

    Parameters
    ----------
    constants : ndarray, shape (c,)
        Of the sensors, changed in place.
    P : ndarray, shape (n, n)
        Covariance after the update, carried along to the corrected state.
    dx : ndarray, shape (n,)
        ``K z``.
    """
    misalignment, before_n = (dx[3], dx[4], dx[5]), state.velocity_n
    invariant_error = add((dx[0], dx[1], dx[2]), cross(before_n, misalignment))
    turn_back = rotation_from_vector(scale(-1.0, misalignment))
    velocity_n, mat_nb = (
        rotate(turn_back, subtract(before_n, invariant_error)),
        compose(turn_back, state.mat_nb),
    )
    change_n = subtract(before_n, velocity_n)
    keep_invariant_error(P, change_n)
    # Likewise for dv - v k / (1 + k_hat) + C e_z x v psi, which a DVL's velocities measure.
    if layout.dvl_scale >= 0:
        factor = 1.0 + constants[layout.dvl_scale - layout.constants]
        _add_to_velocity_error(P, layout.dvl_scale, scale(-1.0 / factor, change_n))
    if layout.dvl_yaw >= 0:
        _add_to_velocity_error(
            P, layout.dvl_yaw, cross((mat_nb[0][2], mat_nb[1][2], mat_nb[2][2]), change_n)
        )
    position, at = state.position, layout.position
    if at >= 0:
        position = without_error(position, (dx[at], dx[at + 1], dx[at + 2]), earth)
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

    The covariance of ``dv + v x phi``, which the update has measured, stays the same.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance, changed in its rows and columns of dv.
    velocity_change_n : tuple of 3 float
        Taken off the velocity, m/s.
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
