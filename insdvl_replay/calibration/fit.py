"""The geometry under which innovations are smallest: robust least squares over several dives, one vehicle.

Each innovation is weighed by what the axis scatters by, far ones count less, and what the configuration says is a
measurement, too, with the sds of `parameters.PARAMETERS`. Mounting, arm and scale are the vehicle's; the delay is each
dive's, since clocks are set anew. Sources: Levenberg, 1944, and Marquardt, 1963, for the steps; Huber and Ronchetti,
"Robust statistics", for weights from a scale that is estimated beside them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from insdvl_replay.calibration.innovations import (
    DELAY,
    LATEST_S,
    NAMES,
    NO_CHANGE,
    PARAMETERS,
    PRIOR_SD,
    DiveInnovations,
    Mask,
    ReadDive,
)
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import DvlColumns, Floats
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import look_down
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.preparation.run import FIT

SOFT: Final = 2.0  # residuals, in what the axis scatters by, beyond which they count less and less
SD_OF_DEVIATION: Final = 1.4826  # standard deviation of normal values over the median of their absolute values
DELAY_STEP_S: Final = 0.05
MOST_ROUNDS: Final = 12
SETTLED: Final = 0.05  # a step of less than so many of its standard deviations is the last
STEEPER, FLATTER = 10.0, 0.1
LARGEST_DAMPING: Final = 1e6
OWN: Final = len(NAMES)
SHARED_ROWS: Final = np.array([i for i in range(OWN) if i != DELAY])


@dataclass(frozen=True)
class Linearised:
    """The residuals of one dive near an answer."""

    residuals: Floats  # (k, 3), in their own standard deviations
    scatter: Floats  # (3,): of each axis, in the same; 1 where the filter knows its noise
    jacobian: Floats  # (k, 3, 8), of the residuals over the scatter
    by_motion: Floats  # likewise: all of it, or the part that the vehicle's motion makes, see `certainty`

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
        """What each ping says, (k, 8): minus half the gradient of the cost."""
        return -np.asarray(np.einsum("ka,ka,kai->ki", self.weights, self.scaled, self.by_motion))


@dataclass(frozen=True)
class Fit:
    """An answer, and the dives linearised there."""

    rows: tuple[NDArray[np.int64], ...]  # of each dive: places of its p parameters among the numbers, (p,)
    prior_sd: Floats  # (count,): how far each number may be off
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
        """Return what one dive says by itself, of its own parameters."""
        rows, own = self.rows[dive], np.arange(len(self.rows[dive]))
        return Fit((own,), self.prior_sd[rows], self.is_free[rows], self.values[rows], (self.dives[dive],))

    def total(self, matrices: Iterable[Floats]) -> Floats:
        """Add a matrix (p, p) of each dive to the information of the prior, (count, count)."""
        total = np.diag(self.prior_sd**-2.0)
        for rows, matrix in zip(self.rows, matrices, strict=True):
            total[np.ix_(rows, rows)] += matrix
        return total

    def squares(self, derivative: str, power: int = 1) -> Floats:
        """Return the weighted sum of products of ``by_motion`` and a derivative, with the prior, (count, count).

        With ``by_motion`` it is the covariance of the gradient where residuals are white; with ``jacobian`` it is how
        fast the gradient falls with the numbers. The third power is of weights that follow the residuals: one that
        counts less counts still less when it grows.
        """
        return self.total(
            np.einsum("ka,kai,kaj->ij", near.weights**power, near.by_motion, getattr(near, derivative))
            for near in self.dives
        )

    @property
    def slope(self) -> Floats:
        """How fast the gradient falls with the numbers, (count, count)."""
        return self.squares("jacobian")

    @property
    def information(self) -> Floats:
        """Covariance of the gradient where residuals are white, (count, count)."""
        return self.squares("by_motion")

    @property
    def cov(self) -> Floats:
        """Formal covariance, (count, count); what is held has the prior alone."""
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
        """How far it is from here to where the scores' sum is zero, (count,); what is held stays."""
        return np.where(self.is_free, np.linalg.solve(self.slope, self.gradient), 0.0)

    @property
    def moved_by_scores(self) -> Floats:
        """How far the answer moves with what the pings say, (count, count): the inverse curvature."""
        return np.asarray(np.linalg.inv(self.squares("jacobian", 3)), dtype=np.float64)


def weights_of(scaled: Floats) -> Floats:
    """Return how much residuals count that are beyond what is usual (soft L1)."""
    return 1.0 / np.sqrt(1.0 + (scaled / SOFT) ** 2)


def robust_cost(scaled: Floats) -> float:
    """Return the sum of soft L1 losses, which near zero are squares."""
    return float(2.0 * SOFT**2 * np.sum(np.sqrt(1.0 + (scaled / SOFT) ** 2) - 1.0))


def scatter_of(residuals: Floats) -> Floats:
    """Return what each axis scatters by, (3,), by the median, which a few far pings do not move."""
    scatter = SD_OF_DEVIATION * np.median(np.abs(residuals), axis=0)
    return np.maximum(scatter, np.finfo(float).tiny)


def fit(
    dives: Sequence[DiveInnovations],
    free: Mask,  # (8,)
    *,
    one_delay: bool = False,
    start: Floats | None = None,
    settled: float = SETTLED,
) -> Fit:
    """Find the changes under which the innovations of all dives are smallest.

    The numbers are the seven of the vehicle, then the delays of the dives, or one for all.
    """
    rows = tuple(np.insert(np.arange(OWN - 1), DELAY, OWN - 1 + (0 if one_delay else i)) for i in range(len(dives)))
    parameters = np.append(SHARED_ROWS, np.full(1 if one_delay else len(dives), DELAY))
    prior_sd, is_free, delays = PRIOR_SD[parameters], free[parameters], slice(OWN - 1, None)
    # Begin at the delay of a coarse grid, so that the fit cannot stay in a side valley.
    values = np.zeros(len(parameters)) if start is None else np.where(is_free, start, 0.0)
    if start is None and free[DELAY]:
        grid = np.arange(-LATEST_S, LATEST_S + DELAY_STEP_S / 2.0, DELAY_STEP_S)
        costs = np.array(
            [delay_profile(dive, NO_CHANGE, grid) for dive in track_progress("looking for the delay", dives)]
        )
        values[delays] = grid[np.argmin(costs.sum(axis=0, keepdims=True) if one_delay else costs, axis=1)]

    def residuals_at(values: Floats) -> list[Floats]:
        return [dive.residuals(values[places]) for dive, places in zip(dives, rows, strict=True)]

    def linearised(values: Floats, residuals: Sequence[Floats]) -> Fit:
        scatters = [scatter_of(left) for left in residuals]
        jacobians = [
            dive.jacobian(values[places], free) / scatter[:, None]
            for dive, places, scatter in zip(dives, rows, scatters, strict=True)
        ]
        return Fit(rows, prior_sd, is_free, values, tuple(map(Linearised, residuals, scatters, jacobians, jacobians)))

    def cost(values: Floats, scaled: Iterable[Floats]) -> float:
        return float(sum(map(robust_cost, scaled)) + np.sum((values / prior_sd) ** 2))

    damping, found = 1e-3, linearised(values, residuals_at(values))
    for _ in track_progress("fitting the innovations", range(MOST_ROUNDS)):
        information, gradient = found.information, found.gradient
        before = cost(found.values, (near.scaled for near in found.dives))
        while damping < LARGEST_DAMPING:
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step[~is_free] = 0.0
            values = found.values + step
            values[delays] = np.clip(values[delays], -LATEST_S, LATEST_S)
            residuals = residuals_at(values)
            # Over what each axis scattered by before: else a worse answer could look better.
            scaled = (left / near.scatter for left, near in zip(residuals, found.dives, strict=True))
            if cost(values, scaled) <= before:
                break
            damping *= STEEPER
        else:
            return found
        damping *= FLATTER
        step, sds = values - found.values, np.sqrt(np.diag(np.linalg.inv(information)))
        if np.max(np.abs(step) / sds) < settled:
            # So near, derivatives are the same.
            scatters = [scatter_of(left) for left in residuals]
            pairs = zip(found.dives, scatters, strict=True)
            jacobians = [near.jacobian * (near.scatter / scatter)[:, None] for near, scatter in pairs]
            near_here = map(Linearised, residuals, scatters, jacobians, jacobians)
            return replace(found, values=values, dives=tuple(near_here))
        found = linearised(values, residuals)
    return found


def delay_profile(dive: DiveInnovations, change: Floats, delays_s: Floats) -> Floats:
    """Return the robust cost of one dive over its delay, all else fixed, (n,) as the delays.

    Each axis is weighed by what it scatters by where that is least, so that no axis hides the others.
    """
    tried = [np.where(np.arange(OWN) == DELAY, delay_s, change) for delay_s in delays_s]
    residuals = list(parallel_map(dive.residuals, tried))
    scatter = np.min([scatter_of(left) for left in residuals], axis=0)
    return np.array([robust_cost(left / scatter) for left in residuals])


# --- How the DVL's axes lie along those of the body, where nobody knows it.

# The 24 ways in which right-handed axes can lie along others.
AXES: Final[tuple[Floats, ...]] = tuple(
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    for turn in [np.diag(signs)[:, order]]
    if np.linalg.det(turn) > 0.0
)
CLEARLY: Final = 0.8  # share of what one mounting leaves of the innovations, below which another one is the likelier
NOT_FAR_OFF: Final = 4.0  # times the least that a mounting leaves, beyond which no arm or delay makes it the best
MOST_FITTED: Final = 6
_ARM_AND_DELAY: Final = np.array([parameter.group in ("arm", "delay") for parameter in PARAMETERS])


@dataclass(frozen=True)
class TriedMounting:
    """One way in which the DVL's axes could lie along the body's, and the robust sum of squares that it leaves."""

    rpy_deg: tuple[float, float, float]
    cost: float  # of several likely ones with the arm and the delay that fit each best


def possible_axes(dvl: DvlColumns) -> tuple[Floats, ...]:
    """Leave out the ways with which the beams would not look down, where the messages tell where they look."""
    if dvl.look_d is None:
        return AXES
    return tuple(turn for turn in AXES if look_down(turn @ dvl.look_d)) or AXES


def with_mounting(config: Config, rpy_deg: tuple[float, float, float]) -> Config:
    """Set the mounting in a configuration."""
    return msgspec.structs.replace(config, dvl=msgspec.structs.replace(config.dvl, mounting_rpy_deg=rpy_deg))


def tried_mountings(dives: Sequence[ReadDive]) -> list[TriedMounting]:
    """Try the ways in which the DVL's axes can lie along the body's, the likeliest first.

    An arm or a delay that is not known yet can make another one look better, so that those that are not far off, and
    what is configured, are tried with arm and delay fitted; these stand before all others.
    """
    config = dives[0].config
    configured = config.dvl.mounting_rpy_deg
    if config.initial.heading_deg == FIT:
        # Innovations of velocities hardly depend on the heading, and with a wrong mounting none fits.
        config = msgspec.structs.replace(config, initial=msgspec.structs.replace(config.initial, heading_deg=0.0))

    def tried(rpy_deg: tuple[float, float, float], *, fitted: bool) -> TriedMounting:
        asked = [dive.with_config(with_mounting(config, rpy_deg)).innovations() for dive in dives]
        changes = [NO_CHANGE] * len(asked)
        if fitted:
            found = fit(asked, _ARM_AND_DELAY)
            changes = [found.change(i) for i in range(len(asked))]
        left = (dive.residuals(change) for dive, change in zip(asked, changes, strict=True))
        return TriedMounting(rpy_deg, sum(map(robust_cost, left)))

    first = []
    for turn in track_progress("trying mountings", possible_axes(dives[0].dive.dvl)):
        roll, pitch, heading = (rpy_from_mat(turn) / DEG + 0.0).tolist()  # no -0.0, which people would read
        first.append(tried((roll, pitch, heading), fitted=False))
    first.sort(key=lambda mounting: mounting.cost)
    near = [mounting for mounting in first if mounting.cost < NOT_FAR_OFF * first[0].cost][:MOST_FITTED]
    near += [mounting for mounting in first if mounting.rpy_deg == configured and mounting not in near]
    stage = "trying mountings with arm and delay"
    fitted = [tried(mounting.rpy_deg, fitted=True) for mounting in track_progress(stage, near)]
    others = [mounting for mounting in first if mounting not in near]
    return sorted(fitted, key=lambda mounting: mounting.cost) + others


def likeliest_mounting(dives: Sequence[ReadDive]) -> tuple[float, float, float]:
    """Return the best of the ways in which the DVL's axes can lie along the body's, as roll, pitch, heading, deg.

    Of several that leave about as much it is one with which the DVL's z looks down, as makers have it: a dive without
    roll and pitch does not tell it from the other side up.
    """
    tried = tried_mountings(dives)
    alike = [mounting for mounting in tried if mounting.cost * CLEARLY <= tried[0].cost]
    downwards = (mounting for mounting in alike if mat_from_rpy(np.array(mounting.rpy_deg) * DEG)[2, 2] > 0.5)
    return next(downwards, tried[0]).rpy_deg
