"""Strapdown mechanisation in north-east-down on the rotating WGS-84 Earth.

Source: equations (24) and (25) of Levy and Klein; Groves, chapter 5.
"""

from typing import NamedTuple

from insdvl_replay.columns import Floats
from insdvl_replay.compiled import compiled
from insdvl_replay.nav.place import Place, curvatures, gravity_at, transport_rate_n
from insdvl_replay.nav.vector_algebra import (
    Matrix,
    Vector,
    add,
    compose,
    cross,
    matrix,
    rotate,
    rotation_from_vector,
    scale,
    subtract,
    vector,
    write_matrix,
    write_vector,
)


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
    """

    rate_ie_n: Vector
    rate_in_n: Vector
    force_n: Vector
    mat_nb: Matrix


@compiled
def propagate(
    position: Floats,
    velocity_n: Floats,
    mat_nb: Floats,
    specific_force_b: Vector,
    angular_rate_b: Vector,
    dt: float,
    place: Place,
) -> Motion:
    """Advance position, velocity and attitude over one interval, in place.

    The specific force is turned to n by the mean of the attitudes at both ends; the position moves with the mean of the
    velocities.

    Parameters
    ----------
    position : ndarray, shape (3,)
        Latitude rad, longitude rad, height m; advanced.
    velocity_n : ndarray, shape (3,)
        m/s; advanced.
    mat_nb : ndarray, shape (3, 3)
        Advanced.
    specific_force_b, angular_rate_b : tuple of 3 float
        Means over the interval, m/s^2 and rad/s.
    dt : float
        Length of the interval, s.
    place : Place
        Where the vehicle is, within its reach.

    Returns
    -------
    Motion
    """
    height_m, velocity, attitude = position[2], vector(velocity_n), matrix(mat_nb)
    rate_in_n = add(place.rate_ie_n, transport_rate_n(place, height_m, velocity))
    attitude_after = _turned(attitude, angular_rate_b, rate_in_n, dt)
    force_n = scale(0.5, add(rotate(attitude, specific_force_b), rotate(attitude_after, specific_force_b)))
    coriolis_n = cross(add(place.rate_ie_n, rate_in_n), velocity)
    acceleration_n = add(subtract(force_n, coriolis_n), (0.0, 0.0, gravity_at(place, height_m)))
    velocity_after = add(velocity, scale(dt, acceleration_n))
    _move(position, scale(0.5 * dt, add(velocity, velocity_after)), place)
    write_vector(velocity_after, velocity_n)
    write_matrix(attitude_after, mat_nb)
    return Motion(place.rate_ie_n, rate_in_n, force_n, attitude_after)


@compiled
def _turned(mat_nb: Matrix, angular_rate_b: Vector, rate_in_n: Vector, dt: float) -> Matrix:
    """Turn the attitude on both sides, each by its exact exponential."""
    body_turn = rotation_from_vector(scale(dt, angular_rate_b))
    frame_turn = rotation_from_vector(scale(-dt, rate_in_n))
    return compose(frame_turn, compose(mat_nb, body_turn))


@compiled
def _move(position: Floats, way_n: Vector, place: Place) -> None:
    """Move a position along a way in metres."""
    to_north, to_east = curvatures(place, position[2])
    position[0] += way_n[0] * to_north
    position[1] += way_n[1] * to_east / place.cos_latitude
    position[2] -= way_n[2]
