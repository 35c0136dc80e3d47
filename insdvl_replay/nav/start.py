"""What a filter starts from."""

from dataclasses import dataclass, field

import numpy as np

from insdvl_replay.columns import Floats


@dataclass(frozen=True)
class Start:
    """Where a filter starts and how sure it is.

    Attributes
    ----------
    position : ndarray, shape (3,)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (3,)
        m/s
    mat_nb : ndarray, shape (3, 3)
        Attitude.
    sd : ndarray, shape (12,)
        Standard deviations of the error states, SI units.
    accel_bias_b, gyro_bias_b : ndarray, shape (3,)
        Biases that are known beforehand, m/s^2 and rad/s; zero unless given.
    """

    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    sd: Floats
    accel_bias_b: Floats = field(default_factory=lambda: np.zeros(3))
    gyro_bias_b: Floats = field(default_factory=lambda: np.zeros(3))
