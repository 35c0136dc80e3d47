"""The gyros against who else knows how the vehicle turned: the reference's attitude, or the direction of gravity."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.imu import samples_in
from insdvl_replay.core.columns import Floats, ImuColumns, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import vector_from_mat

ENOUGH: Final = 20
"""Fewer pairs than this may agree by chance."""
LONGEST_STEP_S: Final = 2.5
"""What lies further apart is not compared, since nobody saw what was between."""

_LEAST_TURN_RADPS: Final = 0.3 * DEG  # above the noise that differences of attitudes have
_TILT_BLOCK_S: Final = 0.25
_TILT_CORRELATION: Final = 0.7


@dataclass(frozen=True)
class AttitudeFit:
    """How the gyros follow the change of the reference's attitude.

    Attributes
    ----------
    scale : float
        Measured over true.
    correlation : float
        1 or -1 where the gyros show nothing else.
    excursion : ndarray, shape (3,)
        From the least to the largest angle of the reference's attitude about each axis, rad: of a vehicle that lies
        still there is only noise to compare.
    by_axis : ndarray, shape (3,)
        The correlation about each axis.
    """

    scale: float
    correlation: float
    excursion: Floats
    by_axis: Floats


def gyro_by_attitude(imu: ImuColumns, reference: ReferenceColumns) -> AttitudeFit | None:
    """Compare what the gyros add up to between two attitudes of the reference with the turn that it shows.

    Returns
    -------
    AttitudeFit or None
        None where the vehicle turned too little for it.
    """
    rows = np.flatnonzero(np.isfinite(reference.mat_nb).all(axis=(1, 2)) & lies_within(reference.time_ns, imu.time_ns))
    time_s, mat_nb = seconds(reference.time_ns[rows], imu.time_ns[0]), reference.mat_nb[rows]
    if len(rows) < ENOUGH:
        return None
    turned = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])
    step_s = np.diff(time_s)
    summed = np.diff(turned_by(imu, time_s), axis=0)
    turning = np.linalg.norm(turned, axis=1) > _LEAST_TURN_RADPS * step_s
    good = turning & (step_s <= LONGEST_STEP_S) & (np.linalg.norm(turned, axis=1) < 1.0)
    if np.count_nonzero(good) < ENOUGH:
        return None
    product, power, summed_power = (
        np.sum(one[good] * other[good], axis=0) for one, other in ((summed, turned), (turned, turned), (summed, summed))
    )
    return AttitudeFit(
        scale=float(product.sum() / power.sum()),
        correlation=float(_correlation(product.sum(), power.sum() * summed_power.sum())),
        excursion=np.ptp(np.cumsum(turned, axis=0), axis=0),
        by_axis=_correlation(product, power * summed_power),
    )


def _correlation(product: Floats, powers: Floats) -> Floats:
    """Divide by the root of both powers; 0 where one is 0."""
    return np.divide(product, np.sqrt(powers), out=np.zeros_like(product), where=powers > 0.0)


def gyro_by_gravity(imu: ImuColumns) -> float | None:
    """Compare the gyros with the change of gravity's direction in body axes, ``du/dt = -w x u``."""
    length = samples_in(imu, _TILT_BLOCK_S)
    blocks = len(imu.time_ns) // length
    if blocks <= 2 * ENOUGH:
        return None
    starts = np.arange(0, blocks * length, length)
    force_b, rate_b = (
        np.add.reduceat(readings[: blocks * length], starts, axis=0) / length
        for readings in (imu.specific_force_b, imu.angular_rate_b)
    )
    size = np.linalg.norm(force_b, axis=1, keepdims=True)
    direction = np.divide(force_b, size, out=np.zeros_like(force_b), where=size > 0.0)
    step_s = seconds(imu.time_ns[length : blocks * length : length], imu.time_ns[: (blocks - 1) * length : length])
    turned = -np.cross(rate_b[1:] + rate_b[:-1], direction[1:] + direction[:-1]) / 4.0 * step_s[:, None]
    seen = np.diff(direction, axis=0)
    good = step_s < 2.0 * _TILT_BLOCK_S
    product = float(np.sum(turned[good] * seen[good]))
    power = float(np.sum(turned[good] ** 2))
    if product**2 <= _TILT_CORRELATION**2 * power * float(np.sum(seen[good] ** 2)):
        return None
    return power / product


def turned_by(imu: ImuColumns, at_s: Floats, longest_s: float = np.inf) -> Floats:
    """Add up the angular rate from the first sample on.

    Parameters
    ----------
    at_s : ndarray, shape (k,)
        Times in seconds from the first sample.
    longest_s : float
        In longer pauses nothing is added, since nobody saw what turned in them.

    Returns
    -------
    ndarray, shape (k, 3), rad
        Along each axis of the body.
    """
    sample_s = seconds(imu.time_ns, imu.time_ns[0])
    step_s = np.diff(sample_s)
    step_s[step_s > longest_s] = 0.0
    columns = []
    for rate in imu.angular_rate_b.T:
        total = np.zeros(len(rate))
        turned = np.add(rate[1:], rate[:-1], out=total[1:])
        turned *= 0.5
        turned *= step_s
        np.cumsum(turned, out=turned)
        columns.append(np.interp(at_s, sample_s, total))
    return np.stack(columns, axis=1)


def lies_within(time_ns: TimeNs, others_ns: TimeNs) -> NDArray[np.bool_]:
    """Find which times lie between the first and the last of others.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    others_ns : ndarray, shape (m,)
        In order.

    Returns
    -------
    ndarray of bool, shape (k,)
    """
    return np.asarray((time_ns >= others_ns[0]) & (time_ns <= others_ns[-1]))
