"""Solutions of the user's filters: checked, and interpolated as those of the vehicle.

A mistake in the user's code is a `CandidateError`. Its candidate is then not evaluated, and all others go on.
"""

from dataclasses import replace
from functools import reduce
from itertools import pairwise
from typing import Any, Final

import numpy as np

from insdvl_replay.core.config import Solution as SolutionSettings
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    ReferenceColumns,
    SolutionColumns,
    TimeNs,
    nothing,
    seconds,
)
from insdvl_replay.core.errors import Note
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.reference_errors import WELL_COVERED
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.user_candidate import CandidateError, Solution
from insdvl_replay.preparation.solution_files import MOST_COVARIANCES, MOTION
from insdvl_replay.preparation.solutions import recorded_history

COMPARED_S: Final = 10.0  # over which turns are compared with those of the baseline
# A solution that differs more from the baseline is of another dive: no filter turns otherwise than its gyros.
FARTHEST_START_M = 100.0
LARGEST_TURN_DEG = 5.0
LARGEST_SPEED = 0.5


def history_of_candidate(
    name: str,
    solution: Solution,
    start: Start,
    start_ns: int,
    imu: ImuColumns,
    velocities: DvlVelocities,
    baseline: History,  # of the same dive
    evaluated_ns: TimeNs,  # (c,), times at which errors are judged by P
) -> tuple[History, tuple[Note, ...]]:
    """Interpolate a solution at the times of the baseline.

    It holds the start where its own first row is later. A `CandidateError` says what is wrong with it.
    """
    key = f"filters.{name}"
    columns = _columns(solution, start, start_ns, int(baseline.time_ns[-1]))
    history, _, notes = recorded_history(
        name, columns, SolutionSettings(), imu, baseline, evaluated_ns, key
    )
    _require_this_dive(history, baseline, imu, solution.time_ns[0])
    met = _innovations(solution, velocities)
    return replace(history, has_own_start=False, innovations=() if met is None else (met,)), notes


def failed_history(name: str, reason: str, baseline: History, imu: ImuColumns) -> History:
    """Return the history of a candidate that gave no trajectory."""
    empty = ReferenceColumns(
        np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3))
    )
    columns = SolutionColumns(empty, None, empty.time_ns, np.empty((0, 9, 9)))
    history, *_ = recorded_history(name, columns, SolutionSettings(), imu, baseline, empty.time_ns)
    return replace(history, failure=f"{name} {reason}")


def _columns(solution: Solution, start: Start, start_ns: int, end_ns: int) -> SolutionColumns:
    """Return a solution that begins at the start, and holds covariances at evenly chosen times."""
    time_ns = solution.time_ns
    inside = (time_ns >= start_ns) & (time_ns <= end_ns)
    if not inside.any():
        first_s, last_s = ((int(at) - start_ns) / NS_PER_S for at in (time_ns[0], time_ns[-1]))
        raise CandidateError(
            f"gives a solution of wrong times: {first_s:.6g} to {last_s:.6g} s after the start, and the dive has 0 to "
            f"{(end_ns - start_ns) / NS_PER_S:.6g} s"
        )
    is_later = int(time_ns[0]) > start_ns
    given = {"position": start.position, "velocity_n": start.velocity_n, "mat_nb": start.mat_nb}
    columns = dict[str, Any]()
    for name, value in given.items():
        own = getattr(solution, name)
        if own is None:
            columns[name] = nothing((len(time_ns) + is_later, *value.shape))
        else:
            columns[name] = np.concatenate([value[None], own]) if is_later else own
    motion_ns = np.concatenate([[start_ns], time_ns]) if is_later else time_ns
    cov = np.empty((0, 9, 9))
    cov_ns = time_ns[:0]
    if solution.cov is not None:
        cov_ns = time_ns if solution.cov_ns is None else solution.cov_ns
        every = 1 + len(cov_ns) // MOST_COVARIANCES
        cov = solution.cov[::every]
        cov_ns = cov_ns[::every]
    return SolutionColumns(ReferenceColumns(motion_ns, **columns), None, cov_ns, cov)


def _require_this_dive(history: History, baseline: History, imu: ImuColumns, first_ns: int) -> None:
    """Require that a solution covers the replay, begins where the baseline is, and turns and moves as that does.

    Before its own first row it has the start. Where the baseline turns otherwise than the gyros, these decide.
    """
    columns = {"position": history.position[:, 0], "velocity_n": history.velocity_n[:, 0]}
    columns["mat_nb"] = history.mat_nb[:, 0, 0]
    known = {
        name: np.isfinite(column) for name, column in columns.items() if np.isfinite(column).any()
    }
    reason = ""
    if not known:
        raise CandidateError("gives a solution without a row in the time of the replay")
    for name, rows in known.items():
        if (share := float(rows.mean())) < WELL_COVERED:
            last_s, end_s = (
                seconds(history.time_ns[at], history.time_ns[0])
                for at in (np.flatnonzero(rows)[-1], -1)
            )
            raise CandidateError(
                f"gives {MOTION[name]} for only {100.0 * share:.0f} % of the replay, the last at {last_s:.1f} of "
                f"{end_s:.1f} s"
            )
    if "position" in known:
        row = int(np.argmax(known["position"] & (history.time_ns >= first_ns)))
        apart_m = float(
            np.hypot(
                *north_east_m(history.position[row], baseline.position[row], baseline.position[row])
            )
        )
        if apart_m > FARTHEST_START_M:
            reason = f"it begins {apart_m:.3g} m from the start"
    if "velocity_n" in known:
        rows = known["velocity_n"] & np.isfinite(baseline.velocity_n).all(axis=1)
        own, other = (np.linalg.norm(run.velocity_n[rows], axis=1) for run in (history, baseline))
        off_mps, usual_mps = (float(np.sqrt(np.mean(speed**2))) for speed in (own - other, other))
        if off_mps > LARGEST_SPEED * (usual_mps + 1.0):
            reason = f"its speed differs from the baseline's by {off_mps:.2g} m/s (rms)"
    if "mat_nb" in known:
        rows = np.flatnonzero(known["mat_nb"] & np.isfinite(baseline.mat_nb).all(axis=(1, 2)))
        since_s = seconds(history.time_ns[rows], history.time_ns[0])
        rows = rows[np.unique(np.searchsorted(since_s, np.arange(0.0, since_s[-1], COMPARED_S)))]
        own, other = (
            np.swapaxes(run.mat_nb[rows[:-1]], 1, 2) @ run.mat_nb[rows[1:]]
            for run in (history, baseline)
        )
        if _apart_deg(own, other) > LARGEST_TURN_DEG:
            rate_b = 0.5 * (imu.angular_rate_b[1:] + imu.angular_rate_b[:-1])
            steps = mat_from_vector(rate_b * seconds(imu.time_ns[1:], imu.time_ns[:-1])[:, None])
            samples = pairwise(np.searchsorted(imu.time_ns, history.time_ns[rows]))
            by_gyros = np.array(
                [reduce(np.matmul, steps[first:last], np.eye(3)) for first, last in samples]
            )
            if (rms_deg := _apart_deg(own, by_gyros)) > LARGEST_TURN_DEG:
                reason = f"its turns in {COMPARED_S:g} s differ from the gyros' by {rms_deg:.2g} deg (rms)"
    if reason:
        raise CandidateError(f"gives a solution that is not of this dive: {reason}")


def _apart_deg(own: Floats, other: Floats) -> float:
    """Return the rms angle between turns, shape (k, 3, 3); 0 of none."""
    off_deg = np.linalg.norm(vector_from_mat(np.swapaxes(other, 1, 2) @ own), axis=1) / DEG
    if len(off_deg):
        return float(np.sqrt(np.mean(off_deg**2)))
    return 0.0


def _innovations(solution: Solution, velocities: DvlVelocities) -> Innovations | None:
    """Return the innovations of the DVL's velocity, in the axes of the IMU."""
    if solution.innovation_b is None or solution.innovation_cov is None:
        return None
    known = np.isfinite(solution.innovation_b).all(axis=1) & np.isfinite(
        solution.innovation_cov
    ).all(axis=(1, 2))
    time_ns, own, pings = np.intersect1d(
        solution.time_ns[known], velocities.time_ns, return_indices=True
    )
    innovation = solution.innovation_b[known][own]
    cov = solution.innovation_cov[known][own]
    sign, log_det = np.linalg.slogdet(cov)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    if not len(time_ns) or np.any(sign <= 0.0) or np.any(variance <= 0.0):
        lacks = (
            "at no time of a ping"
            if not len(time_ns)
            else "with a covariance that is not positive definite"
        )
        raise CandidateError(f"gives innovations {lacks}")
    solved = np.linalg.solve(cov, innovation[..., None])[..., 0]
    count = len(time_ns)
    return Innovations(
        measurement="velocity",
        unit="m/s",
        axes=("x", "y", "z"),
        time_ns=time_ns,
        valid_ns=time_ns,
        measured=velocities.velocity_b[pings],
        innovation=innovation,
        sd=np.sqrt(variance),
        nis=np.sum(innovation * solved, axis=1),
        used=np.ones(count, np.bool_),
        log_det=log_det,
        gate=np.inf,
        reopen_after=0,
        reopened=np.zeros(count, np.bool_),
    )
