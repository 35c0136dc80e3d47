"""The error-state Kalman filter: propagate to each node of the time line, update at pings, remember what was believed.

One loop for every filter. What a filter is aided by is the tuple of its measurements.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.compiled import compiled, inlined
from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.nav.correction import correct, locks_out, open_state
from insdvl_replay.nav.error_model import add_noise, propagate_cov
from insdvl_replay.nav.initial_state import Start
from insdvl_replay.nav.innovation import InsAtPing, linearise
from insdvl_replay.nav.kalman import (
    cholesky,
    innovation_cov,
    standardised,
    transposed_gain,
    update_cov,
)
from insdvl_replay.nav.local_earth import GravityHeight, followed, gravity_at, place_about, place_at
from insdvl_replay.nav.measurements import VELOCITY, Measurement
from insdvl_replay.nav.state_log import (
    Records,
    Updates,
    history_of,
    new_records,
    new_updates,
    write_record,
    write_update,
)
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.vector_algebra import (
    Vector,
    dot,
    matrix,
    rotate_back,
    row_matrix,
    subtract,
    vector,
    write_row_vector,
)


class _Memory(NamedTuple):
    """What windows need of past pings, see `innovation.InsAtPing`."""

    rate_nb_b: Floats
    rate_eb_b: Floats
    velocity_change_b: Floats


class _Matrices(NamedTuple):
    """The covariance, the same memory row by row, what an update is worked out in, see `kalman`, and P0's diagonal."""

    P: Floats
    P_by_row: Floats
    H: Floats
    HP: Floats
    KT: Floats
    rest: Floats
    dx: Floats
    start_var: Floats


class _Stack(NamedTuple):
    """Measurements with a leading axis, so that one compiled loop serves any number of them."""

    kind: NDArray[np.int64]
    available: NDArray[np.bool_]
    valid_ns: TimeNs
    measured_b: Floats
    cov_b: Floats
    velocity_weights: Floats
    interval_weights: Floats
    gate: Floats
    reopen_after: NDArray[np.int64]


def run_filter(
    name: str,
    timeline: Timeline,
    start: Start,
    noise_density: Floats,
    measurements: tuple[Measurement, ...],
    lever_arm_b: Floats,
    *,
    cov_ns: TimeNs | None = None,
) -> History:
    """Run one filter over a dive.

    Parameters
    ----------
    name : str
        The filter's name.
    timeline : Timeline
        Nodes with readings, pings and what to record.
    start : Start
        State and uncertainty at the first node.
    noise_density : ndarray, shape (12,)
        From `error_model.noise_density`.
    measurements : tuple of Measurement
        Applied in this order at each ping. At least one.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    cov_ns : ndarray, shape (c,), optional
        Recorded times at which the history keeps all of P, not only its diagonal; others are ignored.
    """
    keep_cov = np.isin(timeline.event_ns[timeline.record >= 0], () if cov_ns is None else cov_ns)
    records, updates = new_records(keep_cov), new_updates(len(measurements), int(timeline.ping.max()) + 1)
    state, matrices = _state_at(start), _new_matrices(start.cov)
    memory = _Memory(*np.zeros((3, *updates.innovation_b.shape[1:])))
    arm_b = vector(lever_arm_b)
    _run(timeline, state, matrices, noise_density, _stacked(measurements), arm_b, memory, records, updates)
    return history_of(name, timeline, measurements, records, updates)


def _state_at(start: Start) -> NavState:
    return NavState(
        vector(start.position),
        vector(start.velocity_n),
        matrix(start.mat_nb),
        vector(start.accel_bias_b),
        vector(start.gyro_bias_b),
    )


def _new_matrices(cov: Floats) -> _Matrices:
    P, (H, HP, KT, rest) = np.array(cov, order="C"), np.empty((4, 3, 12))
    return _Matrices(P, P.ravel(), H, HP, KT, rest, np.empty(12), np.diag(cov).copy())


@compiled
def _run(
    timeline: Timeline,
    state: NavState,
    matrices: _Matrices,
    noise_density: Floats,
    measurements: _Stack,
    lever_arm_b: Vector,
    memory: _Memory,
    records: Records,
    updates: Updates,
) -> None:
    """Walk the time line. This is the whole filter."""
    P, P_by_row, velocity_after_b = matrices.P, matrices.P_by_row, (0.0, 0.0, 0.0)
    place, before = place_at(state.position[0], state.position[2]), first_node(timeline)
    gravity = GravityHeight(state.position[2], 0.0, before.time_s)
    write_record(state, P, records, timeline.record[before.event])
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        place = place_about(state.position, place)
        force_b = mean(before.specific_force_b, now.specific_force_b)
        rate_b = mean(before.angular_rate_b, now.angular_rate_b)
        gravity = followed(gravity, state.position[2], before.time_s)
        gravity_here = gravity_at(place, gravity.height_m)
        state, motion = propagate(state, force_b, rate_b, dt, place, gravity_here)
        propagate_cov(P_by_row, motion, noise_density, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(P_by_row, timeline.gap_noise_density[gap], dt)
        before = now
        if not is_event(timeline, now):
            continue

        ping = timeline.ping[now.event]
        if ping >= 0:
            _note_motion(state, memory, ping, now.angular_rate_b, motion, velocity_after_b)
            for m in range(len(measurements.kind)):
                if measurements.available[m, ping]:
                    measurement = _unstacked(measurements, m)
                    at_ping = _at_ping(state, memory, now.specific_force_b, gravity_here, lever_arm_b)
                    z = linearise(measurement, ping, at_ping, matrices.H)
                    state = _update(state, measurement, m, ping, now.time_s, z, matrices, updates)
                    if updates.used[m, ping] and measurement.kind == VELOCITY:
                        gravity = GravityHeight(gravity.height_m, gravity.drift_m, now.time_s)
            velocity_after_b = _velocity_b(state)
        row = timeline.record[now.event]
        if row >= 0:
            write_record(state, P, records, row)


def _stacked(measurements: tuple[Measurement, ...]) -> _Stack:
    """Return all measurements the longest window; the weights of older pings are zero."""
    longest = max(measurement.velocity_weights.shape[1] for measurement in measurements)

    def padded(weights: Floats, width: int) -> Floats:
        return np.hstack([np.zeros((len(weights), width - weights.shape[1])), weights])

    return _Stack(
        np.array([measurement.kind for measurement in measurements]),
        np.stack([measurement.available for measurement in measurements]),
        np.stack([measurement.valid_ns for measurement in measurements]),
        np.stack([measurement.measured_b for measurement in measurements]),
        np.stack([measurement.cov_b for measurement in measurements]),
        np.stack([padded(measurement.velocity_weights, longest) for measurement in measurements]),
        np.stack([padded(measurement.interval_weights, longest - 1) for measurement in measurements]),
        np.array([measurement.gate for measurement in measurements]),
        np.array([measurement.reopen_after for measurement in measurements]),
    )


@inlined
def _note_motion(
    state: NavState, memory: _Memory, ping: int, reading_b: Vector, motion: Motion, velocity_after_b: Vector
) -> None:
    """Write down the angular rates at a ping, and what the mechanisation added to the body velocity after the last."""
    rate_ib_b = subtract(reading_b, state.gyro_bias_b)
    write_row_vector(subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_in_n)), memory.rate_nb_b, ping)
    write_row_vector(subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_ie_n)), memory.rate_eb_b, ping)
    write_row_vector(subtract(_velocity_b(state), velocity_after_b), memory.velocity_change_b, ping)


@inlined
def _velocity_b(state: NavState) -> Vector:
    return rotate_back(state.mat_nb, state.velocity_n)


@inlined
def _at_ping(state: NavState, memory: _Memory, reading_b: Vector, gravity: float, lever_arm_b: Vector) -> InsAtPing:
    return InsAtPing(
        state.velocity_n,
        state.mat_nb,
        subtract(reading_b, state.accel_bias_b),
        memory.rate_nb_b,
        memory.rate_eb_b,
        memory.velocity_change_b,
        gravity,
        lever_arm_b,
    )


@inlined
def _unstacked(stack: _Stack, m: int) -> Measurement:
    return Measurement(
        stack.kind[m],
        stack.available[m],
        stack.valid_ns[m],
        stack.measured_b[m],
        stack.cov_b[m],
        stack.velocity_weights[m],
        stack.interval_weights[m],
        stack.gate[m],
        stack.reopen_after[m],
    )


@inlined
def _update(
    state: NavState,
    measurement: Measurement,
    m: int,
    ping: int,
    time_s: float,
    z: Vector,
    matrices: _Matrices,
    updates: Updates,
) -> NavState:
    """Judge an innovation by its gate, use it if it passes, and write down both."""
    P, _, H, HP, KT, rest, dx, start_var = matrices
    R = row_matrix(measurement.cov_b, ping)
    S = innovation_cov(P, H, R, HP)
    L = cholesky(S)
    whitened = standardised(L, z)
    nis = dot(whitened, whitened)
    used = nis <= measurement.gate
    reopened = not used and locks_out(updates, m, nis, time_s, measurement.reopen_after)
    write_update(updates, m, ping, z, S, L, nis, used or reopened, reopened)
    if reopened:
        open_state(P, z, start_var, updates, m, time_s)
        L = cholesky(innovation_cov(P, H, R, HP))
    elif used:
        updates.refused_in_a_row[m] = 0
    else:
        return state
    transposed_gain(HP, L, KT)
    update_cov(P, H, R, HP, KT, rest)
    return correct(state, P, KT, z, dx)
