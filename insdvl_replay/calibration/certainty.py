"""How sure a calibration is: three standard deviations side by side, and what may not be moved.

The formal one believes that innovations are white; the second allows for their correlation; the third is what the dives
differ by. The largest counts. Sources: Newey and West, "A simple, positive semi-definite, heteroskedasticity and
autocorrelation consistent covariance matrix", 1987; Birge, "The calculation of errors by the method of least squares",
1932; DerSimonian and Laird, "Meta-analysis in clinical trials", 1986, for the mean of what differs from dive to dive.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.calibration.considered import BEAM_ERRORS
from insdvl_replay.calibration.fit import SHARED, Fit, Linearised
from insdvl_replay.calibration.parameters import DELAY, NAMES
from insdvl_replay.core.dive_columns import Floats

FEWEST_DIVES: Final = 2
SEEN: Final = 3.0
"""Signal to noise from which something is moved: the prior's standard deviation over what is left of it."""


@dataclass(frozen=True)
class Certainty:
    """Standard deviations of p parameters, SI; the delay's is that of its mean over dives."""

    prior_sd: Floats  # shape (p,): how far papers may be off; of a mean over dives, less
    formal: Floats  # by the information
    correlated: Floats  # with the correlation of the innovations
    between: Floats  # by how the dives differ; NaN of fewer than `FEWEST_DIVES`
    birge: Floats  # how much more dives differ than they should: 1 is expected; NaN of one dive
    beams: Floats  # what single beams may be off by, see `considered`
    imu: Floats  # what is left of the errors of the IMU, likewise

    @property
    def sd(self) -> Floats:
        """The largest of the three, and what beams may be off by beside it, at most the prior's, shape (p,)."""
        return np.asarray(np.minimum(np.sqrt(self._largest**2 + self.beams**2 + self.imu**2), self.prior_sd))

    @property
    def _largest(self) -> Floats:
        return np.fmax(np.fmax(self.formal, self.correlated), self.between)

    @property
    def signal_to_noise(self) -> Floats:
        """The prior's sd over that of the data alone, shape (p,)."""
        return np.sqrt((self.prior_sd / self.sd) ** 2 - 1.0)

    @property
    def seen(self) -> Floats:
        """The same with perfect beams, shape (p,): whether the dives show it at all."""
        return np.sqrt((self.prior_sd / np.minimum(self._largest, self.prior_sd)) ** 2 - 1.0)


def certainty_of(fit: Fit, beside: Fit | None = None, pulled: Floats | None = None) -> Certainty:
    """Say how sure a fit is; `beside` and `pulled` are of `considered`, left out where beams and IMU are perfect."""
    mean_of, inner = _means(fit), beside or fit
    formal = np.sqrt(np.einsum("ij,jk,ik->i", mean_of, inner.cov, mean_of))
    moved = inner.moved_by_scores
    sandwich = moved @ _scores_cov(inner) @ moved.T
    correlated = np.sqrt(np.einsum("ij,jk,ik->i", mean_of, sandwich, mean_of))
    beams = imu = np.zeros(len(NAMES))
    if pulled is not None:
        pulled = mean_of @ np.column_stack([pulled, inner.step])
        beams, imu = (np.linalg.norm(part, axis=1) for part in np.split(pulled, [BEAM_ERRORS], axis=1))
    own, own_sd = one_by_one(fit)
    n = len(own)
    # Behind a mean of delays that are each dive's own stand as many priors.
    prior_sd = np.sqrt(mean_of**2 @ fit.unknowns.prior_sd**2)
    if n < FEWEST_DIVES:
        unknown = np.full(len(NAMES), np.nan)
        return Certainty(prior_sd, formal, correlated, unknown, unknown, beams, imu)
    weights = own_sd**-2.0
    weights[:, DELAY] = delay_weights(*own_delays(fit))
    between, birge = differing(own, own_sd, weights)
    return Certainty(prior_sd, formal, correlated, between, birge, beams, imu)


def differing(own: Floats, own_sd: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return by what dives differ: the standard deviation of their mean by it, and the Birge ratio, shapes (p,).

    A dive that lies still says nothing, and differs from nothing. Where all count alike, the first is their scatter
    over the root of how many they are.
    """
    total = weights.sum(axis=0)
    off = own - np.average(own, axis=0, weights=weights)
    pairs = np.sum(weights * (total - weights), axis=0)
    between = np.sqrt(np.sum((weights * off) ** 2, axis=0) / pairs)
    return between, np.sqrt(np.sum((off / own_sd) ** 2, axis=0) / (len(own) - 1))


def delay_weights(delays_s: Floats, sds_s: Floats) -> Floats:
    """Return what the delay of each dive counts in their mean: as it is sure, and as they differ beyond that.

    Clocks are set anew before a dive: the surest one is no better guess of the next than others are. Where none tells
    more than that, all count alike; one that lies still counts nothing.
    """
    weights = np.asarray(sds_s**-2.0)
    if len(weights) < FEWEST_DIVES:
        return weights
    total = weights.sum()
    chi_square = np.sum(weights * (delays_s - np.average(delays_s, weights=weights)) ** 2)
    beyond_chance = max(0.0, float(chi_square) - (len(weights) - 1))
    apart = total - np.sum(weights**2) / total
    return np.asarray(1.0 / (sds_s**2 + beyond_chance / apart))


def correlations(fit: Fit, at_least: float) -> list[tuple[str, str, float]]:
    """Name the parameters that can hardly be told from each other, with their correlation."""
    mean_of = _means(fit)
    cov = mean_of @ fit.cov @ mean_of.T
    sd = np.sqrt(np.diag(cov))
    correlation = cov / np.outer(sd, sd)
    return [
        (NAMES[i], NAMES[j], float(correlation[i, j]))
        for i, j in zip(*np.triu_indices(len(NAMES), 1), strict=True)
        if abs(correlation[i, j]) >= at_least
    ]


def mean_change(fit: Fit) -> Floats:
    """Return the change of each parameter, shape (8,); of the delay the mean over dives."""
    return np.asarray(_means(fit) @ fit.values)


def _means(fit: Fit) -> Floats:
    """Return what makes the eight of all unknowns, shape (8, count): the delay is the dives', by `delay_weights`."""
    unknowns = fit.unknowns
    rows = np.zeros((len(NAMES), unknowns.count))
    rows[SHARED, unknowns.rows(0)[SHARED]] = 1.0
    weights = delay_weights(*own_delays(fit))
    for dive, share in enumerate(weights / weights.sum()):
        rows[DELAY, unknowns.rows(dive)[DELAY]] += share
    return rows


def _scores_cov(fit: Fit) -> Floats:
    """Return the covariance of what all pings say together, with the correlation of neighbours."""
    # What the prior says is one measurement of its own.
    total = np.diag(fit.unknowns.prior_sd**-2.0)
    for i, near in enumerate(fit.dives):
        rows = fit.unknowns.rows(i)
        total[np.ix_(rows, rows)] += newey_west(near.scores)
    return total


def newey_west(scores: Floats) -> Floats:
    """Return the covariance of the sum of correlated rows, shape (k, n), with Bartlett's weights."""
    k = len(scores)
    lags = int(4.0 * (k / 100.0) ** (2.0 / 9.0)) + 5
    centred = scores - scores.mean(axis=0)
    total = centred.T @ centred
    for lag in range(1, min(lags, k - 1) + 1):
        product = centred[lag:].T @ centred[:-lag]
        total = total + (1.0 - lag / (lags + 1.0)) * (product + product.T)
    return np.asarray(total)


def one_by_one(fit: Fit) -> tuple[Floats, Floats]:
    """Return what each dive says by itself near the common answer, and its formal sds, shapes (n, 8)."""
    own, own_sd = [], []
    for i, near in enumerate(fit.dives):
        alone = Fit(replace(fit.unknowns, dives=1), fit.of_dive(i)[[*SHARED, DELAY]], (near,))
        own.append(alone.unknowns.of_dive(alone.values + alone.step, 0))
        own_sd.append(alone.unknowns.of_dive(np.sqrt(np.diag(alone.cov)), 0))
    return np.array(own), np.array(own_sd)


def autocorrelation(near: Linearised) -> Floats:
    """Return the correlation of neighbouring residuals of each axis, far ones weighed down, shape (3,)."""
    soft = near.scaled * near.weights
    centred = soft - soft.mean(axis=0)
    return np.asarray(np.sum(centred[1:] * centred[:-1], axis=0) / np.sum(centred**2, axis=0))


def own_delays(fit: Fit) -> tuple[Floats, Floats]:
    """Return the delay of each dive and its formal sd, s, shapes (n,)."""
    rows = [int(fit.unknowns.rows(i)[DELAY]) for i in range(fit.unknowns.dives)]
    return fit.values[rows], np.sqrt(np.diag(fit.cov))[rows]
