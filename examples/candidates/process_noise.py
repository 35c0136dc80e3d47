"""Process noise that is the same all the time, but not that of the settings: how much any schedule of it can matter.

    noise_factors = "process_noise:TenTimes"

N. Cohen and I. Klein, "Adaptive Kalman-Informed Transformer", Engineering Applications of Artificial Intelligence, 2025
(arXiv:2401.09987), and A. Levy and I. Klein, "Adaptive Neural Unscented Kalman Filter", 2025 (arXiv:2503.05490), let
networks find it over time. A schedule between two constants hardly moves the filter further than the constants do.
"""

import numpy as np

from insdvl_replay import UserNoise


class TenTimes(UserNoise):
    """Ten times the standard deviation of the settings, of accelerometers and gyros."""

    factor = 10.0

    def noise_factors(self, dive):
        """Return one time and its factors."""
        return dive.imu.time_ns[:1], np.full((1, 2), self.factor)


class ATenth(TenTimes):
    """A tenth of it."""

    factor = 0.1
