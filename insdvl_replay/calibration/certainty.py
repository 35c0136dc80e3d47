"""How sure a calibration is: three standard deviations side by side, and what may not be moved.

The formal one believes that innovations are white; the second allows for their correlation; the third is what the dives
differ by. The largest counts. Sources: Newey and West, "A simple, positive semi-definite, heteroskedasticity and
autocorrelation consistent covariance matrix", 1987; Birge, "The calculation of errors by the method of least squares",
1932.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.calibration.fit import SHARED, Fit, Linearised
from insdvl_replay.calibration.parameters import DELAY, NAMES, PRIOR_SD
from insdvl_replay.core.dive_columns import Floats

FEWEST_DIVES: Final = 2
SEEN: Final = 3.0
"""Signal to noise from which something is moved: the prior's standard deviation over what is left of it."""


@dataclass(frozen=True)
class Certainty:
    """Standard deviations of p parameters, SI; the delay's is that of its mean over dives.

    Attributes
    ----------
    prior_sd : ndarray, shape (p,)
        How far papers may be off.
    formal, correlated, between : ndarray, shape (p,)
        By the information, by the correlation of the innovations, and by how the dives differ; the last is NaN of fewer
        than `FEWEST_DIVES`.
    beams : ndarray, shape (p,)
        What single beams may be off by, see `beam_errors`.
    birge : ndarray, shape (p,)
        How much more dives differ than they should: 1 is expected; NaN of one dive.
    """

    prior_sd: Floats
    formal: Floats
    correlated: Floats
    between: Floats
    birge: Floats
    beams: Floats

    @property
    def sd(self) -> Floats:
        """The largest of the three, and what beams may be off by beside it, at most the prior's, shape (p,)."""
        return np.asarray(np.minimum(np.hypot(self._largest, self.beams), self.prior_sd))

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


def certainty_of(fit: Fit, pulled: Floats | None = None) -> Certainty:
    """Say how sure a fit is.

    Parameters
    ----------
    pulled : ndarray, shape (count, m), optional
        By `beam_errors.pulled_by_beams`; left out, beams are taken to be perfect but for their white noise.
    """
    cov, mean_of = fit.cov, _means(fit)
    formal = np.sqrt(np.einsum("ij,jk,ik->i", mean_of, cov, mean_of))
    moved = fit.moved_by_scores
    sandwich = moved @ _scores_cov(fit) @ moved.T
    correlated = np.sqrt(np.einsum("ij,jk,ik->i", mean_of, sandwich, mean_of))
    beams = np.zeros(len(NAMES)) if pulled is None else np.linalg.norm(mean_of @ pulled, axis=1)
    own, own_sd = one_by_one(fit)
    n = len(own)
    if n < FEWEST_DIVES:
        unknown = np.full(len(NAMES), np.nan)
        return Certainty(PRIOR_SD, formal, correlated, unknown, unknown, beams)
    off = own - np.average(own, axis=0)
    birge = np.sqrt(np.sum((off / own_sd) ** 2, axis=0) / (n - 1))
    return Certainty(PRIOR_SD, formal, correlated, own.std(axis=0, ddof=1) / np.sqrt(n), birge, beams)


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
    """Return what makes the eight of all unknowns, shape (8, count): the delay is the mean of the dives'."""
    unknowns = fit.unknowns
    rows = np.zeros((len(NAMES), unknowns.count))
    for dive in range(unknowns.dives):
        rows[np.arange(len(NAMES)), unknowns.rows(dive)] += 1.0 / unknowns.dives
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
