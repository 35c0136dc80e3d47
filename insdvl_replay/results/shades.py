"""What is shaded behind every panel over time: where the vehicle turned, and where the DVL said nothing."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import TimeNs, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle
from insdvl_replay.replay import Replay
from insdvl_replay.report.plots.panel import Figure, Panel, Shade
from insdvl_replay.results.filter_figures import Clock

TURNS_DEGPS: Final = 1.5
"""The heading changes by more, over the time of several pings."""
OVER_S: Final = 10.0
SILENT: Final = 3.0
"""Pings are missing where none came for this many of the usual steps."""
MOST: Final = 40
"""More stretches of a kind would hide the curves: then none is shaded."""
TURN, NO_DVL = "turn", "silent"


def shades_of(replay: Replay) -> tuple[Shade, ...]:
    """Find what is shaded behind the panels over time of a replay."""
    clock = Clock(replay.start_ns, replay.end_ns)
    turns = _turns(replay.histories[0])
    silent = _silent(replay.velocities.time_ns, replay.start_ns, replay.end_ns)
    return tuple(
        Shade(float(begin), float(end), style)
        for style, stretches in ((TURN, turns), (NO_DVL, silent))
        if len(stretches) <= MOST
        for begin, end in clock.time(np.array(stretches, dtype=np.int64).reshape(-1, 2))
    )


def _turns(history: History) -> list[tuple[int, int]]:
    rows = np.flatnonzero(history.updated)
    time_ns = history.time_ns[rows]
    if len(rows) < 3:
        return []
    heading = np.concatenate([[0.0], np.cumsum(wrap_angle(np.diff(rpy_from_mat(history.mat_nb[rows])[:, 2])))])
    time_s = seconds(time_ns, time_ns[0])
    before, after = (
        np.interp(np.clip(time_s + half, 0.0, time_s[-1]), time_s, heading) for half in (-OVER_S / 2.0, OVER_S / 2.0)
    )
    turning: NDArray[np.bool_] = np.abs(after - before) > TURNS_DEGPS * OVER_S * DEG
    return _stretches(turning, time_ns)


def _silent(time_ns: TimeNs, start_ns: int, end_ns: int) -> list[tuple[int, int]]:
    edges = np.concatenate([[start_ns], time_ns[(time_ns > start_ns) & (time_ns < end_ns)], [end_ns]])
    steps = np.diff(edges)
    usual = float(np.median(steps))
    return [(int(edges[place]), int(edges[place + 1])) for place in np.flatnonzero(steps > SILENT * usual)]


def _stretches(inside: NDArray[np.bool_], time_ns: TimeNs) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8))).reshape(-1, 2)
    return [(int(time_ns[begin]), int(time_ns[min(end, len(time_ns) - 1)])) for begin, end in edges]


def shaded(figures: Sequence[Figure], shades: tuple[Shade, ...], time_label: str) -> tuple[Figure, ...]:
    """Put shades behind the panels of figures that have time across."""
    return tuple(
        replace(figure, panels=tuple(shaded_panel(panel, shades, time_label) for panel in figure.panels))
        for figure in figures
    )


def shaded_panel(panel: Panel, shades: tuple[Shade, ...], time_label: str) -> Panel:
    """Put shades behind a panel, if it has time across."""
    return replace(panel, shades=shades) if panel.x_label == time_label else panel
