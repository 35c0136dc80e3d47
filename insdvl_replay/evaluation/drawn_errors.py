"""True errors of one filter from several starts: what is left of what the start got wrong, and of what sensors add."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TruthColumns, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import PHI, STATES
from insdvl_replay.evaluation.reference import ReferenceErrors, reference_errors
from insdvl_replay.evaluation.state_errors import errors_at


@dataclass(frozen=True)
class RunFromStart:
    """How far a filter is off in one run."""

    filter: str
    time_s: Floats  # k times of the reference, from the start, which is not among them
    against_reference: ReferenceErrors
    error: Floats  # of its first twelve states, shape (k, 12), see `state_errors.StateErrors`
    sd: Floats  # by the filter's covariance, shape (k, 12)


def run_from_start(history: History, reference: ReferenceColumns, truth: TruthColumns | None) -> RunFromStart:
    """Compare one run with the reference, and its biases with the truth, and let go of all else."""
    errors = reference_errors(history, reference)
    return RunFromStart(
        history.filter,
        seconds(errors.time_ns, history.time_ns[0]),
        errors,
        errors_at(errors.time_ns, history, reference, truth)[:, : len(STATES)],
        history.sd[np.searchsorted(history.time_ns, errors.time_ns), : len(STATES)],
    )


@dataclass(frozen=True)
class DrawnErrors:
    """The runs of one filter over the same dive from s starts, of which the first is the dive's own."""

    filter: str
    time_s: Floats  # k times of the reference, from the start, which is not among them
    against_reference: tuple[ReferenceErrors, ...]  # one for each start
    error: Floats  # shape (s, k, 12), see `state_errors.StateErrors`; NaN where neither reference nor truth knows
    sd: Floats  # by the filter's covariance, shape (k, 12), from its own start; from the others it hardly differs


def drawn_errors(runs: Sequence[RunFromStart]) -> DrawnErrors:
    """Take the runs of one filter together, that from the dive's own start first."""
    own, error = runs[0], np.stack([run.error for run in runs])
    return DrawnErrors(own.filter, own.time_s, tuple(run.against_reference for run in runs), error, own.sd)


def errors_of_one_run(
    history: History, like: DrawnErrors, reference: ReferenceColumns, truth: TruthColumns | None
) -> DrawnErrors:
    """Take the errors of a run that has one start, such as a solution that was read, at the times of others."""
    times_ns = like.against_reference[0].time_ns
    return drawn_errors([run_from_start(history, reference.rows(np.isin(reference.time_ns, times_ns)), truth)])


def side_by_side(drawn: DrawnErrors, one: DrawnErrors) -> tuple[DrawnErrors, DrawnErrors]:
    """Lay the runs of a filter, NaN where the one run says nothing, next to that run, as often as there are starts."""
    run, starts = one.against_reference[0], len(drawn.error)
    known = tuple(errors.where_known(run) for errors in drawn.against_reference)
    before = replace(drawn, against_reference=known, error=np.where(np.isfinite(one.error), drawn.error, np.nan))
    after = replace(one, against_reference=(run,) * starts, error=np.repeat(one.error, starts, axis=0))
    return before, after


def squared_errors(drawn: DrawnErrors) -> dict[str, Floats]:
    """Square the errors that measured comparisons are of, by quantity, shape (s, k), SI units.

    They are ``position_h``, ``velocity_h``, ``level`` (the mean square of roll and pitch), and each error state by its
    name. NaN where it is not known; what is never known is left out.
    """
    position_m = np.stack([run.position_error_ned_m for run in drawn.against_reference])
    velocity_mps = np.stack([run.velocity_error_n for run in drawn.against_reference])
    with np.errstate(over="ignore"):
        squares = {
            "position_h": np.sum(position_m[..., :2] ** 2, axis=-1),
            "velocity_h": np.sum(velocity_mps[..., :2] ** 2, axis=-1),
            "level": np.mean(drawn.error[..., PHI][..., :2] ** 2, axis=-1),
            **{state.id: drawn.error[..., state.index] ** 2 for state in STATES},
        }
    return {quantity: square for quantity, square in squares.items() if np.isfinite(square).any()}
