"""What a fit owes to the motion of the vehicle, and what to the noise of its IMU.

A delay or an arm that is tried lets noise of accelerometers and gyros into the innovations, of a vehicle that lies
still, too. Derivatives made of it look like knowledge: the delay comes to rest where innovations happen to be smallest,
the arm near zero, and the more surely the noisier the IMU is. How much of a derivative is noise is what it changes by
beside as much noise once more ("simulation extrapolation"). Where that is not little, what is found is where
innovations do not go with the derivative of the same dive with an averaged IMU ("instrumental variables"). Sources:
Cook & Stefanski, "Simulation-extrapolation estimation in parametric measurement error models", 1994; Fuller,
"Measurement error models", 1987.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import OWN, Fit, Linearised, Mask
from insdvl_replay.calibration.innovations import LATEST_S, DiveInnovations
from insdvl_replay.calibration.parameters import NAMES
from insdvl_replay.core.dive_columns import Floats, ImuColumns
from insdvl_replay.evaluation.consistency import readings_scatter

MOTION_S: Final = 0.5
"""Most of what moves a vehicle is slower than this; white noise mostly faster."""
LITTLE: Final = 0.01
"""Share of the derivative's squares up to which it is taken as it is; it draws what is found to zero by as much."""
MOSTLY: Final = 0.5
"""Share beyond which the derivative is the noise's."""
HIDDEN: Final = 2.0
"""Times what gyros scatter by from sample to sample, as much may be noise; what is fitted also stands for what rates do
between samples."""
SEED: Final = 1


def seen_by_motion(smallest: Fit, dives: Sequence[DiveInnovations], noise_shares: Floats) -> Fit:
    """Go from where innovations are smallest to where they do not go with the vehicle's motion."""
    unknowns = smallest.unknowns
    here = replace(
        smallest,
        dives=tuple(_by_motion(smallest, dive, i, noise_shares[i]) for i, dive in enumerate(dives)),
    )
    values = here.values + here.step
    values[OWN - 1 :] = np.clip(values[OWN - 1 :], -LATEST_S, LATEST_S)
    there = (
        replace(near, residuals=dive.residuals(unknowns.of_dive(values, i)))
        for i, (dive, near) in enumerate(zip(dives, here.dives, strict=True))
    )
    return replace(here, values=values, dives=tuple(there))


def _by_motion(found: Fit, dive: DiveInnovations, number: int, noise_shares: Floats) -> Linearised:
    near, noisy = found.dives[number], noise_shares > LITTLE
    averaged_imu = _jacobian(found, without_imu_noise(dive), number, noisy)
    by_motion = np.where(noisy, averaged_imu, near.jacobian)
    return replace(near, by_motion=by_motion * (noise_shares <= MOSTLY))


def noise_share(found: Fit, dives: Sequence[DiveInnovations]) -> Floats:
    """Return the share of the squares of the derivatives that is noise of the IMU, dive by dive, shape (n, 8).

    A dive that lies still tells nothing, whatever the others do.
    """
    shares = np.zeros((len(dives), len(NAMES)))
    for i, (dive, near) in enumerate(zip(dives, found.dives, strict=True)):
        # The noise is that of all dives together: one that is noisier shows it by how its innovations scatter.
        times = max(1.0, float(np.sqrt(np.mean(near.scatter**2))))
        noisier = _jacobian(found, with_imu_noise(dive, times), i, found.unknowns.free)
        whole = np.maximum(_squares(near, near.jacobian), np.finfo(float).tiny)
        shares[i] = _squares(near, noisier - near.jacobian) / whole
    return shares


def _squares(near: Linearised, derivative: Floats) -> Floats:
    return np.asarray(np.einsum("ka,kai->i", near.weights, derivative**2))


def _jacobian(found: Fit, dive: DiveInnovations, number: int, chosen: Mask) -> Floats:
    """Differentiate as the fit does, over its scatter."""
    return dive.jacobian(found.of_dive(number), found.unknowns.free & chosen) / found.dives[number].scatter[:, None]


def with_imu_noise(dive: DiveInnovations, times: float = 1.0) -> DiveInnovations:
    """Return the same dive with so many times the white noise of its IMU more, as its filter has it."""
    imu, noise, rng = dive.dive.imu, dive.filter.inertial_noise, np.random.default_rng(SEED)
    root_s = np.sqrt(imu.usual_step_s)
    shown = HIDDEN * readings_scatter(imu.angular_rate_b, imu.usual_step_s)
    accel_mps2 = times * noise.accel_white_mps_rts / root_s
    gyro_radps = min(times * noise.gyro_white_rad_rts, shown) / root_s
    shape = imu.specific_force_b.shape
    return _with_imu(
        dive,
        imu.specific_force_b + accel_mps2 * rng.standard_normal(shape),
        imu.angular_rate_b + gyro_radps * rng.standard_normal(shape),
    )


def without_imu_noise(dive: DiveInnovations) -> DiveInnovations:
    """Return the same dive with what its IMU says on the average over `MOTION_S`."""
    imu = dive.dive.imu
    force_b, rate_b = (averaged(of_one, imu.usual_step_s) for of_one in (imu.specific_force_b, imu.angular_rate_b))
    return _with_imu(dive, force_b, rate_b)


def _with_imu(dive: DiveInnovations, force_b: Floats, rate_b: Floats) -> DiveInnovations:
    return replace(dive, dive=replace(dive.dive, imu=ImuColumns(dive.dive.imu.time_ns, force_b, rate_b)))


def averaged(readings: Floats, step_s: float) -> Floats:
    """Average readings over `MOTION_S` around each, shape (k, 3); slower ones stand for themselves."""
    half = int(0.5 * MOTION_S / step_s)
    padded = np.pad(readings, ((half, half), (0, 0)), mode="edge")
    share = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    return np.column_stack([np.convolve(axis, share, mode="valid") for axis in padded.T])
