"""What the sensors beside IMU and DVL read along a trajectory, and how they err."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, SensorColumns
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.sim.motion import Motion


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
