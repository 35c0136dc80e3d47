"""From settings to what each filter measures, with which noise, and from readings of sensors to measurements."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from msgspec.structs import asdict
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Acceleration, Config, Filter, Noise
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, SensorColumns, TimeNs
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.quantities import HELD_OUT
from insdvl_replay.core.states import DEG, FASTEST_MPS, MORE_STATES, SENSORS, states_for
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import DvlMounting, north_east_m
from insdvl_replay.nav.dvl import (
    DvlBeams,
    DvlVelocities,
    acceleration_measurement,
    beam_measurements,
    velocity_cov,
    velocity_measurement,
)
from insdvl_replay.nav.error_model import noise_density
from insdvl_replay.nav.kalman import ADAPTIVE, FIXED, STUDENT_T
from insdvl_replay.nav.levelling import SensorNoise, Start
from insdvl_replay.nav.measurements import (
    DEPTH,
    FIX,
    HEADING,
    PUBLISHED,
    WINDOWED,
    Measurement,
    hold_out,
    sensor_measurement,
)
from insdvl_replay.nav.timeline import FIRST_OTHER, NO_GAPS, Gaps
from insdvl_replay.preparation.gaps import lever_arm_velocity_cov

NO_SENSORS: Final[Mapping[str, Measurement]] = MappingProxyType({})
NO_READINGS: Final[Mapping[str, int]] = MappingProxyType({})
FAR_M: Final = 1000.0  # neither a track reckoned until the start nor a position from a map is off by more
SILENT_S, SILENT_READINGS = 30.0, 20.0  # a pause between readings is noted above this, and so many usual ones
MEASUREMENT_NOISE: Final = {"fixed": FIXED, "adaptive": ADAPTIVE, "student-t": STUDENT_T}
KNOWN_M, UNKNOWN_M = 1e-3, 1e3  # sd of the depth sensor's zero: from the settings, or to be found by the first reading
MORE_SD: Final[dict[str, Callable[[Config], tuple[float, ...]]]] = {  # of more states at the start, SI units
    "position": lambda config: config.initial.position_sd_m,
    "dvl_scale": lambda config: (0.01 * config.initial.dvl_scale_sd_pct,),
    "dvl_yaw": lambda config: (DEG * config.initial.dvl_yaw_sd_deg,),
    "depth_zero": lambda config: (UNKNOWN_M if config.depth.surface_height_m is None else KNOWN_M,),
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
    aiding: tuple[str, ...]  # ``velocity``, ``acceleration``, in the order in which they are applied
    dvl_noise: DvlNoise
    inertial_noise: Noise
    gate_probability: float
    gate_reopen_after: int  # rejected velocities in a row after which the INS is set to the DVL; 0: never
    acceleration: Acceleration
    states: tuple[str, ...]  # names in `states.MORE_STATES`, beside the twelve
    held_out: tuple[str, ...]  # sensors that are held out: they judge the filter and do not aid it
    measurement_noise: int  # how R of velocity and beams is taken, see `nav.kalman`
    more_sd: Floats  # (n - 12,) sd of the states beside the twelve at the start, SI units
    more_density: Floats  # (n - 12,) density of their process noise
    heading_bias_rate_hz: float  # see `filter.run_filter`

    def gate(self, size: int) -> float:
        """Return the largest NIS of so many components that is used; infinite where every innovation is."""
        from insdvl_replay.evaluation.consistency import chi_square_quantile  # scipy: only before filters run

        return chi_square_quantile(self.gate_probability, size)

    @property
    def constants(self) -> int:
        """How many of its states are constants of the sensors."""
        return sum(len(MORE_STATES[block]) for block in self.states if block != "position")

    @property
    def noise_density(self) -> Floats:
        """Process noise, shape (n,), see `error_model.noise_density`."""
        return np.concatenate([noise_density(**asdict(self.inertial_noise)), self.more_density])

    def sensor_noise(self, velocities: DvlVelocities) -> SensorNoise:
        """Return the noise with which the level is found."""
        return SensorNoise(self._velocity_cov(velocities), self.inertial_noise.accel_white_mps_rts)

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
        arm_b, gate, reopen_after = mounting.lever_arm_b, self.gate(3), self.gate_reopen_after
        cov_b = self._velocity_cov(velocities) + lever_arm_velocity_cov(gaps, velocities.time_ns, arm_b)
        found = list[Measurement]()
        for word in (word for word in self.aiding if word not in self.held_out):
            if word == "velocity":
                velocity = velocity_measurement(velocities, cov_b, gate, reopen_after)
                found.append(replace(velocity, noise=self.measurement_noise))
            elif word == "beams":
                if beams is None:
                    raise ConfigError(
                        f"filters.{self.name} is aided by beams, and the DVL gives velocities alone",
                        'aiding = ["velocity"]; dvl.kind and dvl.beam_velocity say where beams stand',
                    )
                swing_cov_b = lever_arm_velocity_cov(gaps, beams.time_ns, arm_b)
                by_beam = beam_measurements(beams, self.beam_sd_mps(velocities), self.gate(1), reopen_after)
                for beam in by_beam:
                    # All beams swing together and are used independently: together they must say as much as one.
                    swing_var = len(by_beam) * (swing_cov_b @ beam.direction_b @ beam.direction_b)
                    cov = beam.cov + swing_var[:, None, None]
                    found.append(replace(beam, cov=cov, noise=self.measurement_noise))
            elif word == "acceleration":
                acceleration = acceleration_measurement(
                    velocities,
                    cov_b,
                    kind=WINDOWED if self.acceleration.model == "windowed" else PUBLISHED,
                    window=self.acceleration.window,
                    order=self.acceleration.order,
                    max_gap_s=self.acceleration.max_window_gap_s,
                    sd_mps2=self.acceleration.sd_mps2,
                    accel_white_mps_rts=self.inertial_noise.accel_white_mps_rts,
                    gate=gate,
                )
                # Nor is one used whose window, or the reading at its ping, is in a gap.
                width, time_ns = acceleration.velocity_weights.shape[1], velocities.time_ns
                first = np.maximum(np.arange(len(time_ns)) - width + 1, 0)
                seen = acceleration.available & ~gaps.overlap(time_ns[first], time_ns)
                found.append(replace(acceleration, available=seen))
            else:
                found.append(replace(sensors[word], gate=self.gate(sensors[word].size)))
        held_out = (replace(sensors[word], name=f"{HELD_OUT}{sensors[word].name}") for word in self.held_out)
        return (*found, *map(hold_out, held_out))

    def _velocity_cov(self, velocities: DvlVelocities) -> Floats:
        """Return the covariance of each ping's velocity, shape (m, 3, 3), m^2/s^2."""
        return velocity_cov(velocities, self.dvl_noise.sd_mps, for_one_beam=self.dvl_noise.key == "beam_sd_mps")


def resolve_filter(name: str, filter_: Filter, config: Config) -> ResolvedFilter:
    """Resolve what a filter takes from the sections that all filters share; of two noises the beams' comes first."""
    held_out, rate_hz = config.evaluation.held_out, 1.0 / config.heading.bias_time_s
    needed = {*filter_.states, *states_for(word for word in filter_.aiding if word not in held_out)}
    states = tuple(block for block in MORE_STATES if block in needed)
    more_sd = np.array([sd for block in states for sd in MORE_SD[block](config)], dtype=np.float64)
    fades = np.array([block == "heading_bias" for block in states for _ in MORE_STATES[block]], dtype=np.float64)
    own_noise = {key: value for key in Noise.__struct_fields__ if (value := getattr(filter_, key)) is not None}
    keys: tuple[Literal["beam_sd_mps", "velocity_sd_mps"], ...] = ("beam_sd_mps", "velocity_sd_mps")
    dvl_noise = ((key, getattr(section, key)) for section in (filter_, config.dvl) for key in keys)
    return ResolvedFilter(
        name,
        filter_.aiding,
        next(DvlNoise(key, sd_mps) for key, sd_mps in dvl_noise if sd_mps is not None),
        changed(config.noise, **own_noise),
        filter_.gate_probability,
        filter_.gate_reopen_after,
        filter_.acceleration or Acceleration(),
        states,
        held_out,
        MEASUREMENT_NOISE[filter_.dvl_noise],
        more_sd,
        # A Gauss-Markov process keeps its variance where its noise has the density 2 sd^2 / time.
        2.0 * rate_hz * fades * more_sd**2,
        rate_hz,
    )


def resolve_filters(config: Config) -> tuple[ResolvedFilter, ...]:
    """Resolve all filters of a configuration that are run, the baseline first."""
    return tuple(resolve_filter(name, filter_, config) for name, filter_ in config.computed.items())


def dvl_mounting(config: Config) -> DvlMounting:
    """Return how the configuration says that the DVL is mounted."""
    return DvlMounting.from_rpy(config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale)


def prepare_sensors(
    sensors: Mapping[str, SensorColumns],
    config: Config,
    start: Start,
    start_ns: int,
    end_ns: int,
    used_ns: Mapping[str, int] = NO_READINGS,  # by sensor, the reading that the start took, which is not used again
) -> tuple[dict[str, Measurement], tuple[Note, ...]]:
    """Prepare the sensors of a dive, without a gate; their rows of a time line begin at `timeline.FIRST_OTHER`."""
    found, notes = dict[str, Measurement](), list[Note]()
    for row, (name, columns) in enumerate(sensors.items(), start=FIRST_OTHER):
        inside = (columns.time_ns > start_ns) & (columns.time_ns <= end_ns)
        if not inside.any():
            raise LogError(
                f"no reading of the {name} lies between the start of the replay and its end",
                f"check {name}.stamp against imu.stamp, or widen --start and --end",
            )
        time_ns, values, settings = columns.time_ns[inside], columns.values[inside], getattr(config, name)
        notes += silence_notes(name, time_ns, start_ns, end_ns)
        kind, values, sd, note = _MEASURED[name](values, settings, start, (int(time_ns[0]) - start_ns) / NS_PER_S)
        notes += note
        axes = SENSORS[name].components[: values.shape[1]]
        measurement = sensor_measurement(name, SENSORS[name].unit, kind, time_ns, values, np.array(sd), axes=axes)
        measurement.available[time_ns == used_ns.get(name)] = False
        arm_b = np.array(getattr(settings, "lever_arm_m", (0.0, 0.0, 0.0)))
        found[name] = replace(measurement, sensor=row, lever_arm_b=arm_b)
    return found, tuple(notes)


_Measured = tuple[int, Floats, tuple[float, ...], list[Note]]  # kind of prediction, values (k, s), their sd


def _depth(depth_m: Floats, settings: Any, start: Start, late_s: float) -> _Measured:
    """Return depths below the ellipsoid: the sensor's own zero is at the water's surface, or anywhere."""
    surface_m, notes = settings.surface_height_m, list[Note]()
    if surface_m is None:
        arm_down_m = float((start.mat_nb @ np.array(settings.lever_arm_m))[2])
        surface_m = float(start.position[2]) - arm_down_m + float(depth_m[0, 0])
        text = (
            f"depth: 0 is taken to be {surface_m:.3f} m above the ellipsoid, by the first reading, {late_s:.2f} s "
            "after the start, and the height at the start; filters that are aided by it find out"
        )
        notes.append(Note("depth_zero", text, hint="depth.surface_height_m says it otherwise"))
    return DEPTH, depth_m - surface_m, (settings.sd_m,), notes


def _heading(heading: Floats, settings: Any, start: Start, late_s: float) -> _Measured:
    return HEADING, heading, (settings.sd_deg * DEG,), []


def _position(fixes: Floats, settings: Any, start: Start, late_s: float) -> _Measured:
    """Return fixes, with heights if these are used; the first must be where the vehicle can be."""
    notes, height_sd_m = list[Note](), settings.height_sd_m
    away_m = float(np.hypot(*north_east_m(fixes[0], start.position, start.position)))
    if away_m > FAR_M + FASTEST_MPS * late_s:
        latitude_deg, longitude_deg = fixes[0, :2] / DEG
        text = (
            f"the first fix, {late_s:.2f} s after the start, is {away_m / 1000.0:.3g} km from it: at latitude "
            f"{latitude_deg:.4f} deg, longitude {longitude_deg:.4f} deg"
        )
        hint = (
            "position.latitude, position.longitude and position.angle_unit; or initial.latitude_deg and longitude_deg"
        )
        notes.append(Note("position_contradiction", text, 1, Severity.WARNING, hint))
    if height_sd_m is None:
        return FIX, fixes[:, :2], (settings.sd_m,) * 2, notes
    return FIX, fixes, (settings.sd_m, settings.sd_m, height_sd_m), notes


_MEASURED: Final[dict[str, Callable[[Floats, Any, Start, float], _Measured]]] = {
    "depth": _depth,
    "heading": _heading,
    "position": _position,
}


def silence_notes(
    name: str,
    time_ns: TimeNs,  # (k,)
    start_ns: int,
    end_ns: int,
) -> list[Note]:
    """Note the longest pause between readings where it is far longer than others; fixes come at the surface alone."""
    ends_ns = np.concatenate([[start_ns], time_ns, [end_ns]])
    length_s = np.diff(ends_ns) / NS_PER_S
    longest = int(np.argmax(length_s))
    usual_s = float(np.median(length_s[1:-1])) if len(time_ns) > 1 else 0.0
    if length_s[longest] <= max(SILENT_S, SILENT_READINGS * usual_s):
        return []
    since_s, span_s = (int(ends_ns[longest]) - start_ns) / NS_PER_S, (end_ns - start_ns) / NS_PER_S
    until = "to the end" if longest == len(time_ns) else "on"
    text = (
        f"no reading of the {name} for {length_s[longest]:.0f} of {span_s:.0f} s, from {since_s:.0f} s after the start "
        f"{until}"
    )
    severity = Severity.INFO if name == "position" else Severity.WARNING
    return [Note(f"{name}_silent", text, severity=severity)]


def held_out_notes(config: Config) -> tuple[Note, ...]:
    """Name the filters that a held-out sensor would aid."""
    notes = list[Note]()
    for sensor in config.evaluation.held_out:
        if names := [name for name, filter_ in config.computed.items() if sensor in filter_.aiding]:
            text = f"the {sensor} is withheld, and does not aid {', '.join(names)}"
            hint = f'take "{sensor}" out of evaluation.held_out'
            notes.append(Note(f"{sensor}_held_out", text, severity=Severity.WARNING, hint=hint))
    return tuple(notes)
