"""The figures of a replay: measured errors, and the errors that the filters predict."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import (
    NS_PER_S,
    Dive,
    Floats,
    Mask,
    ReferenceColumns,
    TimeNs,
    seconds,
)
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG, STATES
from insdvl_replay.core.tables import EvidenceRow, OutageRow, finite
from insdvl_replay.document.parts import (
    LIMIT,
    PREDICTED,
    REFERENCE,
    REJECTED,
    Curve,
    Figure,
    Panel,
    Shade,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.document.plot import Axis, limits
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.consistency import mean_interval
from insdvl_replay.evaluation.convergence import ConvergenceCurves
from insdvl_replay.evaluation.outage_test import SHOWN_S, OutageCurve
from insdvl_replay.evaluation.reference_errors import acceleration_at, reference_acceleration
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat, wrap_angle
from insdvl_replay.preparation.replay import Replay

DERIVED: Final = "derived"
REACHED: Final = "reached"
SIGMAS: Final = 3.0
# Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high.
SETTLED: Final = 0.02
# Share of the values that a panel shows, since one outage would flatten all others; and margin above.
_SHOWN = 0.97
_AIR = 1.15
_CONSTANT: Final = (
    0.5  # Values that fall to no less than this share of the largest are nearly constant.
)
_COMPLETE: Final = 0.98  # Share of the dive from which a curve is of all of it.
_MISSING: Final = 2.5  # A gap is longer than this many usual steps.
_WIDEST: Final = 1.5  # A panel shows a band up to this many times the largest error, so that errors fill the panel.


def replay_figures(replay: Replay) -> tuple[Figure, ...]:
    """Draw all figures of a replay: measured errors, then predicted errors."""
    clock = Clock(replay.start_ns, replay.end_ns)
    figures = (
        *_error_figure(replay, clock),
        *outage_figure(replay.curves.outage, clock),
        *convergence_figure(replay.curves.convergence, replay.tables.evidence),
        _sigma_figure(replay.histories, clock),
        nis_figure(replay.histories, clock, lambda dof: mean_interval(dof, 1)),
        _motion_figure(replay, clock),
        *_acceleration_figure(replay, clock),
    )
    shades = shades_of(replay)
    return tuple(
        replace(figure, panels=tuple(_over_time(panel, shades, clock) for panel in figure.panels))
        for figure in figures
    )


def first_panels(replay: Replay) -> list[Panel]:
    """Draw the first two panels: the horizontal error over time, or the drift without DVL; and the track."""
    return [*error_panel(replay), track_panel(replay)]


def error_panel(replay: Replay) -> Iterator[Panel]:
    """Draw the horizontal error over time; without a reference the drift without DVL, if it is known."""
    clock = Clock(replay.start_ns, replay.end_ns)
    if replay.curves.position:
        curves = []
        for number, (name, curve) in enumerate(replay.curves.position.items()):
            time = clock.time(replay.start_ns + np.round(curve.time_s * NS_PER_S).astype(np.int64))
            band = (curve.low_m, curve.high_m) if curve.starts > 1 else None
            curves.append(Curve(time, curve.median_m, filter_style(number), label=name, band=band))
        # Runs from random starts may end before a long dive does.
        ends = curves[0].x[-1]
        end = clock.limits[1]
        part = f", first {ends:.0f} {clock.unit}" if ends < _COMPLETE * end else ""
        panel = Panel(f"horizontal position error [m]{part}", clock.label, dashes_on_top(curves))
        yield _over_time(panel, shades_of(replay), clock)
    elif replay.curves.outage:
        yield _drift_panel(replay.curves.outage)


def _filter_curves(
    curves: Iterable[tuple[str, Floats, Floats]], *, named: bool = False
) -> tuple[Curve, ...]:
    """Return a curve for each filter, from name, x and y, in the order of the settings; named at their ends."""
    drawn = [
        Curve(x, y, filter_style(i), label=name if named else "")
        for i, (name, x, y) in enumerate(curves)
    ]
    return dashes_on_top(drawn)


def _legend(names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    return tuple((filter_style(number), name) for number, name in enumerate(names))


# --- Errors against the reference.


def _error_figure(replay: Replay, clock: Clock) -> Iterator[Figure]:
    """Draw velocity, attitude and position errors, as far as the reference has them."""
    reference = replay.dive.reference
    found = []
    if not replay.errors or reference is None:
        return
    for history in replay.histories:
        errors = replay.errors[history.filter]
        rows = np.searchsorted(history.time_ns, errors.time_ns)
        mat_nb_reference = reference.mat_nb[np.searchsorted(reference.time_ns, errors.time_ns)]
        misalignment_n = vector_from_mat(history.mat_nb[rows] @ np.swapaxes(mat_nb_reference, 1, 2))
        state_error = np.hstack([errors.velocity_error_n, misalignment_n])
        found.append(
            (
                history.filter,
                errors.time_ns,
                state_error,
                history.sd[rows, :6],
                errors.position_error_ned_m,
            )
        )
    panels = []
    for state in STATES[:6]:
        curves = []
        shown = []
        for number, (_, time_ns, state_error, state_sd, _) in enumerate(found):
            time = clock.time(time_ns)
            error, sd = (
                column[:, state.index] / state.factor for column in (state_error, state_sd)
            )
            band = -SIGMAS * sd, SIGMAS * sd
            curves.append(Curve(time, error, filter_style(number), band=band))
            largest = float(np.max(np.abs(error), where=np.isfinite(error), initial=0.0)) or np.inf
            height = min(SIGMAS * _settled_height(sd[_settled(time_ns, clock)]), _WIDEST * largest)
            shown += [error, np.array([-height, height])]
        title = f"{state.label} [{state.unit}]"
        y_limits = limits(np.concatenate(shown))
        panels.append(Panel(title, clock.label, dashes_on_top(curves), y_limits=y_limits))
    for axis, direction in enumerate(("north", "east", "down")):
        series = [
            (name, clock.time(time_ns), position[:, axis])
            for name, time_ns, _, _, position in found
        ]
        panels.append(
            Panel(f"position error, {direction} [m]", clock.label, _filter_curves(series))
        )
    yield Figure(
        "Errors against the reference (3 sigma)",
        "Shaded, or between dotted lines: 3 sigma of each filter to either side. The errors of a consistent filter "
        "stay inside and fill much of the band. A band that is wider than the panel is cut off. The position has no "
        "band.",
        tuple(
            panel for panel in panels if any(np.isfinite(curve.y).any() for curve in panel.curves)
        ),
        _legend(name for name, *_ in found),
    )


def _settled(time_ns: TimeNs, clock: Clock) -> Mask:
    """Find which times are after the settling at the start, shape (k,)."""
    settled: Mask = time_ns - clock.start_ns >= SETTLED * (clock.end_ns - clock.start_ns)
    return settled


def _settled_height(values: Floats) -> float:
    """Return the height that a panel needs for values after the settling, 0 for none: short peaks may rise above."""
    known = values[np.isfinite(values)]
    if len(known):
        return _AIR * float(np.quantile(known, _SHOWN))
    return 0.0


# --- The outage test and measured convergence.


def outage_figure(curves: Mapping[str, OutageCurve], clock: Clock) -> Iterator[Figure]:
    """Draw the drift without DVL over time and over the dive; nothing without windows."""
    if not curves:
        return
    windows = len(next(iter(curves.values())).begin_ns)
    how = "of one window" if windows == 1 else f"over {windows} windows at equal distances"
    by_window = [
        (name, clock.time(curve.begin_ns), curve.drift_m) for name, curve in curves.items()
    ]
    yield Figure(
        "DVL outage test: drift without the DVL",
        f"Measured by the held-out velocities; no reference is needed. Left: median {how}. Right: each window, at its "
        f"begin. {OutageRow.footnote}",
        (
            _drift_panel(curves),
            Panel(
                f"drift in {SHOWN_S} s, at the begin of each window [m]",
                clock.label,
                _filter_curves(by_window),
                y_scale="log",
            ),
        ),
        (*_legend(curves), (f"{REFERENCE} {PREDICTED}", "95 % of the windows drift less")),
    )


def _drift_panel(curves: Mapping[str, OutageCurve]) -> Panel:
    """Draw the drift over the time without DVL: median, and the limit of 95 %."""
    medians = _filter_curves(
        [(name, curve.time_s, curve.median_m) for name, curve in curves.items()], named=True
    )
    limits_95 = [
        Curve(curve.time_s, curve.p95_m, f"{filter_style(number)} {PREDICTED}", name=f"{name} 95 %")
        for number, (name, curve) in enumerate(curves.items())
    ]
    return Panel(
        "horizontal drift [m]", "time without DVL [s]", (*limits_95, *medians), y_scale="log"
    )


# By quantity of convergence the title of its panel, and its unit in SI.
_CONVERGED: Final = {
    "level": ("level: roll and pitch [deg]", DEG),
    "heading": ("heading [deg]", DEG),
    "velocity": ("horizontal velocity [m/s]", 1.0),
}
# Seconds, and share of the time, that are left out: no ping has come, and half of the axis would show them.
_FIRST_S = 1.0
_FIRST = 1e-3


def convergence_figure(
    curves: Mapping[str, ConvergenceCurves], evidence: Sequence[EvidenceRow]
) -> Iterator[Figure]:
    """Draw the true errors of random starts over time, one panel for each quantity; nothing if none is known.

    ``curves`` are by quantity of `quantities.CONVERGED`; ``evidence`` has the times of convergence.
    """
    names = []
    panels = []
    for quantity, (title, unit) in _CONVERGED.items():
        if (found := curves.get(quantity)) is None:
            continue
        names = list(found.rms)
        shown = found.time_s >= max(_FIRST_S, _FIRST * found.time_s[-1])
        time_s = found.time_s[shown]
        limit = found.limit / unit
        predicted = [
            Curve(
                time_s,
                found.predicted[name][shown] / unit,
                f"{filter_style(number)} {PREDICTED}",
                name=f"{name} sigma",
            )
            for number, name in enumerate(names)
        ]
        measured = _filter_curves([(name, time_s, found.rms[name][shown] / unit) for name in names])
        rows = [row for row in evidence if row.quantity == f"convergence_{quantity}"]
        reached_s = {names[0]: finite(rows[0].baseline) if rows else np.nan}
        reached_s = {row.filter: finite(row.value) for row in rows} | reached_s
        points = [
            Curve(
                np.array([reached_s[name]]),
                np.array([limit]),
                f"{filter_style(number)} {REACHED}",
                points=True,
            )
            for number, name in (*enumerate(names[1:], 1), (0, names[0]))
            if np.isfinite(reached_s.get(name, np.nan))
        ]
        drawn = (*predicted, *measured, *points)
        panels.append(
            Panel(title, "time [s]", drawn, levels=(limit,), y_scale="log", x_scale="log")
        )
    if panels:
        yield Figure(
            "Convergence",
            "Measured: rms of the true errors of runs from random starts, over the last tenth of the elapsed time. A "
            f"point marks the time from which a filter is as good as {names[0]} at the end. No point: the error does "
            "not fall.",
            tuple(panels),
            (
                *_legend(names),
                (f"{REFERENCE} {PREDICTED}", "sigma predicted by the filter"),
                (LIMIT, f"rms of {names[0]} at the end, plus one standard error"),
            ),
        )


# --- Predicted errors.


def _sigma_figure(histories: Sequence[History], clock: Clock) -> Figure:
    """Draw the standard deviations of all filters, one panel for each state."""
    shown = []
    panels = []
    for history in histories:
        # Rows with a ping, and rows in gaps. Between two pings sigma grows, and a curve through all rows would be a
        # broad stroke.
        last = np.maximum.accumulate(np.where(history.updated, np.arange(len(history.time_ns)), 0))
        waited_ns = history.time_ns - history.time_ns[last]
        usual_ns = (
            np.median(np.diff(history.time_ns[history.updated]))
            if history.updated.sum() > 1
            else 0.0
        )
        rows = history.updated | (waited_ns > _MISSING * usual_ns) | (waited_ns == 0)
        shown.append((rows, history.updated[rows] & _settled(history.time_ns[rows], clock)))
    for state in STATES:
        lowest = np.inf
        highest = 0.0
        curves = []
        for number, (history, (rows, pings)) in enumerate(zip(histories, shown, strict=True)):
            if history.predicted[state.index]:
                sd = history.sd[rows, state.index] / state.factor
                lowest = min(lowest, float(np.min(sd[pings], initial=np.inf)))
                highest = max(highest, _settled_height(sd[pings]))
                time = clock.time(history.time_ns[rows])
                curves.append(Curve(time, sd, filter_style(number)))
        # Nearly constant values fill the panel; others begin at zero.
        low = lowest - (_AIR - 1.0) * highest if _CONSTANT * highest < lowest < highest else 0.0
        y_limits = (low, highest) if highest else None
        title = f"{state.label} [{state.unit}]"
        panels.append(Panel(title, clock.label, dashes_on_top(curves), y_limits=y_limits))
    return Figure(
        "Predicted standard deviations",
        "Square roots of the diagonal of P after each ping, and their growth in gaps. The steep fall at the start and "
        "short peaks may be cut off.",
        tuple(panels),
        _legend(history.filter for history in histories),
    )


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
            rejected = np.where(innovations.used | innovations.is_held_out, np.nan, innovations.nis)
            curves = (
                Curve(time, innovations.nis, f"{filter_style(number)} solid"),
                Curve(time, rejected, REJECTED, points=True),
            )
            title = f"{history.filter}: NIS of the {innovations.measurement}"
            levels = interval(innovations.dof)
            panels.append(Panel(title, clock.label, curves, levels=levels, y_scale="log"))
    return Figure(
        "Innovation consistency (NIS)",
        "Normalised innovations squared. Above the interval a filter is overconfident. Below the interval it is "
        "conservative.",
        tuple(panels),
        (
            *_legend(history.filter for history in histories),
            (LIMIT, "95 % of the values of a consistent filter"),
            (REJECTED, "rejected by the gate"),
        ),
    )


# --- The vehicle: its track, its motion, its accelerations.


def _tracks(replay: Replay) -> list[tuple[TimeNs, Floats, Curve]]:
    """Return times, positions and the track from above of each filter and of the reference.

    Positions count from where the baseline starts.
    """
    named: list[tuple[str, str, History | ReferenceColumns]]
    named = [
        (history.filter, filter_style(n), history) for n, history in enumerate(replay.histories)
    ]
    reference = replay.dive.reference
    if reference is not None and reference.has_position:
        named.append((REFERENCE, REFERENCE, reference.within(replay.start_ns, replay.end_ns)))
    tracks = []
    for name, style, motion in named:
        origin = np.broadcast_to(replay.histories[0].position[0], motion.position.shape)
        ned_m = north_east_down_m(motion.position, origin)
        time_s = seconds(motion.time_ns, replay.start_ns)
        tracks.append(
            (motion.time_ns, ned_m, Curve(ned_m[:, 1], ned_m[:, 0], style, label=name, time=time_s))
        )
    return tracks


def _motion_figure(replay: Replay, clock: Clock) -> Figure:
    """Draw the tracks from above and over time, and the motion by the baseline."""
    baseline = replay.histories[0]
    tracks = _tracks(replay)
    above = [replace(curve, label="") for _, _, curve in tracks]
    down = [
        Curve(clock.time(time_ns), ned_m[:, 2], curve.style) for time_ns, ned_m, curve in tracks
    ]
    speed_mps = np.hypot(baseline.velocity_n[:, 0], baseline.velocity_n[:, 1])
    # The turn rate is from ping to ping, where the states are far enough apart for a rate.
    pings = np.flatnonzero(baseline.updated)
    ping_ns = baseline.time_ns[pings]
    heading = rpy_from_mat(baseline.mat_nb[pings])[:, 2]
    rate_degps = wrap_angle(np.diff(heading)) / seconds(ping_ns[1:], ping_ns[:-1]) / DEG
    solid = f"{filter_style(0)} solid"
    speed = Curve(clock.time(baseline.time_ns), speed_mps, solid)
    turn_rate = Curve(clock.time(ping_ns[1:]), rate_degps, solid)
    return Figure(
        "Motion of the vehicle",
        "Track and depth are relative to the start of the replay. Speed over ground and turn rate are the baseline's.",
        (
            Panel("track: north [m] over east [m]", "east [m]", dashes_on_top(above), equal=True),
            Panel("speed over ground, horizontal [m/s]", clock.label, (speed,)),
            Panel("turn rate of the heading [deg/s]", clock.label, (turn_rate,)),
            Panel("depth below the start [m]", clock.label, dashes_on_top(down)),
        ),
        tuple((curve.style, curve.label) for _, _, curve in tracks),
    )


MAGNIFIED: Final = (
    "magnified"  # Added to the style of a filter: its places are not read at the cursor.
)
SEEN: Final = (
    0.08  # Share of the size of a track that its largest error is drawn as, at least half of it.
)


def track_panel(replay: Replay) -> Panel:
    """Draw the tracks from above; with a reference, their errors magnified so that they are seen."""
    tracks = _tracks(replay)
    times_ns, ned_m, reference = tracks[-1]
    errors = {
        name: found
        for name, found in replay.errors.items()
        if np.isfinite(found.position_error_ned_m).any()
    }
    if not errors:
        drawn = [curve for _, _, curve in tracks if curve.style != REFERENCE]
        return Panel(
            "track: north [m] over east [m]", "east [m]", dashes_on_top(drawn), equal=True, low=True
        )
    size_m = max(float(np.ptp(axis[np.isfinite(axis)])) for axis in (ned_m[:, 1], ned_m[:, 0]))
    largest_m = max(
        float(np.nanmax(np.abs(found.position_error_ned_m[:, :2]))) for found in errors.values()
    )
    wanted = SEEN * size_m / largest_m if largest_m > 0.0 else 1.0
    steps = [digit * 10.0**power for power in range(7) for digit in (1.0, 2.0, 5.0)]
    times = max((step for step in steps if step <= wanted), default=1.0)
    drawn = []
    for number, history in enumerate(replay.histories):
        if (found := errors.get(history.filter)) is not None:
            rows = np.clip(np.searchsorted(times_ns, found.time_ns), 0, len(times_ns) - 1)
            off = ned_m[rows] + times * found.position_error_ned_m
            style = f"{filter_style(number)}{f' {MAGNIFIED}' if times > 1.0 else ''}"
            time_s = seconds(found.time_ns, replay.start_ns)
            drawn.append(Curve(off[:, 1], off[:, 0], style, label=history.filter, time=time_s))
    drawn.append(reference)
    much = f", errors {times:g} times as large" if times > 1.0 else ""
    return Panel(f"track{much}: north [m]", "east [m]", dashes_on_top(drawn), equal=True, low=True)


def _acceleration_figure(replay: Replay, clock: Clock) -> Iterator[Figure]:
    """Draw the accelerations by the DVL and by the reference over time, one panel for each axis of the body."""
    met = (innovations for history in replay.histories for innovations in history.innovations)
    derived = next(
        (found for found in met if found.measurement == "acceleration" and len(found.valid_ns)),
        None,
    )
    if derived is None:
        return
    legend = [(DERIVED, "slope of the DVL's velocities")]
    curves = {DERIVED: derived.measured}
    reference = replay.dive.reference
    filters = replay.config.filters.values()
    if reference is not None and reference.has_velocity and reference.has_attitude:
        longest_s = max(
            filter_.acceleration.max_window_gap_s
            for filter_ in filters
            if filter_.acceleration is not None
        )
        acceleration_b = reference_acceleration(reference, longest_s)
        curves[REFERENCE] = acceleration_at(derived.valid_ns, reference.time_ns, acceleration_b)
        legend.append((REFERENCE, "derivative of the reference's velocity"))
    time = clock.time(derived.valid_ns)
    swing = (
        " The motion of the DVL about the IMU is included."
        if np.any(replay.config.dvl.lever_arm_m)
        else ""
    )
    yield Figure(
        f"Acceleration derived from the DVL{' and from the reference' if REFERENCE in curves else ''}",
        f"Slope of the velocity in body axes, at the middle of each window.{swing}",
        tuple(
            Panel(
                f"acceleration {direction} [m/s²]",
                clock.label,
                tuple(Curve(time, values[:, axis], style) for style, values in curves.items()),
            )
            for axis, direction in enumerate(("forward", "starboard", "down"))
        ),
        tuple(legend),
    )


# --- Shades behind the panels over time: where the vehicle turned, and where the DVL has no velocity.

# In a turn the heading changes by more, over the time of several pings.
TURNS_DEGPS = 1.5
OVER_S = 10.0
SILENT: Final = 3.0  # A gap of the DVL is longer than this many usual steps.
MOST: Final = 40  # With more stretches of a kind, none is shaded, since they would hide the curves.


def shades_of(replay: Replay) -> tuple[Shade, ...]:
    """Find what is shaded behind the panels over time of a replay."""
    baseline = replay.histories[0]
    clock = Clock(replay.start_ns, replay.end_ns)
    rows = np.flatnonzero(baseline.updated)
    turns = np.empty((0, 2), dtype=np.int64)
    if len(rows) >= 3:
        time_ns = baseline.time_ns[rows]
        heading = rpy_from_mat(baseline.mat_nb[rows])[:, 2]
        unwrapped = np.cumsum(np.append(0.0, wrap_angle(np.diff(heading))))
        time_s = seconds(time_ns, time_ns[0])
        before, after = (
            np.interp(np.clip(time_s + half_s, 0.0, time_s[-1]), time_s, unwrapped)
            for half_s in (-OVER_S / 2.0, OVER_S / 2.0)
        )
        turning = np.abs(after - before) > TURNS_DEGPS * OVER_S * DEG
        edges = np.flatnonzero(
            np.diff(np.concatenate([[False], turning, [False]]).astype(np.int8))
        ).reshape(-1, 2)
        turns = time_ns[np.minimum(edges, len(time_ns) - 1)]
    pings_ns = replay.velocities.time_ns
    inside = pings_ns[(pings_ns > replay.start_ns) & (pings_ns < replay.end_ns)]
    steps_ns = np.concatenate([[replay.start_ns], inside, [replay.end_ns]])
    gaps = np.flatnonzero(np.diff(steps_ns) > SILENT * float(np.median(np.diff(steps_ns))))
    silent = np.column_stack([steps_ns[gaps], steps_ns[gaps + 1]])
    return tuple(
        Shade(float(begin), float(end), style)
        for style, stretches in (("turn", turns), ("silent", silent))
        if len(stretches) <= MOST
        for begin, end in clock.time(stretches)
    )


def _over_time(panel: Panel, shades: tuple[Shade, ...], clock: Clock) -> Panel:
    """Give a panel over time the shades, and the axis of all such panels."""
    is_linear = panel.x_label == clock.label and panel.x_scale == "linear"
    if is_linear:
        return replace(panel, shades=shades, x_limits=clock.limits)
    return panel


# --- Strips: coverage of the dive by each sensor.

_COLUMNS = 300
_HEIGHT = 20
_TICKS = 5
_RIGHTMOST: Final = 97.0  # Labels from here on end at their place, in percent of the width.
_FEWEST_BEAMS: Final = 3  # With fewer valid beams a ping has no velocity.


def coverage_strips(replay: Replay) -> str:
    """Draw a strip for each sensor, as HTML: as high as the share of the time that its valid samples cover."""
    clock = Clock(replay.start_ns, replay.end_ns)
    rows = []
    for name, time_ns, valid in _sources(replay.dive):
        shares = covered_shares(time_ns, valid, clock.start_ns, clock.end_ns)
        heights = np.round(shares * _HEIGHT).astype(int)
        changes = np.flatnonzero(np.diff(heights, prepend=-1)).tolist()
        steps = "".join(f"H{column}V{_HEIGHT - heights[column]}" for column in changes)
        rows.append(
            f'<div class="source"><span>{escape(name)}</span>'
            f'<span class="share">{100.0 * float(shares.mean()):.1f} %</span></div>'
            f'<svg class="strip" viewBox="0 0 {_COLUMNS} {_HEIGHT}" preserveAspectRatio="none">'
            f'<path d="M0 {_HEIGHT}{steps}H{_COLUMNS}V{_HEIGHT}Z"/></svg>'
        )
    ticks = [*Axis(*clock.limits, 0.0, 100.0).ticks(_TICKS), (100.0, clock.label)]
    times = "".join(
        f'<text class="tick" x="{at:.1f}%" y="{28 if at == 100.0 else 12}" '
        f'text-anchor="{"end" if at > _RIGHTMOST else "middle"}">{label}</text>'
        for at, label in ticks
    )
    return f'<div class="strips">{"".join(rows)}<div></div><svg class="times">{times}</svg></div>'


def _sources(dive: Dive) -> Iterator[tuple[str, TimeNs, Mask]]:
    """Yield name, times and validity of the samples of each sensor, or of each beam."""
    yield "IMU", dive.imu.time_ns, np.ones(len(dive.imu.time_ns), dtype=bool)
    if dive.dvl.beam_velocity_mps is not None:
        valid = np.isfinite(dive.dvl.beam_velocity_mps)
        for beam, column in enumerate(valid.T):
            yield f"DVL beam {beam}", dive.dvl.time_ns, column
        yield "DVL, three beams or more", dive.dvl.time_ns, valid.sum(axis=1) >= _FEWEST_BEAMS
    elif dive.dvl.velocity_d is not None:
        yield "DVL velocity", dive.dvl.time_ns, np.isfinite(dive.dvl.velocity_d.sum(axis=1))
    if (reference := dive.reference) is not None:
        # One strip where each row has all that the reference ever has, else one for each quantity.
        known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
        if all(rows.all() for rows in known.values()):
            known = {"": np.ones(len(reference.time_ns), dtype=bool)}
        for quantity, rows in known.items():
            yield f"reference {quantity}".strip(), reference.time_ns[rows], rows[rows]


def covered_shares(
    time_ns: TimeNs, valid: Mask, start_ns: int, end_ns: int, columns: int = _COLUMNS
) -> Floats:
    """Return the share of each column of a span, (columns,), that valid samples, (k,), cover, from 0 to 1."""
    if len(time_ns) < 2:
        return np.zeros(columns)
    # A sample lasts until the next, but no longer than some usual steps.
    steps_ns = np.diff(time_ns).astype(np.float64)
    usual_ns = float(np.median(steps_ns))
    lasts_ns = np.minimum(np.append(steps_ns, usual_ns), _MISSING * usual_ns) * valid
    # What is covered until each edge: the samples before it, less what of the last is still to come.
    edges_ns = np.linspace(start_ns, end_ns, columns + 1, dtype=np.int64)
    before_ns = np.append(0.0, np.cumsum(lasts_ns))
    rows = np.searchsorted(time_ns, edges_ns, side="right")
    latest = np.maximum(rows - 1, 0)
    unfinished_ns = np.maximum(lasts_ns[latest] - (edges_ns - time_ns[latest]), 0.0)
    covered_ns = before_ns[rows] - np.where(rows > 0, unfinished_ns, 0.0)
    shares: Floats = np.clip(np.diff(covered_ns) / np.diff(edges_ns), 0.0, 1.0)
    return shares
