"""The geometry under which innovations are smallest: robust least squares over several dives, one vehicle.

Each innovation is weighed by what the axis scatters by, far ones count less, and what the configuration says is a
measurement, too, with the sds of `parameters.PARAMETERS`. Mounting, arm and scale are the vehicle's; the delay is each
dive's, since clocks are set anew. Sources: Levenberg, 1944, and Marquardt, 1963, for the steps; Huber and Ronchetti,
"Robust statistics", for weights from a scale that is estimated beside them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.innovations import LATEST_S, DiveInnovations
from insdvl_replay.calibration.parameters import DELAY, NAMES, PRIOR_SD
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import parallel_map, track_progress

SOFT: Final = 2.0
"""Residuals, in what the axis scatters by, beyond which they count less and less."""
SD_OF_DEVIATION: Final = 1.4826
"""Standard deviation of normal values over the median of their absolute values."""
DELAY_STEP_S: Final = 0.05
MOST_ROUNDS: Final = 12
SETTLED: Final = 0.05
"""A step of less than so many of its standard deviations is the last."""
STEEPER, FLATTER = 10.0, 0.1
LARGEST_DAMPING: Final = 1e6
OWN: Final = len(NAMES)
SHARED: Final = np.array([i for i in range(OWN) if i != DELAY])

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Unknowns:
    """Where the parameters of each dive stand among all: those of the vehicle first, then the delays."""

    dives: int
    one_delay: bool  # whether all dives share one, as those of one driver may
    free: Mask  # shape (8,): what is estimated at all

    @property
    def count(self) -> int:
        """How many numbers there are."""
        return OWN - 1 + (1 if self.one_delay else self.dives)

    def rows(self, dive: int) -> NDArray[np.int64]:
        """Where the eight parameters of a dive stand, shape (8,)."""
        rows = np.empty(OWN, dtype=np.int64)
        rows[SHARED] = np.arange(OWN - 1)
        rows[DELAY] = OWN - 1 + (0 if self.one_delay else dive)
        return rows

    def of_dive(self, values: Floats, dive: int) -> Floats:
        """Return the change of one dive, shape (8,)."""
        return values[self.rows(dive)]

    def of_parameters(self, eight: NDArray[Any]) -> NDArray[Any]:
        """Give each number what its parameter has, shape (count,)."""
        return np.concatenate([eight[SHARED], np.full(self.count - OWN + 1, eight[DELAY])])

    @property
    def prior_sd(self) -> Floats:
        """Of all numbers, shape (count,)."""
        return self.of_parameters(PRIOR_SD)

    @property
    def is_free(self) -> Mask:
        """Of all numbers, shape (count,)."""
        return self.of_parameters(self.free)


@dataclass(frozen=True)
class Linearised:
    """The residuals of one dive near an answer."""

    residuals: Floats  # shape (k, 3), in their own standard deviations
    scatter: Floats  # shape (3,): of each axis, in the same; 1 where the filter knows its noise
    jacobian: Floats  # shape (k, 3, 8), of the residuals over the scatter
    by_motion: Floats  # likewise: all of it, or what residuals may not go with, see `motion` and `considered`

    @property
    def scaled(self) -> Floats:
        """Residuals over the scatter, shape (k, 3)."""
        return self.residuals / self.scatter

    @property
    def weights(self) -> Floats:
        """How much each counts, shape (k, 3)."""
        return weights_of(self.scaled)

    @property
    def information(self) -> Floats:
        """The scores' covariance, shape (8, 8), where residuals are white."""
        return np.asarray(np.einsum("ka,kai,kaj->ij", self.weights, self.by_motion, self.by_motion))

    @property
    def slope(self) -> Floats:
        """How fast the scores' sum falls with the parameters, weights held, shape (8, 8)."""
        return np.asarray(np.einsum("ka,kai,kaj->ij", self.weights, self.by_motion, self.jacobian))

    @property
    def curvature(self) -> Floats:
        """The same with weights that follow, shape (8, 8).

        Less than the slope: a residual that is weighed down is weighed down more when it grows.
        """
        return np.asarray(np.einsum("ka,kai,kaj->ij", self.weights**3, self.by_motion, self.jacobian))

    @property
    def scores(self) -> Floats:
        """What each ping says, shape (k, 8); of all of the derivative minus half the gradient of the cost."""
        return -np.asarray(np.einsum("ka,ka,kai->ki", self.weights, self.scaled, self.by_motion))


@dataclass(frozen=True)
class Fit:
    """An answer, and the dives linearised there."""

    unknowns: Unknowns
    values: Floats  # shape (count,): changes, in the order of `Unknowns`
    dives: tuple[Linearised, ...]

    def of_dive(self, dive: int) -> Floats:
        """Return the change of one dive, shape (8,)."""
        return self.unknowns.of_dive(self.values, dive)

    @property
    def cov(self) -> Floats:
        """Formal covariance, shape (count, count); what is held has the prior alone."""
        slope = _total(self.unknowns, [near.slope for near in self.dives])
        return formal_cov(slope, _total(self.unknowns, [near.information for near in self.dives]))

    @property
    def step(self) -> Floats:
        """How far it is from here to where the scores' sum is zero, shape (count,); what is held stays."""
        slope = _total(self.unknowns, [near.slope for near in self.dives])
        step = np.linalg.solve(slope, _gradient(self.unknowns, self.dives, self.values))
        return np.where(self.unknowns.is_free, step, 0.0)

    @property
    def moved_by_scores(self) -> Floats:
        """How far the answer moves with what the pings say, shape (count, count): the inverse curvature."""
        curvature = _total(self.unknowns, [near.curvature for near in self.dives])
        return np.asarray(np.linalg.inv(curvature), dtype=np.float64)


def formal_cov(slope: Floats, information: Floats) -> Floats:
    """Return the covariance of an answer whose scores have the covariance of the information."""
    inverse = np.linalg.inv(slope)
    return np.asarray(inverse @ information @ inverse.T, dtype=np.float64)


def weights_of(scaled: Floats) -> Floats:
    """Return how much residuals count that are beyond what is usual (soft L1)."""
    return 1.0 / np.sqrt(1.0 + (scaled / SOFT) ** 2)


def robust_cost(scaled: Floats) -> float:
    """Return the sum of soft L1 losses, which near zero are squares."""
    return float(2.0 * SOFT**2 * np.sum(np.sqrt(1.0 + (scaled / SOFT) ** 2) - 1.0))


def scatter_of(residuals: Floats) -> Floats:
    """Return what each axis scatters by, shape (3,), by the median, which a few far pings do not move."""
    scatter = SD_OF_DEVIATION * np.median(np.abs(residuals), axis=0)
    return np.maximum(scatter, np.finfo(float).tiny)


def fit(
    dives: Sequence[DiveInnovations],
    free: Mask,
    *,
    one_delay: bool = False,
    start: Floats | None = None,
    settled: float = SETTLED,
) -> Fit:
    """Find the changes under which the innovations of all dives are smallest."""
    unknowns = Unknowns(len(dives), one_delay, free)
    values = _with_delays(unknowns, dives) if start is None else np.where(unknowns.is_free, start, 0.0)
    damping = 1e-3
    linearised = _linearised(unknowns, dives, values)
    for _ in track_progress("fitting the innovations", range(MOST_ROUNDS)):
        information = _total(unknowns, [near.information for near in linearised])
        gradient = _gradient(unknowns, linearised, values)
        before = _cost(unknowns, values, [near.scaled for near in linearised])
        while damping < LARGEST_DAMPING:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step[~unknowns.is_free] = 0.0
            late = values[OWN - 1 :] + step[OWN - 1 :]
            step[OWN - 1 :] += np.clip(late, -LATEST_S, LATEST_S) - late
            residuals = [dive.residuals(unknowns.of_dive(values + step, i)) for i, dive in enumerate(dives)]
            scaled = [of_dive / near.scatter for of_dive, near in zip(residuals, linearised, strict=True)]
            if _cost(unknowns, values + step, scaled) <= before:
                break
            damping *= STEEPER
        else:
            break
        values, damping = values + step, damping * FLATTER
        sds = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.max(np.abs(step) / sds) < settled:
            # So near, derivatives are the same.
            return Fit(unknowns, values, tuple(map(_with_residuals, linearised, residuals)))
        linearised = _linearised(unknowns, dives, values, residuals)
    return Fit(unknowns, values, linearised)


def _with_residuals(near: Linearised, residuals: Floats) -> Linearised:
    scatter = scatter_of(residuals)
    jacobian = near.jacobian * (near.scatter / scatter)[:, None]
    return Linearised(residuals, scatter, jacobian, jacobian)


def _with_delays(unknowns: Unknowns, dives: Sequence[DiveInnovations]) -> Floats:
    """Begin at the delay of a coarse grid, so that the fit cannot stay in a side valley."""
    values = np.zeros(unknowns.count)
    if not unknowns.free[DELAY]:
        return values
    grid = np.arange(-LATEST_S, LATEST_S + DELAY_STEP_S / 2.0, DELAY_STEP_S)
    costs = np.array(
        [delay_profile(dive, np.zeros(OWN), grid) for dive in track_progress("looking for the delay", dives)]
    )
    if unknowns.one_delay:
        costs = costs.sum(axis=0, keepdims=True)
    values[OWN - 1 :] = grid[np.argmin(costs, axis=1)]
    return values


def delay_profile(dive: DiveInnovations, change: Floats, delays_s: Floats) -> Floats:
    """Return the robust cost of one dive over its delay, all else fixed, shape as the delays.

    Each axis is weighed by what it scatters by where that is least, so that no axis hides the others.
    """
    at = [change + (delay_s - change[DELAY]) * (np.arange(OWN) == DELAY) for delay_s in delays_s]
    residuals = list(parallel_map(dive.residuals, at))
    scatter = np.min([scatter_of(of_one) for of_one in residuals], axis=0)
    return np.array([robust_cost(of_one / scatter) for of_one in residuals])


def _linearised(
    unknowns: Unknowns, dives: Sequence[DiveInnovations], values: Floats, known: Sequence[Floats] | None = None
) -> tuple[Linearised, ...]:
    found = []
    for i, dive in enumerate(dives):
        change = unknowns.of_dive(values, i)
        residuals = dive.residuals(change) if known is None else known[i]
        scatter = scatter_of(residuals)
        jacobian = dive.jacobian(change, unknowns.free) / scatter[:, None]
        found.append(Linearised(residuals, scatter, jacobian, jacobian))
    return tuple(found)


def _cost(unknowns: Unknowns, values: Floats, scaled: Sequence[Floats]) -> float:
    """Return the cost of some values with residuals over what each axis scattered by before."""
    return float(sum(map(robust_cost, scaled)) + np.sum((values / unknowns.prior_sd) ** 2))


def _total(unknowns: Unknowns, of_dives: Sequence[Floats]) -> Floats:
    """Add what each dive says, shapes (8, 8), to what the prior says, shape (count, count)."""
    total = np.diag(unknowns.prior_sd**-2.0)
    for i, of_dive in enumerate(of_dives):
        rows = unknowns.rows(i)
        total[np.ix_(rows, rows)] += of_dive
    return total


def _gradient(unknowns: Unknowns, linearised: Sequence[Linearised], values: Floats) -> Floats:
    gradient = -values / unknowns.prior_sd**2
    for i, near in enumerate(linearised):
        gradient[unknowns.rows(i)] += near.scores.sum(axis=0)
    return gradient
