"""The error-state Kalman filter: propagate to each node of the time line, update at readings, remember beliefs.

One loop for every filter. What a filter is aided by is the tuple of its measurements.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import compiled, inlined, is_compiled, plain
from insdvl_replay.core.states import states_with
from insdvl_replay.nav.correction import correct, note_used
from insdvl_replay.nav.error_model import add_noise, fade, propagate_cov
from insdvl_replay.nav.initial_state import Start
from insdvl_replay.nav.innovation import DEPTH, InsAtPing
from insdvl_replay.nav.local_earth import GravityHeight, Place, followed, gravity_at, place_about, place_at
from insdvl_replay.nav.measurements import BEAM, Measurement, Stack, stacked
from insdvl_replay.nav.own_measurement import Predicts
from insdvl_replay.nav.position_error import position_growth, propagate_position_cov
from insdvl_replay.nav.state_layout import StateLayout, layout_of
from insdvl_replay.nav.state_log import (
    Records,
    Updates,
    history_of,
    new_records,
    new_updates,
    write_record,
)
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import PINGS, Node, Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.update import Matrices, count_lost_ping, new_matrices, update
from insdvl_replay.nav.vector_algebra import (
    Vector,
    add,
    matrix,
    rotate_back,
    subtract,
    vector,
    write_row_vector,
)


class _Memory(NamedTuple):
    """What windows need of past pings, see `innovation.InsAtPing`."""

    rate_nb_b: Floats
    rate_eb_b: Floats
    velocity_change_b: Floats


def run_filter(
    name: str,
    timeline: Timeline,
    start: Start,
    noise_density: Floats,
    measurements: tuple[Measurement, ...],
    lever_arm_b: Floats,
    *,
    more_states: Collection[str] = (),
    heading_bias_rate_hz: float = 0.0,
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
        State and uncertainty at the first node, of n states.
    noise_density : ndarray, shape (12,) or (n,)
        From `error_model.noise_density`, and that of the states beside the twelve; left out, they have none.
    measurements : tuple of Measurement
        Applied in this order where several are made at one time. At least one.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    more_states : collection of str
        Names in `states.MORE_STATES`.
    heading_bias_rate_hz : float
        One over the time in which the bias of the heading is forgotten, of a filter that estimates it.
    cov_ns : ndarray, shape (c,), optional
        Recorded times at which the history keeps all of P, not only its diagonal; others are ignored.
    """
    keep_cov = np.isin(timeline.event_ns[timeline.record >= 0], () if cov_ns is None else cov_ns)
    states, stack = states_with(more_states), stacked(measurements)
    if len(noise_density) > len(states):
        raise ValueError(f"{len(noise_density)} densities of {len(states)} states")
    layout, arm_b, updates = layout_of(more_states), vector(lever_arm_b), new_updates(*stack.values.shape)
    records = new_records(keep_cov, len(states), len(start.constants), corrects_position=layout.position >= 0)
    state, matrices = _state_at(start), new_matrices(start, max(3, stack.values.shape[2]))
    memory = _Memory(*np.zeros((3, int(timeline.ping.max()) + 1, 3)))
    density = (*noise_density.tolist(), *[0.0] * (len(states) - len(noise_density)))
    own = min((one.predict for one in measurements if one.predict is not None), key=is_compiled, default=None)
    run = _run if own is None or is_compiled(own) else plain(_run)
    run(timeline, state, matrices, density, layout, heading_bias_rate_hz, stack, own, arm_b, memory, records, updates)
    return history_of(name, timeline, states, measurements, records, updates)


def _state_at(start: Start) -> NavState:
    return NavState(
        vector(start.position),
        vector(start.velocity_n),
        matrix(start.mat_nb),
        vector(start.accel_bias_b),
        vector(start.gyro_bias_b),
    )


@compiled
def _run(
    timeline: Timeline,
    state: NavState,
    matrices: Matrices,
    noise_density: tuple[float, ...],
    layout: StateLayout,
    heading_bias_rate_hz: float,
    measurements: Stack,
    own: Predicts | None,
    lever_arm_b: Vector,
    memory: _Memory,
    records: Records,
    updates: Updates,
) -> None:
    """Walk the time line. This is the whole filter."""
    P, P_by_row, velocity_after_b, corrected = matrices.P, matrices.P_by_row, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    place, before = place_at(state.position[0], state.position[2]), first_node(timeline)
    gravity = GravityHeight(state.position[2], 0.0, before.time_s)
    write_record(state, corrected, matrices.constants, P, records, timeline.record[before.event])
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        place = place_about(state.position, place)
        force_b = mean(before.specific_force_b, now.specific_force_b)
        rate_b = mean(before.angular_rate_b, now.angular_rate_b)
        gravity = followed(gravity, state.position[2], before.time_s)
        gravity_here = gravity_at(place, gravity.height_m)
        state, motion = propagate(state, force_b, rate_b, dt, place, gravity_here)
        if layout.position >= 0:
            growth = position_growth(state, motion, place, dt)
            propagate_position_cov(P_by_row, noise_density, layout.position, growth)
        if layout.heading_bias >= 0:
            kept = math.exp(-heading_bias_rate_hz * dt)
            fade(P, layout.heading_bias, kept)
            matrices.constants[layout.heading_bias - layout.constants] *= kept
        propagate_cov(P_by_row, motion, noise_density, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(P_by_row, len(noise_density), timeline.gap_noise_density[gap], dt)
        before = now
        if not is_event(timeline, now):
            continue

        ping, unaided_b, predicted = timeline.rows[PINGS, now.event], _velocity_b(state), state.position
        if ping >= 0:
            _note_motion(state, memory, ping, now.angular_rate_b, motion, velocity_after_b)
        carried = (now.angular_rate_b, now.specific_force_b, gravity_here, lever_arm_b)
        state, gravity = _meet_readings(
            timeline, now, state, motion, place, gravity, carried, layout, measurements, own, memory, matrices, updates
        )
        corrected = add(corrected, subtract(state.position, predicted))
        velocity_after_b = _velocity_b(state) if ping >= 0 else _corrected_b(velocity_after_b, state, unaided_b)
        row = timeline.record[now.event]
        if row >= 0:
            write_record(state, corrected, matrices.constants, P, records, row)


@inlined
def _meet_readings(
    timeline: Timeline,
    now: Node,
    state: NavState,
    motion: Motion,
    place: Place,
    gravity: GravityHeight,
    carried: tuple[Vector, Vector, float, Vector],
    layout: StateLayout,
    measurements: Stack,
    own: Predicts | None,
    memory: _Memory,
    matrices: Matrices,
    updates: Updates,
) -> tuple[NavState, GravityHeight]:
    """Update by all that is measured at an event, in the order of the measurements.

    A ping of beams by which the velocity was opened is met again.
    """
    estimated, is_again, refused_square, time_s, first, m = False, False, 0.0, now.time_s, 0, 0
    while m < len(measurements.kind):
        row = timeline.rows[measurements.sensor[m], now.event]
        if row >= 0 and measurements.available[m, row]:
            ping = timeline.rows[PINGS, now.event]
            ins = _ins_now(state, motion, memory, ping, carried, place, matrices.constants)
            used, square = update(
                measurements, m, row, time_s, ins, layout, own, estimated, is_again, matrices, updates
            )
            refused_square += square
            estimated = estimated or used
        m += 1
        if measurements.goes_on[m - 1]:
            continue
        last, is_lost = m - 1, refused_square > 0.0 and not estimated and not is_again
        if is_lost and measurements.kind[last] == BEAM:
            is_again = count_lost_ping(refused_square, measurements, last, time_s, layout, matrices, updates)
            if is_again:
                m, refused_square = first, 0.0
                continue
        if estimated:
            note_used(updates, last, time_s)
            state = correct(state, matrices.constants, matrices.P, matrices.dx, layout, place)
            gravity = _aided(gravity, measurements, last, state.position[2], time_s)
        estimated, is_again, refused_square, first = False, False, 0.0, m
    return state, gravity


@inlined
def _corrected_b(velocity_after_b: Vector, state: NavState, unaided_b: Vector) -> Vector:
    """Add to the body velocity after the last ping what another sensor has corrected: the mechanisation did not."""
    return add(velocity_after_b, subtract(_velocity_b(state), unaided_b))


@inlined
def _aided(gravity: GravityHeight, measurements: Stack, m: int, height_m: float, time_s: float) -> GravityHeight:
    """Note that a velocity was used, which holds the height, or a height itself, after which none is drifted."""
    if measurements.kind[m] == DEPTH:
        return GravityHeight(height_m, 0.0, time_s)
    return GravityHeight(gravity.height_m, gravity.drift_m, time_s) if measurements.holds_height[m] else gravity


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
def _ins_now(
    state: NavState,
    motion: Motion,
    memory: _Memory,
    ping: int,
    carried: tuple[Vector, Vector, float, Vector],
    place: Place,
    constants: Floats,
) -> InsAtPing:
    rate_b, force_b, gravity, lever_arm_b = carried
    return InsAtPing(
        state.position,
        state.velocity_n,
        state.mat_nb,
        subtract(force_b, state.accel_bias_b),
        ping,
        memory.rate_nb_b,
        memory.rate_eb_b,
        memory.velocity_change_b,
        gravity,
        lever_arm_b,
        place,
        _rate_eb_b(state, motion, rate_b),
        constants,
    )


@inlined
def _rate_eb_b(state: NavState, motion: Motion, reading_b: Vector) -> Vector:
    return subtract(subtract(reading_b, state.gyro_bias_b), rotate_back(motion.mat_nb, motion.rate_ie_n))
