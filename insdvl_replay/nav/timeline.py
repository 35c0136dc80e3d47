"""One time line for the filter: the IMU's samples, and between them the events at which more than a reading is at hand.

A ping falls inside an IMU interval. The time line has a node there, so that the filter propagates to the ping's time of
validity, updates, and finishes the interval. Samples and events are merged as the filter goes along: nodes with their
readings would take more memory than the samples themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ImuColumns, Scalar, TimeNs, distinct, seconds
from insdvl_replay.core.runtime import inlined
from insdvl_replay.core.states import STATES
from insdvl_replay.nav.algebra import Vector, add, row_vector, scale, subtract

PINGS: Final = 0
"""The sensor whose readings are the DVL's pings: its row in the time line."""
BEAMS: Final = 1
"""The one whose readings are pings of which any beam was heard; those of other sensors come behind."""
FIRST_OTHER: Final = 2
BRIDGE_STEP_S: Final = 1.0
"""Spacing of the nodes inside a gap: short enough that growing uncertainties see each other grow."""


@dataclass(frozen=True)
class Gaps:
    """The long gaps of one dive, in the order of time.

    Attributes
    ----------
    start_ns, end_ns : ndarray, shape (g,)
        The samples before and after each gap.
    noise_density : ndarray, shape (g, 12)
        What each adds to the diagonal of the process noise's spectral density, see `error_model.noise_density`.
    rate_sd_radps : float
        How fast the vehicle may turn in them, unseen.
    """

    start_ns: TimeNs
    end_ns: TimeNs
    noise_density: Floats
    rate_sd_radps: float = 0.0

    @property
    def length_s(self) -> Floats:
        """How long each gap is, shape (g,)."""
        return seconds(self.end_ns, self.start_ns)

    def where(self, keep: NDArray[np.bool_]) -> "Gaps":
        """Keep some of the gaps."""
        return Gaps(self.start_ns[keep], self.end_ns[keep], self.noise_density[keep], self.rate_sd_radps)

    def within(self, start_ns: int, end_ns: int) -> "Gaps":
        """Keep the gaps that a span touches."""
        return self.where((self.start_ns < end_ns) & (self.end_ns > start_ns))

    def overlap(self, from_ns: TimeNs, to_ns: TimeNs) -> NDArray[np.bool_]:
        """Find which of some intervals hold part of a gap; an interval of no length, whether it lies inside one.

        Parameters
        ----------
        from_ns, to_ns : ndarray, shape (k,)
            Ends of the intervals.

        Returns
        -------
        ndarray of bool, shape (k,)
        """
        begun = np.searchsorted(self.start_ns, to_ns, side="left")
        over = np.searchsorted(self.end_ns, from_ns, side="right")
        return np.asarray(begun > over)

    def after(self, time_ns: TimeNs) -> NDArray[np.int64]:
        """Return the row of the gap that lies after each of some times, -1 for none; shape as the times."""
        row = np.searchsorted(self.start_ns, time_ns, side="right") - 1
        over = np.searchsorted(self.end_ns, time_ns, side="right") - 1
        return np.where(row > over, row, -1)

    def node_ns(self) -> TimeNs:
        """Return the times at which a time line needs nodes: both ends of each gap and some between, shape (n,)."""
        steps = np.ceil(self.length_s / BRIDGE_STEP_S).astype(np.int64)
        nodes = [
            start + np.linspace(0, end - start, int(count) + 1, dtype=np.int64)  # times since 1970 are no floats
            for start, end, count in zip(self.start_ns, self.end_ns, steps, strict=True)
        ]
        return np.concatenate([np.empty(0, np.int64), *nodes])

    def longest_stretch(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return the longest part of a span that has no gap.

        Returns
        -------
        tuple of int
            Start and end, ns.
        """
        inside = self.within(start_ns, end_ns)
        starts = np.concatenate([[start_ns], inside.end_ns])
        ends = np.concatenate([inside.start_ns, [end_ns]])
        longest = int(np.argmax(ends - starts))
        return int(starts[longest]), int(ends[longest])


NO_GAPS: Final = Gaps(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, len(STATES))))
"""What a gapless dive has."""


class Timeline(NamedTuple):
    """Samples and events, whose times are the nodes between which the filter propagates.

    Attributes
    ----------
    sample_ns : ndarray, shape (s,)
        Times of the IMU's samples; the first is at or before the start, the last at or after the end.
    specific_force_b, angular_rate_b : ndarray, shape (s, 3)
        Readings of the samples, m/s^2 and rad/s.
    event_ns : ndarray, shape (e,)
        Strictly increasing, from start to end; where a sample has the same time, both are one node.
    rows : ndarray of int, shape (s, e)
        Row of each sensor's reading that is valid at each event, -1 for none; the first sensor's are the DVL's pings.
    record : ndarray of int, shape (e,)
        Row of the history that keeps each event, -1 for none; the first is kept.
    gap : ndarray of int, shape (e,)
        Row of the long gap that lies after each event, -1 for none.
    gap_noise_density : ndarray, shape (g, 12)
        What each long gap adds to the density of the process noise, see `Gaps`.
    """

    sample_ns: TimeNs
    specific_force_b: Floats
    angular_rate_b: Floats
    event_ns: TimeNs
    rows: NDArray[np.int64]
    record: NDArray[np.int64]
    gap: NDArray[np.int64]
    gap_noise_density: Floats

    @property
    def ping(self) -> NDArray[np.int64]:
        """Row of the ping that is valid at each event, -1 for none, shape (e,); not to be asked by what is compiled."""
        return np.asarray(self.rows[PINGS])


class Node(NamedTuple):
    """Where the filter is on the time line.

    Attributes
    ----------
    time_s : float
        Seconds from the start.
    sample, event : int
        Rows of the last sample and of the last event that are not later.
    specific_force_b, angular_rate_b : tuple of float
        Readings, m/s^2 and rad/s: those of a sample, or on the line between two.
    """

    time_ns: int
    time_s: float
    sample: int
    event: int
    specific_force_b: Vector
    angular_rate_b: Vector


NEVER: Final = np.empty(0, np.int64)


def build_timeline(
    imu: ImuColumns,
    ping_ns: TimeNs,
    reference_ns: TimeNs,
    start_ns: int,
    end_ns: int,
    gaps: Gaps = NO_GAPS,
    others_ns: Sequence[TimeNs] = (),
    beams_ns: TimeNs = NEVER,
) -> Timeline:
    """Set pings, readings of other sensors and reference times among the IMU's samples.

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
    others_ns : sequence of ndarray, shape (k,)
        Times of the readings of each further sensor, increasing, after the start and up to the end. No state is kept
        for them.
    beams_ns : ndarray, shape (k,)
        Times of pings of which any beam was heard, where a filter is aided by single beams.

    Raises
    ------
    ValueError
        A reading or the span lies outside the IMU's samples.
    """
    if start_ns < imu.time_ns[0] or end_ns > imu.time_ns[-1]:
        raise ValueError("the span lies outside the IMU's samples")
    sensors_ns = (ping_ns, beams_ns, *others_ns)
    if any(len(time_ns) and (time_ns[0] <= start_ns or time_ns[-1] > end_ns) for time_ns in sensors_ns):
        raise ValueError("a reading lies outside the span")
    gaps = gaps.within(start_ns, end_ns)
    ends_ns = np.array([start_ns, end_ns], dtype=np.int64)
    recorded_ns = distinct(np.concatenate([ends_ns, ping_ns, _inside(reference_ns, ends_ns)]))
    event_ns = distinct(np.concatenate([recorded_ns, *sensors_ns, _inside(gaps.node_ns(), ends_ns)]))
    covering = slice(np.searchsorted(imu.time_ns, start_ns, side="right") - 1, np.searchsorted(imu.time_ns, end_ns) + 1)
    return Timeline(
        _for_the_loop(imu.time_ns[covering]),
        _for_the_loop(imu.specific_force_b[covering]),
        _for_the_loop(imu.angular_rate_b[covering]),
        event_ns,
        np.stack([_row_at(event_ns, time_ns) for time_ns in sensors_ns]),
        _row_at(event_ns, recorded_ns),
        gaps.after(event_ns),
        gaps.noise_density,
    )


def _inside(time_ns: TimeNs, ends_ns: TimeNs) -> TimeNs:
    inside: TimeNs = time_ns[(time_ns > ends_ns[0]) & (time_ns < ends_ns[1])]
    return inside


def _row_at(event_ns: TimeNs, time_ns: TimeNs) -> NDArray[np.int64]:
    """Return the row that each event has among other times, which are all events; -1 for none."""
    row = np.full(len(event_ns), -1)
    row[np.searchsorted(event_ns, time_ns)] = np.arange(len(time_ns))
    return row


def _for_the_loop(column: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return a column as the loop is compiled for; only a strided one, or one that cannot be written to, is copied."""
    return np.require(column, requirements=["C", "W"])


@inlined
def first_node(timeline: Timeline) -> Node:
    """Return the node at the start."""
    return _node(timeline, timeline.event_ns[0], 0, 0)


@inlined
def next_node(timeline: Timeline, before: Node) -> Node:
    """Go on to the next sample or event, whichever comes first."""
    sample_ns, event_ns = timeline.sample_ns[before.sample + 1], timeline.event_ns[before.event + 1]
    sample, event = before.sample + (sample_ns <= event_ns), before.event + (event_ns <= sample_ns)
    return _node(timeline, min(sample_ns, event_ns), sample, event)


@inlined
def is_last(timeline: Timeline, node: Node) -> bool:
    """Return whether a node is the end of the time line."""
    return node.event == len(timeline.event_ns) - 1


@inlined
def is_event(timeline: Timeline, node: Node) -> bool:
    """Return whether a node is an event, and not a sample alone."""
    here: bool = node.time_ns == timeline.event_ns[node.event]
    return here


@inlined
def _node(timeline: Timeline, time_ns: int, sample: int, event: int) -> Node:
    time_s, before_s = _elapsed_s(timeline, time_ns), _elapsed_s(timeline, timeline.sample_ns[sample])
    force_b, rate_b = row_vector(timeline.specific_force_b, sample), row_vector(timeline.angular_rate_b, sample)
    if time_s == before_s:
        return Node(time_ns, time_s, sample, event, force_b, rate_b)
    into_s, step_s = time_s - before_s, _elapsed_s(timeline, timeline.sample_ns[sample + 1]) - before_s
    return Node(
        time_ns,
        time_s,
        sample,
        event,
        _on_the_line(force_b, row_vector(timeline.specific_force_b, sample + 1), into_s, step_s),
        _on_the_line(rate_b, row_vector(timeline.angular_rate_b, sample + 1), into_s, step_s),
    )


@inlined
def _elapsed_s(timeline: Timeline, time_ns: int) -> float:
    since_s: float = (time_ns - timeline.event_ns[0]) * 1e-9
    return since_s


@inlined
def _on_the_line(before: Vector, after: Vector, into_s: float, step_s: float) -> Vector:
    step = subtract(after, before)
    return (
        step[0] / step_s * into_s + before[0],
        step[1] / step_s * into_s + before[1],
        step[2] / step_s * into_s + before[2],
    )


@inlined
def mean(one: Vector, other: Vector) -> Vector:
    """Return the mean of a reading over an interval, from those at its ends."""
    return scale(0.5, add(one, other))
