"""Robust least squares for the geometry with the smallest innovations, over several dives of one vehicle.

Each innovation is divided by the scatter of its axis, and outliers count less. The configuration is a prior, with the
sds of `PARAMETERS`. Mounting, arm and scale are common to all dives. Each dive has its own delay, because clocks are
set again before a dive. Sources: Levenberg, 1944, and Marquardt, 1963, for the steps; Huber and Ronchetti,
"Robust statistics", for weights with an estimated scale.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.calibration.free_mounting import (
    NEAR_QUARTER_RAD,
    LevelDvl,
    angle_between,
    averaged_imu,
    down_of,
    free_mounting,
    velocities_of,
)
from insdvl_replay.calibration.innovations import (
    DELAY,
    LATEST_S,
    NAMES,
    NO_CHANGE,
    PARAMETERS,
    PRIOR_SD,
    DiveInnovations,
    ReadDive,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import DvlColumns, Floats, Integers, Mask
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import look_down
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.preparation.run import FIT

SOFT: Final = 2.0  # residuals, over the scatter of the axis, above which they count less and less
# standard deviation of normal values over the median of their absolute values
SD_OF_DEVIATION: Final = 1.4826
DELAY_STEP_S: Final = 0.05
MOST_ROUNDS: Final = 12
SETTLED: Final = 0.05  # a step below this number of standard deviations is the last
STEEPER: Final = 10.0
FLATTER: Final = 0.1
LARGEST_DAMPING: Final = 1e6
OWN: Final = len(NAMES)
SHARED_ROWS: Final = np.array([i for i in range(OWN) if i != DELAY])
# Places of the delays among the unknowns of a fit, behind those of the vehicle.
_DELAYS: Final = slice(OWN - 1, None)


@dataclass(frozen=True)
class Linearised:
    """The residuals of one dive near a solution."""

    residuals: Floats  # (k, 3), in their own standard deviations
    scatter: Floats  # (3,): of each axis, in the same; 1 where the filter knows its noise
    jacobian: Floats  # (k, 3, 8), of the residuals over the scatter
    by_motion: Floats  # the same, or only the part from the vehicle's motion, see `certainty`

    @property
    def scaled(self) -> Floats:
        """Residuals over the scatter, (k, 3)."""
        return self.residuals / self.scatter

    @property
    def weights(self) -> Floats:
        """How much each residual counts, (k, 3)."""
        return weights_of(self.scaled)

    @property
    def scores(self) -> Floats:
        """The scores of the pings, (k, 8): minus half the gradient of the cost."""
        return -np.asarray(np.einsum("ka,ka,kai->ki", self.weights, self.scaled, self.by_motion))


@dataclass(frozen=True)
class Fit:
    """A solution, and the dives linearised there."""

    # for each dive: indices of its p parameters among the unknowns, (p,)
    rows: tuple[Integers, ...]
    prior_sd: Floats  # (count,): prior sd of each unknown
    is_free: Mask  # (count,): whether each is estimated
    values: Floats  # (count,): changes
    dives: tuple[Linearised, ...]

    @property
    def free(self) -> Mask:
        """Which parameters of a dive are estimated, (p,)."""
        return self.is_free[self.rows[0]]

    def change(self, dive: int) -> Floats:
        """Return the change of one dive, (p,)."""
        return self.values[self.rows[dive]]

    def alone(self, dive: int) -> "Fit":
        """Return the fit of one dive alone."""
        rows = self.rows[dive]
        own = np.arange(len(self.rows[dive]))
        return Fit(
            (own,), self.prior_sd[rows], self.is_free[rows], self.values[rows], (self.dives[dive],)
        )

    def total(self, matrices: Iterable[Floats]) -> Floats:
        """Add a matrix (p, p) of each dive to the information of the prior, (count, count)."""
        total = np.diag(self.prior_sd**-2.0)
        for rows, matrix in zip(self.rows, matrices, strict=True):
            total[np.ix_(rows, rows)] += matrix
        return total

    def squares(self, derivative: str, power: int = 1) -> Floats:
        """Return the weighted sum of products of ``by_motion`` and a derivative, with the prior, (count, count).

        With ``by_motion`` it is the covariance of the gradient for white residuals; with ``jacobian`` the decrease of
        the gradient with the unknowns. Use the third power if the weights change with the residuals: a growing
        outlier counts less and less.
        """
        return self.total(
            np.einsum(
                "ka,kai,kaj->ij", near.weights**power, near.by_motion, getattr(near, derivative)
            )
            for near in self.dives
        )

    @property
    def slope(self) -> Floats:
        """Decrease of the gradient with the unknowns, (count, count)."""
        return self.squares("jacobian")

    @property
    def information(self) -> Floats:
        """Covariance of the gradient for white residuals, (count, count)."""
        return self.squares("by_motion")

    @property
    def cov(self) -> Floats:
        """Formal covariance, (count, count); held parameters have only the prior."""
        inverse = np.linalg.inv(self.slope)
        return np.asarray(inverse @ self.information @ inverse.T, dtype=np.float64)

    @property
    def gradient(self) -> Floats:
        """Minus half the gradient of the cost, (count,)."""
        gradient = -self.values / self.prior_sd**2
        for rows, near in zip(self.rows, self.dives, strict=True):
            gradient[rows] += near.scores.sum(axis=0)
        return gradient

    @property
    def step(self) -> Floats:
        """The step to where the sum of the scores is zero, (count,); 0 for held parameters."""
        return np.where(self.is_free, np.linalg.solve(self.slope, self.gradient), 0.0)

    @property
    def moved_by_scores(self) -> Floats:
        """Change of the solution with the scores, (count, count): the inverse curvature."""
        return np.asarray(np.linalg.inv(self.squares("jacobian", 3)), dtype=np.float64)


def weights_of(scaled: Floats) -> Floats:
    """Return the weights of residuals (soft L1)."""
    return 1.0 / np.sqrt(1.0 + (scaled / SOFT) ** 2)


def robust_cost(scaled: Floats) -> float:
    """Return the sum of soft L1 costs, which are squares near zero."""
    return float(2.0 * SOFT**2 * np.sum(np.sqrt(1.0 + (scaled / SOFT) ** 2) - 1.0))


def scatter_of(residuals: Floats) -> Floats:
    """Return the scatter of each axis, (3,), from the median, which outliers do not change."""
    scatter = SD_OF_DEVIATION * np.median(np.abs(residuals), axis=0)
    return np.maximum(scatter, np.finfo(float).tiny)


@dataclass(frozen=True)
class _Problem:
    """The dives to fit, and where their parameters are among the unknowns.

    The unknowns are seven for the vehicle, then the delays of the dives, or one for all.
    """

    dives: Sequence[DiveInnovations]
    free: Mask  # (8,): parameters of a dive
    rows: tuple[Integers, ...]  # for each dive: indices of its parameters among the unknowns, (8,)
    prior_sd: Floats  # (count,): of each unknown
    is_free: Mask  # (count,)

    @classmethod
    def of(
        cls,
        dives: Sequence[DiveInnovations],
        free: Mask,
        *,
        one_delay: bool,
    ) -> "_Problem":
        """Number the unknowns."""
        delays = np.zeros(len(dives), int) if one_delay else np.arange(len(dives))
        rows = tuple(np.insert(np.arange(OWN - 1), DELAY, OWN - 1 + delay) for delay in delays)
        parameters = np.append(SHARED_ROWS, np.full(len(np.unique(delays)), DELAY))
        return cls(dives, free, rows, PRIOR_SD[parameters], free[parameters])

    def start(self) -> Floats:
        """Begin at the best delays of a coarse grid, to avoid a local minimum, (count,)."""
        values = np.zeros(len(self.prior_sd))
        if not self.free[DELAY]:
            return values
        grid = np.arange(-LATEST_S, LATEST_S + DELAY_STEP_S / 2.0, DELAY_STEP_S)
        costs = np.zeros((len(values), len(grid)))
        for dive, rows in zip(
            track_progress("searching the delay", self.dives), self.rows, strict=True
        ):
            costs[rows[DELAY]] += delay_profile(dive, NO_CHANGE, grid)
        values[_DELAYS] = grid[np.argmin(costs[_DELAYS], axis=1)]
        return values

    def residuals_at(self, values: Floats) -> list[Floats]:
        """Return the residuals of each dive, (k, 3)."""
        return [
            dive.residuals(values[rows]) for dive, rows in zip(self.dives, self.rows, strict=True)
        ]

    def linearised(self, values: Floats, residuals: Sequence[Floats]) -> Fit:
        """Differentiate the residuals at some values."""
        near = []
        for dive, rows, left in zip(self.dives, self.rows, residuals, strict=True):
            scatter = scatter_of(left)
            jacobian = dive.jacobian(values[rows], self.free) / scatter[:, None]
            near.append(Linearised(left, scatter, jacobian, jacobian))
        return Fit(self.rows, self.prior_sd, self.is_free, values, tuple(near))

    def cost(self, values: Floats, scaled: Iterable[Floats]) -> float:
        """Return the cost of residuals over their scatter, and of the distance from the configuration."""
        return float(sum(map(robust_cost, scaled)) + np.sum((values / self.prior_sd) ** 2))


@dataclass(frozen=True)
class _Step:
    """Where the cost is not larger than before."""

    values: Floats  # (count,)
    residuals: Sequence[Floats]
    damping: float  # with which it was found


def fit(
    dives: Sequence[DiveInnovations],
    free: Mask,  # (8,)
    *,
    one_delay: bool = False,
    start: Floats | None = None,
    settled: float = SETTLED,
) -> Fit:
    """Find the changes under which the innovations of all dives are smallest."""
    problem = _Problem.of(dives, free, one_delay=one_delay)
    values = problem.start() if start is None else np.where(problem.is_free, start, 0.0)
    found = problem.linearised(values, problem.residuals_at(values))
    damping = 1e-3
    for _ in track_progress("fitting the innovations", range(MOST_ROUNDS)):
        information = found.information
        step = _downhill(problem, found, information, damping)
        if step is None:
            return found
        damping = step.damping * FLATTER
        sds = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.max(np.abs(step.values - found.values) / sds) < settled:
            return _nearby(found, step)
        found = problem.linearised(step.values, step.residuals)
    return found


def _downhill(
    problem: _Problem,
    found: Fit,
    information: Floats,
    damping: float,
) -> _Step | None:
    """Step with more and more damping until the cost is not larger; None if it always is."""
    gradient = found.gradient
    before = problem.cost(found.values, (near.scaled for near in found.dives))
    while damping < LARGEST_DAMPING:
        damped = information + damping * np.diag(np.diag(information))
        step = np.linalg.solve(damped, gradient)
        step[~problem.is_free] = 0.0
        values = found.values + step
        values[_DELAYS] = np.clip(values[_DELAYS], -LATEST_S, LATEST_S)
        residuals = problem.residuals_at(values)
        # Divide by the scatter before the step; with the new one a worse solution could look better.
        scaled = [left / near.scatter for left, near in zip(residuals, found.dives, strict=True)]
        if problem.cost(values, scaled) <= before:
            return _Step(values, residuals, damping)
        damping *= STEEPER
    return None


def _nearby(found: Fit, step: _Step) -> Fit:
    """Return the fit after a step so small that the derivatives are the same."""
    dives = []
    for near, residuals in zip(found.dives, step.residuals, strict=True):
        scatter = scatter_of(residuals)
        jacobian = near.jacobian * (near.scatter / scatter)[:, None]
        dives.append(Linearised(residuals, scatter, jacobian, jacobian))
    return replace(found, values=step.values, dives=tuple(dives))


def delay_profile(dive: DiveInnovations, change: Floats, delays_s: Floats) -> Floats:
    """Return the robust cost of one dive over its delay, all else fixed, (n,) as the delays.

    Each axis is divided by its smallest scatter, so that no axis hides the others.
    """
    tried = [np.where(np.arange(OWN) == DELAY, delay_s, change) for delay_s in delays_s]
    residuals = list(parallel_map(dive.residuals, tried))
    scatter = np.min([scatter_of(left) for left in residuals], axis=0)
    return np.array([robust_cost(left / scatter) for left in residuals])


# --- Search for an unknown mounting.


def _quarter_turns() -> Iterator[Floats]:
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.diag(signs)[:, order]
            if np.linalg.det(turn) > 0.0:
                yield turn


# The 24 rotations between two right-handed sets of axes that are parallel.
AXES: Final[tuple[Floats, ...]] = tuple(_quarter_turns())
CLEARLY: Final = 0.8  # ratio of costs below which the second mounting is clearly worse
# ratio to the least cost above which no arm or delay makes a mounting the best
NOT_FAR_OFF: Final = 4.0
MOST_FITTED: Final = 6
MOST_FREE: Final = 3  # dives that are fitted freely
_ARM_AND_DELAY: Final = np.array([parameter.group in ("arm", "delay") for parameter in PARAMETERS])


@dataclass(frozen=True)
class TriedMounting:
    """One possible mounting, and the robust sum of squares of its innovations."""

    rpy_deg: tuple[float, float, float]
    cost: float  # for likely mountings with the best arm and delay


def possible_axes(dvl: DvlColumns) -> tuple[Floats, ...]:
    """Return the mountings with which the beams look down, if the messages give beam directions; else all."""
    if dvl.look_d is None:
        return AXES
    return tuple(turn for turn in AXES if look_down(turn @ dvl.look_d)) or AXES


def with_mounting(config: Config, rpy_deg: tuple[float, float, float]) -> Config:
    """Set the mounting in a configuration."""
    return msgspec.structs.replace(
        config, dvl=msgspec.structs.replace(config.dvl, mounting_rpy_deg=rpy_deg)
    )


def tried_mountings(dives: Sequence[ReadDive]) -> list[TriedMounting]:
    """Try quarter turns and the free fits of each dive, and return the likeliest first.

    An unknown arm or delay can make a wrong mounting look better. So the best ones, and the configured one, are tried
    again with fitted arm and delay. These come before all others.
    """
    config = dives[0].config
    configured = config.dvl.mounting_rpy_deg
    if config.initial.heading_deg == FIT:
        # Innovations of velocities hardly depend on the heading, and a wrong mounting fits no heading.
        initial = msgspec.structs.replace(config.initial, heading_deg=0.0)
        config = msgspec.structs.replace(config, initial=initial)

    def tried(rpy_deg: tuple[float, float, float], *, fitted: bool) -> TriedMounting:
        asked = [dive.with_config(with_mounting(config, rpy_deg)).innovations() for dive in dives]
        changes = [NO_CHANGE] * len(asked)
        if fitted:
            found = fit(asked, _ARM_AND_DELAY)
            changes = [found.change(i) for i in range(len(asked))]
        left = (dive.residuals(change) for dive, change in zip(asked, changes, strict=True))
        return TriedMounting(rpy_deg, sum(map(robust_cost, left)))

    first = []
    turns = [*possible_axes(dives[0].dive.dvl), *_free_turns(dives)]
    for turn in track_progress("trying mountings", turns):
        roll, pitch, heading = (np.round(rpy_from_mat(turn) / DEG, 2) + 0.0).tolist()  # no -0.0
        first.append(tried((roll, pitch, heading), fitted=False))
    first.sort(key=lambda mounting: mounting.cost)
    likely = [mounting for mounting in first if mounting.cost < NOT_FAR_OFF * first[0].cost]
    near = likely[:MOST_FITTED]
    others = []
    for mounting in first:
        if mounting in near:
            continue
        if mounting.rpy_deg == configured:
            near.append(mounting)
        else:
            others.append(mounting)
    stage = "trying mountings with arm and delay"
    fitted = [tried(mounting.rpy_deg, fitted=True) for mounting in track_progress(stage, near)]
    return sorted(fitted, key=lambda mounting: mounting.cost) + others


def _free_turns(dives: Sequence[ReadDive]) -> list[Floats]:
    """Return the rotations from DVL to IMU that fit the motion of single dives, (3, 3), where no quarter turn does."""
    found: list[Floats] = []
    for read in dives[:MOST_FREE]:
        dvl = read.dive.dvl
        free = free_mounting(averaged_imu(read.dive.imu), *velocities_of(dvl), AXES)
        if free is None:
            continue
        level = LevelDvl(free, down_of(read.dive.imu), dvl.look_d)
        if dvl.look_d is None:  # it may be built in on its side
            found += [*level.minima, *free.minima[:1]]
        else:
            found += [turn for turn in level.minima if level.is_possible(turn)]
    return [turn for turn in found if not _is_quarter_turn(turn)]


def _is_quarter_turn(turn: Floats) -> bool:
    return min(angle_between(turn, quarter) for quarter in AXES) <= NEAR_QUARTER_RAD


def likeliest_mounting(dives: Sequence[ReadDive]) -> tuple[float, float, float]:
    """Return the likeliest mounting as roll, pitch, heading, deg.

    If several are about as likely, one with the DVL's z axis down is chosen, the usual one. A dive without roll and
    pitch cannot distinguish it from an upside-down one.
    """
    tried = tried_mountings(dives)
    for mounting in tried:
        is_likely = mounting.cost * CLEARLY <= tried[0].cost
        turn = mat_from_rpy(np.array(mounting.rpy_deg) * DEG)
        if is_likely and turn[2, 2] > 0.5:
            return mounting.rpy_deg
    return tried[0].rpy_deg
