"""What filters believe, how wrong they are, and whether they know it: figures over the time of a dive."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs, seconds
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import STATES, State
from insdvl_replay.report.plots.axis import limits
from insdvl_replay.report.plots.panel import (
    LIMIT,
    REJECTED,
    Band,
    Curve,
    Figure,
    Panel,
    dashes_on_top,
    filter_style,
)

_UNITS: Final = ((2 * 3600.0, 3600.0, "h"), (20 * 60.0, 60.0, "min"), (0.0, 1.0, "s"))
"""From this length on, this unit, of this name."""
SETTLED: Final = 0.02
"""Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high."""
_SHOWN: Final = 0.97
"""Share of the values that a panel shows: the growth in one outage would flatten all the rest."""
_AIR: Final = 1.15
_MISSING: Final = 2.5
"""Pings are missing where none came for this many of the usual steps."""
SIGMAS: Final = 3.0
_WIDEST: Final = 4.0
"""So many times the largest error a panel shows of a band: more would make a flat line of the error."""
_AXES: Final = ("north", "east", "down")
Interval = Callable[[int], tuple[float, float]]
"""From degrees of freedom to the interval in which 95 % of the values of a consistent filter lie."""


@dataclass(frozen=True)
class Clock:
    """Time since the start of a replay, in a unit that suits its length.

    Attributes
    ----------
    start_ns, end_ns : int
        Span of the replay.
    """

    start_ns: int
    end_ns: int

    @property
    def label(self) -> str:
        """What stands at a time axis."""
        return f"time [{self._unit[1]}]"

    def time(self, time_ns: TimeNs) -> Floats:
        """Return times since the start in the axis's unit, shape (k,)."""
        return seconds(time_ns, self.start_ns) / self._unit[0]

    def settled(self, time_ns: TimeNs) -> NDArray[np.bool_]:
        """Find which times lie behind the settling at the start, shape (k,)."""
        settled: NDArray[np.bool_] = time_ns - self.start_ns >= SETTLED * (self.end_ns - self.start_ns)
        return settled

    @property
    def _unit(self) -> tuple[float, str]:
        length_s = (self.end_ns - self.start_ns) * 1e-9
        return next((size, name) for least, size, name in _UNITS if length_s >= least)


def settled_height(values: Floats) -> float:
    """Return the height that a panel needs for values behind the settling: short peaks may rise above it.

    Parameters
    ----------
    values : ndarray, shape (k,)
        Not negative.

    Returns
    -------
    float
        0 without finite values.
    """
    known = values[np.isfinite(values)]
    return _AIR * float(np.quantile(known, _SHOWN)) if len(known) else 0.0


def filter_legend(names: list[str]) -> tuple[tuple[str, str], ...]:
    """Return each filter's style and name."""
    return tuple((filter_style(number), name) for number, name in enumerate(names))


def sigma_figure(histories: Sequence[History], clock: Clock) -> Figure:
    """Draw the standard deviations of all filters, one panel for each state."""
    return Figure(
        "What the filters believe: standard deviations",
        "Square roots of P's diagonal, as each ping leaves them, and as they grow where pings are missing. The start, "
        "where they fall steeply, and short peaks may lie above a panel.",
        tuple(_sigma_panel(state, histories, clock) for state in STATES),
        filter_legend([history.filter for history in histories]),
    )


def _sigma_panel(state: State, histories: Sequence[History], clock: Clock) -> Panel:
    highest, curves = 0.0, []
    for number, history in enumerate(histories):
        if not history.believed[state.index]:
            continue
        rows = _told(history)
        sd = history.sd[rows, state.index] / state.factor
        pings = history.updated[rows] & clock.settled(history.time_ns[rows])
        highest = max(highest, settled_height(sd[pings]))
        curves.append(Curve(clock.time(history.time_ns[rows]), sd, filter_style(number), label=history.filter))
    y_limits = (0.0, highest) if highest else None
    return Panel(f"{state.label} [{state.unit}]", clock.label, dashes_on_top(curves), y_limits=y_limits)


def _told(history: History) -> NDArray[np.bool_]:
    """Find which rows show what a filter has learnt: those with a ping, and those that wait long for one.

    Between two pings an uncertainty grows. A curve through all rows would be a broad stroke of that growth.
    """
    last_ns = _last_ping_ns(history)
    usual_ns = np.median(np.diff(history.time_ns[history.updated])) if history.updated.sum() > 1 else 0.0
    waits = history.time_ns - last_ns > _MISSING * usual_ns
    told: NDArray[np.bool_] = history.updated | waits | (last_ns == history.time_ns)
    return told


def _last_ping_ns(history: History) -> TimeNs:
    """Return the time of the last ping before or at each row, or of the start."""
    rows = np.where(history.updated, np.arange(len(history.time_ns)), 0)
    return history.time_ns[np.maximum.accumulate(rows)]


@dataclass(frozen=True)
class FilterErrors:
    """Estimated minus reference of one filter, at the reference's times.

    Attributes
    ----------
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
    """Draw velocity, attitude and position errors, as far as the reference has them."""
    states = (_state_panel(state, errors, clock) for state in STATES[:6])
    positions = (_position_panel(axis, errors, clock) for axis in range(3))
    return Figure(
        "How wrong they are: errors against the reference",
        "Shaded: three standard deviations to either side, as each filter believes them. An honest filter stays "
        "inside, and fills a good part of it; a band that is much wider than the errors leaves the panel. The position "
        "has no band.",
        tuple(panel for panel in (*states, *positions) if _any(panel)),
        filter_legend([of_filter.filter for of_filter in errors]),
    )


def _state_panel(state: State, errors: Sequence[FilterErrors], clock: Clock) -> Panel:
    curves, bands, shown = [], [], []
    for number, of_filter in enumerate(errors):
        time = clock.time(of_filter.time_ns)
        error, sd = (column[:, state.index] / state.factor for column in (of_filter.state_error, of_filter.state_sd))
        curves.append(Curve(time, error, filter_style(number), label=of_filter.filter))
        bands.append(Band(time, -SIGMAS * sd, SIGMAS * sd, filter_style(number)))
        height = min(SIGMAS * settled_height(sd[clock.settled(of_filter.time_ns)]), _WIDEST * _largest(error))
        shown += [error, np.array([-height, height])]
    title = f"{state.label} [{state.unit}]"
    return Panel(title, clock.label, dashes_on_top(curves), tuple(bands), y_limits=limits(np.concatenate(shown)))


def _position_panel(axis: int, errors: Sequence[FilterErrors], clock: Clock) -> Panel:
    curves = [
        Curve(clock.time(of_filter.time_ns), of_filter.position_error_ned_m[:, axis], filter_style(number))
        for number, of_filter in enumerate(errors)
    ]
    return Panel(f"position error, {_AXES[axis]} [m]", clock.label, dashes_on_top(curves))


def _largest(error: Floats) -> float:
    """Return the largest size of an error; infinite where none is known, or all are zero."""
    return float(np.max(np.abs(error), where=np.isfinite(error), initial=0.0)) or np.inf


def _any(panel: Panel) -> bool:
    return any(np.isfinite(curve.y).any() for curve in panel.curves)


def nis_figure(histories: Sequence[History], clock: Clock, interval: Interval) -> Figure:
    """Draw the NIS of every update, one panel for each filter and measurement."""
    return Figure(
        "Whether they know it: normalised innovations squared",
        "Above the interval a filter is surer than it should be; below, it trusts its measurement too little.",
        tuple(
            _nis_panel(history.filter, filter_style(number), innovations, clock, interval)
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


def _nis_panel(name: str, style: str, innovations: Innovations, clock: Clock, interval: Interval) -> Panel:
    time = clock.time(innovations.time_ns)
    rejected = np.where(innovations.used | innovations.is_withheld, np.nan, innovations.nis)
    return Panel(
        f"{name}: NIS of the {innovations.measurement}",
        clock.label,
        (Curve(time, innovations.nis, f"{style} solid"), Curve(time, rejected, REJECTED, points=True)),
        levels=interval(innovations.dof),
        y_scale="log",
    )
