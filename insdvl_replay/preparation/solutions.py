"""Recorded solutions of the vehicle: aligned with the baseline and interpolated at its times."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.config import Solution
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    Integers,
    Mask,
    ReferenceColumns,
    SolutionColumns,
    TimeNs,
    at_time,
    in_blocks,
    nothing,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.history import History
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import BA, DEG, POSITION, states_with
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.reference_errors import WELL_COVERED, covered_share
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.geometry.rotation import (
    mat_from_rpy,
    mat_from_vector,
    rpy_from_mat,
    vector_from_mat,
    wrap_angle,
)
from insdvl_replay.preparation.prepared import reference_at_imu

# in usual steps: between samples that are further apart a solution gives nothing
LONGEST_STEP: Final = 2.5
# a solution's covariance is of some of them; of the biases it never is
STATES: Final = states_with(["position"])
# rows of that covariance among the states
_REPORTED: Final = np.r_[: BA.start, POSITION.start : POSITION.stop]
QUANTITIES: Final = ("positions", "velocities", "attitudes")


def recorded_history(
    name: str,
    solution: SolutionColumns,
    settings: Solution,
    imu: ImuColumns,
    baseline: History,
    evaluated_ns: TimeNs,  # (c,) times at which errors are judged by P
    key: str = "",  # of the settings, in notes; that of a solution if it is left out
) -> tuple[History, ReferenceColumns, tuple[Note, ...]]:
    """Move a solution to the IMU, align it with the baseline where it begins, and interpolate it at its times.

    With it come positions and velocities of each sample, as they were aligned, and notes: how it was aligned, what of
    the replay it covers, and what it does not give.
    """
    key = key or f"filters.{name}.solution"
    notes = list[Note]()
    if any(settings.lever_arm_m) and not solution.motion.has_attitude:
        raise ConfigError(
            f"{key} has no attitude, so {key}.lever_arm_m cannot be applied",
            f"--set {key}.lever_arm_m=[0,0,0] (the errors then contain the lever arm)",
        )
    mat_br = mat_from_rpy(np.array(settings.mounting_rpy_deg) * DEG)
    has_own_origin = solution.moved_n is not None
    align = settings.align or ("position" if has_own_origin else "none")
    if align == "heading":
        at_ns = _first_ns(solution.motion, "attitudes", key, baseline)
        own = _heading_at(solution.motion.time_ns, solution.motion.mat_nb @ mat_br.T, at_ns)
        turn = float(
            wrap_angle(np.array(_heading_at(baseline.time_ns, baseline.mat_nb, at_ns) - own))
        )
        solution = _turned(solution, mat_from_rpy(np.array([0.0, 0.0, turn])))
        notes.append(note("solution_turned", key=key, turn=turn / DEG, baseline=baseline.filter))
    motion = replace(solution.motion, position=_geographic(solution, baseline.position[0]))
    motion = reference_at_imu(motion, imu, np.array(settings.lever_arm_m), mat_br)
    if align != "none" and motion.has_position:
        at_ns = _first_ns(motion, "positions", key, baseline)
        distance_m = _move_to(baseline, motion, at_ns)
        origin = ""
        moved = f"; they moved by {distance_m:.3g} m"
        if has_own_origin:
            origin = " (from an unknown origin)"
            moved = ""
        since_s = (at_ns - int(baseline.time_ns[0])) / NS_PER_S
        notes.append(
            note(
                "solution_aligned",
                key=key,
                origin=origin,
                baseline=baseline.filter,
                since=since_s,
                moved=moved,
            )
        )
    history = _history(
        name,
        replace(solution, motion=motion),
        baseline,
        evaluated_ns,
        is_turned=align == "heading",
    )
    return history, motion.without_attitude(), (*notes, *_coverage_notes(key, motion, history))


def _geographic(solution: SolutionColumns, origin: Floats) -> Floats:
    """Return the positions of a solution, with longitudes on the origin's side of the 180th meridian.

    One that only says how far it moved begins at the origin.
    """
    moved_n = solution.moved_n

    def from_origin(rows: Floats) -> Floats:
        return on_its_side(moved_position(np.broadcast_to(origin, rows.shape), rows))

    def on_its_side(position: Floats) -> Floats:
        position = position.copy()
        position[:, 1] = origin[1] + wrap_angle(position[:, 1] - origin[1])
        return position

    if moved_n is not None:
        return in_blocks(from_origin, moved_n, np.empty(moved_n.shape))
    position = solution.motion.position
    return in_blocks(on_its_side, position, np.empty(position.shape))


def _move_to(baseline: History, motion: ReferenceColumns, at_ns: int) -> float:
    """Move the position at a time to the baseline's, and all others with it, in place; return how far, m."""
    has_height = bool(motion.known["heights"].any())
    position = motion.position
    if not has_height:
        position = np.column_stack([motion.position[:, :2], np.zeros(len(motion.time_ns))])
    own = at_time(motion.time_ns, position, at_ns)
    wanted = at_time(baseline.time_ns, baseline.position, at_ns)
    if not has_height:
        own[2] = wanted[2]
    shift_n = north_east_down_m(wanted, own)

    def shifted(rows: Floats) -> Floats:
        return moved_position(rows, np.broadcast_to(shift_n, rows.shape))

    in_blocks(shifted, motion.position, motion.position)
    return float(np.linalg.norm(shift_n))


def _history(
    name: str,
    solution: SolutionColumns,  # with geographic positions
    baseline: History,
    evaluated_ns: TimeNs,  # (c,)
    *,
    is_turned: bool,
) -> History:
    """Interpolate a solution at the times of the baseline; rows count as updated where it gives any at a ping."""
    motion = solution.motion
    time_ns = baseline.time_ns
    position = interpolated(motion.time_ns, motion.position, time_ns)
    velocity_n = interpolated(motion.time_ns, motion.velocity_n, time_ns)
    mat_nb = interpolated_attitude(motion.time_ns, motion.mat_nb, time_ns)
    given = np.isfinite(np.column_stack([position[:, 0], velocity_n[:, 0], mat_nb[:, 0, 0]])).any(
        axis=1
    )

    def reported(cov: Floats, at_ns: TimeNs) -> Floats:
        """Return the last covariance, shape (c, ...), before, or at, each time; the first before that."""
        if not len(cov):
            return nothing((len(at_ns), *cov.shape[1:]))
        return cov[np.clip(np.searchsorted(solution.cov_ns, at_ns, side="right") - 1, 0, None)]

    sd = np.full((len(time_ns), len(STATES)), np.nan)
    sd[np.ix_(given, _REPORTED)] = np.sqrt(
        reported(np.diagonal(solution.cov, axis1=1, axis2=2), time_ns[given])
    )
    cov_ns = evaluated_ns[np.isin(evaluated_ns, time_ns[given])]
    cov = np.full((len(cov_ns), len(STATES), len(STATES)), np.nan)
    cov[np.ix_(np.arange(len(cov_ns)), _REPORTED, _REPORTED)] = reported(solution.cov, cov_ns)
    no_bias = np.full((len(time_ns), 3), np.nan)
    return History(
        filter=name,
        time_ns=time_ns,
        updated=baseline.updated & given,
        position=position,
        velocity_n=velocity_n,
        mat_nb=mat_nb,
        accel_bias_b=no_bias,
        gyro_bias_b=no_bias,
        sd=sd,
        cov_ns=cov_ns,
        cov=cov,
        innovations=(),
        states=STATES,
        is_partial=True,
        has_own_start=True,
        is_turned=is_turned,
    )


def _first_ns(
    motion: ReferenceColumns,
    quantity: str,
    key: str,
    baseline: History,
) -> int:
    """Return the first time inside the replay at which a quantity is known, or between known ones."""
    known_ns = motion.time_ns[motion.known[quantity]]
    start_ns = int(baseline.time_ns[0])
    end_ns = int(baseline.time_ns[-1])
    if not len(known_ns) or known_ns[0] > end_ns or known_ns[-1] < start_ns:
        raise LogError(
            f"{key}: it has no {quantity} in the time of the replay",
            f"if its clock differs from the log's, set {key}.latency_s; or widen --start and --end",
        )
    return max(start_ns, int(known_ns[0]))


def _heading_at(time_ns: TimeNs, mat_nb: Floats, at_ns: int) -> float:
    known = np.isfinite(mat_nb).all(axis=(1, 2))
    return float(
        at_time(time_ns[known], np.unwrap(rpy_from_mat(mat_nb[known])[:, 2])[:, None], at_ns)[0]
    )


def _turned(solution: SolutionColumns, mat: Floats) -> SolutionColumns:
    """Turn a solution about down; geographic positions about the first of them."""
    motion = solution.motion
    moved_n = solution.moved_n
    position = motion.position
    if moved_n is not None:
        moved_n = moved_n @ mat.T
    elif motion.has_position:
        first = np.broadcast_to(
            position[int(np.argmax(motion.known["positions"]))], position.shape
        )
        position = moved_position(first, north_east_down_m(position, first) @ mat.T)
    turned = replace(
        motion, position=position, velocity_n=motion.velocity_n @ mat.T, mat_nb=mat @ motion.mat_nb
    )
    # Block by block: a block that is NaN leaves the others as they are.
    blocks = np.einsum("ik,cakbl,jl->caibj", mat, solution.cov.reshape(-1, 3, 3, 3, 3), mat)
    return replace(
        solution, motion=turned, moved_n=moved_n, cov=blocks.reshape(solution.cov.shape)
    )


def _between(time_ns: TimeNs, known: Mask, at_ns: TimeNs) -> tuple[Integers, Floats]:
    """Return the known rows around each time, shape (2, k), and its share of the step between them, shape (k,).

    The share is NaN outside, and where the step is longer than `LONGEST_STEP`.
    """
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        return np.zeros((2, len(at_ns)), np.int64), np.full(len(at_ns), np.nan)
    known_ns = time_ns[rows]
    before = np.clip(np.searchsorted(known_ns, at_ns, side="right") - 1, 0, len(known_ns) - 2)
    step_s = seconds(known_ns[before + 1], known_ns[before])
    share = seconds(at_ns, known_ns[before]) / step_s
    usual_s = float(np.median(np.diff(known_ns), overwrite_input=True)) * 1e-9
    given = (
        (share >= 0.0)
        & (share <= 1.0)
        & ((step_s <= LONGEST_STEP * usual_s) | (share == 0.0) | (share == 1.0))
    )
    return rows[before + np.array([[0], [1]])], np.where(given, share, np.nan)


def interpolated(time_ns: TimeNs, values: Floats, at_ns: TimeNs) -> Floats:
    """Interpolate rows, shape (r, 3), linearly, each column by itself: a height may be missing."""
    found = np.full((len(at_ns), 3), np.nan)
    for column, into in zip(values.T, found.T, strict=True):
        rows, share = _between(time_ns, np.isfinite(column), at_ns)
        if np.isfinite(share).any():
            first, second = column[rows]
            into[:] = first + share * (second - first)
    return found


def interpolated_attitude(time_ns: TimeNs, mat_nb: Floats, at_ns: TimeNs) -> Floats:
    """Turn from one attitude to the next at a steady rate."""
    rows, share = _between(time_ns, np.asarray(np.isfinite(mat_nb).all(axis=(1, 2))), at_ns)
    found = np.full((len(at_ns), 3, 3), np.nan)
    given = np.flatnonzero(np.isfinite(share))

    def partway(block: Integers) -> Floats:
        first, second = mat_nb[rows[:, block]]
        turn = vector_from_mat(np.swapaxes(first, 1, 2) @ second)
        return np.asarray(first @ mat_from_vector(share[block, None] * turn))

    found[given] = in_blocks(partway, given, np.empty((len(given), 3, 3)))
    return found


def _coverage_notes(key: str, motion: ReferenceColumns, history: History) -> Iterator[Note]:
    """Note the quantities that a solution lacks or does not cover, and those without covariance."""
    start_ns = int(history.time_ns[0])
    end_ns = int(history.time_ns[-1])
    shares = dict[str, list[str]]()
    never = [quantity for quantity in QUANTITIES if not motion.known[quantity].any()]
    if never:
        severity = Severity.WARNING if len(never) == len(QUANTITIES) else Severity.INFO
        yield note(
            "solution_lacks",
            len(never),
            severity=severity,
            key=key,
            quantities=" and ".join(never),
        )
    for quantity in QUANTITIES:
        share = covered_share(motion.time_ns, motion.known[quantity], start_ns, end_ns)
        if quantity not in never and share < WELL_COVERED:
            shares.setdefault(f"{100.0 * share:.0f}", []).append(quantity)
    for percent, quantities in shares.items():
        names = " and ".join(quantities)
        yield note(
            "solution_coverage", len(quantities), key=key, quantities=names, percent=percent
        )
    blocks = {"velocity": slice(0, 3), "attitude": slice(3, 6), "position": POSITION}
    lacking = [block for block, states in blocks.items() if not history.predicted[states].any()]
    if lacking:
        yield note(
            "solution_without_covariance", len(lacking), key=key, quantities=" and ".join(lacking)
        )
