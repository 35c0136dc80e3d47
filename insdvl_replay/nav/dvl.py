"""The DVL: velocities of its beams, accelerations of past velocities, and the measurements that these make.

The four beams of a ping also have redundancy, from which their noise follows without a filter. One combination of four
readings does not depend on the velocity. For a Janus it is half of ``y1 - y2 + y3 - y4``, the manufacturers' error
velocity; its noise is that of one beam.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import DvlColumns, Floats, TimeNs
from insdvl_replay.core.history import Innovations
from insdvl_replay.core.quantities import PARITY, beam_name
from insdvl_replay.geometry.frames import DvlMounting, beam_vectors, solve_beams, whole_ping_cov
from insdvl_replay.nav.measurements import BEAM, VELOCITY, Measurement
from insdvl_replay.nav.timeline import BEAMS


@dataclass(frozen=True)
class DvlVelocities:
    """Velocities over ground, one for each usable ping, in body axes, at the DVL."""

    time_ns: TimeNs  # (m,), times of validity
    velocity_b: Floats  # (m, 3), ``C_d^b v_d``, m/s
    # (m, 3, 3), covariance for noise of unit variance of each beam. A DVL that reports velocities does not report which
    # beams were lost: all its pings count as complete.
    unit_cov_b: Floats
    full_unit_cov_b: Floats  # (3, 3), the same for a ping with all beams
    beams_used: NDArray[np.int64]  # (m,), 3 or 4 for beams; 0 where the DVL reports velocities
    residual_mps: Floats  # (m,), rms of the beams' residuals over their degrees of freedom; NaN without redundancy
    # left out: fewer than three beams, beams in a plane, or an invalid velocity
    pings_without_velocity: int
    pings_with_bad_residual: int  # left out: their beams disagree

    def within(self, start_ns: int, end_ns: int) -> "DvlVelocities":
        """Keep the pings after the start and up to the end."""
        return self.where((self.time_ns > start_ns) & (self.time_ns <= end_ns))

    def where(self, keep: NDArray[np.bool_]) -> "DvlVelocities":
        """Keep some of the pings."""
        columns = ("time_ns", "velocity_b", "unit_cov_b", "beams_used", "residual_mps")
        return replace(self, **{name: getattr(self, name)[keep] for name in columns})


@dataclass(frozen=True)
class DvlBeams:
    """Velocities along the beams, in their directions in body axes."""

    time_ns: TimeNs  # (k,), times of validity of the pings with any beam
    beam_velocity_mps: Floats  # (k, beams), without the scale error; NaN where a beam is lost
    directions_b: Floats  # (beams, 3), unit vectors


def dvl_beams(
    dvl: DvlColumns,
    mounting: DvlMounting,
    start_ns: int,
    end_ns: int,
) -> DvlBeams | None:
    """Return the beams of a DVL after the start and up to the end; None where it reports velocities."""
    if dvl.beam_velocity_mps is None or dvl.beam_vectors_d is None:
        return None
    inside = (dvl.time_ns > start_ns) & (dvl.time_ns <= end_ns)
    valid = np.isfinite(dvl.beam_velocity_mps).any(axis=1) & inside
    velocity_mps = dvl.beam_velocity_mps[valid] / mounting.scale
    return DvlBeams(dvl.time_ns[valid], velocity_mps, dvl.beam_vectors_d @ mounting.mat_bd.T)


def dvl_velocities(
    dvl: DvlColumns, mounting: DvlMounting | None = None, max_residual_mps: float = np.inf
) -> DvlVelocities:
    """Solve the pings for velocities, divide out the scale, and turn them to body axes.

    Parameters
    ----------
    dvl : DvlColumns
        Beams or velocities.
    mounting : DvlMounting, optional
        Left out: the DVL's axes are the body's.
    max_residual_mps : float
        Pings whose beams disagree by more are left out.

    Returns
    -------
    DvlVelocities
        Usable pings only, with the others counted.
    """
    if dvl.velocity_d is not None:
        velocity_d = dvl.velocity_d
        full_unit_cov_d = whole_ping_cov(
            beam_vectors() if dvl.beam_vectors_d is None else dvl.beam_vectors_d
        )
        unit_cov_d = np.broadcast_to(full_unit_cov_d, (len(velocity_d), 3, 3))
        residual_mps = np.full(len(velocity_d), np.nan)
        beams_used = np.zeros(len(velocity_d), dtype=np.int64)
    elif dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        velocity_d, unit_cov_d, residual_mps = solve_beams(
            dvl.beam_velocity_mps, dvl.beam_vectors_d
        )
        full_unit_cov_d = whole_ping_cov(dvl.beam_vectors_d)
        beams_used = np.isfinite(dvl.beam_velocity_mps).sum(axis=1)
    else:
        raise ValueError("a DVL gives beams with their vectors, or velocities")
    mounting = mounting or DvlMounting()
    solved = np.isfinite(velocity_d).all(axis=1)
    bad = solved & (residual_mps > max_residual_mps)
    keep = solved & ~bad
    return DvlVelocities(
        time_ns=dvl.time_ns[keep],
        velocity_b=mounting.velocity_b(velocity_d[keep]),
        unit_cov_b=mounting.mat_bd @ unit_cov_d[keep] @ mounting.mat_bd.T,
        full_unit_cov_b=mounting.mat_bd @ full_unit_cov_d @ mounting.mat_bd.T,
        beams_used=beams_used[keep],
        residual_mps=residual_mps[keep] / mounting.scale,
        pings_without_velocity=int(np.sum(~solved)),
        pings_with_bad_residual=int(np.sum(bad)),
    )


def derivative_weights(offset_s: Floats, order: int) -> Floats:
    """Return the weights that make derivatives of values, ``(L' L)^-1 L'`` with ``L_jk = offset_j^k / k!``.

    Equations (10) to (17) of Levy and Klein. Times of the values are from the time of the expansion, shape (..., n).
    The order of the polynomial is below n. In the result, shape (..., order + 1, n), row k gives the k-th derivative.
    """
    if not 1 <= order < offset_s.shape[-1]:
        raise ValueError(f"order {order} needs a window above it, found {offset_s.shape[-1]}")
    powers = np.arange(order + 1)
    factorials = np.cumprod(np.maximum(powers, 1))
    # keeps powers of long windows near 1
    scale = np.max(np.abs(offset_s), axis=-1)[..., None, None]
    L = (offset_s[..., None] / scale) ** powers / factorials
    weights: Floats = np.linalg.pinv(L) / scale ** powers[:, None]
    return weights


@dataclass(frozen=True)
class SlopeWindows:
    """Windows of consecutive velocities, one ending at each ping, with the weights of their slope."""

    complete: NDArray[np.bool_]  # (m,), False while the window fills, and after a gap
    velocity_weights: Floats  # (m, n), c: slope = sum_j c_j v_j; their sum is 0
    interval_weights: Floats  # (m, n - 1), W: slope = sum_j W_j (v_j - v_(j-1)), j from 1; W_j = sum of c_i for i >= j
    interval_s: Floats  # (m, n - 1), lengths of the intervals
    middle_s: Floats  # (m,), mean time of the window, where the slope is valid


def slope_windows(
    time_s: Floats,
    window: int,
    order: int = 1,
    max_gap_s: float = np.inf,
) -> SlopeWindows:
    """Make the weights for the slope at the middle of each window of past velocities.

    Equations (21) to (23) of Levy and Klein, with the two-row B that they mean; see docs/equations/acceleration.md.

    Parameters
    ----------
    time_s : ndarray, shape (m,)
        Times of the velocities, increasing, at any spacing.
    window : int
        Number n of velocities, 2 or more.
    order : int
        Of the fitted polynomial; the slope is its first derivative at the mean time of the window.
    max_gap_s : float
        A longer pause starts a new window.
    """
    m = len(time_s)
    complete = np.zeros(m, dtype=np.bool_)
    c = np.zeros((m, window))
    interval_s = np.zeros((m, window - 1))
    middle_s = time_s.copy()
    if m >= window:
        times = sliding_window_view(time_s, window)
        interval_s[window - 1 :] = np.diff(times, axis=1)
        complete[window - 1 :] = (interval_s[window - 1 :] <= max_gap_s).all(axis=1)
        middle_s[window - 1 :] = times.mean(axis=1)
        c[window - 1 :] = derivative_weights(times - middle_s[window - 1 :, None], order)[:, 1, :]
    c[~complete] = 0.0
    W = np.cumsum(c[:, ::-1], axis=1)[:, ::-1][:, 1:]
    return SlopeWindows(complete, c, W, interval_s, middle_s)


def windowed_sum(weights: Floats, values: Floats) -> Floats:
    """Sum the values of each window with its weights: ``sum_j weights[k, j] values[k - n + 1 + j]``, shape (m, ...).

    The weights, shape (m, n), are zero where the window is not complete.
    """
    n = weights.shape[1]
    total = np.zeros(values.shape)
    for j in range(n):
        lag = n - 1 - j
        weight = weights[lag:, j].reshape(-1, *[1] * (values.ndim - 1))
        total[lag:] += weight * values[: max(0, len(values) - lag)]
    return total


def velocity_cov(
    velocities: DvlVelocities, sd_mps: float, *, for_one_beam: bool = False
) -> Floats:
    """Return the covariance of each DVL velocity.

    Noise of one beam goes through the least squares: with four beams, tilted by ``a`` from z, the variances in d are
    ``1 / (2 sin^2 a)``, the same again, and ``1 / (4 cos^2 a)`` times a beam's. Else each axis of a velocity from all
    beams has ``sd_mps``, and a velocity from fewer beams is worse by the factor of the least squares.

    Parameters
    ----------
    for_one_beam : bool
        Whether the noise is that of a beam.

    Returns
    -------
    ndarray, shape (m, 3, 3), m^2/s^2
    """
    if for_one_beam:
        return sd_mps**2 * velocities.unit_cov_b
    values, vectors = np.linalg.eigh(velocities.full_unit_cov_b)
    whiten = vectors / np.sqrt(values) @ vectors.T
    cov: Floats = sd_mps**2 * (whiten @ velocities.unit_cov_b @ whiten)
    return cov


def velocity_measurement(velocities: DvlVelocities, cov_b: Floats) -> Measurement:
    """Return the measurement of the DVL's velocity at every ping, with covariances from `velocity_cov`."""
    return Measurement(
        name="velocity",
        unit="m/s",
        kind=VELOCITY,
        valid_ns=velocities.time_ns,
        values=velocities.velocity_b,
        cov=cov_b,
        available=np.ones(len(cov_b), np.bool_),
        axes=("x", "y", "z"),
        holds_height=True,
    )


def beam_measurements(beams: DvlBeams, sd_mps: float) -> list[Measurement]:
    """Return a measurement of each beam, ``beam_1`` and so on, as measurements of one reading, each with its own gate.

    The noise is that of one beam.
    """
    readings = beams.beam_velocity_mps
    count = len(beams.directions_b)
    return [
        Measurement(
            name=beam_name(beam + 1),
            unit="m/s",
            kind=BEAM,
            valid_ns=beams.time_ns,
            values=np.nan_to_num(readings[:, beam : beam + 1]),
            cov=np.full((len(readings), 1, 1), sd_mps * sd_mps),
            available=np.isfinite(readings[:, beam]),
            sensor=BEAMS,
            direction_b=direction_b,
            goes_on=beam < count - 1,
            holds_height=True,
        )
        for beam, direction_b in enumerate(beams.directions_b)
    ]


def acceleration_measurement(
    velocities: DvlVelocities,
    velocity_cov_b: Floats,
    windows: SlopeWindows,
    *,
    kind: int,
    sd_mps2: float | None,
    accel_white_mps_rts: float,
) -> Measurement:
    """Return the measurement of the slope of past DVL velocities, `PUBLISHED` or `WINDOWED`.

    Parameters
    ----------
    velocity_cov_b : ndarray, shape (m, 3, 3)
        From `velocity_cov`.
    sd_mps2 : float or None
        Standard deviation on each axis; None takes the DVL's noise through the fit plus the accelerometer's through the
        prediction, ``R_a = sum c_j^2 R_j + N_a^2 sum W_j^2 dt_j``.
    accel_white_mps_rts : float
        White noise of the accelerometers, m/s/sqrt(s).
    """
    if sd_mps2 is not None:
        cov_b = np.broadcast_to(sd_mps2**2 * np.eye(3), velocity_cov_b.shape)
    else:
        predicted_var = accel_white_mps_rts**2 * np.sum(
            windows.interval_weights**2 * windows.interval_s, axis=1
        )
        fitted_cov = windowed_sum(windows.velocity_weights**2, velocity_cov_b)
        cov_b = fitted_cov + predicted_var[:, None, None] * np.eye(3)
    return Measurement(
        name="acceleration",
        unit="m/s^2",
        kind=kind,
        valid_ns=velocities.time_ns[:1] + np.round(windows.middle_s * 1e9).astype(np.int64),
        values=windowed_sum(windows.velocity_weights, velocities.velocity_b),
        cov=cov_b,
        available=windows.complete,
        axes=("x", "y", "z"),
        velocity_weights=windows.velocity_weights,
        interval_weights=windows.interval_weights,
    )


def parity_innovations(beams: DvlBeams, sd_mps: float) -> tuple[Innovations, ...]:
    """Return the parity of each ping with four beams, as an innovation that no filter predicted; else nothing.

    With fewer beams there is no redundancy. With more, one number does not describe it.

    Parameters
    ----------
    sd_mps : float
        Noise of one beam in the settings.
    """
    if len(beams.directions_b) != 4:
        return ()
    blind = np.linalg.svd(beams.directions_b.T)[2][-1]
    whole = np.isfinite(beams.beam_velocity_mps).all(axis=1)
    parity_mps = np.sum(beams.beam_velocity_mps[whole] * blind, axis=1) * np.sign(blind[0])
    count = int(whole.sum())
    time_ns = beams.time_ns[whole]
    sd = np.full((count, 1), sd_mps)
    no = np.zeros(count, np.bool_)
    return (
        Innovations(
            measurement=PARITY,
            unit="m/s",
            axes=(),
            time_ns=time_ns,
            valid_ns=time_ns,
            measured=parity_mps[:, None],
            innovation=parity_mps[:, None],
            sd=sd,
            nis=(parity_mps / sd_mps) ** 2,
            used=~no,
            log_det=np.full(count, 2.0 * np.log(sd_mps)),
            gate=np.inf,
            reopen_after=0,
            reopened=no,
        ),
    )
