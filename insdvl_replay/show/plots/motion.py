"""The vehicle: its track, its motion, its accelerations."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import DEG
from insdvl_replay.document.parts import (
    REFERENCE,
    Curve,
    Figure,
    Panel,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.evaluation.reference_errors import (
    ReferenceErrors,
    acceleration_at,
    reference_acceleration,
)
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle
from insdvl_replay.preparation.replay import Replay
from insdvl_replay.show.plots.curves import (
    Series,
    StoredDive,
    figure_for_paper,
    filter_curves,
)

DERIVED: Final = "derived"
# Added to the style of a filter: its places are not read at the cursor.
MAGNIFIED: Final = "magnified"
# Share of the size of a track that its largest error is drawn as; a round factor makes it 40 % of that or more.
SEEN: Final = 0.08
_EAST: Final = "east [m]"
_TRACK: Final = "track: north [m] over east [m]"
_MOST_ENLARGED: Final = 5e6
_VECTORS: Final = 60  # number of vectors of each filter


# --- The track.


@dataclass(frozen=True)
class _Track:
    """The way of a filter or of the reference, from where the baseline starts."""

    name: str
    style: str
    time_ns: TimeNs  # (k,)
    ned_m: Floats  # (k, 3)
    time_s: Floats  # (k,), from the start of the replay

    def from_above(self) -> Curve:
        """Return the track as it is seen from above."""
        north_m = self.ned_m[:, 0]
        east_m = self.ned_m[:, 1]
        return Curve(east_m, north_m, self.style, label=self.name, time=self.time_s)


def _tracks(replay: Replay) -> list[_Track]:
    """Return the tracks of the filters, then that of the reference, if its positions are known."""
    motions: list[tuple[str, str, History | ReferenceColumns]] = []
    for number, history in enumerate(replay.histories):
        motions.append((history.filter, filter_style(number), history))
    reference = replay.dive.reference
    if reference is not None and reference.has_position:
        inside = reference.within(replay.start_ns, replay.end_ns)
        motions.append((REFERENCE, REFERENCE, inside))
    tracks = []
    for name, style, motion in motions:
        origin = np.broadcast_to(replay.histories[0].position[0], motion.position.shape)
        ned_m = north_east_down_m(motion.position, origin)
        time_s = seconds(motion.time_ns, replay.start_ns)
        tracks.append(_Track(name, style, motion.time_ns, ned_m, time_s))
    return tracks


def track_panel(replay: Replay) -> Panel:
    """Draw the tracks from above in their true size."""
    drawn = [track.from_above() for track in _tracks(replay)]
    return Panel(_TRACK, _EAST, dashes_on_top(drawn), equal=True, low=True)


def error_vectors_panel(replay: Replay) -> Iterator[Panel]:
    """Draw the position errors as vectors beside the track of the reference, magnified so that they are seen.

    Without errors there is no such panel. It is folded, since its vectors end where the vehicle never was.
    """
    errors = {}
    for name, found in replay.errors.items():
        if np.isfinite(found.position_error_ned_m).any():
            errors[name] = found
    if not errors:
        return
    reference = _tracks(replay)[-1]
    times = _magnification(reference, errors)
    drawn = []
    for number, history in enumerate(replay.histories):
        if history.filter in errors:
            style = f"{filter_style(number)} {MAGNIFIED} solid"
            drawn.append(_vectors(history.filter, style, reference, errors[history.filter], times))
    size = f", {times:g} times as large" if times > 1.0 else ""
    title = f"error vectors{size}: north [m]"
    curves = (reference.from_above(), *drawn)
    yield Panel(title, _EAST, curves, equal=True, low=True, folded=True)


def _vectors(
    name: str,
    style: str,
    reference: _Track,
    errors: ReferenceErrors,
    times: float,  # as large as they are
) -> Curve:
    """Return the errors of a filter as vectors from the track of the reference, evenly over time."""
    known = np.flatnonzero(np.isfinite(errors.position_error_ned_m[:, :2]).all(axis=1))
    picked = known[np.linspace(0, len(known) - 1, _VECTORS).astype(np.int64)]
    last = len(reference.time_ns) - 1
    rows = np.clip(np.searchsorted(reference.time_ns, errors.time_ns[picked]), 0, last)
    feet_m = reference.ned_m[rows, :2]
    tips_m = feet_m + times * errors.position_error_ned_m[picked, :2]
    apart = np.full_like(feet_m, np.nan)  # interrupts the line behind each vector
    north_m, east_m = np.stack([feet_m, tips_m, apart], axis=1).reshape(-1, 2).T
    return Curve(east_m, north_m, style, label=name)


def _magnification(reference: _Track, errors: Mapping[str, ReferenceErrors]) -> float:
    """Return a round factor by which errors are enlarged, so that the largest is seen beside the track."""
    sizes_m = []
    for axis_m in (reference.ned_m[:, 1], reference.ned_m[:, 0]):
        sizes_m.append(float(np.ptp(axis_m[np.isfinite(axis_m)])))
    largest_m = 0.0
    for found in errors.values():
        largest_m = max(largest_m, float(np.nanmax(np.abs(found.position_error_ned_m[:, :2]))))
    if largest_m == 0.0:
        return 1.0
    wanted = SEEN * max(sizes_m) / largest_m
    return _round_factor(min(wanted, _MOST_ENLARGED))


def _round_factor(wanted: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20 and so on that is not above what is wanted; at least 1."""
    if wanted < 1.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    for digit in (5.0, 2.0):
        if digit * power <= wanted:
            return digit * power
    return power


def track_for_paper(dive: StoredDive) -> Figure:
    """Draw the tracks from above, with that of the reference if it is known."""
    series = []
    for name in dive.trajectory.names:
        east_m = dive.trajectory.of(name, "position_e_m")
        series.append(Series(name, east_m, dive.trajectory.of(name, "position_n_m")))
    *others, baseline = filter_curves(series)
    reference = []
    legend = []
    if dive.reference is not None and dive.reference["position_n_m"].notna().any():
        east_m = dive.reference["position_e_m"].to_numpy()
        north_m = dive.reference["position_n_m"].to_numpy()
        reference.append(Curve(east_m, north_m, REFERENCE))
        legend.append((REFERENCE, REFERENCE))
    panel = Panel("north [m]", _EAST, (*others, *reference, baseline), equal=True)
    return figure_for_paper(dive, [panel], legend)


# --- The motion.


def motion_figure(replay: Replay, clock: Clock) -> Figure:
    """Draw the tracks from above and over time, and the motion by the baseline."""
    tracks = _tracks(replay)
    above = [replace(track.from_above(), label="") for track in tracks]
    down = [Curve(clock.time(track.time_ns), track.ned_m[:, 2], track.style) for track in tracks]
    return Figure(
        "Motion of the vehicle",
        "Track and depth are relative to the start of the replay. Speed over ground and turn rate are those of the "
        "baseline.",
        (
            Panel(_TRACK, _EAST, dashes_on_top(above), equal=True),
            _speed_panel(replay.histories[0], clock),
            _turn_rate_panel(replay.histories[0], clock),
            Panel("depth below the start [m]", clock.label, dashes_on_top(down)),
        ),
        tuple((track.style, track.name) for track in tracks),
    )


def _speed_panel(baseline: History, clock: Clock) -> Panel:
    speed_mps = np.hypot(baseline.velocity_n[:, 0], baseline.velocity_n[:, 1])
    curve = Curve(clock.time(baseline.time_ns), speed_mps, f"{filter_style(0)} solid")
    return Panel("speed over ground, horizontal [m/s]", clock.label, (curve,))


def _turn_rate_panel(baseline: History, clock: Clock) -> Panel:
    """Draw the turn rate from ping to ping, where the states are far enough apart for a rate."""
    pings = np.flatnonzero(baseline.updated)
    ping_ns = baseline.time_ns[pings]
    heading = rpy_from_mat(baseline.mat_nb[pings])[:, 2]
    rate_degps = wrap_angle(np.diff(heading)) / seconds(ping_ns[1:], ping_ns[:-1]) / DEG
    curve = Curve(clock.time(ping_ns[1:]), rate_degps, f"{filter_style(0)} solid")
    return Panel("turn rate of the heading [deg/s]", clock.label, (curve,))


# --- The accelerations.


def acceleration_figure(replay: Replay, clock: Clock) -> Iterator[Figure]:
    """Draw the accelerations by the DVL and by the reference over time, one panel for each axis of the body."""
    derived = _derived_acceleration(replay.histories)
    if derived is None:
        return
    title = "Acceleration derived from the DVL"
    legend = [(DERIVED, "slope of the DVL's velocities")]
    curves = {DERIVED: derived.measured}
    reference = replay.dive.reference
    if reference is not None and reference.has_velocity and reference.has_attitude:
        title += " and from the reference"
        legend.append((REFERENCE, "derivative of the reference's velocity"))
        acceleration_b = reference_acceleration(reference, _longest_gap_s(replay))
        curves[REFERENCE] = acceleration_at(derived.valid_ns, reference.time_ns, acceleration_b)
    caption = "Slope of the velocity in body axes, at the middle of each window."
    if np.any(replay.config.dvl.lever_arm_m):
        caption += " The motion of the DVL about the IMU is included."
    time = clock.time(derived.valid_ns)
    panels = []
    for axis, direction in enumerate(("forward", "starboard", "down")):
        drawn = tuple(Curve(time, values[:, axis], style) for style, values in curves.items())
        panels.append(Panel(f"acceleration {direction} [m/s²]", clock.label, drawn))
    yield Figure(title, caption, tuple(panels), tuple(legend))


def _derived_acceleration(histories: Sequence[History]) -> Innovations | None:
    """Return the accelerations that the first filter met which is aided by them."""
    for history in histories:
        for innovations in history.innovations:
            if innovations.measurement == "acceleration" and len(innovations.valid_ns):
                return innovations
    return None


def _longest_gap_s(replay: Replay) -> float:
    """Return the longest gap in a window of velocities that any filter allows."""
    return max(
        filter_.acceleration.max_window_gap_s
        for filter_ in replay.config.filters.values()
        if filter_.acceleration is not None
    )
