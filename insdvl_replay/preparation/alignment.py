"""Where and how a filter starts: from the reference, from an AHRS, or level from gravity (section ``[initial]``)."""

from dataclasses import dataclass, replace

import numpy as np

from insdvl_replay.core.config import Initial
from insdvl_replay.core.dive_columns import Floats, ImuColumns, ReferenceColumns, apart_s, at_time, seconds
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, wrap_angle
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.levelling import (
    FEWEST_SAMPLES,
    LEVELLING_S,
    Level,
    SensorNoise,
    Start,
    find_level,
    levelling_samples,
    start_cov,
)
from insdvl_replay.preparation.start_position import FAR_S, configured_latitude_deg, idle_note, start_position

HEADING_DOUBT = 10.0 * DEG
"""No compass of a vehicle errs by more, even where nobody has taken the declination off."""

IDLE_HEADING_DOUBT = 5.0 * DEG
"""A heading that somebody read off a compass, or a plan, is as near as this."""

TILT_DOUBT = 5.0 * DEG
"""No AHRS errs by more, nor do accelerometers."""


@dataclass(frozen=True)
class Alignment:
    """The start of a replay: when, with which state and uncertainty, and what the reference did not give."""

    start_ns: int
    start: Start
    notes: tuple[Note, ...]

    @property
    def row(self) -> ReferenceColumns:
        """The start as a reference of one row."""
        start = self.start
        return ReferenceColumns(
            np.array([self.start_ns]), start.position[None], start.velocity_n[None], start.mat_nb[None]
        )


def align(
    imu: ImuColumns,
    velocities: DvlVelocities,
    noise: SensorNoise,
    reference: ReferenceColumns | None,
    initial: Initial,
    lever_arm_b: Floats,
    start_ns: int,
    end_ns: int,
    sensed_mat_nb: Floats | None = None,
    *,
    is_fix: bool = False,
) -> Alignment:
    """Find the start: the reference's first attitude inside the span, or the first sample when levelling.

    What the reference lacks is taken from gravity (roll, pitch), from the DVL (velocity) and from the configuration
    (heading, position), each with a note. Started level or by a sensor, the reference gives the position and height
    alone. The lever arm, shape (3,), goes from IMU to DVL, m; a sensor's attitude, shape (3, 3), is that at the start,
    and a sensor's fix may stand in the place of the configured position.
    """
    notes: list[Note] = []
    check_start(
        initial,
        has_reference=reference is not None,
        has_position=reference is not None and reference.has_position,
        has_attitude=reference is not None and reference.has_attitude,
        has_heading=sensed_mat_nb is not None,
    )
    moving = reference if initial.source == "reference" else None
    posed = moving if moving is not None and moving.has_attitude else None
    if posed is not None:
        start_ns = _first_attitude_ns(posed, start_ns, end_ns)
    position = start_position(reference, initial, start_ns, notes, is_fix=is_fix)
    level = None
    if posed is not None:
        mat_nb = posed.mat_nb[np.searchsorted(posed.time_ns, start_ns)]
    elif sensed_mat_nb is not None and len(levelling_samples(imu, start_ns).time_ns) < FEWEST_SAMPLES:
        mat_nb = sensed_mat_nb
    else:
        heading = _heading(initial, sensed_mat_nb)
        level = _level(imu, velocities, noise, initial, lever_arm_b, start_ns, heading, float(position[0]))
        mat_nb = mat_from_rpy(np.array([*level.roll_pitch, heading])) if sensed_mat_nb is None else sensed_mat_nb
    velocity_n = _reference_velocity(moving, start_ns)
    by_dvl_n = None
    if velocity_n is None:
        velocity_b, note = _dvl_velocity(imu, velocities, level, initial, mat_nb, lever_arm_b, start_ns, position)
        velocity_n = by_dvl_n = mat_nb @ velocity_b
        notes.append(note)
    cov = start_cov(initial_sd(initial), mat_nb, level if sensed_mat_nb is None else None, by_dvl_n)
    if level is not None:
        notes += _level_notes(level, mat_nb, cov) if sensed_mat_nb is None else _tilt_notes(level, mat_nb)
    notes += _heading_notes(reference, mat_nb, start_ns) if posed is None else _idle_heading_notes(initial, mat_nb)
    start = Start(position, velocity_n, mat_nb, cov, _accel_bias_b(initial), _gyro_bias_b(initial))
    return Alignment(start_ns, start, tuple(notes))


def check_start(
    initial: Initial, *, has_reference: bool, has_position: bool, has_attitude: bool, has_heading: bool = False
) -> None:
    """Refuse settings that leave open where or how a filter starts, by what a reference gives, or a sensor.

    Raises
    ------
    LogError
        A reference is wanted, and there is none.
    ConfigError
        Heading or latitude are needed and not configured.
    """
    from_reference = initial.source == "reference"
    if from_reference and not has_reference:
        raise LogError(
            "no reference solution was found to start from",
            "name it with --set reference.topic=... and its fields (a solution that is a filter is none), or start "
            "level: --set initial.source=level --set initial.heading_deg=... --set initial.latitude_deg=..., or, where "
            "the log has an AHRS, from its attitude: --set initial.source=sensor --set initial.latitude_deg=...",
        )
    if not has_position:
        configured_latitude_deg(initial)
    if not (has_heading or (from_reference and has_attitude)) and initial.heading_deg is None:
        by_track = ", or fit, by the track of its positions" if has_position else ""
        raise ConfigError(
            "the heading at the start is needed: no reference gives it, or initial.source is level, which takes none",
            f"--set initial.heading_deg=... (or sensor, by an AHRS or a compass{by_track})",
        )


def _heading(initial: Initial, sensed_mat_nb: Floats | None) -> float:
    if sensed_mat_nb is not None:
        return float(rpy_from_mat(sensed_mat_nb)[2])
    if not isinstance(initial.heading_deg, float | int):
        raise ValueError("the heading is still to be fitted: start_heading.prepare_with_heading does it")
    return initial.heading_deg * DEG


def initial_sd(initial: Initial) -> Floats:
    """Return the initial standard deviations of the 12 error states.

    Returns
    -------
    ndarray, shape (12,), SI units
    """
    sd = np.empty(12)
    sd[DV] = initial.velocity_sd_mps
    sd[PHI] = np.array(initial.misalignment_sd_deg) * DEG
    sd[BA] = initial.accel_bias_sd_mg * MG
    sd[BG] = initial.gyro_bias_sd_degph * DEG_PER_HOUR
    return sd


def _first_attitude_ns(reference: ReferenceColumns, start_ns: int, end_ns: int) -> int:
    """Find the first attitude in the span, if possible one that has a position near it."""
    has_attitude = np.isfinite(reference.mat_nb).all(axis=(1, 2))
    inside = has_attitude & (reference.time_ns >= start_ns) & (reference.time_ns < end_ns)
    located = inside & (apart_s(reference.time_ns, reference.position[:, :2], reference.time_ns) <= FAR_S)
    inside = located if located.any() else inside
    if not inside.any():
        raise LogError(
            "the reference gives no attitude between the first and the last IMU sample of the span",
            "check that both are stamped by the same clock (imu.stamp, reference.stamp), or widen --start and --end",
        )
    return int(reference.time_ns[np.argmax(inside)])


def _level(
    imu: ImuColumns,
    velocities: DvlVelocities,
    noise: SensorNoise,
    initial: Initial,
    lever_arm_b: Floats,
    start_ns: int,
    heading: float,
    latitude: float,
) -> Level:
    """Find the level, by readings without the configured biases."""
    samples = levelling_samples(imu, start_ns)
    if len(samples.time_ns) < FEWEST_SAMPLES:
        raise LogError(
            f"only {len(samples.time_ns)} IMU samples without a pause lie in the {LEVELLING_S:g} s after the start, "
            "too few to find the level",
            "choose another --start",
        )
    unbiased = replace(
        samples,
        specific_force_b=samples.specific_force_b - _accel_bias_b(initial),
        angular_rate_b=samples.angular_rate_b - _gyro_bias_b(initial),
    )
    return find_level(unbiased, velocities, noise, lever_arm_b, start_ns, heading=heading, latitude=latitude)


def _heading_notes(reference: ReferenceColumns | None, mat_nb: Floats, start_ns: int) -> list[Note]:
    """Hold the configured heading against the reference's, where one is near enough to the start."""
    if reference is None or not reference.has_attitude:
        return []
    rows = np.flatnonzero(np.isfinite(reference.mat_nb).all(axis=(1, 2)))
    row = rows[np.argmin(np.abs(reference.time_ns[rows] - start_ns))]
    if abs(seconds(reference.time_ns[row : row + 1], start_ns)[0]) > FAR_S:
        return []
    theirs, ours = rpy_from_mat(reference.mat_nb[row])[2], rpy_from_mat(mat_nb)[2]
    if abs(float(wrap_angle(np.asarray(ours - theirs)))) <= HEADING_DOUBT:
        return []
    ours_deg, theirs_deg = ours / DEG % 360.0, theirs / DEG % 360.0
    text = f"the heading of {ours_deg:.0f} deg at the start contradicts the reference, which has {theirs_deg:.0f} deg"
    return [Note("start_heading_contradiction", text, 1, Severity.WARNING, f"initial.heading_deg = {theirs_deg:.1f}")]


def _idle_heading_notes(initial: Initial, mat_nb: Floats) -> list[Note]:
    """State that a heading is configured in vain, where it is another than that of the reference's attitude."""
    if not isinstance(initial.heading_deg, float | int):
        return []
    theirs = rpy_from_mat(mat_nb)[2]
    if abs(float(wrap_angle(np.asarray(initial.heading_deg * DEG - theirs)))) <= IDLE_HEADING_DOUBT:
        return []
    hint = 'leave initial.heading_deg out, or initial.source = "level" to start from it'
    shown = f"{theirs / DEG % 360.0:.1f} deg"
    return [idle_note("start_heading_idle", "heading_deg", initial.heading_deg, shown, hint)]


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
    """Hold the roll and pitch of a sensor against gravity, where the DVL took the vehicle's own acceleration off."""
    felt, said = level.gravity_b / np.linalg.norm(level.gravity_b), mat_nb[2]
    tilt = np.arctan2(np.linalg.norm(np.cross(felt, said)), felt @ said)
    if not level.pings or tilt <= TILT_DOUBT:
        return []
    felt_deg, said_deg = np.array(level.roll_pitch) / DEG, rpy_from_mat(mat_nb)[:2] / DEG
    text = (
        f"the sensor's roll and pitch of {said_deg[0]:.1f} and {said_deg[1]:.1f} deg at the start contradict gravity, "
        f"which says {felt_deg[0]:.1f} and {felt_deg[1]:.1f} deg"
    )
    hint = 'heading.axes, heading.mounting_rpy_deg, or initial.source = "level"'
    return [Note("start_tilt_contradiction", text, 1, Severity.WARNING, hint)]


def _reference_velocity(reference: ReferenceColumns | None, start_ns: int) -> Floats | None:
    if reference is None or apart_s(reference.time_ns, reference.velocity_n, np.array([start_ns]))[0] > FAR_S:
        return None
    return at_time(reference.time_ns, reference.velocity_n, start_ns)


def _dvl_velocity(
    imu: ImuColumns,
    velocities: DvlVelocities,
    level: Level | None,
    initial: Initial,
    mat_nb: Floats,
    lever_arm_b: Floats,
    start_ns: int,
    position: Floats,
) -> tuple[Floats, Note]:
    """Return the IMU's velocity in b, of the nearest ping; after levelling, of the first, and carried to the start."""
    if level is not None and level.pings:
        away_s = seconds(velocities.time_ns[velocities.time_ns >= start_ns][:1], start_ns)[0]
        return level.velocity_b, _dvl_note(away_s)
    nearest = int(np.argmin(np.abs(velocities.time_ns - start_ns)))
    rate_ib_b = at_time(imu.time_ns, imu.angular_rate_b, int(velocities.time_ns[nearest])) - _gyro_bias_b(initial)
    rate_eb_b = rate_ib_b - mat_nb.T @ earth_rate_n(position[0])
    away_s = abs(int(velocities.time_ns[nearest]) - start_ns) * 1e-9
    velocity_b: Floats = velocities.velocity_b[nearest] - np.cross(rate_eb_b, lever_arm_b)
    return velocity_b, _dvl_note(away_s)


def _dvl_note(away_s: float) -> Note:
    return Note("start_velocity_dvl", f"velocity at the start from the DVL's ping {away_s:.2f} s away")


def _accel_bias_b(initial: Initial) -> Floats:
    return np.array(initial.accel_bias_mg) * MG


def _gyro_bias_b(initial: Initial) -> Floats:
    return np.array(initial.gyro_bias_degph) * DEG_PER_HOUR
