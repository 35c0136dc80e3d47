"""Whether the innovations are as large as each filter says: their normalised squares, and where they should lie."""

from collections.abc import Callable, Sequence

import numpy as np

from insdvl_replay.core.history import History, Innovations
from insdvl_replay.report.plots.panel import LIMIT, REJECTED, Curve, Figure, Panel, filter_style
from insdvl_replay.results.figures.clock import Clock, filter_legend

Interval = Callable[[int], tuple[float, float]]
"""From degrees of freedom to the interval in which 95 % of the values of a consistent filter lie."""


def nis_figure(histories: Sequence[History], clock: Clock, interval: Interval) -> Figure:
    """Draw the NIS of every update, one panel for each filter and measurement.

    Parameters
    ----------
    histories : sequence of History
    clock : Clock
    interval : callable

    Returns
    -------
    Figure
        Measurements without updates are left out.
    """
    return Figure(
        "Whether they know it: normalised innovations squared",
        "Above the interval a filter is surer than it should be; below, it trusts its measurement too little.",
        tuple(
            _panel(history.filter, filter_style(number), innovations, clock, interval)
            for number, history in enumerate(histories)
            for innovations in history.innovations
            if len(innovations.nis)
        ),
        (
            *filter_legend([history.filter for history in histories]),
            (LIMIT, "95 % of the values of a consistent filter"),
            (REJECTED, "rejected by the gate"),
        ),
    )


def _panel(name: str, style: str, innovations: Innovations, clock: Clock, interval: Interval) -> Panel:
    time = clock.time(innovations.time_ns)
    rejected = np.where(innovations.used, np.nan, innovations.nis)
    return Panel(
        f"{name}: NIS of the {innovations.measurement}",
        clock.label,
        (Curve(time, innovations.nis, f"{style} solid"), Curve(time, rejected, REJECTED, points=True)),
        levels=interval(innovations.dof),
        y_scale="log",
    )
