"""Strapdown mechanisation in north-east-down on the rotating WGS-84 Earth.

Source: equations (24) and (25) of Levy and Klein; Groves, chapter 5.
"""

from typing import NamedTuple

from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.algebra import Matrix, Vector, add, compose, cross, rotate, rotation_from_vector, scale, subtract
from insdvl_replay.nav.earth_model import Place, curvatures, transport_curvature, transport_rate_n


class NavState(NamedTuple):
    """What the INS believes of the vehicle and of its own sensors.

    Attributes
    ----------
    position : tuple of 3 float
        Latitude rad, longitude rad, height m.
    velocity_n : tuple of 3 float
        m/s
    mat_nb : tuple of 3 rows
        Attitude.
    accel_bias_b, gyro_bias_b : tuple of 3 float
        What the readings are too large by, m/s^2 and rad/s.
    """

    position: Vector
    velocity_n: Vector
    mat_nb: Matrix
    accel_bias_b: Vector
    gyro_bias_b: Vector


class Motion(NamedTuple):
    """What errors have grown by during a step of the mechanisation.

    Attributes
    ----------
    rate_ie_n, rate_in_n : tuple of 3 float
        Earth rate, and Earth rate plus transport rate, rad/s.
    force_n : tuple of 3 float
        Specific force in n, m/s^2.
    mat_nb : tuple of 3 rows
        Attitude at the end.
    curvature : tuple of 3 float
        Of the Earth under the vehicle, see `local_earth.transport_curvature`, 1/m.
    """

    rate_ie_n: Vector
    rate_in_n: Vector
    force_n: Vector
    mat_nb: Matrix
    curvature: Vector


@inlined
def propagate(
    state: NavState, specific_force_b: Vector, angular_rate_b: Vector, dt: float, place: Place, gravity: float
) -> tuple[NavState, Motion]:
    """Advance position, velocity and attitude over one interval, s, by raw readings: the biases are taken off here.

    The specific force is turned to n by the mean of the attitudes at both ends; the position moves with the mean of the
    velocities.
    """
    height_m, velocity_n = state.position[2], state.velocity_n
    force_b, rate_b = subtract(specific_force_b, state.accel_bias_b), subtract(angular_rate_b, state.gyro_bias_b)
    curvature = transport_curvature(place, height_m)
    rate_in_n = add(place.rate_ie_n, transport_rate_n(curvature, velocity_n))
    mat_nb = _turned(state.mat_nb, rate_b, rate_in_n, dt)
    force_n = scale(0.5, add(rotate(state.mat_nb, force_b), rotate(mat_nb, force_b)))
    coriolis_n = cross(add(place.rate_ie_n, rate_in_n), velocity_n)
    acceleration_n = add(subtract(force_n, coriolis_n), (0.0, 0.0, gravity))
    velocity_after_n = add(velocity_n, scale(dt, acceleration_n))
    position = _moved(state.position, scale(0.5 * dt, add(velocity_n, velocity_after_n)), place)
    after = NavState(position, velocity_after_n, mat_nb, state.accel_bias_b, state.gyro_bias_b)
    return after, Motion(place.rate_ie_n, rate_in_n, force_n, mat_nb, curvature)


@inlined
def _turned(mat_nb: Matrix, angular_rate_b: Vector, rate_in_n: Vector, dt: float) -> Matrix:
    """Turn the attitude on both sides, each by its exact exponential."""
    body_turn = rotation_from_vector(scale(dt, angular_rate_b))
    frame_turn = rotation_from_vector(scale(-dt, rate_in_n))
    return compose(frame_turn, compose(mat_nb, body_turn))


@inlined
def _moved(position: Vector, way_n: Vector, place: Place) -> Vector:
    """Move a position along a way in metres."""
    to_north, to_east = curvatures(place, position[2])
    return (
        position[0] + way_n[0] * to_north,
        position[1] + way_n[1] * to_east / place.cos_latitude,
        position[2] - way_n[2],
    )
