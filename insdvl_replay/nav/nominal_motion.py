"""The motion around which errors are linearised, at the pings, and how those at the start have grown until then."""

from typing import NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import compiled, inlined
from insdvl_replay.nav.error_model import add_noise, propagate_cov, propagate_errors
from insdvl_replay.nav.kalman import multiply
from insdvl_replay.nav.local_earth import gravity_at, normal_gravity, place_about, place_at
from insdvl_replay.nav.state_layout import TWELVE
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import PINGS, Timeline, first_node, is_event, is_last, mean, next_node
from insdvl_replay.nav.vector_algebra import (
    Vector,
    add,
    cross,
    rotate_back,
    row_matrix,
    row_vector,
    subtract,
    write_row_matrix,
    write_row_vector,
)


class NominalPings(NamedTuple):
    """The motion around which the errors are linearised, where it is measured.

    Attributes
    ----------
    velocity_n : ndarray, shape (m, 3)
        m/s
    mat_nb : ndarray, shape (m, 3, 3)
        Attitude.
    rate_nb_b : ndarray, shape (m, 3)
        Angular rate of the body against n, rad/s.
    gravity : ndarray, shape (m,)
        m/s^2
    transition : ndarray, shape (m, 12, 12)
        Phi(t, t0), from the errors at the start to those at the ping.
    step : ndarray, shape (m, 12, 12)
        Phi from the ping before, of the first from the start.
    noise : ndarray, shape (m, 12, 12)
        Covariance of what process noise has added meanwhile.
    """

    velocity_n: Floats
    mat_nb: Floats
    rate_nb_b: Floats
    gravity: Floats
    transition: Floats
    step: Floats
    noise: Floats


def nominal_pings(
    timeline: Timeline, nominal: History, noise_density: Floats, *, earth_rate: bool = True
) -> NominalPings:
    """Carry the errors at the start to each ping along a nominal motion.

    Equations (48) and (49) of Levy and Klein, as the product of ``I + F dt`` along the way; see
    equations/observability.md.

    Parameters
    ----------
    timeline : Timeline
        Nodes with readings and pings.
    nominal : History
        A row at each recorded event of the time line; from one to the next the motion is mechanised.
    noise_density : ndarray, shape (12,)
        From `error_model.noise_density`; long gaps of the IMU add theirs.
    earth_rate : bool
        False: let the Earth be flat and at rest, and take the Coriolis acceleration out of the readings.

    Raises
    ------
    ValueError
        The history was recorded on another time line.
    """
    if not np.array_equal(nominal.time_ns, timeline.event_ns[timeline.record >= 0]):
        raise ValueError("the nominal motion has other times than the time line records")
    pings = int(timeline.ping.max()) + 1
    found = NominalPings(
        np.empty((pings, 3)),
        np.empty((pings, 3, 3)),
        np.empty((pings, 3)),
        np.empty(pings),
        *np.empty((3, pings, TWELVE, TWELVE)),
    )
    states = _States(
        nominal.position,
        nominal.velocity_n,
        np.ascontiguousarray(nominal.mat_nb),
        nominal.accel_bias_b,
        nominal.gyro_bias_b,
    )
    _walk(timeline, states, tuple(noise_density.tolist()), earth_rate, found)
    return found


class _States(NamedTuple):
    """Columns of navigation states."""

    position: Floats
    velocity_n: Floats
    mat_nb: Floats
    accel_bias_b: Floats
    gyro_bias_b: Floats


@inlined
def _row_state(states: _States, row: int) -> NavState:
    return NavState(
        row_vector(states.position, row),
        row_vector(states.velocity_n, row),
        row_matrix(states.mat_nb, row),
        row_vector(states.accel_bias_b, row),
        row_vector(states.gyro_bias_b, row),
    )


@compiled
def _walk(
    timeline: Timeline, nominal: _States, noise_density: tuple[float, ...], earth_rate: bool, found: NominalPings
) -> None:
    """Mechanise from one recorded event to the next, and let errors grow and noise gather from ping to ping."""
    transition, step, noise = np.eye(TWELVE), np.eye(TWELVE), np.zeros((TWELVE, TWELVE))
    step_by_row, noise_by_row = step.ravel(), noise.ravel()
    state = _row_state(nominal, timeline.record[0])
    place = place_at(state.position[0], state.position[2])
    before = first_node(timeline)
    while not is_last(timeline, before):
        now = next_node(timeline, before)
        dt = now.time_s - before.time_s
        before_n = state.velocity_n
        place = place_about(state.position, place)
        force_b = mean(before.specific_force_b, now.specific_force_b)
        rate_b = mean(before.angular_rate_b, now.angular_rate_b)
        state, motion = propagate(state, force_b, rate_b, dt, place, gravity_at(place, state.position[2]))
        errors_motion = motion if earth_rate else _on_a_resting_earth(motion, before_n)
        propagate_errors(step_by_row, errors_motion, dt)
        propagate_cov(noise_by_row, errors_motion, noise_density, dt)
        gap = timeline.gap[before.event]
        if gap >= 0:
            add_noise(noise_by_row, TWELVE, timeline.gap_noise_density[gap], dt)
        before = now
        if not is_event(timeline, now):
            continue

        ping, row = timeline.rows[PINGS, now.event], timeline.record[now.event]
        if row >= 0:
            state = _row_state(nominal, row)
        if ping >= 0:
            write_row_vector(state.velocity_n, found.velocity_n, ping)
            write_row_matrix(state.mat_nb, found.mat_nb, ping)
            rate_ib_b = subtract(now.angular_rate_b, state.gyro_bias_b)
            rate_in_b = rotate_back(motion.mat_nb, motion.rate_in_n)
            write_row_vector(subtract(rate_ib_b, rate_in_b), found.rate_nb_b, ping)
            found.gravity[ping] = normal_gravity(state.position[0], state.position[2])
            multiply(step, transition, found.transition[ping])
            found.step[ping], found.noise[ping] = step, noise
            transition = found.transition[ping]
            step[:], noise[:] = np.eye(TWELVE), 0.0


@inlined
def _on_a_resting_earth(motion: Motion, velocity_n: Vector) -> Motion:
    """Return the motion with the specific force that the same way would take on an Earth that is flat and at rest."""
    coriolis_n = cross(add(motion.rate_ie_n, motion.rate_in_n), velocity_n)
    still = (0.0, 0.0, 0.0)
    return Motion(still, still, subtract(motion.force_n, coriolis_n), motion.mat_nb, still)
