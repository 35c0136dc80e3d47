"""Error against the reference, at the reference's own times."""

from dataclasses import dataclass, replace

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import REFERENCE_QUANTITIES
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import ReferenceErrorRow
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.evaluation.believed import improvement_pct
from insdvl_replay.evaluation.coverage import WELL_COVERED, covered_share
from insdvl_replay.evaluation.travelled import compared_distance_m
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat

DEAD_RECKONED = ("position_h", "depth", "position_h_pct")
"""Quantities that keep what went wrong in a gap of the IMU: nothing brings position and its heading back."""
SHORTEST_M = 10.0
"""Over a shorter way, percent of distance says nothing: at rest a filter's noise alone travels some metres."""


@dataclass(frozen=True)
class ReferenceErrors:
    """Estimated minus reference, at the reference's times after the start. NaN where the reference lacks a quantity.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Reference times inside the replay.
    position_error_ned_m : ndarray, shape (k, 3)
        North, east, down, m.
    velocity_error_n : ndarray, shape (k, 3)
        m/s
    attitude_error_rad : ndarray, shape (k, 3)
        Roll, pitch, heading: the error rotation about the vehicle's level forward, level starboard and down axes, rad.
    distance_m : float
        Horizontal distance travelled from the start to the last compared position, see
        `travelled.compared_distance_m`.
    dead_reckoned_error_ned_m : ndarray, shape (k, 3), or None
        As ``position_error_ned_m``, with all corrections of the position taken back; None where there are none.
    """

    time_ns: TimeNs
    position_error_ned_m: Floats
    velocity_error_n: Floats
    attitude_error_rad: Floats
    distance_m: float
    dead_reckoned_error_ned_m: Floats | None = None

    @property
    def drifting_ned_m(self) -> Floats:
        """The position error that only the velocity changes: a correction of the position is no drift."""
        dead_reckoned = self.dead_reckoned_error_ned_m
        return self.position_error_ned_m if dead_reckoned is None else dead_reckoned

    def where_known(self, other: "ReferenceErrors") -> "ReferenceErrors":
        """Keep what another filter's errors have a number for at the same times, too; else NaN, as far as both go."""
        return replace(
            self,
            position_error_ned_m=np.where(np.isfinite(other.position_error_ned_m), self.position_error_ned_m, np.nan),
            velocity_error_n=np.where(np.isfinite(other.velocity_error_n), self.velocity_error_n, np.nan),
            attitude_error_rad=np.where(np.isfinite(other.attitude_error_rad), self.attitude_error_rad, np.nan),
            distance_m=min(self.distance_m, other.distance_m),
            dead_reckoned_error_ned_m=np.where(np.isfinite(other.position_error_ned_m), self.drifting_ned_m, np.nan),
        )


def reference_errors(history: History, reference: ReferenceColumns, baseline: History | None = None) -> ReferenceErrors:
    """Compare a history with the reference where the history was recorded at the reference's times.

    Parameters
    ----------
    history : History
        Recorded at every reference time inside the replay.
    baseline : History, optional
        By whose velocity the distance is where the reference does not tell it, if not by the history's own.

    Returns
    -------
    ReferenceErrors
        Without the start, where the filter was set to the reference.
    """
    time_ns, ours, theirs = np.intersect1d(history.time_ns[1:], reference.time_ns, return_indices=True)
    ours += 1
    position, truth = history.position[ours], reference.position[theirs]
    error_ned_m = north_east_down_m(position, truth)
    return ReferenceErrors(
        time_ns,
        error_ned_m,
        history.velocity_n[ours] - reference.velocity_n[theirs],
        attitude_error(history.mat_nb[ours], reference.mat_nb[theirs]),
        compared_distance_m(reference, baseline or history, time_ns[np.isfinite(error_ned_m[:, :2]).all(axis=1)]),
        north_east_down_m(history.dead_reckoned[ours], truth) if len(history.corrected) else None,
    )


def attitude_error(mat_nb: Floats, mat_nb_reference: Floats) -> Floats:
    """Return the error rotation as roll, pitch and heading error.

    The rotation vector of ``C_hat C'``, which lies in n, is turned by the reference's heading to the vehicle's level
    axes. Differences of Euler angles would blow up near the vertical; these do not, and on a level vehicle they are the
    same.

    Parameters
    ----------
    mat_nb, mat_nb_reference : ndarray, shape (k, 3, 3)

    Returns
    -------
    ndarray, shape (k, 3), rad
    """
    known = np.isfinite(mat_nb_reference).all(axis=(1, 2))
    error = np.full((len(mat_nb), 3), np.nan)
    vector_n = vector_from_mat(mat_nb[known] @ np.swapaxes(mat_nb_reference[known], 1, 2))
    heading = rpy_from_mat(mat_nb_reference[known])[:, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    error[known, 0] = cos * vector_n[:, 0] + sin * vector_n[:, 1]
    error[known, 1] = -sin * vector_n[:, 0] + cos * vector_n[:, 1]
    error[known, 2] = vector_n[:, 2]
    return error


def reference_error_table(
    log: str, histories: tuple[History, ...], errors: dict[str, ReferenceErrors], *, bridged_gaps: bool = False
) -> list[ReferenceErrorRow]:
    """Set the candidates' error against the reference beside the baseline's.

    Parameters
    ----------
    log : str
        Name of the dive.
    histories : tuple of History
        The first is the baseline.
    errors : dict of str to ReferenceErrors
        By filter name; empty where the dive has no reference.
    bridged_gaps : bool
        Whether the filters went through long gaps of the IMU.

    Returns
    -------
    list of ReferenceErrorRow
        9 for each candidate; final errors keep their sign. Where the status is ``partly covered``, since the reference
        has the quantity for less than `coverage.WELL_COVERED` of the replay, or ``lost in gap``, the numbers stand, but
        say nothing of the filters. Beside a solution that was read, the baseline's numbers are of the same instants.
    """
    baseline, *candidates = histories
    span_ns = int(baseline.time_ns[0]), int(baseline.time_ns[-1])
    summaries = {name: _summary(error, span_ns) for name, error in errors.items()}
    rows, nan = [], float("nan")
    for history in candidates:
        candidate = history.filter
        beside = summaries.get(baseline.filter, {})
        if history.is_read and errors:
            beside = _summary(errors[baseline.filter].where_known(errors[candidate]), span_ns)
        for quantity, unit in REFERENCE_QUANTITIES.items():
            named = log, candidate, quantity, unit
            if not errors:
                rows.append(ReferenceErrorRow(*named, nan, nan, nan, nan, nan, 0, ReferenceStatus.NO_REFERENCE))
                continue
            before_rmse, before_final, samples, covered = beside[quantity]
            rmse, final, *_ = summaries[candidate][quantity]
            status = _status(quantity, samples, covered, errors[candidate], bridged_gaps)
            if not samples and summaries[baseline.filter][quantity][2]:
                status = ReferenceStatus.NOT_IN_SOLUTION
            numbers = before_rmse, rmse, improvement_pct(before_rmse, rmse), before_final, final
            rows.append(ReferenceErrorRow(*named, *numbers, samples, status))
    return rows


def _status(
    quantity: str, samples: int, covered: float, errors: ReferenceErrors, bridged_gaps: bool
) -> ReferenceStatus:
    if samples and bridged_gaps and quantity in DEAD_RECKONED:
        return ReferenceStatus.LOST_IN_GAP
    if samples:
        return ReferenceStatus.COMPARED if covered >= WELL_COVERED else ReferenceStatus.PARTLY_COVERED
    known = np.isfinite(errors.position_error_ned_m[:, :2]).all(axis=1).any()
    return ReferenceStatus.NO_DISTANCE if quantity == "position_h_pct" and known else ReferenceStatus.NOT_IN_REFERENCE


def _summary(errors: ReferenceErrors, span_ns: tuple[int, int]) -> dict[str, tuple[float, float, int, float]]:
    """Return rms, final error, number of samples and share of the replay of each quantity, in its shown unit."""
    horizontal_m = np.hypot(errors.position_error_ned_m[:, 0], errors.position_error_ned_m[:, 1])
    per_cent = 100.0 / errors.distance_m if errors.distance_m >= SHORTEST_M else float("nan")
    columns = [
        *errors.velocity_error_n.T,
        *(errors.attitude_error_rad.T / DEG),
        horizontal_m,
        errors.position_error_ned_m[:, 2],
        horizontal_m * per_cent,
    ]
    return {
        quantity: (*_rms_final_samples(column), covered_share(errors.time_ns, np.isfinite(column), *span_ns))
        for quantity, column in zip(REFERENCE_QUANTITIES, columns, strict=True)
    }


def _rms_final_samples(error: Floats) -> tuple[float, float, int]:
    known = error[np.isfinite(error)]
    if not len(known):
        return float("nan"), float("nan"), 0
    return float(np.sqrt(np.mean(known**2))), float(known[-1]), len(known)
