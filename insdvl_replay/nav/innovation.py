"""What a measurement says of the errors at a ping: the innovation z and the Jacobian H.

    z = predicted - measured = H dx + noise,    dx = estimated - true

velocity      z = C' v + w_eb x l - v_dvl                    H = [ C' | C'[v x] | 0 | -[l x] ]
published     z = f + C' g - a_dvl                           H = [ 0 | C'[g x] | I | 0 ]
windowed      z = slope of the INS over the window - a_dvl   H = [ -[w x]C' | C'[g x] - [w x]C'[v x] | I | [v_b x] ]

The slope of a body-frame velocity is ``f + C' g - w x v_b``; ``published`` is the paper's model, which leaves out w x
v_b. ``windowed`` predicts the same weighted sum of velocities that the DVL's slope is, from what the mechanisation
alone has added to the body velocity between pings. Equations (36) to (46) of Levy and Klein, with signs that agree with
F; see EQUATIONS.md.
"""

from typing import NamedTuple

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.error_model import write_skew
from insdvl_replay.nav.measurements import PUBLISHED, VELOCITY, Measurement
from insdvl_replay.nav.vector_algebra import matrix, rotate_back, vector, write_vector


class InsAtPing(NamedTuple):
    """What the INS knows at a ping, and what it remembers of the pings before.

    Attributes
    ----------
    velocity_n : ndarray, shape (3,)
    mat_nb : ndarray, shape (3, 3)
    specific_force_b : ndarray, shape (3,)
        Compensated reading, m/s^2.
    rate_nb_b, rate_eb_b : ndarray, shape (m, 3)
        Angular rate of the body against n and against the Earth at each ping so far, rad/s.
    velocity_change_b : ndarray, shape (m, 3)
        What the mechanisation added to the body velocity since the ping before, m/s.
    gravity : float
        m/s^2
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    """

    velocity_n: Floats
    mat_nb: Floats
    specific_force_b: Floats
    rate_nb_b: Floats
    rate_eb_b: Floats
    velocity_change_b: Floats
    gravity: float
    lever_arm_b: Floats


@compiled
def linearise(measurement: Measurement, ping: int, ins: InsAtPing, z: Floats, H: Floats) -> None:
    """Write the innovation and the Jacobian of a measurement.

    Parameters
    ----------
    measurement : Measurement
    ping : int
        Row of the ping.
    ins : InsAtPing
    z : ndarray, shape (3,)
        Written: predicted minus measured.
    H : ndarray, shape (3, 12)
        Written.
    """
    for i in range(3):
        for j in range(12):
            H[i, j] = 0.0
    if measurement.kind == VELOCITY:
        _predict_velocity(ins, ping, z, H)
    elif measurement.kind == PUBLISHED:
        _predict_specific_force(ins, z, H)
    else:
        _predict_slope(measurement, ins, ping, z, H)
    for i in range(3):
        z[i] -= measurement.measured_b[ping, i]


@compiled
def _predict_velocity(ins: InsAtPing, ping: int, z: Floats, H: Floats) -> None:
    """Write the velocity at the DVL, C' v + w_eb x l, and its Jacobian."""
    write_vector(rotate_back(matrix(ins.mat_nb), vector(ins.velocity_n)), z)
    _add_cross(1.0, ins.rate_eb_b, ping, ins.lever_arm_b, z)
    for i in range(3):
        for j in range(3):
            H[i, j] = ins.mat_nb[j, i]
    _add_turned_skew(ins.mat_nb, ins.velocity_n, H)
    write_skew(H, 0, 9, -1.0, ins.lever_arm_b)


@compiled
def _predict_specific_force(ins: InsAtPing, z: Floats, H: Floats) -> None:
    """Write the paper's prediction, f + C' g, and its Jacobian with the sign that goes with F."""
    gravity_n = np.array([0.0, 0.0, ins.gravity])
    write_vector(rotate_back(matrix(ins.mat_nb), vector(gravity_n)), z)
    _add_turned_skew(ins.mat_nb, gravity_n, H)
    for i in range(3):
        z[i] += ins.specific_force_b[i]
        H[i, 6 + i] = 1.0


@compiled
def _predict_slope(measurement: Measurement, ins: InsAtPing, ping: int, z: Floats, H: Floats) -> None:
    """Write the slope of the DVL's velocity that the mechanisation predicts over the window, and its Jacobian."""
    n = measurement.velocity_weights.shape[1]
    first = ping - n + 1
    for i in range(3):
        z[i] = 0.0
    for j in range(max(0, -first), n):
        _add_cross(measurement.velocity_weights[ping, j], ins.rate_eb_b, first + j, ins.lever_arm_b, z)
        if j > 0:
            for i in range(3):
                z[i] += measurement.interval_weights[ping, j - 1] * ins.velocity_change_b[first + j, i]
    _write_slope_jacobian(ins, ping, H)


@compiled
def _write_slope_jacobian(ins: InsAtPing, ping: int, H: Floats) -> None:
    """Write [ -[w x]C' | C'[g x] - [w x]C'[v x] | I | [v_b x] ]."""
    turned, rate, velocity_b = np.zeros((3, 6)), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(3):
            turned[i, j] = ins.mat_nb[j, i]
    _add_turned_skew(ins.mat_nb, ins.velocity_n, turned)
    write_skew(rate, 0, 0, 1.0, ins.rate_nb_b[ping])
    _add_turned_skew(ins.mat_nb, np.array([0.0, 0.0, ins.gravity]), H)
    for i in range(3):
        H[i, 6 + i] = 1.0
        for j in range(6):
            for k in range(3):
                H[i, j] -= rate[i, k] * turned[k, j]
    write_vector(rotate_back(matrix(ins.mat_nb), vector(ins.velocity_n)), velocity_b)
    write_skew(H, 0, 9, 1.0, velocity_b)


@compiled
def _add_cross(factor: float, rates: Floats, row: int, arm: Floats, total: Floats) -> None:
    """Add ``factor rates[row] x arm``."""
    x, y, z = rates[row, 0], rates[row, 1], rates[row, 2]
    total[0] += factor * (y * arm[2] - z * arm[1])
    total[1] += factor * (z * arm[0] - x * arm[2])
    total[2] += factor * (x * arm[1] - y * arm[0])


@compiled
def _add_turned_skew(mat_nb: Floats, vector_n: Floats, matrix: Floats) -> None:
    """Add ``C' [vector x]`` to columns 3 to 5, those of the misalignment."""
    x, y, z = vector_n[0], vector_n[1], vector_n[2]
    for i in range(3):
        matrix[i, 3] += mat_nb[1, i] * z - mat_nb[2, i] * y
        matrix[i, 4] += mat_nb[2, i] * x - mat_nb[0, i] * z
        matrix[i, 5] += mat_nb[0, i] * y - mat_nb[1, i] * x
