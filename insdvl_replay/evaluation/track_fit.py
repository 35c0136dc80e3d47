"""The scale and the turn that would lay a filter's track on the reference's: how a DVL's scale and mounting show.

Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991, which in the
plane is a linear regression between complex numbers.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, nanoseconds
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.effective_samples import samples_in_mean
from insdvl_replay.evaluation.reference import SHORTEST_M, ReferenceErrors
from insdvl_replay.geometry.frames import north_east_m

AVERAGED_S: Final = 20.0
"""Residuals are averaged over so long, which leaves their slow part: what dead reckoning loses, not a fix's noise."""
FEWEST_AVERAGES: Final = 6
"""From fewer there is no standard error."""

Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class TrackFit:
    """What would lay the filter's track on the reference's, with standard errors; NaN where it cannot be told.

    Attributes
    ----------
    scale_pct, scale_sd_pct : float
        The factor less one: positive where the filter's track is too small.
    turn_deg, turn_sd_deg : float
        Clockwise seen from above, as a heading.
    """

    scale_pct: float
    scale_sd_pct: float
    turn_deg: float
    turn_sd_deg: float


UNKNOWN: Final = TrackFit(float("nan"), float("nan"), float("nan"), float("nan"))


def filter_track_fit(errors: ReferenceErrors, reference: ReferenceColumns) -> TrackFit:
    """Fit a filter's track to the reference's at the times where they are compared."""
    position = reference.position[np.searchsorted(reference.time_ns, errors.time_ns)]
    known = np.isfinite(position[:, :2]).all(axis=1) & np.isfinite(errors.position_error_ned_m[:, :2]).all(axis=1)
    if not known.any():
        return UNKNOWN
    origin = position[known][0]
    track_m = np.stack(north_east_m(position[known], origin, origin), axis=1)
    return track_fit(errors.time_ns[known], track_m + errors.position_error_ned_m[known, :2], track_m)


def track_fit(time_ns: TimeNs, estimated_m: Floats, reference_m: Floats) -> TrackFit:
    """Find scale, turn and shift, in closed form, that lay one track on another.

    Residuals of dead reckoning wander, so that their own sum says nothing of the certainty. The standard errors come
    from their changes between averages, which are nearly independent: each change moves all that follows it, with the
    weight that the points behind it have in the fit. Noise of the reference makes them too large rather than too small.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        In order.
    estimated_m, reference_m : ndarray, shape (k, 2)
        North, east, m.

    Returns
    -------
    TrackFit
        Unknown where the reference's track is not `SHORTEST_M` across.
    """
    if len(time_ns) < 2 or np.hypot(*np.ptp(reference_m, axis=0)) < SHORTEST_M:
        return UNKNOWN
    estimated, reference = (np.asarray(track @ [1.0, 1.0j]) for track in (estimated_m, reference_m))
    estimated, reference = estimated - estimated.mean(), reference - reference.mean()
    squares = float(np.sum(np.abs(estimated) ** 2))
    if squares == 0.0:
        return UNKNOWN
    similarity = complex(np.vdot(estimated, reference) / squares)
    if similarity == 0.0:
        return UNKNOWN
    weights = estimated.conj() / (squares * similarity)
    parts = _influence_of_changes(time_ns, weights, reference - similarity * estimated)
    scale_sd, turn_sd = _standard_error(parts.real), _standard_error(parts.imag)
    scale_pct, turn_deg = 100.0 * (abs(similarity) - 1.0), float(np.angle(similarity)) / DEG
    return TrackFit(scale_pct, 100.0 * scale_sd, turn_deg, turn_sd / DEG)


def _influence_of_changes(time_ns: TimeNs, weights: Complexes, residuals: Complexes) -> Complexes:
    """Return what each change between averaged residuals adds to the relative error of the similarity."""
    _, first = np.unique((time_ns - time_ns[0]) // nanoseconds(AVERAGED_S), return_index=True)
    averages = np.add.reduceat(residuals, first) / np.diff(first, append=len(time_ns))
    behind: Complexes = np.cumsum(np.add.reduceat(weights, first)[::-1])[::-1]
    parts: Complexes = behind[1:] * np.diff(averages)
    return parts


def _standard_error(parts: Floats) -> float:
    """Return the standard error of a sum of parts that may be correlated with their neighbours."""
    n = len(parts)
    if n < FEWEST_AVERAGES:
        return float("nan")
    return float(np.sqrt(np.sum(parts**2) * n / samples_in_mean(parts)))
