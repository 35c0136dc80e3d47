"""Shades behind the panels over time: where the vehicle turned, and where the DVL has no velocity."""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Integers, Mask, TimeNs, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.document.parts import Shade
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle
from insdvl_replay.preparation.replay import Replay

# In a turn the heading changes by more, over the time of several pings.
TURNS_DEGPS = 1.5
OVER_S = 10.0
SILENT: Final = 3.0  # A gap of the DVL is longer than this many usual steps.
# With more stretches of a kind, none is shaded, since they would hide the curves.
MOST: Final = 40


def shades_of(replay: Replay) -> tuple[Shade, ...]:
    """Find what is shaded behind the panels over time of a replay."""
    clock = Clock(replay.start_ns, replay.end_ns)
    shades = []
    for style, stretches in (("turn", _turns(replay.histories[0])), ("silent", _silences(replay))):
        if len(stretches) <= MOST:
            for begin, end in clock.time(stretches):
                shades.append(Shade(float(begin), float(end), style))
    return tuple(shades)


def _turns(baseline: History) -> TimeNs:
    """Find the stretches in which the heading turns, shape (turns, 2)."""
    rows = np.flatnonzero(baseline.updated)
    if len(rows) < 3:
        return np.empty((0, 2), dtype=np.int64)
    time_ns = baseline.time_ns[rows]
    heading = rpy_from_mat(baseline.mat_nb[rows])[:, 2]
    unwrapped = np.cumsum(np.append(0.0, wrap_angle(np.diff(heading))))
    time_s = seconds(time_ns, time_ns[0])
    before_s = np.clip(time_s - OVER_S / 2.0, 0.0, time_s[-1])
    after_s = np.clip(time_s + OVER_S / 2.0, 0.0, time_s[-1])
    before = np.interp(before_s, time_s, unwrapped)
    after = np.interp(after_s, time_s, unwrapped)
    turning = np.abs(after - before) > TURNS_DEGPS * OVER_S * DEG
    edges = _stretches(turning)
    turns: TimeNs = time_ns[np.minimum(edges, len(time_ns) - 1)]
    return turns


def _stretches(rows: Mask) -> Integers:
    """Return the first row of each stretch that is true, and the row after it, shape (stretches, 2)."""
    changes = np.diff(np.concatenate([[False], rows, [False]]).astype(np.int8))
    return np.flatnonzero(changes).reshape(-1, 2)


def _silences(replay: Replay) -> TimeNs:
    """Find the stretches in which the DVL has no velocity, shape (silences, 2)."""
    pings_ns = replay.velocities.time_ns
    inside = pings_ns[(pings_ns > replay.start_ns) & (pings_ns < replay.end_ns)]
    steps_ns = np.concatenate([[replay.start_ns], inside, [replay.end_ns]])
    gaps = np.flatnonzero(np.diff(steps_ns) > SILENT * float(np.median(np.diff(steps_ns))))
    return np.column_stack([steps_ns[gaps], steps_ns[gaps + 1]])
