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
    ImuColumns,
    ReferenceColumns,
    apart_s,
    at_time,
)
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import BY_SENSOR, DEG, DEG_PER_HOUR, MG, PHI
from insdvl_replay.core.words import HeadingSource, Severity
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
from insdvl_replay.preparation.notes import note
from insdvl_replay.preparation.start_sources import (
    AttitudeSource,
    PositionSource,
    StartSources,
    initial_sd,
    source_note,
    source_sd,
    velocity_change_cov,
)

FAR_S: Final = 1.0  # readings further from the start are not used for it
HEADING_LIMIT_DEG: Final = (
    10.0  # no compass of a vehicle errs by more, even with the declination left in
)
GIVEN_HEADING_LIMIT_DEG: Final = (
    5.0  # a heading that somebody read off a compass, or a plan, is as near as this
)
TILT_LIMIT: Final = 5.0 * DEG  # no AHRS errs by more, nor do accelerometers
LEAST_DVL_SD_MPS: Final = 5e-4  # of a ping, whatever its neighbours show: readings are rounded
LATITUDE_LIMIT_DEG: Final = 0.1  # a latitude that a user gives in round numbers is as near as this


@dataclass(frozen=True)
class Alignment:
    """The start of a replay: when, with which state and uncertainty, and what was assumed."""

    start_ns: int
    start: Start
    notes: tuple[Note, ...]
    initial: Initial | None = None  # the settings, with what other sensors filled in
    spread_cov: Floats | None = (
        None  # (n, n) of random starts, by [initial]; None: as that of the start
    )
    used_ns: Mapping[str, int] = field(
        default_factory=dict
    )  # by sensor, the time of the reading that the start took
    heading_source: HeadingSource = HeadingSource.SETTINGS

    @property
    def spread_start(self) -> Start:
        """The start with the uncertainty that random starts are drawn from."""
        if self.spread_cov is None:
            return self.start
        return replace(self.start, cov=self.spread_cov)

    @property
    def row(self) -> ReferenceColumns:
        """The start as a reference of one row."""
        start = self.start
        return ReferenceColumns(
            np.array([self.start_ns]),
            start.position[None],
            start.velocity_n[None],
            start.mat_nb[None],
        )


def align(
    dive: Dive,
    config: Config,
    velocities: DvlVelocities,
    start_ns: int,
    end_ns: int,
    fitted_heading_sd: float | None = None,  # rad, if the heading of the settings was fitted
) -> Alignment:
    """Find the start of the filters in a span: the first attitude of the reference or the AHRS, else its first sample.

    What the reference lacks comes from other sensors, from gravity (roll, pitch), from the DVL (velocity) and from the
    settings (heading, position), each with a note. Started level or by an AHRS, the reference gives the position alone.
    """
    imu = dive.imu
    reference = dive.reference
    initial = config.initial
    notes = list[Note]()
    used_ns = dict[str, int]()
    moving = reference if initial.source == "reference" else None
    posed = moving if moving is not None and moving.has_attitude else None
    is_located = reference is not None and reference.has_position
    heading_deg = initial.heading_deg if isinstance(initial.heading_deg, float | int) else None

    def nearest(sensor: str) -> tuple[Floats, float]:
        """Return the reading that is nearest to the start, and how far it is away, s."""
        time_ns = dive.sensors[sensor].time_ns
        row = int(np.argmin(np.abs(time_ns - start_ns)))
        used_ns[sensor] = int(time_ns[row])
        return dive.sensors[sensor].values[row], abs(used_ns[sensor] - start_ns) / NS_PER_S

    # Other sensors: a whole attitude where it is asked for; heading and position where they are open.
    sensed_mat_nb = None
    is_heading_sensed = False
    level_sd_deg = 0.0
    fix = None
    if initial.source == BY_SENSOR:
        is_heading_sensed = heading_deg is None
        level_sd_deg = config.heading.level_sd_deg
        start_ns, sensed_mat_nb, found = _sensor_attitude(dive, heading_deg, start_ns, end_ns)
        notes.append(found)
    elif posed is None and "heading" in dive.sensors and initial.heading_deg in (None, BY_SENSOR):
        values, away_s = nearest("heading")
        if away_s > FAR_S:
            raise LogError(
                f"the heading reading nearest to the start is {away_s:.1f} s away",
                "choose a --start with a heading reading, or --set initial.heading_deg=...",
            )
        heading_deg = float(values[0]) / DEG % 360.0
        is_heading_sensed = True
        notes.append(note("start_heading_sensor", heading=heading_deg, away=away_s))
        initial = changed(initial, heading_deg=heading_deg)
    sensor_sd_deg = level_sd_deg, level_sd_deg, config.heading.sd_deg if is_heading_sensed else 0.0
    sds_deg = tuple(
        map(max, initial.misalignment_sd_deg, sensor_sd_deg)
    )  # no surer than the sensor is
    initial = changed(initial, misalignment_sd_deg=sds_deg)
    if not is_located and "position" in dive.sensors and initial.latitude_deg is None:
        fix, away_s = nearest("position")
        severity = Severity.WARNING if away_s > FAR_S else Severity.INFO
        notes.append(note("start_position_sensor", severity=severity, away=away_s))
        if np.isnan(fix[2]):
            notes.append(note("start_height_configured", height=initial.height_m))
        height_m = float(fix[2])
        sd_m = config.position.sd_m
        sds_m = initial.position_sd_m
        initial = changed(
            initial,
            latitude_deg=float(fix[0]) / DEG,
            longitude_deg=float(fix[1]) / DEG,
            height_m=initial.height_m if np.isnan(height_m) else height_m,
            position_sd_m=(max(sds_m[0], sd_m), max(sds_m[1], sd_m), sds_m[2]),
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
        position, position_notes = _reference_position(reference, initial, start_ns)
        notes += position_notes
    else:
        latitude_deg = start_latitude_deg(initial)
        position = np.array([latitude_deg * DEG, initial.longitude_deg * DEG, initial.height_m])
        if fix is None:
            notes.append(note("start_position_configured", latitude=latitude_deg))

    # Attitude.
    arm_b = np.array(config.dvl.lever_arm_m)
    baseline = resolve_filters(config)[0]
    accel_bias_b = np.array(initial.accel_bias_mg) * MG
    gyro_bias_b = np.array(initial.gyro_bias_degph) * DEG_PER_HOUR
    level = None
    samples = levelling_samples(imu, start_ns)
    if posed is not None:
        mat_nb = posed.mat_nb[np.searchsorted(posed.time_ns, start_ns)]
    elif sensed_mat_nb is not None and len(samples.time_ns) < FEWEST_SAMPLES:
        mat_nb = sensed_mat_nb
    else:
        if len(samples.time_ns) < FEWEST_SAMPLES:
            raise LogError(
                f"only {len(samples.time_ns)} IMU samples without a gap in the {LEVELLING_S:g} s after the start, too "
                "few for levelling",
                "choose another --start",
            )
        if sensed_mat_nb is None and heading_deg is None:
            raise ValueError("the heading is still to be fitted: run.prepare_with_heading does it")
        heading = (
            (heading_deg or 0.0) * DEG
            if sensed_mat_nb is None
            else float(rpy_from_mat(sensed_mat_nb)[2])
        )
        unbiased = ImuColumns(
            samples.time_ns,
            samples.specific_force_b - accel_bias_b,
            samples.angular_rate_b - gyro_bias_b,
        )
        level = find_level(
            unbiased,
            velocities,
            baseline.velocity_cov(velocities),
            baseline.inertial_noise.accel_white_mps_rts,
            arm_b,
            start_ns,
            heading=heading,
            latitude=float(position[0]),
        )
        mat_nb = (
            mat_from_rpy(np.array([*level.roll_pitch, heading]))
            if sensed_mat_nb is None
            else sensed_mat_nb
        )

    # Velocity: the reference's, else that of the nearest ping; after levelling, of the first, carried to the start.
    by_dvl = None
    dvl_velocity_n = None
    if (
        moving is not None
        and apart_s(moving.time_ns, moving.velocity_n, np.array([start_ns]))[0] <= FAR_S
    ):
        velocity_n = at_time(moving.time_ns, moving.velocity_n, start_ns)
    else:
        rate_ie_b = mat_nb.T @ earth_rate_n(position[0])
        covs_b = baseline.velocity_cov(velocities)
        by_dvl = _velocity_by_dvl(
            imu, velocities, covs_b, level, start_ns, arm_b, gyro_bias_b + rate_ie_b
        )
        velocity_n = dvl_velocity_n = mat_nb @ by_dvl.velocity_b
        notes.append(note("start_velocity_dvl", away=abs(by_dvl.ping_ns - start_ns) * 1e-9))
    levelled_by = level if sensed_mat_nb is None else None
    cov = start_cov(initial_sd(initial), mat_nb, levelled_by, dvl_velocity_n)
    spread_cov = None
    heading_source = _heading_source(
        posed=posed is not None, sensed=is_heading_sensed, fitted=fitted_heading_sd is not None
    )
    if initial.uncertainty == "source":
        sources = StartSources(
            _attitude_source(posed=posed is not None, sensed=sensed_mat_nb is not None),
            heading_source,
            _position_source(located=is_located, fixed=fix is not None),
            dvl_velocity_n is None,
            fitted_heading_sd,
        )
        found_sd = source_sd(dive, config, velocities, sources, start_ns, float(position[0]))
        velocity_cov_n = None if by_dvl is None else by_dvl.cov_n(mat_nb)
        spread_cov = cov
        cov = start_cov(found_sd.states, mat_nb, levelled_by, dvl_velocity_n, velocity_cov_n)
        initial = changed(initial, position_sd_m=found_sd.position_m)
        notes.append(source_note(sources, cov))

    # What does not fit together. A configured height stays; the rest of a fix moves from the antenna to the IMU.
    if level is not None:
        notes += _level_notes(level, mat_nb, cov, is_sensed=sensed_mat_nb is not None)
    start_heading_deg = float(rpy_from_mat(mat_nb)[2]) / DEG
    if posed is None:
        notes += _heading_notes(reference, start_heading_deg, start_ns)
    elif (
        heading_deg is not None
        and _apart_deg(heading_deg, start_heading_deg) > GIVEN_HEADING_LIMIT_DEG
    ):
        notes.append(
            note("start_heading_idle", configured=heading_deg, found=start_heading_deg % 360.0)
        )
    if fix is not None:
        moved = moved_position(position, -(mat_nb @ np.array(config.position.lever_arm_m)))
        position = np.where(np.isfinite(fix), moved, position)
    start = Start(
        position,
        velocity_n,
        mat_nb,
        cov,
        accel_bias_b,
        gyro_bias_b,
        is_heading_sensed=is_heading_sensed,
    )
    return Alignment(start_ns, start, tuple(notes), initial, spread_cov, used_ns, heading_source)


@dataclass(frozen=True)
class _DvlVelocity:
    """A velocity of the IMU over ground by a ping."""

    velocity_b: Floats  # (3,) m/s
    cov_b: Floats  # (3, 3) of its noise, m^2/s^2
    ping_ns: int

    def cov_n(self, mat_nb: Floats) -> Floats:
        """Return the covariance in n, (3, 3); no less than the rounding of readings."""
        return np.asarray(mat_nb @ self.cov_b @ mat_nb.T + LEAST_DVL_SD_MPS**2 * np.eye(3))


def _velocity_by_dvl(
    imu: ImuColumns,
    velocities: DvlVelocities,
    covs_b: Floats,  # (m, 3, 3) of the noise of each ping
    level: Level | None,
    start_ns: int,
    arm_b: Floats,  # (3,) IMU to DVL, m
    still_rate_b: Floats,  # (3,) what the gyros measure without any turn over ground, rad/s
) -> _DvlVelocity:
    """Return the velocity at the start by the level's first ping, else by the nearest one."""
    if level is not None and level.pings:
        ping_ns = int(velocities.time_ns[np.searchsorted(velocities.time_ns, start_ns)])
        return _DvlVelocity(level.velocity_b, level.velocity_cov_b, ping_ns)
    nearest = int(np.argmin(np.abs(velocities.time_ns - start_ns)))
    ping_ns = int(velocities.time_ns[nearest])
    rate_eb_b = at_time(imu.time_ns, imu.angular_rate_b, ping_ns) - still_rate_b
    velocity_b = velocities.velocity_b[nearest] - np.cross(rate_eb_b, arm_b)
    change_cov = velocity_change_cov(velocities, nearest, start_ns)
    return _DvlVelocity(velocity_b, covs_b[nearest] + change_cov, ping_ns)


def _attitude_source(*, posed: bool, sensed: bool) -> AttitudeSource:
    if posed:
        return AttitudeSource.REFERENCE
    if sensed:
        return AttitudeSource.AHRS
    return AttitudeSource.GRAVITY


def _heading_source(*, posed: bool, sensed: bool, fitted: bool) -> HeadingSource:
    if posed:
        return HeadingSource.REFERENCE
    if sensed:
        return HeadingSource.SENSOR
    if fitted:
        return HeadingSource.FIT
    return HeadingSource.SETTINGS


def _position_source(*, located: bool, fixed: bool) -> PositionSource:
    if located:
        return PositionSource.REFERENCE
    if fixed:
        return PositionSource.SENSOR
    return PositionSource.SETTINGS


def _sensor_attitude(
    dive: Dive, heading_deg: float | None, start_ns: int, end_ns: int
) -> tuple[int, Floats, Note]:
    """Return time and value of the AHRS's first attitude in the span; a configured heading replaces its own."""
    time_ns = dive.sensors["heading"].time_ns
    mats_nb = dive.sensors["heading"].mat_nb
    if mats_nb is None:
        raise LogError(
            'initial.source is "sensor", but the heading messages have no roll and pitch',
            "set heading.roll and heading.pitch, or start level: --set initial.source=level",
        )
    inside = (time_ns >= start_ns) & (time_ns < end_ns) & np.isfinite(mats_nb).all(axis=(1, 2))
    if not inside.any():
        raise LogError(
            "the heading sensor has no attitude between the first and the last IMU sample of the span",
            "compare heading.stamp with imu.stamp, or widen --start and --end",
        )
    row = int(np.argmax(inside))
    first_ns = int(time_ns[row])
    mat_nb = mats_nb[row]
    roll, pitch, heading = rpy_from_mat(mat_nb)
    if heading_deg is not None:
        heading = heading_deg * DEG
        mat_nb = mat_from_rpy(np.array([roll, pitch, heading]))
    since_s = (first_ns - start_ns) / NS_PER_S
    shown_deg = heading / DEG % 360.0
    return first_ns, mat_nb, note(
        "start_attitude_sensor", roll=roll / DEG, pitch=pitch / DEG, since=since_s, heading=shown_deg
    )  # fmt: skip


def _first_attitude_ns(reference: ReferenceColumns, start_ns: int, end_ns: int) -> int:
    """Find the first attitude in the span, if possible one that has a position near it."""
    inside = (
        reference.known["attitudes"]
        & (reference.time_ns >= start_ns)
        & (reference.time_ns < end_ns)
    )
    located = inside & (
        apart_s(reference.time_ns, reference.position[:, :2], reference.time_ns) <= FAR_S
    )
    inside = located if located.any() else inside
    if not inside.any():
        raise LogError(
            "the reference has no attitude between the first and the last IMU sample of the span",
            "compare imu.stamp with reference.stamp (both need the same clock), or widen --start and --end",
        )
    return int(reference.time_ns[np.argmax(inside)])


def _reference_position(
    reference: ReferenceColumns, initial: Initial, start_ns: int
) -> tuple[Floats, list[Note]]:
    """Interpolate the reference's position at the start; its height may be missing."""
    horizontal = reference.position[:, :2].copy()
    notes = list[Note]()
    first_longitude = horizontal[np.argmax(np.isfinite(horizontal).all(axis=1)), 1]
    horizontal[:, 1] = wrap_angle(
        horizontal[:, 1] - first_longitude
    )  # so that 180 deg lies between no two rows
    quantities = {"position": horizontal, "height": reference.position[:, 2:]}
    if not reference.known["heights"].any():
        del quantities["height"]
        notes.append(note("start_height_configured", height=initial.height_m))
    found = {
        name: at_time(reference.time_ns, values, start_ns) for name, values in quantities.items()
    }
    for quantity, values in quantities.items():
        far_s = float(apart_s(reference.time_ns, values, np.array([start_ns]))[0])
        if far_s > FAR_S:
            notes.append(note("start_{quantity}_far", quantity=quantity, away=far_s))
            break
    (latitude, longitude), (height_m,) = found["position"], found.get("height", (initial.height_m,))
    latitude_deg = float(latitude) / DEG
    if (
        initial.latitude_deg is not None
        and abs(initial.latitude_deg - latitude_deg) > LATITUDE_LIMIT_DEG
    ):
        notes.append(
            note(
                "start_latitude_contradiction", configured=initial.latitude_deg, found=latitude_deg
            )
        )
    return np.array([latitude, float(wrap_angle(longitude + first_longitude)), height_m]), notes


def _apart_deg(heading_deg: float, other_deg: float) -> float:
    return abs(float(wrap_angle(np.asarray((heading_deg - other_deg) * DEG)))) / DEG


def _heading_notes(
    reference: ReferenceColumns | None, heading_deg: float, start_ns: int
) -> list[Note]:
    """Compare the heading with the reference's, where one is near enough to the start."""
    if reference is None or not reference.has_attitude:
        return []
    known = reference.rows(reference.known["attitudes"])
    row = int(np.argmin(np.abs(known.time_ns - start_ns)))
    found_deg = float(rpy_from_mat(known.mat_nb[row])[2]) / DEG
    is_far = abs(int(known.time_ns[row]) - start_ns) * 1e-9 > FAR_S
    if is_far or _apart_deg(heading_deg, found_deg) <= HEADING_LIMIT_DEG:
        return []
    return [
        note("start_heading_contradiction", heading=heading_deg % 360.0, found=found_deg % 360.0)
    ]


def _level_notes(level: Level, mat_nb: Floats, cov: Floats, *, is_sensed: bool) -> list[Note]:
    """Give roll and pitch with their standard deviations, or compare a sensor's with gravity."""
    rpy_deg = rpy_from_mat(mat_nb) / DEG
    if is_sensed:
        # Only where the DVL took the vehicle's own acceleration off.
        gravity_b = level.gravity_b / np.linalg.norm(level.gravity_b)
        down_b = mat_nb[2]
        tilt = np.arctan2(np.linalg.norm(np.cross(gravity_b, down_b)), gravity_b @ down_b)
        if not level.pings or tilt <= TILT_LIMIT:
            return []
        return [
            note(
                "start_tilt_contradiction",
                sensed=rpy_deg,
                measured=np.array(level.roll_pitch) / DEG,
            )
        ]
    # About the vehicle's level forward and starboard axes.
    level_axes = mat_from_rpy(np.array([0.0, 0.0, rpy_deg[2] * DEG]))
    sd_deg = np.sqrt(np.diagonal(level_axes.T @ cov[PHI, PHI] @ level_axes)) / DEG
    notes = [note("start_levelled", rpy=rpy_deg, sd=sd_deg, level=level)]
    if level.pings:
        return notes
    return [*notes, note("start_level_unaided", level=level)]
