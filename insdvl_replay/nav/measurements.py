"""What the DVL tells the filter: each measurement answers z, H and R at a ping.

    z = predicted - measured = H dx + noise,    dx = estimated - true

velocity      z = C' v + w_eb x l - v_dvl                    H = [ C' | C'[v x] | 0 | -[l x] ]
published     z = f + C' g - a_dvl                           H = [ 0 | C'[g x] | I | 0 ]
windowed      z = slope of the INS over the window - a_dvl   H = [ -[w x]C' | C'[g x] - [w x]C'[v x] | I | [v_b x] ]

The slope of a body-frame velocity is ``f + C' g - w x v_b``; ``published`` is the paper's model, which leaves out w x
v_b. ``windowed`` predicts the same weighted sum of velocities that the DVL's slope is, from what the mechanisation
alone has added to the body velocity between pings. Equations (36) to (46) of Levy and Klein, with signs that agree with
F; see EQUATIONS.md.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, TimeNs, seconds
from insdvl_replay.nav.compiled import compiled
from insdvl_replay.nav.dvl import DvlVelocities, slope_windows, windowed_sum
from insdvl_replay.nav.error_model import write_skew
from insdvl_replay.nav.strapdown import rotate_back

VELOCITY: Final = 0
PUBLISHED: Final = 1
WINDOWED: Final = 2


class Measurement(NamedTuple):
    """One kind of aiding, ready for every ping.

    Attributes
    ----------
    kind : int
        `VELOCITY`, `PUBLISHED` or `WINDOWED`.
    available : ndarray of bool, shape (m,)
        Whether this ping has the measurement.
    valid_ns : ndarray, shape (m,)
        Time of validity: the ping's, or the middle of the window.
    measured_b : ndarray, shape (m, 3)
        Velocity m/s or acceleration m/s^2, in b.
    cov_b : ndarray, shape (m, 3, 3)
        R.
    velocity_weights : ndarray, shape (m, n)
        Weights c of the window's velocities; n = 1 for velocity aiding.
    interval_weights : ndarray, shape (m, n - 1)
        Weights W of the window's intervals.
    gate : float
        Largest NIS that is used.
    """

    kind: int
    available: NDArray[np.bool_]
    valid_ns: TimeNs
    measured_b: Floats
    cov_b: Floats
    velocity_weights: Floats
    interval_weights: Floats
    gate: float


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


def velocity_cov(velocities: DvlVelocities, velocity_sd_mps: float, beam_sd_mps: float | None) -> Floats:
    """Give the covariance of each DVL velocity.

    With ``beam_sd_mps`` it is the beams' noise through the least squares. Without, each axis of a velocity from all
    beams has ``velocity_sd_mps``, and a velocity from fewer beams is worse by as much as the least squares says.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    velocity_sd_mps : float
    beam_sd_mps : float or None

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    if not velocities.from_beams:
        return velocity_sd_mps**2 * velocities.shape_b
    if beam_sd_mps is not None:
        return beam_sd_mps**2 * velocities.shape_b
    values, vectors = np.linalg.eigh(velocities.full_shape_b)
    whiten = vectors / np.sqrt(values) @ vectors.T
    cov: Floats = velocity_sd_mps**2 * (whiten @ velocities.shape_b @ whiten)
    return cov


def velocity_measurement(velocities: DvlVelocities, cov_b: Floats, gate: float) -> Measurement:
    """Aid by the DVL's velocity at every ping.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    cov_b : ndarray, shape (m, 3, 3)
        From `velocity_cov`.
    gate : float
        Largest NIS that is used.

    Returns
    -------
    Measurement
    """
    m = len(velocities.time_ns)
    return Measurement(
        VELOCITY,
        np.ones(m, dtype=np.bool_),
        velocities.time_ns,
        np.ascontiguousarray(velocities.velocity_b),
        np.ascontiguousarray(cov_b),
        np.zeros((m, 1)),
        np.zeros((m, 0)),
        gate,
    )


def acceleration_measurement(
    velocities: DvlVelocities,
    velocity_cov_b: Floats,
    *,
    kind: int,
    window: int,
    order: int,
    max_gap_s: float,
    sd_mps2: float | None,
    accel_white_mps_rts: float,
    gate: float,
) -> Measurement:
    """Aid by the slope of past DVL velocities.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    velocity_cov_b : ndarray, shape (m, 3, 3)
        From `velocity_cov`.
    kind : int
        `PUBLISHED` or `WINDOWED`.
    window, order, max_gap_s
        See `dvl.slope_windows`.
    sd_mps2 : float or None
        Standard deviation on each axis; None takes the DVL's noise through the fit plus the accelerometer's through the
        prediction, ``R_a = sum c_j^2 R_j + N_a^2 sum W_j^2 dt_j``.
    accel_white_mps_rts : float
        White noise of the accelerometers, m/s/sqrt(s).
    gate : float
        Largest NIS that is used.

    Returns
    -------
    Measurement
    """
    time_s = seconds(velocities.time_ns, velocities.time_ns[:1])
    windows = slope_windows(time_s, window, order, max_gap_s)
    if sd_mps2 is not None:
        cov_b = np.broadcast_to(sd_mps2**2 * np.eye(3), (len(time_s), 3, 3))
    else:
        predicted_var = accel_white_mps_rts**2 * np.sum(windows.interval_weights**2 * windows.interval_s, axis=1)
        fitted_cov = windowed_sum(windows.velocity_weights**2, velocity_cov_b)
        cov_b = fitted_cov + predicted_var[:, None, None] * np.eye(3)
    return Measurement(
        kind,
        windows.complete,
        velocities.time_ns[:1] + np.round(windows.middle_s * 1e9).astype(np.int64),
        windowed_sum(windows.velocity_weights, velocities.velocity_b),
        np.ascontiguousarray(cov_b),
        windows.velocity_weights,
        np.ascontiguousarray(windows.interval_weights),
        gate,
    )


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
    rotate_back(ins.mat_nb, ins.velocity_n, z)
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
    rotate_back(ins.mat_nb, gravity_n, z)
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
    rotate_back(ins.mat_nb, ins.velocity_n, velocity_b)
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
