"""What the DVL measures at its pings, ready for a filter: the velocity, or the slope of the last few, with its noise R.

`innovation` predicts the same from the INS.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs, seconds
from insdvl_replay.nav.dvl import DvlVelocities, slope_windows, windowed_sum

VELOCITY: Final = 0
PUBLISHED: Final = 1
WINDOWED: Final = 2
NEVER_REOPENED: Final = 0
"""An acceleration that is rejected locks nothing out: the velocity brings the INS back."""


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
    reopen_after : int
        Rejections in a row after which the velocity's uncertainty is opened; 0: never.
    """

    kind: int
    available: NDArray[np.bool_]
    valid_ns: TimeNs
    measured_b: Floats
    cov_b: Floats
    velocity_weights: Floats
    interval_weights: Floats
    gate: float
    reopen_after: int


def velocity_cov(velocities: DvlVelocities, sd_mps: float, *, of_one_beam: bool = False) -> Floats:
    """Return the covariance of each DVL velocity.

    Noise of one beam goes through the least squares. Else each axis of a velocity from all beams has ``sd_mps``, and a
    velocity from fewer beams is worse by as much as the least squares says.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    of_one_beam : bool
        Whether the noise is that of a beam; of velocities that come from beams alone.

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    if of_one_beam or not velocities.from_beams:
        return sd_mps**2 * velocities.unit_cov_b
    values, vectors = np.linalg.eigh(velocities.full_unit_cov_b)
    whiten = vectors / np.sqrt(values) @ vectors.T
    cov: Floats = sd_mps**2 * (whiten @ velocities.unit_cov_b @ whiten)
    return cov


def velocity_measurement(velocities: DvlVelocities, cov_b: Floats, gate: float, reopen_after: int) -> Measurement:
    """Aid by the DVL's velocity at every ping.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    cov_b : ndarray, shape (m, 3, 3)
        From `velocity_cov`.
    gate : float
        Largest NIS that is used.
    reopen_after : int
        Rejections in a row after which the velocity's uncertainty is opened; 0: never.
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
        reopen_after,
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
        NEVER_REOPENED,
    )
