"""Whether a white noise can be its sensor's: the classes that sensors come in, and what the readings themselves show.

A filter that fits noise to its innovations has nowhere else to put what a wrong lever arm or delay does to them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats


@dataclass(frozen=True)
class Sensors:
    """The classes that one kind of sensor comes in.

    Attributes
    ----------
    worst : mapping of str to float
        The worst white noise of each class, in SI units, best class first.
    least : float
        Less than the best sensors have.
    """

    name: str
    worst: Mapping[str, float]
    least: float


CLASSES: Final[Mapping[str, Sensors]] = MappingProxyType(
    {
        # Servo accelerometers have 1 to 10 ug/sqrt(Hz), good micromechanical ones 100; cheap ones reach 1000.
        "accel_white_mps_rts": Sensors("accelerometers", {"fog": 5e-4, "tactical": 1.8e-3, "mems": 1e-2}, 1e-5),
        # Navigators have 0.003 deg/sqrt(h) or less, tactical gyros 0.15; the cheapest reach 0.05 deg/s/sqrt(Hz).
        "gyro_white_rad_rts": Sensors("gyros", {"fog": 1e-5, "tactical": 6e-5, "mems": 1e-3}, 1e-8),
        # From 3 mm/s of a ping at 1 MHz to 3 cm/s at 150 kHz, which reaches furthest.
        "velocity_sd_mps": Sensors("DVLs", {"DVL": 0.1}, 3e-4),
        "beam_sd_mps": Sensors("DVLs", {"DVL": 0.1}, 3e-4),
    }
)
"""By the key of the settings; names of classes as of the presets."""
FILTERED: Final = 10.0
"""An IMU that smooths its readings shows less of its noise from sample to sample than it has over a second: by up to
this factor."""
RESTLESS: Final = 2.0
"""Vibration that comes and goes scatters the readings by as much more than in the usual block."""
BLOCK: Final = 50
"""Samples of a block; turns and single wrong readings spoil few of them."""


def readings_scatter(readings: Floats, step_s: float) -> float:
    """Bound the white noise of a sensor by how its readings scatter from sample to sample.

    What is left of three readings after a straight line through them is noise, vibration, and what the vehicle does
    within two steps: at least the sensor's noise, unless it smooths its readings.

    Parameters
    ----------
    readings : ndarray, shape (k, 3)
    step_s : float
        From one to the next.

    Returns
    -------
    float
        White noise density, in the readings' unit times sqrt(s): the largest of the three axes, each the median over
        blocks. NaN of fewer than three readings.
    """
    bends = np.diff(readings, n=2, axis=0) / np.sqrt(6.0)  # of white noise: 1, -2 and 1 times it, squared and added
    if not len(bends):
        return np.nan
    length = min(BLOCK, len(bends))
    blocks = bends[: len(bends) // length * length].reshape(-1, length, 3)
    power = np.median(np.mean(blocks**2, axis=1), axis=0)
    return float(np.sqrt(power.max() * step_s))


def sensor_class(key: str, noise: float) -> str:
    """Name the best class of sensors that may be so noisy; empty where none is.

    Parameters
    ----------
    key : str
        Of `CLASSES`.
    """
    return next((name for name, worst in CLASSES[key].worst.items() if noise <= worst), "")


def beyond_the_sensor(key: str, noise: float, scatter: float = 0.0) -> str:
    """State why a white noise cannot be its sensor's.

    Parameters
    ----------
    key : str
        Of `CLASSES`.
    scatter : float
        From `readings_scatter`; 0 where the readings show nothing of the noise alone, as those of a DVL.

    Returns
    -------
    str
        Empty where it may be.
    """
    sensors = CLASSES[key]
    best, worst = min(sensors.worst.values()), max(sensors.worst.values())
    reasons = []
    if scatter and noise > best and noise > FILTERED * scatter:
        reasons.append(f"{noise / scatter:.0f} times what the readings scatter by ({scatter:.2g})")
    if noise > worst and noise > RESTLESS * scatter:
        reasons.append(f"more than any {sensors.name} have ({worst:g})")
    if noise < sensors.least:
        reasons.append(f"less than any {sensors.name} have ({sensors.least:g})")
    return " and ".join(reasons)
