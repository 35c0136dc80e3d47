"""Simulate a dive with perfect sensors, or with sensor errors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    sensors: Mapping[
        str, SensorErrors
    ] = NO_SENSORS,  # besides IMU and DVL, by their names in `core.states.SENSORS`
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
    return replace(
        dive,
        dvl=replace(
            dive.dvl, time_ns=late_ns, beam_velocity_mps=scale * dive.dvl.beam_velocity_mps
        ),
    )


def exact_dive(
    scenario: str
    | Scenario,  # a name in `trajectories.SCENARIOS`, or anything with the functions of a scenario
    *,
    duration_s: float | None = None,  # a longer one continues straight ahead
    imu_rate_hz: float = 100.0,  # starts with the dive, as the reference
    dvl_rate_hz: float = 1.0,  # starts at `FIRST_PING_S`
    reference_rate_hz: float = 5.0,
    reference_at_pings: bool = False,  # the reference has a row at the start and at each ping instead
    outages: Sequence[tuple[float, float]] = (),  # start and end, s, of spans with NaN in all beams
    lost_beams: Sequence[LostBeam] = (),
    lever_arm_m: Vector = (0.0, 0.0, 0.0),  # IMU to DVL, in b
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0),  # the DVL's mounting rotation, d to b
    sensor_rates_hz: Mapping[
        str, float
    ] = NO_RATES,  # besides IMU and DVL; they start with the dive, at the IMU's place
) -> Dive:
    """Simulate a dive with perfect sensors. A Monte Carlo study needs it once, and `add_errors` for each run."""
    course = named("scenario", scenario, SCENARIOS) if isinstance(scenario, str) else scenario
    end_s = course.duration_s if duration_s is None else duration_s
    _check_positive("duration", "s", end_s)
    if end_s > LONGEST_S:
        raise ConfigError(
            f"duration is {end_s:g} s, more than {LONGEST_S:g} s", f"--duration {LONGEST_S:g}"
        )
    rates_hz = {
        "IMU": imu_rate_hz,
        "DVL": dvl_rate_hz,
        "reference": reference_rate_hz,
        **sensor_rates_hz,
    }
    for sensor, rate_hz in rates_hz.items():
        _check_positive(f"{sensor} rate", "Hz", rate_hz)
    if end_s * imu_rate_hz < 1.0:
        raise ConfigError(
            f"a dive of {end_s:g} s at {imu_rate_hz:g} Hz has less than two IMU samples",
            "--duration 60",
        )
    beams = len(AZIMUTH_DEG)
    spans = [*lost_beams, *(LostBeam(beam, *outage) for outage in outages for beam in range(beams))]
    for span in spans:
        if not span.start_s < span.end_s:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s must end after its start",
                "give START:END in seconds from the start of the dive",
            )
        if span.start_s >= end_s or span.end_s <= 0.0:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s is outside the dive of {end_s:g} s",
                "give START:END in seconds from the start of the dive, or a longer --duration",
            )
        if not 0 <= span.beam < beams:
            raise ConfigError(
                f"beam {span.beam} does not exist", f"beams are counted from 0 to {beams - 1}"
            )
    trajectory = Trajectory(course, end_s)

    def grid_ns(first_s: float, rate_hz: float) -> TimeNs:
        # The end is included for any rounding.
        count = max(0, int(np.floor((end_s - first_s) * rate_hz + 1e-6)) + 1)
        return START_NS + np.rint((first_s + np.arange(count) / rate_hz) * 1e9).astype(np.int64)

    def motion_at(time_ns: TimeNs) -> Motion:
        return trajectory.at(seconds(time_ns, START_NS))

    # The IMU, by blocks.
    imu_ns = grid_ns(0.0, imu_rate_hz)
    ping_ns = grid_ns(FIRST_PING_S, dvl_rate_hz)
    blocks = [motion_at(block) for block in np.array_split(imu_ns, 1 + len(imu_ns) // BLOCK)]
    forces_b = [block.specific_force_b for block in blocks]
    rates_b = [block.angular_rate_b for block in blocks]

    # The DVL.
    time_s = seconds(ping_ns, START_NS)
    vectors_d = beam_vectors_d()
    motion = motion_at(ping_ns)
    mat_db = mat_from_sines(*sine_and_cosine(np.array(mounting_rpy_deg) * DEG)).T
    velocity_b = turned(np.swapaxes(motion.mat_nb, -1, -2), motion.velocity_n)
    velocity_d = turned(mat_db, velocity_b + np.cross(motion.turn_rate_b, lever_arm_m))
    beam_velocity_mps = turned(vectors_d, velocity_d)
    for span in spans:
        beam_velocity_mps[(time_s >= span.start_s) & (time_s < span.end_s), span.beam] = np.nan

    # The other sensors, and the reference with as many digits as matter: below 0.1 mm, 1 um/s and 1 prad.
    sensors = {}
    for name, rate_hz in sensor_rates_hz.items():
        reading_ns = grid_ns(0.0, rate_hz)
        motion = motion_at(reading_ns)
        values = named("sensor", name, SIMULATED).reading(motion)
        sensors[name] = SensorColumns(
            reading_ns, values, motion.mat_nb if name == "heading" else None
        )
    reference_ns = (
        np.append(START_NS, ping_ns) if reference_at_pings else grid_ns(0.0, reference_rate_hz)
    )
    motion = motion_at(reference_ns)
    reference = ReferenceColumns(
        reference_ns,
        position=np.round(motion.position, 11),
        velocity_n=np.round(motion.velocity_n, 6),
        mat_nb=np.round(motion.mat_nb, 12),
    )
    unbiased = np.zeros_like(reference.velocity_n)
    return Dive(
        name=scenario if isinstance(scenario, str) else course.about,
        imu=ImuColumns(imu_ns, np.concatenate(forces_b), np.concatenate(rates_b)),
        dvl=DvlColumns(ping_ns, beam_velocity_mps, vectors_d),
        reference=reference,
        truth=TruthColumns(reference_ns, unbiased, unbiased),
        sensors=sensors,
    )


def _check_positive(what: str, unit: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise ConfigError(
            f"{what} must be above 0, found {value:g} {unit}", f"give the {what} in {unit}"
        )


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
        raise ConfigError(f"seed must be at least 0, found {seed}", f"--seed {-seed}")
    if exact.truth is None:
        raise ValueError("errors are added to an exact dive, which holds truth")
    accel_rng, gyro_rng, dvl_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)
    )
    sensor_rngs = {name: np.random.default_rng([seed, *name.encode()]) for name in sensor_errors}
    imu, biases = add_imu_errors(exact.imu, imu_errors, accel_rng, gyro_rng)
    time_ns = exact.truth.time_ns
    latest = np.searchsorted(biases.time_ns, time_ns, side="right") - 1
    return replace(
        exact,
        imu=imu,
        dvl=add_dvl_errors(exact.dvl, dvl_errors, dvl_rng),
        truth=TruthColumns(
            time_ns,
            np.round(biases.accel_bias_b[latest], 10),
            np.round(biases.gyro_bias_b[latest], 14),
        ),
        sensors={
            name: add_sensor_errors(name, exact.sensors[name], errors, sensor_rngs[name])
            for name, errors in sensor_errors.items()
        },
    )
