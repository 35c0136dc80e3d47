"""The level from gravity: what accelerometers feel less what the DVL says the vehicle itself does.

In the Earth's frame ``dv/dt = f + g``. The gyros turn everything to the body axes at the start, by R from b at a time
to b at the start, so that a vehicle that turns or changes its speed is levelled like one at rest:

    R v_b - int R f dt = v_b(start) + g_b t

A straight line through the left side, known at each ping, has gravity as its slope. Coriolis' acceleration is left out,
0.002 deg at 2 m/s, as is the gyros' white noise.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ImuColumns, TimeNs, distinct, nanoseconds, seconds
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, skew
from insdvl_replay.nav.dvl import DvlVelocities

LEVELLING_S: Final = 10.0
"""Longest time over which gravity is looked for: pings of 1 Hz and 2 cm/s tell it to 0.013 deg, far below any bias."""
FEWEST_SAMPLES: Final = 10
"""With fewer samples gravity is not told from motion."""
LONGEST_PAUSE_S: Final = 0.5
"""Nobody integrates across a longer pause of the IMU."""
UNSEEN_MPS2: Final = 0.5
"""Standard deviation of a vehicle's mean acceleration where no DVL sees it: a turn at 2 m/s and 15 deg/s."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the sensors that find the level.

    Attributes
    ----------
    velocity_cov_b : ndarray, shape (m, 3, 3)
        Of each ping, m^2/s^2.
    accel_white_mps_rts : float
        Of the accelerometers, m/s/sqrt(s).
    """

    velocity_cov_b: Floats
    accel_white_mps_rts: float


@dataclass(frozen=True)
class Level:
    """Gravity as the vehicle feels it at the start, and how it errs.

    The error of ``gravity_b`` is ``per_accel_bias @ b_a + per_gyro_bias @ b_g`` plus noise, for biases of readings that
    are true plus bias.

    Attributes
    ----------
    gravity_b : ndarray, shape (3,)
        m/s^2, downwards.
    velocity_b : ndarray, shape (3,)
        Of the IMU over ground at the start, by the first ping, m/s; NaN without pings.
    per_accel_bias : ndarray, shape (3, 3)
        Near minus one.
    per_gyro_bias : ndarray, shape (3, 3)
        m/s^2 for one rad/s.
    noise_cov_b : ndarray, shape (3, 3)
        m^2/s^4
    span_s : float
        Time over which gravity was found.
    pings : int
        That took the vehicle's own acceleration off; 0 where there were too few.
    """

    gravity_b: Floats
    velocity_b: Floats
    per_accel_bias: Floats
    per_gyro_bias: Floats
    noise_cov_b: Floats
    span_s: float
    pings: int

    @property
    def roll_pitch(self) -> tuple[float, float]:
        """Roll and pitch, rad."""
        x, y, z = self.gravity_b
        return float(np.arctan2(y, z)), float(np.arctan2(-x, np.hypot(y, z)))


@dataclass(frozen=True)
class _Window:
    """Readings and what they add up to at the nodes, which are the IMU's times, the start and the pings.

    ``mat`` takes b to b at the start; ``force_sum`` and ``mat_sum`` integrate ``mat f`` and ``mat`` from the start on.
    """

    time_ns: TimeNs
    time_s: Floats
    force_b: Floats
    rate_eb_b: Floats
    mat: Floats
    force_sum: Floats
    mat_sum: Floats


def levelling_samples(imu: ImuColumns, start_ns: int) -> ImuColumns:
    """Keep the samples of `LEVELLING_S` after the start, up to the first pause.

    Returns
    -------
    ImuColumns
        With fewer than `FEWEST_SAMPLES` the level is not found.
    """
    first = int(np.searchsorted(imu.time_ns, start_ns))
    last = int(np.searchsorted(imu.time_ns, start_ns + nanoseconds(LEVELLING_S), side="right"))
    pauses = np.flatnonzero(np.diff(imu.time_ns[first:last]) > nanoseconds(LONGEST_PAUSE_S))
    rows = slice(first, first + 1 + int(pauses[0]) if pauses.size else last)
    return ImuColumns(imu.time_ns[rows], imu.specific_force_b[rows], imu.angular_rate_b[rows])


def find_level(
    samples: ImuColumns,
    velocities: DvlVelocities,
    noise: SensorNoise,
    lever_arm_b: Floats,
    start_ns: int,
    *,
    heading: float,
    latitude: float,
) -> Level:
    """Find gravity in the body axes at the start.

    Levelling as in Groves, chapter 5, with the vehicle's own acceleration taken off.

    Parameters
    ----------
    samples : ImuColumns
        From `levelling_samples`, without the biases that are known beforehand.
    velocities : DvlVelocities
        m pings.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    heading, latitude : float
        Of the start, rad; they say where the Earth's rotation points.
    """
    heard = (velocities.time_ns >= start_ns) & (velocities.time_ns <= samples.time_ns[-1])
    window = _window(samples, velocities.time_ns[heard], start_ns, heading, latitude)
    unaided = _by_mean_force(window, noise)
    if np.count_nonzero(heard) < 2:
        return unaided
    aided = _by_velocities(window, velocities, heard, noise, lever_arm_b)
    return min(aided, unaided, key=lambda level: float(np.trace(level.noise_cov_b)))


def _window(imu: ImuColumns, ping_ns: TimeNs, start_ns: int, heading: float, latitude: float) -> _Window:
    """Turn all readings to the body axes at the start, in the frame of the Earth."""
    time_ns = distinct(np.concatenate([[start_ns], imu.time_ns, ping_ns]))
    time_s, sample_s = seconds(time_ns, start_ns), seconds(imu.time_ns, start_ns)
    force_b, rate_ib_b = (
        np.column_stack([np.interp(time_s, sample_s, column) for column in readings.T])
        for readings in (imu.specific_force_b, imu.angular_rate_b)
    )
    rate_ie_b = _earth_rate_b(force_b.mean(axis=0), heading, latitude)
    # Seen from the stars, the Earth turns about an axis that stands still in b at the start.
    mat_from_inertial = mat_from_vector(-time_s[:, None] * rate_ie_b)
    mat = mat_from_inertial @ _turned(rate_ib_b, time_s)
    return _Window(
        time_ns,
        time_s,
        force_b,
        rate_ib_b - np.einsum("kji,j->ki", mat, rate_ie_b),
        mat,
        _integral(np.einsum("kij,kj->ki", mat, force_b), time_s),
        _integral(mat, time_s),
    )


def _earth_rate_b(mean_force_b: Floats, heading: float, latitude: float) -> Floats:
    """Return the Earth's rotation in b; a level that is wrong by 3 deg moves the result by 0.001 deg."""
    x, y, z = mean_force_b
    mat_nb = mat_from_rpy(np.array([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), heading]))
    rate_ie_b: Floats = earth_rate_n(latitude) @ mat_nb
    return rate_ie_b


def _turned(rate_b: Floats, time_s: Floats) -> Floats:
    """Return the rotation from b at each time to b at the first, shape (k, 3, 3).

    Products of neighbours are doubled in reach until each has all before it, in place of one after the other.
    """
    step = 0.5 * (rate_b[1:] + rate_b[:-1]) * np.diff(time_s)[:, None]
    mat = np.concatenate([np.eye(3)[None], mat_from_vector(step)])
    reach = 1
    while reach < len(mat):
        mat[reach:] = mat[:-reach] @ mat[reach:]
        reach *= 2
    return mat


def _integral(values: Floats, time_s: Floats) -> Floats:
    """Integrate along the first axis from the first time on, by trapezoids."""
    step_s = np.diff(time_s).reshape(-1, *[1] * (values.ndim - 1))
    total = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) * step_s, axis=0, out=total[1:])
    return total


def _by_velocities(
    window: _Window, velocities: DvlVelocities, heard: NDArray[np.bool_], noise: SensorNoise, lever_arm_b: Floats
) -> Level:
    """Lay a straight line through the pings, which are as noisy as is told, or as they scatter, if that is more."""
    rows = np.searchsorted(window.time_ns, velocities.time_ns[heard])
    velocity_b = velocities.velocity_b[heard] - np.cross(window.rate_eb_b[rows], lever_arm_b)
    turned = np.einsum("kij,kj->ki", window.mat[rows], velocity_b)
    free = turned - window.force_sum[rows]
    time_s = window.time_s[rows] - window.time_s[rows].mean()
    weights = time_s / np.sum(time_s**2)
    slope = weights @ free
    mat, cov_b = window.mat[rows], noise.velocity_cov_b[heard]
    told = np.einsum("k,kij,kjl,kml->im", weights**2, mat, cov_b, mat)
    scatter = np.sum((free - free.mean(axis=0) - np.outer(time_s, slope)) ** 2)
    expected = float(np.trace(cov_b.mean(axis=0))) * (len(rows) - 2)
    larger = max(1.0, float(scatter) / expected) if expected > 0.0 else 1.0
    # The nearest ping errs by less than the line's intercept, which holds all that the accelerometers err by.
    velocity_at_start_b = free[0] - slope * window.time_s[rows[0]]
    per_gyro_bias = mat @ skew(lever_arm_b) - skew(turned) @ window.mat_sum[rows]
    return _level(window, rows, weights, turned, per_gyro_bias, noise, larger * told, velocity_at_start_b, len(rows))


def _by_mean_force(window: _Window, noise: SensorNoise) -> Level:
    """Take the velocity for the same at the end as at the start."""
    rows, time_s = np.array([0, len(window.time_s) - 1]), window.time_s
    weights = np.array([-1.0, 1.0]) / time_s[-1]
    unseen = UNSEEN_MPS2**2 * np.eye(3)
    still, still_per_gyro_bias = np.zeros((2, 3)), np.zeros((2, 3, 3))
    return _level(window, rows, weights, still, still_per_gyro_bias, noise, unseen, np.full(3, np.nan), 0)


def _level(
    window: _Window,
    rows: NDArray[np.int64],
    weights: Floats,
    turned: Floats,
    turned_per_gyro_bias: Floats,
    noise: SensorNoise,
    velocity_cov: Floats,
    velocity_b: Floats,
    pings: int,
) -> Level:
    """Weigh what is known at some rows to gravity, its sensitivities and its noise."""
    time_s = window.time_s
    # A gyro's bias turns what is carried to the start by mat_sum times it.
    swung = skew(np.einsum("kij,kj->ki", window.mat, window.force_b)) @ window.mat_sum
    per_gyro_bias = _integral(swung, time_s)[rows] + turned_per_gyro_bias
    later = np.cumsum(weights[::-1])[::-1]
    white = noise.accel_white_mps_rts**2 * float(np.sum(later**2 * np.diff(time_s[rows], prepend=0.0)))
    return Level(
        weights @ (turned - window.force_sum[rows]),
        velocity_b,
        -np.einsum("k,kij->ij", weights, window.mat_sum[rows]),
        np.einsum("k,kij->ij", weights, per_gyro_bias),
        velocity_cov + white * np.eye(3),
        float(time_s[-1]),
        pings,
    )
