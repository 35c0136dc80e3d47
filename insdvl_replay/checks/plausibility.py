"""Whether the columns of a dive can be what the log says: each sensor by itself, and all of them together.

What would make the tables wrong ends the work with the key that puts it right; what may make them wrong is a warning.
"""

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import COHERENT, INCOHERENT, SCALE_DOUBT, dvl_checks, scale_notes
from insdvl_replay.checks.dvl_comparison import TrackFit, track_by_positions
from insdvl_replay.checks.gyro_comparison import AttitudeFit, gyro_by_attitude, gyro_by_gravity
from insdvl_replay.checks.imu import AXES, Check, imu_checks
from insdvl_replay.checks.reference import reference_checks
from insdvl_replay.core.columns import DvlColumns, ImuColumns, ReferenceColumns
from insdvl_replay.core.config import Config, Imu, Initial
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import wrap_angle

UNIT_WRONG: Final = 5.0
"""Factor of the angular rate at which it is another unit: deg/s are 57 times rad/s."""
TRACK_DOUBT: Final = 0.15
"""The same for gyros seen through a track, whose DVL and positions have errors of their own."""
TILT_DOUBT: Final = 0.7
"""The same for gyros seen by gravity, to which a moving vehicle adds its own acceleration."""
AXIS_AGAINST: Final = 0.7
"""Correlation about one axis, of the opposite sign, that is no noise."""
LEAST_EXCURSION: Final = 3.0 * DEG
"""Attitudes of a vehicle that turns less cannot check its gyros."""
HEADING_DOUBT: Final = 30.0 * DEG
"""Beyond what gyro bias turns a track during a dive."""


@dataclass(frozen=True)
class GyroScale:
    """How the gyros compare with what others show.

    Attributes
    ----------
    scale : float
        Angular rate measured over true.
    by : str
        The source of the comparison.
    tolerance : float
        Factor up to which it is in order.
    """

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
    """List what has to be looked at in the columns of a dive.

    Parameters
    ----------
    place : str
        The file, for messages to the user.

    Returns
    -------
    tuple of Check
        They find what cannot be: each note says how often, since when, and which key helps.
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
    """Compare the gyros with whoever knows their scale best.

    Parameters
    ----------
    imu, dvl, reference, config
        As of `plausibility_checks`.

    Returns
    -------
    GyroScale or None
        None where the vehicle moved too little for it.
    """
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
    """Return the scale of the gyros by the best source that there is."""
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
    if initial.heading_deg is None:
        return []
    if abs(float(wrap_angle(np.asarray(initial.heading_deg * DEG - heading)))) <= HEADING_DOUBT:
        return []
    text = (
        f"the DVL's track fits the reference's positions with a heading of {heading / DEG:.0f} deg at the start, "
        f"and {initial.heading_deg:g} deg are configured, from the first ping on"
    )
    hint = f"initial.heading_deg = {heading / DEG:.0f}, or dvl.mounting_rpy_deg where the heading is known"
    return [Note("dvl_direction", text, len(dvl.time_ns), Severity.WARNING, hint)]
