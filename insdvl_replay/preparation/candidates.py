"""Solutions of the user's filters: checked, and interpolated as those of the vehicle.

A mistake in the user's code is a `CandidateError`. Its candidate is then not evaluated, and all others go on.
"""

from dataclasses import replace
from functools import reduce
from itertools import pairwise
from typing import Final

import numpy as np

from insdvl_replay.core.config import Solution as SolutionSettings
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    Mask,
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
from insdvl_replay.preparation.solution_check import MOTION
from insdvl_replay.preparation.solution_files import MOST_COVARIANCES
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
    innovations: tuple[Innovations, ...] = ()
    if solution.innovation_b is not None and solution.innovation_cov is not None:
        met = _innovations(
            solution.time_ns, solution.innovation_b, solution.innovation_cov, velocities
        )
        innovations = (met,)
    return replace(history, has_own_start=False, innovations=innovations), notes


def failed_history(
    name: str,
    reason: str,
    baseline: History,
    imu: ImuColumns,
) -> History:
    """Return the history of a candidate that gave no trajectory."""
    empty = ReferenceColumns(
        np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3))
    )
    columns = SolutionColumns(empty, None, empty.time_ns, np.empty((0, 9, 9)))
    history, *_ = recorded_history(name, columns, SolutionSettings(), imu, baseline, empty.time_ns)
    return replace(history, failure=f"{name} {reason}")


def _columns(
    solution: Solution,
    start: Start,
    start_ns: int,
    end_ns: int,
) -> SolutionColumns:
    """Return a solution that begins at the start, and holds covariances at evenly chosen times."""
    time_ns = solution.time_ns
    inside = (time_ns >= start_ns) & (time_ns <= end_ns)
    if not inside.any():
        first_s = (int(time_ns[0]) - start_ns) / NS_PER_S
        last_s = (int(time_ns[-1]) - start_ns) / NS_PER_S
        raise CandidateError(
            f"gives a solution of wrong times: {first_s:.6g} to {last_s:.6g} s after the start, and the dive has 0 to "
            f"{(end_ns - start_ns) / NS_PER_S:.6g} s"
        )
    is_later = int(time_ns[0]) > start_ns
    motion_ns = time_ns
    if is_later:
        motion_ns = np.concatenate([[start_ns], time_ns])
    rows = len(time_ns)
    motion = ReferenceColumns(
        time_ns=motion_ns,
        position=_from_start(solution.position, start.position, rows, is_later=is_later),
        velocity_n=_from_start(solution.velocity_n, start.velocity_n, rows, is_later=is_later),
        mat_nb=_from_start(solution.mat_nb, start.mat_nb, rows, is_later=is_later),
    )
    cov = np.empty((0, 9, 9))
    cov_ns = time_ns[:0]
    if solution.cov is not None:
        cov_ns = time_ns if solution.cov_ns is None else solution.cov_ns
        every = 1 + len(cov_ns) // MOST_COVARIANCES
        cov = solution.cov[::every]
        cov_ns = cov_ns[::every]
    return SolutionColumns(motion, None, cov_ns, cov)


def _from_start(
    own: Floats | None,
    start: Floats,
    rows: int,
    *,
    is_later: bool,
) -> Floats:
    """Return a column of a solution, NaN where it is not given; one that is later begins with the start."""
    if own is None:
        return nothing((rows + is_later, *start.shape))
    if is_later:
        return np.concatenate([start[None], own])
    return own


def _require_this_dive(
    history: History,
    baseline: History,
    imu: ImuColumns,
    first_ns: int,
) -> None:
    """Require that a solution covers the replay, begins where the baseline is, and turns and moves as that does.

    Before its own first row it has the start. Where the baseline turns otherwise than the gyros, these decide.
    """
    columns = {
        "position": history.position[:, 0],
        "velocity_n": history.velocity_n[:, 0],
        "mat_nb": history.mat_nb[:, 0, 0],
    }
    known = {name: np.isfinite(column) for name, column in columns.items()}
    given = {name: rows for name, rows in known.items() if rows.any()}
    if not given:
        raise CandidateError("gives a solution without a row in the time of the replay")
    for name, rows in given.items():
        _require_covered(MOTION[name], history.time_ns, rows)
    reason = ""
    if "mat_nb" in given:
        reason = _other_turns(history, baseline, imu, given["mat_nb"])
    if "velocity_n" in given and not reason:
        reason = _other_speed(history, baseline, given["velocity_n"])
    if "position" in given and not reason:
        reason = _other_place(history, baseline, given["position"], first_ns)
    if reason:
        raise CandidateError(f"gives a solution that is not of this dive: {reason}")


def _require_covered(what: str, time_ns: TimeNs, known: Mask) -> None:
    """Require that a quantity is known in most rows of the replay."""
    share = float(known.mean())
    if share >= WELL_COVERED:
        return
    since_s = seconds(time_ns, time_ns[0])
    raise CandidateError(
        f"gives {what} for only {100.0 * share:.0f} % of the replay, the last at "
        f"{since_s[known][-1]:.1f} of {since_s[-1]:.1f} s"
    )


def _other_place(
    history: History,
    baseline: History,
    known: Mask,
    first_ns: int,
) -> str:
    """Say that a solution begins far from where the baseline is; empty if it does not."""
    row = int(np.argmax(known & (history.time_ns >= first_ns)))
    place = baseline.position[row]
    apart_m = float(np.hypot(*north_east_m(history.position[row], place, place)))
    latitude = float(history.position[row, 0])
    if abs(latitude) > 0.5 * np.pi:
        return f"its latitude is {latitude:.3g} rad, so its angles may be degrees"
    if apart_m > FARTHEST_START_M:
        return f"it begins {apart_m:.3g} m from the start"
    return ""


def _other_speed(history: History, baseline: History, known: Mask) -> str:
    """Say that a solution is far faster or slower than the baseline; empty if it is not."""
    rows = known & np.isfinite(baseline.velocity_n).all(axis=1)
    if not rows.any():
        return ""
    own_mps = np.linalg.norm(history.velocity_n[rows], axis=1)
    usual_mps = np.linalg.norm(baseline.velocity_n[rows], axis=1)
    off_mps = _rms(own_mps - usual_mps)
    if off_mps > LARGEST_SPEED * (_rms(usual_mps) + 1.0):
        return f"its speed differs from the baseline's by {off_mps:.2g} m/s (rms)"
    return ""


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _other_turns(
    history: History,
    baseline: History,
    imu: ImuColumns,
    known: Mask,
) -> str:
    """Say that a solution turns otherwise than baseline and gyros; empty if it does not."""
    rows = np.flatnonzero(known & np.isfinite(baseline.mat_nb).all(axis=(1, 2)))
    # A baseline that broke down early may have none of them.
    if not len(rows):
        return ""
    since_s = seconds(history.time_ns[rows], history.time_ns[0])
    rows = rows[np.unique(np.searchsorted(since_s, np.arange(0.0, since_s[-1], COMPARED_S)))]
    own = _turns(history.mat_nb[rows])
    is_other = _apart_deg(own, _turns(baseline.mat_nb[rows])) > LARGEST_TURN_DEG
    if not is_other:
        return ""
    rms_deg = _apart_deg(own, _turns_by_gyros(imu, history.time_ns[rows]))
    if rms_deg > LARGEST_TURN_DEG:
        return f"its turns in {COMPARED_S:g} s differ from the gyros' by {rms_deg:.2g} deg (rms)"
    return ""


def _turns(mat_nb: Floats) -> Floats:
    """Return the turns from each attitude to the next, shape (k - 1, 3, 3)."""
    return np.asarray(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:])


def _turns_by_gyros(imu: ImuColumns, time_ns: TimeNs) -> Floats:
    """Return the turns that the gyros measure from each time to the next, shape (k - 1, 3, 3)."""
    rate_b = 0.5 * (imu.angular_rate_b[1:] + imu.angular_rate_b[:-1])
    steps = mat_from_vector(rate_b * seconds(imu.time_ns[1:], imu.time_ns[:-1])[:, None])
    samples = pairwise(np.searchsorted(imu.time_ns, time_ns))
    return np.array([reduce(np.matmul, steps[first:last], np.eye(3)) for first, last in samples])


def _apart_deg(own: Floats, other: Floats) -> float:
    """Return the rms angle between turns, shape (k, 3, 3); 0 of none."""
    off_deg = np.linalg.norm(vector_from_mat(np.swapaxes(other, 1, 2) @ own), axis=1) / DEG
    if len(off_deg):
        return float(np.sqrt(np.mean(off_deg**2)))
    return 0.0


def _innovations(
    given_ns: TimeNs,
    innovation_b: Floats,
    innovation_cov: Floats,
    velocities: DvlVelocities,
) -> Innovations:
    """Return a solution's innovations of the DVL's velocity, in the axes of the IMU, at the pings."""
    known = np.isfinite(innovation_b).all(axis=1) & np.isfinite(innovation_cov).all(axis=(1, 2))
    time_ns, own, pings = np.intersect1d(given_ns[known], velocities.time_ns, return_indices=True)
    if not len(time_ns):
        raise CandidateError("gives innovations at no time of a ping")
    innovation = innovation_b[known][own]
    cov = innovation_cov[known][own]
    sign, log_det = np.linalg.slogdet(cov)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    if np.any(sign <= 0.0) or np.any(variance <= 0.0):
        raise CandidateError("gives innovations with a covariance that is not positive definite")
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
