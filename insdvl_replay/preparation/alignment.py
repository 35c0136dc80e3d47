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
from insdvl_replay.core.notes import note
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
from insdvl_replay.preparation.filters import ResolvedFilter, resolve_filters
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
# no compass of a vehicle errs by more, even with the declination left in
HEADING_LIMIT_DEG: Final = 10.0
# a heading that somebody read off a compass, or a plan, is as near as this
GIVEN_HEADING_LIMIT_DEG: Final = 5.0
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
    # (n, n) of random starts, by [initial]; None: as that of the start
    spread_cov: Floats | None = None
    # by sensor, the time of the reading that the start took
    used_ns: Mapping[str, int] = field(default_factory=dict)
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
    given = _Given(dive, config, velocities, start_ns, end_ns, fitted_heading_sd)
    reference = dive.reference
    if config.initial.source == BY_SENSOR:
        return _start_by_ahrs(given)
    # A start on a reference that is not there is refused by `_require_start`.
    if config.initial.source == "level" or reference is None:
        return _start_level(given)
    if reference.has_attitude:
        return _start_on_reference(given, reference)
    return _start_level_with_reference(given, reference)


@dataclass(frozen=True)
class _Given:
    """What a start is found from."""

    dive: Dive
    config: Config
    velocities: DvlVelocities
    start_ns: int
    end_ns: int
    fitted_heading_sd: float | None  # rad

    @property
    def located(self) -> ReferenceColumns | None:
        """The reference, if it has positions."""
        reference = self.dive.reference
        if reference is None or not reference.has_position:
            return None
        return reference

    @property
    def heading_deg(self) -> float | None:
        """The heading of the settings; None where they name another source, or none."""
        heading_deg = self.config.initial.heading_deg
        if isinstance(heading_deg, float | int):
            return heading_deg
        return None

    @property
    def baseline(self) -> ResolvedFilter:
        """The baseline, whose noise the start has."""
        return resolve_filters(self.config)[0]

    @property
    def arm_b(self) -> Floats:
        """From the IMU to the DVL, shape (3,), m."""
        return np.array(self.config.dvl.lever_arm_m)

    @property
    def accel_bias_b(self) -> Floats:
        """Of the settings, shape (3,), m/s^2."""
        return np.array(self.config.initial.accel_bias_mg) * MG

    @property
    def gyro_bias_b(self) -> Floats:
        """Of the settings, shape (3,), rad/s."""
        return np.array(self.config.initial.gyro_bias_degph) * DEG_PER_HOUR


# --- The four starts: on the reference, by an AHRS, level, and level with the velocity of a reference.


def _start_on_reference(given: _Given, reference: ReferenceColumns) -> Alignment:
    """Start on the first attitude of the reference."""
    settings = _with_fix(given, _Settings(given.config.initial), given.start_ns)
    _require_start(given, settings)
    start_ns = _first_attitude_ns(reference, given.start_ns, given.end_ns)
    pose = _Pose(
        start_ns=start_ns,
        place=_place(given, settings, start_ns),
        mat_nb=reference.mat_nb[np.searchsorted(reference.time_ns, start_ns)],
        attitude=AttitudeSource.REFERENCE,
        heading=HeadingSource.REFERENCE,
    )
    return _aligned(given, settings, pose, _velocity_by_reference(given, reference, pose))


def _start_by_ahrs(given: _Given) -> Alignment:
    """Start on the first attitude of the AHRS, and compare it with gravity, where there are samples enough."""
    start_ns, mat_nb, found = _sensor_attitude(given)
    sensor = given.config.heading
    heading_sd_deg = 0.0
    heading = _heading_of_settings(given)
    if given.heading_deg is None:
        heading_sd_deg = sensor.sd_deg
        heading = HeadingSource.SENSOR
    initial = _no_surer_than(
        given.config.initial, (sensor.level_sd_deg, sensor.level_sd_deg, heading_sd_deg)
    )
    settings = _with_fix(given, _Settings(initial, (found,)), start_ns)
    _require_start(given, settings, has_heading=True)
    place = _place(given, settings, start_ns)
    samples = levelling_samples(given.dive.imu, start_ns)
    level = None
    if len(samples.time_ns) >= FEWEST_SAMPLES:
        level = _level(given, samples, start_ns, place, float(rpy_from_mat(mat_nb)[2]))
    pose = _Pose(start_ns, place, mat_nb, AttitudeSource.AHRS, heading, level)
    return _aligned(given, settings, pose, _velocity_by_dvl(given, pose))


def _start_level(given: _Given) -> Alignment:
    """Start with roll and pitch by gravity, and the velocity of the DVL."""
    settings, pose = _levelled(given)
    return _aligned(given, settings, pose, _velocity_by_dvl(given, pose))


def _start_level_with_reference(given: _Given, reference: ReferenceColumns) -> Alignment:
    """Start with roll and pitch by gravity, and the velocity of a reference that has no attitude."""
    settings, pose = _levelled(given)
    return _aligned(given, settings, pose, _velocity_by_reference(given, reference, pose))


def _levelled(given: _Given) -> tuple["_Settings", "_Pose"]:
    """Find roll and pitch by gravity; the heading is the settings' or, where these leave it open, a sensor's."""
    settings = _Settings(given.config.initial)
    heading_deg = given.heading_deg
    heading_source = _heading_of_settings(given)
    is_open = given.config.initial.heading_deg in (None, BY_SENSOR)
    if is_open and "heading" in given.dive.sensors:
        settings, heading_deg = _with_heading(given)
        heading_source = HeadingSource.SENSOR
    settings = _with_fix(given, settings, given.start_ns)
    _require_start(given, settings)
    place = _place(given, settings, given.start_ns)
    samples = levelling_samples(given.dive.imu, given.start_ns)
    if len(samples.time_ns) < FEWEST_SAMPLES:
        raise LogError(
            f"only {len(samples.time_ns)} IMU samples without a gap in the {LEVELLING_S:g} s after the start, too "
            "few for levelling",
            "choose another --start",
        )
    if heading_deg is None:
        raise ValueError("the heading is still to be fitted: run.prepare_with_heading does it")
    heading = heading_deg * DEG
    level = _level(given, samples, given.start_ns, place, heading)
    mat_nb = mat_from_rpy(np.array([*level.roll_pitch, heading]))
    pose = _Pose(given.start_ns, place, mat_nb, AttitudeSource.GRAVITY, heading_source, level)
    return settings, pose


@dataclass(frozen=True)
class _Settings:
    """The settings of a start, with what other sensors fill in."""

    initial: Initial
    notes: tuple[Note, ...] = ()
    used_ns: Mapping[str, int] = field(default_factory=dict)  # by sensor
    fix: Floats | None = None  # (3,) that gave the position; NaN for a height that it lacks


@dataclass(frozen=True)
class _Place:
    """The position at the start, of the antenna if a fix gave it."""

    position: Floats  # (3,)
    source: PositionSource
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class _Pose:
    """A start without its velocity."""

    start_ns: int
    place: _Place
    mat_nb: Floats
    attitude: AttitudeSource
    heading: HeadingSource
    level: Level | None = None  # gravity, where it was found

    @property
    def levelled_by(self) -> Level | None:
        """Gravity, where roll and pitch come from it."""
        if self.attitude == AttitudeSource.GRAVITY:
            return self.level
        return None


@dataclass(frozen=True)
class _Velocity:
    """The velocity at the start."""

    velocity_n: Floats  # (3,) m/s
    dvl_cov_n: Floats | None = None  # (3, 3) of its noise, m^2/s^2; None for the reference's
    notes: tuple[Note, ...] = ()

    @property
    def by_dvl_n(self) -> Floats | None:
        """The velocity, where it is the DVL's."""
        if self.dvl_cov_n is None:
            return None
        return self.velocity_n


def _start_with(
    cov: Floats,
    given: _Given,
    settings: _Settings,
    pose: _Pose,
    velocity: _Velocity,
) -> Start:
    """Return the state of the IMU at the start, with its covariance, (12, 12)."""
    return Start(
        position=_position_of_imu(given, settings, pose),
        velocity_n=velocity.velocity_n,
        mat_nb=pose.mat_nb,
        cov=cov,
        accel_bias_b=given.accel_bias_b,
        gyro_bias_b=given.gyro_bias_b,
        is_heading_sensed=pose.heading == HeadingSource.SENSOR,
    )


def _aligned(
    given: _Given,
    settings: _Settings,
    pose: _Pose,
    velocity: _Velocity,
) -> Alignment:
    """Give a start its uncertainty, and note what does not fit together."""
    initial = settings.initial
    notes = [*settings.notes, *pose.place.notes, *velocity.notes]
    spread_cov = None
    cov = start_cov(initial_sd(initial), pose.mat_nb, pose.levelled_by, velocity.by_dvl_n)
    if initial.uncertainty == "source":
        spread_cov = cov
        sources = StartSources(
            attitude=pose.attitude,
            heading=pose.heading,
            position=pose.place.source,
            is_velocity_of_reference=velocity.by_dvl_n is None,
            fitted_heading_sd=given.fitted_heading_sd,
        )
        latitude = float(pose.place.position[0])
        found_sd = source_sd(
            given.dive, given.config, given.velocities, sources, pose.start_ns, latitude
        )
        cov = start_cov(
            found_sd.states, pose.mat_nb, pose.levelled_by, velocity.by_dvl_n, velocity.dvl_cov_n
        )
        initial = changed(initial, position_sd_m=found_sd.position_m)
        notes.append(source_note(sources, cov))
    if pose.level is not None:
        is_sensed = pose.attitude == AttitudeSource.AHRS
        notes += _level_notes(pose.level, pose.mat_nb, cov, is_sensed=is_sensed)
    notes += _heading_notes(given, pose)
    return Alignment(
        start_ns=pose.start_ns,
        start=_start_with(cov, given, settings, pose, velocity),
        notes=tuple(notes),
        initial=initial,
        spread_cov=spread_cov,
        used_ns=settings.used_ns,
        heading_source=pose.heading,
    )


# --- What other sensors fill in.


@dataclass(frozen=True)
class _Reading:
    """The reading of a sensor that is nearest to the start."""

    values: Floats
    time_ns: int
    away_s: float


def _nearest(dive: Dive, sensor: str, start_ns: int) -> _Reading:
    columns = dive.sensors[sensor]
    row = int(np.argmin(np.abs(columns.time_ns - start_ns)))
    time_ns = int(columns.time_ns[row])
    return _Reading(columns.values[row], time_ns, abs(time_ns - start_ns) / NS_PER_S)


def _with_heading(given: _Given) -> tuple[_Settings, float]:
    """Take the heading from a sensor; return it as well, deg."""
    found = _nearest(given.dive, "heading", given.start_ns)
    if found.away_s > FAR_S:
        raise LogError(
            f"the heading reading nearest to the start is {found.away_s:.1f} s away",
            "choose a --start with a heading reading, or --set initial.heading_deg=...",
        )
    heading_deg = float(found.values[0]) / DEG % 360.0
    initial = _no_surer_than(given.config.initial, (0.0, 0.0, given.config.heading.sd_deg))
    settings = _Settings(
        changed(initial, heading_deg=heading_deg),
        (note("start_heading_sensor", heading=heading_deg, away=found.away_s),),
        {"heading": found.time_ns},
    )
    return settings, heading_deg


def _no_surer_than(initial: Initial, sensor_sd_deg: tuple[float, float, float]) -> Initial:
    """Return the settings with an attitude that is no surer than the sensor that gives it."""
    own_north, own_east, own_down = initial.misalignment_sd_deg
    north, east, down = sensor_sd_deg
    sds_deg = (max(own_north, north), max(own_east, east), max(own_down, down))
    return changed(initial, misalignment_sd_deg=sds_deg)


def _with_fix(given: _Given, settings: _Settings, start_ns: int) -> _Settings:
    """Take the position from a fix where neither the reference nor the settings give it."""
    initial = settings.initial
    is_open = given.located is None and initial.latitude_deg is None
    if not is_open or "position" not in given.dive.sensors:
        return settings
    found = _nearest(given.dive, "position", start_ns)
    severity = Severity.WARNING if found.away_s > FAR_S else Severity.INFO
    notes = [*settings.notes, note("start_position_sensor", severity=severity, away=found.away_s)]
    latitude, longitude, height_m = found.values.tolist()
    if np.isnan(height_m):
        height_m = initial.height_m
        notes.append(note("start_height_configured", height=height_m))
    sd_m = given.config.position.sd_m
    north_m, east_m, down_m = initial.position_sd_m
    initial = changed(
        initial,
        latitude_deg=latitude / DEG,
        longitude_deg=longitude / DEG,
        height_m=height_m,
        position_sd_m=(max(north_m, sd_m), max(east_m, sd_m), down_m),
    )
    used_ns = {**settings.used_ns, "position": found.time_ns}
    return _Settings(initial, tuple(notes), used_ns, found.values)


def _require_start(given: _Given, settings: _Settings, *, has_heading: bool = False) -> None:
    """Raise if reference, sensors and settings do not determine the start."""
    reference = given.dive.reference
    check_start(
        settings.initial,
        has_reference=reference is not None,
        has_position=given.located is not None,
        has_attitude=reference is not None and reference.has_attitude,
        has_heading=has_heading,
    )


def _heading_of_settings(given: _Given) -> HeadingSource:
    """Return the source of a heading that is in the settings."""
    if given.fitted_heading_sd is None:
        return HeadingSource.SETTINGS
    return HeadingSource.FIT


# --- Position.


def _place(given: _Given, settings: _Settings, start_ns: int) -> _Place:
    """Return the position at the start: the reference's, else that of the settings, or of the fix in them."""
    initial = settings.initial
    if given.located is not None:
        position, notes = _reference_position(given.located, initial, start_ns)
        return _Place(position, PositionSource.REFERENCE, tuple(notes))
    latitude_deg = start_latitude_deg(initial)
    position = np.array([latitude_deg * DEG, initial.longitude_deg * DEG, initial.height_m])
    if settings.fix is not None:
        return _Place(position, PositionSource.SENSOR)
    configured = note("start_position_configured", latitude=latitude_deg)
    return _Place(position, PositionSource.SETTINGS, (configured,))


def _position_of_imu(given: _Given, settings: _Settings, pose: _Pose) -> Floats:
    """Move the position of a fix from the antenna to the IMU; a configured height stays."""
    position = pose.place.position
    if settings.fix is None:
        return position
    arm_n = pose.mat_nb @ np.array(given.config.position.lever_arm_m)
    return np.where(np.isfinite(settings.fix), moved_position(position, -arm_n), position)


# --- Level and velocity.


def _level(
    given: _Given,
    samples: ImuColumns,
    start_ns: int,
    place: _Place,
    heading: float,
) -> Level:
    """Find gravity in body axes, without the biases that the settings know."""
    unbiased = ImuColumns(
        samples.time_ns,
        samples.specific_force_b - given.accel_bias_b,
        samples.angular_rate_b - given.gyro_bias_b,
    )
    baseline = given.baseline
    return find_level(
        unbiased,
        given.velocities,
        baseline.velocity_cov(given.velocities),
        baseline.inertial_noise.accel_white_mps_rts,
        given.arm_b,
        start_ns,
        heading=heading,
        latitude=float(place.position[0]),
    )


def _velocity_by_reference(given: _Given, reference: ReferenceColumns, pose: _Pose) -> _Velocity:
    """Return the velocity of the reference; where it has none near the start, the DVL's."""
    at_ns = np.array([pose.start_ns])
    if apart_s(reference.time_ns, reference.velocity_n, at_ns)[0] <= FAR_S:
        return _Velocity(at_time(reference.time_ns, reference.velocity_n, pose.start_ns))
    return _velocity_by_dvl(given, pose)


def _velocity_by_dvl(given: _Given, pose: _Pose) -> _Velocity:
    """Return the velocity of the level's first ping, carried to the start; without a level of the nearest ping."""
    level = pose.level
    if level is not None and level.pings:
        pings_ns = given.velocities.time_ns
        ping_ns = int(pings_ns[np.searchsorted(pings_ns, pose.start_ns)])
        velocity_b = level.velocity_b
        cov_b = level.velocity_cov_b
    else:
        ping_ns, velocity_b, cov_b = _nearest_ping(given, pose)
    # No less than the rounding of readings.
    cov_n = np.asarray(pose.mat_nb @ cov_b @ pose.mat_nb.T + LEAST_DVL_SD_MPS**2 * np.eye(3))
    found = note("start_velocity_dvl", away=abs(ping_ns - pose.start_ns) * 1e-9)
    return _Velocity(pose.mat_nb @ velocity_b, cov_n, (found,))


def _nearest_ping(given: _Given, pose: _Pose) -> tuple[int, Floats, Floats]:
    """Return time, velocity of the IMU in b, m/s, and covariance, m^2/s^2, of the ping nearest to the start."""
    imu = given.dive.imu
    velocities = given.velocities
    nearest = int(np.argmin(np.abs(velocities.time_ns - pose.start_ns)))
    ping_ns = int(velocities.time_ns[nearest])
    # What the gyros measure without any turn over ground.
    still_rate_b = given.gyro_bias_b + pose.mat_nb.T @ earth_rate_n(pose.place.position[0])
    rate_eb_b = at_time(imu.time_ns, imu.angular_rate_b, ping_ns) - still_rate_b
    velocity_b = velocities.velocity_b[nearest] - np.cross(rate_eb_b, given.arm_b)
    cov_b = given.baseline.velocity_cov(velocities)[nearest]
    change_cov = velocity_change_cov(velocities, nearest, pose.start_ns)
    return ping_ns, velocity_b, cov_b + change_cov


# --- Attitudes of others, and what contradicts them.


def _sensor_attitude(given: _Given) -> tuple[int, Floats, Note]:
    """Return time and value of the AHRS's first attitude in the span; a configured heading replaces its own."""
    time_ns = given.dive.sensors["heading"].time_ns
    mats_nb = given.dive.sensors["heading"].mat_nb
    if mats_nb is None:
        raise LogError(
            'initial.source is "sensor", but the heading messages have no roll and pitch',
            "set heading.roll and heading.pitch, or start level: --set initial.source=level",
        )
    in_span = (time_ns >= given.start_ns) & (time_ns < given.end_ns)
    inside = in_span & np.isfinite(mats_nb).all(axis=(1, 2))
    if not inside.any():
        raise LogError(
            "the heading sensor has no attitude between the first and the last IMU sample of the span",
            "compare heading.stamp with imu.stamp, or widen --start and --end",
        )
    row = int(np.argmax(inside))
    first_ns = int(time_ns[row])
    mat_nb = mats_nb[row]
    roll, pitch, heading = rpy_from_mat(mat_nb)
    if given.heading_deg is not None:
        heading = given.heading_deg * DEG
        mat_nb = mat_from_rpy(np.array([roll, pitch, heading]))
    found = note(
        "start_attitude_sensor",
        roll=roll / DEG,
        pitch=pitch / DEG,
        since=(first_ns - given.start_ns) / NS_PER_S,
        heading=heading / DEG % 360.0,
    )
    return first_ns, mat_nb, found


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
    if located.any():
        inside = located
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
    notes = list[Note]()
    horizontal = reference.position[:, :2].copy()
    # So that 180 deg lies between no two rows.
    first_longitude = horizontal[np.argmax(np.isfinite(horizontal).all(axis=1)), 1]
    horizontal[:, 1] = wrap_angle(horizontal[:, 1] - first_longitude)
    latitude, longitude = at_time(reference.time_ns, horizontal, start_ns)
    height_m = initial.height_m
    quantities = {"position": horizontal}
    if reference.known["heights"].any():
        quantities["height"] = reference.position[:, 2:]
        height_m = at_time(reference.time_ns, quantities["height"], start_ns)[0]
    else:
        notes.append(note("start_height_configured", height=height_m))
    for quantity, values in quantities.items():
        far_s = float(apart_s(reference.time_ns, values, np.array([start_ns]))[0])
        if far_s > FAR_S:
            notes.append(note(f"start_{quantity}_far", quantity=quantity, away=far_s))
            break
    given_deg = initial.latitude_deg
    latitude_deg = float(latitude) / DEG
    if given_deg is not None and abs(given_deg - latitude_deg) > LATITUDE_LIMIT_DEG:
        notes.append(
            note("start_latitude_contradiction", configured=given_deg, found=latitude_deg)
        )
    return np.array([latitude, float(wrap_angle(longitude + first_longitude)), height_m]), notes


def _apart_deg(heading_deg: float, other_deg: float) -> float:
    return abs(float(wrap_angle(np.asarray((heading_deg - other_deg) * DEG)))) / DEG


def _heading_notes(given: _Given, pose: _Pose) -> list[Note]:
    """Compare the heading with the settings', where it is the reference's, else with the reference's near the start."""
    reference = given.dive.reference
    heading_deg = float(rpy_from_mat(pose.mat_nb)[2]) / DEG
    if pose.attitude == AttitudeSource.REFERENCE:
        idle_deg = given.heading_deg
        if idle_deg is None or _apart_deg(idle_deg, heading_deg) <= GIVEN_HEADING_LIMIT_DEG:
            return []
        return [note("start_heading_idle", configured=idle_deg, found=heading_deg % 360.0)]
    if reference is None or not reference.has_attitude:
        return []
    known = reference.rows(reference.known["attitudes"])
    row = int(np.argmin(np.abs(known.time_ns - pose.start_ns)))
    found_deg = float(rpy_from_mat(known.mat_nb[row])[2]) / DEG
    is_far = abs(int(known.time_ns[row]) - pose.start_ns) * 1e-9 > FAR_S
    if is_far or _apart_deg(heading_deg, found_deg) <= HEADING_LIMIT_DEG:
        return []
    return [
        note("start_heading_contradiction", heading=heading_deg % 360.0, found=found_deg % 360.0)
    ]


def _level_notes(
    level: Level,
    mat_nb: Floats,
    cov: Floats,
    *,
    is_sensed: bool,
) -> list[Note]:
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
