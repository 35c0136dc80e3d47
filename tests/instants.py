"""All that a filter is told at the nodes of a time line, as columns; and readings of one value."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.nav.algebra import Vector
from insdvl_replay.nav.increments import Readings
from insdvl_replay.nav.timeline import Node, Timeline, first_node, is_event, is_last, next_node


class Instants(NamedTuple):
    """Times, readings and their bends at k nodes; shapes (k,), (k,), and four times (k, 3).

    Of each, the ping that is valid there and the gap that the interval before it lies in, -1 for none, and whether it
    is recorded; shape (k,).
    """

    time_ns: TimeNs
    time_s: Floats
    specific_force_b: Floats
    angular_rate_b: Floats
    force_bend_b: Floats
    rate_bend_b: Floats
    ping: NDArray[np.int64]
    gap: NDArray[np.int64]
    record: NDArray[np.bool_]


def instants(timeline: Timeline) -> Instants:
    """Go along a time line as the filter does."""
    nodes = list(_nodes(timeline))
    event = np.array([node.event for node in nodes])
    here = np.array([is_event(timeline, node) for node in nodes])
    return Instants(
        np.array([node.time_ns for node in nodes]),
        np.array([node.time_s for node in nodes]),
        *np.swapaxes([node.readings for node in nodes], 0, 1),
        np.where(here, timeline.ping[event], -1),
        np.append(-1, timeline.gap[event[:-1]]),
        here & (timeline.record[event] >= 0),
    )


def steady(force_b: Vector, rate_b: Vector) -> Readings:
    """Give readings that stay as they are."""
    still = (0.0, 0.0, 0.0)
    return Readings(force_b, rate_b, still, still)


def _nodes(timeline: Timeline) -> Iterator[Node]:
    node = first_node(timeline)
    yield node
    while not is_last(timeline, node):
        node = next_node(timeline, node)
        yield node
