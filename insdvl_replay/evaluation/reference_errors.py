"""Errors against the reference, at the reference's own times: of one run, of runs from random starts, and their table.

Errors are estimated minus reference, NaN where either says nothing. Percentages are of the distance travelled, which
is the reference's wherever it can be measured.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import (
    Floats,
    Mask,
    ReferenceColumns,
    TimeNs,
    TruthColumns,
    nanoseconds,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import REFERENCE_QUANTITIES
from insdvl_replay.core.states import BA, BG, DEG, DV, PHI, POSITION, STATES
from insdvl_replay.core.tables import ReferenceErrorRow
from insdvl_replay.core.words import ReferenceStatus
from insdvl_replay.evaluation.series import thinned
from insdvl_replay.geometry.frames import north_east_down_m, north_east_m
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat

# Share of a replay that has to be covered before errors count as those of the whole.
WELL_COVERED: Final = 0.9
USUAL_STEPS: Final = 5.0  # A step of up to this many usual steps is no gap.
SHORT_S: Final = 2.5  # A shorter step is no gap either.
CHORD_S: Final = 10.0  # Shorter steps between positions would add up noise instead of distance.
# No percentages over a shorter distance, since at rest a filter's noise adds up to some metres.
SHORTEST_M: Final = 10.0
# Quantities that keep the error of an IMU gap: position is not observed again.
DEAD_RECKONED: Final = ("position_h", "depth", "position_h_pct")

NO_ERRORS: Final[Floats] = np.empty(0)

Known = Mask


# --- What the reference covers, and how far the vehicle went.


def covered_share(
    time_ns: TimeNs,
    known: Known,
    start_ns: int,
    end_ns: int,
) -> float:
    """Return the share of a span, 0 to 1, that is covered by numbers without gaps."""
    known_ns = time_ns[known]
    steps_ns = np.diff(known_ns[(known_ns >= start_ns) & (known_ns <= end_ns)])
    if not steps_ns.size:
        return 0.0
    longest_ns = max(USUAL_STEPS * float(np.median(steps_ns)), nanoseconds(SHORT_S))
    return float(steps_ns[steps_ns <= longest_ns].sum() / (end_ns - start_ns))


def compared_distance_m(reference: ReferenceColumns, baseline: History, time_ns: TimeNs) -> float:
    """Return the horizontal distance from the start to the last compared position, the same for all filters.

    It is the reference's wherever its velocities, or else its positions, cover the span. Chords between noisy positions
    are too long, so that the shorter of them and the baseline's distance counts; else it is the baseline's.
    """
    if not len(time_ns):
        return 0.0
    start_ns = int(baseline.time_ns[0])
    end_ns = int(time_ns[-1])
    estimated_m = distance_travelled_m(baseline, time_ns)
    within = reference.within(start_ns, end_ns)
    speed_share = covered_share(within.time_ns, within.known["velocities"], start_ns, end_ns)
    position_share = covered_share(within.time_ns, within.known["positions"], start_ns, end_ns)
    if max(speed_share, position_share) < WELL_COVERED:
        return estimated_m
    referred_m = float(reference_distance_m(within, np.union1d(start_ns, within.time_ns))[-1])
    if speed_share >= WELL_COVERED:
        return referred_m
    return min(referred_m, estimated_m)


def distance_travelled_m(history: History, time_ns: TimeNs) -> float:
    """Integrate a filter's horizontal speed from the start to the last of some times."""
    if not len(time_ns):
        return 0.0
    rows = history.time_ns <= time_ns[-1]
    speed_mps = np.hypot(history.velocity_n[rows, 0], history.velocity_n[rows, 1])
    return float(np.trapezoid(speed_mps, seconds(history.time_ns[rows], history.time_ns[0])))


def reference_distance_m(reference: ReferenceColumns, time_ns: TimeNs) -> Floats:
    """Return how far the reference has travelled horizontally since the first of its times, shape (k,).

    Its speed is integrated; where that is known for too little of the time, chords between positions are added up. NaN
    where it has neither.
    """
    rows = np.isin(reference.time_ns, time_ns)
    moving = reference.known["velocities"] & rows
    located = reference.known["positions"] & rows
    time_s = seconds(time_ns, time_ns[0])
    speed_share = covered_share(
        reference.time_ns[rows], moving[rows], int(time_ns[0]), int(time_ns[-1])
    )
    if speed_share >= WELL_COVERED or (moving.any() and not located.any()):
        speed_mps = np.hypot(reference.velocity_n[moving, 0], reference.velocity_n[moving, 1])
        steady_mps = np.interp(time_s, seconds(reference.time_ns[moving], time_ns[0]), speed_mps)
        steps_m = np.diff(time_s) * (steady_mps[1:] + steady_mps[:-1]) / 2.0
        return np.append(0.0, np.cumsum(steps_m))
    if not located.any():
        return np.full(len(time_ns), np.nan)
    ends = np.union1d(thinned(reference.time_ns[located], CHORD_S), np.count_nonzero(located) - 1)
    fix_ns = reference.time_ns[located][ends]
    position = reference.position[located][ends]
    chords_m = np.hypot(*north_east_m(position[1:], position[:-1], position[:-1]))
    travelled_m = np.append(0.0, np.cumsum(chords_m))
    along_m: Floats = np.interp(time_s, seconds(fix_ns, time_ns[0]), travelled_m)
    return along_m


# --- Errors of one run.


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors of one run at the k times of the reference after its start."""

    time_ns: TimeNs
    position_error_ned_m: Floats  # (k, 3), north, east, down
    velocity_error_n: Floats  # (k, 3), m/s
    # (k, 3), roll, pitch, heading: about level forward, level starboard and down
    attitude_error_rad: Floats
    distance_m: float  # horizontal, from the start to the last compared position
    # (k, 3), position errors with all corrections of the position taken back
    drifting_ned_m: Floats


def reference_errors(
    history: History, reference: ReferenceColumns, baseline: History | None = None
) -> ReferenceErrors:
    """Compare a history with the reference at every reference time inside the replay, without the start.

    Where the reference does not give the distance, it is the baseline's, or else the history's own.
    """
    time_ns, ours, theirs = np.intersect1d(
        history.time_ns[1:], reference.time_ns, return_indices=True
    )
    ours += 1
    error_ned_m = north_east_down_m(history.position[ours], reference.position[theirs])
    located_ns = time_ns[np.isfinite(error_ned_m[:, :2]).all(axis=1)]
    return ReferenceErrors(
        time_ns=time_ns,
        position_error_ned_m=error_ned_m,
        velocity_error_n=history.velocity_n[ours] - reference.velocity_n[theirs],
        attitude_error_rad=attitude_error(history.mat_nb[ours], reference.mat_nb[theirs]),
        distance_m=compared_distance_m(reference, baseline or history, located_ns),
        drifting_ned_m=north_east_down_m(history.dead_reckoned[ours], reference.position[theirs]),
    )


def attitude_error(mat_nb: Floats, mat_nb_reference: Floats) -> Floats:
    """Return the error rotation as roll, pitch and heading error, shape (k, 3), rad.

    The rotation vector of ``C_hat C'``, in n, is turned by the reference's heading to the vehicle's level axes. On a
    level vehicle this equals differences of Euler angles, and near the vertical it does not blow up.
    """
    known = np.isfinite(mat_nb_reference).all(axis=(1, 2))
    error = np.full((len(mat_nb), 3), np.nan)
    north, east, down = vector_from_mat(
        mat_nb[known] @ np.swapaxes(mat_nb_reference[known], 1, 2)
    ).T
    heading = rpy_from_mat(mat_nb_reference[known])[:, 2]
    cos = np.cos(heading)
    sin = np.sin(heading)
    error[known] = np.column_stack([cos * north + sin * east, -sin * north + cos * east, down])
    return error


def motion_error(
    velocity_n: Floats,  # (k, 3), m/s
    mat_nb: Floats,  # (k, 3, 3)
    true_velocity_n: Floats,
    true_mat_nb: Floats,
) -> tuple[Floats, Floats]:
    """Return the errors of velocity, m/s, and attitude, rad, as P defines them, shape (k, 3) each.

    The filter is exact for the invariant error ``xi = v_hat - C_hat C' v``, to first order ``dv + v_hat x phi``. This
    dv is the difference of the velocities where the misalignment is small; with a heading that is off by 20 deg the
    difference would also hold the second order, 6 % of the speed. Where an attitude is not known, it is the difference.
    """
    known = np.isfinite(true_mat_nb).all(axis=(1, 2)) & np.isfinite(mat_nb).all(axis=(1, 2))
    velocity_error_n = velocity_n - true_velocity_n
    misalignment_n = np.full_like(velocity_n, np.nan)
    turned = mat_nb[known] @ np.swapaxes(true_mat_nb[known], 1, 2)
    misalignment_n[known] = vector_from_mat(turned)
    invariant_error_n = velocity_n[known] - np.einsum("kij,kj->ki", turned, true_velocity_n[known])
    velocity_error_n[known] = invariant_error_n - np.cross(
        velocity_n[known], misalignment_n[known]
    )
    return velocity_error_n, misalignment_n


def errors_at(
    time_ns: TimeNs,
    history: History,
    reference: ReferenceColumns,
    truth: TruthColumns | None,
) -> Floats:
    """Return the errors of a filter's states, shape (k, n), SI units, at times that history and reference share.

    The states are the twelve, and the position where the filter estimates it. A bias is what is left in the compensated
    readings, known at the times of the truth.
    """
    ours = np.searchsorted(history.time_ns, time_ns)
    theirs = np.searchsorted(reference.time_ns, time_ns)
    states = POSITION.stop if history.estimates_position else POSITION.start
    error = np.full((len(time_ns), states), np.nan)
    error[:, DV], error[:, PHI] = motion_error(
        history.velocity_n[ours],
        history.mat_nb[ours],
        reference.velocity_n[theirs],
        reference.mat_nb[theirs],
    )
    if truth is not None:
        _, rows, true_rows = np.intersect1d(
            time_ns, truth.time_ns, assume_unique=True, return_indices=True
        )
        error[rows, BA] = truth.accel_bias_b[true_rows] - history.accel_bias_b[ours][rows]
        error[rows, BG] = truth.gyro_bias_b[true_rows] - history.gyro_bias_b[ours][rows]
    if history.estimates_position:
        error[:, POSITION] = north_east_down_m(history.position[ours], reference.position[theirs])
    return error


# --- Errors of runs from several starts.


@dataclass(frozen=True)
class DrawnErrors:
    """Errors of one filter over the same dive from s starts, the dive's own first, at k times of the reference."""

    filter: str
    time_ns: TimeNs  # (k,), the start is not among them
    time_s: Floats  # (k,), from the start
    position_error_ned_m: Floats  # (s, k, 3)
    velocity_error_n: Floats  # (s, k, 3), m/s
    error: Floats  # (s, k, 12), of the states, see `errors_at`
    sd: Floats  # (k, 12), by the filter's covariance, from one start of them; it hardly differs between random ones
    drifting_ned_m: Floats  # (s, k, 3), as of `ReferenceErrors`


def run_from_start(
    history: History, reference: ReferenceColumns, truth: TruthColumns | None
) -> DrawnErrors:
    """Compare one run with the reference, and its biases with the truth; keep only the errors."""
    time_ns, ours, theirs = np.intersect1d(
        history.time_ns[1:], reference.time_ns, return_indices=True
    )
    ours = ours + 1
    position = reference.position[theirs]
    error_ned_m = drifting_ned_m = north_east_down_m(history.position[ours], position)[None]
    if len(history.corrected):
        drifting_ned_m = north_east_down_m(history.dead_reckoned[ours], position)[None]
    return DrawnErrors(
        history.filter,
        time_ns,
        seconds(time_ns, history.time_ns[0]),
        error_ned_m,
        (history.velocity_n[ours] - reference.velocity_n[theirs])[None],
        errors_at(time_ns, history, reference, truth)[None, :, : len(STATES)],
        history.sd[ours, : len(STATES)],
        drifting_ned_m,
    )


def drawn_errors(runs: Sequence[DrawnErrors], *, own_sd: bool = True) -> DrawnErrors:
    """Take the runs of one filter together, that from the dive's own start first.

    The standard deviations are those of the dive's own start, else of the first random one.
    """
    position_error_ned_m = np.concatenate([run.position_error_ned_m for run in runs])
    drifting_ned_m = position_error_ned_m
    has_corrections = runs[0].drifting_ned_m is not runs[0].position_error_ned_m
    if has_corrections:  # without them one array holds both
        drifting_ned_m = np.concatenate([run.drifting_ned_m for run in runs])
    sd = runs[0].sd
    if not own_sd and len(runs) > 1:
        sd = runs[1].sd
    return replace(
        runs[0],
        position_error_ned_m=position_error_ned_m,
        velocity_error_n=np.concatenate([run.velocity_error_n for run in runs]),
        error=np.concatenate([run.error for run in runs]),
        sd=sd,
        drifting_ned_m=drifting_ned_m,
    )


def squared_errors(drawn: DrawnErrors) -> dict[str, Floats]:
    """Square the errors whose convergence is measured, by quantity, shape (s, k), SI units, if they are ever known.

    They are ``position_h``, ``velocity_h``, ``level`` (the mean square of roll and pitch), and each state by its name.
    """
    with np.errstate(over="ignore"):
        squares = {
            "position_h": np.sum(drawn.position_error_ned_m[..., :2] ** 2, axis=-1),
            "velocity_h": np.sum(drawn.velocity_error_n[..., :2] ** 2, axis=-1),
            "level": np.mean(drawn.error[..., PHI][..., :2] ** 2, axis=-1),
            **{state.id: drawn.error[..., state.index] ** 2 for state in STATES},
        }
    return {quantity: square for quantity, square in squares.items() if np.isfinite(square).any()}


# --- The table.


def improvement_pct(before: float, after: float) -> float:
    """Return ``(before - after) / before`` in percent; NaN where ``before`` is zero or either is not finite."""
    if not (np.isfinite(before) and np.isfinite(after)) or before == 0.0:
        return float("nan")
    return float(100.0 * (before - after) / before)


def reference_error_table(
    log: str,
    histories: tuple[History, ...],
    errors: Mapping[str, ReferenceErrors],
    *,
    bridged_gaps: bool = False,
) -> list[ReferenceErrorRow]:
    """Return the candidates' errors next to the baseline's, 9 rows a candidate; final errors keep their sign.

    A baseline without candidates has its own errors, next to none.
    The errors, by filter, are empty without a reference. With the status ``partly covered`` or ``lost in gap`` the
    numbers are given, but are not evidence. Next to a partial candidate the baseline's numbers are of the same
    instants.
    """
    baseline, *candidates = histories
    rows: list[ReferenceErrorRow] = []
    for candidate in candidates or [baseline]:
        if errors:
            rows += _rows_of_candidate(log, baseline, candidate, errors, bridged_gaps=bridged_gaps)
        else:
            rows += _rows_without_reference(log, candidate)
    return rows


def _rows_without_reference(log: str, candidate: History) -> Iterator[ReferenceErrorRow]:
    for quantity, unit in REFERENCE_QUANTITIES.items():
        yield ReferenceErrorRow(
            log=log,
            filter=candidate.filter,
            quantity=quantity,
            unit=unit,
            baseline_rmse=np.nan,
            rmse=np.nan,
            improvement_pct=np.nan,
            baseline_final=np.nan,
            final=np.nan,
            samples=0,
            status=ReferenceStatus.NO_REFERENCE,
        )


def _rows_of_candidate(
    log: str,
    baseline: History,
    candidate: History,
    errors: Mapping[str, ReferenceErrors],
    *,
    bridged_gaps: bool,
) -> Iterator[ReferenceErrorRow]:
    """Yield the errors of a candidate next to those of the baseline, by quantity."""
    own = errors[candidate.filter]
    of_baseline = errors[baseline.filter]
    after = _shown(own, own.distance_m)
    before = _shown(of_baseline, of_baseline.distance_m)
    compared = before
    if candidate.is_partial:
        at_same_distance = _shown(of_baseline, min(own.distance_m, of_baseline.distance_m))
        compared = {
            quantity: np.where(np.isfinite(after[quantity]), error, np.nan)
            for quantity, error in at_same_distance.items()
        }
    start_ns = int(baseline.time_ns[0])
    end_ns = int(baseline.time_ns[-1])
    for quantity, unit in REFERENCE_QUANTITIES.items():
        known = np.isfinite(compared[quantity])
        if known.any():
            share = covered_share(of_baseline.time_ns, known, start_ns, end_ns)
            status = _status_by_coverage(quantity, share, bridged_gaps=bridged_gaps)
        else:
            status = _why_not_compared(quantity, before, after)
        # A baseline without candidates stands next to none.
        errors_of_baseline = NO_ERRORS if candidate is baseline else compared[quantity]
        baseline_rmse, baseline_final = _rms_and_final(errors_of_baseline)
        rmse, final = _rms_and_final(after[quantity])
        yield ReferenceErrorRow(
            log=log,
            filter=candidate.filter,
            quantity=quantity,
            unit=unit,
            baseline_rmse=baseline_rmse,
            rmse=rmse,
            improvement_pct=improvement_pct(baseline_rmse, rmse),
            baseline_final=baseline_final,
            final=final,
            samples=int(known.sum()),
            status=status,
        )


def _status_by_coverage(quantity: str, share: float, *, bridged_gaps: bool) -> ReferenceStatus:
    """Return the status of an error that is known for some share of the replay."""
    if bridged_gaps and quantity in DEAD_RECKONED:
        return ReferenceStatus.LOST_IN_GAP
    if share >= WELL_COVERED:
        return ReferenceStatus.COMPARED
    return ReferenceStatus.PARTLY_COVERED


def _why_not_compared(
    quantity: str, before: Mapping[str, Floats], after: Mapping[str, Floats]
) -> ReferenceStatus:
    """Return why an error is not known at any time: the errors of baseline and candidate are given, by quantity."""
    if np.isfinite(before[quantity]).any():
        return ReferenceStatus.NOT_IN_SOLUTION
    if quantity == "position_h_pct" and np.isfinite(after["position_h"]).any():
        return ReferenceStatus.NO_DISTANCE
    return ReferenceStatus.NOT_IN_REFERENCE


def _shown(errors: ReferenceErrors, distance_m: float) -> dict[str, Floats]:
    """Return the errors of each quantity in its shown unit, shape (k,)."""
    horizontal_m = np.hypot(*errors.position_error_ned_m[:, :2].T)
    percent = 100.0 / distance_m if distance_m >= SHORTEST_M else np.nan
    attitude = errors.attitude_error_rad.T / DEG
    down_m = errors.position_error_ned_m[:, 2]
    columns = (*errors.velocity_error_n.T, *attitude, horizontal_m, down_m, horizontal_m * percent)
    return dict(zip(REFERENCE_QUANTITIES, columns, strict=True))


def _rms_and_final(error: Floats) -> tuple[float, float]:
    known = error[np.isfinite(error)]
    if len(known):
        return (float(np.sqrt(np.mean(known**2))), float(known[-1]))
    return (np.nan, np.nan)


# --- The acceleration of the reference.


def reference_acceleration(reference: ReferenceColumns, max_gap_s: float) -> Floats:
    """Differentiate the reference's velocity in body axes, by central differences of second order; shape (r, 3), m/s^2.

    No attitude is interpolated: a reference of 1 Hz says nothing of it inside a sharp turn, while the body's own
    velocity hardly changes there. NaN in the first and last row, next to longer pauses, and next to rows without
    velocity or attitude.
    """
    acceleration_b = np.full((len(reference.time_ns), 3), np.nan)
    if len(reference.time_ns) < 3:
        return acceleration_b
    velocity_b = np.einsum("kji,kj->ki", reference.mat_nb, reference.velocity_n)
    time_s = seconds(reference.time_ns, reference.time_ns[:1])
    acceleration_b[1:-1] = np.gradient(velocity_b, time_s, axis=0)[1:-1]
    apart = np.diff(time_s) > max_gap_s
    acceleration_b[:-1][apart] = acceleration_b[1:][apart] = np.nan
    return acceleration_b


def acceleration_at(time_ns: TimeNs, reference_ns: TimeNs, acceleration_b: Floats) -> Floats:
    """Interpolate the reference's acceleration at other times; NaN where a row next to the time has none."""
    time_s = seconds(time_ns, reference_ns[:1])
    row_s = seconds(reference_ns, reference_ns[:1])
    return np.column_stack(
        [np.interp(time_s, row_s, axis, np.nan, np.nan) for axis in acceleration_b.T]
    )


def differentiated_over_s(reference: ReferenceColumns) -> float:
    """Return the median time over which the reference's velocity is differentiated, from row to row but one."""
    return float(np.median(seconds(reference.time_ns[2:], reference.time_ns[:-2])))


def vector_rmse(estimated: Floats, reference: Floats, rows: Known) -> float:
    """Return the root mean square length of the difference of vectors, shape (k, 3), in some rows; NaN without any.

    Equation (55) of Levy and Klein.
    """
    if not rows.any():
        return float("nan")
    return float(np.sqrt(np.mean(np.sum((estimated[rows] - reference[rows]) ** 2, axis=1))))
