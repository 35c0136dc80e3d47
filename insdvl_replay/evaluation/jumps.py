"""How often a filter's position jumps: steps that neither its own velocity nor the steps around explain.

A reference is looked at in the same way, see `geometry.frames`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.tables import JumpRow
from insdvl_replay.geometry.frames import find_jumps, steps_of, unexplained_m

SMALLEST_M: Final = 0.5
"""Less is no jump: in turns velocities and positions of a few hertz differ by some centimetres."""


def jump_table(log: str, histories: Iterable[History], motions: Mapping[str, ReferenceColumns]) -> list[JumpRow]:
    """Count the jumps of each filter whose position can jump.

    Parameters
    ----------
    log : str
        Name of the dive.
    motions : mapping of str to ReferenceColumns
        Those of solutions that were read, by filter: they are looked at from sample to sample.

    Returns
    -------
    list of JumpRow
        None of a filter that goes by its velocity alone, and of a solution without positions inside the replay.
    """
    able = [history for history in histories if history.is_read or history.estimates_position]
    return [row for history in able for row in _row(log, history, motions.get(history.filter))]


def _row(log: str, history: History, motion: ReferenceColumns | None) -> Iterator[JumpRow]:
    start_ns, end_ns = int(history.time_ns[0]), int(history.time_ns[-1])
    motion = history.motion() if motion is None else motion.within(start_ns, end_ns)
    motion = _without_repeats(motion)
    unlike_m = unexplained_m(steps_of(motion))
    known = np.flatnonzero(np.isfinite(unlike_m))
    if len(known):
        largest = int(known[np.argmax(unlike_m[known])])
        placed_ns = motion.time_ns[motion.known["positions"]]
        at_s = (int(placed_ns[largest + 1]) - start_ns) * 1e-9
        jumps = len(find_jumps(unlike_m, SMALLEST_M))
        yield JumpRow(log, history.filter, len(known), jumps, float(unlike_m[largest]), at_s)


def _without_repeats(motion: ReferenceColumns) -> ReferenceColumns:
    """Take positions once that are told again and again until there is a new one; the velocities all stay."""
    placed = np.flatnonzero(motion.known["positions"])
    again = placed[1:][(np.diff(motion.position[placed, :2], axis=0) == 0.0).all(axis=1)]
    if not len(again):
        return motion
    position = motion.position.copy()
    position[again] = np.nan
    return replace(motion, position=position)
