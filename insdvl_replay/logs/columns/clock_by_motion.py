"""Which times of the IMU pings of a DVL belong to, where their clocks have nothing to do with each other.

The velocities of a DVL change as accelerometers, gyros and gravity say, and its own attitude turns as the gyros say, at
the right times alone. No axes, signs, scales, mounting or lever arm need to be known: they are the free coefficients of
linear fits. A first search goes through all lags at once, by correlations: rates of change over a second, beside the
specific force without gravity, the products of angular rate and velocity, and the angular acceleration. Then lag and
drift are fitted. Gyros turn the pings into axes that do not turn, in which the velocity gains what the accelerometers
say and a curve of second order that stands for gravity, in blocks of half a minute. Standard errors come from the
scatter of the scores of the blocks, in which residuals may be correlated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, pairwise
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import (
    Array,
    Floats,
    ImuColumns,
    Integers,
    Mask,
    TimeNs,
    seconds,
)
from insdvl_replay.geometry.rotation import mat_from_vector, skew, vector_from_mat

DRIFT_SD: Final = 5e-5  # of the clocks of instruments, before it is measured
SURE_S: Final = 0.03  # standard error with which a lag counts as found
FEWEST: Final = 60  # samples and pings
LEAST_OVERLAP: Final = 0.25  # of the shorter file
SHORTEST_OVERLAP_S: Final = 30.0
LIKELY: Final = 0.5  # part of the best evidence with which a lag is tried
MOST_PEAKS: Final = 40  # more lags are as likely by chance
LEAST_GAIN: Final = 12.0  # logarithm of the likelihood by which the best lag must be ahead
LEAST_EVIDENCE: Final = 200.0  # twice the gain of the logarithm of the likelihood
STEP_S: Final = 0.5  # between the lags of the first search
_MOST_LAGS: Final = 1 << 16
_LAGS_AT_A_TIME: Final = 1 << 12
_GRAVITY_S: Final = 15.0  # over which the mean of the specific force is gravity
_GRID_S: Final = 0.05  # steps in which readings are integrated
_MOST_STEPS: Final = 1 << 20
_MARGIN_S: Final = 1.0  # by which a fit may move a lag
_RATE_S: Final = 0.1  # to each side, over which angular rates are averaged
_LONGEST_GAP_S: Final = 1.5  # between pings that are interpolated
_BLOCK_S: Final = 30.0
_FEWEST_OF_BLOCK: Final = 15
_ORDER: Final = 2  # of the curve that a block may have beside
_ROUNDS: Final = 8
_DIFFERENCE_S: Final = 0.5
_OUTLIER_SDS: Final = 4.0
_ALIKE: Final = 0.05  # by which the logarithms of variances differ by chance
_BLOCKS_TRIED: Final = 30
_MOST_BLOCKS: Final = 120  # of a dive, evenly chosen
_TINY: Final = 1e-9
_LEAST_SHARE: Final = 0.05
_UNKNOWN_S: Final = 1e3  # standard error of a lag of which nothing is known
_UNIFORM: Final = 12.0**-0.5  # sd of what lies anywhere in a step
_LEAST_TURN: Final = 1e-3  # rad, of all attitudes
_LARGEST_TURN: Final = 1.0  # rad, between two attitudes; more is a jump


@dataclass(frozen=True)
class Rows:
    """What the file of a DVL says: velocities, or attitudes."""

    time_ns: TimeNs  # (k,), of its own clock, increasing
    values: Floats  # (k, 3) m/s in any axes, or the sum of its turns, rad
    are_turns: bool = False

    @classmethod
    def of_velocities(cls, time_ns: TimeNs, velocity_d: Floats | None) -> "Rows":
        """Keep the pings that have a velocity, (k, 3)."""
        if velocity_d is None:
            return cls(time_ns[:0], np.empty((0, 3)))
        known = np.isfinite(velocity_d).all(axis=1)
        return cls(time_ns[known], velocity_d[known])

    @classmethod
    def of_attitudes(cls, time_ns: TimeNs, mat_nb: Floats) -> "Rows":
        """Sum up the turns between attitudes, (k, 3, 3), as gyros would see them; jumps are left out."""
        turns = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])
        turns[np.linalg.norm(turns, axis=1) > _LARGEST_TURN] = 0.0
        summed = np.cumsum(turns, axis=0)
        return cls(time_ns, np.concatenate([np.zeros((1, 3)), summed]), are_turns=True)

    @property
    def may_tell(self) -> bool:
        """Whether there are enough rows; attitudes that never turn tell nothing."""
        if len(self.time_ns) < FEWEST:
            return False
        return not self.are_turns or float(np.ptp(self.values, axis=0).max()) > _LEAST_TURN

    @cached_property
    def resolution_s(self) -> float:
        """The step of the clock by which the rows are stamped."""
        for step_ns in (10**9, 10**8, 10**7, 10**6):
            if not np.any(self.time_ns % step_ns):
                return step_ns * 1e-9
        return 0.0


@dataclass(frozen=True)
class FileClock:
    """How the clock of a file runs against that of the IMU."""

    at_ns: int  # by the clock of the file, in the middle of what both saw
    ahead_ns: int  # of the IMU's clock there
    drift: float  # seconds per second by which it runs faster
    ahead_sd_s: float
    drift_sd: float
    half_s: float  # from the middle to the ends of what both saw
    sources: tuple[str, ...]  # that tell it

    def by_imu(self, time_ns: TimeNs) -> TimeNs:
        """Return times of the file by the clock of the IMU."""
        since_s = seconds(time_ns, self.at_ns)
        slow_ns = np.rint(since_s * (self.drift / (1.0 + self.drift)) * 1e9).astype(np.int64)
        return np.asarray(time_ns - self.ahead_ns - slow_ns)

    @property
    def largest_sd_s(self) -> float:
        """The standard error at the ends."""
        return float(np.hypot(self.ahead_sd_s, self.drift_sd * self.half_s))


class Motion:
    """Readings of an IMU, integrated in axes that do not turn."""

    def __init__(self, imu: ImuColumns) -> None:
        sample_s = seconds(imu.time_ns, imu.time_ns[0])
        self.origin_ns = int(imu.time_ns[0])
        self.step_s = imu.usual_step_s
        length_s = float(sample_s[-1])
        grid_step_s = max(_GRID_S, self.step_s, length_s / _MOST_STEPS)
        self.grid_s = np.arange(0.0, length_s, grid_step_s)
        self.angle = _integrated(sample_s, imu.angular_rate_b, self.grid_s)
        self.force = _integrated(sample_s, imu.specific_force_b, self.grid_s)
        turns = np.diff(self.angle, axis=0)
        self.mat = _chained(mat_from_vector(turns))
        middles = self.mat[:-1] @ mat_from_vector(0.5 * turns)
        gains = np.einsum("kij,kj->ki", middles, np.diff(self.force, axis=0))
        self.gained = np.concatenate([np.zeros((1, 3)), np.cumsum(gains, axis=0)])
        steps_s = np.diff(self.grid_s)[:, None, None]
        summed = np.cumsum(middles * steps_s, axis=0)
        self.summed_mat = np.concatenate([np.zeros((1, 3, 3)), summed])

    @property
    def length_s(self) -> float:
        """The time that it saw."""
        return float(self.grid_s[-1])

    def interpolated(self, values: Floats, at_s: Floats) -> Floats:
        """Interpolate values on the grid, (n, ...), at times, (k, ...)."""
        after = np.searchsorted(self.grid_s, at_s).clip(1, len(self.grid_s) - 1)
        width_s = self.grid_s[1] - self.grid_s[0]
        share = (at_s - self.grid_s[after - 1]) / width_s
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[after - 1] * (1.0 - share) + values[after] * share)

    def mats(self, at_s: Floats) -> Floats:
        """Return the attitudes at times, (k, 3, 3)."""
        before = (np.searchsorted(self.grid_s, at_s) - 1).clip(0, len(self.grid_s) - 2)
        rest = self.interpolated(self.angle, at_s) - self.angle[before]
        return np.asarray(self.mat[before] @ mat_from_vector(rest))

    def rates(self, at_s: Floats) -> Floats:
        """Return angular rates around times, (k, 3), rad/s."""
        ahead = self.interpolated(self.angle, at_s + _RATE_S)
        behind = self.interpolated(self.angle, at_s - _RATE_S)
        return (ahead - behind) / (2.0 * _RATE_S)


def _integrated(sample_s: Floats, values: Floats, grid_s: Floats) -> Floats:
    """Integrate readings, (k, 3), by trapezoids up to the times of a grid."""
    found = np.empty((len(grid_s), 3))
    steps_s = np.diff(sample_s)
    for column, into in zip(values.T, found.T, strict=True):
        gains = 0.5 * (column[1:] + column[:-1]) * steps_s
        summed = np.concatenate([[0.0], np.cumsum(gains)])
        into[:] = np.interp(grid_s, sample_s, summed)
    return found


def _chained(turns: Floats) -> Floats:
    """Return the products of rotations, (k, 3, 3), up to each of them, after the unit matrix."""
    count = len(turns)
    size = int(np.ceil(np.sqrt(count + 1)))
    filled = np.tile(np.eye(3), (size * size, 1, 1))
    filled[1 : count + 1] = turns
    blocks = filled.reshape(size, size, 3, 3)
    for i in range(1, size):
        blocks[:, i] = blocks[:, i - 1] @ blocks[:, i]
    for i in range(1, size):
        blocks[i] = blocks[i - 1, -1] @ blocks[i]
    return blocks.reshape(-1, 3, 3)[: count + 1]


def clock_by_motion(
    imu: ImuColumns,
    sources: Sequence[Rows],
    *,
    are_stamps_likely: bool = False,
) -> FileClock | None:
    """Return the clock of a DVL's file by the motion that both saw; None where that does not determine it.

    Parameters
    ----------
    imu : ImuColumns
        By its own clock.
    sources : sequence of Rows
        What the file has of velocities and attitudes, at least one, by the clock of the file.
    are_stamps_likely : bool
        Whether it must be clearly less likely that both have one clock.
    """
    sources = [rows for rows in sources if rows.may_tell]
    if len(imu.time_ns) < FEWEST or not sources:
        return None
    motion = Motion(imu)
    origin_ns = int(sources[0].time_ns[0])
    tried = []
    if are_stamps_likely:
        stamped_s = float(seconds(sources[0].time_ns[:1], motion.origin_ns)[0])
        tried.append(_fits(motion, sources, origin_ns, stamped_s, _BLOCKS_TRIED))
    for lag_s in _likely_lags(motion, sources, origin_ns):
        tried.append(_fits(motion, sources, origin_ns, lag_s, _BLOCKS_TRIED))
    best = _clearly_best(tried)
    if best is None:
        return None
    fits = _fits(motion, sources, origin_ns, best[0].lag_s, _MOST_BLOCKS)
    return _joined(fits, motion, origin_ns)


def _fits(
    motion: Motion,
    sources: Sequence[Rows],
    origin_ns: int,
    lag_s: float,
    blocks: int,
) -> list["_Fit"]:
    """Fit lag and drift near a first lag by each source that has enough there."""
    fits = []
    for rows in sources:
        fit = _Fit.of(motion, rows, origin_ns, lag_s, blocks)
        if fit is not None:
            fits.append(fit)
    return fits


def _clearly_best(found: Sequence[Sequence["_Fit"]]) -> Sequence["_Fit"] | None:
    """Return the fits of the lag that leaves the least; None where another one leaves hardly more."""
    found = [fits for fits in found if fits]
    if not found:
        return None
    best = found[0]
    for other in found[1:]:
        if _gain(best, other) < 0.0:
            best = other
    for other in found:
        # Lags that are so near lead to the same fit.
        is_same = abs(other[0].lag_s - best[0].lag_s) < 2.0 * _MARGIN_S
        if not is_same and _gain(best, other) < LEAST_GAIN:
            return None
    return best


def _gain(best: Sequence["_Fit"], other: Sequence["_Fit"]) -> float:
    """Return how much more likely a lag is than another one, as a logarithm, by what both leave of the same rows."""
    gain = 0.0
    for ours in best:
        for theirs in other:
            if ours.are_turns != theirs.are_turns:
                continue
            ratio = float(np.log(theirs.variance / ours.variance))
            # Parts of a dive differ by so much.
            if abs(ratio) > _ALIKE:
                gain += 0.5 * min(ours.independent, theirs.independent) * ratio
    return gain


# --- The first search.


def _likely_lags(motion: Motion, sources: Sequence[Rows], origin_ns: int) -> list[float]:
    """Return times of the IMU at the first row of the first source, s, for which there is evidence, the best first."""
    last_s = max(float(seconds(rows.time_ns, origin_ns)[-1]) for rows in sources)
    step_s = max(STEP_S, (motion.length_s + last_s) / _MOST_LAGS)
    at_s = np.arange(step_s, last_s - step_s, step_s)
    of_imu_s = np.arange(step_s, motion.length_s - step_s, step_s)
    if min(len(at_s), len(of_imu_s)) < FEWEST // 2:
        return []
    of_imu = _signals_of_imu(motion, of_imu_s, step_s)
    total: Floats = np.zeros(len(at_s) + len(of_imu_s) - 1)
    for rows in sources:
        total += _evidence(of_imu, rows, origin_ns, at_s, step_s)
    # Of the first column, the last time of the DVL is the first one of the IMU.
    lags_s = (np.arange(len(total)) - len(at_s) + 1) * step_s
    is_peak = np.ones(len(total), np.bool_)
    is_peak[1:] &= total[1:] >= total[:-1]
    is_peak[:-1] &= total[:-1] > total[1:]
    is_peak &= total > max(LEAST_EVIDENCE, LIKELY * float(total.max()))
    peaks = np.flatnonzero(is_peak)
    peaks = peaks[np.argsort(-total[peaks], kind="stable")]
    if len(peaks) > MOST_PEAKS:
        return []
    return [float(lag_s) for lag_s in lags_s[peaks]]


def _signals_of_imu(motion: Motion, at_s: Floats, step_s: float) -> Floats:
    """Return ones, angular rates, angular accelerations, and specific forces without gravity: (n, 10)."""
    # It is loaded late, since few dives need it.
    from scipy.ndimage import gaussian_filter1d

    before = motion.interpolated(motion.angle, at_s - step_s)
    after = motion.interpolated(motion.angle, at_s + step_s)
    rate = (after - before) / (2.0 * step_s)
    acceleration = (motion.rates(at_s + step_s) - motion.rates(at_s - step_s)) / (2.0 * step_s)
    mats = motion.mats(at_s)
    gained = motion.interpolated(motion.gained, at_s + step_s)
    gained = gained - motion.interpolated(motion.gained, at_s - step_s)
    force = gained / (2.0 * step_s)
    force -= gaussian_filter1d(force, _GRAVITY_S / step_s, axis=0, mode="nearest")
    force = np.einsum("kji,kj->ki", mats, force)
    columns = [np.ones((len(at_s), 1)), _unit(rate), _unit(acceleration), _unit(force)]
    return np.concatenate(columns, axis=1)


def _unit(values: Floats) -> Floats:
    """Scale three columns together."""
    size = float(np.sqrt(np.mean(values**2)))
    return values / max(size, 1e-12)


def _evidence(
    of_imu: Floats,
    rows: Rows,
    origin_ns: int,
    at_s: Floats,
    step_s: float,
) -> Floats:
    """Return twice the logarithm of the likelihood that each lag gains over no relation at all."""
    row_s = seconds(rows.time_ns, origin_ns)
    change, middle = _smoothed(row_s, rows.values, at_s, step_s)
    known = _is_near(row_s, at_s, step_s)
    if not known.any():
        return np.zeros(len(at_s) + len(of_imu) - 1)
    change = np.where(known[:, None], change - change[known].mean(axis=0), 0.0)
    change = _unit(change)
    ones = known.astype(np.float64)[:, None]
    terms = [(0, 0), (1, 0), (2, 0), (3, 0)]
    of_dvl = ones
    if not rows.are_turns:
        middle = np.where(known[:, None], middle, 0.0)
        of_dvl = np.concatenate([ones, _unit(middle)], axis=1)
        terms += [(i, 0) for i in range(4, 10)]
        for i in range(1, 4):
            terms += [(i, j) for j in range(1, 4)]
    shorter_s = step_s * min(len(at_s), len(of_imu))
    least_s = max(SHORTEST_OVERLAP_S, LEAST_OVERLAP * shorter_s)
    return _Lags(of_imu, of_dvl, change, terms).evidence(least_s / step_s)


def _smoothed(
    row_s: Floats,
    values: Floats,
    at_s: Floats,
    step_s: float,
) -> tuple[Floats, Floats]:
    """Return the change of rows per second over two steps around times, and their mean there, (n, 3) each."""
    half_s = 0.5 * step_s
    change = np.empty((len(at_s), 3))
    middle = np.empty((len(at_s), 3))
    for numbers, into, mean in zip(values.T, change.T, middle.T, strict=True):
        areas = 0.5 * (numbers[1:] + numbers[:-1]) * np.diff(row_s)
        area = np.concatenate([[0.0], np.cumsum(areas)])
        before = _mean_around(at_s - step_s, half_s, row_s, numbers, area)
        after = _mean_around(at_s + step_s, half_s, row_s, numbers, area)
        into[:] = (after - before) / (2.0 * step_s)
        mean[:] = _mean_around(at_s, half_s, row_s, numbers, area)
    return change, middle


def _mean_around(
    around_s: Floats,
    half_s: float,
    row_s: Floats,
    numbers: Floats,
    area: Floats,
) -> Floats:
    """Return the mean around times of what goes straight from row to row."""
    found = np.zeros(len(around_s))
    for sign in (-1.0, 1.0):
        at_s = (around_s + sign * half_s).clip(row_s[0], row_s[-1])
        after = np.searchsorted(row_s, at_s).clip(1, len(row_s) - 1)
        since_s = at_s - row_s[after - 1]
        there = np.interp(at_s, row_s, numbers)
        found += sign * (area[after - 1] + 0.5 * since_s * (numbers[after - 1] + there))
    return found / (2.0 * half_s)


def _is_near(row_s: Floats, at_s: Floats, step_s: float) -> Mask:
    """Return which times lie between rows that are not far apart, with what is around them."""
    longest_s = max(_LONGEST_GAP_S, 2.0 * float(np.median(np.diff(row_s))))
    known: Mask = np.ones(len(at_s), np.bool_)
    for there_s in (at_s - 1.5 * step_s, at_s, at_s + 1.5 * step_s):
        after = np.searchsorted(row_s, there_s)
        inside = (after > 0) & (after < len(row_s))
        place = after.clip(1, len(row_s) - 1)
        known &= inside & (row_s[place] - row_s[place - 1] <= longest_s)
    return known


@dataclass(frozen=True)
class _Lags:
    """Linear fits of what a DVL says at all lags; a term is a column of the IMU times one of the DVL."""

    of_imu: Floats  # (n, q), the first one of ones
    of_dvl: Floats  # (n, r), the first one tells where the others are known
    change: Floats  # (n, 3)
    terms: Sequence[tuple[int, int]]

    def evidence(self, fewest: float) -> Floats:
        """Return the evidence of each lag, with as many rows at least."""
        count = len(self.terms)
        rows = self._correlated([((0, 0), self.of_dvl[:, 0])])[0]
        squares = []
        of_changes = []
        for values in self.change.T:
            pairs = [((i, 0), self.of_dvl[:, j] * values) for i, j in self.terms]
            of_changes.append(self._correlated(pairs))
            squares.append(self._correlated([((0, 0), values**2)])[0])
        normal = self._normal()
        evidence = np.zeros(len(rows))
        # Changes over two steps: every other one is independent.
        free = 0.5 * rows - count
        possible = np.flatnonzero((rows >= fewest) & (free > 2.0))
        for first in range(0, len(possible), _LAGS_AT_A_TIME):
            block = possible[first : first + _LAGS_AT_A_TIME]
            mats = normal[:, :, block].transpose(2, 0, 1)
            sizes = np.einsum("kii->ki", mats)
            mats = mats + 1e-6 * np.eye(count) * (sizes.mean(axis=1)[:, None, None] + 1e-9)
            rights = np.stack([found[:, block] for found in of_changes], axis=2)
            rights = rights.transpose(1, 0, 2)
            explained = np.einsum("kpm,kpm->km", rights, np.linalg.solve(mats, rights))
            total = np.stack([found[block] for found in squares], axis=1)
            mean = np.stack([found[0, block] for found in of_changes], axis=1)
            total = total - mean**2 / rows[block, None]
            explained = explained - mean**2 / rows[block, None]
            left = np.maximum(total - explained, 1e-6 * total + 1e-12)
            shares = left / free[block, None] / (total / (0.5 * rows[block, None] - 1.0) + 1e-12)
            evidence[block] = -np.sum(np.log(shares), axis=1) * free[block]
        return np.maximum(evidence, 0.0)

    def _normal(self) -> Floats:
        """Return the normal matrices of all lags, (p, p, lags)."""
        count = len(self.terms)
        places = list(combinations_with_replacement(range(count), 2))
        pairs = []
        for p, q in places:
            of_imu = (self.terms[p][0], self.terms[q][0])
            of_dvl = self.of_dvl[:, self.terms[p][1]] * self.of_dvl[:, self.terms[q][1]]
            pairs.append((of_imu, of_dvl))
        found = self._correlated(pairs)
        normal = np.empty((count, count, found.shape[1]))
        for (p, q), values in zip(places, found, strict=True):
            normal[p, q] = values
            normal[q, p] = values
        return normal

    def _correlated(self, pairs: Sequence[tuple[tuple[int, int], Floats]]) -> Floats:
        """Return the sums of products of the IMU's columns, two by two, and of the DVL's, at all lags."""
        from scipy.fft import irfft, next_fast_len, rfft

        count = len(self.change)
        whole = count + len(self.of_imu) - 1
        length = next_fast_len(whole, real=True)
        spectra: dict[tuple[int, int], Array] = {}
        found = np.empty((len(pairs), whole))
        for ((i, j), values), into in zip(pairs, found, strict=True):
            key = (min(i, j), max(i, j))
            if key not in spectra:
                spectra[key] = rfft(self.of_imu[:, i] * self.of_imu[:, j], length)
            # Turned round in time, so that the product is the correlation.
            turned_round = rfft(values[::-1], length)
            into[:] = irfft(spectra[key] * turned_round, length)[:whole]
        return found


# --- The fit.


@dataclass(frozen=True)
class _Fit:
    """Lag and drift by one kind of rows."""

    lag_s: float  # from which it began
    at_s: float  # since the first row of the DVL's file, in the middle
    half_s: float
    imu_s: float  # the IMU's time there
    drift: float  # of the IMU's time against that of the rows
    information: Floats  # (2, 2) of both
    are_turns: bool
    is_settled: bool
    variance: float  # of what is left
    independent: float  # numbers that tell it

    @classmethod
    def of(
        cls,
        motion: Motion,
        rows: Rows,
        origin_ns: int,
        lag_s: float,
        most: int,
    ) -> "_Fit | None":
        """Fit lag and drift near a first lag; None where they are not determined."""
        row_s = seconds(rows.time_ns, origin_ns)
        inside = (row_s + lag_s > _MARGIN_S) & (row_s + lag_s < motion.length_s - _MARGIN_S)
        row_s = row_s[inside]
        blocks = list(_blocks(row_s))
        if len(blocks) < 2:
            return None
        blocks = blocks[:: -(-len(blocks) // most)]
        kept = np.concatenate(blocks)
        of_block = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
        values = rows.values[inside][kept]
        row_s = row_s[kept]
        middle_s = 0.5 * float(row_s[0] + row_s[-1])
        scores = _Scores(motion, values, row_s, of_block, rows.are_turns, middle_s)
        found = _iterated(scores, lag_s)
        step = found.step
        if not step.variance > 0.0:
            return None  # what is the same at all times fits anywhere
        half_s = 0.5 * float(row_s[-1] - row_s[0])
        step_s = np.hypot(motion.step_s, rows.resolution_s) * _UNIFORM
        covariance = np.linalg.inv(step.information)
        covariance[0, 0] += step_s**2
        return cls(
            lag_s=lag_s,
            at_s=middle_s,
            half_s=half_s,
            imu_s=middle_s + found.shift_s,
            drift=found.drift,
            information=np.linalg.inv(covariance),
            are_turns=rows.are_turns,
            is_settled=found.is_settled,
            variance=step.variance,
            independent=step.independent,
        )


def _blocks(row_s: Floats) -> Iterator[Integers]:
    """Give the rows of each block that has enough."""
    number = np.floor(row_s / _BLOCK_S).astype(np.int64)
    for rows in np.split(np.arange(len(row_s)), np.flatnonzero(np.diff(number)) + 1):
        if len(rows) >= _FEWEST_OF_BLOCK:
            yield rows


@dataclass(frozen=True)
class _Columns:
    """What is compared of k rows at a lag."""

    values: Floats  # (k, 3, 1)
    free: Floats  # (k, 3, p), with free coefficients


@dataclass(frozen=True)
class _Step:
    """What a fit at a lag and a drift finds."""

    change: Floats  # (2,) of both
    information: Floats  # (2, 2)
    variance: float  # of what is left
    independent: float  # numbers


@dataclass(frozen=True)
class _Iterated:
    """Lag and drift after some fits, each from where the one before ended."""

    shift_s: float
    drift: float
    step: _Step  # the last fit
    is_settled: bool


def _iterated(scores: "_Scores", lag_s: float) -> _Iterated:
    """Fit lag and drift near a first lag until they hardly change."""
    scores.mount(lag_s)
    shift_s = lag_s
    drift = 0.0
    is_settled = False
    for _ in range(_ROUNDS):
        step = scores.at(shift_s, drift)
        change_s = float(np.clip(step.change[0], -STEP_S, STEP_S))
        if not abs(shift_s + change_s - lag_s) < _MARGIN_S:
            break
        shift_s += change_s
        drift += float(step.change[1])
        sd_s = float(np.linalg.inv(step.information)[0, 0]) ** 0.5
        is_settled = abs(change_s) < 0.1 * sd_s
        if is_settled:
            break
    return _Iterated(shift_s, drift, step, is_settled)


class _Scores:
    """Linear fits of rows in blocks, at a lag and a drift."""

    def __init__(
        self,
        motion: Motion,
        values: Floats,
        row_s: Floats,
        of_block: Integers,
        are_turns: bool,
        middle_s: float,
    ) -> None:
        self._motion = motion
        self._values = values
        self._row_s = row_s
        self._since_s = row_s - middle_s
        self._of_block = of_block
        self._are_turns = are_turns
        self._mounted = values
        self._curves = self._bases()

    def at(self, shift_s: float, drift: float) -> "_Step":
        """Return the changes of lag and drift that fit best."""
        at_s = self._row_s + shift_s + drift * self._since_s
        columns = self._columns(at_s)
        ahead = self._columns(at_s + _DIFFERENCE_S)
        behind = self._columns(at_s - _DIFFERENCE_S)
        weight = np.ones(len(at_s))
        values = self._bent(columns.values)
        free = self._bent(columns.free)
        coefficients = _solved(values, free, weight)
        here = columns.values - columns.free @ coefficients
        forward = (ahead.values - ahead.free @ coefficients - here) / _DIFFERENCE_S
        backward = (here - behind.values + behind.free @ coefficients) / _DIFFERENCE_S
        slope = 0.5 * (forward + backward)
        by_drift = slope * self._since_s[:, None, None]
        wanted = self._bent(np.concatenate([slope, by_drift], axis=2))
        both = np.concatenate([free, wanted], axis=2)
        for _ in range(3):
            solved = _solved(values, both, weight)
            left = (values - both @ solved)[:, :, 0]
            size = np.sqrt(np.mean(left**2, axis=1))
            scatter = 1.4826 * float(np.median(size)) + 1e-12
            weight = np.minimum(1.0, _OUTLIER_SDS * scatter / np.maximum(size, 1e-12))
        self._turn(coefficients[:, 0])
        alone = wanted - free @ _solved(wanted, free, weight)
        change = -solved[free.shape[2] :, 0]
        covariance, inflation = self._covariance(alone, left, weight)
        # Noise of the accelerometers looks like a slope. Before and after a row it is not the same noise.
        sides = self._bent(np.concatenate([forward, backward], axis=2))
        before_after = float(np.sum(sides[:, :, 0] * sides[:, :, 1]))
        share = before_after / (float(np.sum(wanted[:, :, 0] ** 2)) + 1e-12)
        share = min(max(share, _LEAST_SHARE), 1.0)
        change = change / share
        covariance = covariance / share**2
        information = np.linalg.inv(covariance)
        prior = np.diag([0.0, DRIFT_SD**-2.0])
        together = information + prior
        change = np.linalg.solve(together, information @ change - prior @ [0.0, drift])
        variance = float(np.sum(weight[:, None] * left**2)) / left.size
        return _Step(change, np.asarray(together, np.float64), variance, left.size / inflation)

    def _columns(self, at_s: Floats) -> "_Columns":
        """Return what is compared at the times of the rows."""
        motion = self._motion
        if self._are_turns:
            angle = motion.interpolated(motion.angle, at_s)
            free = np.einsum("kj,il->kilj", angle, np.eye(3)).reshape(len(at_s), 3, 9)
            return _Columns(self._values[:, :, None], free)
        mats = motion.mats(at_s)
        moving = np.einsum("kij,kj->ki", mats, self._mounted)
        gained = motion.interpolated(motion.gained, at_s)
        turning = mats @ skew(self._mounted)
        arm = mats @ skew(motion.rates(at_s))
        bias = motion.interpolated(motion.summed_mat, at_s)
        free = np.concatenate([moving[:, :, None], turning, arm, bias], axis=2)
        return _Columns((gained - moving)[:, :, None], free)

    def mount(self, shift_s: float) -> None:
        """Turn the velocities into the axes of the IMU, by a fit of any matrix at a lag."""
        if self._are_turns:
            return
        motion = self._motion
        at_s = self._row_s + shift_s
        mats = motion.mats(at_s)
        moving = np.einsum("kmi,kj->kmij", mats, self._values).reshape(len(at_s), 3, 9)
        arm = mats @ skew(motion.rates(at_s))
        bias = motion.interpolated(motion.summed_mat, at_s)
        gained = self._bent(motion.interpolated(motion.gained, at_s)[:, :, None])
        free = self._bent(np.concatenate([moving, arm, bias], axis=2))
        solved = _solved(gained, free, np.ones(len(at_s)))
        left, sizes, right = np.linalg.svd(solved[:9, 0].reshape(3, 3))
        self._mounted = float(sizes[0]) * self._values @ (left @ right).T

    def _turn(self, coefficients: Floats) -> None:
        """Correct the scale and the mounting by what a fit found."""
        if not self._are_turns:
            turn = mat_from_vector(-coefficients[1:4])
            self._mounted = (1.0 + float(coefficients[0])) * self._mounted @ turn.T

    def _bases(self) -> list[tuple[slice, Floats]]:
        """Return the rows of each block, and the curves that it may have."""
        bases = []
        edges = np.flatnonzero(np.diff(self._of_block)) + 1
        bounds = [0, *edges.tolist(), len(self._of_block)]
        for first, last in pairwise(bounds):
            since_s = self._row_s[first:last] - self._row_s[first:last].mean()
            powers = np.vander(since_s / _BLOCK_S, _ORDER + 1)
            bases.append((slice(first, last), np.linalg.qr(powers)[0]))
        return bases

    def _bent(self, values: Floats) -> Floats:
        """Return columns, (k, 3, p), without the curves of the blocks."""
        found = np.empty_like(values)
        for rows, basis in self._curves:
            part = values[rows]
            curve = np.tensordot(basis, np.tensordot(basis.T, part, 1), 1)
            found[rows] = part - curve
        return found

    def _covariance(
        self,
        alone: Floats,
        left: Floats,
        weight: Floats,
    ) -> tuple[Floats, float]:
        """Return the covariance of lag and drift by the scatter of the blocks, not below that of single rows.

        By how much it is larger is returned, too.
        """
        weighted = alone * weight[:, None, None]
        power = np.einsum("kmp,kmq->pq", weighted, alone)
        if not np.linalg.det(power) > _TINY * power[0, 0] * power[1, 1]:
            return np.diag([_UNKNOWN_S**2, 1.0]), 1.0
        inverse = np.linalg.inv(power)
        single = np.sum(weight[:, None] * left**2) / max(3 * len(left) - 20, 1)
        scores = []
        sizes = []
        for rows, _ in self._curves:
            scores.append(np.einsum("kmp,km->p", weighted[rows], left[rows]))
            sizes.append(float(np.sum(weighted[rows, :, 0] * alone[rows, :, 0])))
        shares = np.array(sizes) / sum(sizes)
        blocks = 1.0 / float(np.sum(shares**2))
        spread = np.array(scores)
        of_blocks = inverse @ (spread.T @ spread) @ inverse
        of_blocks *= 1.0 + 2.0 / max(blocks - 1.0, 0.1)
        of_rows = single * inverse
        ratios = np.diag(of_blocks) / np.diag(of_rows)
        inflation = max(1.0, float(ratios.max()))
        return np.asarray(of_rows * inflation), inflation


def _solved(values: Floats, columns: Floats, weight: Floats) -> Floats:
    """Return the coefficients of columns, (k, 3, p), of any units, that fit values, (k, 3, m), the best."""
    root = np.sqrt(weight)[:, None, None]
    left = (root * columns).reshape(-1, columns.shape[2])
    right = (root * values).reshape(-1, values.shape[2])
    size = np.linalg.norm(left, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    unit = left / size
    inverse = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    return np.asarray(inverse @ (unit.T @ right) / size[:, None])


def _joined(fits: Sequence[_Fit], motion: Motion, origin_ns: int) -> FileClock | None:
    """Return the clock by all fits that are sure; where they exclude each other, velocities decide."""
    sure = []
    for fit in fits:
        if fit.is_settled and np.linalg.inv(fit.information)[0, 0] ** 0.5 < SURE_S:
            sure.append(fit)
    if not sure:
        return None
    first = sure[0]
    middle_s = first.at_s
    information = np.zeros((2, 2))
    right = np.zeros(2)
    for fit in sure:
        # Of lag and drift in the middle of the first.
        from_s = middle_s - fit.at_s
        back = np.array([[1.0, -from_s], [0.0, 1.0]])
        found = np.array([fit.imu_s - fit.at_s + fit.drift * from_s, fit.drift])
        own = back.T @ fit.information @ back
        information += own
        right += own @ found
    covariance = np.linalg.inv(information)
    shift_s, drift = np.linalg.solve(information, right).tolist()
    at_ns = origin_ns + round(middle_s * 1e9)
    imu_ns = motion.origin_ns + round((middle_s + shift_s) * 1e9)
    return FileClock(
        at_ns=at_ns,
        ahead_ns=at_ns - imu_ns,
        drift=1.0 / (1.0 + drift) - 1.0,
        ahead_sd_s=float(covariance[0, 0]) ** 0.5,
        drift_sd=float(covariance[1, 1]) ** 0.5,
        half_s=first.half_s,
        sources=tuple("attitudes" if fit.are_turns else "velocities" for fit in sure),
    )
