"""Where and how the filters start (``[initial]``): by the reference, other sensors, gravity, or as configured."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.config_file import check_start, start_latitude_deg
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    ReferenceColumns,
    SensorColumns,
    apart_s,
    at_time,
    seconds,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import BA, BG, BY_SENSOR, DEG, DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, wrap_angle
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.levelling import (
    FEWEST_SAMPLES,
    LEVELLING_S,
    Level,
    Start,
    find_level,
    levelling_samples,
    start_cov,
)
from insdvl_replay.preparation.filters import resolve_filters

FAR_S: Final = 1.0  # what is further from the start than this says little about it: a vehicle moves on
HEADING_DOUBT: Final = 10.0 * DEG  # no compass of a vehicle errs by more, even with the declination left in
IDLE_HEADING_DOUBT: Final = 5.0 * DEG  # a heading that somebody read off a compass, or a plan, is as near as this
TILT_DOUBT: Final = 5.0 * DEG  # no AHRS errs by more, nor do accelerometers
LATITUDE_DOUBT_DEG: Final = 0.1  # a latitude that a user gives in round numbers is as near as this


@dataclass(frozen=True)
class Alignment:
    """The start of a replay: when, with which state and uncertainty, and what was assumed."""

    start_ns: int
    start: Start
    notes: tuple[Note, ...]
    initial: Initial | None = None  # the settings, with what other sensors filled in
    used_ns: Mapping[str, int] = field(default_factory=dict)  # by sensor, the time of the reading that the start took

    @property
    def row(self) -> ReferenceColumns:
        """The start as a reference of one row."""
        start = self.start
        return ReferenceColumns(
            np.array([self.start_ns]), start.position[None], start.velocity_n[None], start.mat_nb[None]
        )


def align(dive: Dive, config: Config, velocities: DvlVelocities, start_ns: int, end_ns: int) -> Alignment:
    """Find the start of the filters in a span: the first attitude of the reference or the AHRS, else its first sample.

    What the reference lacks comes from other sensors, from gravity (roll, pitch), from the DVL (velocity) and from the
    settings (heading, position), each with a note. Started level or by an AHRS, the reference gives the position alone.
    """
    imu, reference, initial, notes = dive.imu, dive.reference, config.initial, list[Note]()
    used_ns, is_located = dict[str, int](), reference is not None and reference.has_position
    moving = reference if initial.source == "reference" else None
    posed = moving if moving is not None and moving.has_attitude else None
    heading_deg = initial.heading_deg if isinstance(initial.heading_deg, float | int) else None
    sensed_mat_nb, is_heading_sensed, fix = None, False, None

    # Other sensors: a whole attitude where it is asked for; heading and position where they are open.
    if initial.source == BY_SENSOR:
        is_heading_sensed = heading_deg is None
        start_ns, sensed_mat_nb, note = _sensor_attitude(dive.sensors["heading"], heading_deg, start_ns, end_ns)
        level_deg, sd_deg = config.heading.level_sd_deg, config.heading.sd_deg if is_heading_sensed else 0.0
        initial = _no_surer(initial, level_deg, sd_deg)
        notes.append(note)
    elif posed is None and "heading" in dive.sensors and initial.heading_deg in (None, BY_SENSOR):
        values, used_ns["heading"], away_s = _nearest(dive.sensors["heading"], start_ns)
        if away_s > FAR_S:
            raise LogError(
                f"the reading of the heading that is nearest to the start is {away_s:.1f} s away",
                "--start where there is one, or --set initial.heading_deg=...",
            )
        heading_deg, is_heading_sensed = float(values[0]) / DEG % 360.0, True
        initial = _no_surer(changed(initial, heading_deg=heading_deg), 0.0, config.heading.sd_deg)
        text = f"heading at the start {heading_deg:.2f} deg, of the sensor's reading {away_s:.2f} s away"
        notes.append(Note("start_heading_sensor", text))
    if not is_located and "position" in dive.sensors and initial.latitude_deg is None:
        fix, used_ns["position"], away_s = _nearest(dive.sensors["position"], start_ns)
        severity = Severity.WARNING if away_s > FAR_S else Severity.INFO
        text = f"position at the start by the fix {away_s:.2f} s away"
        notes.append(Note("start_position_sensor", text, severity=severity))
        if np.isnan(fix[2]):
            notes.append(_configured_height_note(initial))
        (latitude, longitude, height_m), sd_m = fix.tolist(), config.position.sd_m
        north_m, east_m, down_m = initial.position_sd_m
        initial = changed(
            initial,
            latitude_deg=latitude / DEG,
            longitude_deg=longitude / DEG,
            height_m=initial.height_m if np.isnan(height_m) else height_m,
            position_sd_m=(max(north_m, sd_m), max(east_m, sd_m), down_m),
        )
    check_start(
        initial,
        has_reference=reference is not None,
        has_position=is_located,
        has_attitude=reference is not None and reference.has_attitude,
        has_heading=sensed_mat_nb is not None,
    )

    # Time and position.
    if posed is not None:
        start_ns = _first_attitude_ns(posed, start_ns, end_ns)
    if reference is not None and is_located:
        position, found = _reference_position(reference, initial, start_ns)
        notes += found
    else:
        latitude_deg = start_latitude_deg(initial)
        position = np.array([latitude_deg * DEG, initial.longitude_deg * DEG, initial.height_m])
        if fix is None:
            text = f"started at the configured latitude {latitude_deg:g} deg"
            notes.append(Note("start_position_configured", text))

    # Attitude.
    arm_b = np.array(config.dvl.lever_arm_m)
    accel_bias_b, gyro_bias_b = np.array(initial.accel_bias_mg) * MG, np.array(initial.gyro_bias_degph) * DEG_PER_HOUR
    level, samples = None, levelling_samples(imu, start_ns)
    if posed is not None:
        mat_nb = posed.mat_nb[np.searchsorted(posed.time_ns, start_ns)]
    elif sensed_mat_nb is not None and len(samples.time_ns) < FEWEST_SAMPLES:
        mat_nb = sensed_mat_nb
    else:
        if len(samples.time_ns) < FEWEST_SAMPLES:
            raise LogError(
                f"only {len(samples.time_ns)} IMU samples without a pause lie in the {LEVELLING_S:g} s after the "
                "start, too few to find the level",
                "choose another --start",
            )
        if sensed_mat_nb is None and heading_deg is None:
            raise ValueError("the heading is still to be fitted: run.prepare_with_heading does it")
        heading = (heading_deg or 0.0) * DEG if sensed_mat_nb is None else float(rpy_from_mat(sensed_mat_nb)[2])
        unbiased = replace(
            samples,
            specific_force_b=samples.specific_force_b - accel_bias_b,
            angular_rate_b=samples.angular_rate_b - gyro_bias_b,
        )
        noise = resolve_filters(config)[0].sensor_noise(velocities)
        level = find_level(unbiased, velocities, noise, arm_b, start_ns, heading=heading, latitude=float(position[0]))
        mat_nb = mat_from_rpy(np.array([*level.roll_pitch, heading])) if sensed_mat_nb is None else sensed_mat_nb

    # Velocity: the reference's, else that of the nearest ping; after levelling, of the first, carried to the start.
    velocity_n, dvl_velocity_n = None, None
    if moving is not None and apart_s(moving.time_ns, moving.velocity_n, np.array([start_ns]))[0] <= FAR_S:
        velocity_n = at_time(moving.time_ns, moving.velocity_n, start_ns)
    else:
        if level is not None and level.pings:
            velocity_b = level.velocity_b
            away_s = float(seconds(velocities.time_ns[velocities.time_ns >= start_ns][:1], start_ns)[0])
        else:
            nearest = int(np.argmin(np.abs(velocities.time_ns - start_ns)))
            ping_ns = int(velocities.time_ns[nearest])
            rate_ib_b = at_time(imu.time_ns, imu.angular_rate_b, ping_ns) - gyro_bias_b
            rate_eb_b = rate_ib_b - mat_nb.T @ earth_rate_n(position[0])
            velocity_b, away_s = (
                velocities.velocity_b[nearest] - np.cross(rate_eb_b, arm_b),
                abs(ping_ns - start_ns) * 1e-9,
            )
        velocity_n = dvl_velocity_n = mat_nb @ velocity_b
        notes.append(Note("start_velocity_dvl", f"velocity at the start from the DVL's ping {away_s:.2f} s away"))
    cov = start_cov(initial_sd(initial), mat_nb, level if sensed_mat_nb is None else None, dvl_velocity_n)

    # What does not fit together. A configured height stays; the rest of a fix moves from the antenna to the IMU.
    if level is not None:
        notes += _level_notes(level, mat_nb, cov) if sensed_mat_nb is None else _tilt_notes(level, mat_nb)
    if posed is None:
        notes += _heading_notes(reference, mat_nb, start_ns)
    elif heading_deg is not None:
        theirs = rpy_from_mat(mat_nb)[2]
        if abs(float(wrap_angle(np.asarray(heading_deg * DEG - theirs)))) > IDLE_HEADING_DOUBT:
            hint = 'leave initial.heading_deg out, or initial.source = "level" to start from it'
            shown = f"{theirs / DEG % 360.0:.1f} deg"
            notes.append(_idle_note("start_heading_idle", "heading_deg", heading_deg, shown, hint))
    if fix is not None:
        moved = moved_position(position, -(mat_nb @ np.array(config.position.lever_arm_m)))
        position = np.where(np.isfinite(fix), moved, position)
    start = Start(position, velocity_n, mat_nb, cov, accel_bias_b, gyro_bias_b, is_heading_sensed=is_heading_sensed)
    return Alignment(start_ns, start, tuple(notes), initial, used_ns)


def initial_sd(initial: Initial) -> Floats:
    """Return the initial standard deviations of the 12 error states, shape (12,), SI units."""
    sd = np.empty(12)
    sd[DV] = initial.velocity_sd_mps
    sd[PHI] = np.array(initial.misalignment_sd_deg) * DEG
    sd[BA] = initial.accel_bias_sd_mg * MG
    sd[BG] = initial.gyro_bias_sd_degph * DEG_PER_HOUR
    return sd


def _no_surer(initial: Initial, level_deg: float, heading_deg: float) -> Initial:
    """Widen the configured standard deviations of roll, pitch and heading to those of a sensor."""
    north_deg, east_deg, down_deg = initial.misalignment_sd_deg
    sd_deg = max(north_deg, level_deg), max(east_deg, level_deg), max(down_deg, heading_deg)
    return changed(initial, misalignment_sd_deg=sd_deg)


def _sensor_attitude(
    readings: SensorColumns, heading_deg: float | None, start_ns: int, end_ns: int
) -> tuple[int, Floats, Note]:
    """Return time and value of the AHRS's first attitude in the span; a configured heading replaces its own."""
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
    if heading_deg is not None:
        heading = heading_deg * DEG
        mat_nb = mat_from_rpy(np.array([roll, pitch, heading]))
    text = (
        f"roll {roll / DEG:.2f} deg and pitch {pitch / DEG:.2f} deg of the sensor's first attitude, "
        f"{(first_ns - start_ns) / NS_PER_S:.2f} s into the span, at a heading of {heading / DEG % 360.0:.2f} deg"
    )
    return first_ns, mat_nb, Note("start_attitude_sensor", text)


def _nearest(readings: SensorColumns, start_ns: int) -> tuple[Floats, int, float]:
    """Return the reading nearest to the start, its time, ns, and how far it is away, s."""
    row = int(np.argmin(np.abs(readings.time_ns - start_ns)))
    time_ns = int(readings.time_ns[row])
    return readings.values[row], time_ns, abs(time_ns - start_ns) / NS_PER_S


def _first_attitude_ns(reference: ReferenceColumns, start_ns: int, end_ns: int) -> int:
    """Find the first attitude in the span, if possible one that has a position near it."""
    inside = reference.known["attitudes"] & (reference.time_ns >= start_ns) & (reference.time_ns < end_ns)
    located = inside & (apart_s(reference.time_ns, reference.position[:, :2], reference.time_ns) <= FAR_S)
    inside = located if located.any() else inside
    if not inside.any():
        raise LogError(
            "the reference gives no attitude between the first and the last IMU sample of the span",
            "check that both are stamped by the same clock (imu.stamp, reference.stamp), or widen --start and --end",
        )
    return int(reference.time_ns[np.argmax(inside)])


def _reference_position(reference: ReferenceColumns, initial: Initial, start_ns: int) -> tuple[Floats, list[Note]]:
    """Interpolate the reference's position at the start; its height may be missing."""
    horizontal, height_m = reference.position[:, :2].copy(), reference.position[:, 2:]
    first_longitude = horizontal[np.argmax(np.isfinite(horizontal).all(axis=1)), 1]
    horizontal[:, 1] = wrap_angle(horizontal[:, 1] - first_longitude)  # so that 180 deg lies between no two rows
    latitude, longitude = at_time(reference.time_ns, horizontal, start_ns)
    quantities, notes = {"position": horizontal}, list[Note]()
    if np.isfinite(height_m).any():
        start_height_m = at_time(reference.time_ns, height_m, start_ns)[0]
        quantities["height"] = height_m
    else:
        start_height_m = initial.height_m
        notes.append(_configured_height_note(initial))
    for quantity, values in quantities.items():
        far_s = float(apart_s(reference.time_ns, values, np.array([start_ns]))[0])
        if far_s > FAR_S:
            text = f"the {quantity} at the start is the reference's {far_s:.1f} s away from it, and is off by as much"
            hint = f"--start near the reference's {quantity}s"
            notes.append(Note(f"start_{quantity}_far", text, severity=Severity.WARNING, hint=hint))
            break
    latitude_deg = float(latitude) / DEG
    if initial.latitude_deg is not None and abs(initial.latitude_deg - latitude_deg) > LATITUDE_DOUBT_DEG:
        hint = "leave initial.latitude_deg out, or name another reference.topic or reference.fix"
        shown = f"{latitude_deg:.4g} deg"
        notes.append(_idle_note("start_latitude_contradiction", "latitude_deg", initial.latitude_deg, shown, hint))
    return np.array([latitude, float(wrap_angle(longitude + first_longitude)), start_height_m]), notes


def _configured_height_note(initial: Initial) -> Note:
    return Note("start_height_configured", f"started at the configured height {initial.height_m:g} m")


def _idle_note(code: str, key: str, configured: float, theirs: str, hint: str) -> Note:
    text = f"initial.{key} is {configured:g}, but the reference starts at {theirs}, which counts"
    return Note(code, text, severity=Severity.WARNING, hint=hint)


def _heading_notes(reference: ReferenceColumns | None, mat_nb: Floats, start_ns: int) -> list[Note]:
    """Compare the heading with the reference's, where one is near enough to the start."""
    if reference is None or not reference.has_attitude:
        return []
    rows = np.flatnonzero(reference.known["attitudes"])
    row = rows[np.argmin(np.abs(reference.time_ns[rows] - start_ns))]
    if abs(seconds(reference.time_ns[row : row + 1], start_ns)[0]) > FAR_S:
        return []
    theirs, ours = rpy_from_mat(reference.mat_nb[row])[2], rpy_from_mat(mat_nb)[2]
    if abs(float(wrap_angle(np.asarray(ours - theirs)))) <= HEADING_DOUBT:
        return []
    ours_deg, theirs_deg = ours / DEG % 360.0, theirs / DEG % 360.0
    text = f"the heading of {ours_deg:.0f} deg at the start contradicts the reference, which has {theirs_deg:.0f} deg"
    return [Note("start_heading_contradiction", text, 1, Severity.WARNING, f"initial.heading_deg = {theirs_deg:.1f}")]


def _level_notes(level: Level, mat_nb: Floats, cov: Floats) -> list[Note]:
    """State roll and pitch with their standard deviations, about the vehicle's level forward and starboard axes."""
    roll_deg, pitch_deg, heading_deg = rpy_from_mat(mat_nb) / DEG
    level_axes = mat_from_rpy(np.array([0.0, 0.0, heading_deg * DEG]))
    roll_sd_deg, pitch_sd_deg, _ = np.sqrt(np.diagonal(level_axes.T @ cov[PHI, PHI] @ level_axes)) / DEG
    text = (
        f"roll {roll_deg:.2f} +- {roll_sd_deg:.2f} deg and pitch {pitch_deg:.2f} +- {pitch_sd_deg:.2f} deg "
        f"from gravity over {level.span_s:.3g} s, at a heading of {heading_deg:g} deg"
    )
    notes = [Note("start_levelled", text)]
    if not level.pings:
        text = (
            f"the DVL tells too little of the {level.span_s:.3g} s after the start to take the vehicle's own "
            "acceleration off gravity"
        )
        hint = "--start where the DVL sees the bottom"
        notes.append(Note("start_level_unaided", text, severity=Severity.WARNING, hint=hint))
    return notes


def _tilt_notes(level: Level, mat_nb: Floats) -> list[Note]:
    """Compare a sensor's roll and pitch with gravity, where the DVL took the vehicle's own acceleration off."""
    measured, sensed = level.gravity_b / np.linalg.norm(level.gravity_b), mat_nb[2]
    tilt = np.arctan2(np.linalg.norm(np.cross(measured, sensed)), measured @ sensed)
    if not level.pings or tilt <= TILT_DOUBT:
        return []
    measured_deg, sensed_deg = np.array(level.roll_pitch) / DEG, rpy_from_mat(mat_nb)[:2] / DEG
    text = (
        f"the sensor's roll and pitch of {sensed_deg[0]:.1f} and {sensed_deg[1]:.1f} deg at the start contradict "
        f"gravity, which says {measured_deg[0]:.1f} and {measured_deg[1]:.1f} deg"
    )
    hint = 'heading.axes, heading.mounting_rpy_deg, or initial.source = "level"'
    return [Note("start_tilt_contradiction", text, 1, Severity.WARNING, hint)]
