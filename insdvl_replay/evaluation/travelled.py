"""How far a vehicle went: what errors are percents of, and where segments of a hundred metres end."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, nanoseconds, seconds
from insdvl_replay.core.history import History
from insdvl_replay.evaluation.coverage import WELL_COVERED, covered_share
from insdvl_replay.geometry.frames import north_east_m

CHORD_S: Final = 10.0
"""Steps between positions that are shorter than this add up their noise rather than the way."""


def compared_distance_m(reference: ReferenceColumns, baseline: History, time_ns: TimeNs) -> float:
    """Return the horizontal distance from the start to the last compared position, the same for all filters.

    It is the reference's wherever its velocities, or else its positions, cover the way, for that of a filter errs as
    the filter does. Chords between noisy positions are too long, though, so that the shorter of them and the
    baseline's way counts; with fixes before and after a dive alone, it is the baseline's.

    Parameters
    ----------
    baseline : History
        Its first row is the start.
    time_ns : ndarray, shape (k,)
        In order, times of the reference at which there are positions to compare.
    """
    if not len(time_ns):
        return 0.0
    start_ns, end_ns = int(baseline.time_ns[0]), int(time_ns[-1])
    estimated_m = distance_travelled_m(baseline, time_ns)
    within = reference.within(start_ns, end_ns)
    by_speed, by_positions = (_covers(within, name, start_ns, end_ns) for name in ("velocities", "positions"))
    if not (by_speed or by_positions):
        return estimated_m
    referred_m = float(reference_distance_m(within, np.union1d(start_ns, within.time_ns))[-1])
    return referred_m if by_speed else min(referred_m, estimated_m)


def distance_travelled_m(history: History, time_ns: TimeNs) -> float:
    """Integrate a filter's horizontal speed from the start to the last of some times.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
    """
    if not len(time_ns):
        return 0.0
    rows = history.time_ns <= time_ns[-1]
    speed_mps = np.hypot(history.velocity_n[rows, 0], history.velocity_n[rows, 1])
    return float(np.trapezoid(speed_mps, seconds(history.time_ns[rows], history.time_ns[0])))


def reference_distance_m(reference: ReferenceColumns, time_ns: TimeNs) -> Floats:
    """Return how far the reference has travelled horizontally since the first of some times.

    Its speed is added up; where it gives velocities for too little of the time, chords between its positions.

    Parameters
    ----------
    time_ns : ndarray, shape (k,)
        In order, times of the reference; the first may be another.

    Returns
    -------
    ndarray, shape (k,), m
        NaN where the reference has neither velocity nor position.
    """
    rows = np.isin(reference.time_ns, time_ns)
    moving, located = reference.known["velocities"] & rows, reference.known["positions"] & rows
    by_speed = _covers(reference.rows(rows), "velocities", int(time_ns[0]), int(time_ns[-1]))
    if by_speed or (moving.any() and not located.any()):
        speed_mps = np.hypot(reference.velocity_n[moving, 0], reference.velocity_n[moving, 1])
        since_s = seconds(time_ns, time_ns[0])
        steady_mps = np.interp(since_s, seconds(reference.time_ns[moving], time_ns[0]), speed_mps)
        return _added_up(np.diff(since_s) * (steady_mps[1:] + steady_mps[:-1]) / 2.0)
    if not located.any():
        return np.full(len(time_ns), np.nan)
    ends = np.union1d(thinned(reference.time_ns[located], CHORD_S), np.count_nonzero(located) - 1)
    fix_ns, position = reference.time_ns[located][ends], reference.position[located][ends]
    way_m = _added_up(np.hypot(*north_east_m(position[1:], position[:-1], position[:-1])))
    return np.interp(seconds(time_ns, time_ns[0]), seconds(fix_ns, time_ns[0]), way_m)


def thinned(time_ns: TimeNs, step_s: float) -> NDArray[np.int64]:
    """Return the first row in every step of time."""
    if not len(time_ns):
        return np.empty(0, np.int64)
    _, rows = np.unique((time_ns - time_ns[0]) // nanoseconds(step_s), return_index=True)
    return np.asarray(rows, dtype=np.int64)


def _covers(reference: ReferenceColumns, quantity: str, start_ns: int, end_ns: int) -> bool:
    known = reference.known[quantity]
    return covered_share(reference.time_ns, known, start_ns, end_ns) >= WELL_COVERED


def _added_up(steps: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(steps)])
