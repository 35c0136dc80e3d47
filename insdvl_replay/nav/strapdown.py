"""Strapdown mechanisation in north-east-down on the rotating WGS-84 Earth.

Source: equations (24) and (25) of Levy and Klein; Groves, chapter 5.
"""

from typing import NamedTuple

from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import (
    Matrix,
    Vector,
    add,
    compose,
    cross,
    rotate,
    rotation_from_vector,
    scale,
    subtract,
)
from insdvl_replay.nav.earth_model import (
    LocalEarth,
    curvatures,
    transport_curvature,
    transport_rate_n,
)
from insdvl_replay.nav.increments import Readings, increments


class NavState(NamedTuple):
    """The navigation state of an INS, with the biases of its sensors."""

    position: Vector  # latitude rad, longitude rad, height m
    velocity_n: Vector  # m/s
    mat_nb: Matrix
    accel_bias_b: Vector  # reading minus true, m/s^2
    gyro_bias_b: Vector  # rad/s


class Motion(NamedTuple):
    """What the growth of errors in a step of the mechanisation depends on."""

    rate_ie_n: Vector  # Earth rate, rad/s
    rate_in_n: Vector  # Earth rate plus transport rate, rad/s
    force_n: Vector  # specific force, m/s^2
    mat_nb: Matrix  # at the end of the step
    curvature: Vector  # of the Earth, see `earth_model.transport_curvature`, 1/m


@inlined
def propagate(
    state: NavState,
    before: Readings,
    after: Readings,
    dt: float,
    earth: LocalEarth,
    gravity: float,
) -> tuple[NavState, Motion]:
    """Advance position, velocity and attitude over an interval of ``dt`` seconds by raw readings at its ends.

    The mean of the attitudes at both ends turns the specific force to n. The position moves with the mean of the
    velocities.
    """
    height_m, velocity_n = state.position[2], state.velocity_n
    force_b, turn_b = increments(before, after, state.accel_bias_b, state.gyro_bias_b, dt)
    curvature = transport_curvature(earth, height_m)
    rate_in_n = add(earth.rate_ie_n, transport_rate_n(curvature, velocity_n))
    # The attitude turns on both sides, each by its exact exponential.
    body_turn, frame_turn = (
        rotation_from_vector(turn_b),
        rotation_from_vector(scale(-dt, rate_in_n)),
    )
    mat_nb = compose(frame_turn, compose(state.mat_nb, body_turn))
    force_n = scale(0.5, add(rotate(state.mat_nb, force_b), rotate(mat_nb, force_b)))
    felt_n = add(force_n, (0.0, 0.0, gravity))
    coriolis_n = cross(add(earth.rate_ie_n, rate_in_n), add(velocity_n, scale(0.5 * dt, felt_n)))
    acceleration_n = subtract(felt_n, coriolis_n)
    velocity_after_n = add(velocity_n, scale(dt, acceleration_n))
    moved_n = scale(0.5 * dt, add(velocity_n, velocity_after_n))
    to_north, to_east = curvatures(earth, height_m)
    position = (
        state.position[0] + moved_n[0] * to_north,
        state.position[1] + moved_n[1] * to_east / earth.cos_latitude,
        state.position[2] - moved_n[2],
    )
    state_after = NavState(
        position, velocity_after_n, mat_nb, state.accel_bias_b, state.gyro_bias_b
    )
    return state_after, Motion(earth.rate_ie_n, rate_in_n, force_n, mat_nb, curvature)
