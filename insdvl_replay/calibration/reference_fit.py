"""Reference and DVL fitted to each other: robust least squares of what the baseline and the reference differ by.

What the innovations said of the DVL is a measurement of its own, as sure as they are, so that the two heads are told
apart: velocities see the sum of how the reference and the DVL are turned, and innovations see the DVL alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.calibration.certainty import Certainty
from insdvl_replay.calibration.fit import Mask, scatter_of, weights_of
from insdvl_replay.calibration.reference_parameters import CLOCK, LATEST_CLOCK_S, SHARED, SHARED_SD
from insdvl_replay.calibration.with_reference import LEVEL, LOST_HEADING_SD, OWN, ReferenceDive
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import track_progress
from insdvl_replay.evaluation.series import samples_in_mean

ROUNDS: Final = 5
FINEST_CLOCK_S: Final = 2e-4
"""Between two samples of the IMU the attitude is interpolated, which shifts a clock by about as much on all dives."""
CONSIDERED: Final = np.array(
    [parameter.name in ("delay", "mounting_x", "arm_x", "arm_y", "arm_z") for parameter in SHARED]
)
"""Of what the innovations said of the DVL, the reference moves scale, pitch and heading; what may be wrong of the rest
counts in every standard deviation. Velocities just behind a ping would mistake its noise for a delay."""


@dataclass(frozen=True)
class Near:
    """One dive near an answer: what is compared in what it scatters by, shapes (k, 3) and (k, 3, 17)."""

    time_s: Floats
    scaled: Floats
    jacobian: Floats

    @property
    def weights(self) -> Floats:
        """How much each counts, shape (k, 3)."""
        return weights_of(self.scaled)

    @property
    def information(self) -> Floats:
        """Shape (17, 17)."""
        return np.asarray(np.einsum("ka,kai,kaj->ij", self.weights, self.jacobian, self.jacobian))

    @property
    def curvature(self) -> Floats:
        """How fast the scores' sum falls, shape (17, 17), see `fit.Linearised`."""
        return np.asarray(np.einsum("ka,kai,kaj->ij", self.weights**3, self.jacobian, self.jacobian))

    @property
    def scores(self) -> Floats:
        """What each time says, in order, shape (m, 17): minus half the gradient of the cost."""
        rows = -np.einsum("ka,ka,kai->ki", self.weights, self.scaled, self.jacobian)
        times, at = np.unique(self.time_s, return_inverse=True)
        sums = np.zeros((len(times), rows.shape[1]))
        np.add.at(sums, at, rows)
        return sums


@dataclass(frozen=True)
class ReferenceFit:
    """An answer.

    Attributes
    ----------
    values : ndarray, shape (15 + 2 n,)
        Changes of `SHARED`, then what is each dive's own.
    prior_sd : ndarray, likewise
    information_of_pings : ndarray, shape (15,)
        At most; zero where they are not asked.
    """

    values: Floats
    prior_sd: Floats
    dives: tuple[Near, ...]
    information_of_pings: Floats

    @property
    def shared(self) -> Floats:
        """Changes of `SHARED`, shape (15,)."""
        return self.values[: len(SHARED)]

    @property
    def certainty(self) -> Certainty:
        """Three standard deviations of each of `SHARED`, as those of a calibration without reference."""
        count = len(SHARED)
        cov, considered = _solved(_total(self.prior_sd, [near.information for near in self.dives]), self.prior_sd)
        moved, _ = _solved(_total(self.prior_sd, [near.curvature for near in self.dives]), self.prior_sd)
        # What the prior says is one measurement of its own.
        correlated = considered + np.sum((moved / self.prior_sd) ** 2, axis=1)
        for i, near in enumerate(self.dives):
            correlated += [_variance_of_sum(parts) for parts in (near.scores @ moved[rows_of(i)]).T]
        # What all pings of a dive are off by is fitted away, and no residual shows it: their scatter says how much.
        told = self.information_of_pings > 0.0
        correlated[:count][told] += 1.0 / self.information_of_pings[told]
        correlated[CLOCK] += FINEST_CLOCK_S**2
        formal, correlated = (np.sqrt(of)[:count] for of in (np.diag(cov) + considered, correlated))
        if len(self.dives) < 2:
            unknown = np.full(count, np.nan)
            return Certainty(SHARED_SD, formal, correlated, unknown, unknown, np.zeros(count), np.zeros(count))
        own, own_sd = zip(*(self._alone(i, near) for i, near in enumerate(self.dives)), strict=True)
        apart, n = np.array(own) - np.mean(own, axis=0), len(own)
        birge = np.sqrt(np.sum((apart / np.array(own_sd)) ** 2, axis=0) / (n - 1))
        between = np.std(own, axis=0, ddof=1) / np.sqrt(n)
        return Certainty(SHARED_SD, formal, correlated, between, birge, np.zeros(count), np.zeros(count))

    def _alone(self, dive: int, near: Near) -> tuple[Floats, Floats]:
        """Return what one dive says by itself near the common answer, and its formal sds, shapes (15,)."""
        rows, count = rows_of(dive), len(SHARED)
        cov, considered = _solved(near.information + np.diag(self.prior_sd[rows] ** -2.0), self.prior_sd[rows])
        step = cov @ (near.scores.sum(axis=0) - self.values[rows] / self.prior_sd[rows] ** 2)
        return self.shared + step[:count], np.sqrt(np.diag(cov) + considered)[:count]


def rows_of(dive: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Where the numbers of a dive stand among all, shape (17,)."""
    count = len(SHARED)
    return np.concatenate([np.arange(count), count + OWN * dive + np.arange(OWN)])


def fit_reference(dives: Sequence[ReferenceDive], free: Mask, shared_sd: Floats) -> ReferenceFit:
    """Find the changes under which the baseline and the reference differ least.

    Parameters
    ----------
    dives : sequence of ReferenceDive
        At least one.
    free : ndarray of bool, shape (15,)
        What may change, of `SHARED`.
    shared_sd : ndarray, shape (15,)
        How sure each is before.
    """
    prior_sd = np.concatenate([shared_sd, np.full(OWN * len(dives), LOST_HEADING_SD)])
    values = np.zeros(len(prior_sd))
    near = tuple(_near(dive, values[rows_of(i)], free) for i, dive in enumerate(dives))
    for _ in track_progress("fitting the reference", range(ROUNDS)):
        gradient = -values / prior_sd**2
        for i, of_dive in enumerate(near):
            gradient[rows_of(i)] += of_dive.scores.sum(axis=0)
        cov, _ = _solved(_total(prior_sd, [of_dive.information for of_dive in near]), prior_sd)
        values = values + cov @ gradient
        values[CLOCK] = np.clip(values[CLOCK], -LATEST_CLOCK_S, LATEST_CLOCK_S)
        near = tuple(_near(dive, values[rows_of(i)], free) for i, dive in enumerate(dives))
    pings = np.sum([dive.information_of_pings for dive in dives], axis=0) * free
    return ReferenceFit(values, prior_sd, near, pings)


def _total(prior_sd: Floats, of_dives: Sequence[Floats]) -> Floats:
    """Add what each dive says, shapes (17, 17), to what the prior says."""
    total = np.diag(prior_sd**-2.0)
    for i, of_dive in enumerate(of_dives):
        rows = rows_of(i)
        total[np.ix_(rows, rows)] += of_dive
    return total


def _solved(information: Floats, prior_sd: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of what is estimated, and the variances that what is considered adds (Schmidt).

    Both are zero, and the prior's, for what is considered.
    """
    considered = np.flatnonzero(CONSIDERED)
    estimated = np.setdiff1d(np.arange(len(information)), considered)
    cov, added = np.zeros_like(information), np.zeros(len(information))
    own = np.linalg.inv(information[np.ix_(estimated, estimated)])
    cov[np.ix_(estimated, estimated)] = own
    moved = own @ information[np.ix_(estimated, considered)]
    added[estimated] = np.sum((moved * prior_sd[considered]) ** 2, axis=1)
    added[considered] = prior_sd[considered] ** 2
    return cov, added


def _variance_of_sum(parts: Floats) -> float:
    """Return the variance of a sum of parts that may be alike for a long time."""
    return float(np.sum(parts**2) * len(parts) / max(samples_in_mean(parts), 1.0))


def _near(dive: ReferenceDive, values: Floats, free: Mask) -> Near:
    """Linearise one dive; each axis of each kind of row is weighed by what it scatters by."""
    shared, own = values[: len(SHARED)], values[len(SHARED) :]
    compared = dive.compared(shared)
    jacobian = np.concatenate([dive.jacobian(shared, free), compared.own], axis=2)
    off = compared.values - compared.own @ own
    known = np.isfinite(off)
    scatter = np.ones_like(off)
    for family in np.unique(compared.family):
        rows = compared.family == family
        scatter[rows] = dive.level_sd if family == LEVEL else scatter_of(np.where(known[rows], off[rows], 0.0))
    jacobian = np.where(known[:, :, None], jacobian / scatter[:, :, None], 0.0)
    jacobian[:, :, len(SHARED) :] *= -1.0
    return Near(compared.time_s, np.where(known, off / scatter, 0.0), jacobian)
