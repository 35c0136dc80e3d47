"""All that a filter is told at the nodes of a time line, as columns."""

from typing import NamedTuple

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.nav.timeline import Timeline, instant_at


class Instants(NamedTuple):
    """Readings at k nodes; shapes (k,), (k, 3) and (k, 3)."""

    time_s: Floats
    specific_force_b: Floats
    angular_rate_b: Floats


def instants(timeline: Timeline) -> Instants:
    """Go along a time line as the filter does."""
    rows = [instant_at(timeline, k) for k in range(len(timeline.time_ns))]
    return Instants(*(np.array(column) for column in zip(*rows, strict=True)))
