"""The DVL outage test: a filter continues from a ping that it has used, without the later ones.

It starts from its history at that ping, state and P, so that a window costs no more than its own length. The
innovations of the missing pings are computed all the same: they measure the drift, and their NIS the filter's
consistency.
"""

from collections.abc import Collection

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.history import History
from insdvl_replay.nav.earth_model import HOLD_AFTER_S
from insdvl_replay.nav.error_model import TWELVE
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.timeline import PINGS, Timeline


def run_outage(
    history: History,
    timeline: Timeline,
    window_ns: tuple[int, int],
    *,
    noise_density: Floats,
    measurements: tuple[Measurement, ...],
    lever_arm_b: Floats,
    more_states: Collection[str] = (),
    heading_bias_rate_hz: float = 0.0,
) -> History:
    """Run a filter through an outage of the DVL, without its velocities and accelerations; other sensors still aid.

    Parameters
    ----------
    history : History
        Of the filter with every ping; ValueError if it has no P at the start of the window.
    timeline : Timeline
        With the readings of the measurements.
    window_ns : tuple of int
        Times of the last ping that is used, and of the last one that is missing.
    measurements : tuple of Measurement
        The velocity, prepared for every ping of the dive, and those that do not come from the DVL.
    noise_density, lever_arm_b, more_states, heading_bias_rate_hz
        As for the history, see `filter.run_filter`.

    Returns
    -------
    History
        At the start of the window and at each missing ping. Its first innovations are those of the missing pings, none
        of which is used; NIS is by the true R.
    """
    window, start = between_pings(timeline, *window_ns), restart(history, window_ns[0])
    events, inside = slice(*np.searchsorted(timeline.event_ns, window_ns, side="right")), []
    for measurement in measurements:
        rows = timeline.rows[measurement.sensor, events]
        rows = rows[rows >= 0]
        inside.append(measurement.rows(slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0)))
    velocity, *others = inside
    kept = (velocity.held_out(), *(other for other in others if other.available.any()))
    return run_filter(
        history.filter, window, start, noise_density, kept, lever_arm_b,
        more_states=more_states, heading_bias_rate_hz=heading_bias_rate_hz,
    )  # fmt: skip


def restart(history: History, time_ns: int) -> Start:
    """Return a start from a history at a time at which it has P; ValueError at others.

    With twelve states its height is the one at which the filter takes gravity: after long times without a velocity,
    the filter's own has drifted.
    """
    row, cov_row = (int(np.searchsorted(times, time_ns)) for times in (history.time_ns, history.cov_ns))
    if cov_row == len(history.cov_ns) or history.cov_ns[cov_row] != time_ns:
        raise ValueError(f"the history of {history.filter} holds no P at {time_ns}")
    latitude, longitude, height_m = history.position[row]
    if len(history.states) == TWELVE:
        # The sum of the height's drifts while that of gravity was held, see `earth_model.GravityHeight`.
        holding = [found.time_ns[found.used] for found in history.innovations if found.holds_height]
        aided_ns = np.unique(np.concatenate([history.time_ns[:1], *holding]))
        aided_ns = aided_ns[aided_ns <= time_ns]
        held_ns = aided_ns[:-1] + int(HOLD_AFTER_S * NS_PER_S)
        outages = held_ns < aided_ns[1:]
        before = np.searchsorted(history.time_ns, held_ns[outages], side="right") - 1
        after = np.searchsorted(history.time_ns, aided_ns[1:][outages])
        height_m = height_m - float(np.sum(history.position[after, 2] - history.position[before, 2]))
    return Start(
        np.array([latitude, longitude, height_m]),
        history.velocity_n[row],
        history.mat_nb[row],
        history.cov[cov_row],
        history.accel_bias_b[row],
        history.gyro_bias_b[row],
        history.constants[row],
    )


def between_pings(timeline: Timeline, start_ns: int, end_ns: int) -> Timeline:
    """Cut a time line from one ping to another, with rows counted from the one after the first.

    It has the same nodes, but records only pings and the two ends.
    """
    events = slice(*np.searchsorted(timeline.event_ns, [start_ns, end_ns + 1]))
    samples = slice(
        np.searchsorted(timeline.sample_ns, start_ns, side="right") - 1,
        np.searchsorted(timeline.sample_ns, end_ns) + 1,
    )
    is_ping = timeline.rows[PINGS, events] >= 0
    rows = np.where(timeline.event_ns[events] > start_ns, timeline.rows[:, events], -1)
    first = np.min(rows, axis=1, where=rows >= 0, initial=np.iinfo(np.int64).max, keepdims=True)
    return Timeline(
        timeline.sample_ns[samples],
        timeline.specific_force_b[samples],
        timeline.angular_rate_b[samples],
        timeline.event_ns[events],
        np.where(rows >= 0, rows - first, -1),
        np.where(is_ping, np.cumsum(is_ping) - 1, -1),
        timeline.gap[events],
        timeline.gap_noise_density,
    )
