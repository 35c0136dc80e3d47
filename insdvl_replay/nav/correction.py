"""Take the estimated errors out of the navigation state, and carry the covariance along to the corrected state.

The errors are counted from the estimate, so that a correction moves the point from which they are counted. Which
heading error looks like which velocity error depends on the velocity: turned as a whole about down, a dive looks the
same to DVL and IMU, and ``dv = -v x phi`` goes with the turn ``phi``. A filter that corrects v and leaves P as it was
takes the difference between the old and the new v for a sight of the heading.

Source: Barrau and Bonnabel, "The Invariant Extended Kalman Filter as a Stable Observer"; see EQUATIONS.md.
"""

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.recording import Ins
from insdvl_replay.nav.vector_algebra import compose, matrix, rotation_from_vector, write_matrix


@compiled
def correct(ins: Ins, KT: Floats, z: Floats) -> None:
    """Take ``dx = K z`` out of the navigation state; the error state returns to zero.

    Parameters
    ----------
    ins : Ins
        Corrected; its P is that after the update.
    KT : ndarray, shape (3, 12)
        K', of the gain.
    z : ndarray, shape (3,)
        Innovation.
    """
    dx = np.empty(12)
    for i in range(12):
        dx[i] = KT[0, i] * z[0] + KT[1, i] * z[1] + KT[2, i] * z[2]
    for i in range(3):
        ins.velocity_n[i] -= dx[i]
        ins.accel_bias_b[i] += dx[6 + i]
        ins.gyro_bias_b[i] += dx[9 + i]
    turn = rotation_from_vector((-dx[3], -dx[4], -dx[5]))
    write_matrix(compose(turn, matrix(ins.mat_nb)), ins.mat_nb)
    keep_invariant_error(ins.P, dx[:3])


@compiled
def keep_invariant_error(P: Floats, velocity_change_n: Floats) -> None:
    """Express the covariance about the corrected velocity: ``P <- T P T'`` with ``dv <- dv + velocity_change x phi``.

    It leaves the covariance of ``dv + v x phi`` as it was, the velocity error that the update has told something of.

    Parameters
    ----------
    P : ndarray, shape (12, 12)
        Covariance, changed in its rows and columns of dv.
    velocity_change_n : ndarray, shape (3,)
        What was taken off the velocity, m/s.
    """
    x, y, z = velocity_change_n
    for j in range(12):
        north, east, down = P[3, j], P[4, j], P[5, j]
        P[0, j] += y * down - z * east
        P[1, j] += z * north - x * down
        P[2, j] += x * east - y * north
    for j in range(12):
        north, east, down = P[j, 3], P[j, 4], P[j, 5]
        P[j, 0] += y * down - z * east
        P[j, 1] += z * north - x * down
        P[j, 2] += x * east - y * north
    for i in range(3):
        for j in range(i):
            P[i, j] = P[j, i]
