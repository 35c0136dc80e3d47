"""One time line for the filter: IMU samples, pings and reference times merged, readings interpolated between samples.

A ping falls inside an IMU interval. The time line has a node there, so that the filter propagates to the ping's time of
validity, updates, and finishes the interval.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.columns import Floats, ImuColumns, TimeNs, seconds
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.gaps import NO_GAPS, Gaps
from insdvl_replay.nav.vector_algebra import Vector


@dataclass(frozen=True)
class Timeline:
    """Nodes between which the filter propagates.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Strictly increasing, from start to end.
    time_s : ndarray, shape (k,)
        Seconds from the start.
    specific_force_b, angular_rate_b : ndarray, shape (k, 3)
        Readings, linear between samples, m/s^2 and rad/s.
    ping : ndarray of int, shape (k,)
        Row of the ping that is valid here, -1 for none.
    record : ndarray of bool, shape (k,)
        Whether the history keeps this node.
    gap : ndarray of int, shape (k,)
        Row of the long gap that the interval before this node lies in, -1 for none.
    gap_noise_density : ndarray, shape (g, 12)
        What each long gap adds to the density of the process noise, see `gaps.Gaps`.
    """

    time_ns: TimeNs
    time_s: Floats
    specific_force_b: Floats
    angular_rate_b: Floats
    ping: NDArray[np.int64]
    record: NDArray[np.bool_]
    gap: NDArray[np.int32]
    gap_noise_density: Floats


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
    kept = np.unique(np.concatenate([[start_ns, end_ns], ping_ns, inside]).astype(np.int64))
    gaps = gaps.within(start_ns, end_ns)
    between = np.concatenate([imu.time_ns, gaps.bridge_ns()])
    time_ns = _merged(between[(between > start_ns) & (between < end_ns)], kept)
    ping = np.full(len(time_ns), -1, dtype=np.int64)
    ping[np.searchsorted(time_ns, ping_ns)] = np.arange(len(ping_ns))
    record = np.zeros(len(time_ns), dtype=np.bool_)
    record[np.searchsorted(time_ns, kept)] = True
    time_s = seconds(time_ns, start_ns)
    sample_s = seconds(imu.time_ns, start_ns)
    return Timeline(
        time_ns,
        time_s,
        _interpolated(time_s, sample_s, imu.specific_force_b),
        _interpolated(time_s, sample_s, imu.angular_rate_b),
        ping,
        record,
        _gap_rows(time_ns, gaps),
        gaps.noise_density,
    )


def _merged(one: TimeNs, other: TimeNs) -> TimeNs:
    """Unite times; a stable sort merges runs that are sorted already in a hundredth of the time of any other."""
    time_ns = np.sort(np.concatenate([one, other]), kind="stable")
    once: TimeNs = time_ns[np.append(True, time_ns[1:] > time_ns[:-1])]
    return once


def _gap_rows(time_ns: TimeNs, gaps: Gaps) -> NDArray[np.int32]:
    """Name the gap of each interval; its ends are nodes, so that no interval lies in it by half."""
    rows = np.full(len(time_ns), -1, dtype=np.int32)
    inside = 1 + np.flatnonzero(gaps.overlap(time_ns[:-1], time_ns[1:]))
    rows[inside] = np.searchsorted(gaps.start_ns, time_ns[inside]) - 1
    return rows


def _interpolated(time_s: Floats, sample_s: Floats, readings: Floats) -> Floats:
    return np.column_stack([np.interp(time_s, sample_s, readings[:, axis]) for axis in range(3)])


@compiled
def mean_reading(readings: Floats, k: int) -> Vector:
    """Give the mean of a reading over the interval before node k."""
    return (
        0.5 * (readings[k - 1, 0] + readings[k, 0]),
        0.5 * (readings[k - 1, 1] + readings[k, 1]),
        0.5 * (readings[k - 1, 2] + readings[k, 2]),
    )
