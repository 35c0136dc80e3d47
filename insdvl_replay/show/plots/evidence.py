"""The evidence on one dive as curves: the position error, the drift without DVL, convergence from random starts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import EvidenceRow, OutageRow, finite
from insdvl_replay.document.parts import (
    LIMIT,
    PREDICTED,
    REFERENCE,
    Curve,
    Figure,
    Panel,
    Scale,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.convergence import ConvergenceCurves
from insdvl_replay.evaluation.evaluate import PositionCurve
from insdvl_replay.evaluation.outage_test import SHOWN_S, OutageCurve
from insdvl_replay.show.plots.curves import (
    TIME_S,
    Series,
    StoredDive,
    figure_for_paper,
    filter_curves,
    filter_legend,
    known_number,
    thin_curves,
)

REACHED: Final = "reached"
_COMPLETE: Final = 0.98  # Share of the dive from which a curve is of all of it.


# --- The position error, on the first screen of a page.


def position_error_panel(
    positions: Mapping[str, PositionCurve], start_ns: int, clock: Clock
) -> Panel:
    """Draw the horizontal error over time, with the range of the runs from random starts, by filter."""
    curves = []
    for number, (name, curve) in enumerate(positions.items()):
        time = clock.time(start_ns + np.round(curve.time_s * NS_PER_S).astype(np.int64))
        band = (curve.low_m, curve.high_m) if curve.starts > 1 else None
        curves.append(Curve(time, curve.median_m, filter_style(number), label=name, band=band))
    title = "horizontal position error [m]"
    # Runs from random starts may end before a long dive does.
    ends = curves[0].x[-1]
    if ends < _COMPLETE * clock.limits[1]:
        title += f", first {ends:.0f} {clock.unit}"
    return Panel(title, clock.label, dashes_on_top(curves))


# --- The outage test.

WITHOUT_DVL: Final = "time without DVL [s]"


def outage_figure(curves: Mapping[str, OutageCurve], clock: Clock) -> Iterator[Figure]:
    """Draw the drift without DVL over time and over the dive; nothing without windows."""
    if not curves:
        return
    [first, *_] = curves.values()
    windows = len(first.begin_ns)
    how = f"over {windows} windows at equal distances"
    if windows == 1:
        how = "of one window"
    by_window = [
        Series(name, clock.time(curve.begin_ns), curve.drift_m) for name, curve in curves.items()
    ]
    yield Figure(
        "DVL outage test: drift without the DVL",
        f"The drift is measured by the held-out velocities, so no reference is needed. Left: median {how}. Right: "
        f"each window, at its start. {OutageRow.footnote}",
        (
            drift_panel(curves),
            Panel(
                f"drift in {SHOWN_S} s, at the start of each window [m]",
                clock.label,
                filter_curves(by_window),
                y_scale="log",
            ),
        ),
        (*filter_legend(curves), (f"{REFERENCE} {PREDICTED}", "95 % of the windows drift less")),
    )


def drift_panel(curves: Mapping[str, OutageCurve]) -> Panel:
    """Draw the drift over the time without DVL: median, and the limit of 95 %."""
    medians = []
    limits_95 = []
    for name, curve in curves.items():
        medians.append(Series(name, curve.time_s, curve.median_m))
        limits_95.append(Series(name, curve.time_s, curve.p95_m))
    return _drift_panel(filter_curves(medians, named=True), limits_95)


def _drift_panel(
    medians: Sequence[Curve], limits_95: Sequence[Series], x_scale: Scale = "linear"
) -> Panel:
    curves = (*thin_curves(limits_95, "95 %"), *medians)
    title = "horizontal drift [m]"
    return Panel(title, WITHOUT_DVL, curves, x_scale=x_scale, y_scale="log")


def outage_for_paper(dive: StoredDive) -> Figure:
    """Draw the drift over the time without DVL at the lengths of windows that the outage test has."""
    medians = []
    limits_95 = []
    rows = dive.tables.get("outage", ())
    for name in dive.trajectory.names:
        length_s = []
        median_m = []
        p95_m = []
        for row in rows:
            if row.get("filter") == name:
                length_s.append(float(str(row["window_s"])))
                median_m.append(known_number(row.get("drift_median_m")))
                p95_m.append(known_number(row.get("drift_p95_m")))
        medians.append(Series(name, np.array(length_s), np.array(median_m)))
        limits_95.append(Series(name, np.array(length_s), np.array(p95_m)))
    lines = filter_curves(medians)
    points = [replace(line, points=True) for line in lines]
    panels = []
    if rows:
        panels.append(_drift_panel((*lines, *points), limits_95, x_scale="log"))
    return figure_for_paper(
        dive, panels, [(REFERENCE, "median"), (f"{REFERENCE} {PREDICTED}", "95 %")]
    )


# --- Measured convergence.

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
    names: list[str] = []
    panels = []
    for quantity, (title, unit) in _CONVERGED.items():
        if quantity not in curves:
            continue
        found = curves[quantity]
        names = list(found.rms)
        shown = found.time_s >= max(_FIRST_S, _FIRST * found.time_s[-1])
        time_s = found.time_s[shown]
        measured = []
        predicted = []
        for name in names:
            measured.append(Series(name, time_s, found.rms[name][shown] / unit))
            predicted.append(Series(name, time_s, found.predicted[name][shown] / unit))
        limit = found.limit / unit
        rows = [row for row in evidence if row.quantity == f"convergence_{quantity}"]
        drawn = (*_converging(measured, predicted), *_reached_points(names, rows, limit))
        panels.append(Panel(title, TIME_S, drawn, levels=(limit,), y_scale="log", x_scale="log"))
    if panels:
        yield Figure(
            "Convergence",
            "The curves are the rms of the true errors of runs from random starts, over the last tenth of the "
            "elapsed time. A "
            f"point marks the time from which a filter is as good as {names[0]} at the end. There is no point if the "
            f"error does not fall.",
            tuple(panels),
            (
                *filter_legend(names),
                (f"{REFERENCE} {PREDICTED}", "sigma predicted by the filter"),
                (LIMIT, f"rms of {names[0]} at the end, plus one standard error"),
            ),
        )


def _converging(measured: Sequence[Series], predicted: Sequence[Series]) -> tuple[Curve, ...]:
    return (*thin_curves(predicted, "sigma"), *filter_curves(measured))


def _reached_points(
    names: Sequence[str], rows: Sequence[EvidenceRow], limit: float
) -> tuple[Curve, ...]:
    """Mark where each filter reaches the limit, if it does."""
    reached_s = {row.filter: finite(row.value) for row in rows}
    if rows:
        reached_s[names[0]] = finite(rows[0].baseline)
    points = []
    for number, name in enumerate(names):
        style = f"{filter_style(number)} {REACHED}"
        time_s = np.array([reached_s.get(name, np.nan)])
        points.append(Curve(time_s, np.array([limit]), style, points=True))
    return tuple(point for point in dashes_on_top(points) if np.isfinite(point.x[0]))


def convergence_for_paper(dive: StoredDive) -> Figure:
    """Draw the true errors of random starts, and what the filters predict of them, over time."""
    names = dive.trajectory.names
    curves = dive.trajectory.curves
    panels = []
    for quantity, (title, unit) in _CONVERGED.items():
        if f"{quantity}_time_s" not in curves:
            continue
        time_s = curves[f"{quantity}_time_s"]
        measured = []
        predicted = []
        for number, name in enumerate(names):
            measured.append(Series(name, time_s, curves[f"{quantity}_rms"][number] / unit))
            predicted.append(Series(name, time_s, curves[f"{quantity}_predicted"][number] / unit))
        panels.append(Panel(title, TIME_S, _converging(measured, predicted), y_scale="log"))
    return figure_for_paper(
        dive, panels, [(REFERENCE, "measured"), (f"{REFERENCE} {PREDICTED}", "predicted")]
    )
