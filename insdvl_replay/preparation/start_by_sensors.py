"""What the start takes from other sensors: an attitude where it is asked for; heading and position that are open."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from insdvl_replay.core.config import Config, Heading, Initial
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ReferenceColumns, SensorColumns
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import BY_SENSOR, DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.nav.levelling import Start
from insdvl_replay.preparation.start_position import FAR_S, configured_height_note


@dataclass(frozen=True)
class SensedStart:
    """A start as far as sensors tell it.

    Attributes
    ----------
    config : Config
        With what it left open filled in; it is no surer than the sensors are.
    start_ns : int
        Of the span; of the sensor's first attitude in it, where this is the start.
    mat_nb : ndarray, shape (3, 3), or None
        Attitude there.
    notes : tuple of Note
    told_ns : mapping of str to int
        Times of the readings that this start is made of, by sensor: a filter that is aided by them knows them already.
    is_heading : bool
        Whether its heading is the sensor's.
    fix : ndarray, shape (3,), or None
        That its position is, of the antenna; its height is NaN where it has none, and the configured one counts.
    """

    config: Config
    start_ns: int
    mat_nb: Floats | None
    notes: tuple[Note, ...]
    told_ns: Mapping[str, int]
    is_heading: bool
    fix: Floats | None

    def at_imu(self, start: Start) -> Start:
        """Move a start from the antenna, whose fix its position is, to the IMU; a configured height stays."""
        start = replace(start, is_heading_sensed=self.is_heading)
        if self.fix is None:
            return start
        arm_n = start.mat_nb @ np.array(self.config.position.lever_arm_m)
        moved = moved_position(start.position, -arm_n)
        return replace(start, position=np.where(np.isfinite(self.fix), moved, start.position))


def started_by_sensors(
    config: Config,
    sensors: Mapping[str, SensorColumns],
    reference: ReferenceColumns | None,
    start_ns: int,
    end_ns: int,
) -> SensedStart:
    """Find the attitude where a sensor is to tell it, and fill in heading and position by the readings nearest to it.

    Parameters
    ----------
    sensors : mapping of str to SensorColumns
        Of the dive.
    start_ns, end_ns : int
        Of the span; where filters start from a reference's attitude, this counts and no sensor.

    Raises
    ------
    LogError
        The attitude is to be a sensor's, which gives none in the span; or the heading, which is silent at the start.
    """
    initial, notes, mat_nb, fix, is_heading = config.initial, list[Note](), None, None, False
    told_ns = dict[str, int]()
    posed = initial.source == "reference" and reference is not None and reference.has_attitude
    if initial.source == BY_SENSOR:
        is_heading = not isinstance(initial.heading_deg, float | int)
        start_ns, mat_nb = _attitude(initial, sensors["heading"], start_ns, end_ns, notes)
        initial = _no_surer(initial, config.heading)
    elif not posed and "heading" in sensors and initial.heading_deg in (None, BY_SENSOR):
        initial = _with_heading(initial, sensors["heading"], config.heading.sd_deg, start_ns, notes)
        told_ns["heading"], is_heading = _nearest_ns(sensors["heading"], start_ns), True
    located = reference is not None and reference.has_position
    if not located and "position" in sensors and initial.latitude_deg is None:
        fix, away_s = _nearest(sensors["position"], start_ns)
        initial = _with_position(initial, fix, away_s, config.position.sd_m, notes)
        told_ns["position"] = _nearest_ns(sensors["position"], start_ns)
    config = msgspec.structs.replace(config, initial=initial)
    return SensedStart(config, start_ns, mat_nb, tuple(notes), told_ns, is_heading, fix)


def _attitude(
    initial: Initial, readings: SensorColumns, start_ns: int, end_ns: int, notes: list[Note]
) -> tuple[int, Floats]:
    """Return the first attitude in the span, with the heading of the configuration if it has one, and its time."""
    if readings.mat_nb is None:
        raise LogError(
            'initial.source is "sensor", and the messages of the heading hold no roll and pitch',
            "name heading.roll and heading.pitch, or start level: --set initial.source=level",
        )
    inside = (readings.time_ns >= start_ns) & (readings.time_ns < end_ns)
    rows = np.flatnonzero(inside & np.isfinite(readings.mat_nb).all(axis=(1, 2)))
    if not rows.size:
        raise LogError(
            "the sensor of the heading gives no attitude between the first and the last IMU sample of the span",
            "check heading.stamp against imu.stamp, or widen --start and --end",
        )
    mat_nb, first_ns = readings.mat_nb[rows[0]], int(readings.time_ns[rows[0]])
    roll, pitch, heading = rpy_from_mat(mat_nb)
    if isinstance(initial.heading_deg, float | int):
        heading = initial.heading_deg * DEG
        mat_nb = mat_from_rpy(np.array([roll, pitch, heading]))
    late_s = (first_ns - start_ns) / NS_PER_S
    text = f"roll {roll / DEG:.2f} deg and pitch {pitch / DEG:.2f} deg of the sensor's first attitude"
    text += f", {late_s:.2f} s into the span, at a heading of {heading / DEG % 360.0:.2f} deg"
    notes.append(Note("start_attitude_sensor", text))
    return first_ns, mat_nb


def _no_surer(initial: Initial, sensor: Heading) -> Initial:
    """Widen what is configured to what a sensor's attitude errs by; a heading from elsewhere is as sure as it was."""
    north_deg, east_deg, down_deg = initial.misalignment_sd_deg
    if not isinstance(initial.heading_deg, float | int):
        down_deg = max(down_deg, sensor.sd_deg)
    level_deg = sensor.level_sd_deg
    sds_deg = (max(north_deg, level_deg), max(east_deg, level_deg), down_deg)
    return msgspec.structs.replace(initial, misalignment_sd_deg=sds_deg)


def _with_heading(
    initial: Initial, readings: SensorColumns, sd_deg: float, start_ns: int, notes: list[Note]
) -> Initial:
    values, away_s = _nearest(readings, start_ns)
    if away_s > FAR_S:
        raise LogError(
            f"the reading of the heading that is nearest to the start is {away_s:.1f} s away",
            "--start where there is one, or --set initial.heading_deg=...",
        )
    heading_deg = float(values[0]) / DEG % 360.0
    text = f"heading at the start {heading_deg:.2f} deg, of the sensor's reading {away_s:.2f} s away"
    notes.append(Note("start_heading_sensor", text))
    north_deg, east_deg, down_deg = initial.misalignment_sd_deg
    return msgspec.structs.replace(
        initial, heading_deg=heading_deg, misalignment_sd_deg=(north_deg, east_deg, max(down_deg, sd_deg))
    )


def _with_position(initial: Initial, fix: Floats, away_s: float, sd_m: float, notes: list[Note]) -> Initial:
    latitude, longitude, height_m = fix
    text = f"position at the start by the fix {away_s:.2f} s away"
    severity = Severity.WARNING if away_s > FAR_S else Severity.INFO
    notes.append(Note("start_position_sensor", text, severity=severity))
    if np.isnan(height_m):
        height_m = initial.height_m
        notes.append(configured_height_note(initial))
    north_m, east_m, down_m = initial.position_sd_m
    return msgspec.structs.replace(
        initial,
        latitude_deg=float(latitude) / DEG,
        longitude_deg=float(longitude) / DEG,
        height_m=float(height_m),
        position_sd_m=(max(north_m, sd_m), max(east_m, sd_m), down_m),
    )


def _nearest(readings: SensorColumns, start_ns: int) -> tuple[Floats, float]:
    """Return the reading nearest to a time, and by how many seconds it is away."""
    row = _nearest_row(readings, start_ns)
    return readings.values[row], abs(int(readings.time_ns[row]) - start_ns) / NS_PER_S


def _nearest_ns(readings: SensorColumns, start_ns: int) -> int:
    return int(readings.time_ns[_nearest_row(readings, start_ns)])


def _nearest_row(readings: SensorColumns, start_ns: int) -> int:
    return int(np.argmin(np.abs(readings.time_ns - start_ns)))
