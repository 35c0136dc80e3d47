"""Coasting: a filter goes on from a ping that it has used, and every later one is withheld from it.

It starts from what it has written down at that ping, state and P, so that a window costs no more than its own length.
The withheld pings are measured against it all the same: their innovations say how far it has gone astray, and their
NIS whether it knows.
"""

from collections.abc import Collection

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.core.history import History
from insdvl_replay.nav.earth_model import HOLD_AFTER_S
from insdvl_replay.nav.error_model import TWELVE
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import Measurement, withheld
from insdvl_replay.nav.timeline import PINGS, Timeline


def coast(
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
    """Let a filter go on from a ping with none of the next ones, accelerations neither; other sensors still aid it.

    Parameters
    ----------
    history : History
        Of the filter with every ping; ValueError if it does not hold P at the start of the window.
    timeline : Timeline
        With the readings of the measurements.
    window_ns : tuple of int
        Times of the ping that is used last, and of the last one that is withheld.
    measurements : tuple of Measurement
        The velocity, prepared for every ping of the dive, and those that do not come from the DVL.
    noise_density, lever_arm_b, more_states, heading_bias_rate_hz
        As the history was made with, see `filter.run_filter`.

    Returns
    -------
    History
        At the start of the window and at each withheld ping. Its first innovations are those of the withheld pings,
        none of which is used; NIS is by the true R.
    """
    window, start = between_pings(timeline, *window_ns), restart(history, window_ns[0])
    velocity, *others = (one.rows(_inside(timeline, one.sensor, *window_ns)) for one in measurements)
    told = (withheld(velocity), *(one for one in others if one.available.any()))
    return run_filter(
        history.filter, window, start, noise_density, told, lever_arm_b,
        more_states=more_states, heading_bias_rate_hz=heading_bias_rate_hz,
    )  # fmt: skip


def _inside(timeline: Timeline, sensor: int, start_ns: int, end_ns: int) -> slice:
    """Return the rows of a sensor's readings after a time and up to another."""
    events = slice(*np.searchsorted(timeline.event_ns, [start_ns, end_ns], side="right"))
    rows = timeline.rows[sensor, events]
    rows = rows[rows >= 0]
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0)


def restart(history: History, time_ns: int) -> Start:
    """Return what a filter goes on from at a time at which its history holds P; ValueError at others.

    Its height is the one at which the filter takes gravity, from which it goes on: where it had no velocity for long,
    its own has run away.
    """
    row, of_cov = (int(np.searchsorted(times, time_ns)) for times in (history.time_ns, history.cov_ns))
    if of_cov == len(history.cov_ns) or history.cov_ns[of_cov] != time_ns:
        raise ValueError(f"the history of {history.filter} holds no P at {time_ns}")
    latitude, longitude, height_m = history.position[row]
    drift_m = _height_drift_m(history, time_ns) if len(history.states) == TWELVE else 0.0
    return Start(
        np.array([latitude, longitude, height_m - drift_m]),
        history.velocity_n[row],
        history.mat_nb[row],
        history.cov[of_cov],
        history.accel_bias_b[row],
        history.gyro_bias_b[row],
        history.constants[row],
    )


def _height_drift_m(history: History, until_ns: int) -> float:
    """Sum up by what the height has moved while that of gravity was held, see `local_earth.GravityHeight`."""
    holding = [one for one in history.innovations if one.holds_height]
    aided_ns = np.unique(np.concatenate([history.time_ns[:1], *(one.time_ns[one.used] for one in holding)]))
    aided_ns = aided_ns[aided_ns <= until_ns]
    held_ns = aided_ns[:-1] + int(HOLD_AFTER_S * NS_PER_S)
    outages = held_ns < aided_ns[1:]
    before = np.searchsorted(history.time_ns, held_ns[outages], side="right") - 1
    after = np.searchsorted(history.time_ns, aided_ns[1:][outages])
    return float(np.sum(history.position[after, 2] - history.position[before, 2]))


def between_pings(timeline: Timeline, start_ns: int, end_ns: int) -> Timeline:
    """Cut a time line from one ping to another, whose rows count from the one after the first.

    It has the same nodes, but only pings and the two ends are recorded.
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
