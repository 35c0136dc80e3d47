"""What a simulation can be asked for, and what it says to anything else.

A simulated dive: the exact one, and the one that sensors report of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final, TypeVar

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
from insdvl_replay.sim.trajectories import SCENARIOS, Scenario, Trajectory, sine_and_cosine

LONGEST_S: Final = 7 * 86400.0
"""No simulated dive is longer: a week at 100 Hz already fills 10 GB."""

T = TypeVar("T")


def named(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Look a name up, or say which one was meant.

    Parameters
    ----------
    kind : str
        What it names, for the error.

    Returns
    -------
    anything
        What the name stands for.

    Raises
    ------
    ConfigError
        The name is not known.
    """
    require_known(kind, name, known)
    return known[name]


def check_duration(duration_s: float) -> None:
    """Require a duration above 0 that memory holds; a `ConfigError` else."""
    check_positive("duration", "s", duration_s)
    if duration_s > LONGEST_S:
        raise ConfigError(
            f"duration is {duration_s:g} s, and may be {LONGEST_S:g} s at most", f"--duration {LONGEST_S:g}"
        )


def check_positive(what: str, unit: str, value: float) -> None:
    """Require a number above 0; a `ConfigError` else."""
    if not 0.0 < value < np.inf:
        raise ConfigError(f"{what} is {value:g} {unit}, and must be above 0", f"give the {what} in {unit}")


def check_spans(spans: Sequence[LostBeam], duration_s: float) -> None:
    """Require beams that there are, lost inside the dive until after they were; a `ConfigError` else."""
    beams = len(AZIMUTH_DEG)
    for span in spans:
        if not span.start_s < span.end_s:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s does not end after its start",
                "give its start first, then its end, in seconds from the start of the dive",
            )
        if span.start_s >= duration_s or span.end_s <= 0.0:
            raise ConfigError(
                f"an outage from {span.start_s:g} s to {span.end_s:g} s lies outside the dive, which lasts "
                f"{duration_s:g} s",
                "give its start and its end in seconds from the start of the dive, or a longer --duration",
            )
        if not 0 <= span.beam < beams:
            raise ConfigError(f"beam {span.beam} cannot be lost", f"beams are counted from 0 to {beams - 1}")


START_NS: Final = 1_704_067_200_000_000_000
"""Time of the first IMU sample of every dive, 2024-01-01T00:00:00Z."""
FIRST_PING_S: Final = 0.3717
"""Time of the first ping: pings fall between IMU samples, as they do at sea."""
BLOCK: Final = 100_000
"""IMU samples worked on at once, which bounds the memory that a long dive takes."""

NO_SENSORS: Final[Mapping[str, SensorErrors]] = MappingProxyType({})
NO_RATES: Final[Mapping[str, float]] = MappingProxyType({})


def simulate_dive(
    scenario: str,
    *,
    seed: int = 1,
    duration_s: float | None = None,
    grade: str = "fog",
    imu_rate_hz: float = 100.0,
    dvl_rate_hz: float = 1.0,
    reference_rate_hz: float = 5.0,
    outages: Sequence[tuple[float, float]] = (),
    lost_beams: Sequence[LostBeam] = (),
    imu_errors: ImuErrors | None = None,
    dvl_errors: DvlErrors | None = None,
    lever_arm_m: Vector = (0.0, 0.0, 0.0),
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0),
    sensors: Mapping[str, SensorErrors] = NO_SENSORS,
    dvl_delay_s: float = 0.0,
    dvl_scale: float = 1.0,
) -> Dive:
    """Simulate a dive as its sensors report it. The same arguments give the same bytes, whatever the processor.

    Parameters
    ----------
    scenario : str
        A name in `trajectories.SCENARIOS`.
    seed : int
        Of every error; not negative.
    grade : str
        A name in `sensor_errors.GRADES`.
    imu_errors, dvl_errors : optional
        Instead of the grade's errors, and of the defaults of `DvlErrors`.
    duration_s, imu_rate_hz, dvl_rate_hz, reference_rate_hz, outages, lost_beams, lever_arm_m, mounting_rpy_deg
        As in `exact_dive`.
    sensors : mapping of str to SensorErrors
        Those that the vehicle has beside IMU and DVL, by their names in `core.states.SENSORS`.
    dvl_delay_s, dvl_scale : float
        As in `late_and_long`.

    Returns
    -------
    Dive
        The reference is the exact motion; truth holds the biases.

    Raises
    ------
    ConfigError
        Unknown scenario or grade, or a number that cannot be.
    """
    if imu_errors is None:
        imu_errors = named("IMU grade", grade, GRADES)
    exact = exact_dive(
        scenario,
        duration_s=duration_s,
        imu_rate_hz=imu_rate_hz,
        dvl_rate_hz=dvl_rate_hz,
        reference_rate_hz=reference_rate_hz,
        outages=outages,
        lost_beams=lost_beams,
        lever_arm_m=lever_arm_m,
        mounting_rpy_deg=mounting_rpy_deg,
        sensor_rates_hz={name: errors.rate_hz for name, errors in sensors.items()},
    )
    dive = add_errors(exact, imu_errors, dvl_errors or DvlErrors(), seed, sensors)
    return late_and_long(dive, dvl_delay_s, dvl_scale)


def late_and_long(dive: Dive, delay_s: float, scale: float) -> Dive:
    """Stamp the pings later than they are valid, and let them read so many times the velocity.

    Raises
    ------
    ConfigError
        A scale that is not above 0, or a delay that is no number.
    """
    check_positive("DVL scale", "times the velocity", scale)
    if not abs(delay_s) < LONGEST_S:
        raise ConfigError(f"DVL delay is {delay_s:g} s", "give the delay in s")
    if (delay_s, scale) == (0.0, 1.0) or dive.dvl.beam_velocity_mps is None:
        return dive
    late_ns = dive.dvl.time_ns + nanoseconds(delay_s)
    return replace(dive, dvl=replace(dive.dvl, time_ns=late_ns, beam_velocity_mps=scale * dive.dvl.beam_velocity_mps))


def exact_dive(
    scenario: str | Scenario,
    *,
    duration_s: float | None = None,
    imu_rate_hz: float = 100.0,
    dvl_rate_hz: float = 1.0,
    reference_rate_hz: float = 5.0,
    reference_at_pings: bool = False,
    outages: Sequence[tuple[float, float]] = (),
    lost_beams: Sequence[LostBeam] = (),
    lever_arm_m: Vector = (0.0, 0.0, 0.0),
    mounting_rpy_deg: Vector = (0.0, 0.0, 0.0),
    sensor_rates_hz: Mapping[str, float] = NO_RATES,
) -> Dive:
    """Simulate a dive with perfect sensors. A Monte Carlo study needs it once, and `add_errors` for each run.

    Parameters
    ----------
    scenario : str or Scenario
        A name in `trajectories.SCENARIOS`, or anything with the functions of a scenario.
    duration_s : float, optional
        Cuts the scenario, or lets the vehicle go straight on; left out: the scenario's own.
    imu_rate_hz, dvl_rate_hz, reference_rate_hz : float
        The IMU and the reference start with the dive, the DVL at `FIRST_PING_S`.
    reference_at_pings : bool
        The reference has a row at the start and at each ping instead of a rate of its own.
    outages : sequence of (start_s, end_s)
        Spans in which no beam finds the bottom: such pings are there, and all NaN.
    lost_beams : sequence of LostBeam
        Spans in which one beam does not.
    lever_arm_m : tuple of three floats
        IMU to DVL, in b.
    mounting_rpy_deg : tuple of three floats
        The DVL's mounting rotation, d to b, as roll, pitch, heading.
    sensor_rates_hz : mapping of str to float
        Of the sensors beside IMU and DVL, which begin with the dive; they are at the IMU.

    Raises
    ------
    ConfigError
        Unknown scenario, or a number that cannot be.
    """
    way = named("scenario", scenario, SCENARIOS) if isinstance(scenario, str) else scenario
    end_s = way.duration_s if duration_s is None else duration_s
    check_duration(end_s)
    rates_hz = {"IMU": imu_rate_hz, "DVL": dvl_rate_hz, "reference": reference_rate_hz, **sensor_rates_hz}
    for sensor, rate_hz in rates_hz.items():
        check_positive(f"{sensor} rate", "Hz", rate_hz)
    if end_s * imu_rate_hz < 1.0:
        raise ConfigError(f"a dive of {end_s:g} s at {imu_rate_hz:g} Hz has less than two IMU samples", "--duration 60")
    every_beam = range(len(AZIMUTH_DEG))
    spans = [*lost_beams, *(LostBeam(beam, *outage) for outage in outages for beam in every_beam)]
    check_spans(spans, end_s)
    trajectory = Trajectory(way, end_s)
    ping_ns = _grid_ns(FIRST_PING_S, dvl_rate_hz, end_s)
    own_ns = _grid_ns(0.0, reference_rate_hz, end_s)
    reference = _reference(trajectory, np.append(START_NS, ping_ns) if reference_at_pings else own_ns)
    unbiased = np.zeros_like(reference.velocity_n)
    return Dive(
        name=scenario if isinstance(scenario, str) else way.about,
        imu=_imu(trajectory, _grid_ns(0.0, imu_rate_hz, end_s)),
        dvl=_dvl(trajectory, ping_ns, lever_arm_m, mounting_rpy_deg, spans),
        reference=reference,
        truth=TruthColumns(reference.time_ns, unbiased, unbiased),
        sensors={
            name: _sensor(trajectory, name, _grid_ns(0.0, rate_hz, end_s)) for name, rate_hz in sensor_rates_hz.items()
        },
    )


def add_errors(
    exact: Dive,
    imu_errors: ImuErrors,
    dvl_errors: DvlErrors,
    seed: int,
    sensor_errors: Mapping[str, SensorErrors] = NO_SENSORS,
) -> Dive:
    """Let the sensors of an exact dive err.

    Parameters
    ----------
    exact : Dive
        From `exact_dive`.
    seed : int
        Not negative. Accelerometers, gyros and DVL draw from streams of their own, by numpy's ziggurat, which asks the
        C library for a logarithm once in thousands of draws; readings are rounded to their quantum after it.

    Returns
    -------
    Dive
        With the biases as truth, at the times of the exact dive's truth.

    Raises
    ------
    ConfigError
        The seed is negative.
    ValueError
        The dive holds no truth to replace.
    """
    if seed < 0:
        raise ConfigError(f"seed {seed} is negative", f"--seed {-seed}")
    if exact.truth is None:
        raise ValueError("errors are added to an exact dive, which holds truth")
    accel_rng, gyro_rng, dvl_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    sensor_rngs = {name: np.random.default_rng([seed, *name.encode()]) for name in sensor_errors}
    imu, biases = add_imu_errors(exact.imu, imu_errors, accel_rng, gyro_rng)
    return replace(
        exact,
        imu=imu,
        dvl=add_dvl_errors(exact.dvl, dvl_errors, dvl_rng),
        truth=_truth_at(exact.truth.time_ns, biases),
        sensors={
            name: add_sensor_errors(name, exact.sensors[name], errors, sensor_rngs[name])
            for name, errors in sensor_errors.items()
        },
    )


def _grid_ns(first_s: float, rate_hz: float, end_s: float) -> TimeNs:
    """Count evenly from the first sample to the end, the end included whatever its last bit."""
    count = max(0, int(np.floor((end_s - first_s) * rate_hz + 1e-6)) + 1)
    return START_NS + np.rint((first_s + np.arange(count) / rate_hz) * 1e9).astype(np.int64)


def _imu(trajectory: Trajectory, time_ns: TimeNs) -> ImuColumns:
    motions = [trajectory.at(block) for block in np.array_split(seconds(time_ns, START_NS), 1 + len(time_ns) // BLOCK)]
    return ImuColumns(
        time_ns,
        np.concatenate([motion.specific_force_b for motion in motions]),
        np.concatenate([motion.angular_rate_b for motion in motions]),
    )


def _dvl(
    trajectory: Trajectory, time_ns: TimeNs, lever_arm_m: Vector, mounting_rpy_deg: Vector, spans: Sequence[LostBeam]
) -> DvlColumns:
    time_s, vectors_d = seconds(time_ns, START_NS), beam_vectors_d()
    motion = trajectory.at(time_s)
    mat_db = mat_from_sines(*sine_and_cosine(np.array(mounting_rpy_deg) * DEG)).T
    velocity_b = turned(np.swapaxes(motion.mat_nb, -1, -2), motion.velocity_n)
    velocity_d = turned(mat_db, velocity_b + np.cross(motion.turn_rate_b, lever_arm_m))
    beam_velocity_mps = turned(vectors_d, velocity_d)
    for span in spans:
        beam_velocity_mps[(time_s >= span.start_s) & (time_s < span.end_s), span.beam] = np.nan
    return DvlColumns(time_ns, beam_velocity_mps, vectors_d)


def _sensor(trajectory: Trajectory, name: str, time_ns: TimeNs) -> SensorColumns:
    motion = trajectory.at(seconds(time_ns, START_NS))
    values = named("sensor", name, SIMULATED).reading(motion)
    return SensorColumns(time_ns, values, motion.mat_nb if name == "heading" else None)


def _reference(trajectory: Trajectory, time_ns: TimeNs) -> ReferenceColumns:
    """Write the motion down with as many digits as matter: below 0.1 mm, 1 um/s and 1 prad."""
    motion = trajectory.at(seconds(time_ns, START_NS))
    return ReferenceColumns(
        time_ns,
        position=np.round(motion.position, 11),
        velocity_n=np.round(motion.velocity_n, 6),
        mat_nb=np.round(motion.mat_nb, 12),
    )


def _truth_at(time_ns: TimeNs, biases: TruthColumns) -> TruthColumns:
    latest = np.searchsorted(biases.time_ns, time_ns, side="right") - 1
    return TruthColumns(time_ns, np.round(biases.accel_bias_b[latest], 10), np.round(biases.gyro_bias_b[latest], 14))
