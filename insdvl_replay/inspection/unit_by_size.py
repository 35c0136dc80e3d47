"""In which unit readings are, by their size: of gravity, of the speeds of vehicles, and of how fast these turn."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from insdvl_replay.checks.imu import SPIN_RADPS
from insdvl_replay.core.states import GRAVITY_MPS2
from insdvl_replay.core.units import SPECIFIC_FORCE_UNITS, VELOCITY_UNITS

# Units that the size of a reading can tell from one another; the others are read where a title or a setting has them.
FORCE_UNITS: Final = ("m/s2", "g", "mg", "ug")
SPEED_UNITS: Final = ("m/s", "mm/s", "cm/s")
_GRAVITY_OFF: Final = 0.1  # share by which the size of gravity may be off
_SPEEDS_MPS: Final = (0.1, 5.0)  # over ground of a vehicle under way


def force_units(size: float, stated: str = "m/s2") -> list[str]:
    """Return the units in which the size of a specific force is that of gravity: the stated one, else usual ones."""
    least_mps2 = (1.0 - _GRAVITY_OFF) * GRAVITY_MPS2
    most_mps2 = (1.0 + _GRAVITY_OFF) * GRAVITY_MPS2
    limits_mps2 = (least_mps2, most_mps2)
    if _fitting(size, (stated,), SPECIFIC_FORCE_UNITS, limits_mps2):
        return [stated]
    return _fitting(size, FORCE_UNITS, SPECIFIC_FORCE_UNITS, limits_mps2)


def nearest_force_unit(size: float, unit: str) -> str:
    """Return the unit in which the size of a specific force is nearest to gravity: a usual one, or the given one."""

    def distance(name: str) -> float:
        return float(abs(np.log(size * SPECIFIC_FORCE_UNITS[name] / GRAVITY_MPS2)))

    return min((unit, *FORCE_UNITS), key=distance)


def speed_units(size: float, limits_mps: tuple[float, float] = _SPEEDS_MPS) -> list[str]:
    """Return the units in which a speed is between two limits, which are those of vehicles if none are given."""
    return _fitting(size, SPEED_UNITS, VELOCITY_UNITS, limits_mps)


def is_rate_in_degrees(median_radps: float) -> bool:
    """Return whether a median rate is so fast in rad/s that it is in deg/s."""
    return median_radps > SPIN_RADPS


def _fitting(
    size: float,
    units: tuple[str, ...],
    factors: Mapping[str, float],
    limits: tuple[float, float],
) -> list[str]:
    """Return the units in which a size is between two limits, SI."""
    least, most = limits
    return [unit for unit in units if least < size * factors[unit] < most]
