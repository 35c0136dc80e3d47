"""The DVL outage test: a filter continues from a ping that it has used, without the later ones.

It starts from its history at that ping, state and P, so that a window costs no more than its own length. The
innovations of the missing pings are computed all the same: they measure the drift, and their NIS the filter's
consistency.
"""

from typing import Any, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats, TimeNs, distinct
from insdvl_replay.core.history import History
from insdvl_replay.nav.earth_model import HOLD_AFTER_S
from insdvl_replay.nav.error_model import TWELVE
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.timeline import PINGS, Timeline, samples_around
from insdvl_replay.nav.user_measurement import NoiseFactors


class GravityDrift(NamedTuple):
    """How far the height of a filter has drifted from the one at which it takes gravity, see `earth_model`."""

    since_ns: TimeNs  # (o,), ends of the times without a velocity in which gravity was held
    drift_m: Floats  # (o + 1,), sum of the height's drifts before the first end, and from each on


def gravity_drift(history: History) -> GravityDrift:
    """Add up the drifts of the height while that of gravity was held; filters that estimate a position have none.

    All windows of a history share it: it goes through every reading that was used.
    """
    if len(history.states) != TWELVE:
        return GravityDrift(np.empty(0, np.int64), np.zeros(1))
    holding = [found.time_ns[found.used] for found in history.innovations if found.holds_height]
    aided_ns = distinct(np.concatenate([history.time_ns[:1], *holding]))
    held_ns = aided_ns[:-1] + int(HOLD_AFTER_S * NS_PER_S)
    outages = held_ns < aided_ns[1:]
    until_ns = aided_ns[1:][outages]
    before = np.searchsorted(history.time_ns, held_ns[outages], side="right") - 1
    after = np.searchsorted(history.time_ns, until_ns)
    drifts_m = history.position[after, 2] - history.position[before, 2]
    return GravityDrift(until_ns, np.concatenate([[0.0], np.cumsum(drifts_m)]))


def run_outage(
    history: History,
    drift: GravityDrift,
    timeline: Timeline,
    window_ns: tuple[int, int],
    measurements: tuple[Measurement, ...],
    *,
    noise_factors: NoiseFactors | None = None,
    **settings: Any,
) -> History:
    """Run a filter through an outage of the DVL, without its velocities and accelerations; other sensors still aid.

    Parameters
    ----------
    history : History
        Of the filter with every ping; ValueError if it has no P at the start of the window.
    drift : GravityDrift
        Of the same history.
    window_ns : tuple of int
        Times of the last ping that is used, and of the last one that is missing.
    measurements : tuple of Measurement
        The velocity, prepared for every ping of the dive, and those that do not come from the DVL.
    noise_factors : NoiseFactors, optional
        As for the history; those that hold in the window are used.
    **settings
        As for the history, see `run_filter`.

    Returns
    -------
    History
        At the start of the window and at each missing ping. Its first innovations are those of the missing pings, none
        of which is used; NIS is by the true R.
    """
    window = between_pings(timeline, *window_ns)
    start = restart(history, drift, window_ns[0])
    events = slice(*np.searchsorted(timeline.event_ns, window_ns, side="right"))
    inside = []
    for measurement in measurements:
        rows = timeline.rows[measurement.sensor, events]
        rows = rows[rows >= 0]
        inside.append(
            measurement.rows(slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0))
        )
    velocity, *others = inside
    kept = (velocity.held_out(), *(other for other in others if other.available.any()))
    factors = None if noise_factors is None else noise_factors.within(*window_ns)
    return run_filter(
        history.filter, window, start, measurements=kept, noise_factors=factors, **settings
    )


def restart(history: History, drift: GravityDrift, time_ns: int) -> Start:
    """Return a start from a history at a time at which it has P; ValueError at others.

    With twelve states its height is the one at which the filter takes gravity: after long times without a velocity,
    the filter's own has drifted.
    """
    row = int(np.searchsorted(history.time_ns, time_ns))
    cov_row = int(np.searchsorted(history.cov_ns, time_ns))
    if cov_row == len(history.cov_ns) or history.cov_ns[cov_row] != time_ns:
        raise ValueError(f"the history of {history.filter} holds no P at {time_ns}")
    latitude, longitude, height_m = history.position[row]
    drifted_m = drift.drift_m[np.searchsorted(drift.since_ns, time_ns, side="right")]
    return Start(
        np.array([latitude, longitude, height_m - drifted_m]),
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
    samples = samples_around(timeline.sample_ns, start_ns, end_ns)
    is_ping = timeline.rows[PINGS, events] >= 0
    rows = np.where(timeline.event_ns[events] > start_ns, timeline.rows[:, events], -1)
    first = np.min(
        rows,
        axis=1,
        where=rows >= 0,
        initial=np.iinfo(np.int64).max,
        keepdims=True,
    )
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
