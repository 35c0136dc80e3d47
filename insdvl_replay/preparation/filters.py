"""From the configuration of a filter to its measurements and its noise: every key resolved once."""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import msgspec
import numpy as np

from insdvl_replay.core.config import Acceleration, Config, Filter, Noise
from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.quantities import WITHHELD
from insdvl_replay.core.states import DEG, MORE_STATES, states_for
from insdvl_replay.geometry.frames import DvlMounting
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
from insdvl_replay.nav.levelling import SensorNoise
from insdvl_replay.nav.measurements import PUBLISHED, WINDOWED, Measurement, withheld
from insdvl_replay.nav.timeline import NO_GAPS, Gaps
from insdvl_replay.preparation.long_gaps import lever_arm_velocity_cov

NO_SENSORS: Final[Mapping[str, Measurement]] = MappingProxyType({})


class DvlNoise(NamedTuple):
    """The DVL's noise as one filter takes it: of one beam, or of each axis of a velocity from all beams."""

    key: Literal["beam_sd_mps", "velocity_sd_mps"]
    sd_mps: float


@dataclass(frozen=True)
class ResolvedFilter:
    """A filter of the configuration in which nothing is left open: its own keys, or the common ones in their place.

    Attributes
    ----------
    aiding : tuple of str
        ``velocity``, ``acceleration``, in the order in which they are applied.
    gate_probability : float
        See `gate`.
    gate_reopen_after : int
        Rejected velocities in a row after which the INS is set to the DVL; 0: never.
    acceleration : Acceleration
        How accelerations are fitted, for a filter that is aided by them.
    states : tuple of str
        Names in `states.MORE_STATES` of what it estimates beside the twelve.
    withheld : tuple of str
        Sensors of whose readings it is not told, but by which it is judged.
    measurement_noise : int
        How R of velocity and beams is taken, see `nav.kalman`.
    more_sd, more_density : ndarray, shape (n - 12,)
        Standard deviations of these states at the start, and the density of their process noise, SI units.
    heading_bias_rate_hz : float
        See `filter.run_filter`.
    """

    name: str
    aiding: tuple[str, ...]
    dvl_noise: DvlNoise
    inertial_noise: Noise
    gate_probability: float
    gate_reopen_after: int
    acceleration: Acceleration
    states: tuple[str, ...]
    withheld: tuple[str, ...]
    measurement_noise: int
    more_sd: Floats
    more_density: Floats
    heading_bias_rate_hz: float

    def gate(self, size: int) -> float:
        """Return the largest NIS of so many components that is used; infinite where every innovation is."""
        # Not imported before it is needed: what is asked before the filters run does not wait for it.
        from insdvl_replay.evaluation.chi_square import chi_square_quantile

        return chi_square_quantile(self.gate_probability, size)

    @property
    def constants(self) -> int:
        """How many of its states are constants of the sensors."""
        return sum(len(MORE_STATES[block]) for block in self.states if block != "position")

    @property
    def noise_density(self) -> Floats:
        """Process noise, shape (n,), see `error_model.noise_density`."""
        return np.concatenate([noise_density(**msgspec.structs.asdict(self.inertial_noise)), self.more_density])

    def sensor_noise(self, velocities: DvlVelocities) -> SensorNoise:
        """Return the noise with which the level is found."""
        return SensorNoise(self._ping_cov(velocities), self.inertial_noise.accel_white_mps_rts)

    def measurements(
        self,
        velocities: DvlVelocities,
        mounting: DvlMounting,
        gaps: Gaps = NO_GAPS,
        sensors: Mapping[str, Measurement] = NO_SENSORS,
        beams: DvlBeams | None = None,
    ) -> tuple[Measurement, ...]:
        """Prepare what the filter is aided by, in its order, then what is withheld from it.

        In the IMU's long gaps the lever arm swings unseen, and no window of accelerations spans any part of one.

        Parameters
        ----------
        sensors : mapping of str to Measurement
            From `sensors.prepare_sensors`.
        beams : DvlBeams or None
            Of a DVL that has them.
        """
        cov_b = self._ping_cov(velocities) + lever_arm_velocity_cov(gaps, velocities.time_ns, mounting.lever_arm_b)
        found = list[Measurement]()
        for word in (word for word in self.aiding if word not in self.withheld):
            if word == "beams":
                found += self._beams(velocities, mounting, gaps, beams)
            else:
                found.append(self._measurement(word, velocities, cov_b, gaps, sensors))
        return (*found, *(_withheld(sensors[name]) for name in self.withheld))

    def _beams(
        self, velocities: DvlVelocities, mounting: DvlMounting, gaps: Gaps, beams: DvlBeams | None
    ) -> Iterator[Measurement]:
        """Prepare beams, whose noise follows from that of velocities if only this is told."""
        if beams is None:
            raise ConfigError(
                f"filters.{self.name} is aided by beams, and the DVL gives velocities alone",
                'aiding = ["velocity"]; dvl.kind and dvl.beam_velocity say where beams stand',
            )
        swing_cov_b = lever_arm_velocity_cov(gaps, beams.time_ns, mounting.lever_arm_b)
        found = beam_measurements(beams, self.beam_sd_mps(velocities), self.gate(1), self.gate_reopen_after)
        for one in found:
            # All beams swing together, and are used as if each did by itself: so many of them say as much as one does.
            swing_var = len(found) * (swing_cov_b @ one.direction_b @ one.direction_b)
            yield dataclasses.replace(one, cov=one.cov + swing_var[:, None, None], noise=self.measurement_noise)

    def beam_sd_mps(self, velocities: DvlVelocities) -> float:
        """Return the noise of one beam: that of which all beams make, in the mean of the axes, that of a velocity."""
        if self.dvl_noise.key == "beam_sd_mps":
            return self.dvl_noise.sd_mps
        return self.dvl_noise.sd_mps / float(np.sqrt(np.trace(velocities.full_unit_cov_b) / 3.0))

    def _measurement(
        self, word: str, velocities: DvlVelocities, cov_b: Floats, gaps: Gaps, sensors: Mapping[str, Measurement]
    ) -> Measurement:
        if word == "velocity":
            velocity = velocity_measurement(velocities, cov_b, self.gate(3), self.gate_reopen_after)
            return dataclasses.replace(velocity, noise=self.measurement_noise)
        if word == "acceleration":
            return _seen(self._acceleration(velocities, cov_b), velocities.time_ns, gaps)
        return dataclasses.replace(sensors[word], gate=self.gate(sensors[word].size))

    def _ping_cov(self, velocities: DvlVelocities) -> Floats:
        """Return the covariance of each ping's velocity as the filter is told it, shape (m, 3, 3), m^2/s^2."""
        return velocity_cov(velocities, self.dvl_noise.sd_mps, of_one_beam=self.dvl_noise.key == "beam_sd_mps")

    def _acceleration(self, velocities: DvlVelocities, cov_b: Floats) -> Measurement:
        return acceleration_measurement(
            velocities,
            cov_b,
            kind=WINDOWED if self.acceleration.model == "windowed" else PUBLISHED,
            window=self.acceleration.window,
            order=self.acceleration.order,
            max_gap_s=self.acceleration.max_window_gap_s,
            sd_mps2=self.acceleration.sd_mps2,
            accel_white_mps_rts=self.inertial_noise.accel_white_mps_rts,
            gate=self.gate(3),
        )


def resolve_filter(name: str, filter_: Filter, config: Config) -> ResolvedFilter:
    """Resolve what a filter takes from the sections that all filters share.

    Of the DVL's noise, what the filter names itself, under either key, goes before ``[dvl]``. Where one of the two
    names both, the beams' goes first.
    """
    own = {key: getattr(filter_, key) for key in Noise.__struct_fields__}
    states, rate_hz = _states(filter_, config.evaluation.withheld), 1.0 / config.heading.bias_time_s
    more_sd = np.concatenate([np.empty(0), *(MORE_SD[block](config) for block in states)])
    fades = np.array([block == "heading_bias" for block in states for _ in MORE_STATES[block]], dtype=np.float64)
    return ResolvedFilter(
        name,
        filter_.aiding,
        _dvl_noise(filter_, config),
        msgspec.structs.replace(config.noise, **{key: value for key, value in own.items() if value is not None}),
        filter_.gate_probability,
        filter_.gate_reopen_after,
        filter_.acceleration or Acceleration(),
        states,
        config.evaluation.withheld,
        MEASUREMENT_NOISE[filter_.dvl_noise],
        more_sd,
        # A Gauss-Markov process keeps its variance where its noise has the density 2 sd^2 / time.
        2.0 * rate_hz * fades * more_sd**2,
        rate_hz,
    )


def _states(filter_: Filter, withheld: Collection[str]) -> tuple[str, ...]:
    """Name the blocks of states beside the twelve: those that are asked for, and those that its aiding needs."""
    needed = {*filter_.states, *states_for(word for word in filter_.aiding if word not in withheld)}
    return tuple(block for block in MORE_STATES if block in needed)


KNOWN_M, UNKNOWN_M = 1e-3, 1e3
"""Of a zero that the settings say, and of one that the first reading has to tell, by the height that a filter has then:
the gauge then knows nothing of how far off this is."""
MEASUREMENT_NOISE: Final = {"fixed": FIXED, "adaptive": ADAPTIVE, "student-t": STUDENT_T}
MORE_SD: Final[dict[str, Callable[[Config], Floats]]] = {
    "position": lambda config: np.array(config.initial.position_sd_m),
    "dvl_scale": lambda config: np.array([0.01 * config.initial.dvl_scale_sd_pct]),
    "dvl_yaw": lambda config: np.array([DEG * config.initial.dvl_yaw_sd_deg]),
    "depth_zero": lambda config: np.array([UNKNOWN_M if config.depth.surface_height_m is None else KNOWN_M]),
    "heading_bias": lambda config: np.array([DEG * config.heading.bias_sd_deg]),
}
"""Standard deviations of the blocks of `states.MORE_STATES` at the start, SI units."""


def resolve_filters(config: Config) -> tuple[ResolvedFilter, ...]:
    """Resolve all filters of a configuration that are run, the baseline first; see `resolve_filter`."""
    return tuple(resolve_filter(name, filter_, config) for name, filter_ in config.computed.items())


def dvl_mounting(config: Config) -> DvlMounting:
    """Return how the configuration says that the DVL is mounted."""
    return DvlMounting.of(config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale)


def _dvl_noise(filter_: Filter, config: Config) -> DvlNoise:
    for named in (filter_, config.dvl):
        if named.beam_sd_mps is not None:
            return DvlNoise("beam_sd_mps", named.beam_sd_mps)
        if named.velocity_sd_mps is not None:
            return DvlNoise("velocity_sd_mps", named.velocity_sd_mps)
    raise ValueError("[dvl] always has a velocity_sd_mps")


def _seen(measurement: Measurement, time_ns: TimeNs, gaps: Gaps) -> Measurement:
    """Withhold an acceleration wherever its window, or the reading at its ping, lies in a gap."""
    window = measurement.velocity_weights.shape[1]
    first = np.maximum(np.arange(len(time_ns)) - window + 1, 0)
    return dataclasses.replace(measurement, available=measurement.available & ~gaps.overlap(time_ns[first], time_ns))


def _withheld(sensor: Measurement) -> Measurement:
    return withheld(dataclasses.replace(sensor, name=f"{WITHHELD}{sensor.name}"))
