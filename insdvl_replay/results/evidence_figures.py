"""The evidence over time: how filters drift while the DVL is withheld, and how errors of the start wear off."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from insdvl_replay.core.states import DEG
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import CoastingRow, EvidenceRow
from insdvl_replay.evaluation.convergence import ConvergenceCurves
from insdvl_replay.evaluation.outage_test import SHOWN_EVERY_S, SHOWN_S, OutageCurve
from insdvl_replay.report.plots.panel import (
    BELIEVED,
    LIMIT,
    REFERENCE,
    Band,
    Curve,
    Figure,
    Panel,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.results.filter_figures import Clock, filter_legend

_SHOWN: Final = {
    "level": ("level: roll and pitch [deg]", DEG),
    "heading": ("heading [deg]", DEG),
    "velocity": ("horizontal velocity [m/s]", 1.0),
}
"""By quantity of convergence the title of its panel, and its unit in SI."""
REACHED: Final = "reached"
_FIRST_S, _FIRST = 1.0, 1e-3
"""Seconds, and share of the time, that are left out: no ping has come, and half of the axis would show them."""


def coasting_figure(curves: Mapping[str, OutageCurve], clock: Clock) -> Iterator[Figure]:
    """Draw the drift without velocities over time, and where in the dive it is large; nothing without windows."""
    if not curves:
        return
    windows = len(next(iter(curves.values())).begin_ns)
    how = "of one window" if windows == 1 else f"over {windows} windows, one every {SHOWN_EVERY_S} s"
    yield Figure(
        "Coasting: how far they drift while the DVL is withheld",
        f"By what the withheld velocities say, with or without a reference. First the median {how}, and shaded where "
        f"95 % of them stay; then each window by itself, where it begins. {CoastingRow.footnote}",
        (drift_panel(curves), _windows_panel(curves, clock)),
        filter_legend(list(curves)),
    )


def drift_panel(curves: Mapping[str, OutageCurve]) -> Panel:
    """Draw the drift without velocities over the time they are withheld: median, and where 95 % stay."""
    lines, bands = [], []
    for number, (name, curve) in enumerate(curves.items()):
        lines.append(Curve(curve.time_s, curve.median_m, filter_style(number), label=name))
        bands.append(Band(curve.time_s, np.zeros_like(curve.p95_m), curve.p95_m, filter_style(number)))
    return Panel("horizontal drift [m]", "time withheld [s]", dashes_on_top(lines), tuple(bands))


def _windows_panel(curves: Mapping[str, OutageCurve], clock: Clock) -> Panel:
    lines = [
        Curve(clock.time(curve.begin_ns), curve.drift_m, filter_style(number))
        for number, curve in enumerate(curves.values())
    ]
    return Panel(f"drift in {SHOWN_S} s, by where they begin [m]", clock.label, dashes_on_top(lines))


def convergence_figure(curves: Mapping[str, ConvergenceCurves], evidence: Sequence[EvidenceRow]) -> Iterator[Figure]:
    """Draw how the true errors of drawn starts wear off, one panel for each quantity; nothing where none is known.

    Parameters
    ----------
    curves : mapping of str to ConvergenceCurves
        By quantity of `quantities.CONVERGED`.
    evidence : sequence of EvidenceRow
        Has the times at which they are down.
    """
    shown = {quantity: curves[quantity] for quantity in _SHOWN if quantity in curves}
    if not shown:
        return
    names = list(next(iter(shown.values())).rms)
    yield Figure(
        "Measured convergence: how errors of the start wear off",
        "Rms of the true errors of runs from drawn starts, each over the last tenth of the time that has passed. A "
        f"point marks from when on a filter is as good as {names[0]} is at the end; there is none where nothing falls.",
        tuple(_convergence_panel(quantity, one, names, evidence) for quantity, one in shown.items()),
        (
            *filter_legend(names),
            (f"{REFERENCE} {BELIEVED}", "what a filter believes of its error"),
            (LIMIT, f"rms of {names[0]} at the end, and one standard error more"),
        ),
    )


def _convergence_panel(
    quantity: str, curves: ConvergenceCurves, names: Sequence[str], evidence: Sequence[EvidenceRow]
) -> Panel:
    title, unit = _SHOWN[quantity]
    styles = {name: filter_style(number) for number, name in enumerate(names)}
    shown = curves.time_s >= max(_FIRST_S, _FIRST * curves.time_s[-1])
    time_s = curves.time_s[shown]
    measured = [Curve(time_s, curves.rms[name][shown] / unit, style) for name, style in styles.items()]
    believed = [
        Curve(time_s, curves.believed[name][shown] / unit, f"{style} {BELIEVED}") for name, style in styles.items()
    ]
    limit = curves.limit / unit
    reached = [
        Curve(np.array([reached_s]), np.array([limit]), f"{styles[name]} {REACHED}", points=True)
        for name, reached_s in _reached_s(quantity, names[0], evidence).items()
    ]
    curves_in_order = (*believed, *dashes_on_top(measured), *reached)
    return Panel(title, "time [s]", curves_in_order, levels=(limit,), y_scale="log", x_scale="log")


def _reached_s(quantity: str, baseline: str, evidence: Sequence[EvidenceRow]) -> dict[str, float]:
    """Return when each filter has converged, those that have."""
    rows = [row for row in evidence if row.quantity == f"convergence_{quantity}"]
    times_s = {row.filter: finite(row.value) for row in rows}
    if rows:
        times_s[baseline] = finite(rows[0].baseline)
    return {name: time_s for name, time_s in times_s.items() if np.isfinite(time_s)}
