"""How sensors err: inertial ones by a bias that wanders, white noise and the steps of their digits, a DVL by its beams.

White noise and random walk as IEEE Std 952, annex C, defines them by their Allan variance.

What the sensors beside IMU and DVL read along a trajectory, and how they err.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import DvlColumns, Floats, ImuColumns, SensorColumns, TruthColumns
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.frames import beam_vectors, moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat, turned
from insdvl_replay.sim.trajectories import Motion

DEG_PER_RT_HOUR: Final = DEG / 60.0
"""One deg/sqrt(h), the unit of angular random walk on data sheets, in rad/sqrt(s)."""


@dataclass(frozen=True)
class ImuErrors:
    """Size of the errors of three like accelerometers and three like gyros.

    Attributes
    ----------
    accel_white_mps_rts, gyro_white_rad_rts : float
        White noise density N; one sample at rate f has the standard deviation N sqrt(f), its integral over t has
        N sqrt(t).
    accel_bias_sd_mps2, gyro_bias_sd_radps : float
        Standard deviation of the bias at the start of a dive.
    accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts : float
        Random walk K of the bias: after t it has moved by K sqrt(t).
    accel_quantum_mps2, gyro_quantum_radps : float
        Steps to which readings are rounded; 0 for none.
    """

    accel_white_mps_rts: float = 0.0
    gyro_white_rad_rts: float = 0.0
    accel_bias_sd_mps2: float = 0.0
    gyro_bias_sd_radps: float = 0.0
    accel_bias_walk_mps2_rts: float = 0.0
    gyro_bias_walk_radps_rts: float = 0.0
    accel_quantum_mps2: float = 0.0
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
    """Round to whole multiples of a quantum; 0 leaves the values as they are.

    Parameters
    ----------
    values : ndarray, any shape
    quantum : float
        In the unit of the values.

    Returns
    -------
    ndarray, the same shape
    """
    if quantum == 0.0:
        return values
    rounded: Floats = np.rint(values / quantum) * quantum
    return rounded


def add_imu_errors(
    exact: ImuColumns, errors: ImuErrors, accel_rng: np.random.Generator, gyro_rng: np.random.Generator
) -> tuple[ImuColumns, TruthColumns]:
    """Add bias, white noise and steps; return the readings and the biases that were drawn."""
    interval_s = float(exact.time_ns[-1] - exact.time_ns[0]) * 1e-9 / (len(exact.time_ns) - 1)
    root_s, shape = math.sqrt(interval_s), exact.specific_force_b.shape
    accel_bias = _bias(shape, errors.accel_bias_sd_mps2, errors.accel_bias_walk_mps2_rts * root_s, accel_rng)
    gyro_bias = _bias(shape, errors.gyro_bias_sd_radps, errors.gyro_bias_walk_radps_rts * root_s, gyro_rng)
    accel_noise = errors.accel_white_mps_rts / root_s * accel_rng.standard_normal(shape)
    gyro_noise = errors.gyro_white_rad_rts / root_s * gyro_rng.standard_normal(shape)
    imu = ImuColumns(
        exact.time_ns,
        quantise(exact.specific_force_b + accel_bias + accel_noise, errors.accel_quantum_mps2),
        quantise(exact.angular_rate_b + gyro_bias + gyro_noise, errors.gyro_quantum_radps),
    )
    return imu, TruthColumns(exact.time_ns, accel_bias, gyro_bias)


def _bias(shape: tuple[int, ...], start_sd: float, step_sd: float, rng: np.random.Generator) -> Floats:
    """Draw a bias and let it wander, one step per sample."""
    steps = step_sd * rng.standard_normal(shape)
    steps[0] = start_sd * rng.standard_normal(shape[1:])
    walk: Floats = np.cumsum(steps, axis=0)
    return walk


@dataclass(frozen=True)
class DvlErrors:
    """Size of the errors of one beam: ``y = (b . v_d)(1 + scale) + bias + noise``.

    The defaults are those of a 600 kHz bottom-track DVL: 4.2 mm/s in a beam are 6 mm/s in each horizontal axis of four
    beams at 30 deg.

    Attributes
    ----------
    beam_sd_mps : float
        White noise of one reading.
    beam_bias_sd_mps : float
        Standard deviation of a beam's constant offset, drawn once a dive.
    beam_scale_sd : float
        Standard deviation of a beam's scale error, drawn once a dive.
    beam_quantum_mps : float
        Step to which readings are rounded; 0 for none.
    velocity_sd_mps : float
        White noise that the beams of a ping share: each axis of the velocity has as much of it.
    """

    beam_sd_mps: float = 0.0042
    beam_bias_sd_mps: float = 0.001
    beam_scale_sd: float = 0.002
    beam_quantum_mps: float = 1e-4
    velocity_sd_mps: float = 0.0


@dataclass(frozen=True)
class LostBeam:
    """A span in which one beam finds no bottom.

    Attributes
    ----------
    beam : int
        Row of `beam_vectors_d`, from 0.
    start_s, end_s : float
        Seconds from the start of the dive; the end is not part of the span.
    """

    beam: int
    start_s: float
    end_s: float


def beam_vectors_d() -> Floats:
    """Return the unit vectors of a Janus of four beams, from the instrument towards the seabed.

    They are rounded to twelve digits, so that no machine's last bit of a sine shows in a log.

    Returns
    -------
    ndarray, shape (4, 3)
    """
    return np.round(beam_vectors(), 12)


def add_dvl_errors(exact: DvlColumns, errors: DvlErrors, rng: np.random.Generator) -> DvlColumns:
    """Spoil perfect beams; lost ones stay lost."""
    if exact.beam_velocity_mps is None or exact.beam_vectors_d is None:
        raise ValueError("the errors of a DVL are drawn for its beams, and these columns hold none")
    pings, beams = exact.beam_velocity_mps.shape
    scale = errors.beam_scale_sd * rng.standard_normal(beams)
    bias = errors.beam_bias_sd_mps * rng.standard_normal(beams)
    noise = errors.beam_sd_mps * rng.standard_normal((pings, beams))
    noise += turned(exact.beam_vectors_d, errors.velocity_sd_mps * rng.standard_normal((pings, 3)))
    reading = exact.beam_velocity_mps * (1.0 + scale) + bias + noise
    return replace(exact, beam_velocity_mps=quantise(reading, errors.beam_quantum_mps))


@dataclass(frozen=True)
class SensorErrors:
    """How often a sensor reads, and how large its white noise is in the unit of its kind, see `UNITS`."""

    sd: float
    rate_hz: float = 1.0


@dataclass(frozen=True)
class SimulatedSensor:
    """One kind of sensor.

    Attributes
    ----------
    unit : str
        Of its noise, for the user.
    si : float
        One of it in the unit of the readings.
    reading : callable
        From the motion to exact readings, shape (k, s).
    """

    unit: str
    si: float
    reading: Callable[[Motion], Floats]


def _depth_m(motion: Motion) -> Floats:
    return np.asarray(-motion.position[:, 2:])


def _heading_rad(motion: Motion) -> Floats:
    """Return the headings to twelve digits: no two processors' arcs agree beyond."""
    return np.asarray(np.round(rpy_from_mat(motion.mat_nb)[:, 2:], 12))


SIMULATED: Final[Mapping[str, SimulatedSensor]] = {
    "depth": SimulatedSensor("m", 1.0, _depth_m),
    "heading": SimulatedSensor("deg", DEG, _heading_rad),
    "position": SimulatedSensor("m", 1.0, lambda motion: motion.position),
}
"""By the names of `core.states.SENSORS`; at the IMU's place."""


def add_sensor_errors(name: str, exact: SensorColumns, errors: SensorErrors, rng: np.random.Generator) -> SensorColumns:
    """Add white noise to exact readings; of an attitude to each of its angles."""
    sd = SIMULATED[name].si * errors.sd
    noise = sd * rng.standard_normal(exact.values.shape)
    values = moved_position(exact.values, noise) if name == "position" else exact.values + noise
    if exact.mat_nb is None:
        return SensorColumns(exact.time_ns, values)
    roll_pitch = rpy_from_mat(exact.mat_nb)[:, :2] + sd * rng.standard_normal((len(values), 2))
    return SensorColumns(exact.time_ns, values, mat_from_rpy(np.concatenate([roll_pitch, values], axis=1)))
