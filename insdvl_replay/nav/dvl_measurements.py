"""What a DVL aids by at its pings: the velocity, single beams, and the acceleration that past velocities make."""

from dataclasses import replace

import numpy as np

from insdvl_replay.core.dive_columns import Floats, seconds
from insdvl_replay.core.quantities import beam_name
from insdvl_replay.nav.dvl import DvlBeams, DvlVelocities, slope_windows, windowed_sum
from insdvl_replay.nav.measurements import BEAM, NEVER_REOPENED, VELOCITY, Measurement, sensor_measurement
from insdvl_replay.nav.timeline import BEAMS, PINGS


def velocity_cov(velocities: DvlVelocities, sd_mps: float, *, of_one_beam: bool = False) -> Floats:
    """Return the covariance of each DVL velocity.

    Noise of one beam goes through the least squares: with four beams, tilted by ``a`` from z, the variances in d are
    ``1 / (2 sin^2 a)``, the same again, and ``1 / (4 cos^2 a)`` times a beam's. Else each axis of a velocity from all
    beams has ``sd_mps``, and a velocity from fewer beams is worse by as much as the least squares says.

    Parameters
    ----------
    velocities : DvlVelocities
        m pings.
    of_one_beam : bool
        Whether the noise is that of a beam.

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    if of_one_beam:
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
        name="velocity",
        unit="m/s",
        kind=VELOCITY,
        sensor=PINGS,
        available=np.ones(m, dtype=np.bool_),
        valid_ns=velocities.time_ns,
        values=velocities.velocity_b,
        cov=cov_b,
        gate=gate,
        reopen_after=reopen_after,
        velocity_weights=np.zeros((m, 1)),
        interval_weights=np.zeros((m, 0)),
        axes=("x", "y", "z"),
        holds_height=True,
    )


def beam_measurements(dvl: DvlBeams, sd_mps: float, gate: float, reopen_after: int) -> tuple[Measurement, ...]:
    """Aid by the velocities along the beams, each judged by itself, and measure how they agree.

    Parameters
    ----------
    dvl : DvlBeams
        k pings.
    sd_mps : float
        Noise of one beam.
    gate : float
        Largest NIS of a beam that is used.
    reopen_after : int
        Pings in a row of which no beam was used, after which the velocity's uncertainty is opened; 0: never.

    Returns
    -------
    tuple of Measurement
        One for each beam, ``beam_1`` and so on, as measurements of one reading.
    """
    beams = dvl.beam_velocity_mps.shape[1]
    found = []
    for beam in range(beams):
        reading = dvl.beam_velocity_mps[:, beam : beam + 1]
        one = sensor_measurement(
            beam_name(beam + 1), "m/s", BEAM, dvl.time_ns, np.nan_to_num(reading), np.array([sd_mps])
        )
        found.append(
            replace(
                one,
                sensor=BEAMS,
                available=np.isfinite(reading[:, 0]),
                gate=gate,
                reopen_after=reopen_after,
                direction_b=dvl.directions_b[beam],
                goes_on=beam < beams - 1,
                holds_height=True,
            )
        )
    return tuple(found)


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
        name="acceleration",
        unit="m/s^2",
        kind=kind,
        sensor=PINGS,
        available=windows.complete,
        valid_ns=velocities.time_ns[:1] + np.round(windows.middle_s * 1e9).astype(np.int64),
        values=windowed_sum(windows.velocity_weights, velocities.velocity_b),
        cov=cov_b,
        gate=gate,
        reopen_after=NEVER_REOPENED,
        velocity_weights=windows.velocity_weights,
        interval_weights=windows.interval_weights,
        axes=("x", "y", "z"),
    )
