"""One time line for the filter: the IMU's samples, and between them the events with readings of other sensors.

A ping falls inside an IMU interval. The time line has a node there: the filter propagates to the ping's time of
validity, updates, and finishes the interval. The filter merges samples and events on its way; nodes with their readings
would take more memory than the samples themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ImuColumns, TimeNs, distinct, seconds
from insdvl_replay.core.runtime import inlined
from insdvl_replay.core.states import STATES
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.nav.algebra import Vector, row_vector, scale, subtract
from insdvl_replay.nav.increments import Readings, bend_weights, readings_between

PINGS, BEAMS, FIRST_OTHER = range(3)
"""Rows of a time line: of the DVL's pings with a velocity, of those with any beam; other sensors follow."""
BRIDGE_STEP_S: Final = 1.0
"""Spacing of the nodes inside a gap, short enough for growing uncertainties to act on each other."""


@dataclass(frozen=True)
class Gaps:
    """The long gaps of the IMU in one dive, in the order of time."""

    start_ns: TimeNs  # (g,), the sample before each gap
    end_ns: TimeNs  # (g,), the sample after it
    noise_density: Floats  # (g, 12), what each adds to that of the process noise, see `error_model.noise_density`
    rate_sd_radps: float = 0.0  # how fast the vehicle may turn in a gap

    @property
    def length_s(self) -> Floats:
        """Length of each gap, shape (g,)."""
        return seconds(self.end_ns, self.start_ns)

    def where(self, keep: NDArray[np.bool_]) -> "Gaps":
        """Keep some of the gaps."""
        return Gaps(
            self.start_ns[keep], self.end_ns[keep], self.noise_density[keep], self.rate_sd_radps
        )

    def within(self, start_ns: int, end_ns: int) -> "Gaps":
        """Keep the gaps that a span touches."""
        return self.where((self.start_ns < end_ns) & (self.end_ns > start_ns))

    def overlap(self, from_ns: TimeNs, to_ns: TimeNs) -> NDArray[np.bool_]:
        """Return which intervals contain part of a gap; an interval of no length counts if it is inside one."""
        begun = np.searchsorted(self.start_ns, to_ns, side="left")
        over = np.searchsorted(self.end_ns, from_ns, side="right")
        return np.asarray(begun > over)

    def swing_cov(self, time_ns: TimeNs, lever_arm_b: Floats) -> Floats:
        """Return the covariance of ``w x l`` at times, shape (m, 3, 3): zero outside a gap, where the rate is known."""
        inside = self.overlap(time_ns, time_ns)
        arm = skew(lever_arm_b)
        return inside[:, None, None] * self.rate_sd_radps**2 * (arm @ arm.T)

    def after(self, time_ns: TimeNs) -> NDArray[np.int64]:
        """Return the row of the gap after each time, -1 for none."""
        row = np.searchsorted(self.start_ns, time_ns, side="right") - 1
        over = np.searchsorted(self.end_ns, time_ns, side="right") - 1
        return np.where(row > over, row, -1)

    def node_ns(self) -> TimeNs:
        """Return the nodes that a time line needs: both ends of each gap and some between."""
        steps = np.ceil(self.length_s / BRIDGE_STEP_S).astype(np.int64)
        nodes = [
            start
            # times since 1970 are no floats
            + np.linspace(0, end - start, int(count) + 1, dtype=np.int64)
            for start, end, count in zip(self.start_ns, self.end_ns, steps, strict=True)
        ]
        return np.concatenate([np.empty(0, np.int64), *nodes])

    def longest_stretch(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Return start and end of the longest part of a span without a gap."""
        inside = self.within(start_ns, end_ns)
        starts = np.concatenate([[start_ns], inside.end_ns])
        ends = np.concatenate([inside.start_ns, [end_ns]])
        longest = int(np.argmax(ends - starts))
        return int(starts[longest]), int(ends[longest])


NO_GAPS: Final = Gaps(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, len(STATES))))


class Timeline(NamedTuple):
    """Samples and events, whose times are the nodes between which the filter propagates."""

    # (s,); those that cover the span, and one more on either side where the IMU has one
    sample_ns: TimeNs
    specific_force_b: Floats  # (s, 3), m/s^2
    angular_rate_b: Floats  # (s, 3), rad/s
    event_ns: TimeNs  # (e,), strictly increasing, from start to end; one node with a sample of the same time
    # (sensors, e), row of each sensor's reading at each event, -1 for none; pings first
    rows: NDArray[np.int64]
    # (e,), row of the history for each event, -1 for none; the first has one
    record: NDArray[np.int64]
    gap: NDArray[np.int64]  # (e,), row of the long gap after each event, -1 for none
    gap_noise_density: Floats  # (g, 12), see `Gaps`

    @property
    def ping(self) -> NDArray[np.int64]:
        """Row of the ping at each event, -1 for none, shape (e,); not for compiled code."""
        return np.asarray(self.rows[PINGS])


class Node(NamedTuple):
    """The place of the filter on the time line."""

    time_ns: int
    time_s: float  # seconds from the start
    sample: int  # row of the last sample that is not later
    event: int  # row of the last event that is not later
    readings: Readings  # of a sample or between two


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
    """Merge pings, readings of other sensors and reference times into the IMU's samples.

    Parameters
    ----------
    imu : ImuColumns
        Covers start to end.
    ping_ns : ndarray, shape (m,)
        Times of the velocities, after the start. Readings after the end are left out.
    reference_ns : ndarray, shape (r,)
        Times at which the history needs the state; those outside are left out.
    gaps : Gaps
        The IMU's long gaps, which get nodes.
    others_ns : sequence of ndarray, shape (k,)
        Times of each further sensor's readings, increasing, after the start. Nothing is recorded for them.
    beams_ns : ndarray, shape (k,)
        Times of pings with any beam, for filters aided by single beams.

    Raises
    ------
    ValueError
        The span is outside the IMU's samples, or a reading before its start.
    """
    if start_ns < imu.time_ns[0] or end_ns > imu.time_ns[-1]:
        raise ValueError("the span lies outside the IMU's samples")
    sensors_ns = [
        time_ns[: np.searchsorted(time_ns, end_ns, "right")]
        for time_ns in (ping_ns, beams_ns, *others_ns)
    ]
    if any(len(time_ns) and time_ns[0] <= start_ns for time_ns in sensors_ns):
        raise ValueError("a reading lies before the start")

    def inside(time_ns: TimeNs) -> TimeNs:
        return np.asarray(time_ns[(time_ns > start_ns) & (time_ns < end_ns)])

    def row_at(time_ns: TimeNs) -> NDArray[np.int64]:
        row = np.full(len(event_ns), -1)
        row[np.searchsorted(event_ns, time_ns)] = np.arange(len(time_ns))
        return row

    gaps = gaps.within(start_ns, end_ns)
    ends_ns = np.array([start_ns, end_ns], dtype=np.int64)
    recorded_ns = distinct(np.concatenate([ends_ns, sensors_ns[PINGS], inside(reference_ns)]))
    event_ns = distinct(np.concatenate([recorded_ns, *sensors_ns, inside(gaps.node_ns())]))
    covering = samples_around(imu.time_ns, start_ns, end_ns)
    # The loop is compiled for contiguous, writable columns; others are copied.
    return Timeline(
        np.require(imu.time_ns[covering], requirements=["C", "W"]),
        np.require(imu.specific_force_b[covering], requirements=["C", "W"]),
        np.require(imu.angular_rate_b[covering], requirements=["C", "W"]),
        event_ns,
        np.stack([row_at(time_ns) for time_ns in sensors_ns]),
        row_at(recorded_ns),
        gaps.after(event_ns),
        gaps.noise_density,
    )


def samples_around(sample_ns: TimeNs, start_ns: int, end_ns: int) -> slice:
    """Return the rows of the samples that cover a span, and of one more on either side, by which they bend."""
    first = int(np.searchsorted(sample_ns, start_ns, side="right")) - 2
    last = int(np.searchsorted(sample_ns, end_ns)) + 1
    return slice(max(first, 0), min(last, len(sample_ns) - 1) + 1)


@inlined
def first_node(timeline: Timeline) -> Node:
    """Return the node at the start."""
    sample = 0
    while (
        sample + 1 < len(timeline.sample_ns)
        and timeline.sample_ns[sample + 1] <= timeline.event_ns[0]
    ):
        sample += 1
    return _node(timeline, timeline.event_ns[0], sample, 0)


@inlined
def next_node(timeline: Timeline, before: Node) -> Node:
    """Return the next sample or event, whichever is earlier."""
    sample_ns, event_ns = (
        timeline.sample_ns[before.sample + 1],
        timeline.event_ns[before.event + 1],
    )
    sample, event = before.sample + (sample_ns <= event_ns), before.event + (event_ns <= sample_ns)
    return _node(timeline, min(sample_ns, event_ns), sample, event)


@inlined
def is_last(timeline: Timeline, node: Node) -> bool:
    """Return whether a node is the end of the time line."""
    return node.event == len(timeline.event_ns) - 1


@inlined
def is_event(timeline: Timeline, node: Node) -> bool:
    """Return whether a node is an event, and not only a sample."""
    here: bool = node.time_ns == timeline.event_ns[node.event]
    return here


@inlined
def _node(
    timeline: Timeline,
    time_ns: int,
    sample: int,
    event: int,
) -> Node:
    start_ns = timeline.event_ns[0]
    time_s, before_s = (time_ns - start_ns) * 1e-9, (timeline.sample_ns[sample] - start_ns) * 1e-9
    before = _readings_at(timeline, sample)
    if time_s == before_s:
        return Node(time_ns, time_s, sample, event, before)
    into_s, step_s = (
        time_s - before_s,
        (timeline.sample_ns[sample + 1] - start_ns) * 1e-9 - before_s,
    )
    return Node(
        time_ns,
        time_s,
        sample,
        event,
        readings_between(before, _readings_at(timeline, sample + 1), into_s, step_s),
    )


@inlined
def _readings_at(timeline: Timeline, sample: int) -> Readings:
    """Read a sample, and how readings bend there; at the first and the last sample as at the ones next to them."""
    force_b, rate_b = (
        row_vector(timeline.specific_force_b, sample),
        row_vector(timeline.angular_rate_b, sample),
    )
    samples = len(timeline.sample_ns)
    if samples < 3:
        return Readings(force_b, rate_b, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    middle = min(max(sample, 1), samples - 2)
    before_ns = timeline.sample_ns[middle] - timeline.sample_ns[middle - 1]
    after_ns = timeline.sample_ns[middle + 1] - timeline.sample_ns[middle]
    weights = bend_weights(before_ns * 1e-9, after_ns * 1e-9)
    return Readings(
        force_b,
        rate_b,
        _bend(timeline.specific_force_b, middle, weights),
        _bend(timeline.angular_rate_b, middle, weights),
    )


@inlined
def _bend(readings: Floats, middle: int, weights: tuple[float, float]) -> Vector:
    here = row_vector(readings, middle)
    from_before, to_after = (
        subtract(here, row_vector(readings, middle - 1)),
        subtract(row_vector(readings, middle + 1), here),
    )
    return subtract(scale(weights[1], to_after), scale(weights[0], from_before))
