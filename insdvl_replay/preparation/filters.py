"""From settings to what each filter measures, with which noise, and from readings of sensors to measurements."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec.structs import asdict

from insdvl_replay.core.config import Acceleration, Config, Filter, InertialNoise
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, SensorColumns, TimeNs, seconds
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.held_out import HeldOut, held_out_name
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG, FASTEST_MPS, MORE_STATES, SENSORS, states_for
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import DvlMounting, north_east_m
from insdvl_replay.nav import kalman
from insdvl_replay.nav.dvl import (
    DvlBeams,
    DvlVelocities,
    acceleration_measurement,
    beam_measurements,
    slope_windows,
    velocity_cov,
    velocity_measurement,
)
from insdvl_replay.nav.error_model import noise_density
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import (
    DEPTH,
    FIX,
    HEADING,
    PUBLISHED,
    WINDOWED,
    Measurement,
    sensor_measurement,
)
from insdvl_replay.nav.timeline import FIRST_OTHER, NO_GAPS, Gaps

NO_SENSORS: Final[Mapping[str, Measurement]] = MappingProxyType({})
NO_READINGS: Final[Mapping[str, int]] = MappingProxyType({})
# neither a track reckoned until the start nor a position from a map is off by more
FAR_M: Final = 1000.0
# a pause between readings is noted above this, and so many usual ones
SILENT_S = 30.0
SILENT_READINGS = 20.0
MEASUREMENT_NOISE: Final = {
    "fixed": kalman.FIXED,
    "adaptive": kalman.ADAPTIVE,
    "student-t": kalman.STUDENT_T,
}
KINDS: Final = {"depth": DEPTH, "heading": HEADING, "position": FIX}
# sd of the depth sensor's zero: from the settings, or to be found by the first reading
KNOWN_M = 1e-3
UNKNOWN_M = 1e3
# of more states at the start, SI units
MORE_SD: Final[dict[str, Callable[[Config], tuple[float, ...]]]] = {
    "position": lambda config: config.initial.position_sd_m,
    "dvl_scale": lambda config: (0.01 * config.initial.dvl_scale_sd_pct,),
    "dvl_yaw": lambda config: (DEG * config.initial.dvl_yaw_sd_deg,),
    "depth_zero": lambda config: (
        UNKNOWN_M if config.depth.surface_height_m is None else KNOWN_M,
    ),
    "heading_bias": lambda config: (DEG * config.heading.bias_sd_deg,),
}


class DvlNoise(NamedTuple):
    """The DVL's noise: of one beam, or of each axis of a velocity from all beams."""

    key: Literal["beam_sd_mps", "velocity_sd_mps"]
    sd_mps: float


@dataclass(frozen=True)
class ResolvedFilter:
    """A filter with its own settings, or the common ones in their place."""

    name: str
    # ``velocity``, ``acceleration``, in the order in which they are applied
    aiding: tuple[str, ...]
    dvl_noise: DvlNoise
    inertial_noise: InertialNoise
    gate_probability: float
    # rejected velocities in a row after which the INS is set to the DVL; 0: never
    gate_reopen_after: int
    acceleration: Acceleration
    states: tuple[str, ...]  # names in `states.MORE_STATES`, beside the twelve
    # the filter is compared with it and not aided by it
    held_out: HeldOut
    measurement_noise: int  # how R of velocity and beams is taken, see `nav.kalman`
    more_sd: Floats  # (n - 12,) sd of the states beside the twelve at the start, SI units
    more_density: Floats  # (n - 12,) density of their process noise
    heading_bias_rate_hz: float  # see `filter.run_filter`
    noise_factors: str | None = None  # ``module:Class``

    def gate(self, size: int) -> float:
        """Return the largest NIS of so many components that is used; infinite where every innovation is."""
        # scipy: only before filters run
        from insdvl_replay.evaluation.consistency import chi_square_quantile

        return chi_square_quantile(self.gate_probability, size)

    @property
    def used_aiding(self) -> tuple[str, ...]:
        """The part of its aiding that is not held out."""
        return self.held_out.given(self.aiding)

    @property
    def constants(self) -> int:
        """How many of its states are constants of the sensors."""
        return sum(len(MORE_STATES[block]) for block in self.states if block != "position")

    @property
    def noise_density(self) -> Floats:
        """Process noise, shape (n,), see `error_model.noise_density`."""
        return np.concatenate([noise_density(**asdict(self.inertial_noise)), self.more_density])

    def velocity_cov(self, velocities: DvlVelocities) -> Floats:
        """Return the covariance of each ping's velocity, shape (m, 3, 3), m^2/s^2."""
        return velocity_cov(
            velocities, self.dvl_noise.sd_mps, for_one_beam=self.dvl_noise.key == "beam_sd_mps"
        )

    def beam_sd_mps(self, velocities: DvlVelocities) -> float:
        """Return the noise of one beam; that of a velocity is the mean over its axes of what all beams make."""
        if self.dvl_noise.key == "beam_sd_mps":
            return self.dvl_noise.sd_mps
        return self.dvl_noise.sd_mps / float(np.sqrt(np.trace(velocities.full_unit_cov_b) / 3.0))

    def measurements(
        self,
        velocities: DvlVelocities,
        mounting: DvlMounting,
        gaps: Gaps = NO_GAPS,
        sensors: Mapping[str, Measurement] = NO_SENSORS,  # from `prepare_sensors`
        beams: DvlBeams | None = None,
    ) -> tuple[Measurement, ...]:
        """Prepare what aids the filter, in its order, then what is held out.

        In long gaps of the IMU the turn rate is unknown, and with it the velocity of the lever arm.
        """
        cov_b = self.velocity_cov(velocities) + gaps.swing_cov(
            velocities.time_ns, mounting.lever_arm_b
        )
        found = list[Measurement]()
        for aid in self.used_aiding:
            if aid == "velocity":
                found.append(self._as_set(velocity_measurement(velocities, cov_b)))
            elif aid == "beams":
                found += self._beams(beams, velocities, mounting, gaps)
            elif aid == "acceleration":
                found.append(self._acceleration(velocities, cov_b, gaps))
            else:
                found.append(sensors[aid])
        used = [replace(measurement, gate=self.gate(measurement.size)) for measurement in found]
        held_out = list[Measurement]()
        for sensor in self.held_out.sensors:
            measurement = sensors[sensor]
            name = held_out_name(measurement.name)
            held_out.append(replace(measurement, name=name).held_out())
        return (*used, *held_out)

    def _as_set(self, measurement: Measurement) -> Measurement:
        """Give a measurement of the velocity the filter's settings for it."""
        return replace(
            measurement, noise=self.measurement_noise, reopen_after=self.gate_reopen_after
        )

    def _beams(
        self,
        beams: DvlBeams | None,
        velocities: DvlVelocities,
        mounting: DvlMounting,
        gaps: Gaps,
    ) -> list[Measurement]:
        """Prepare each beam; all swing together and are used independently, so together they say as much as one."""
        if beams is None:
            raise ConfigError(
                f"filters.{self.name} is aided by beams, but the DVL has velocities only",
                'aiding = ["velocity"]; if the log has beams, set dvl.kind and dvl.beam_velocity',
            )
        swing_cov_b = gaps.swing_cov(beams.time_ns, mounting.lever_arm_b)
        by_beam = beam_measurements(beams, self.beam_sd_mps(velocities))
        found = []
        for beam in by_beam:
            swing_var = len(by_beam) * (swing_cov_b @ beam.direction_b @ beam.direction_b)
            found.append(self._as_set(replace(beam, cov=beam.cov + swing_var[:, None, None])))
        return found

    def _acceleration(
        self,
        velocities: DvlVelocities,
        cov_b: Floats,
        gaps: Gaps,
    ) -> Measurement:
        """Prepare the slopes of the velocity; none is used whose window, or the reading at its ping, is in a gap."""
        settings = self.acceleration
        time_ns = velocities.time_ns
        windows = slope_windows(
            seconds(time_ns, time_ns[:1]),
            settings.window,
            settings.order,
            settings.max_window_gap_s,
        )
        acceleration = acceleration_measurement(
            velocities,
            cov_b,
            windows,
            kind=WINDOWED if settings.model == "windowed" else PUBLISHED,
            sd_mps2=settings.sd_mps2,
            accel_white_mps_rts=self.inertial_noise.accel_white_mps_rts,
        )
        first = np.maximum(np.arange(len(time_ns)) - settings.window + 1, 0)
        seen = windows.complete & ~gaps.overlap(time_ns[first], time_ns)
        return replace(acceleration, available=seen)


def resolve_filter(name: str, filter_: Filter, config: Config) -> ResolvedFilter:
    """Resolve what a filter takes from the sections that all filters share."""
    held_out = config.held_out
    needed = {*filter_.states, *states_for(held_out.given(filter_.aiding))}
    states = tuple(block for block in MORE_STATES if block in needed)
    more_sd = list[float]()
    fading = list[bool]()
    for block in states:
        more_sd += MORE_SD[block](config)
        fading += [block == "heading_bias"] * len(MORE_STATES[block])
    # A Gauss-Markov process keeps its variance where its noise has the density 2 sd^2 / time.
    rate_hz = 1.0 / config.heading.bias_time_s
    sds = np.array(more_sd, np.float64)
    more_density = 2.0 * rate_hz * np.array(fading, np.float64) * sds**2
    return ResolvedFilter(
        name=name,
        aiding=filter_.aiding,
        dvl_noise=_dvl_noise(filter_, config),
        inertial_noise=_inertial_noise(filter_, config),
        gate_probability=filter_.gate_probability,
        gate_reopen_after=filter_.gate_reopen_after,
        acceleration=filter_.acceleration or Acceleration(),
        states=states,
        held_out=held_out,
        measurement_noise=MEASUREMENT_NOISE[filter_.dvl_noise],
        more_sd=sds,
        more_density=more_density,
        heading_bias_rate_hz=rate_hz,
        noise_factors=filter_.noise_factors,
    )


def _dvl_noise(filter_: Filter, config: Config) -> DvlNoise:
    """Return the noise of the filter's own section, else that of ``[dvl]``; of two in a section the beams'."""
    for section in (filter_, config.dvl):
        if section.beam_sd_mps is not None:
            return DvlNoise("beam_sd_mps", section.beam_sd_mps)
        if section.velocity_sd_mps is not None:
            return DvlNoise("velocity_sd_mps", section.velocity_sd_mps)
    raise ValueError("[dvl] has no noise")


def _inertial_noise(filter_: Filter, config: Config) -> InertialNoise:
    """Return the noise of ``[noise]``, with what the filter's own section has instead."""
    found = {}
    for key in InertialNoise.__struct_fields__:
        found[key] = getattr(filter_, key)
        if found[key] is None:
            found[key] = getattr(config.noise, key)
    return InertialNoise(**found)


def resolve_filters(config: Config) -> tuple[ResolvedFilter, ...]:
    """Resolve all filters of a configuration that are run, the baseline first."""
    return tuple(
        resolve_filter(name, filter_, config) for name, filter_ in config.computed.items()
    )


def dvl_mounting(config: Config) -> DvlMounting:
    """Return how the configuration says that the DVL is mounted."""
    return DvlMounting.from_rpy(
        config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale
    )


def prepare_sensors(
    sensors: Mapping[str, SensorColumns],
    config: Config,
    start: Start,
    start_ns: int,
    end_ns: int,
    # by sensor, the reading that the start took, which is not used again
    used_ns: Mapping[str, int] = NO_READINGS,
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the sensors of a dive, without a gate; their rows of a time line begin at `timeline.FIRST_OTHER`."""
    found = dict[str, Measurement]()
    notes = list[Note]()
    for row, (name, columns) in enumerate(sensors.items(), start=FIRST_OTHER):
        inside = (columns.time_ns > start_ns) & (columns.time_ns <= end_ns)
        if not inside.any():
            raise LogError(
                f"no reading of the {name} sensor between the start and the end of the replay",
                f"compare {name}.stamp with imu.stamp, or widen --start and --end",
            )
        time_ns = columns.time_ns[inside]
        values = columns.values[inside]
        notes += silence_notes(name, time_ns, start_ns, end_ns)
        arm_m = (0.0, 0.0, 0.0)
        late_s = (int(time_ns[0]) - start_ns) / NS_PER_S
        if name == "depth":
            # The sensor's own zero is at the water's surface, or anywhere: values are below the ellipsoid.
            arm_m = config.depth.lever_arm_m
            surface_m = config.depth.surface_height_m
            sd = [config.depth.sd_m]
            if surface_m is None:
                arm_down_m = float((start.mat_nb @ np.array(arm_m))[2])
                surface_m = float(start.position[2]) - arm_down_m + float(values[0, 0])
                notes.append(note("depth_zero", surface=surface_m, late=late_s))
            values = values - surface_m
        elif name == "heading":
            sd = [config.heading.sd_deg * DEG]
        else:
            # Fixes have heights if these are used; the first must be where the vehicle can be.
            arm_m = config.position.lever_arm_m
            height_sd_m = config.position.height_sd_m
            sd = [config.position.sd_m] * 2
            away_m = float(np.hypot(*north_east_m(values[0], start.position, start.position)))
            if away_m > FAR_M + FASTEST_MPS * late_s:
                away_km = away_m / 1000.0
                fix_deg = values[0, :2] / DEG
                notes.append(
                    note("position_contradiction", late=late_s, away=away_km, fix=fix_deg)
                )
            if height_sd_m is None:
                values = values[:, :2]
            else:
                sd.append(height_sd_m)
        axes = SENSORS[name].components[: values.shape[1]]
        made = sensor_measurement(
            name, SENSORS[name].unit, KINDS[name], time_ns, values, np.array(sd), axes
        )
        made.available[time_ns == used_ns.get(name)] = False
        found[name] = replace(made, sensor=row, sensor_arm_b=np.array(arm_m))
    return found, tuple(notes)


def silence_notes(
    sensor: str,
    time_ns: TimeNs,
    start_ns: int,
    end_ns: int,
) -> list[Note]:
    """Note the longest pause between readings where it is far longer than others; fixes come at the surface alone."""
    ends_ns = np.concatenate([[start_ns], time_ns, [end_ns]])
    length_s = np.diff(ends_ns) / NS_PER_S
    longest = int(np.argmax(length_s))
    usual_s = 0.0
    if len(time_ns) > 1:
        usual_s = float(np.median(length_s[1:-1]))
    if length_s[longest] <= max(SILENT_S, SILENT_READINGS * usual_s):
        return []
    since_s = (int(ends_ns[longest]) - start_ns) / NS_PER_S
    span_s = (end_ns - start_ns) / NS_PER_S
    until = "to the end" if longest == len(time_ns) else "on"
    severity = Severity.INFO if sensor == "position" else Severity.WARNING
    values = {"length": length_s[longest], "span": span_s, "since": since_s, "until": until}
    return [note(f"{sensor}_silent", severity=severity, sensor=sensor, **values)]


def held_out_notes(config: Config) -> list[Note]:
    """Name the filters that a held-out sensor would aid."""
    notes = []
    for sensor in config.held_out.sensors:
        names = [name for name, filter_ in config.computed.items() if sensor in filter_.aiding]
        if names:
            notes.append(note(f"{sensor}_held_out", sensor=sensor, filters=", ".join(names)))
    return notes
