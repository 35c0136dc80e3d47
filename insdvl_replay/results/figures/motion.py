"""What the vehicle did: its track seen from above, its speed, its turn rate and its depth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from insdvl_replay.core.columns import Floats, TimeNs, seconds
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import rpy_from_mat, wrap_angle
from insdvl_replay.report.plots.panel import REFERENCE, Curve, Figure, Panel, dashes_on_top, filter_style
from insdvl_replay.results.figures.clock import Clock


@dataclass(frozen=True)
class Track:
    """Where somebody says that the vehicle was.

    Attributes
    ----------
    label, style : str
    time_ns : ndarray, shape (k,)
    position_ned_m : ndarray, shape (k, 3)
        From the baseline's start; NaN where nothing is said.
    """

    label: str
    style: str
    time_ns: TimeNs
    position_ned_m: Floats


def motion_figure(tracks: Sequence[Track], baseline: History, clock: Clock) -> Figure:
    """Draw the tracks from above and over time, and how the baseline says that the vehicle moved.

    Parameters
    ----------
    tracks : sequence of Track
        One for each filter, and the reference's if there is one.
    baseline : History
    clock : Clock

    Returns
    -------
    Figure
    """
    above = [Curve(track.position_ned_m[:, 1], track.position_ned_m[:, 0], track.style) for track in tracks]
    down = [Curve(clock.time(track.time_ns), track.position_ned_m[:, 2], track.style) for track in tracks]
    return Figure(
        "What the vehicle did",
        "The track from above and the depth begin at the start of the replay; speed over ground and turn rate are "
        "the baseline's.",
        (
            Panel("track: north [m] over east [m]", "east [m]", dashes_on_top(above), equal=True),
            Panel("speed over ground, horizontal [m/s]", clock.label, (_speed(baseline, clock),)),
            Panel("turn rate of the heading [deg/s]", clock.label, (_turn_rate(baseline, clock),)),
            Panel("depth below the start [m]", clock.label, dashes_on_top(down)),
        ),
        tuple((track.style, track.label) for track in tracks),
    )


def filter_track(number: int, history: History, position_ned_m: Floats) -> Track:
    """Make the track of a filter, by its place in the configuration."""
    return Track(history.filter, filter_style(number), history.time_ns, position_ned_m)


def reference_track(time_ns: TimeNs, position_ned_m: Floats) -> Track:
    """Make the reference's track."""
    return Track("reference", REFERENCE, time_ns, position_ned_m)


def _speed(history: History, clock: Clock) -> Curve:
    speed_mps = np.hypot(history.velocity_n[:, 0], history.velocity_n[:, 1])
    return Curve(clock.time(history.time_ns), speed_mps, f"{filter_style(0)} solid")


def _turn_rate(history: History, clock: Clock) -> Curve:
    """From ping to ping, where the states are far enough apart for a rate."""
    rows = np.flatnonzero(history.updated)
    heading = rpy_from_mat(history.mat_nb[rows])[:, 2]
    time_ns = history.time_ns[rows]
    rate_degps = wrap_angle(np.diff(heading)) / seconds(time_ns[1:], time_ns[:-1]) / DEG
    return Curve(clock.time(time_ns[1:]), rate_degps, f"{filter_style(0)} solid")
