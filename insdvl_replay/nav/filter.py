"""What a filter writes down on its way: its state at the recorded events, and each innovation.

One update: an innovation is judged by its gate, and what passes changes P and the errors that are estimated.

`filter` corrects the state by them once all of a reading is told.

The error-state Kalman filter: propagate to each node of the time line, update at readings, remember beliefs.

One loop for every filter. What a filter is aided by is the tuple of its measurements.
"""

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.runtime import compiled, inlined, is_compiled, plain
from insdvl_replay.core.states import State, states_with
from insdvl_replay.geometry.rotation import wrap_angle
from insdvl_replay.nav.algebra import (
    Vector,
    add,
    matrix,
    rotate_back,
    subtract,
    vector,
    write_row_matrix,
    write_row_vector,
)
from insdvl_replay.nav.earth_model import GravityHeight, Place, followed, gravity_at, place_about, place_at
from insdvl_replay.nav.error_model import (
    TWELVE,
    StateLayout,
    add_noise,
    fade,
    layout_of,
    position_growth,
    propagate_cov,
    propagate_position_cov,
)
from insdvl_replay.nav.kalman import (
    ADAPTIVE,
    STUDENT_T,
    believed_factor,
    chance_var,
    cholesky,
    correct,
    found_factor,
    innovation_cov,
    normalised_square,
    outlier_factor,
    transposed_gain,
    update_cov,
)
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import BEAM, DEPTH, InsAtPing, Measurement, Stack, linearise, stacked
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import PINGS, Node, Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.user_measurement import Predicts


class Records(NamedTuple):
    """The navigation state at the recorded events, and P at some: ``cov_row`` is its row in ``cov``, -1 for none.

    ``corrected`` is the sum of all corrections of the position; it has no rows where no filter makes any.
    """

    position: Floats
    corrected: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats
    constants: Floats
    sd: Floats
    cov_row: NDArray[np.int64]
    cov: Floats


class Updates(NamedTuple):
    """Innovations, first axis measurement, second axis reading; and how far each kind is in a run of rejections.

    ``refused_in_a_row`` counts the rejections up to now, ``refused_s`` is the time of the last, ``used_s`` that of the
    last reading that was used, and ``reopened_s`` that of the last that was used in spite of the gate. ``noise_found``
    is how much larger R is by the innovations, ``noise_var`` its variance by chance alone, and ``noise_factor`` as
    far as it is more than that.
    """

    innovation: Floats
    sd: Floats
    nis: Floats
    used: NDArray[np.bool_]
    reopened: NDArray[np.bool_]
    log_det: Floats
    refused_in_a_row: NDArray[np.int64]
    refused_s: Floats
    used_s: Floats
    reopened_s: Floats
    noise_factor: Floats
    noise_found: Floats
    noise_var: Floats


def new_records(keep_cov: NDArray[np.bool_], states: int, constants: int, *, corrects_position: bool) -> Records:
    """Make room for the states at recorded events, with all of P at those that are to keep it."""
    rows = len(keep_cov)
    return Records(
        position=np.empty((rows, 3)),
        corrected=np.empty((rows if corrects_position else 0, 3)),
        velocity_n=np.empty((rows, 3)),
        mat_nb=np.empty((rows, 3, 3)),
        accel_bias_b=np.empty((rows, 3)),
        gyro_bias_b=np.empty((rows, 3)),
        constants=np.empty((rows, constants)),
        sd=np.empty((rows, states)),
        cov_row=np.where(keep_cov, np.cumsum(keep_cov) - 1, -1),
        cov=np.empty((int(keep_cov.sum()), states, states)),
    )


def new_updates(measurements: int, readings: int, size: int) -> Updates:
    """Make room for the innovations of some kinds of measurement, with so many components at most, at each reading."""
    return Updates(
        innovation=np.full((measurements, readings, size), np.nan),
        sd=np.full((measurements, readings, size), np.nan),
        nis=np.full((measurements, readings), np.nan),
        used=np.zeros((measurements, readings), dtype=np.bool_),
        reopened=np.zeros((measurements, readings), dtype=np.bool_),
        log_det=np.full((measurements, readings), np.nan),
        refused_in_a_row=np.zeros(measurements, dtype=np.int64),
        refused_s=np.full(measurements, -np.inf),
        used_s=np.zeros(measurements),
        reopened_s=np.full(measurements, -np.inf),
        noise_factor=np.ones(measurements),
        noise_found=np.ones(measurements),
        noise_var=np.zeros(measurements),
    )


@inlined
def write_record(state: NavState, corrected: Vector, constants: Floats, P: Floats, records: Records, row: int) -> None:
    """Write down the navigation state and what its covariance P says, as a row."""
    write_row_vector(state.position, records.position, row)
    if row < len(records.corrected):
        write_row_vector(corrected, records.corrected, row)
    write_row_vector(state.velocity_n, records.velocity_n, row)
    write_row_matrix(state.mat_nb, records.mat_nb, row)
    write_row_vector(state.accel_bias_b, records.accel_bias_b, row)
    write_row_vector(state.gyro_bias_b, records.gyro_bias_b, row)
    for i in range(len(constants)):
        records.constants[row, i] = constants[i]
    for i in range(P.shape[0]):
        records.sd[row, i] = math.sqrt(P[i, i])
    cov_row = records.cov_row[row]
    if cov_row >= 0:
        # By elements: numba takes three seconds to compile the assignment of a whole array.
        for i in range(P.shape[0]):
            for j in range(P.shape[0]):
                records.cov[cov_row, i, j] = P[i, j]


@inlined
def write_update(
    updates: Updates,
    m: int,
    row: int,
    z: Floats,
    S: Floats,
    L: Floats,
    nis: float,
    used: bool,
    reopened: bool,
    is_again: bool,
) -> None:
    """Write down an innovation and what was thought of it; L is the Cholesky factor of its covariance S.

    Of one that is met again stays what it was at first.
    """
    updates.used[m, row], updates.reopened[m, row] = used, reopened or (is_again and used)
    if is_again:
        return
    updates.nis[m, row] = nis
    log_det = 0.0
    for i in range(len(z)):
        log_det += math.log(L[i, i])
        updates.innovation[m, row, i] = z[i]
        updates.sd[m, row, i] = math.sqrt(S[i, i])
    updates.log_det[m, row] = 2.0 * log_det


def history_of(
    name: str,
    timeline: Timeline,
    states: tuple[State, ...],
    measurements: tuple[Measurement, ...],
    records: Records,
    updates: Updates,
) -> History:
    """Gather what a filter wrote down."""
    innovations = []
    for m, measurement in enumerate(measurements):
        reading_ns = timeline.event_ns[timeline.rows[measurement.sensor] >= 0]
        rows = np.flatnonzero(measurement.available)
        innovations.append(
            Innovations(
                measurement=measurement.name,
                unit=measurement.unit,
                axes=measurement.axes,
                time_ns=reading_ns[rows],
                valid_ns=measurement.valid_ns[rows],
                measured=measurement.values[rows],
                innovation=updates.innovation[m, rows, : measurement.size],
                sd=updates.sd[m, rows, : measurement.size],
                nis=updates.nis[m, rows],
                used=updates.used[m, rows],
                gate=measurement.gate,
                reopen_after=measurement.reopen_after,
                reopened=updates.reopened[m, rows],
                log_det=updates.log_det[m, rows],
                noise_factor=float(updates.noise_factor[m]),
                holds_height=measurement.holds_height,
            )
        )
    records.position[:, 1] = wrap_angle(records.position[:, 1])
    recorded = timeline.record >= 0
    time_ns = timeline.event_ns[recorded]
    return History(
        filter=name,
        states=states,
        time_ns=time_ns,
        updated=timeline.ping[recorded] >= 0,
        position=records.position,
        velocity_n=records.velocity_n,
        mat_nb=records.mat_nb,
        accel_bias_b=records.accel_bias_b,
        gyro_bias_b=records.gyro_bias_b,
        sd=records.sd,
        cov_ns=time_ns[records.cov_row >= 0],
        cov=records.cov,
        innovations=tuple(innovations),
        constants=records.constants,
        corrected=records.corrected,
    )


BEAMS_TO_AXES: Final = 4.0
"""The square of a velocity error is at most so many times the sum of its squares along the beams of a Janus at 20 deg
or more."""


class Matrices(NamedTuple):
    """The covariance, the same memory row by row, what an update is worked out in, see `kalman`, and P0's diagonal."""

    P: Floats
    P_by_row: Floats
    H: Floats
    HP: Floats
    KT: Floats
    rest: Floats
    R: Floats
    S: Floats
    L: Floats
    z: Floats
    standardised: Floats
    dx: Floats
    start_var: Floats
    constants: Floats


def new_matrices(start: Start, size: int) -> Matrices:
    """Make room for measurements of up to so many components, at least three, with P as at the start."""
    cov, n, constants = start.cov, len(start.cov), start.constants.copy()
    P, (H, HP, KT, rest) = np.array(cov, order="C"), np.zeros((4, size, n))
    (R, S, L), (z, standardised) = np.zeros((3, size, size)), np.zeros((2, size))
    return Matrices(
        P, P.ravel(), H, HP, KT, rest, R, S, L, z, standardised, np.zeros(n), np.diag(cov).copy(), constants
    )


RUN_PAUSE_S: Final = 60.0
"""Rejections further apart, as on both sides of an outage, are no run."""


SOON_S: Final = 60.0
"""A filter that is lost again so soon was not put right by its velocity."""


@inlined
def locks_out(updates: Updates, m: int, nis: float, time_s: float, reopen_after: int) -> bool:
    """Count a rejection, and tell whether there were so many in a row that it is the INS which is off."""
    if not math.isfinite(nis):
        return False
    goes_on = time_s - updates.refused_s[m] <= RUN_PAUSE_S
    updates.refused_in_a_row[m] = updates.refused_in_a_row[m] + 1 if goes_on else 1
    updates.refused_s[m] = time_s
    lost: bool = 0 < reopen_after <= updates.refused_in_a_row[m]
    return lost


@inlined
def note_used(updates: Updates, m: int, time_s: float) -> None:
    """End a run of rejections."""
    updates.refused_in_a_row[m], updates.used_s[m] = 0, time_s


@inlined
def open_state(
    P: Floats, square: float, start_var: Floats, position: int, updates: Updates, m: int, time_s: float
) -> None:
    """Let the velocity be as uncertain on each axis as the innovation is large: the next gain sets it to the DVL's.

    The position becomes as uncertain as so wrong a velocity lets it since the last reading that was used. Other states
    keep their uncertainty and their correlations with the velocity, and hardly move. A filter that is lost again within
    `SOON_S` was not put right by that: levels, heading and biases become as uncertain as at the start, on top of what
    they are.

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Covariance; variances grow, in place.
    square : float
        Of the innovation, m^2/s^2.
    start_var : ndarray, shape (n,)
        Variances at the start.
    position : int
        Row of the position's first state, negative where there is none.
    updates : Updates
        Its times of this kind of measurement are changed.
    m : int
        The kind of measurement.
    time_s : float
        Seconds from the start.
    """
    if time_s - updates.reopened_s[m] <= SOON_S:
        for i in range(3, TWELVE):
            P[i, i] += start_var[i]
    lost_s = time_s - updates.used_s[m]
    for i in range(3):
        P[i, i] += square
        if position >= 0:
            P[position + i, position + i] += square * lost_s * lost_s
    updates.reopened_s[m] = time_s
    note_used(updates, m, time_s)


@inlined
def update(
    measurements: Stack,
    m: int,
    row: int,
    time_s: float,
    ins: InsAtPing,
    layout: StateLayout,
    own: Predicts | None,
    goes_on: bool,
    is_again: bool,
    matrices: Matrices,
    updates: Updates,
) -> tuple[bool, float]:
    """Judge an innovation by its gate, use it if it passes, and write down both.

    What is used changes P and the estimated errors ``dx``, to which those of the measurements before it are added if it
    goes on with their reading. The state is corrected by all of them. A beam that is met again, since its ping has
    opened the velocity, keeps the innovation that it had before, and tells nothing of the noise.

    Returns
    -------
    used : bool
    square : float
        Of an innovation that was not used; else 0.
    """
    P, dx, size = matrices.P, matrices.dx, measurements.size[m]
    H, HP, KT, rest = matrices.H[:size], matrices.HP[:size], matrices.KT[:size], matrices.rest[:size]
    R, S, L = matrices.R[:size, :size], matrices.S[:size, :size], matrices.L[:size, :size]
    z, standardised = matrices.z[:size], matrices.standardised[:size]
    linearise(measurements, m, row, ins, layout, own, z, matrices.H[: max(size, 3)])
    if goes_on:
        _take_off(H, dx, z)
    for i in range(size):
        for j in range(size):
            R[i, j] = updates.noise_factor[m] * measurements.cov[m, row, i, j]
    innovation_cov(P, H, R, HP, S)
    cholesky(S, L)
    nis = normalised_square(L, z, standardised)
    # Of a velocity that was opened, innovations tell of that alone.
    is_followed = measurements.noise[m] == ADAPTIVE and not is_again
    if (is_followed or measurements.noise[m] == STUDENT_T) and nis <= measurements.gate[m]:
        _scale(R, _noise_factor(measurements.noise[m], m, nis, z, S, R, updates))
        innovation_cov(P, H, R, HP, S)
        cholesky(S, L)
        nis = normalised_square(L, z, standardised)
    used = nis <= measurements.gate[m]
    alone = measurements.kind[m] != BEAM
    reopened = not used and alone and locks_out(updates, m, nis, time_s, measurements.reopen_after[m])
    write_update(updates, m, row, z, S, L, nis, used or reopened, reopened, is_again)
    if reopened:
        open_state(P, _square(z), matrices.start_var, layout.position, updates, m, time_s)
        innovation_cov(P, H, R, HP, S)
        cholesky(S, L)
    elif used:
        note_used(updates, m, time_s)
    else:
        _learn_of_rejected(is_followed, measurements.gate[m], m, nis, z, S, R, updates)
        return False, _square(z)
    transposed_gain(HP, L, KT)
    for i in range(len(dx)):
        estimate = KT[0, i] * z[0]
        for k in range(1, size):
            estimate += KT[k, i] * z[k]
        dx[i] = dx[i] + estimate if goes_on else estimate
    update_cov(P, H, R, HP, KT, rest)
    return True, 0.0


@inlined
def _take_off(H: Floats, dx: Floats, z: Floats) -> None:
    """Take off an innovation what errors that are estimated already leave of it, ``z <- z - H dx``."""
    for i in range(len(z)):
        for j in range(len(dx)):
            z[i] -= H[i, j] * dx[j]


@inlined
def _noise_factor(kind: int, m: int, nis: float, z: Floats, S: Floats, R: Floats, updates: Updates) -> float:
    """Return by how much larger an innovation says that R is, and remember it where the noise is followed."""
    if kind == STUDENT_T:
        return outlier_factor(nis, len(z))
    return _follow_noise(m, 1.0, z, S, R, updates)


@inlined
def _learn_of_rejected(
    is_followed: bool, gate: float, m: int, nis: float, z: Floats, S: Floats, R: Floats, updates: Updates
) -> None:
    """Let an innovation that the gate has rejected tell of the noise as much as one would that had just passed."""
    if is_followed and 0.0 < gate < nis and math.isfinite(nis):
        _follow_noise(m, gate / nis, z, S, R, updates)


@inlined
def _follow_noise(m: int, share: float, z: Floats, S: Floats, R: Floats, updates: Updates) -> float:
    """Remember how large R is by an innovation more, and return by how much larger that is than until now."""
    before: float = updates.noise_factor[m]
    updates.noise_found[m] = found_factor(updates.noise_found[m], before, z, S, R, share)
    updates.noise_var[m] = chance_var(updates.noise_var[m], before, S, R)
    updates.noise_factor[m] = believed_factor(updates.noise_found[m], updates.noise_var[m])
    after: float = updates.noise_factor[m]
    return after / before


@inlined
def _scale(R: Floats, factor: float) -> None:
    for i in range(len(R)):
        for j in range(len(R)):
            R[i, j] *= factor


@inlined
def _square(z: Floats) -> float:
    total = 0.0
    for i in range(len(z)):
        total += z[i] * z[i]
    return total


@inlined
def count_lost_ping(
    square: float,
    measurements: Stack,
    m: int,
    time_s: float,
    layout: StateLayout,
    matrices: Matrices,
    updates: Updates,
) -> bool:
    """Count a ping of which no beam passed, and tell whether after so many in a row the velocity was opened for it."""
    lost = locks_out(updates, m, square, time_s, measurements.reopen_after[m])
    if lost:
        open_state(matrices.P, BEAMS_TO_AXES * square, matrices.start_var, layout.position, updates, m, time_s)
    return lost


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
