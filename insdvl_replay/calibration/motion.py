"""What a fit owes to the motion of the vehicle, and what to the noise of its IMU.

A delay or an arm that is tried lets noise of accelerometers and gyros into the innovations, of a vehicle that lies
still, too. Derivatives made of it look like knowledge: the delay comes to rest where innovations happen to be smallest,
the arm near zero, and the more surely the noisier the IMU is. What is found is therefore where innovations do not go
with the derivatives of the same dive with an averaged IMU ("instrumental variables"). Source: Fuller, "Measurement
error models", 1987.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import OWN, Fit, Linearised
from insdvl_replay.calibration.innovations import LATEST_S, DiveInnovations
from insdvl_replay.core.dive_columns import Floats, ImuColumns

MOTION_S: Final = 0.5
"""A vehicle moves slower than this; the IMU's readings that are faster are mostly noise."""
MOSTLY: Final = 0.5
"""Share of the derivative's squares beyond which it is the noise's."""


def seen_by_motion(smallest: Fit, dives: Sequence[DiveInnovations]) -> Fit:
    """Go from where innovations are smallest to where they do not go with the vehicle's motion.

    Parameters
    ----------
    smallest : Fit
    dives : sequence of DiveInnovations
        Those that were fitted, in the same order.
    """
    unknowns = smallest.unknowns
    here = replace(smallest, dives=tuple(_by_motion(smallest, dive, i) for i, dive in enumerate(dives)))
    shown = noise_share(here) <= MOSTLY
    # What is mostly noise is left to its prior, and with it what it pulls at the rest.
    here = replace(here, dives=tuple(replace(near, by_motion=near.by_motion * shown) for near in here.dives))
    values = here.values + here.step
    values[OWN - 1 :] = np.clip(values[OWN - 1 :], -LATEST_S, LATEST_S)
    there = (
        replace(near, residuals=dive.residuals(unknowns.of_dive(values, i)))
        for i, (dive, near) in enumerate(zip(dives, here.dives, strict=True))
    )
    return replace(here, values=values, dives=tuple(there))


def noise_share(found: Fit) -> Floats:
    """Return the share of the squares of the derivatives that is noise of the IMU, shape (8,)."""
    noise = sum(_squares(near, near.jacobian - near.by_motion) for near in found.dives)
    whole = sum(_squares(near, near.jacobian) for near in found.dives)
    return np.asarray(noise / np.maximum(whole, np.finfo(float).tiny))


def _squares(near: Linearised, derivative: Floats) -> Floats:
    return np.asarray(np.einsum("ka,kai->i", near.weights, derivative**2))


def _by_motion(found: Fit, dive: DiveInnovations, number: int) -> Linearised:
    near = found.dives[number]
    jacobian = without_imu_noise(dive).jacobian(found.of_dive(number), found.unknowns.free)
    return replace(near, by_motion=jacobian / near.scatter[:, None])


def without_imu_noise(dive: DiveInnovations) -> DiveInnovations:
    """Return the same dive with what its IMU says on the average over `MOTION_S`."""
    imu = dive.dive.imu
    force_b, rate_b = (averaged(of_one, imu.usual_step_s) for of_one in (imu.specific_force_b, imu.angular_rate_b))
    return replace(dive, dive=replace(dive.dive, imu=ImuColumns(imu.time_ns, force_b, rate_b)))


def averaged(readings: Floats, step_s: float) -> Floats:
    """Average readings over `MOTION_S` around each, shape (k, 3); slower ones stand for themselves."""
    half = int(0.5 * MOTION_S / step_s)
    padded = np.pad(readings, ((half, half), (0, 0)), mode="edge")
    share = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    return np.column_stack([np.convolve(axis, share, mode="valid") for axis in padded.T])
