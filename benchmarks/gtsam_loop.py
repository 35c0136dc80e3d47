"""GTSAM's mechanisation and covariance on the readings of a file; run by the interpreter that has GTSAM."""

import sys
import time

import gtsam
import numpy as np


def seconds_an_epoch(path: str) -> float:
    """Integrate the readings between two pings, again and again; no update is part of it."""
    with np.load(path) as readings:
        force_b, rate_b, dt = readings["force_b"], readings["rate_b"], float(readings["dt"])
        noise = readings["noise_density"]
    params = gtsam.PreintegrationCombinedParams.MakeSharedD(9.8)
    params.setAccelerometerCovariance(noise[0] * np.eye(3))
    params.setGyroscopeCovariance(noise[3] * np.eye(3))
    params.setBiasAccCovariance(noise[6] * np.eye(3))
    params.setBiasOmegaCovariance(noise[9] * np.eye(3))
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params)
    start_s = time.thread_time()
    for k in range(len(force_b)):
        if k % 100 == 0:
            preintegrated.resetIntegration()
        preintegrated.integrateMeasurement(force_b[k], rate_b[k], dt)
    return (time.thread_time() - start_s) / len(force_b)


if __name__ == "__main__":
    sys.stdout.write(str(seconds_an_epoch(sys.argv[1])))
