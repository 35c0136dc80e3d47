"""A replay in figures: what the rooms know, laid out for the page that shows it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.chi_square import mean_interval
from insdvl_replay.evaluation.errors import acceleration_at, reference_acceleration
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import rpy_from_mat, vector_from_mat, wrap_angle
from insdvl_replay.replay import Replay
from insdvl_replay.report.plots.panel import REFERENCE, Curve, Figure, Panel, dashes_on_top, filter_style
from insdvl_replay.results.coverage import Source, coverage_strips
from insdvl_replay.results.evidence_figures import coasting_figure, convergence_figure
from insdvl_replay.results.filter_figures import Clock, FilterErrors, error_figure, nis_figure, sigma_figure
from insdvl_replay.results.first_figures import first_panels
from insdvl_replay.results.shades import shaded, shaded_panel, shades_of

_FEWEST_BEAMS = 3
"""With fewer valid beams a ping has no velocity."""
DERIVED: Final = "derived"
_BODY_AXES: Final = ("forward", "starboard", "down")


@dataclass(frozen=True)
class Track:
    """Where somebody says that the vehicle was.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
    position_ned_m : ndarray, shape (k, 3)
        From the baseline's start; NaN where nothing is said.
    """

    label: str
    style: str
    time_ns: TimeNs
    position_ned_m: Floats


def replay_figures(replay: Replay) -> tuple[Figure, ...]:
    """Draw all figures of a replay: what was measured, then what the filters believe."""
    clock = Clock(replay.start_ns, replay.end_ns)
    figures = (
        *_errors(replay, clock),
        *coasting_figure(replay.curves.coasting, clock),
        *convergence_figure(replay.curves.convergence, replay.tables.evidence),
        sigma_figure(replay.histories, clock),
        nis_figure(replay.histories, clock, lambda dof: mean_interval(dof, 1)),
        motion_figure(list(_tracks(replay)), replay.histories[0], clock),
        *_acceleration_figure(replay, clock),
    )
    return shaded(figures, shades_of(replay), clock.label)


def replay_first_panels(replay: Replay) -> tuple[Panel, ...]:
    """Draw the pictures of the first screen."""
    clock, shades = Clock(replay.start_ns, replay.end_ns), shades_of(replay)
    return tuple(shaded_panel(panel, shades, clock.label) for panel in first_panels(replay))


def replay_coverage(replay: Replay) -> str:
    """Draw which part of a replay each sensor covers."""
    return coverage_strips(list(_sources(replay.dive)), Clock(replay.start_ns, replay.end_ns))


def _errors(replay: Replay, clock: Clock) -> Iterator[Figure]:
    if replay.errors:
        yield error_figure([_filter_errors(replay, history) for history in replay.histories], clock)


def _filter_errors(replay: Replay, history: History) -> FilterErrors:
    errors, reference = replay.errors[history.filter], replay.dive.reference
    assert reference is not None
    rows = np.searchsorted(history.time_ns, errors.time_ns)
    mat_nb_reference = reference.mat_nb[np.searchsorted(reference.time_ns, errors.time_ns)]
    misalignment_n = vector_from_mat(history.mat_nb[rows] @ np.swapaxes(mat_nb_reference, 1, 2))
    return FilterErrors(
        history.filter,
        errors.time_ns,
        np.hstack([errors.velocity_error_n, misalignment_n]),
        history.sd[rows, :6],
        errors.position_error_ned_m,
    )


def _tracks(replay: Replay) -> Iterator[Track]:
    origin = replay.histories[0].position[0]
    for number, history in enumerate(replay.histories):
        yield filter_track(number, history, _ned_m(history.position, origin))
    reference = replay.dive.reference
    if reference is not None and reference.has_position:
        inside = (reference.time_ns >= replay.start_ns) & (reference.time_ns <= replay.end_ns)
        yield reference_track(reference.time_ns[inside], _ned_m(reference.position[inside], origin))


def _ned_m(position: Floats, origin: Floats) -> Floats:
    return north_east_down_m(position, np.broadcast_to(origin, position.shape))


def _acceleration_figure(replay: Replay, clock: Clock) -> Iterator[Figure]:
    derived = _first_slopes(replay.histories)
    if derived is None:
        return
    lever_arm = bool(np.any(replay.config.dvl.lever_arm_m))
    expected_b = _expected_acceleration(replay.dive, replay.config, derived)
    yield acceleration_figure(derived.valid_ns, derived.measured, expected_b, clock, lever_arm=lever_arm)


def _first_slopes(histories: tuple[History, ...]) -> Innovations | None:
    met = (innovations for history in histories for innovations in history.innovations)
    return next((met_by for met_by in met if met_by.measurement == "acceleration" and len(met_by.valid_ns)), None)


def _expected_acceleration(dive: Dive, config: Config, derived: Innovations) -> Floats | None:
    reference = dive.reference
    if reference is None or not (reference.has_velocity and reference.has_attitude):
        return None
    longest_s = max(
        filter_.acceleration.max_window_gap_s for filter_ in config.filters.values() if filter_.acceleration is not None
    )
    acceleration_b = reference_acceleration(reference, longest_s)
    return acceleration_at(derived.valid_ns, reference.time_ns, acceleration_b)


def _sources(dive: Dive) -> Iterator[Source]:
    yield Source("IMU", dive.imu.time_ns, np.ones(len(dive.imu.time_ns), dtype=bool))
    if dive.dvl.beam_velocity_mps is not None:
        valid = np.isfinite(dive.dvl.beam_velocity_mps)
        for beam, column in enumerate(valid.T):
            yield Source(f"DVL beam {beam}", dive.dvl.time_ns, column)
        yield Source("DVL, three beams or more", dive.dvl.time_ns, valid.sum(axis=1) >= _FEWEST_BEAMS)
    elif dive.dvl.velocity_d is not None:
        yield Source("DVL velocity", dive.dvl.time_ns, np.isfinite(dive.dvl.velocity_d.sum(axis=1)))
    if dive.reference is not None:
        yield from _reference_sources(dive.reference)


def _reference_sources(reference: ReferenceColumns) -> Iterator[Source]:
    """Return the reference as one where it tells all that it ever tells in each row, else each quantity by itself."""
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    if all(rows.all() for rows in known.values()):
        known = {"": np.ones(len(reference.time_ns), dtype=bool)}
    for quantity, rows in known.items():
        yield Source(f"reference {quantity}".strip(), reference.time_ns[rows], np.ones(int(rows.sum()), dtype=bool))


def motion_figure(tracks: Sequence[Track], baseline: History, clock: Clock) -> Figure:
    """Draw the tracks from above and over time, and how the baseline says that the vehicle moved."""
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


def acceleration_figure(
    time_ns: TimeNs, derived_b: Floats, reference_b: Floats | None, clock: Clock, *, lever_arm: bool
) -> Figure:
    """Draw both accelerations over time, one panel for each axis of the body.

    Parameters
    ----------
    time_ns : ndarray, shape (m,)
        Times of validity.
    derived_b, reference_b : ndarray, shape (m, 3)
        m/s^2; the reference's, if there is one that gives any.
    lever_arm : bool
        Whether the DVL lies away from the IMU.
    """
    swing = " The swing of the DVL about the IMU is left in." if lever_arm else ""
    legend = [(DERIVED, "slope of the DVL's velocities")]
    if reference_b is not None:
        legend.append((REFERENCE, "derivative of the reference's velocity"))
    beside = "" if reference_b is None else ", beside the reference"
    return Figure(
        f"What the acceleration is worth: from the DVL{beside}",
        f"Rates of the velocity's components in body axes, at the middle of their windows.{swing}",
        tuple(_acceleration_panel(axis, time_ns, derived_b, reference_b, clock) for axis in range(3)),
        tuple(legend),
    )


def _acceleration_panel(
    axis: int, time_ns: TimeNs, derived_b: Floats, reference_b: Floats | None, clock: Clock
) -> Panel:
    curves = [Curve(clock.time(time_ns), derived_b[:, axis], DERIVED)]
    if reference_b is not None:
        curves.append(Curve(clock.time(time_ns), reference_b[:, axis], REFERENCE))
    return Panel(f"acceleration {_BODY_AXES[axis]} [m/s²]", clock.label, tuple(curves))
