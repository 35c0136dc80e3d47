"""The heading and the gyro's bias at the start under which a filter's track lies on that of a reference.

Least squares of the tracks, with their shift and scale, which is the DVL's, fitted beside them. Standard errors are
those of `track_fit`: by the changes between averaged residuals.
"""

from dataclasses import dataclass

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs, nanoseconds
from insdvl_replay.evaluation.effective_samples import samples_in_mean
from insdvl_replay.evaluation.reference import SHORTEST_M
from insdvl_replay.evaluation.track_fit import AVERAGED_S, FEWEST_AVERAGES

HEADING, BIAS = 0, 1


@dataclass(frozen=True)
class HeadingFit:
    """How a start has to change.

    Attributes
    ----------
    heading, heading_sd : float
        rad
    bias, bias_sd : float
        Of the gyro about down, rad/s.
    """

    heading: float
    heading_sd: float
    bias: float
    bias_sd: float


def heading_fit(
    time_ns: TimeNs,
    estimated_m: Floats,
    per_heading_m: Floats,
    per_bias_m: Floats,
    reference_m: Floats,
    known_bias: tuple[float, float],
) -> HeadingFit | None:
    """Fit shift, scale, heading and bias of one track to another.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        In order.
    estimated_m, reference_m : ndarray, shape (k, 2)
        North, east, m.
    per_heading_m, per_bias_m : ndarray, shape (k, 2)
        Derivatives of the estimated track by both, m/rad and m/(rad/s).
    known_bias : tuple of float
        By how much the bias of the track is above what was known of it, and how sure that was, rad/s.

    Returns
    -------
    HeadingFit or None
        None where the reference's track is not `SHORTEST_M` across, or too short to say how sure it is.
    """
    if len(time_ns) < 2 or np.hypot(*np.ptp(reference_m, axis=0)) < SHORTEST_M:
        return None
    columns = np.stack([per_heading_m, per_bias_m, estimated_m], axis=2)
    columns, off_m = columns - columns.mean(axis=0), reference_m - estimated_m
    off_m = off_m - off_m.mean(axis=0)
    weights = np.linalg.pinv(columns.reshape(-1, 3)).reshape(3, -1, 2)
    found = np.einsum("ika,ka->i", weights, off_m)
    cov = _covariance(time_ns, weights, off_m - columns @ found)
    return None if cov is None else _with_prior(found, cov, *known_bias)


def _covariance(time_ns: TimeNs, weights: Floats, residuals_m: Floats) -> Floats | None:
    """Return the covariance of what is fitted: each change moves all behind it, with the weight that this has."""
    _, first = np.unique((time_ns - time_ns[0]) // nanoseconds(AVERAGED_S), return_index=True)
    if len(first) <= FEWEST_AVERAGES:
        return None
    averages = np.add.reduceat(residuals_m, first) / np.diff(first, append=len(time_ns))[:, None]
    behind = np.cumsum(np.add.reduceat(weights, first, axis=1)[:, ::-1], axis=1)[:, ::-1]
    parts = np.einsum("ika,ka->ik", behind[:, 1:], np.diff(averages, axis=0))
    alike = np.sqrt([len(part) / max(samples_in_mean(part), 1.0) for part in parts])
    return np.asarray(parts @ parts.T * np.outer(alike, alike))


def _with_prior(found: Floats, cov: Floats, off: float, sd: float) -> HeadingFit:
    """Take what was known of the bias as one measurement more, which the heading follows as the track couples them."""
    variance = float(cov[BIAS, BIAS]) + sd**2
    gain = cov[: BIAS + 1, BIAS] / variance
    heading, bias = found[: BIAS + 1] - gain * (off + found[BIAS])
    left = np.diag(cov)[: BIAS + 1] - gain**2 * variance
    return HeadingFit(float(heading), float(np.sqrt(left[HEADING])), float(bias), float(np.sqrt(left[BIAS])))
