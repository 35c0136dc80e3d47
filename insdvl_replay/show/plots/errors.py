"""What filters err, what they predict that they err, and their innovations, over time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Mask, ReferenceColumns, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import AXES
from insdvl_replay.core.states import STATES, State
from insdvl_replay.document.parts import (
    LIMIT,
    REJECTED,
    Curve,
    Figure,
    Panel,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.document.plot import limits
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.consistency import mean_interval
from insdvl_replay.evaluation.reference_errors import ReferenceErrors
from insdvl_replay.geometry.rotation import vector_from_mat
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.show.plots.curves import (
    TIME_S,
    Series,
    StoredDive,
    figure_for_paper,
    filter_curves,
    filter_legend,
    is_known,
    known_number,
    title_of,
)

SIGMAS: Final = 3.0
# Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high.
SETTLED: Final = 0.02
# Share of the values that a panel shows, since one outage would flatten all others; and margin above.
_SHOWN = 0.97
_AIR = 1.15
# Values that fall to no less than this share of the largest are nearly constant.
_CONSTANT: Final = 0.5
_GAP: Final = 2.5  # A gap of the pings is longer than this many usual steps.
_WIDEST: Final = 1.5  # A panel shows a band up to this many times the largest error, so that errors fill the panel.


# --- Errors against the reference.


@dataclass(frozen=True)
class _StateErrors:
    """The errors of a filter against the reference, at the k times of both."""

    filter: str
    time_ns: TimeNs
    errors: Floats  # (k, 6): velocity m/s and attitude rad, in n
    sd: Floats  # (k, 6), as the filter predicts it
    position_ned_m: Floats  # (k, 3)


def errors_figure(replay: Replay, clock: Clock) -> Iterator[Figure]:
    """Draw velocity, attitude and position errors, as far as the reference has them."""
    reference = replay.dive.reference
    if not replay.errors or reference is None:
        return
    found = [
        _state_errors(history, replay.errors[history.filter], reference)
        for history in replay.histories
    ]
    panels = [_error_panel(state, found, clock) for state in STATES[:6]]
    for axis, direction in enumerate(("north", "east", "down")):
        series = [
            Series(own.filter, clock.time(own.time_ns), own.position_ned_m[:, axis])
            for own in found
        ]
        title = f"position error, {direction} [m]"
        panels.append(Panel(title, clock.label, filter_curves(series)))
    yield Figure(
        "Errors against the reference (3 sigma)",
        "The bands, shaded or between dotted lines, are 3 sigma of each filter to either "
        "side, and the errors of a "
        "consistent filter fill much of them without leaving. A band that is wider than "
        "the panel is cut off. The "
        "position has no band.",
        tuple(panel for panel in panels if is_known(panel.curves)),
        filter_legend(own.filter for own in found),
    )


def _state_errors(
    history: History, errors: ReferenceErrors, reference: ReferenceColumns
) -> _StateErrors:
    rows = np.searchsorted(history.time_ns, errors.time_ns)
    mat_nb_reference = reference.mat_nb[np.searchsorted(reference.time_ns, errors.time_ns)]
    misalignment_n = vector_from_mat(history.mat_nb[rows] @ np.swapaxes(mat_nb_reference, 1, 2))
    return _StateErrors(
        filter=history.filter,
        time_ns=errors.time_ns,
        errors=np.hstack([errors.velocity_error_n, misalignment_n]),
        sd=history.sd[rows, :6],
        position_ned_m=errors.position_error_ned_m,
    )


def _error_panel(state: State, found: Sequence[_StateErrors], clock: Clock) -> Panel:
    """Draw the error in a state, with the band of each filter as far as it is about as wide as the errors."""
    curves = []
    shown = []
    for number, own in enumerate(found):
        error = own.errors[:, state.index] / state.factor
        sd = own.sd[:, state.index] / state.factor
        band = (-SIGMAS * sd, SIGMAS * sd)
        curves.append(Curve(clock.time(own.time_ns), error, filter_style(number), band=band))
        largest = float(np.max(np.abs(error), where=np.isfinite(error), initial=0.0)) or np.inf
        settled_sd = sd[_is_settled(own.time_ns, clock)]
        height = min(SIGMAS * _settled_height(settled_sd), _WIDEST * largest)
        shown += [error, np.array([-height, height])]
    y_limits = limits(np.concatenate(shown))
    return Panel(title_of(state), clock.label, dashes_on_top(curves), y_limits=y_limits)


def _is_settled(time_ns: TimeNs, clock: Clock) -> Mask:
    """Find which times are after the settling at the start, shape (k,)."""
    length_ns = clock.end_ns - clock.start_ns
    settled: Mask = time_ns - clock.start_ns >= SETTLED * length_ns
    return settled


def _settled_height(values: Floats) -> float:
    """Return the height that a panel needs for values after the settling, 0 for none: short peaks may rise above."""
    known = values[np.isfinite(values)]
    if len(known):
        return _AIR * float(np.quantile(known, _SHOWN))
    return 0.0


_SIZES: Final = {
    "position_error_m": "position error [m]",
    "velocity_error_mps": "velocity error [m/s]",
    "level_error_deg": "level error [deg]",
    "heading_error_deg": "heading error [deg]",
}


def errors_for_paper(dive: StoredDive) -> Figure:
    """Draw the sizes of the errors against the reference."""
    panels = [
        Panel(title, TIME_S, filter_curves(dive.over_time(column)))
        for column, title in _SIZES.items()
    ]
    return figure_for_paper(dive, (panel for panel in panels if is_known(panel.curves)))


# --- Predicted errors.


def sigma_figure(histories: Sequence[History], clock: Clock) -> Figure:
    """Draw the standard deviations of all filters, one panel for each state."""
    drawn = [_DrawnSigma(history, _drawn_rows(history), clock) for history in histories]
    return Figure(
        "Predicted standard deviations",
        "These are the square roots of the diagonal of P after each ping, and they grow in "
        "gaps. The steep fall at "
        "the start and short peaks may be cut off.",
        tuple(_sigma_panel(state, drawn, clock) for state in STATES),
        filter_legend(history.filter for history in histories),
    )


def _drawn_rows(history: History) -> Mask:
    """Find the rows with a ping, and those in gaps.

    Between two pings sigma grows, and a curve through all rows would be a broad stroke.
    """
    last = np.maximum.accumulate(np.where(history.updated, np.arange(len(history.time_ns)), 0))
    waited_ns = history.time_ns - history.time_ns[last]
    usual_ns = 0.0
    if history.updated.sum() > 1:
        usual_ns = float(np.median(np.diff(history.time_ns[history.updated])))
    rows: Mask = history.updated | (waited_ns > _GAP * usual_ns) | (waited_ns == 0)
    return rows


@dataclass(frozen=True)
class _DrawnSigma:
    """The rows of a history that are drawn."""

    history: History
    rows: Mask
    clock: Clock

    @property
    def time_ns(self) -> TimeNs:
        """The times of these rows."""
        return self.history.time_ns[self.rows]

    @property
    def settled(self) -> Mask:
        """Which of these rows are pings after the settling at the start."""
        return self.history.updated[self.rows] & _is_settled(self.time_ns, self.clock)

    def sigma(self, state: State) -> Floats:
        """The standard deviation of a state in these rows, in its shown unit."""
        sd: Floats = self.history.sd[self.rows, state.index] / state.factor
        return sd


def _sigma_panel(state: State, drawn: Sequence[_DrawnSigma], clock: Clock) -> Panel:
    """Draw the standard deviations of a state, of the filters that predict it."""
    curves = []
    lowest = np.inf
    highest = 0.0
    for number, own in enumerate(drawn):
        if own.history.predicted[state.index]:
            sd = own.sigma(state)
            lowest = min(lowest, float(np.min(sd[own.settled], initial=np.inf)))
            highest = max(highest, _settled_height(sd[own.settled]))
            curves.append(Curve(clock.time(own.time_ns), sd, filter_style(number)))
    y_limits = _limits_of_sigma(lowest, highest)
    return Panel(title_of(state), clock.label, dashes_on_top(curves), y_limits=y_limits)


def _limits_of_sigma(lowest: float, highest: float) -> tuple[float, float] | None:
    """Return the limits of a panel: nearly constant values fill it, others begin at zero."""
    if not highest:
        return None
    if _CONSTANT * highest < lowest < highest:
        return (lowest - (_AIR - 1.0) * highest, highest)
    return (0.0, highest)


def sigma_for_paper(dive: StoredDive) -> Figure:
    """Draw the standard deviations of all filters, one panel for each of the chosen states."""
    panels = []
    for state in STATES:
        if not dive.states or state.id.startswith(dive.states):
            curves = filter_curves(dive.over_time(f"{state.id}_sd"))
            panels.append(Panel(title_of(state), TIME_S, curves))
    return figure_for_paper(dive, panels)


# --- Innovations.


def nis_figure(
    histories: Sequence[History], clock: Clock, interval: Callable[[int], tuple[float, float]]
) -> Figure:
    """Draw the NIS of every update, one panel for each filter and measurement.

    ``interval`` gives, by degrees of freedom, where 95 % of the values of a consistent filter are.
    """
    panels = []
    for number, history in enumerate(histories):
        for innovations in history.innovations:
            if not len(innovations.nis):
                continue
            time = clock.time(innovations.time_ns)
            rejected = np.where(
                innovations.used | innovations.is_held_out, np.nan, innovations.nis
            )
            curves = (
                Curve(time, innovations.nis, f"{filter_style(number)} solid"),
                Curve(time, rejected, REJECTED, points=True),
            )
            title = f"{history.filter}: NIS of the {innovations.measurement}"
            levels = interval(innovations.dof)
            panels.append(Panel(title, clock.label, curves, levels=levels, y_scale="log"))
    return Figure(
        "Innovation consistency (NIS)",
        "These are the normalised innovations squared. If most are above the interval, the "
        "filter is overconfident; "
        "if below, conservative.",
        tuple(panels),
        (
            *filter_legend(history.filter for history in histories),
            (LIMIT, "95 % of the values of a consistent filter"),
            (REJECTED, "rejected by the gate"),
        ),
    )


def nis_for_paper(dive: StoredDive) -> Figure:
    """Draw the NIS of the last update over its degrees of freedom, of all filters, over what is expected."""
    panels = []
    for measurement in ("velocity", "acceleration"):
        curves = filter_curves(dive.over_time(f"nis_{measurement}"))
        if is_known(curves):
            expected = _expected_nis(measurement, dive)
            title = f"NIS / dof, {measurement}"
            panels.append(Panel(title, TIME_S, (expected, *curves), y_scale="log"))
    return figure_for_paper(dive, panels, [(f"band {LIMIT}", "95 % of a consistent filter")])


def _expected_nis(measurement: str, dive: StoredDive) -> Curve:
    """Return the NIS over its degrees of freedom that is expected, with 95 % of its values."""
    dof = len(AXES)
    for row in dive.tables.get("consistency", ()):
        if row.get("measurement") == measurement:
            dof = int(known_number(row["dof"]))
            break
    time_s = dive.trajectory.time_s
    low, high = mean_interval(dof, 1)
    band = (np.full(len(time_s), low / dof), np.full(len(time_s), high / dof))
    return Curve(time_s, np.ones(len(time_s)), LIMIT, band=band)
