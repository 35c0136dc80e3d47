"""Whether a solution of the vehicle's own is something else than the reference that it is judged by."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.instants import same_instants
from insdvl_replay.checks.sensors import OWN_SHARE, SAME_RAD
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, SolutionColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.words import Severity

SAME: Final = 1e-7
"""Attitudes and velocities (m/s) that differ by less are the same, as files write them."""
FEWEST: Final = 10
"""So many samples of the same time."""


def solution_notes(solutions: Mapping[str, SolutionColumns], reference: ReferenceColumns | None) -> tuple[Note, ...]:
    """Note the solutions that are the reference itself, from another topic or from a file."""
    return tuple(_solution_notes(solutions, reference)) if reference is not None else ()


def _solution_notes(solutions: Mapping[str, SolutionColumns], reference: ReferenceColumns) -> Iterator[Note]:
    for name, solution in solutions.items():
        ours, theirs = same_instants(solution.motion.time_ns, reference.time_ns)
        same = {
            "attitudes": _same(solution.motion.mat_nb[ours], reference.mat_nb[theirs], SAME),
            "velocities": _same(solution.motion.velocity_n[ours], reference.velocity_n[theirs], SAME),
            "positions": _same(solution.motion.position[ours, :2], reference.position[theirs, :2], SAME_RAD),
        }
        found = {quantity: int(rows.sum()) for quantity, rows in same.items()}
        quantity, count = max(found.items(), key=lambda item: item[1])
        if count > max(OWN_SHARE * len(solution.motion.time_ns), FEWEST):
            text = (
                f"{count} of {len(solution.motion.time_ns)} {quantity} of filters.{name}.solution are the reference's"
            )
            hint = "reference.topic and reference.fix name what it is to be judged by"
            yield Note(f"solution_{name}{IS_REFERENCE}", text, count, Severity.WARNING, hint)


def _same(ours: Floats, theirs: Floats, least: float) -> NDArray[np.bool_]:
    """Find the rows that are alike; at rest all velocities are."""
    components = tuple(range(1, ours.ndim))
    apart, size = (np.abs(rows).max(axis=components, initial=0.0) for rows in (ours - theirs, theirs))
    return np.asarray((apart < least) & (size > least))
