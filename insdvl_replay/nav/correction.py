"""Take the estimated errors out of the navigation state, and carry the covariance along to the corrected state.

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
from insdvl_replay.nav.local_earth import Place
from insdvl_replay.nav.position_error import without_error
from insdvl_replay.nav.state_layout import TWELVE, StateLayout
from insdvl_replay.nav.state_log import Updates
from insdvl_replay.nav.strapdown import NavState
from insdvl_replay.nav.vector_algebra import (
    Matrix,
    Vector,
    add,
    compose,
    cross,
    rotate,
    rotation_from_vector,
    scale,
    subtract,
)

RUN_PAUSE_S: Final = 60.0
"""Rejections further apart, as on both sides of an outage, are no run."""
SOON_S: Final = 60.0
"""A filter that is lost again so soon was not put right by its velocity."""


@inlined
def locks_out(updates: Updates, m: int, nis: float, time_s: float, reopen_after: int) -> bool:
    """Count a rejection, and tell whether there were so many in a row that it is the INS which is off."""
    if not math.isfinite(nis):
        return False
    goes_on = time_s - updates.refused_s[m] <= RUN_PAUSE_S
    updates.refused_in_a_row[m] = updates.refused_in_a_row[m] + 1 if goes_on else 1
    updates.refused_s[m] = time_s
    lost: bool = 0 < reopen_after <= updates.refused_in_a_row[m]
    return lost


@inlined
def note_used(updates: Updates, m: int, time_s: float) -> None:
    """End a run of rejections."""
    updates.refused_in_a_row[m], updates.used_s[m] = 0, time_s


@inlined
def open_state(
    P: Floats, square: float, start_var: Floats, position: int, updates: Updates, m: int, time_s: float
) -> None:
    """Let the velocity be as uncertain on each axis as the innovation is large: the next gain sets it to the DVL's.

    The position becomes as uncertain as so wrong a velocity lets it since the last reading that was used. Other states
    keep their uncertainty and their correlations with the velocity, and hardly move. A filter that is lost again within
    `SOON_S` was not put right by that: levels, heading and biases become as uncertain as at the start, on top of what
    they are.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; variances grow, in place.
    square : float
        Of the innovation, m^2/s^2.
    start_var : ndarray, shape (n,)
        Variances at the start.
    position : int
        Row of the position's first state, negative where there is none.
    updates : Updates
        Its times of this kind of measurement are changed.
    m : int
        The kind of measurement.
    time_s : float
        Seconds from the start.
    """
    if time_s - updates.reopened_s[m] <= SOON_S:
        for i in range(3, TWELVE):
            P[i, i] += start_var[i]
    lost_s = time_s - updates.used_s[m]
    for i in range(3):
        P[i, i] += square
        if position >= 0:
            P[position + i, position + i] += square * lost_s * lost_s
    updates.reopened_s[m] = time_s
    note_used(updates, m, time_s)


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
