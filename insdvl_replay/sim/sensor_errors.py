"""Sensor errors: bias with random walk, white noise and quantisation of IMUs; beam errors of a DVL.

White noise and random walk are defined by their Allan variance, as in IEEE Std 952, annex C. Other sensors have white
noise.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import (
    DvlColumns,
    Floats,
    ImuColumns,
    SensorColumns,
    TruthColumns,
)
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.frames import beam_vectors, moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, turned
from insdvl_replay.sim.trajectories import Motion

# The unit of angular random walk on data sheets, in rad/sqrt(s).
DEG_PER_RT_HOUR: Final = DEG / 60.0


@dataclass(frozen=True)
class ImuErrors:
    """Size of the errors of three equal accelerometers and three equal gyros.

    White noise N has the standard deviation N sqrt(f) in one sample at rate f, and N sqrt(t) in its integral over t.
    """

    accel_white_mps_rts: float = 0.0
    gyro_white_rad_rts: float = 0.0
    accel_bias_sd_mps2: float = 0.0  # of the bias at the start of a dive
    gyro_bias_sd_radps: float = 0.0
    # Random walk K: after t the standard deviation of the bias has grown by K sqrt(t).
    accel_bias_walk_mps2_rts: float = 0.0
    gyro_bias_walk_radps_rts: float = 0.0
    accel_quantum_mps2: float = 0.0  # step to which readings are rounded; 0 for none
    gyro_quantum_radps: float = 0.0


# The quanta are powers of two, which float64 holds exactly: the same bytes on every machine, and short ones in a
# compressed log. Each is well below the noise of one sample at 100 Hz.
GRADES: Final[Mapping[str, ImuErrors]] = MappingProxyType(
    {
        "fog": ImuErrors(
            accel_white_mps_rts=1e-4,
            gyro_white_rad_rts=0.001 * DEG_PER_RT_HOUR,
            accel_bias_sd_mps2=0.04 * MG,
            gyro_bias_sd_radps=0.01 * DEG_PER_HOUR,
            accel_bias_walk_mps2_rts=1e-6,
            gyro_bias_walk_radps_rts=2e-10,
            accel_quantum_mps2=2.0**-13,
            gyro_quantum_radps=2.0**-20,
        ),
        "tactical": ImuErrors(
            accel_white_mps_rts=1e-3,
            gyro_white_rad_rts=0.1 * DEG_PER_RT_HOUR,
            accel_bias_sd_mps2=1.0 * MG,
            gyro_bias_sd_radps=3.0 * DEG_PER_HOUR,
            accel_bias_walk_mps2_rts=2e-5,
            gyro_bias_walk_radps_rts=8e-8,
            accel_quantum_mps2=2.0**-11,
            gyro_quantum_radps=2.0**-16,
        ),
        "mems": ImuErrors(
            accel_white_mps_rts=2e-3,
            gyro_white_rad_rts=0.3 * DEG_PER_RT_HOUR,
            accel_bias_sd_mps2=4.0 * MG,
            gyro_bias_sd_radps=30.0 * DEG_PER_HOUR,
            accel_bias_walk_mps2_rts=8e-5,
            gyro_bias_walk_radps_rts=8e-7,
            accel_quantum_mps2=2.0**-9,
            gyro_quantum_radps=2.0**-14,
        ),
    }
)
"""Typical IMUs: fibre-optic gyros as in a navigator for survey vehicles, tactical grade, and micromechanical."""


def quantise(values: Floats, quantum: float) -> Floats:
    """Round to whole multiples of a quantum; 0 leaves the values unchanged."""
    if quantum == 0.0:
        return values
    rounded: Floats = np.rint(values / quantum) * quantum
    return rounded


def add_imu_errors(
    exact: ImuColumns,
    errors: ImuErrors,
    accel_rng: np.random.Generator,
    gyro_rng: np.random.Generator,
) -> tuple[ImuColumns, TruthColumns]:
    """Add bias, white noise and quantisation; return the readings and the drawn biases."""

    def bias(start_sd: float, walk: float, rng: np.random.Generator) -> Floats:
        steps = walk * root_s * rng.standard_normal(shape)
        steps[0] = start_sd * rng.standard_normal(shape[1:])
        return np.asarray(np.cumsum(steps, axis=0))

    interval_s = float(exact.time_ns[-1] - exact.time_ns[0]) * 1e-9 / (len(exact.time_ns) - 1)
    root_s = math.sqrt(interval_s)
    shape = exact.specific_force_b.shape
    accel_bias = bias(errors.accel_bias_sd_mps2, errors.accel_bias_walk_mps2_rts, accel_rng)
    gyro_bias = bias(errors.gyro_bias_sd_radps, errors.gyro_bias_walk_radps_rts, gyro_rng)
    accel_noise = errors.accel_white_mps_rts / root_s * accel_rng.standard_normal(shape)
    gyro_noise = errors.gyro_white_rad_rts / root_s * gyro_rng.standard_normal(shape)
    imu = ImuColumns(
        exact.time_ns,
        quantise(exact.specific_force_b + accel_bias + accel_noise, errors.accel_quantum_mps2),
        quantise(exact.angular_rate_b + gyro_bias + gyro_noise, errors.gyro_quantum_radps),
    )
    return imu, TruthColumns(exact.time_ns, accel_bias, gyro_bias)


@dataclass(frozen=True)
class DvlErrors:
    """Size of the errors of one beam: ``y = (b . v_d)(1 + scale) + bias + noise``.

    The defaults are those of a 600 kHz bottom-track DVL: 4.2 mm/s in a beam are 6 mm/s in each horizontal axis of four
    beams at 30 deg.
    """

    beam_sd_mps: float = 0.0042  # white noise of one reading
    beam_bias_sd_mps: float = 0.001  # a beam's constant offset, drawn once a dive
    beam_scale_sd: float = 0.002  # a beam's scale error, drawn once a dive
    beam_quantum_mps: float = 1e-4  # step to which readings are rounded; 0 for none
    # White noise on each axis of the velocity, common to the beams of a ping.
    velocity_sd_mps: float = 0.0


@dataclass(frozen=True)
class LostBeam:
    """A span without bottom track of one beam."""

    beam: int  # row of `beam_vectors_d`, from 0
    start_s: float  # from the start of the dive
    end_s: float  # not part of the span


def beam_vectors_d() -> Floats:
    """Return the unit vectors of a Janus of four beams, from the instrument towards the seabed, shape (4, 3).

    They are rounded to twelve digits, so that logs do not depend on the processor.
    """
    return np.round(beam_vectors(), 12)


def add_dvl_errors(exact: DvlColumns, errors: DvlErrors, rng: np.random.Generator) -> DvlColumns:
    """Add errors to exact beams; lost ones stay lost."""
    if exact.beam_velocity_mps is None or exact.beam_vectors_d is None:
        raise ValueError("DVL errors need beams, and these columns have none")
    pings, beams = exact.beam_velocity_mps.shape
    scale = errors.beam_scale_sd * rng.standard_normal(beams)
    bias = errors.beam_bias_sd_mps * rng.standard_normal(beams)
    noise = errors.beam_sd_mps * rng.standard_normal((pings, beams))
    noise += turned(exact.beam_vectors_d, errors.velocity_sd_mps * rng.standard_normal((pings, 3)))
    reading = exact.beam_velocity_mps * (1.0 + scale) + bias + noise
    return replace(exact, beam_velocity_mps=quantise(reading, errors.beam_quantum_mps))


@dataclass(frozen=True)
class SensorErrors:
    """White noise and rate of a sensor."""

    sd: float  # in the unit of `SIMULATED`
    rate_hz: float = 1.0


@dataclass(frozen=True)
class SimulatedSensor:
    """One kind of sensor besides IMU and DVL."""

    unit: str  # of its noise, for the user
    si: float  # one of it in the unit of the readings
    reading: Callable[[Motion], Floats]  # exact readings, shape (k, s)


SIMULATED: Final[Mapping[str, SimulatedSensor]] = {
    "depth": SimulatedSensor("m", 1.0, lambda motion: np.asarray(-motion.position[:, 2:])),
    # Twelve digits: further ones differ between processors.
    "heading": SimulatedSensor(
        "deg", DEG, lambda motion: np.asarray(np.round(rpy_from_mat(motion.mat_nb)[:, 2:], 12))
    ),
    "position": SimulatedSensor("m", 1.0, lambda motion: motion.position),
}
"""By the names of `core.states.SENSORS`; at the IMU's place."""


def add_sensor_errors(
    name: str, exact: SensorColumns, errors: SensorErrors, rng: np.random.Generator
) -> SensorColumns:
    """Add white noise to exact readings; for an attitude to each of its angles."""
    sd = SIMULATED[name].si * errors.sd
    noise = sd * rng.standard_normal(exact.values.shape)
    values = exact.values + noise
    if name == "position":
        values = moved_position(exact.values, noise)
    if exact.mat_nb is None:
        return SensorColumns(exact.time_ns, values)
    roll_pitch = rpy_from_mat(exact.mat_nb)[:, :2] + sd * rng.standard_normal((len(values), 2))
    mat_nb = mat_from_rpy(np.concatenate([roll_pitch, values], axis=1))
    return SensorColumns(exact.time_ns, values, mat_nb)
