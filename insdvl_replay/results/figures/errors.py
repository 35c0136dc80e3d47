"""How wrong each filter is: its error against the reference, and three standard deviations to either side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats, TimeNs
from insdvl_replay.core.states import STATES, State
from insdvl_replay.report.plots.axis import limits
from insdvl_replay.report.plots.panel import Band, Curve, Figure, Panel, dashes_on_top, filter_style
from insdvl_replay.results.figures.clock import Clock, filter_legend, settled_height

SIGMAS: Final = 3.0
_AXES: Final = ("north", "east", "down")


@dataclass(frozen=True)
class FilterErrors:
    """Estimated minus reference of one filter, at the reference's times.

    Attributes
    ----------
    filter : str
    time_ns : ndarray, shape (k,)
    state_error : ndarray, shape (k, 6)
        Velocity error m/s and misalignment rad, in n; NaN where the reference lacks them.
    state_sd : ndarray, shape (k, 6)
        What the filter believes of them.
    position_error_ned_m : ndarray, shape (k, 3)
    """

    filter: str
    time_ns: TimeNs
    state_error: Floats
    state_sd: Floats
    position_error_ned_m: Floats


def error_figure(errors: Sequence[FilterErrors], clock: Clock) -> Figure:
    """Draw velocity, attitude and position errors, as far as the reference has them.

    Parameters
    ----------
    errors : sequence of FilterErrors
        The first is the baseline's.
    clock : Clock

    Returns
    -------
    Figure
        Without panels where the reference has nothing to compare with.
    """
    states = (_state_panel(state, errors, clock) for state in STATES[:6])
    positions = (_position_panel(axis, errors, clock) for axis in range(3))
    return Figure(
        "How wrong they are: errors against the reference",
        "Shaded: three standard deviations to either side, as each filter believes them. An honest filter stays "
        "inside, and fills a good part of it. The position is no state of these filters and has no band.",
        tuple(panel for panel in (*states, *positions) if _any(panel)),
        filter_legend([of_filter.filter for of_filter in errors]),
    )


def _state_panel(state: State, errors: Sequence[FilterErrors], clock: Clock) -> Panel:
    curves, bands, shown = [], [], []
    for number, of_filter in enumerate(errors):
        time = clock.time(of_filter.time_ns)
        error, sd = (column[:, state.index] / state.factor for column in (of_filter.state_error, of_filter.state_sd))
        curves.append(Curve(time, error, filter_style(number)))
        bands.append(Band(time, -SIGMAS * sd, SIGMAS * sd, filter_style(number)))
        height = SIGMAS * settled_height(sd[clock.settled(of_filter.time_ns)])
        shown += [error, np.array([-height, height])]
    title = f"{state.label} [{state.unit}]"
    return Panel(title, clock.label, dashes_on_top(curves), tuple(bands), y_limits=limits(np.concatenate(shown)))


def _position_panel(axis: int, errors: Sequence[FilterErrors], clock: Clock) -> Panel:
    curves = [
        Curve(clock.time(of_filter.time_ns), of_filter.position_error_ned_m[:, axis], filter_style(number))
        for number, of_filter in enumerate(errors)
    ]
    return Panel(f"position error, {_AXES[axis]} [m]", clock.label, dashes_on_top(curves))


def _any(panel: Panel) -> bool:
    return any(np.isfinite(curve.y).any() for curve in panel.curves)
