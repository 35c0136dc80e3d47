"""The start of a filter: the level from gravity, the covariance of the errors at the start, and random starts.

Gravity is what accelerometers feel less what the DVL measures of the vehicle's own acceleration. In the Earth's frame
``dv/dt = f + g``. The gyros turn everything to the body axes at the start, by R from b at a time to b at the start, so
that a vehicle that turns or accelerates is levelled like one at rest:

    R v_b - int R f dt = v_b(start) + g_b t

A straight line through the left side, known at each ping, has gravity as its slope. The Coriolis acceleration, 0.002
deg at 2 m/s, and the gyros' white noise are left out.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ImuColumns, distinct, nanoseconds, seconds
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.geometry.earth import earth_rate_n
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, skew
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.increments import UNEVEN, Readings, increments, readings_between

LEVELLING_S: Final = 10.0
"""Longest time for the level: pings of 1 Hz and 2 cm/s determine it to 0.013 deg, far below any bias."""
FEWEST_SAMPLES: Final = 10
"""With fewer samples the level is not found."""
LONGEST_PAUSE_S: Final = 0.5
"""Longest pause of the IMU to integrate across."""
NOTHING: Final = (0.0, 0.0, 0.0)
FEWEST_SCATTERING: Final = 6
"""With fewer pings, their scatter does not show that their noise is smaller than that of the settings."""
UNSEEN_MPS2: Final = 0.5
"""Standard deviation of a vehicle's mean acceleration without a DVL: a turn at 2 m/s and 15 deg/s."""


@dataclass(frozen=True)
class Level:
    """Gravity in the body axes at the start, and its error.

    The error of ``gravity_b`` is ``per_accel_bias @ b_a + per_gyro_bias @ b_g`` plus noise, for biases of readings that
    are true plus bias.
    """

    gravity_b: Floats  # (3,), m/s^2, downwards
    velocity_b: Floats  # (3,), of the IMU over ground at the start, by the first ping, m/s; NaN without pings
    velocity_cov_b: Floats  # (3, 3), of its noise, by the scatter of the pings, m^2/s^2
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
    velocity_cov_b: Floats,
    accel_white_mps_rts: float,
    lever_arm_b: Floats,
    start_ns: int,
    *,
    heading: float,
    latitude: float,
) -> Level:
    """Find gravity in the body axes at the start.

    Levelling as in Groves, chapter 5, with the vehicle's own acceleration removed.

    Parameters
    ----------
    samples : ImuColumns
        From `levelling_samples`, without the biases that are known beforehand.
    velocities : DvlVelocities
        m pings.
    velocity_cov_b : ndarray, shape (m, 3, 3)
        Their noise, m^2/s^2.
    accel_white_mps_rts : float
        White noise of the accelerometers, m/s/sqrt(s).
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    heading, latitude : float
        Of the start, rad, for the direction of the Earth's rotation.
    """
    inside = (velocities.time_ns >= start_ns) & (velocities.time_ns <= samples.time_ns[-1])
    ping_ns = velocities.time_ns[inside]
    time_ns = distinct(np.concatenate([[start_ns], samples.time_ns, ping_ns]))
    time_s = seconds(time_ns, start_ns)
    sample_s = seconds(samples.time_ns, start_ns)
    at = _readings_at(samples, sample_s, time_s)
    force_b = np.column_stack(at.specific_force_b)
    rate_ib_b = np.column_stack(at.angular_rate_b)
    # The Earth's rotation in b; a level that is wrong by 3 deg moves the result by 0.001 deg.
    x, y, z = force_b.mean(axis=0)
    mat_nb = mat_from_rpy(np.array([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), heading]))
    rate_ie_b: Floats = earth_rate_n(latitude) @ mat_nb
    # The rotation from b at each time to b at the first. Products of neighbours are doubled in reach until each
    # contains all before it. In inertial space, the Earth turns about an axis that is fixed in b at the start.
    step_s: Any = np.diff(time_s)
    summed = increments(
        _rows(at, slice(None, -1)), _rows(at, slice(1, None)), NOTHING, NOTHING, step_s
    )
    turned = np.concatenate([np.eye(3)[None], mat_from_vector(np.column_stack(summed.turn_b))])
    reach = 1
    while reach < len(turned):
        turned[reach:] = turned[:-reach] @ turned[reach:]
        reach *= 2
    mat = mat_from_vector(-time_s[:, None] * rate_ie_b) @ turned
    rate_eb_b = rate_ib_b - np.einsum("kji,j->ki", mat, rate_ie_b)
    turned_force_b = np.einsum("kij,kj->ki", mat, force_b)
    mean_force_b = np.einsum(
        "kij,kj->ki", 0.5 * (mat[1:] + mat[:-1]), np.column_stack(summed.mean_force_b)
    )
    force_sum = np.concatenate(
        [np.zeros((1, 3)), np.cumsum(step_s[:, None] * mean_force_b, axis=0)]
    )
    mat_sum = _integral(mat, time_s)
    # A gyro's bias turns what is carried to the start by mat_sum times it.
    swung = _integral(skew(turned_force_b) @ mat_sum, time_s)

    def level(
        rows: NDArray[np.int64],
        weights: Floats,
        velocity: Floats,  # at the rows, turned to b at the start
        per_gyro_bias: Floats,
        velocity_cov: Floats,
        velocity_b: Floats,
        ping_cov_b: Floats,
        pings: int,
    ) -> Level:
        later = np.cumsum(weights[::-1])[::-1]
        white = accel_white_mps_rts**2 * float(
            np.sum(later**2 * np.diff(time_s[rows], prepend=0.0))
        )
        return Level(
            weights @ (velocity - force_sum[rows]),
            velocity_b,
            ping_cov_b,
            -np.einsum("k,kij->ij", weights, mat_sum[rows]),
            np.einsum("k,kij->ij", weights, swung[rows] + per_gyro_bias),
            velocity_cov + white * np.eye(3),
            float(time_s[-1]),
            pings,
        )

    # Without a DVL, the velocity counts as equal at the end and at the start.
    ends = np.array([0, len(time_s) - 1])
    unseen = UNSEEN_MPS2**2 * np.eye(3)
    difference = np.array([-1.0, 1.0]) / time_s[-1]
    still = np.zeros((2, 3))
    per_gyro_bias = np.zeros((2, 3, 3))
    unaided = level(
        ends,
        difference,
        still,
        per_gyro_bias,
        unseen,
        np.full(3, np.nan),
        np.full((3, 3), np.nan),
        0,
    )
    if len(ping_ns) < 2:
        return unaided

    # With one, a straight line through the pings. Their noise is that of the settings, or their scatter if larger.
    rows = np.searchsorted(time_ns, ping_ns)
    cov_b = velocity_cov_b[inside]
    velocity = np.einsum(
        "kij,kj->ki",
        mat[rows],
        velocities.velocity_b[inside] - np.cross(rate_eb_b[rows], lever_arm_b),
    )
    free = velocity - force_sum[rows]
    ping_s = time_s[rows] - time_s[rows].mean()
    weights = ping_s / np.sum(ping_s**2)
    slope = weights @ free
    slope_cov = np.einsum("k,kij,kjl,kml->im", weights**2, mat[rows], cov_b, mat[rows])
    scatter = float(np.sum((free - free.mean(axis=0) - np.outer(ping_s, slope)) ** 2))
    expected = float(np.trace(cov_b.mean(axis=0))) * (len(rows) - 2)
    larger = max(1.0, scatter / expected) if expected > 0.0 else 1.0
    # The noise of the first ping: by the scatter, shared among the axes as beams do; with few pings by the settings.
    ping_cov_b = larger * cov_b[0]
    if len(rows) >= FEWEST_SCATTERING:
        unit_cov_b = velocities.unit_cov_b[inside]
        ping_cov_b = (
            scatter / (float(np.trace(unit_cov_b.mean(axis=0))) * (len(rows) - 2)) * unit_cov_b[0]
        )
    # The first ping errs less than the line's intercept, which contains the whole error of the accelerometers.
    velocity_b = free[0] - slope * time_s[rows[0]]
    per_gyro_bias = mat[rows] @ skew(lever_arm_b) - skew(velocity) @ mat_sum[rows]
    aided = level(
        rows,
        weights,
        velocity,
        per_gyro_bias,
        larger * slope_cov,
        velocity_b,
        ping_cov_b,
        len(rows),
    )
    return min(aided, unaided, key=lambda found: float(np.trace(found.noise_cov_b)))


def _readings_at(samples: ImuColumns, sample_s: Floats, time_s: Floats) -> Any:
    """Return `increments.Readings` at times, each component an array of shape (k,), on the cubic of the filter."""
    row = np.clip(
        np.searchsorted(sample_s, time_s, side="right") - 1, 0, max(len(sample_s) - 2, 0)
    )
    after = np.minimum(row + 1, len(sample_s) - 1)
    into_s: Any = np.clip(time_s, sample_s[0], sample_s[-1]) - sample_s[row]
    step_s: Any = np.maximum(sample_s[after] - sample_s[row], np.finfo(float).tiny)
    columns = (samples.specific_force_b, samples.angular_rate_b)
    whole = Readings(
        *(
            tuple(column.T)
            for column in (*columns, *(_bends(column, sample_s) for column in columns))
        )
    )
    return readings_between(_rows(whole, row), _rows(whole, after), into_s, step_s)


def _bends(readings: Floats, sample_s: Floats) -> Floats:
    """Return the bends at samples, shape (k, 3), as `timeline` finds them one by one."""
    bends = np.zeros_like(readings)
    step_s = np.diff(sample_s)[:, None]
    if len(readings) < 3:
        return bends
    before_s = step_s[:-1]
    after_s = step_s[1:]
    even = (before_s <= UNEVEN * after_s) & (after_s <= UNEVEN * before_s)
    slope = np.diff(readings, axis=0) / step_s
    bends[1:-1] = np.where(even, np.diff(slope, axis=0) / (before_s + after_s), 0.0)
    bends[[0, -1]] = bends[[1, -2]]
    return bends


def _rows(readings: Any, rows: slice | NDArray[np.int64]) -> Any:
    return Readings(*(tuple(column[rows] for column in vector) for vector in readings))


def _integral(values: Floats, time_s: Floats) -> Floats:
    """Integrate along the first axis from the first time on, by trapezoids."""
    step_s = np.diff(time_s).reshape(-1, *[1] * (values.ndim - 1))
    total = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) * step_s, axis=0, out=total[1:])
    return total


@dataclass(frozen=True)
class Start:
    """The state of a filter at the start, and its uncertainty."""

    position: Floats  # (3,), latitude rad, longitude rad, height m
    velocity_n: Floats  # (3,), m/s
    mat_nb: Floats  # (3, 3)
    cov: Floats  # (n, n), of the error states, SI units
    accel_bias_b: Floats = field(default_factory=lambda: np.zeros(3))  # known beforehand, m/s^2
    gyro_bias_b: Floats = field(default_factory=lambda: np.zeros(3))  # rad/s
    # (c,), of the sensors, that have states
    constants: Floats = field(default_factory=lambda: np.zeros(0))
    is_heading_sensed: bool = False  # the heading is the sensor's, with its bias

    @property
    def sd(self) -> Floats:
        """Standard deviations of the error states, shape (12,)."""
        return np.sqrt(np.diagonal(self.cov))


def with_more_states(
    start: Start,
    more_sd: Floats,
    constants: int,
    *,
    heading_bias: bool = False,
) -> Start:
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
    n = len(start.cov)
    cov = np.diag(np.concatenate([start.sd, more_sd]) ** 2)
    cov[:n, :n] = start.cov
    if heading_bias and start.is_heading_sensed:
        by_heading = np.append(
            start.cov[:, PHI.stop - 1] / start.cov[PHI.stop - 1, PHI.stop - 1], 1.0
        )
        rows = [*range(n), len(cov) - 1]
        cov[len(cov) - 1, len(cov) - 1] = 0.0
        cov[np.ix_(rows, rows)] += more_sd[-1] ** 2 * np.outer(by_heading, by_heading)
    return replace(start, cov=cov, constants=np.zeros(constants))


def start_cov(
    sd: Floats,
    mat_nb: Floats,
    level: Level | None,
    velocity_by_dvl_n: Floats | None,
    velocity_cov_n: Floats | None = None,
) -> Floats:
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
    velocity_cov_n : ndarray, shape (3, 3), or None
        Covariance of its noise, m^2/s^2, where it is known better than by ``sd``.

    Returns
    -------
    ndarray, shape (12, 12)
    """
    effect = np.eye(len(sd))
    own = np.diag(sd**2)
    if level is not None:
        tilt = slice(PHI.start, PHI.start + 2)
        # C_hat' e_d is gravity's direction in b, so that phi x e_d = -C times its error.
        per_gravity = (
            np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
            @ mat_nb
            / np.linalg.norm(level.gravity_b)
        )
        effect[tilt, BA] = per_gravity @ level.per_accel_bias
        effect[tilt, BG] = per_gravity @ level.per_gyro_bias
        own[tilt, tilt] = per_gravity @ level.noise_cov_b @ per_gravity.T
    if velocity_cov_n is not None:
        own[DV, DV] = velocity_cov_n
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
