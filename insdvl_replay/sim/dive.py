"""Simulate a dive with perfect sensors, or with sensor errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from types import MappingProxyType
from typing import Any, Final, TypeVar

import numpy as np

from insdvl_replay.core.config import Vector
from insdvl_replay.core.dive_columns import (
    Dive,
    DvlColumns,
    ImuColumns,
    ReferenceColumns,
    SensorColumns,
    TimeNs,
    TruthColumns,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, require_known
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import AZIMUTH_DEG
from insdvl_replay.geometry.rotation import mat_from_sines, turned
from insdvl_replay.sim.sensor_errors import (
    GRADES,
    SIMULATED,
    DvlErrors,
    ImuErrors,
    LostBeam,
    SensorErrors,
    add_dvl_errors,
    add_imu_errors,
    add_sensor_errors,
    beam_vectors_d,
)
from insdvl_replay.sim.trajectories import SCENARIOS, Motion, Scenario, Trajectory, sine_and_cosine

LONGEST_S: Final = 7 * 86400.0  # a week at 100 Hz already fills 10 GB
START_NS: Final = 1_704_067_200_000_000_000  # first IMU sample of every dive, 2024-01-01T00:00:00Z
FIRST_PING_S: Final = 0.3717  # pings are between IMU samples, as in real logs
BLOCK: Final = 100_000  # IMU samples per block, to limit the memory for a long dive

NO_SENSORS: Final[Mapping[str, SensorErrors]] = MappingProxyType({})
NO_RATES: Final[Mapping[str, float]] = MappingProxyType({})

T = TypeVar("T")


def named(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Return the entry with this name; the ConfigError for an unknown name suggests another."""
    require_known(kind, name, known)
    return known[name]


def simulate_dive(
    scenario: str,
    *,
    seed: int = 1,  # of every error; not negative
    grade: str = "fog",
    imu_errors: ImuErrors | None = None,  # instead of the grade's
    dvl_errors: DvlErrors | None = None,
    # Besides IMU and DVL, by their names in `core.states.SENSORS`.
    sensors: Mapping[str, SensorErrors] = NO_SENSORS,
    dvl_delay_s: float = 0.0,
    dvl_scale: float = 1.0,
    **exact_options: Any,  # of `exact_dive`
) -> Dive:
    """Simulate a dive with sensor errors; the reference is the exact motion, truth contains the biases.

    The same arguments give the same bytes on every processor.
    """
    if imu_errors is None:
        imu_errors = named("IMU grade", grade, GRADES)
    rates_hz = {name: errors.rate_hz for name, errors in sensors.items()}
    exact = exact_dive(scenario, sensor_rates_hz=rates_hz, **exact_options)
    dive = add_errors(exact, imu_errors, dvl_errors or DvlErrors(), seed, sensors)
    return late_and_long(dive, dvl_delay_s, dvl_scale)


def late_and_long(dive: Dive, delay_s: float, scale: float) -> Dive:
    """Delay the stamps of the pings, and scale their velocities."""
    _check_positive("DVL scale", "times the velocity", scale)
    if not abs(delay_s) < LONGEST_S:
        raise ConfigError(f"DVL delay is {delay_s:g} s", "give the delay in s")
    if (delay_s, scale) == (0.0, 1.0) or dive.dvl.beam_velocity_mps is None:
        return dive
    late_ns = dive.dvl.time_ns + nanoseconds(delay_s)
    scaled_mps = scale * dive.dvl.beam_velocity_mps
    return replace(dive, dvl=replace(dive.dvl, time_ns=late_ns, beam_velocity_mps=scaled_mps))


@dataclass(frozen=True)
class _Course:
    """The exact motion of a dive, by the times of its log."""

    trajectory: Trajectory
    end_s: float

    def grid_ns(self, first_s: float, rate_hz: float) -> TimeNs:
        """Return the times of a sensor from its first reading to the end of the dive, (k,)."""
        # The end is included for any rounding.
        count = max(0, int(np.floor((self.end_s - first_s) * rate_hz + 1e-6)) + 1)
        offsets_s = first_s + np.arange(count) / rate_hz
        return START_NS + np.rint(offsets_s * 1e9).astype(np.int64)

    def at(self, time_ns: TimeNs) -> Motion:
        """Return the motion at times."""
        return self.trajectory.at(seconds(time_ns, START_NS))

    def imu(self, rate_hz: float) -> ImuColumns:
        """Return exact readings of an IMU, made block by block."""
        time_ns = self.grid_ns(0.0, rate_hz)
        blocks = np.array_split(time_ns, 1 + len(time_ns) // BLOCK)
        motions = [self.at(block) for block in blocks]
        forces_b = [motion.specific_force_b for motion in motions]
        rates_b = [motion.angular_rate_b for motion in motions]
        return ImuColumns(time_ns, np.concatenate(forces_b), np.concatenate(rates_b))

    def dvl(
        self,
        time_ns: TimeNs,
        lost: Sequence[LostBeam],
        lever_arm_m: Vector,
        mounting_rpy_deg: Vector,
    ) -> DvlColumns:
        """Return exact pings at times, NaN where a beam is lost."""
        time_s = seconds(time_ns, START_NS)
        vectors_d = beam_vectors_d()
        motion = self.at(time_ns)
        mat_db = mat_from_sines(*sine_and_cosine(np.array(mounting_rpy_deg) * DEG)).T
        velocity_b = turned(np.swapaxes(motion.mat_nb, -1, -2), motion.velocity_n)
        velocity_d = turned(mat_db, velocity_b + np.cross(motion.turn_rate_b, lever_arm_m))
        beam_velocity_mps = turned(vectors_d, velocity_d)
        for span in lost:
            is_lost = (time_s >= span.start_s) & (time_s < span.end_s)
            beam_velocity_mps[is_lost, span.beam] = np.nan
        return DvlColumns(time_ns, beam_velocity_mps, vectors_d)

    def sensor(self, name: str, rate_hz: float) -> SensorColumns:
        """Return exact readings of another sensor."""
        time_ns = self.grid_ns(0.0, rate_hz)
        motion = self.at(time_ns)
        values = named("sensor", name, SIMULATED).reading(motion)
        mat_nb = motion.mat_nb if name == "heading" else None
        return SensorColumns(time_ns, values, mat_nb)

    def reference(self, time_ns: TimeNs) -> ReferenceColumns:
        """Return the motion at times with as many digits as matter: below 0.1 mm, 1 um/s and 1 prad."""
        motion = self.at(time_ns)
        return ReferenceColumns(
            time_ns,
            position=np.round(motion.position, 11),
            velocity_n=np.round(motion.velocity_n, 6),
            mat_nb=np.round(motion.mat_nb, 12),
        )


def exact_dive(
    # A name in `trajectories.SCENARIOS`, or anything with the functions of a scenario.
    scenario: str | Scenario,
    *,
    duration_s: float | None = None,  # a longer one continues straight ahead
    imu_rate_hz: float = 100.0,  # starts with the dive, as the reference
    dvl_rate_hz: float = 1.0,  # starts at `FIRST_PING_S`
    reference_rate_hz: float = 5.0,
    reference_at_pings: bool = False,  # the reference has a row at the start and at each ping instead
    # Start and end, s, of spans with NaN in all beams.
    outages: Sequence[tuple[float, float]] = (),
    lost_beams: Sequence[LostBeam] = (),
    lever_arm_m: Vector = (0.0, 0.0, 0.0),  # IMU to DVL, in b
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0),  # the DVL's mounting rotation, d to b
    # Besides IMU and DVL; they start with the dive, at the IMU's place.
    sensor_rates_hz: Mapping[str, float] = NO_RATES,
) -> Dive:
    """Simulate a dive with perfect sensors. A Monte Carlo study needs it once, and `add_errors` for each run."""
    found = named("scenario", scenario, SCENARIOS) if isinstance(scenario, str) else scenario
    end_s = found.duration_s if duration_s is None else duration_s
    _check_positive("duration", "s", end_s)
    if end_s > LONGEST_S:
        text = f"duration is {end_s:g} s, more than {LONGEST_S:g} s"
        raise ConfigError(text, f"give at most {LONGEST_S:g} s")
    rates_hz = {"IMU": imu_rate_hz, "DVL": dvl_rate_hz, "reference": reference_rate_hz}
    for sensor, rate_hz in {**rates_hz, **sensor_rates_hz}.items():
        _check_positive(f"{sensor} rate", "Hz", rate_hz)
    if end_s * imu_rate_hz < 1.0:
        text = f"a dive of {end_s:g} s at {imu_rate_hz:g} Hz has less than two IMU samples"
        raise ConfigError(text, "give a longer duration, such as 60 s")
    lost = list(lost_beams)
    for start_s, stop_s in outages:
        lost += [LostBeam(beam, start_s, stop_s) for beam in range(len(AZIMUTH_DEG))]
    for span in lost:
        _check_span(span, end_s)
    _check_vector("lever arm", "m", lever_arm_m)
    _check_vector("mounting", "deg", mounting_rpy_deg)

    course = _Course(Trajectory(found, end_s), end_s)
    imu = course.imu(imu_rate_hz)
    ping_ns = course.grid_ns(FIRST_PING_S, dvl_rate_hz)
    dvl = course.dvl(ping_ns, lost, lever_arm_m, mounting_rpy_deg)
    sensors = {name: course.sensor(name, rate_hz) for name, rate_hz in sensor_rates_hz.items()}
    reference_ns = course.grid_ns(0.0, reference_rate_hz)
    if reference_at_pings:
        reference_ns = np.append(START_NS, ping_ns)
    reference = course.reference(reference_ns)
    unbiased = np.zeros_like(reference.velocity_n)
    return Dive(
        name=scenario if isinstance(scenario, str) else scenario.about,
        imu=imu,
        dvl=dvl,
        reference=reference,
        truth=TruthColumns(reference_ns, unbiased, unbiased),
        sensors=sensors,
    )


OPTIONS: Final = tuple(
    name
    for function in (simulate_dive, exact_dive)
    for name in signature(function).parameters
    if name not in ("scenario", "exact_options", "sensor_rates_hz")
)
"""The options of `simulate_dive` by name, with those of `exact_dive`."""


def _check_span(span: LostBeam, end_s: float) -> None:
    """Refuse an outage of a beam that ends before it starts, is outside the dive, or is of no beam."""
    beams = len(AZIMUTH_DEG)
    outage = f"an outage from {span.start_s:g} s to {span.end_s:g} s"
    hint = "give START:END in seconds from the start of the dive"
    if not span.start_s < span.end_s:
        raise ConfigError(f"{outage} must end after its start", hint)
    if span.start_s >= end_s or span.end_s <= 0.0:
        hint += ", or a longer duration"
        raise ConfigError(f"{outage} is outside the dive of {end_s:g} s", hint)
    if not 0 <= span.beam < beams:
        hint = f"beams are counted from 0 to {beams - 1}"
        raise ConfigError(f"beam {span.beam} does not exist", hint)


def _check_vector(what: str, unit: str, vector: Vector) -> None:
    if np.shape(vector) != (3,) or not np.isfinite(vector).all():
        text = f"{what} must be three finite numbers, found {vector}"
        raise ConfigError(text, f"give the {what} in {unit}")


def _check_positive(what: str, unit: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        text = f"{what} must be above 0, found {value:g} {unit}"
        raise ConfigError(text, f"give the {what} in {unit}")


def add_errors(
    exact: Dive,
    imu_errors: ImuErrors,
    dvl_errors: DvlErrors,
    seed: int,  # not negative
    sensor_errors: Mapping[str, SensorErrors] = NO_SENSORS,
) -> Dive:
    """Add sensor errors to an exact dive, with the biases as truth, at the times of the exact dive's truth.

    Accelerometers, gyros and DVL have separate random streams. numpy's ziggurat calls the C library's logarithm once in
    thousands of draws; readings are rounded to their quantum afterwards.
    """
    if seed < 0:
        raise ConfigError(f"seed must be at least 0, found {seed}", f"for example {-seed}")
    if exact.truth is None:
        raise ValueError("errors are added to an exact dive, which holds truth")
    accel_rng, gyro_rng, dvl_rng = map(
        np.random.default_rng, np.random.SeedSequence(seed).spawn(3)
    )
    imu, biases = add_imu_errors(exact.imu, imu_errors, accel_rng, gyro_rng)
    time_ns = exact.truth.time_ns
    latest = np.searchsorted(biases.time_ns, time_ns, side="right") - 1
    truth = TruthColumns(
        time_ns,
        np.round(biases.accel_bias_b[latest], 10),
        np.round(biases.gyro_bias_b[latest], 14),
    )
    sensors = {}
    for name, errors in sensor_errors.items():
        rng = np.random.default_rng([seed, *name.encode()])
        sensors[name] = add_sensor_errors(name, exact.sensors[name], errors, rng)
    dvl = add_dvl_errors(exact.dvl, dvl_errors, dvl_rng)
    return replace(
        exact,
        imu=imu,
        dvl=dvl,
        truth=truth,
        sensors=sensors,
    )
