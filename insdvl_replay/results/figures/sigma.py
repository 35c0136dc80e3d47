"""What each filter believes: the standard deviation of the twelve error states over time, as in the paper's figures."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.states import STATES, State
from insdvl_replay.report.plots.panel import Curve, Figure, Panel, dashes_on_top, filter_style
from insdvl_replay.results.figures.clock import Clock, filter_legend, settled_height

_MISSING: Final = 2.5
"""Pings are missing where none came for this many of the usual steps."""


def sigma_figure(histories: Sequence[History], clock: Clock) -> Figure:
    """Draw the standard deviations of all filters, one panel for each state.

    Parameters
    ----------
    histories : sequence of History
        The first is the baseline.
    clock : Clock

    Returns
    -------
    Figure
    """
    return Figure(
        "What the filters believe: standard deviations",
        "Square roots of P's diagonal, as each ping leaves them, and as they grow where pings are missing. The start, "
        "where they fall steeply, and short peaks may lie above a panel.",
        tuple(_panel(state, histories, clock) for state in STATES),
        filter_legend([history.filter for history in histories]),
    )


def _panel(state: State, histories: Sequence[History], clock: Clock) -> Panel:
    highest, curves = 0.0, []
    for number, history in enumerate(histories):
        rows = _told(history)
        sd = history.sd[rows, state.index] / state.factor
        pings = history.updated[rows] & clock.settled(history.time_ns[rows])
        highest = max(highest, settled_height(sd[pings]))
        curves.append(Curve(clock.time(history.time_ns[rows]), sd, filter_style(number)))
    y_limits = (0.0, highest) if highest else None
    return Panel(f"{state.label} [{state.unit}]", clock.label, dashes_on_top(curves), y_limits=y_limits)


def _told(history: History) -> NDArray[np.bool_]:
    """Tell which rows show what a filter has learnt: those with a ping, and those that wait long for one.

    Between two pings an uncertainty grows. A curve through all rows would be a broad stroke of that growth.
    """
    last_ns = _last_ping_ns(history)
    usual_ns = np.median(np.diff(history.time_ns[history.updated])) if history.updated.sum() > 1 else 0.0
    waits = history.time_ns - last_ns > _MISSING * usual_ns
    told: NDArray[np.bool_] = history.updated | waits | (last_ns == history.time_ns)
    return told


def _last_ping_ns(history: History) -> TimeNs:
    """Give the time of the last ping before or at each row, or of the start."""
    rows = np.where(history.updated, np.arange(len(history.time_ns)), 0)
    return history.time_ns[np.maximum.accumulate(rows)]
