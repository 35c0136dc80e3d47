"""Absolute and relative pose errors (APE, RPE) of a trajectory, as evo gives them.

Poses are associated by their nearest stamps; nothing is interpolated. Sources: Sturm et al., "A benchmark for the
evaluation of RGB-D SLAM systems", 2012, for both errors; the documentation of evo 1.38 for the rules of association,
for pairs of poses and for statistics. A test compares all numbers with those of evo.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, Integers, TimeNs
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import vector_from_mat

MAX_DIFF_S: Final = 0.01
TOLERANCE: Final = 0.1  # share of a length by which all pairs may miss it


@dataclass(frozen=True)
class Poses:
    """Poses at k times; orientations may be unknown."""

    time_ns: TimeNs  # (k,)
    position_m: Floats  # (k, 3)
    mat: Floats  # (k, 3, 3) from body to the frame of the positions

    def rows(self, rows: Integers) -> "Poses":
        """Return some of the poses."""
        return Poses(self.time_ns[rows], self.position_m[rows], self.mat[rows])


class Delta(NamedTuple):
    """How far the two poses of a pair are apart."""

    size: float
    unit: str  # ``f`` for poses, or ``m`` travelled

    @property
    def text(self) -> str:
        """The length with its unit."""
        return f"{self.size:g} {self.unit}"


class PairIds(NamedTuple):
    """The first and last poses of p pairs."""

    first: Integers  # (p,)
    last: Integers


class Statistics(NamedTuple):
    """Statistics of some errors."""

    poses: int  # or pairs
    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    sse: float


# Quantities by the end of their name, with their units.
PARTS: Final = {"translation": "m", "rotation": "", "angle": "deg", "full": ""}


# --- Which poses belong together.


def associated(
    reference: Poses, estimate: Poses, max_diff_s: float = MAX_DIFF_S
) -> tuple[Poses, Poses]:
    """Return the poses of both whose stamps are nearest to each other, and at most so far apart.

    Each pose of the trajectory with fewer poses, of equal ones the estimate, gets the nearest one of the other.
    """
    if len(estimate.time_ns) > len(reference.time_ns):
        ours, theirs = _nearest(reference.time_ns, estimate.time_ns, max_diff_s)
        return reference.rows(ours), estimate.rows(theirs)
    ours, theirs = _nearest(estimate.time_ns, reference.time_ns, max_diff_s)
    return reference.rows(theirs), estimate.rows(ours)


def _nearest(few_ns: TimeNs, many_ns: TimeNs, max_diff_s: float) -> tuple[Integers, Integers]:
    """Pair each of some times with the nearest of others, by seconds as files have them; of two the earlier."""
    empty = np.empty(0, np.int64)
    if not len(few_ns) or not len(many_ns):
        return empty, empty
    few_s = _as_seconds(few_ns)
    many_s = _as_seconds(many_ns)
    found = np.searchsorted(many_s, few_s, side="right")
    after = np.minimum(found, len(many_s) - 1)
    before = np.maximum(after - 1, 0)
    until_after_s = many_s[after] - few_s
    since_before_s = np.where(after > 0, few_s - many_s[before], np.inf)
    is_after = (until_after_s <= max_diff_s) & (until_after_s < since_before_s)
    is_before = (since_before_s <= max_diff_s) & (since_before_s <= until_after_s)
    inside = (few_s >= many_s[0] - max_diff_s) & (few_s <= many_s[-1] + max_diff_s)
    kept = np.flatnonzero((is_after | is_before) & inside)
    return kept, np.where(is_after, after, before)[kept]


def _as_seconds(time_ns: TimeNs) -> Floats:
    """Return times as the nearest floating-point numbers of seconds."""
    whole, rest = np.divmod(time_ns, NS_PER_S)
    return np.asarray(whole + rest / NS_PER_S)


# --- Absolute errors.


def absolute_errors(reference: Poses, estimate: Poses) -> dict[str, Floats]:
    """Return the errors of associated poses, shape (k,), by part; those of unknown orientations are left out."""
    shift_m = estimate.position_m - reference.position_m
    found = {"translation": _lengths(shift_m)}
    known = _with_orientation(reference, estimate)
    turned = np.swapaxes(reference.mat[known], 1, 2)
    found |= _of_rotations(turned @ estimate.mat[known], shift_m[known])
    return found


def _with_orientation(*poses: Poses) -> Integers:
    """Return the rows at which all poses have an orientation."""
    known = np.ones(len(poses[0].time_ns), np.bool_)
    for each in poses:
        known &= np.isfinite(each.mat).all(axis=(1, 2))
    return np.flatnonzero(known)


def _lengths(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt(np.sum(vectors**2, axis=1)))


def _of_rotations(error: Floats, shift_m: Floats) -> dict[str, Floats]:
    """Return the errors of rotations, shape (k, 3, 3), and of whole poses with some shifts, shape (k, 3)."""
    if not len(error):
        return {}
    squares = np.sum((error - np.eye(3)) ** 2, axis=(1, 2))
    return {
        "rotation": np.sqrt(squares),
        "angle": _lengths(vector_from_mat(error)) / DEG,
        "full": np.sqrt(squares + np.sum(shift_m**2, axis=1)),
    }


# --- Relative errors.


def relative_errors(reference: Poses, estimate: Poses, pairs: PairIds) -> dict[str, Floats]:
    """Return the errors of the motion from the first to the last pose of each pair, shape (p,), by part.

    The motion is seen from the first pose, so that an orientation is needed there and at the end.
    """
    known = np.zeros(len(reference.time_ns), np.bool_)
    known[_with_orientation(reference, estimate)] = True
    usable = known[pairs.first] & known[pairs.last]
    first = pairs.first[usable]
    last = pairs.last[usable]
    turn, way_m = _motion(reference, first, last)
    own_turn, own_way_m = _motion(estimate, first, last)
    turned = np.swapaxes(turn, 1, 2)
    shift_m = np.einsum("kij,kj->ki", turned, own_way_m - way_m)
    if not len(first):
        return {}
    return {"translation": _lengths(shift_m), **_of_rotations(turned @ own_turn, shift_m)}


def _motion(poses: Poses, first: Integers, last: Integers) -> tuple[Floats, Floats]:
    """Return rotation and displacement from poses to others, seen from the first ones."""
    inverse = np.swapaxes(poses.mat[first], 1, 2)
    way_m = poses.position_m[last] - poses.position_m[first]
    return inverse @ poses.mat[last], np.einsum("kij,kj->ki", inverse, way_m)


def pairs_of_poses(estimate: Poses, delta: Delta, *, all_pairs: bool = False) -> PairIds:
    """Choose pairs of poses that are some poses, or some metres of the estimate's way, apart.

    Consecutive pairs share their ends. With all pairs one begins at each pose.
    """
    count = len(estimate.time_ns)
    if delta.unit == "f":
        step = max(round(min(delta.size, count)), 1)
        first = np.arange(0, count - step, 1 if all_pairs else step)
        return PairIds(first, first + step)
    steps_m = _lengths(np.diff(estimate.position_m, axis=0))
    if all_pairs:
        return _all_pairs(steps_m, delta.size)
    ids = np.fromiter(_ends_of_lengths(steps_m, delta.size), np.int64)
    return PairIds(ids[:-1], ids[1:])


def _ends_of_lengths(steps_m: Floats, length_m: float) -> Iterator[int]:
    """Yield the poses at which a length has been travelled since the one before."""
    yield 0
    begin = 0
    block = 64
    while begin < len(steps_m):
        travelled_m = np.cumsum(steps_m[begin : begin + block])
        reached = np.flatnonzero(travelled_m >= length_m)
        if len(reached):
            begin += int(reached[0]) + 1
            yield begin
        elif begin + block >= len(steps_m):
            return
        else:
            block *= 2


def _all_pairs(steps_m: Floats, length_m: float) -> PairIds:
    """Pair each pose with the later one that is nearest to a length away, if it is within `TOLERANCE`."""
    travelled_m = np.concatenate([np.zeros(1), np.cumsum(steps_m)])
    first = np.arange(len(travelled_m) - 1)
    after = np.searchsorted(travelled_m, travelled_m[first] + length_m).clip(first + 1, None)
    after = np.minimum(after, len(travelled_m) - 1)
    before = np.maximum(after - 1, first + 1)
    off_after_m = np.abs(travelled_m[after] - travelled_m[first] - length_m)
    off_before_m = np.abs(travelled_m[before] - travelled_m[first] - length_m)
    last = np.where(off_after_m < off_before_m, after, before)
    # Of poses at rest the first one counts.
    last = np.maximum(np.searchsorted(travelled_m, travelled_m[last]), first + 1)
    near = np.minimum(off_after_m, off_before_m) <= length_m * TOLERANCE
    return PairIds(first[near], last[near])


def statistics(errors: Floats) -> Statistics:
    """Return the statistics of errors, shape (k,)."""
    squares = errors**2
    return Statistics(
        poses=len(errors),
        rmse=math.sqrt(float(np.mean(squares))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        std=float(np.std(errors)),
        min=float(np.min(errors)),
        max=float(np.max(errors)),
        sse=float(np.sum(squares)),
    )
