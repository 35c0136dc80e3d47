"""The DVL against the reference: its velocity in body axes, or, where there are positions alone, its track.

The track is made by gyros and DVL together. Horizontal vectors are complex numbers: forward or north, plus i times
starboard or east.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.gyro_comparison import ENOUGH, LONGEST_STEP_S, lies_within, turned_by
from insdvl_replay.core.columns import DvlColumns, Floats, ImuColumns, ReferenceColumns, TimeNs, nanoseconds, seconds
from insdvl_replay.core.config import Config
from insdvl_replay.core.states import DEG, DEG_PER_HOUR
from insdvl_replay.geometry.beams import DvlMounting, solve_beams
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.geometry.rotation import wrap_angle

_LEAST_SPEED_MPS: Final = 0.2  # above a DVL's noise and the velocity of a lever arm
_LEAST_VARIATION_MPS: Final = 0.015  # below it a DVL shows its noise
_TRACK_WINDOW_S: Final = 10.0
_LEAST_WINDOW_M: Final = 3.0  # above the noise of a satellite fix
_LEAST_TRACK_TURN: Final = np.pi / 2.0
_CLEARLY: Final = 2.0  # another scale of the gyros has to halve what a scale of 1 leaves unexplained
_SCALES: Final = np.concatenate([[DEG], np.geomspace(0.3, 3.0, 93), [1.0 / DEG]])

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Fit:
    """How one series of horizontal vectors follows another.

    Attributes
    ----------
    scale : float
        Length of the first over the second.
    turn : float
        Angle by which the first is turned from the second, towards starboard, rad.
    coherence : float
        1 where the first is the second turned and scaled, 0 where they have nothing to do with each other.
    """

    scale: float
    turn: float
    coherence: float


@dataclass(frozen=True)
class TrackFit:
    """How the track of gyros and DVL follows the positions.

    Attributes
    ----------
    gyro_scale : float or None
        Measured over true; None where the vehicle turned too little for it.
    dvl_scale : float
        Measured over true.
    heading : float
        At the start of the replay, rad.
    coherence : float
        As of `Fit`.
    """

    gyro_scale: float | None
    dvl_scale: float
    heading: float
    coherence: float


def fit(measured: Complex, true: Complex) -> Fit:
    """Fit ``measured = scale exp(i turn) true`` by least squares.

    Parameters
    ----------
    measured, true : ndarray of complex, shape (k,)
    """
    product = complex(np.vdot(true, measured))
    power, other_power = float(np.vdot(true, true).real), float(np.vdot(measured, measured).real)
    if not power or not other_power:
        return Fit(0.0, 0.0, 0.0)
    return Fit(abs(product) / power, float(np.angle(product)), abs(product) / float(np.sqrt(power * other_power)))


def dvl_by_velocity(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> Fit | None:
    """Compare the DVL's horizontal velocity in body axes with the reference's.

    Parameters
    ----------
    config : Config
        Mounting rotation and scale of the DVL.

    Returns
    -------
    Fit or None
        None where too few rows move, or lack velocity or attitude.
    """
    measured_b, true_b = _velocity_pairs(dvl, reference, config)
    measured, true = horizontal(measured_b), horizontal(true_b)
    moving = np.abs(true) > _LEAST_SPEED_MPS
    return fit(measured[moving], true[moving]) if np.count_nonzero(moving) >= ENOUGH else None


def axes_by_velocity(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> Floats:
    """Correlate the DVL's velocity with the reference's along each axis of the body.

    Parameters
    ----------
    dvl, reference, config
        As of `dvl_by_velocity`.

    Returns
    -------
    ndarray, shape (3,)
        NaN along axes on which the velocity changes too little to tell.
    """
    measured_b, true_b = _velocity_pairs(dvl, reference, config)
    found = np.full(3, np.nan)
    if len(true_b) < ENOUGH:
        return found
    for axis in np.flatnonzero((true_b.std(axis=0) > _LEAST_VARIATION_MPS) & (measured_b.std(axis=0) > 0.0)):
        found[axis] = np.corrcoef(measured_b[:, axis], true_b[:, axis])[0, 1]
    return found


def track_by_positions(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns, config: Config
) -> TrackFit | None:
    """Fit the track of gyros and DVL to positions, by the scale of the gyros at which it follows them best."""
    ping_ns, measured_b = _pings(dvl, config)
    measured = horizontal(measured_b)
    fixes = np.flatnonzero(np.isfinite(reference.position[:, :2]).all(axis=1))
    if len(ping_ns) < ENOUGH or len(fixes) < ENOUGH:
        return None
    fixes = fixes[lies_within(reference.time_ns[fixes], ping_ns)]
    fix_ns, fixes_m = reference.time_ns[fixes], _track_m(reference.position[fixes])
    first, last = _windows(fix_ns, ping_ns)
    true = fixes_m[last] - fixes_m[first]
    if len(first) < ENOUGH or np.sqrt(np.mean(np.abs(true) ** 2)) < _LEAST_WINDOW_M:
        return None
    start_s = config.span.start_s or 0.0
    at_s = np.concatenate([[start_s], seconds(ping_ns, imu.time_ns[0])])
    start_yaw, *yaw = turned_by(imu, at_s)[:, 2] - config.initial.gyro_bias_degph[2] * DEG_PER_HOUR * at_s
    turned = np.array(yaw)

    def fitted(gyro_scale: float) -> Fit:
        track = _travelled_m(ping_ns, measured * np.exp(1j * turned / gyro_scale), fix_ns)
        return fit(track[last] - track[first], true)

    turns = float(np.ptp(turned)) > _LEAST_TRACK_TURN
    gyro_scale, best = 1.0, fitted(1.0)
    if turns:
        other = max(_SCALES.tolist(), key=lambda scale: fitted(scale).coherence)
        if 1.0 - fitted(other).coherence < (1.0 - best.coherence) / _CLEARLY:
            gyro_scale, best = other, fitted(other)
    heading = float(wrap_angle(np.asarray(start_yaw / gyro_scale - best.turn)))
    return TrackFit(gyro_scale if turns else None, best.scale, heading, best.coherence)


def _velocity_pairs(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> tuple[Floats, Floats]:
    """Return the velocities of DVL and reference in body axes, at times of the reference that have both."""
    ping_ns, measured_b = _pings(dvl, config)
    complete = np.isfinite(reference.velocity_n).all(axis=1) & np.isfinite(reference.mat_nb).all(axis=(1, 2))
    if len(ping_ns) < ENOUGH:
        return np.empty((0, 3)), np.empty((0, 3))
    rows = np.flatnonzero(complete & lies_within(reference.time_ns, ping_ns))
    rows = rows[_pause_s(ping_ns, reference.time_ns[rows]) <= LONGEST_STEP_S]
    true_b = np.einsum("kji,kj->ki", reference.mat_nb[rows], reference.velocity_n[rows])
    at_s, ping_s = seconds(reference.time_ns[rows], ping_ns[0]), seconds(ping_ns, ping_ns[0])
    return np.stack([np.interp(at_s, ping_s, column) for column in measured_b.T], axis=1), true_b


def horizontal(vectors: Floats) -> Complex:
    """Make complex numbers of the first two parts of vectors, shape (k, 3)."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def _pings(dvl: DvlColumns, config: Config) -> tuple[TimeNs, Floats]:
    """Return the velocities in body axes of the pings that have a velocity or all beams."""
    if dvl.velocity_d is not None:
        velocity_d = dvl.velocity_d
    elif dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        velocity_d = solve_beams(dvl.beam_velocity_mps, dvl.beam_vectors_d)[0]
        velocity_d[~np.isfinite(dvl.beam_velocity_mps).all(axis=1)] = np.nan
    else:
        raise ValueError("a DVL gives beams with their vectors, or velocities")
    good = np.isfinite(velocity_d).all(axis=1)
    mounting = DvlMounting.of(config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale)
    return dvl.time_ns[good], mounting.velocity_b(velocity_d[good])


def _pause_s(time_ns: TimeNs, at_ns: TimeNs) -> Floats:
    """Return the length of the step of ``time_ns`` in which each time lies."""
    after = np.clip(np.searchsorted(time_ns, at_ns), 1, len(time_ns) - 1)
    return seconds(time_ns[after], time_ns[after - 1])


def _track_m(position: Floats) -> Complex:
    """Measure along the plane that touches the Earth at the first position."""
    north_m, east_m = north_east_m(position, position[0], position[0])
    return np.asarray(north_m + 1j * east_m)


def _windows(fix_ns: TimeNs, ping_ns: TimeNs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair fixes that lie a window apart, without a long pause of the pings between them."""
    last = np.searchsorted(fix_ns, fix_ns + nanoseconds(_TRACK_WINDOW_S))
    first = np.flatnonzero(last < len(fix_ns))
    last = last[first]
    pauses_ns = ping_ns[1:][np.diff(ping_ns) > nanoseconds(LONGEST_STEP_S)]
    unbroken = np.searchsorted(pauses_ns, fix_ns[first]) == np.searchsorted(pauses_ns, fix_ns[last])
    close = fix_ns[last] - fix_ns[first] < nanoseconds(2.0 * _TRACK_WINDOW_S)
    return first[unbroken & close], last[unbroken & close]


def _travelled_m(ping_ns: TimeNs, velocity: Complex, at_ns: TimeNs) -> Complex:
    ping_s = seconds(ping_ns, ping_ns[0])
    way_m = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(ping_s))])
    return np.asarray(np.interp(seconds(at_ns, ping_ns[0]), ping_s, way_m))
