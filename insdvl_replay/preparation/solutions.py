"""Solutions of the vehicle's own beside the filters that are run: laid where these start, and told at their times."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.config import Solution
from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Floats,
    ImuColumns,
    ReferenceColumns,
    Scalar,
    SolutionColumns,
    TimeNs,
    at_time,
    in_blocks,
    nothing,
    seconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note
from insdvl_replay.core.history import History
from insdvl_replay.core.states import BA, DEG, POSITION, states_with
from insdvl_replay.core.words import Severity
from insdvl_replay.evaluation.errors import WELL_COVERED, covered_share
from insdvl_replay.geometry.frames import moved_position, north_east_down_m
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, rpy_from_mat, vector_from_mat, wrap_angle
from insdvl_replay.preparation.prepared import reference_at_imu

LONGEST_STEP: Final = 2.5
"""Between samples that are further apart, in usual steps, a solution says nothing."""
STATES: Final = states_with(["position"])
"""Those of which a solution can say how sure it is are among these; the biases never are."""
_TOLD: Final = np.r_[: BA.start, POSITION.start : POSITION.stop]
"""Rows of a solution's covariance among its states."""
QUANTITIES: Final = ("positions", "velocities", "attitudes")


def read_solutions(
    solutions: dict[str, SolutionColumns],
    settings: Mapping[str, Solution],
    imu: ImuColumns,
    baseline: History,
    judged_ns: TimeNs,
) -> tuple[tuple[History, ...], dict[str, ReferenceColumns], tuple[Note, ...]]:
    """Tell what each solution of a dive says at the times of the baseline.

    Parameters
    ----------
    solutions : dict of str to SolutionColumns
        Those of the dive. They are taken out one by one: of a long log they are larger than the IMU's readings.
    settings : mapping of str to Solution
        By the name of the filter that each is.
    judged_ns : ndarray, shape (c,)
        Times at which errors are judged by P.

    Returns
    -------
    tuple of History
        In the order of the settings; between two samples on a line, with the turn between two attitudes at a steady
        rate.
    dict of str to ReferenceColumns
        Positions and velocities of each sample, as they were laid.
    tuple of Note
        Where each was laid, what of the replay it covers, and of what it says nothing.

    Raises
    ------
    LogError
        A solution says nothing inside the replay.
    ConfigError
        A solution is of another point than the IMU, and gives no attitude to say where that is.
    """
    histories, motions, notes = list[History](), dict[str, ReferenceColumns](), list[Note]()
    for name, setting in settings.items():
        laid, found, turned = laid_solution(name, solutions.pop(name), setting, imu, baseline)
        notes += [*found, *_coverage_notes(name, laid.motion, baseline)]
        histories.append(history_of(name, laid, baseline, judged_ns, is_turned=turned))
        notes += _belief_notes(name, histories[-1])
        motions[name] = laid.motion.without_attitude()
    return tuple(histories), motions, tuple(notes)


def laid_solution(
    name: str, solution: SolutionColumns, settings: Solution, imu: ImuColumns, baseline: History
) -> tuple[SolutionColumns, list[Note], bool]:
    """Move a solution to the IMU, and lay it where the baseline is when it begins, as the settings ask for.

    Returns
    -------
    SolutionColumns
        With geographic positions.
    list of Note
        What was done.
    bool
        Whether it was turned to the baseline's heading.
    """
    key, notes = f"filters.{name}.solution", list[Note]()
    if any(settings.lever_arm_m) and not solution.motion.has_attitude:
        raise ConfigError(
            f"{key} gives no attitude by which {key}.lever_arm_m could move it to the IMU",
            f"--set {key}.lever_arm_m=[0,0,0], and its errors hold the lever arm",
        )
    mat_br = mat_from_rpy(np.array(settings.mounting_rpy_deg) * DEG)
    align = settings.align or ("none" if solution.way_n is None else "position")
    if align == "heading":
        at_ns = _first_ns(solution.motion, "attitudes", key, baseline)
        own = _heading_at(solution.motion.time_ns, solution.motion.mat_nb @ mat_br.T, at_ns)
        turn = float(wrap_angle(np.array(_heading_at(baseline.time_ns, baseline.mat_nb, at_ns) - own)))
        solution = _turned(solution, mat_from_rpy(np.array([0.0, 0.0, turn])))
        text = f"{key}: turned by {turn / DEG:+.2f} deg to the heading of {baseline.filter} at its first attitude"
        notes.append(Note("solution_turned", text))
    motion = solution.motion
    origin, has_own_origin = baseline.position[0], solution.way_n is not None
    position = in_blocks(
        lambda rows: _laid_near(origin, rows, are_ways=has_own_origin),
        motion.position if solution.way_n is None else solution.way_n,
        np.empty(motion.position.shape),
    )
    motion = replace(motion, position=position)
    solution = replace(solution, motion=motion, way_n=None)
    motion = reference_at_imu(motion, imu, np.array(settings.lever_arm_m), mat_br)
    if align != "none" and motion.has_position:
        way_m, late_s = _shift(motion, key, baseline)
        from_own = " from an origin of its own" if has_own_origin else ""
        moved = "" if from_own else f", {way_m:.3g} m from where it was"
        text = (
            f"{key}: its positions{from_own} are laid on {baseline.filter} at the first of them, "
            f"{late_s:.2f} s after the start{moved}"
        )
        notes.append(Note("solution_laid", text))
    return replace(solution, motion=motion), notes, align == "heading"


def history_of(
    name: str, solution: SolutionColumns, baseline: History, judged_ns: TimeNs, *, is_turned: bool
) -> History:
    """Tell a solution with geographic positions at the times of the baseline.

    Returns
    -------
    History
        Without innovations and without biases. Its rows count as updated where it says anything at a ping of the
        baseline.
    """
    motion, time_ns = solution.motion, baseline.time_ns
    position = _interpolated(motion.time_ns, motion.position, time_ns)
    velocity_n = _interpolated(motion.time_ns, motion.velocity_n, time_ns)
    mat_nb = _interpolated_attitude(motion.time_ns, motion.mat_nb, time_ns)
    said = np.isfinite(np.column_stack([position[:, 0], velocity_n[:, 0], mat_nb[:, 0, 0]])).any(axis=1)
    sd = np.full((len(time_ns), len(STATES)), np.nan)
    sd[np.ix_(said, _TOLD)] = np.sqrt(_told_at(solution, time_ns[said], np.diagonal(solution.cov, axis1=1, axis2=2)))
    cov_ns = judged_ns[np.isin(judged_ns, time_ns[said])]
    whole = np.full((len(cov_ns), len(STATES), len(STATES)), np.nan)
    whole[np.ix_(np.arange(len(cov_ns)), _TOLD, _TOLD)] = _told_at(solution, cov_ns, solution.cov)
    untold = np.full((len(time_ns), 3), np.nan)
    return History(
        filter=name,
        time_ns=time_ns,
        updated=baseline.updated & said,
        position=position,
        velocity_n=velocity_n,
        mat_nb=mat_nb,
        accel_bias_b=untold,
        gyro_bias_b=untold,
        sd=sd,
        cov_ns=cov_ns,
        cov=whole,
        innovations=(),
        states=STATES,
        is_read=True,
        is_turned=is_turned,
    )


def _laid_near(origin: Floats, told: Floats, *, are_ways: bool) -> Floats:
    """Make positions of positions or of ways from an origin, with longitudes on its side of the 180th meridian."""
    near = moved_position(np.broadcast_to(origin, told.shape), told) if are_ways else told.copy()
    near[:, 1] = origin[1] + wrap_angle(near[:, 1] - origin[1])
    return near


def _first_ns(motion: ReferenceColumns, quantity: str, key: str, baseline: History) -> int:
    """Return the first time inside the replay at which a quantity is known, or lies between known ones."""
    known_ns = motion.time_ns[motion.known[quantity]]
    start_ns, end_ns = int(baseline.time_ns[0]), int(baseline.time_ns[-1])
    if not len(known_ns) or known_ns[0] > end_ns or known_ns[-1] < start_ns:
        raise LogError(
            f"{key}: none of its {quantity} lies in the replay",
            f"are its times on the log's clock? {key}.latency_s moves them, --start and --end widen the replay",
        )
    return max(start_ns, int(known_ns[0]))


def _heading_at(time_ns: TimeNs, mat_nb: Floats, at_ns: int) -> float:
    known = np.isfinite(mat_nb).all(axis=(1, 2))
    return float(at_time(time_ns[known], np.unwrap(rpy_from_mat(mat_nb[known])[:, 2])[:, None], at_ns)[0])


def _turned(solution: SolutionColumns, mat: Floats) -> SolutionColumns:
    """Turn a solution about down; geographic positions about the first of them."""
    motion, way_n = solution.motion, solution.way_n
    position = motion.position
    if way_n is not None:
        way_n = way_n @ mat.T
    elif motion.has_position:
        first = np.broadcast_to(position[int(np.argmax(motion.known["positions"]))], position.shape)
        position = moved_position(first, north_east_down_m(position, first) @ mat.T)
    turned = replace(motion, position=position, velocity_n=motion.velocity_n @ mat.T, mat_nb=mat @ motion.mat_nb)
    # Block by block: a block that is not told leaves the others as they are.
    blocks = np.einsum("ik,cakbl,jl->caibj", mat, solution.cov.reshape(-1, 3, 3, 3, 3), mat)
    return replace(solution, motion=turned, way_n=way_n, cov=blocks.reshape(solution.cov.shape))


def _shift(motion: ReferenceColumns, key: str, baseline: History) -> tuple[float, float]:
    """Lay the first position on the baseline, in place; return by how many metres it moves, and when that is, s."""
    at_ns = _first_ns(motion, "positions", key, baseline)
    has_height = bool(motion.known["heights"].any())
    told = motion.position if has_height else np.column_stack([motion.position[:, :2], np.zeros(len(motion.time_ns))])
    own, wanted = (
        at_time(*of_one, at_ns) for of_one in ((motion.time_ns, told), (baseline.time_ns, baseline.position))
    )
    if not has_height:
        own[2] = wanted[2]
    way_n = north_east_down_m(wanted, own)
    in_blocks(lambda rows: moved_position(rows, np.broadcast_to(way_n, rows.shape)), motion.position, motion.position)
    return float(np.linalg.norm(way_n)), (at_ns - int(baseline.time_ns[0])) / NS_PER_S


def _between(time_ns: TimeNs, known: NDArray[np.bool_], at_ns: TimeNs) -> tuple[NDArray[np.int64], Floats]:
    """Find between which known rows each time lies.

    Returns
    -------
    before : ndarray, shape (k,)
        Rows among the known ones; another one follows each.
    share : ndarray, shape (k,)
        Of the step to the next; NaN outside, and where the step is longer than `LONGEST_STEP`.
    """
    known_ns = _of(known, time_ns)
    if len(known_ns) < 2:
        return np.zeros(len(at_ns), np.int64), np.full(len(at_ns), np.nan)
    before = np.clip(np.searchsorted(known_ns, at_ns, side="right") - 1, 0, len(known_ns) - 2)
    step_s = seconds(known_ns[before + 1], known_ns[before])
    share = seconds(at_ns, known_ns[before]) / step_s
    usual_s = float(np.median(np.diff(known_ns), overwrite_input=True)) * 1e-9
    said = (share >= 0.0) & (share <= 1.0) & ((step_s <= LONGEST_STEP * usual_s) | (share == 0.0) | (share == 1.0))
    return before, np.where(said, share, np.nan)


def _of(known: NDArray[np.bool_], values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the known rows; mostly it is all of them, which spares a copy."""
    return values if known.all() else values[known]


def _interpolated(time_ns: TimeNs, values: Floats, at_ns: TimeNs) -> Floats:
    """Lay rows, shape (r, 3), at other times, each column by itself: a height may be missing."""
    columns = []
    for column in values.T:
        known: NDArray[np.bool_] = np.isfinite(column)
        before, share = _between(time_ns, known, at_ns)
        given = _of(known, column) if known.sum() > 1 else np.full(2, np.nan)
        columns.append(given[before] + share * (given[before + 1] - given[before]))
    return np.stack(columns, axis=1)


def _interpolated_attitude(time_ns: TimeNs, mat_nb: Floats, at_ns: TimeNs) -> Floats:
    known = np.asarray(np.isfinite(mat_nb).all(axis=(1, 2)))
    before, share = _between(time_ns, known, at_ns)
    found, said = np.full((len(at_ns), 3, 3), np.nan), np.flatnonzero(np.isfinite(share))
    rows = before + np.array([[0], [1]])
    if not known.all():
        rows[:, said] = np.flatnonzero(known)[rows[:, said]]

    def partway(told: NDArray[np.int64]) -> Floats:
        first, second = mat_nb[rows[:, told]]
        turn = vector_from_mat(np.swapaxes(first, 1, 2) @ second)
        return np.asarray(first @ mat_from_vector(share[told, None] * turn))

    found[said] = in_blocks(partway, said, np.empty((len(said), 3, 3)))
    return found


def _told_at(solution: SolutionColumns, at_ns: TimeNs, told: Floats) -> Floats:
    """Return of covariances, shape (c, ...), the last one before, or at, each time; the first before that."""
    if not len(told):
        return nothing((len(at_ns), *told.shape[1:]))
    return told[np.clip(np.searchsorted(solution.cov_ns, at_ns, side="right") - 1, 0, None)]


def _coverage_notes(name: str, motion: ReferenceColumns, baseline: History) -> Iterator[Note]:
    """State what a solution says nothing of, or not all the time."""
    start_ns, end_ns = int(baseline.time_ns[0]), int(baseline.time_ns[-1])
    never = [quantity for quantity in QUANTITIES if not motion.known[quantity].any()]
    if never:
        severity = Severity.WARNING if len(never) == len(QUANTITIES) else Severity.INFO
        lacking = " and ".join(never)
        yield Note("solution_lacks", f"filters.{name}.solution says nothing of {lacking}", len(never), severity)
    alike: dict[str, list[str]] = {}
    for quantity in (one for one in QUANTITIES if one not in never):
        share = covered_share(motion.time_ns, motion.known[quantity], start_ns, end_ns)
        if share < WELL_COVERED:
            alike.setdefault(f"{100.0 * share:.0f}", []).append(quantity)
    for percent, quantities in alike.items():
        text = (
            f"{' and '.join(quantities)} of filters.{name}.solution cover {percent} % of the replay; it is judged on "
            "that part, and the baseline beside it at the same instants"
        )
        yield Note("solution_coverage", text, len(quantities), Severity.WARNING, "--start and --end choose that part")


def _belief_notes(name: str, history: History) -> Iterator[Note]:
    blocks = {"velocity": slice(0, 3), "attitude": slice(3, 6), "position": POSITION}
    lacking = [block for block, states in blocks.items() if not history.believed[states].any()]
    if lacking:
        text = f"filters.{name}.solution does not say how sure it is of {' and '.join(lacking)}"
        yield Note("solution_without_covariance", text, len(lacking))
