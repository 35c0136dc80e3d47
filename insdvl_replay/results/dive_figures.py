"""A replay in figures: lay out what the rooms know for the page that shows it."""

from collections.abc import Iterator

import numpy as np

from insdvl_replay.core.columns import Dive, Floats, ReferenceColumns
from insdvl_replay.core.config import Config
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.evaluation.acceleration import acceleration_at, reference_acceleration
from insdvl_replay.evaluation.chi_square import mean_interval
from insdvl_replay.geometry.frames import north_east_down_m
from insdvl_replay.geometry.rotation import vector_from_mat
from insdvl_replay.replay import Replay
from insdvl_replay.report.plots.panel import Figure
from insdvl_replay.results.figures.acceleration import acceleration_figure
from insdvl_replay.results.figures.clock import Clock
from insdvl_replay.results.figures.coverage import Source, coverage_strips
from insdvl_replay.results.figures.errors import FilterErrors, error_figure
from insdvl_replay.results.figures.innovations import nis_figure
from insdvl_replay.results.figures.motion import Track, filter_track, motion_figure, reference_track
from insdvl_replay.results.figures.sigma import sigma_figure

_FEWEST_BEAMS = 3
"""With fewer valid beams a ping has no velocity."""


def replay_figures(replay: Replay) -> tuple[Figure, ...]:
    """Draw all figures of a replay.

    Parameters
    ----------
    replay : Replay

    Returns
    -------
    tuple of Figure
        Those that need what the dive does not have are left out.
    """
    clock = Clock(replay.start_ns, replay.end_ns)
    return (
        sigma_figure(replay.histories, clock),
        *_errors(replay, clock),
        nis_figure(replay.histories, clock, lambda dof: mean_interval(dof, 1)),
        motion_figure(list(_tracks(replay)), replay.histories[0], clock),
        *_acceleration(replay, clock),
    )


def replay_coverage(replay: Replay) -> str:
    """Draw which part of a replay each sensor covers.

    Parameters
    ----------
    replay : Replay

    Returns
    -------
    str
        HTML.
    """
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


def _acceleration(replay: Replay, clock: Clock) -> Iterator[Figure]:
    derived = _first_slopes(replay.histories)
    if derived is None:
        return
    lever_arm = bool(np.any(replay.config.dvl.lever_arm_m))
    expected_b = _expected_acceleration(replay.dive, replay.config, derived)
    yield acceleration_figure(derived.valid_ns, derived.measured_b, expected_b, clock, lever_arm=lever_arm)


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
    """Give the reference as one where it tells all that it ever tells in each row, else each quantity by itself."""
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    if all(rows.all() for rows in known.values()):
        known = {"": np.ones(len(reference.time_ns), dtype=bool)}
    for quantity, rows in known.items():
        yield Source(f"reference {quantity}".strip(), reference.time_ns[rows], np.ones(int(rows.sum()), dtype=bool))
