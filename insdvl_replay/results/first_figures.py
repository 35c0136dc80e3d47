"""The three pictures of the first screen of a page: the error over time, the track, what is believed and measured."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import NS_PER_S, Floats
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.replay import Replay
from insdvl_replay.report.plots.panel import REFERENCE, Band, Curve, Panel, dashes_on_top, filter_style
from insdvl_replay.results.evidence_figures import drift_panel
from insdvl_replay.results.filter_figures import Clock

SEEN: Final = 0.08
"""Share of the size of a track that its largest error is drawn as, at least half of it."""


def first_panels(replay: Replay) -> Iterator[Panel]:
    """Draw the horizontal error over time, or the drift without velocities, and the track."""
    clock = Clock(replay.start_ns, replay.end_ns)
    if replay.curves.position:
        yield position_panel(replay, clock)
    elif replay.curves.coasting:
        yield drift_panel(replay.curves.coasting)
    yield track_panel(replay)


def position_panel(replay: Replay, clock: Clock) -> Panel:
    """Draw the middle of the horizontal position errors from all starts, and between which they lie."""
    curves, bands = [], []
    for number, (name, curve) in enumerate(replay.curves.position.items()):
        time = clock.time(replay.start_ns + np.round(curve.time_s * NS_PER_S).astype(np.int64))
        curves.append(Curve(time, curve.median_m, filter_style(number), label=name))
        if curve.starts > 1:
            bands.append(Band(time, curve.low_m, curve.high_m, filter_style(number)))
    return Panel("horizontal position error [m]", clock.label, dashes_on_top(curves), tuple(bands))


def track_panel(replay: Replay) -> Panel:
    """Draw the tracks from above; beside a reference, their errors so much larger that they are seen."""
    origin = replay.histories[0].position[0]
    reference = replay.dive.reference
    known = {name: errors for name, errors in replay.errors.items() if np.isfinite(errors.position_error_ned_m).any()}
    if reference is None or not reference.has_position or not known:
        tracks = [
            Curve(*_east_north(history.position, origin), filter_style(number), label=history.filter)
            for number, history in enumerate(replay.histories)
        ]
        return Panel("track: north [m] over east [m]", "east [m]", dashes_on_top(tracks), equal=True, low=True)
    inside = (reference.time_ns >= replay.start_ns) & (reference.time_ns <= replay.end_ns)
    times_ns, (east, north) = reference.time_ns[inside], _east_north(reference.position[inside], origin)
    largest = max(float(np.nanmax(np.abs(errors.position_error_ned_m[:, :2]))) for errors in known.values())
    times = _magnified(largest, max(float(np.ptp(east[np.isfinite(east)])), float(np.ptp(north[np.isfinite(north)]))))
    curves = []
    for number, history in enumerate(replay.histories):
        if (errors := known.get(history.filter)) is None:
            continue
        rows = np.clip(np.searchsorted(times_ns, errors.time_ns), 0, len(times_ns) - 1)
        east_error, north_error = (times * errors.position_error_ned_m[:, axis] for axis in (1, 0))
        curves.append(
            Curve(east[rows] + east_error, north[rows] + north_error, filter_style(number), label=history.filter)
        )
    curves.append(Curve(east, north, REFERENCE, label="reference"))
    much = f", errors {times:g} times as large" if times > 1.0 else ""
    return Panel(f"track{much}: north [m]", "east [m]", dashes_on_top(curves), equal=True, low=True)


def _east_north(position: Floats, origin: Floats) -> tuple[Floats, Floats]:
    ned_m = north_east_down_m(position, np.broadcast_to(origin, position.shape))
    return ned_m[:, 1], ned_m[:, 0]


def _magnified(largest_m: float, size_m: float) -> float:
    """Return 1, 2, 5, 10 and so on: how much larger errors are drawn to be seen beside the track."""
    wanted = SEEN * size_m / largest_m if largest_m > 0.0 else 1.0
    steps = [digit * 10.0**power for power in range(7) for digit in (1.0, 2.0, 5.0)]
    return max((step for step in steps if step <= wanted), default=1.0)
