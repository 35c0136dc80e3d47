"""The rotation from a DVL to an IMU, of any size, by one linear fit of the dive's motion.

Over a window the gyros give the attitude D(t) against its start. The DVL's velocities v and the specific forces f then
satisfy at each ping, with the rotation R from DVL to IMU and the lever arm l::

    D R v - D (w x l) = V + g t + h t^2 + (integral of D f dt) - (integral of D dt) b - (integral of [D f x] D) c

V and g are the velocity at the start and gravity in the axes of the start, and h is what the turning Earth does to
gravity. They are unknown in each window. The biases b of accelerometers and c of gyros hold for the dive.

All unknowns are linear, also the nine elements of R. So a window is a small square matrix, the sum of some windows is
the fit of these windows, and no start value is needed. The rotation that fits best is then found from all quarter turns
by Newton's steps. Source of the steps on rotations: Absil, Mahony and Sepulchre, "Optimization Algorithms on Matrix
Manifolds", 2008.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import velocities_b
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import DvlColumns, Floats, ImuColumns, Mask, TimeNs, seconds
from insdvl_replay.core.states import DEG, DEG_PER_HOUR, MG
from insdvl_replay.geometry.rotation import mat_from_vector, skew, vector_from_mat

IMU_STEP_S: Final = 0.04  # to which readings are averaged
LEAST_BETTER: Final = 1.02  # the same where a rotation is many standard deviations off
MANY_SDS: Final = 5.0
CLEARLY: Final = 1.25  # ratio of sums of squares from which a rotation is excluded
# a calibration that starts from the quarter turn finds the rest
NEAR_QUARTER_RAD: Final = 4.0 * DEG
LEAST_TILT: Final = 0.7  # cosine; no DVL is built in more obliquely
WINDOW_S: Final = 20.0
LONGEST_STEP_S: Final = 0.5  # IMU steps above it end the usable part of a window
# unknowns of a window: velocity and gravity at its start, and how the Earth turns gravity
OWN: Final = 9
FEWEST_PINGS: Final = 8  # in a window
FEWEST_WINDOWS: Final = 3
# Standard deviations of the biases and of the lever arm before the fit.
_ARM_SD_M: Final = 1.0
_ACCEL_SD_MPS2: Final = 30.0 * MG
_GYRO_SD_RADPS: Final = 300.0 * DEG_PER_HOUR
_TYPICAL_SD_MPS: Final = 0.03  # noise of a ping, against which these count
TURN: Final = slice(0, 9)  # columns of the nine elements of R, row by row
_NUISANCE: Final = slice(9, 18)  # lever arm, accelerometer biases, gyro biases
_KNOWN: Final = 18  # column of what is known
MOST_STEPS: Final = 25
MOST_STARTS: Final = 6
SETTLED_RAD: Final = 1e-5
SAME_RAD: Final = 5.0 * DEG  # minima that are closer are one
LARGEST_SCALE: Final = 1.1  # of a DVL
LATEST_S: Final = 0.45
_DELAY_SD_S: Final = 0.1
_LEVEL_RAD: Final = 60.0 * DEG
_LEVEL_SD_RAD: Final = 5.0 * DEG  # of a DVL's down axis from the vehicle's
DELAY_STEPS_S: Final = (0.1, 0.1, 0.03, 0.01)


@dataclass(frozen=True)
class MotionWindows:
    """Squares and products of the equations of all windows of a dive, for one delay of the DVL."""

    squares: Floats  # (windows, 19, 19), without the unknowns of single windows
    count: int  # of equations

    def total(self, chosen: Mask | None = None) -> Floats:
        """Add up windows, with what is known of the biases and the arm, (19, 19)."""
        squares = self.squares if chosen is None else self.squares[chosen]
        prior = np.zeros(_KNOWN + 1)
        prior[_NUISANCE] = np.repeat([_ARM_SD_M, _ACCEL_SD_MPS2, _GYRO_SD_RADPS], 3) ** -2.0
        return np.asarray(squares.sum(axis=0) + np.diag(prior) * _TYPICAL_SD_MPS**2)


@dataclass(frozen=True)
class Quadratic:
    """Cost of a rotation as a square of its nine elements, the other unknowns at their best."""

    square: Floats  # (9, 9)
    product: Floats  # (9,)
    rest: float

    @classmethod
    def of(cls, total: Floats) -> "Quadratic":
        """Remove arm and biases from the squares of some windows."""
        inner = total[_NUISANCE, _NUISANCE]
        kept = [*range(9), _KNOWN]
        across = total[kept, _NUISANCE]
        left = total[np.ix_(kept, kept)] - across @ np.linalg.solve(inner, across.T)
        return cls(left[:9, :9], left[:9, 9], float(left[9, 9]))

    def scale(self, mat: Floats) -> float:
        """Return true over measured velocity that fits a rotation best, as far as a DVL can be off."""
        elements = mat.ravel()
        power = float(elements @ self.square @ elements)
        best = float(self.product @ elements) / power if power > 0.0 else 1.0
        return min(max(best, 1.0 / LARGEST_SCALE), LARGEST_SCALE)

    def cost(self, mat: Floats) -> float:
        """Return the sum of squares for a rotation from DVL to IMU, (3, 3)."""
        elements = self.scale(mat) * mat.ravel()
        return float(elements @ self.square @ elements - 2.0 * self.product @ elements + self.rest)

    def descended(self, mat: Floats) -> Floats:
        """Return the rotation of least cost near one to start from, (3, 3)."""
        cost = self.cost(mat)
        damping = 1e-3
        for _ in range(MOST_STEPS):
            elements = self.scale(mat) * mat
            moved = np.einsum("aij,jk->ika", _GENERATORS, elements).reshape(9, 3)
            pull = self.square @ elements.ravel() - self.product
            curved = np.einsum("abij,jk,ik->ab", _CURVATURES, elements, pull.reshape(3, 3))
            # Far from the best, the curvature may be negative.
            sizes, axes = np.linalg.eigh(moved.T @ self.square @ moved + curved)
            sizes = np.abs(sizes)
            step = -axes @ (
                (axes.T @ (moved.T @ pull)) / (sizes + damping * max(float(sizes.max()), 1e-30))
            )
            tried = mat_from_vector(step) @ mat
            tried_cost = self.cost(tried)
            if tried_cost > cost:
                damping *= 10.0
                continue
            mat = tried
            cost = tried_cost
            damping = max(0.1 * damping, 1e-9)
            if np.linalg.norm(step) < SETTLED_RAD:
                break
        return mat

    def minima(self, starts: Sequence[Floats]) -> list[Floats]:
        """Return the rotations of locally least cost from the most promising starts, the best first."""
        near = sorted(starts, key=self.cost)[:MOST_STARTS]
        found = sorted((self.descended(start) for start in near), key=self.cost)
        apart: list[Floats] = []
        for mat in found:
            if all(angle_between(mat, other) > SAME_RAD for other in apart):
                apart.append(mat)
        return apart


def angle_between(mat: Floats, other: Floats) -> float:
    """Return the angle between two rotations, rad."""
    return float(np.linalg.norm(vector_from_mat(mat @ other.T)))


_GENERATORS: Final = np.stack([skew(axis) for axis in np.eye(3)])
_PRODUCTS: Final = _GENERATORS[:, None] @ _GENERATORS  # of each pair
_CURVATURES: Final = 0.5 * (_PRODUCTS + np.swapaxes(_PRODUCTS, 0, 1))


@dataclass(frozen=True)
class FreeMounting:
    """The rotations from DVL to IMU that fit a dive."""

    minima: tuple[Floats, ...]  # (3, 3) each, of locally least cost, the best first
    cost: float  # mean square of an equation at the best, (m/s)^2
    delay_s: float
    windows: MotionWindows
    quadratic: Quadratic

    @property
    def mat(self) -> Floats:
        """The rotation that fits best, (3, 3)."""
        return self.minima[0]

    def misfit(self, mat: Floats) -> float:
        """Return the ratio of a rotation's sum of squares to the best's."""
        return self.quadratic.cost(mat) / self.quadratic.cost(self.mat)

    def levelled(
        self,
        mat: Floats,
        axis_d: Floats,
        axis_b: Floats,
    ) -> Floats:
        """Return a rotation near another one, with an axis of the DVL near one of the IMU's where motion does not tell.

        Both axes are unit vectors, (3,). An axis that is further off than `_LEVEL_RAD` stays where it is.
        """
        if float(axis_b @ mat @ axis_d) < np.cos(_LEVEL_RAD):
            return mat
        weight = self.cost / _LEVEL_SD_RAD**2
        product = self.quadratic.product + weight * np.outer(axis_b, axis_d).ravel()
        return replace(self.quadratic, product=product).descended(mat)

    def held_out_misfit(self, mat: Floats, other: Floats) -> float:
        """Return how much worse another rotation predicts each window than one that is fitted to all other windows.

        The fit begins near a rotation. Arm, biases and scale are those of the other windows, too.
        """
        by_fit = 0.0
        by_other = 0.0
        count = len(self.windows.squares)
        for window in range(count):
            total = self.windows.total(np.arange(count) != window)
            quadratic = Quadratic.of(total)
            square = self.windows.squares[window]
            fitted = _solution(total, quadratic, quadratic.descended(mat))
            fixed = _solution(total, quadratic, other)
            by_fit += float(fitted @ square @ fitted)
            by_other += float(fixed @ square @ fixed)
        return by_other / by_fit

    def sd_about(self, mat: Floats, axis_b: Floats) -> float:
        """Return the sd of a rotation about a unit vector of the IMU, rad, from fits without single windows.

        Source: Tukey's jackknife; Efron, "The jackknife, the bootstrap and other resampling plans", 1982.
        """
        count = len(self.windows.squares)
        moved = []
        for window in range(count):
            without = Quadratic.of(self.windows.total(np.arange(count) != window)).descended(mat)
            moved.append(float(axis_b @ vector_from_mat(without @ mat.T)))
        return float(np.sqrt((count - 1) / count * np.sum(np.square(moved))))


def _solution(total: Floats, quadratic: Quadratic, mat: Floats) -> Floats:
    """Return all unknowns for a rotation, with arm and biases at their best, and -1 for what is known, (19,)."""
    elements = (quadratic.scale(mat) * mat).ravel()
    known = total[_NUISANCE, _KNOWN] - total[_NUISANCE, TURN] @ elements
    return np.concatenate([elements, np.linalg.solve(total[_NUISANCE, _NUISANCE], known), [-1.0]])


@dataclass(frozen=True)
class _Integrals:
    """What gyros and accelerometers add up to in each window of k samples."""

    origin_ns: int
    times_s: Floats  # (windows, k), each window ends where the next begins
    whole: Mask  # (windows,), whether there is no gap
    attitude: Floats  # (windows, k, 3, 3), against the window's start
    summed: Floats  # (windows, k, 24): rate (3), integrals of D f (3), of D (9), of [D f x] integral of D (9)

    @classmethod
    def of(cls, imu: ImuColumns) -> "_Integrals | None":
        """Integrate all windows at once; None where the dive is too short."""
        imu_s = seconds(imu.time_ns, imu.time_ns[0])
        if len(imu_s) < 3:
            return None
        length = max(2, round(WINDOW_S / float(np.median(np.diff(imu_s)))))
        count = (len(imu_s) - 1) // length
        if count < FEWEST_WINDOWS:
            return None
        rows = np.arange(count)[:, None] * length + np.arange(length + 1)
        times_s = imu_s[rows]
        steps_s = np.diff(times_s, axis=1)[:, :, None]
        force = imu.specific_force_b[rows]
        rate = imu.angular_rate_b[rows]
        turns = mat_from_vector(0.5 * (rate[:, 1:] + rate[:, :-1]) * steps_s)
        attitude = np.empty((*rows.shape, 3, 3))
        attitude[:, 0] = np.eye(3)
        for k in range(length):
            attitude[:, k + 1] = attitude[:, k] @ turns[:, k]
        turned_force = np.einsum("wkij,wkj->wki", attitude, force)
        by_attitude = _summed(attitude.reshape(*rows.shape, 9), steps_s)
        by_gyro = skew(turned_force) @ by_attitude.reshape(*rows.shape, 3, 3)
        by_gyro = _summed(by_gyro.reshape(*rows.shape, 9), steps_s)
        summed = np.concatenate(
            [rate, _summed(turned_force, steps_s), by_attitude, by_gyro], axis=2
        )
        whole = (steps_s <= LONGEST_STEP_S).all(axis=(1, 2))
        return cls(int(imu.time_ns[0]), times_s, whole, attitude, summed)

    def windows(
        self,
        ping_ns: TimeNs,
        velocity_d: Floats,
        delay_s: float,
    ) -> MotionWindows | None:
        """Make the equations of all windows; None where too few have pings."""
        ping_s = seconds(ping_ns, self.origin_ns) - delay_s
        squares = []
        count = 0
        for window in np.flatnonzero(self.whole).tolist():
            times_s = self.times_s[window]
            first, last = np.searchsorted(ping_s, times_s[[0, -1]])
            if last - first < FEWEST_PINGS:
                continue
            equations = self._equations(window, ping_s[first:last], velocity_d[first:last])
            squares.append(equations.T @ equations)
            count += len(equations) - OWN
        if len(squares) >= FEWEST_WINDOWS:
            return MotionWindows(np.array(squares), count)
        return None

    def _equations(
        self,
        window: int,
        at_s: Floats,
        velocity_d: Floats,
    ) -> Floats:
        """Return the equations of one window, (3 pings, 19), without its own unknowns."""
        times_s = self.times_s[window]
        attitude = self.attitude[window]
        summed = self.summed[window]
        after = np.clip(np.searchsorted(times_s, at_s), 1, len(times_s) - 1)
        before = after - 1
        share = ((at_s - times_s[before]) / (times_s[after] - times_s[before]))[:, None]
        readings = summed[before] + share * (summed[after] - summed[before])
        near = attitude[before] + share[:, :, None] * (attitude[after] - attitude[before])
        pings = len(at_s)
        equations = np.zeros((pings, 3, _KNOWN + 1))
        # D R v: element (i, j) of R counts with D[:, i] v[j].
        equations[:, :, TURN] = np.einsum("kai,kj->kaij", near, velocity_d).reshape(pings, 3, 9)
        equations[:, :, 9:12] = -near @ skew(readings[:, :3])
        equations[:, :, 12:15] = readings[:, 6:15].reshape(pings, 3, 3)
        equations[:, :, 15:18] = readings[:, 15:24].reshape(pings, 3, 3)
        equations[:, :, _KNOWN] = readings[:, 3:6]
        since_s = at_s - at_s.mean()
        own, _ = np.linalg.qr(np.column_stack([np.ones(pings), since_s, since_s**2]))
        flat = equations.reshape(pings, -1)
        return np.asarray((flat - own @ (own.T @ flat)).reshape(3 * pings, _KNOWN + 1))


def _summed(values: Floats, steps_s: Floats) -> Floats:
    """Integrate (windows, k, n) over time by trapezoids."""
    total = np.zeros_like(values)
    np.cumsum(0.5 * (values[:, 1:] + values[:, :-1]) * steps_s, axis=1, out=total[:, 1:])
    return total


def free_mounting(
    imu: ImuColumns,
    ping_ns: TimeNs,
    velocity_d: Floats,
    starts: Sequence[Floats],
) -> FreeMounting | None:
    """Fit the rotation from DVL to IMU, with arm, delay, scale and biases; None where too little is measured.

    The IMU is thinned; the starts are rotations that are tried first, such as the quarter turns.
    """
    good = np.isfinite(velocity_d).all(axis=1)
    ping_ns = ping_ns[good]
    velocity_d = velocity_d[good]
    integrals = _Integrals.of(imu)
    if integrals is None:
        return None

    def tried(delay_s: float, starts: Sequence[Floats]) -> FreeMounting | None:
        windows = integrals.windows(ping_ns, velocity_d, delay_s)
        if windows is None:
            return None
        return _fitted(windows, delay_s, starts)

    best = tried(0.0, starts)
    if best is None:
        return None
    for step_s in DELAY_STEPS_S:
        near = [best.delay_s + count * step_s for count in (-2, -1, 1, 2)]
        fits = [tried(delay_s, best.minima) for delay_s in near if abs(delay_s) <= LATEST_S]
        best = min([best, *(fit for fit in fits if fit is not None)], key=lambda fit: fit.cost)
    return tried(best.delay_s, [*best.minima, *starts])


def _fitted(windows: MotionWindows, delay_s: float, starts: Sequence[Floats]) -> FreeMounting:
    quadratic = Quadratic.of(windows.total())
    minima = quadratic.minima(starts)
    degrees = max(float(windows.count) - _KNOWN, 1.0)
    cost = quadratic.cost(minima[0]) / degrees * (1.0 + (delay_s / _DELAY_SD_S) ** 2 / degrees)
    return FreeMounting(tuple(minima), cost, delay_s, windows, quadratic)


@dataclass(frozen=True)
class LevelDvl:
    """A free fit with what is known of vehicles: they are level, and so are their DVLs where motion does not tell."""

    fit: FreeMounting
    down_b: Floats  # (3,), where gravity pulls on average, in the IMU's axes
    known_look_d: Floats | None = None  # (3,), where the beams look, if the messages tell

    @property
    def look_d(self) -> Floats:
        """Where a DVL looks, a unit vector, (3,)."""
        if self.known_look_d is None:
            return np.array([0.0, 0.0, 1.0])
        return _unit(self.known_look_d)

    def tilt(self, mat: Floats) -> float:
        """Return the cosine of the angle between the vehicle's down and the DVL's."""
        return float(self.down_b @ mat @ self.look_d)

    def is_possible(self, mat: Floats) -> bool:
        """Return whether the DVL looks down, or up if its beams do not say where they look."""
        return (
            self.tilt(mat) if self.known_look_d is not None else abs(self.tilt(mat))
        ) > LEAST_TILT

    @cached_property
    def minima(self) -> list[Floats]:
        """Rotations of locally least cost, (3, 3) each, upright and upside down, level where motion does not tell."""
        return [
            self._levelled(mat) for mat in [*self.fit.minima, *map(self._tipped, self.fit.minima)]
        ]

    @property
    def likeliest(self) -> Floats:
        """The rotation of least cost, (3, 3); of similar ones that whose DVL looks down."""
        possible = [mat for mat in self.minima if self.is_possible(mat)] or self.minima
        least = min(map(self.fit.misfit, possible))
        similar = [mat for mat in possible if self.fit.misfit(mat) < CLEARLY * least]
        return max(similar, key=lambda mat: round(self.tilt(mat), 1))

    def _levelled(self, mat: Floats) -> Floats:
        """Return the best rotation near another one, with a level DVL where the motion leaves that open."""
        axis_b = self.down_b if self.tilt(mat) > 0.0 else -self.down_b
        return self.fit.levelled(mat, self.look_d, axis_b)

    def _tipped(self, mat: Floats) -> Floats:
        """Turn a rotation by half a turn about the direction of travel: upside down."""
        along = mat @ self.travel_d
        return np.asarray(mat_from_vector(np.pi * along) @ mat)

    @property
    def travel_d(self) -> Floats:
        """The horizontal direction of the DVL in which its equations are strongest, a unit vector, (3,)."""
        power = np.einsum("ijik->jk", self.fit.quadratic.square.reshape(3, 3, 3, 3))
        _, axes = np.linalg.eigh(power)
        return np.asarray(axes[:, -1])

    @cached_property
    def _sd_rad(self) -> float:
        """Standard deviation about down of the likeliest rotation, rad."""
        return self.fit.sd_about(self.likeliest, self.down_b)

    def excludes(self, other: Floats, mat: Floats) -> bool:
        """Return whether a rotation, (3, 3), is clearly worse than one near the likeliest.

        Of rotations that are not far, also whether it is many standard deviations off about down.
        """
        misfit = self.fit.misfit(other) / self.fit.misfit(mat)
        if misfit > CLEARLY:
            return True
        turn = vector_from_mat(other @ mat.T)
        is_far = float(np.linalg.norm(turn)) > _LEVEL_RAD
        return (
            not is_far
            and misfit > LEAST_BETTER
            and abs(float(turn @ self.down_b)) > MANY_SDS * self._sd_rad
        )


def down_of(imu: ImuColumns) -> Floats:
    """Return where gravity pulls in the mean of a dive, a unit vector, (3,)."""
    return _unit(-np.median(imu.specific_force_b, axis=0))


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def velocities_of(dvl: DvlColumns) -> tuple[TimeNs, Floats]:
    """Return times and velocities in the DVL's axes of the pings that have a velocity or all beams."""
    return velocities_b(dvl, Config())


def samples_in_step(imu: ImuColumns) -> int:
    """Return how many samples of an IMU are averaged to one, 1 at least."""
    return max(1, round(IMU_STEP_S / imu.usual_step_s))


def averaged_imu(imu: ImuColumns) -> ImuColumns:
    """Return the means of readings over `IMU_STEP_S`, at the means of their times."""
    return imu.averaged(samples_in_step(imu))
