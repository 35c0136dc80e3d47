"""Scheduled process noise: the accelerometers count less where they shake. Name it in ``noise_factors`` of a filter."""

import numpy as np

from insdvl_replay import UserNoise

WINDOW_S = 1.0
LARGEST = 1000.0


class ByVibration(UserNoise):
    """Noise in proportion to the differences of neighbouring samples, second by second, from the quiet ones on."""

    def noise_factors(self, dive):
        """Return times and factors of accelerometers and gyros."""
        imu = dive.imu
        window = ((imu.time_ns - imu.time_ns[0]) * 1e-9 // WINDOW_S).astype(int)[1:]
        first, counts = np.unique(window, return_index=True, return_counts=True)[1:]
        columns = []
        for readings in (imu.specific_force_b, imu.angular_rate_b):
            square = np.sum(np.diff(readings, axis=0) ** 2, axis=1)
            rms = np.sqrt(np.add.reduceat(square, first) / counts)
            quiet = np.percentile(rms, 10)  # what the settings are for
            columns.append(np.clip(rms / max(quiet, 1e-12), 1.0, LARGEST))
        # A window ends before its factor is known, so it holds for the next one.
        return imu.time_ns[1:][first + counts - 1], np.column_stack(columns)
