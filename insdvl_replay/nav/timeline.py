"""One time line for the filter: IMU samples, pings and reference times merged, readings interpolated between samples.

A ping falls inside an IMU interval. The time line has a node there, so that the filter propagates to the ping's time of
validity, updates, and finishes the interval. Readings are interpolated as the filter goes along: a copy for each node
would take more memory than the samples themselves.
"""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, ImuColumns, TimeNs
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.gaps import NO_GAPS, Gaps
from insdvl_replay.nav.vector_algebra import Vector, add, scale, vector

Scalar = TypeVar("Scalar", bound=np.generic)


class Timeline(NamedTuple):
    """Nodes between which the filter propagates, and the samples whose readings it takes.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Strictly increasing, from start to end.
    sample : ndarray of int, shape (k,)
        Row of the last sample at or before each node.
    ping : ndarray of int, shape (k,)
        Row of the ping that is valid here, -1 for none.
    record : ndarray of bool, shape (k,)
        Whether the history keeps this node.
    gap : ndarray of int, shape (k,)
        Row of the long gap that the interval before this node lies in, -1 for none.
    gap_noise_density : ndarray, shape (g, 12)
        What each long gap adds to the density of the process noise, see `gaps.Gaps`.
    sample_ns : ndarray, shape (s,)
        Times of the IMU's samples.
    specific_force_b, angular_rate_b : ndarray, shape (s, 3)
        Readings of the samples, m/s^2 and rad/s.
    """

    time_ns: TimeNs
    sample: NDArray[np.int32]
    ping: NDArray[np.int32]
    record: NDArray[np.bool_]
    gap: NDArray[np.int32]
    gap_noise_density: Floats
    sample_ns: TimeNs
    specific_force_b: Floats
    angular_rate_b: Floats


class Instant(NamedTuple):
    """The readings at a node.

    Attributes
    ----------
    time_s : float
        Seconds from the start.
    specific_force_b, angular_rate_b : tuple of float
        m/s^2 and rad/s.
    """

    time_s: float
    specific_force_b: Vector
    angular_rate_b: Vector


def build_timeline(
    imu: ImuColumns, ping_ns: TimeNs, reference_ns: TimeNs, start_ns: int, end_ns: int, gaps: Gaps = NO_GAPS
) -> Timeline:
    """Merge the IMU's samples with pings and reference times.

    Parameters
    ----------
    imu : ImuColumns
        Covers start to end.
    ping_ns : ndarray, shape (m,)
        Times of the velocities, after the start and up to the end.
    reference_ns : ndarray, shape (r,)
        Times at which to keep the state for comparison; those outside are left out.
    start_ns, end_ns : int
        Span of the replay.
    gaps : Gaps
        The IMU's long gaps; in each the time line has nodes of its own.

    Returns
    -------
    Timeline

    Raises
    ------
    ValueError
        A ping or the span lies outside the IMU's samples.
    """
    if start_ns < imu.time_ns[0] or end_ns > imu.time_ns[-1]:
        raise ValueError("the span lies outside the IMU's samples")
    if len(ping_ns) and (ping_ns[0] <= start_ns or ping_ns[-1] > end_ns):
        raise ValueError("a ping lies outside the span")
    inside = reference_ns[(reference_ns > start_ns) & (reference_ns < end_ns)]
    kept = _merged(np.array([start_ns, end_ns], dtype=np.int64), ping_ns, inside)
    gaps = gaps.within(start_ns, end_ns)
    time_ns = _merged(_between(imu.time_ns, start_ns, end_ns), _between(gaps.bridge_ns(), start_ns, end_ns), kept)
    sample = np.searchsorted(imu.time_ns, time_ns, side="right").astype(np.int32)
    sample -= 1
    ping = np.full(len(time_ns), -1, dtype=np.int32)
    ping[np.searchsorted(time_ns, ping_ns)] = np.arange(len(ping_ns))
    record = np.zeros(len(time_ns), dtype=np.bool_)
    record[np.searchsorted(time_ns, kept)] = True
    return Timeline(
        time_ns,
        sample,
        ping,
        record,
        _gap_rows(time_ns, gaps),
        gaps.noise_density,
        _for_the_loop(imu.time_ns),
        _for_the_loop(imu.specific_force_b),
        _for_the_loop(imu.angular_rate_b),
    )


def _between(time_ns: TimeNs, start_ns: int, end_ns: int) -> TimeNs:
    first, last = np.searchsorted(time_ns, start_ns, side="right"), np.searchsorted(time_ns, end_ns, side="left")
    return time_ns[first:last]


def _merged(*times_ns: TimeNs) -> TimeNs:
    """Unite times; a stable sort merges runs that are sorted already in a hundredth of the time of any other."""
    time_ns = np.concatenate(times_ns)
    time_ns.sort(kind="stable")
    once: TimeNs = time_ns[np.append(True, time_ns[1:] > time_ns[:-1])]
    return once


def _gap_rows(time_ns: TimeNs, gaps: Gaps) -> NDArray[np.int32]:
    """Name the gap of each interval; its ends are nodes, so that no interval lies in it by half."""
    rows = np.full(len(time_ns), -1, dtype=np.int32)
    firsts = np.maximum(np.searchsorted(time_ns, gaps.start_ns, side="right"), 1)
    lasts = np.searchsorted(time_ns, gaps.end_ns, side="left")
    for row, (first, last) in enumerate(zip(firsts, lasts, strict=True)):
        rows[first : last + 1] = row
    return rows


def _for_the_loop(column: NDArray[Scalar]) -> NDArray[Scalar]:
    """Give a column as the loop is compiled for; only a strided one, or one that cannot be written to, is copied."""
    return np.require(column, requirements=["C", "W"])


@compiled
def instant_at(timeline: Timeline, k: int) -> Instant:
    """Give the readings at node k: those of a sample, or on the line between two.

    Parameters
    ----------
    timeline : Timeline
    k : int

    Returns
    -------
    Instant
    """
    row = timeline.sample[k]
    time_s, before_s = _elapsed_s(timeline, timeline.time_ns[k]), _elapsed_s(timeline, timeline.sample_ns[row])
    force_b, rate_b = vector(timeline.specific_force_b[row]), vector(timeline.angular_rate_b[row])
    if time_s == before_s:
        return Instant(time_s, force_b, rate_b)
    into_s, step_s = time_s - before_s, _elapsed_s(timeline, timeline.sample_ns[row + 1]) - before_s
    return Instant(
        time_s,
        _on_the_line(force_b, timeline.specific_force_b[row + 1], into_s, step_s),
        _on_the_line(rate_b, timeline.angular_rate_b[row + 1], into_s, step_s),
    )


@compiled
def _elapsed_s(timeline: Timeline, time_ns: int) -> float:
    since_s: float = (time_ns - timeline.time_ns[0]) * 1e-9
    return since_s


@compiled
def _on_the_line(before: Vector, after: Floats, into_s: float, step_s: float) -> Vector:
    return (
        (after[0] - before[0]) / step_s * into_s + before[0],
        (after[1] - before[1]) / step_s * into_s + before[1],
        (after[2] - before[2]) / step_s * into_s + before[2],
    )


@compiled
def mean(one: Vector, other: Vector) -> Vector:
    """Give the mean of a reading over an interval, from those at its ends."""
    return scale(0.5, add(one, other))
