"""Whether the columns of a dive can be what the log says: each sensor by itself, and all of them together.

What would make the tables wrong ends the work with the key that puts it right; what may make them wrong is a warning.
Where a reference has positions alone, they are compared with the track that gyros and DVL make together.
"""

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.dvl import (
    COHERENT,
    INCOHERENT,
    SCALE_DOUBT,
    Fit,
    dvl_checks,
    fit,
    scale_notes,
    velocities_b,
)
from insdvl_replay.checks.imu import (
    AXES,
    ENOUGH,
    LONGEST_STEP_S,
    AttitudeFit,
    Check,
    gyro_by_attitude,
    gyro_by_gravity,
    imu_checks,
    lies_within,
    turned_by,
)
from insdvl_replay.checks.reference import reference_checks
from insdvl_replay.core.config import Config, Imu, Initial
from insdvl_replay.core.dive_columns import (
    DvlColumns,
    Floats,
    ImuColumns,
    ReferenceColumns,
    TimeNs,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG, DEG_PER_HOUR
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import Complex, horizontal, north_east_m
from insdvl_replay.geometry.rotation import wrap_angle

_TRACK_WINDOW_S: Final = 10.0
_LEAST_WINDOW_M: Final = 3.0  # above the noise of a satellite fix
_LEAST_TRACK_TURN: Final = np.pi / 2.0
_CLEARLY: Final = 2.0  # another scale of the gyros has to halve what a scale of 1 leaves unexplained
_SCALES: Final = np.concatenate([[DEG], np.geomspace(0.3, 3.0, 93), [1.0 / DEG]])


@dataclass(frozen=True)
class TrackFit:
    """How the track of gyros and DVL follows the positions.

    Scales are measured over true, that of the gyros None where the vehicle turned too little to tell; the heading is
    that at the start of the replay, rad.
    """

    gyro_scale: float | None
    dvl_scale: float
    heading: float
    coherence: float


def track_by_positions(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns, config: Config
) -> TrackFit | None:
    """Fit the track of gyros and DVL to positions, by the scale of the gyros at which it follows them best."""
    ping_ns, measured_b = velocities_b(dvl, config)
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
    heard = np.searchsorted(pauses_ns, fix_ns[first]) == np.searchsorted(pauses_ns, fix_ns[last])
    close = fix_ns[last] - fix_ns[first] < nanoseconds(2.0 * _TRACK_WINDOW_S)
    return first[heard & close], last[heard & close]


def _travelled_m(ping_ns: TimeNs, velocity: Complex, at_ns: TimeNs) -> Complex:
    ping_s = seconds(ping_ns, ping_ns[0])
    way_m = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(ping_s))])
    return np.asarray(np.interp(seconds(at_ns, ping_ns[0]), ping_s, way_m))


UNIT_WRONG: Final = 5.0
"""Factor of the angular rate at which it is another unit: deg/s are 57 times rad/s."""
TRACK_DOUBT: Final = 0.15
"""The same for gyros seen through a track, whose DVL and positions have errors of their own."""
TILT_DOUBT: Final = 0.7
"""The same for gyros seen by gravity, which in a moving vehicle swings with its own acceleration."""
AXIS_AGAINST: Final = 0.7
"""Correlation about one axis, of the opposite sign, that is no noise."""
LEAST_EXCURSION: Final = 3.0 * DEG
"""Attitudes of a vehicle that swings less are no witness against its gyros."""
HEADING_DOUBT: Final = 30.0 * DEG
"""Beyond what gyro bias turns a track during a dive."""


@dataclass(frozen=True)
class GyroScale:
    """How the gyros compare with what others show: measured over true, and the factor up to which it is in order."""

    scale: float
    by: str
    tolerance: float

    @property
    def off(self) -> float:
        """Factor by which the scale is off, 1 or more; infinite where the sign is wrong."""
        return max(self.scale, 1.0 / self.scale) if self.scale > 0.0 else np.inf


def plausibility_checks(
    place: str, imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config
) -> tuple[Check, ...]:
    """List what has to be looked at in the columns of a dive, whose file is the place in messages to the user.

    What is found, a note each, says how often, since when, and which key helps.
    """
    by_attitude, track = _comparisons(imu, dvl, reference, config)
    return (
        *imu_checks(place, imu, reference, config.imu),
        partial(_gyro_notes, place, imu, _best_scale(imu, by_attitude, track), config.imu),
        partial(_attitude_notes, imu, by_attitude),
        *dvl_checks(place, dvl, reference, config),
        *(reference_checks(imu, dvl, reference) if reference is not None else ()),
        partial(_track_notes, place, track, dvl, config),
    )


def plausibility_notes(
    place: str, imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Look for what cannot be in the columns of a dive, and stop at the first thing that would make the tables wrong.

    Parameters
    ----------
    place, imu, dvl, reference, config
        As of `plausibility_checks`.

    Raises
    ------
    LogError
        The IMU is too slow, dead, or in another unit than the configuration says.
    """
    return tuple(note for check in plausibility_checks(place, imu, dvl, reference, config) for note in check())


def gyro_scale(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config
) -> GyroScale | None:
    """Compare the gyros with whoever knows their scale best; None where the vehicle moved too little to tell."""
    return _best_scale(imu, *_comparisons(imu, dvl, reference, config))


def _comparisons(
    imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config
) -> tuple[AttitudeFit | None, TrackFit | None]:
    if reference is None:
        return None, None
    complete = reference.has_attitude and reference.has_velocity
    track = None if complete else track_by_positions(imu, dvl, reference, config)
    return gyro_by_attitude(imu, reference), track


def _best_scale(imu: ImuColumns, by_attitude: AttitudeFit | None, track: TrackFit | None) -> GyroScale | None:
    """Ask for the scale of the gyros whoever knows it best."""
    if by_attitude is not None and abs(by_attitude.correlation) > COHERENT:
        return GyroScale(by_attitude.scale, "the reference's attitude", 1.0 + SCALE_DOUBT)
    if track is not None and track.gyro_scale is not None and track.coherence > COHERENT:
        return GyroScale(track.gyro_scale, "the DVL's track against the reference's positions", 1.0 + TRACK_DOUBT)
    by_gravity = gyro_by_gravity(imu)
    return GyroScale(by_gravity, "the swing of gravity", 1.0 + TILT_DOUBT) if by_gravity is not None else None


def _gyro_notes(place: str, imu: ImuColumns, found: GyroScale | None, settings: Imu) -> list[Note]:
    if found is None or found.off < found.tolerance:
        return []
    text = f"the angular rate is {found.scale:.3g} times what {found.by} shows, from 0 s on"
    if found.scale < 0.0:
        hint = 'imu.axes = "flu" turns y and z, and imu.specific_force_axes names those of the force where they differ'
        return [Note("imu_gyro_sign", text, len(imu.time_ns), Severity.WARNING, hint)]
    if found.scale > UNIT_WRONG:
        raise LogError(text, 'imu.angular_rate_unit = "deg/s"', place)
    if found.scale < 1.0 / UNIT_WRONG:
        raise LogError(text, 'imu.angular_rate_unit = "rad/s"', place)
    hint = f"imu.angular_rate_scale = {found.scale * settings.angular_rate_scale:.3g}"
    return [Note("imu_gyro_scale", text, len(imu.time_ns), Severity.WARNING, hint)]


def _attitude_notes(imu: ImuColumns, by_attitude: AttitudeFit | None) -> list[Note]:
    if by_attitude is None or by_attitude.excursion.max() < LEAST_EXCURSION:
        return []
    if abs(by_attitude.correlation) >= INCOHERENT:
        return _axis_notes(imu, by_attitude)
    text = (
        "the angular rate does not follow the change of the reference's attitude, from 0 s on "
        f"(correlation {by_attitude.correlation:.2f})"
    )
    hint = "imu.axes, reference.axes, or imu.stamp and reference.stamp"
    return [Note("imu_gyro_contradiction", text, len(imu.time_ns), Severity.WARNING, hint)]


def _axis_notes(imu: ImuColumns, by_attitude: AttitudeFit) -> list[Note]:
    """Find axes that turn the other way while another one follows the reference."""
    known = by_attitude.excursion >= LEAST_EXCURSION
    if not np.any(known & (by_attitude.by_axis > AXIS_AGAINST)):
        return []
    axes = np.flatnonzero(known & (by_attitude.by_axis < -AXIS_AGAINST)).tolist()
    return [
        Note(
            "imu_gyro_axis",
            f"the angular rate {AXES[axis]} turns against the reference's attitude, from 0 s on "
            f"(correlation {by_attitude.by_axis[axis]:.2f}), while another axis follows it",
            len(imu.time_ns),
            Severity.WARNING,
            "imu.axes, or imu.angular_rate names the fields in another order",
        )
        for axis in axes
    ]


def _track_notes(place: str, track: TrackFit | None, dvl: DvlColumns, config: Config) -> list[Note]:
    if track is None:
        return []
    if track.coherence < INCOHERENT:
        text = (
            "the track of gyros and DVL does not follow the reference's positions, "
            f"whatever the heading and the scales, from the first ping on (coherence {track.coherence:.2f})"
        )
        hint = "initial.gyro_bias_degph, imu.axes, dvl.mounting_rpy_deg, or another imu.topic"
        return [Note("track_contradiction", text, len(dvl.time_ns), Severity.WARNING, hint)]
    if track.coherence < COHERENT:
        return []
    return [*scale_notes(place, track.dvl_scale, dvl, config), *_heading_notes(track.heading, dvl, config.initial)]


def _heading_notes(heading: float, dvl: DvlColumns, initial: Initial) -> list[Note]:
    if not isinstance(initial.heading_deg, float | int):
        return []
    if abs(float(wrap_angle(np.asarray(initial.heading_deg * DEG - heading)))) <= HEADING_DOUBT:
        return []
    text = (
        f"the DVL's track fits the reference's positions with a heading of {heading / DEG:.0f} deg at the start, "
        f"and {initial.heading_deg:g} deg are configured, from the first ping on"
    )
    hint = f"initial.heading_deg = {heading / DEG:.0f}, or dvl.mounting_rpy_deg where the heading is known"
    return [Note("dvl_direction", text, len(dvl.time_ns), Severity.WARNING, hint)]
