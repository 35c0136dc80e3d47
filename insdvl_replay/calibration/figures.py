"""A calibration in pictures: innovations before and after, the cost of a delay, how dives differ and coast."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from insdvl_replay.calibration.calibration import AXES, Calibration
from insdvl_replay.calibration.certainty import mean_change, one_by_one
from insdvl_replay.calibration.fit import delay_profile
from insdvl_replay.calibration.innovations import LATEST_S, SKIPPED, DiveInnovations
from insdvl_replay.calibration.parameters import DELAY, LABELS, NAMES, PARAMETERS
from insdvl_replay.calibration.rows import HeldOutRow
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.report.document import counted
from insdvl_replay.report.plots.panel import LIMIT, REFERENCE, Curve, Figure, Panel, filter_style
from insdvl_replay.results.filter_figures import Clock

DRAWN: Final = 6
"""Dives whose course is drawn; the tables have all of them."""
BEFORE, AFTER = filter_style(1), filter_style(0)
_LEGEND: Final = ((BEFORE, "before"), (AFTER, "after"))
_PROFILE_S: Final = np.linspace(-LATEST_S, LATEST_S, 17)
_SHARE: Final = 0.995
"""Of the innovations so many are inside a panel: wild ones would flatten the rest."""
_AIR: Final = 1.2
_OF_DIVES: Final = "dive, in the order of the table"


def calibration_figures(found: Calibration, dives: Sequence[DiveInnovations]) -> tuple[Figure, ...]:
    """Draw a calibration; what there is nothing to draw of is left out."""
    dives = [found.noise.applied(dive) for dive in dives]
    figures = [_innovations(found.change_of_dive(i), dive) for i, dive in enumerate(dives[:DRAWN])]
    figures.append(_delays(found, dives))
    return (*figures, *_between_dives(found), *_coasting(found.held_out))


def _innovations(change: Floats, dive: DiveInnovations) -> Figure:
    before, after = (dive.residuals(at) for at in (np.zeros(len(NAMES)), change))
    time_ns = dive.prepared.velocities.time_ns[SKIPPED:-SKIPPED]
    clock = Clock(dive.prepared.alignment.start_ns, dive.prepared.end_ns)
    shown = [
        Curve(clock.time(time_ns), column, style)
        for values, style in ((before, BEFORE), (after, AFTER))
        for column in values.T
    ]
    panels = []
    for axis, pair in zip(AXES, zip(shown[:3], shown[3:], strict=True), strict=True):
        height = _AIR * float(np.quantile(np.abs(np.concatenate([curve.y for curve in pair])), _SHARE))
        panels.append(Panel(f"innovation {axis} [sd]", clock.label, pair, y_limits=(-height, height)))
    return Figure(
        f"Innovations of {dive.name}",
        "Predicted minus measured velocity, in its own standard deviation. What is left should have no pattern.",
        tuple(panels),
        _LEGEND,
    )


def _delays(found: Calibration, dives: Sequence[DiveInnovations]) -> Figure:
    """Draw what a delay costs beyond the best, with all else as it was found."""
    panels = []
    for i, dive in enumerate(dives[:DRAWN]):
        change = found.change_of_dive(i)
        delays_s = np.union1d(_PROFILE_S, change[DELAY])
        costs = delay_profile(dive, change, delays_s)
        costs = costs - costs.min()
        at = np.searchsorted(delays_s, change[DELAY])
        proposed = Curve(delays_s[[at, at]], np.array([0.0, costs.max()]), REFERENCE)
        panels.append(Panel(dive.name, "delay [s], from the configured one", (Curve(delays_s, costs, AFTER), proposed)))
    return Figure(
        "What a delay costs",
        "The sum of the squares of the innovations, far ones counted less, above its least. A deep valley is a sure "
        "delay; several of them, or a floor, are none.",
        tuple(panels),
        ((AFTER, "cost"), (REFERENCE, "as fitted")),
    )


def _between_dives(found: Calibration) -> Iterator[Figure]:
    """Draw what each dive says by itself; nothing of one dive."""
    own, own_sd = one_by_one(found.fit)
    common = mean_change(found.fit)
    drawn = found.fit.unknowns.free
    if len(own) < 2 or not drawn.any():
        return
    place = np.arange(1.0, len(own) + 1.0)
    panels = []
    for row, parameter in enumerate(PARAMETERS):
        if not drawn[row]:
            continue
        value, sd = parameter.shown_as * own[:, row], parameter.shown_as * own_sd[:, row]
        bars = Curve(np.repeat(place, 3), _interrupted(value - sd, value + sd), BEFORE)
        panels.append(
            Panel(
                f"{LABELS[parameter.name]} [{parameter.unit}]",
                _OF_DIVES,
                (bars, Curve(place, value, BEFORE, points=True)),
                levels=(parameter.shown_as * float(common[row]),),
                x_whole=True,
            )
        )
    yield Figure(
        "What each dive says by itself",
        "By innovations alone: the change that one dive would make, with its formal standard deviation.",
        tuple(panels),
        ((BEFORE, "one dive"), (LIMIT, "all dives")),
    )


def _interrupted(low: Floats, high: Floats) -> Floats:
    """Lay lines end to end with a gap behind each."""
    return np.column_stack([low, high, np.full(len(low), np.nan)]).ravel()


def _coasting(rows: Sequence[HeldOutRow]) -> Iterator[Figure]:
    known = [row for row in rows if row.drift_before_m is not None and row.drift_after_m is not None]
    if not known:
        return
    place = np.arange(1.0, len(known) + 1.0)
    pairs = np.array([[row.drift_before_m, row.drift_after_m] for row in known], dtype=np.float64)
    way = Curve(np.repeat(place, 3), _interrupted(pairs[:, 0], pairs[:, 1]), REFERENCE)
    ends = [Curve(place, pairs[:, i], style, points=True) for i, style in enumerate((BEFORE, AFTER))]
    yield Figure(
        "Coasting on dives that were not fitted",
        f"Median drift in 60 s without velocities; {counted(len(known), 'dive')} had windows.",
        (Panel("horizontal drift [m]", _OF_DIVES, (way, *ends), x_whole=True),),
        _LEGEND,
    )
