"""Whether a solution of the vehicle's own is something else than the reference that it is judged by."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.checks.instants import same_instants
from insdvl_replay.checks.sensors import OWN_SHARE, SAME_RAD
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import NS_PER_S, Floats, ReferenceColumns, SolutionColumns
from insdvl_replay.core.errors import Note
from insdvl_replay.core.quantities import IS_REFERENCE
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import north_east_down_m

SAME: Final = 1e-7
"""Attitudes and velocities (m/s) that differ by less are the same, as files write them."""
WAY_NS, SAME_WAY_M, FAR_M = 10 * NS_PER_S, 1e-3, 0.1
"""Ways of ten seconds by a track of metres that differ by less are the same; at rest all ways are."""
FEWEST: Final = 10
"""So many samples of the same time."""


def solution_notes(
    solutions: Mapping[str, SolutionColumns], reference: ReferenceColumns | None, config: Config
) -> tuple[Note, ...]:
    """Note the solutions that are the reference itself, from a topic or a file, with the latencies put back."""
    return tuple(_solution_notes(solutions, reference, config)) if reference is not None else ()


def _solution_notes(
    solutions: Mapping[str, SolutionColumns], reference: ReferenceColumns, config: Config
) -> Iterator[Note]:
    for name, solution in solutions.items():
        latency_s = config.solutions[name].latency_s - config.reference.latency_s
        ours, theirs = same_instants(solution.motion.time_ns, reference.time_ns, latency_s)
        same = {
            "attitudes": _same(solution.motion.mat_nb[ours], reference.mat_nb[theirs], SAME),
            "velocities": _same(solution.motion.velocity_n[ours], reference.velocity_n[theirs], SAME),
            "positions": _same(solution.motion.position[ours, :2], reference.position[theirs, :2], SAME_RAD),
            "ways": _same_ways(solution, reference, ours, theirs),
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


def _same_ways(
    solution: SolutionColumns, reference: ReferenceColumns, ours: NDArray[np.intp], theirs: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Find the rows from which positions in metres, whose origin nobody knows, go where those of the reference do."""
    if solution.way_n is None:
        return np.zeros(len(ours), dtype=np.bool_)
    time_ns, way_n, position = solution.motion.time_ns[ours], solution.way_n[ours], reference.position[theirs]
    later = np.searchsorted(time_ns, time_ns + WAY_NS)
    earlier = np.flatnonzero(later < len(time_ns))
    later = later[earlier]
    ours_m = (way_n[later] - way_n[earlier])[:, :2]
    theirs_m = north_east_down_m(position[later], position[earlier])[:, :2]
    apart_m, far_m = (np.linalg.norm(rows, axis=1) for rows in (ours_m - theirs_m, theirs_m))
    return np.asarray((apart_m < SAME_WAY_M) & (far_m > FAR_M))
