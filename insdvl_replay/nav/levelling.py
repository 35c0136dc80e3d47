"""The start of a filter: the level from gravity, the covariance of the errors at the start, and drawn starts.

Gravity is what accelerometers feel less what the DVL measures of the vehicle's own acceleration. In the Earth's frame
``dv/dt = f + g``. The gyros turn everything to the body axes at the start, by R from b at a time to b at the start, so
that a vehicle that turns or accelerates is levelled like one at rest:

    R v_b - int R f dt = v_b(start) + g_b t

A straight line through the left side, known at each ping, has gravity as its slope. The Coriolis acceleration, 0.002
deg at 2 m/s, and the gyros' white noise are left out.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ImuColumns, TimeNs, distinct, nanoseconds, seconds
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, skew
from insdvl_replay.nav.dvl import DvlVelocities

LEVELLING_S: Final = 10.0
"""Longest time for the level: pings of 1 Hz and 2 cm/s determine it to 0.013 deg, far below any bias."""
FEWEST_SAMPLES: Final = 10
"""With fewer samples the level is not found."""
LONGEST_PAUSE_S: Final = 0.5
"""Longest pause of the IMU to integrate across."""
UNSEEN_MPS2: Final = 0.5
"""Standard deviation of a vehicle's mean acceleration without a DVL: a turn at 2 m/s and 15 deg/s."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the sensors that find the level."""

    velocity_cov_b: Floats  # (m, 3, 3), of each ping, m^2/s^2
    accel_white_mps_rts: float  # m/s/sqrt(s)


@dataclass(frozen=True)
class Level:
    """Gravity in the body axes at the start, and its error.

    The error of ``gravity_b`` is ``per_accel_bias @ b_a + per_gyro_bias @ b_g`` plus noise, for biases of readings that
    are true plus bias.
    """

    gravity_b: Floats  # (3,), m/s^2, downwards
    velocity_b: Floats  # (3,), of the IMU over ground at the start, by the first ping, m/s; NaN without pings
    per_accel_bias: Floats  # (3, 3), near minus one
    per_gyro_bias: Floats  # (3, 3), m/s^2 for one rad/s
    noise_cov_b: Floats  # (3, 3), m^2/s^4
    span_s: float  # time over which gravity was found
    pings: int  # that removed the vehicle's own acceleration; 0 where there were too few

    @property
    def roll_pitch(self) -> tuple[float, float]:
        """Roll and pitch, rad."""
        x, y, z = self.gravity_b
        return float(np.arctan2(y, z)), float(np.arctan2(-x, np.hypot(y, z)))


@dataclass(frozen=True)
class _Window:
    """Readings and their integrals at the nodes, which are the IMU's times, the start and the pings."""

    time_ns: TimeNs
    time_s: Floats
    force_b: Floats
    rate_eb_b: Floats
    mat: Floats  # b to b at the start
    force_sum: Floats  # integral of ``mat f`` from the start
    mat_sum: Floats  # integral of ``mat``


def levelling_samples(imu: ImuColumns, start_ns: int) -> ImuColumns:
    """Keep the samples of `LEVELLING_S` after the start, up to the first pause; `FEWEST_SAMPLES` are needed."""
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
    # The Earth's rotation in b; a level that is wrong by 3 deg moves the result by 0.001 deg.
    x, y, z = force_b.mean(axis=0)
    mat_nb = mat_from_rpy(np.array([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), heading]))
    rate_ie_b: Floats = earth_rate_n(latitude) @ mat_nb
    # The rotation from b at each time to b at the first. Products of neighbours are doubled in reach until each
    # contains all before it.
    step = 0.5 * (rate_ib_b[1:] + rate_ib_b[:-1]) * np.diff(time_s)[:, None]
    turned = np.concatenate([np.eye(3)[None], mat_from_vector(step)])
    reach = 1
    while reach < len(turned):
        turned[reach:] = turned[:-reach] @ turned[reach:]
        reach *= 2
    # In inertial space, the Earth turns about an axis that is fixed in b at the start.
    mat = mat_from_vector(-time_s[:, None] * rate_ie_b) @ turned
    return _Window(
        time_ns,
        time_s,
        force_b,
        rate_ib_b - np.einsum("kji,j->ki", mat, rate_ie_b),
        mat,
        _integral(np.einsum("kij,kj->ki", mat, force_b), time_s),
        _integral(mat, time_s),
    )


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


@dataclass(frozen=True)
class Start:
    """The state of a filter at the start, and its uncertainty."""

    position: Floats  # (3,), latitude rad, longitude rad, height m
    velocity_n: Floats  # (3,), m/s
    mat_nb: Floats  # (3, 3)
    cov: Floats  # (n, n), of the error states, SI units
    accel_bias_b: Floats = field(default_factory=lambda: np.zeros(3))  # known beforehand, m/s^2
    gyro_bias_b: Floats = field(default_factory=lambda: np.zeros(3))  # rad/s
    constants: Floats = field(default_factory=lambda: np.zeros(0))  # (c,), of the sensors, that have states
    is_heading_sensed: bool = False  # the heading is the sensor's, with its bias

    @property
    def sd(self) -> Floats:
        """Standard deviations of the error states, shape (12,)."""
        return np.sqrt(np.diagonal(self.cov))


def with_more_states(start: Start, more_sd: Floats, constants: int, *, heading_bias: bool = False) -> Start:
    """Add states to a start, independent of all others except the bias of a heading that was the sensor's.

    Parameters
    ----------
    more_sd : ndarray, shape (n - 12,)
        Their standard deviations.
    constants : int
        How many of them are constants of the sensors, which start as zero.
    heading_bias : bool
        Whether the last of them is that bias.
    """
    if not len(more_sd):
        return start
    n, cov = len(start.cov), np.diag(np.concatenate([start.sd, more_sd]) ** 2)
    cov[:n, :n] = start.cov
    if heading_bias and start.is_heading_sensed:
        by_heading = np.append(start.cov[:, PHI.stop - 1] / start.cov[PHI.stop - 1, PHI.stop - 1], 1.0)
        rows = [*range(n), len(cov) - 1]
        cov[len(cov) - 1, len(cov) - 1] = 0.0
        cov[np.ix_(rows, rows)] += more_sd[-1] ** 2 * np.outer(by_heading, by_heading)
    return replace(start, cov=cov, constants=np.zeros(constants))


def start_cov(sd: Floats, mat_nb: Floats, level: Level | None, velocity_by_dvl_n: Floats | None) -> Floats:
    """Return the covariance of a start from the errors that do not depend on each other.

    Accelerometers that are biased tilt the level by exactly ``phi = (-b_e, b_n) / g``, and a velocity that the DVL
    measures in b is off by ``phi x v`` in n: what the filter finds of one it finds of the other.

    Parameters
    ----------
    sd : ndarray, shape (12,)
        Of the error states where each is known by itself.
    mat_nb : ndarray, shape (3, 3)
        Attitude at the start.
    level : Level or None
        Where it made roll and pitch, whose standard deviations then follow from it.
    velocity_by_dvl_n : ndarray, shape (3,), or None
        The velocity, where the DVL's was turned to n.

    Returns
    -------
    ndarray, shape (12, 12)
    """
    effect, own = np.eye(len(sd)), np.diag(sd**2)
    if level is not None:
        tilt = slice(PHI.start, PHI.start + 2)
        # C_hat' e_d is gravity's direction in b, so that phi x e_d = -C times its error.
        per_gravity = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) @ mat_nb / np.linalg.norm(level.gravity_b)
        effect[tilt, BA] = per_gravity @ level.per_accel_bias
        effect[tilt, BG] = per_gravity @ level.per_gyro_bias
        own[tilt, tilt] = per_gravity @ level.noise_cov_b @ per_gravity.T
    if velocity_by_dvl_n is not None:
        effect[DV] += -skew(velocity_by_dvl_n) @ effect[PHI]
    cov: Floats = effect @ own @ effect.T
    return 0.5 * (cov + cov.T)


def drawn_starts(start: Start, count: int, seed: int | tuple[int, ...]) -> tuple[Start, ...]:
    """Return a start, and others with errors that are drawn from its covariance.

    A replay starts on its reference, without the errors that P0 allows for and that aiding exists to find. Only drawn
    starts show how fast a filter finds them.

    Parameters
    ----------
    count : int
        How many, with the start itself. Of two counts, the smaller gives the first of the larger.
    seed : int
        Of the draws. Filters with equal starts get equal errors.

    Returns
    -------
    tuple of Start
        The first is the start itself. All have its position, which has no error state, and its covariance.
    """
    # By a triangular factor, which is the same on every processor; eigenvectors of equal variances would not be. The
    # states are scaled by their standard deviations first: in SI units P0 spans some ten decades.
    factor = np.linalg.cholesky(start.cov / np.outer(start.sd, start.sd))
    normal = np.random.default_rng(seed).standard_normal((max(count - 1, 0), len(start.cov)))
    return (start, *(start_with_error(start, start.sd * (factor @ draw)) for draw in normal))


def start_with_error(start: Start, error: Floats) -> Start:
    """Add an error to a start: the inverse of `kalman.correct`, which takes the same errors out.

    The velocity follows from the error that is exact for misalignments of any size, ``dv + v_hat x phi``, which is
    ``v_hat - exp([phi x]) v``: ``(I + [phi x]) v_hat = exp([phi x]) v + dv``.

    Parameters
    ----------
    error : ndarray, shape (12,)
        Estimated minus true, of a bias true minus estimated, in the order of `states.STATES`, SI units.
    """
    turn = mat_from_vector(error[PHI])
    velocity_n = np.linalg.solve(np.eye(3) + skew(error[PHI]), turn @ start.velocity_n + error[DV])
    return replace(
        start,
        velocity_n=np.asarray(velocity_n, dtype=np.float64),
        mat_nb=turn @ start.mat_nb,
        accel_bias_b=start.accel_bias_b - error[BA],
        gyro_bias_b=start.gyro_bias_b - error[BG],
    )
