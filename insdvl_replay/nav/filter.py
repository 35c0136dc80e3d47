"""The error-state Kalman filter: propagate to each node of the time line, update at readings, record.

One loop serves every filter. The measurements of a filter are a tuple.
"""

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Integers, Mask, TimeNs, seconds
from insdvl_replay.core.history import History, Innovations
from insdvl_replay.core.runtime import compiled, inlined, is_compiled, plain
from insdvl_replay.core.states import states_with
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
from insdvl_replay.nav.earth_model import (
    NOWHERE,
    GravityHeight,
    followed,
    gravity_at,
    local_earth_near,
)
from insdvl_replay.nav.error_model import (
    TWELVE,
    TWELVE_ALONE,
    NoiseSteps,
    StateLayout,
    add_noise,
    add_noise_of_axes,
    fade,
    layout_of,
    position_growth,
    propagate_cov,
    propagate_position_cov,
)
from insdvl_replay.nav.kalman import (
    ADAPTIVE,
    STUDENT_T,
    chance_var,
    cholesky,
    correct,
    found_factor,
    innovation_cov,
    normalised_square,
    outlier_factor,
    significant_factor,
    transposed_gain,
    update_cov,
)
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.measurements import (
    BEAM,
    DEPTH,
    InsNow,
    Measurement,
    Memory,
    Stack,
    linearise,
    stacked,
)
from insdvl_replay.nav.strapdown import NavState, propagate
from insdvl_replay.nav.timeline import PINGS, Timeline, first_node, is_event, is_last, next_node
from insdvl_replay.nav.user_measurement import NoiseFactors, Predicts

BEAMS_TO_AXES: Final = 4.0
"""The square of a velocity error is at most so many times the sum of its squares along the beams of a Janus at 20 deg
or more."""
RUN_PAUSE_S: Final = 60.0
"""Rejections further apart, as on both sides of an outage, are no run."""
SOON_S: Final = 60.0
"""If a filter is lost again so soon, opening its velocity was not enough."""


class Records(NamedTuple):
    """The navigation state at the recorded events, and P at some."""

    cov_row: Integers  # row in ``cov``, -1 for none
    cov: Floats
    position: Floats
    # sum of all corrections of the position; without rows where a filter makes none
    corrected: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats
    constants: Floats
    sd: Floats


class Updates(NamedTuple):
    """Innovations by measurement and reading; and for each measurement its run of rejections and its noise."""

    innovation: Floats
    sd: Floats
    nis: Floats
    log_det: Floats
    used: Mask
    reopened: Mask  # used in spite of the gate
    rejected_in_a_row: Integers
    rejected_s: Floats  # time of the last rejection
    reopened_s: Floats  # time of the last that was used in spite of the gate
    used_s: Floats  # time of the last reading that was used
    noise_var: Floats  # of `noise_found`, by chance
    noise_found: Floats  # factor of R by the innovations
    noise_factor: Floats  # the same, as far as it is more than chance


class Matrices(NamedTuple):
    """The covariance and the working memory of an update, see `kalman`."""

    P: Floats
    P_by_row: Floats  # the same memory
    start_var: Floats  # diagonal of P0
    constants: Floats  # of the sensors
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
    noise_factors: NoiseFactors | None = None,
    cov_ns: TimeNs | None = None,
) -> History:
    """Run one filter over a dive.

    Parameters
    ----------
    start : Start
        State and uncertainty at the first node, of n states.
    noise_density : ndarray, shape (12,) or (n,)
        From `error_model.noise_density`, and that of the other states, zero if left out.
    measurements : tuple of Measurement
        Applied in this order where several are made at one time. At least one.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    more_states : collection of str
        Names in `states.MORE_STATES`.
    heading_bias_rate_hz : float
        One over the time in which the heading's bias is forgotten, for a filter that estimates it.
    noise_factors : NoiseFactors, optional
        By which the white noise of the readings changes with time.
    cov_ns : ndarray, shape (c,), optional
        Recorded times at which the history keeps all of P, not only its diagonal; others are ignored.
    """
    states = states_with(more_states)
    stack = stacked(measurements)
    layout = layout_of(more_states)
    n = len(states)
    if len(noise_density) > n:
        raise ValueError(f"{len(noise_density)} densities of {n} states")
    density = (*noise_density.tolist(), *[0.0] * (n - len(noise_density)))
    is_recorded = timeline.record >= 0
    time_ns = timeline.event_ns[is_recorded]
    if cov_ns is None:
        cov_ns = time_ns[:0]
    keep_cov = np.isin(time_ns, cov_ns)
    state = NavState(
        vector(start.position),
        vector(start.velocity_n),
        matrix(start.mat_nb),
        vector(start.accel_bias_b),
        vector(start.gyro_bias_b),
    )
    records = _empty_records(keep_cov, start, n, estimates_position=layout.position >= 0)
    count, readings, width = stack.values.shape
    updates = _no_updates(count, readings, width)
    predict = _prediction(measurements)
    run = _run
    if predict is not None and not is_compiled(predict):
        run = plain(_run)
    rate_hz = None
    if n > TWELVE:
        rate_hz = heading_bias_rate_hz
    run(
        timeline,
        state,
        _matrices(start, n, width),
        density,
        _noise_steps(noise_factors, noise_density, int(timeline.event_ns[0])),
        layout,
        rate_hz,
        stack,
        predict,
        vector(lever_arm_b),
        _memory(int(timeline.ping.max()) + 1),
        records,
        updates,
    )
    records.position[:, 1] = wrap_angle(records.position[:, 1])
    return History(
        filter=name,
        states=states,
        time_ns=time_ns,
        updated=timeline.ping[is_recorded] >= 0,
        position=records.position,
        corrected=records.corrected,
        velocity_n=records.velocity_n,
        mat_nb=records.mat_nb,
        accel_bias_b=records.accel_bias_b,
        gyro_bias_b=records.gyro_bias_b,
        constants=records.constants,
        sd=records.sd,
        cov_ns=time_ns[keep_cov],
        cov=records.cov,
        innovations=tuple(
            _innovations(made, m, timeline, updates) for m, made in enumerate(measurements)
        ),
    )


def _empty_records(
    keep_cov: Mask,
    start: Start,
    n: int,
    *,
    estimates_position: bool,
) -> Records:
    """Make room for the states at the recorded events, with P where it is to be kept, shape (k,)."""
    rows = len(keep_cov)
    corrected_rows = rows if estimates_position else 0
    return Records(
        cov_row=np.where(keep_cov, np.cumsum(keep_cov) - 1, -1),
        cov=np.empty((int(keep_cov.sum()), n, n)),
        position=np.empty((rows, 3)),
        corrected=np.empty((corrected_rows, 3)),
        velocity_n=np.empty((rows, 3)),
        mat_nb=np.empty((rows, 3, 3)),
        accel_bias_b=np.empty((rows, 3)),
        gyro_bias_b=np.empty((rows, 3)),
        constants=np.empty((rows, len(start.constants))),
        sd=np.empty((rows, n)),
    )


def _no_updates(measurements: int, readings: int, width: int) -> Updates:
    """Make room for the innovations of some measurements, of which none has been met."""
    return Updates(
        innovation=np.full((measurements, readings, width), np.nan),
        sd=np.full((measurements, readings, width), np.nan),
        nis=np.full((measurements, readings), np.nan),
        log_det=np.full((measurements, readings), np.nan),
        used=np.zeros((measurements, readings), np.bool_),
        reopened=np.zeros((measurements, readings), np.bool_),
        rejected_in_a_row=np.zeros(measurements, np.int64),
        rejected_s=np.full(measurements, -np.inf),
        reopened_s=np.full(measurements, -np.inf),
        used_s=np.zeros(measurements),
        noise_var=np.zeros(measurements),
        noise_found=np.ones(measurements),
        noise_factor=np.ones(measurements),
    )


def _matrices(start: Start, n: int, width: int) -> Matrices:
    """Return the covariance of a start of n states, with memory for updates by up to so many components."""
    P = np.array(start.cov, order="C")
    size = max(3, width)
    return Matrices(
        P=P,
        P_by_row=P.ravel(),
        start_var=np.diag(start.cov).copy(),
        constants=start.constants.copy(),
        H=np.zeros((size, n)),
        HP=np.zeros((size, n)),
        KT=np.zeros((size, n)),
        rest=np.zeros((size, n)),
        R=np.zeros((size, size)),
        S=np.zeros((size, size)),
        L=np.zeros((size, size)),
        z=np.zeros(size),
        standardised=np.zeros(size),
        dx=np.zeros(n),
    )


def _memory(pings: int) -> Memory:
    return Memory(
        rate_nb_b=np.zeros((pings, 3)),
        rate_eb_b=np.zeros((pings, 3)),
        velocity_change_b=np.zeros((pings, 3)),
    )


def _noise_steps(
    noise_factors: NoiseFactors | None, noise_density: Floats, start_ns: int
) -> NoiseSteps:
    """Return what factors of the readings' noise add to its density, from the start on."""
    if noise_factors is None:
        return NoiseSteps(time_s=np.empty(0), density_b=np.empty((0, 6)))
    more = np.asarray(noise_density)[:6] * (noise_factors.factors**2 - 1.0)
    return NoiseSteps(time_s=seconds(noise_factors.time_ns, start_ns), density_b=more)


def _prediction(measurements: tuple[Measurement, ...]) -> Predicts | None:
    """Return the function that predicts what the user defined; one that is not compiled predicts all of it."""
    predictions = [made.predict for made in measurements if made.predict is not None]
    return min(predictions, key=is_compiled, default=None)


def _innovations(
    made: Measurement,
    number: int,
    timeline: Timeline,
    updates: Updates,
) -> Innovations:
    """Return the innovations of a measurement, the one of this number, at its available readings."""
    reading_ns = timeline.event_ns[timeline.rows[made.sensor] >= 0]
    rows = np.flatnonzero(made.available[: len(reading_ns)])
    return Innovations(
        measurement=made.name,
        unit=made.unit,
        axes=made.axes,
        time_ns=reading_ns[rows],
        valid_ns=made.valid_ns[rows],
        measured=made.values[rows],
        innovation=updates.innovation[number, rows, : made.size],
        sd=updates.sd[number, rows, : made.size],
        nis=updates.nis[number, rows],
        used=updates.used[number, rows],
        log_det=updates.log_det[number, rows],
        gate=made.gate,
        reopen_after=made.reopen_after,
        reopened=updates.reopened[number, rows],
        noise_factor=float(updates.noise_factor[number]),
        holds_height=made.holds_height,
    )


# What becomes of an innovation.
UNTESTED: Final = 0
SCALED: Final = 1
"""It passed the gate. Its noise was scaled by what the innovation itself shows, and it is tested again."""
USED: Final = 2
REJECTED: Final = 3
OPENED: Final = 4
"""It is the last of too many rejections in a row. The velocity is opened, so that it is used in spite of the gate."""


# One function: parts of it would each be optimised by themselves, and once more in it, which takes a third longer.
@compiled
def _run(  # noqa: C901
    timeline: Timeline,
    state: NavState,
    matrices: Matrices,
    noise_density: tuple[float, ...],
    more_noise: NoiseSteps,
    layout: StateLayout,
    # None for twelve states, so that nothing is compiled for more
    heading_bias_rate_hz: float | None,
    measurements: Stack,
    user: Predicts | None,
    lever_arm_b: Vector,
    memory: Memory,
    records: Records,
    updates: Updates,
) -> None:
    """Walk the time line. This is the whole filter."""
    # The compiler knows the length of the tuple, and leaves out what twelve states do not need.
    if len(noise_density) <= TWELVE:
        layout = TWELVE_ALONE
    P = matrices.P
    P_by_row = matrices.P_by_row
    dx = matrices.dx
    constants = matrices.constants
    now = first_node(timeline)
    earth = NOWHERE
    velocity_after_b = (0.0, 0.0, 0.0)
    corrected = (0.0, 0.0, 0.0)
    gravity = GravityHeight(state.position[2], 0.0, now.time_s)
    noise_step = -1
    while True:
        row = -1
        if is_event(timeline, now):
            row = timeline.record[now.event]
        if row >= 0:
            write_row_vector(state.position, records.position, row)
            if layout.position >= 0:
                write_row_vector(corrected, records.corrected, row)
            write_row_vector(state.velocity_n, records.velocity_n, row)
            write_row_matrix(state.mat_nb, records.mat_nb, row)
            write_row_vector(state.accel_bias_b, records.accel_bias_b, row)
            write_row_vector(state.gyro_bias_b, records.gyro_bias_b, row)
            for i in range(len(constants)):
                records.constants[row, i] = constants[i]
            # By elements: numba takes three seconds to compile the assignment of a whole array.
            cov_row = records.cov_row[row]
            for i in range(P.shape[0]):
                records.sd[row, i] = math.sqrt(P[i, i])
                if cov_row >= 0:
                    for j in range(P.shape[0]):
                        records.cov[cov_row, i, j] = P[i, j]
        if is_last(timeline, now):
            return

        # Propagate the state and its covariance to the next sample or event.
        before = now
        now = next_node(timeline, now)
        dt = now.time_s - before.time_s
        earth = local_earth_near(state.position, earth)
        gravity = followed(gravity, state.position[2], before.time_s)
        gravity_here = gravity_at(earth, gravity.height_m)
        state, motion = propagate(state, before.readings, now.readings, dt, earth, gravity_here)
        if heading_bias_rate_hz is not None:
            if layout.position >= 0:
                growth = position_growth(state, motion, earth, dt)
                propagate_position_cov(P_by_row, noise_density, layout.position, growth)
            if layout.heading_bias >= 0:
                kept = math.exp(-heading_bias_rate_hz * dt)
                fade(P, layout.heading_bias, kept)
                constants[layout.heading_bias - layout.constants] *= kept
        propagate_cov(P_by_row, motion, noise_density, dt)
        while (
            noise_step + 1 < len(more_noise.time_s)
            and more_noise.time_s[noise_step + 1] <= before.time_s
        ):
            noise_step += 1
        if noise_step >= 0:
            density_b = more_noise.density_b[noise_step]
            add_noise_of_axes(P_by_row, len(noise_density), motion.mat_nb, density_b, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(P_by_row, len(noise_density), timeline.gap_noise_density[gap], dt)
        if not is_event(timeline, now):
            continue

        # Remember the motion at a ping: windows need the rates, and what the mechanisation alone has added.
        ping = timeline.rows[PINGS, now.event]
        predicted = state.position
        predicted_b = _velocity_b(state)
        if ping >= 0:
            rate_ib_b = subtract(now.readings.angular_rate_b, state.gyro_bias_b)
            rate_nb_b = subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_in_n))
            rate_eb_b = subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_ie_n))
            write_row_vector(rate_nb_b, memory.rate_nb_b, ping)
            write_row_vector(rate_eb_b, memory.rate_eb_b, ping)
            write_row_vector(
                subtract(predicted_b, velocity_after_b), memory.velocity_change_b, ping
            )

        # Apply the measurements in their order. Those of one reading, such as beams, add to dx and correct the state
        # together. If all beams of too many pings in a row were rejected, the velocity is opened and the beams of the
        # last ping are applied again. They keep the innovations that they had before, and do not count for the noise.
        time_s = now.time_s
        estimated = False  # dx has the errors that the reading shows
        is_again = False  # the velocity was opened for the reading
        rejected_square = 0.0
        first = 0  # measurement of the reading
        m = 0
        while m < len(measurements.kind):
            row = timeline.rows[measurements.sensor[m], now.event]
            if row >= 0 and measurements.available[m, row]:
                # The innovation, less what the errors estimated before explain of it.
                size = measurements.size[m]
                gate = measurements.gate[m]
                noise = measurements.noise[m]
                H = matrices.H[:size]
                HP = matrices.HP[:size]
                KT = matrices.KT[:size]
                rest = matrices.rest[:size]
                R = matrices.R[:size, :size]
                S = matrices.S[:size, :size]
                L = matrices.L[:size, :size]
                z = matrices.z[:size]
                standardised = matrices.standardised[:size]
                rate_ib_b = subtract(now.readings.angular_rate_b, state.gyro_bias_b)
                ins = InsNow(
                    state.position,
                    state.velocity_n,
                    state.mat_nb,
                    subtract(now.readings.specific_force_b, state.accel_bias_b),
                    memory,
                    gravity_here,
                    lever_arm_b,
                    earth,
                    subtract(rate_ib_b, rotate_back(motion.mat_nb, motion.rate_ie_n)),
                    constants,
                )
                linearise(measurements, m, row, ins, layout, user, z, matrices.H[: max(size, 3)])
                if estimated:
                    for i in range(size):
                        for j in range(len(dx)):
                            z[i] -= H[i, j] * dx[j]
                _write_scaled(updates.noise_factor[m], measurements.cov[m, row], R)

                # The gate, again with the noise that the innovation itself shows, and with an opened velocity.
                is_followed = noise == ADAPTIVE and not is_again
                stage = UNTESTED
                while True:
                    innovation_cov(P, H, R, HP, S)
                    cholesky(S, L)
                    nis = normalised_square(L, z, standardised)
                    if stage == OPENED:
                        break
                    passes = nis <= gate
                    if passes and stage == UNTESTED and (is_followed or noise == STUDENT_T):
                        factor = (
                            _follow_noise(m, 1.0, z, S, R, updates)
                            if is_followed
                            else outlier_factor(nis, size)
                        )
                        _write_scaled(factor, R, R)
                        stage = SCALED
                        continue
                    is_alone = measurements.kind[m] != BEAM
                    if passes:
                        stage = USED
                    elif is_alone and locks_out(
                        updates, m, nis, time_s, measurements.reopen_after[m]
                    ):
                        stage = OPENED
                    else:
                        stage = REJECTED
                    updates.used[m, row] = stage != REJECTED
                    updates.reopened[m, row] = stage == OPENED or (is_again and stage == USED)
                    if not is_again:
                        updates.nis[m, row] = nis
                        log_det = 0.0
                        for i in range(size):
                            log_det += math.log(L[i, i])
                            updates.innovation[m, row, i] = z[i]
                            updates.sd[m, row, i] = math.sqrt(S[i, i])
                        updates.log_det[m, row] = 2.0 * log_det
                    if stage != OPENED:
                        break
                    open_state(
                        P, _square(z), matrices.start_var, layout.position, updates, m, time_s
                    )

                # The gain and the covariance; of a rejected innovation the part that would just have passed.
                if stage == REJECTED:
                    if is_followed and 0.0 < gate < nis and math.isfinite(nis):
                        _follow_noise(m, gate / nis, z, S, R, updates)
                    rejected_square += _square(z)
                else:
                    updates.rejected_in_a_row[m] = 0
                    updates.used_s[m] = time_s
                    transposed_gain(HP, L, KT)
                    for i in range(len(dx)):
                        estimate = KT[0, i] * z[0]
                        for k in range(1, size):
                            estimate += KT[k, i] * z[k]
                        if estimated:
                            dx[i] += estimate
                        else:
                            dx[i] = estimate
                    update_cov(P, H, R, HP, KT, rest)
                    estimated = True
            last = m
            m += 1
            if measurements.goes_on[last]:
                continue

            # All of the reading is applied.
            if (
                rejected_square > 0.0
                and not estimated
                and not is_again
                and measurements.kind[last] == BEAM
            ):
                is_again = locks_out(
                    updates, last, rejected_square, time_s, measurements.reopen_after[last]
                )
                if is_again:
                    square = BEAMS_TO_AXES * rejected_square
                    open_state(
                        P, square, matrices.start_var, layout.position, updates, last, time_s
                    )
                    m = first
                    rejected_square = 0.0
                    continue
            if estimated:
                updates.rejected_in_a_row[last] = 0
                updates.used_s[last] = time_s
                state = correct(state, constants, P, dx, layout, earth)
                # Gravity follows the INS's height while a velocity holds it; a depth leaves no drift.
                if measurements.kind[last] == DEPTH:
                    gravity = GravityHeight(state.position[2], 0.0, time_s)
                elif measurements.holds_height[last]:
                    gravity = GravityHeight(gravity.height_m, gravity.drift_m, time_s)
            estimated = False
            is_again = False
            rejected_square = 0.0
            first = m

        corrected = add(corrected, subtract(state.position, predicted))
        if ping >= 0:
            velocity_after_b = _velocity_b(state)
        else:
            # Between pings, the correction by another sensor is not the mechanisation's.
            change_b = subtract(_velocity_b(state), predicted_b)
            velocity_after_b = add(velocity_after_b, change_b)


@inlined
def _velocity_b(state: NavState) -> Vector:
    return rotate_back(state.mat_nb, state.velocity_n)


@inlined
def _write_scaled(factor: float, mat: Floats, R: Floats) -> None:
    for i in range(len(R)):
        for j in range(len(R)):
            R[i, j] = factor * mat[i, j]


@inlined
def _square(z: Floats) -> float:
    total = 0.0
    for i in range(len(z)):
        total += z[i] * z[i]
    return total


@inlined
def _follow_noise(
    m: int,
    share: float,
    z: Floats,
    S: Floats,
    R: Floats,
    updates: Updates,
) -> float:
    """Update the factor of R by an innovation, and return its ratio to the factor before."""
    before: float = updates.noise_factor[m]
    updates.noise_found[m] = found_factor(updates.noise_found[m], before, z, S, R, share)
    updates.noise_var[m] = chance_var(updates.noise_var[m], before, S, R)
    updates.noise_factor[m] = significant_factor(updates.noise_found[m], updates.noise_var[m])
    after: float = updates.noise_factor[m]
    return after / before


@inlined
def locks_out(
    updates: Updates,
    m: int,
    nis: float,
    time_s: float,
    reopen_after: int,
) -> bool:
    """Count a rejection, and return whether so many in a row mean that the INS is wrong."""
    if not math.isfinite(nis):
        return False
    goes_on = time_s - updates.rejected_s[m] <= RUN_PAUSE_S
    if goes_on:
        updates.rejected_in_a_row[m] += 1
    else:
        updates.rejected_in_a_row[m] = 1
    updates.rejected_s[m] = time_s
    lost: bool = 0 < reopen_after <= updates.rejected_in_a_row[m]
    return lost


@inlined
def open_state(
    P: Floats,
    square: float,
    start_var: Floats,
    position: int,
    updates: Updates,
    m: int,
    time_s: float,
) -> None:
    """Make the velocity as uncertain on each axis as the innovation is large: the next gain sets it to the DVL's.

    The position becomes as uncertain as so wrong a velocity makes it since the last reading that was used. Other states
    keep their uncertainty and their correlations with the velocity, and hardly move. If a filter is lost again within
    `SOON_S`, levels, heading and biases become as uncertain as at the start, on top of what they are.

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
    m : int
        The measurement, whose times in ``updates`` change.
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
    updates.rejected_in_a_row[m] = 0
    updates.used_s[m] = time_s
