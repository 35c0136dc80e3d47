"""Strapdown mechanisation in north-east-down on the rotating WGS-84 Earth.

The functions work on small arrays in place, since the filter calls them once for each IMU sample.
Source: equations (24) and (25) of Levy and Klein; Groves, chapter 5.
"""

import math
from typing import NamedTuple

import numpy as np

from insdvl_replay import earth
from insdvl_replay.columns import Floats
from insdvl_replay.nav.compiled import compiled

normal_gravity = compiled(earth.normal_gravity)
meridian_radius_m = compiled(earth.meridian_radius_m)
transverse_radius_m = compiled(earth.transverse_radius_m)


@compiled
def earth_rate_n(latitude: float, rate_n: Floats) -> None:
    """Write the Earth's rotation rate w_ie in n.

    Parameters
    ----------
    latitude : float
        rad
    rate_n : ndarray, shape (3,)
        Written, rad/s.
    """
    rate_n[0] = earth.EARTH_RATE * math.cos(latitude)
    rate_n[1] = 0.0
    rate_n[2] = -earth.EARTH_RATE * math.sin(latitude)


@compiled
def transport_rate_n(
    latitude: float, velocity_n: Floats, north_radius_m: float, east_radius_m: float, rate_n: Floats
) -> None:
    """Write the rate w_en at which n turns because the vehicle moves over the curved Earth.

    Parameters
    ----------
    latitude : float
        rad
    velocity_n : ndarray, shape (3,)
        m/s
    north_radius_m, east_radius_m : float
        Radii of curvature at the vehicle's height.
    rate_n : ndarray, shape (3,)
        Written, rad/s.
    """
    rate_n[0] = velocity_n[1] / east_radius_m
    rate_n[1] = -velocity_n[0] / north_radius_m
    rate_n[2] = -velocity_n[1] * math.tan(latitude) / east_radius_m


@compiled
def rotation_from_vector(vector: Floats, mat: Floats) -> None:
    """Write the rotation matrix exp([vector x]) by Rodrigues' formula.

    Below 0.01 rad the sine and cosine are replaced by their series, which there are exact to the last bit but one.

    Parameters
    ----------
    vector : ndarray, shape (3,)
        rad
    mat : ndarray, shape (3, 3)
        Written.
    """
    x, y, z = vector[0], vector[1], vector[2]
    square = x * x + y * y + z * z
    if square < 1e-4:
        sine = 1.0 - square / 6.0 * (1.0 - square / 20.0)
        versine = 0.5 - square / 24.0 * (1.0 - square / 30.0)
    else:
        angle = math.sqrt(square)
        sine = math.sin(angle) / angle
        versine = (1.0 - math.cos(angle)) / square
    mat[0, 0] = 1.0 - versine * (y * y + z * z)
    mat[1, 1] = 1.0 - versine * (x * x + z * z)
    mat[2, 2] = 1.0 - versine * (x * x + y * y)
    mat[0, 1], mat[1, 0] = versine * x * y - sine * z, versine * x * y + sine * z
    mat[0, 2], mat[2, 0] = versine * x * z + sine * y, versine * x * z - sine * y
    mat[1, 2], mat[2, 1] = versine * y * z - sine * x, versine * y * z + sine * x


@compiled
def compose(mat_ab: Floats, mat_bc: Floats, mat_ac: Floats) -> None:
    """Write the product of two rotations, each of shape (3, 3); the product is neither of them."""
    for i in range(3):
        for j in range(3):
            mat_ac[i, j] = mat_ab[i, 0] * mat_bc[0, j] + mat_ab[i, 1] * mat_bc[1, j] + mat_ab[i, 2] * mat_bc[2, j]


@compiled
def rotate(mat: Floats, vector: Floats, rotated: Floats) -> None:
    """Write ``mat @ vector``; ``rotated`` is not ``vector``."""
    for i in range(3):
        rotated[i] = mat[i, 0] * vector[0] + mat[i, 1] * vector[1] + mat[i, 2] * vector[2]


@compiled
def rotate_back(mat: Floats, vector: Floats, rotated: Floats) -> None:
    """Write ``mat.T @ vector``; ``rotated`` is not ``vector``."""
    for i in range(3):
        rotated[i] = mat[0, i] * vector[0] + mat[1, i] * vector[1] + mat[2, i] * vector[2]


class Step(NamedTuple):
    """What a step of the mechanisation leaves for the error model, and room to compute it in.

    Attributes
    ----------
    rate_ie_n, rate_in_n : ndarray, shape (3,)
        Earth rate, and Earth rate plus transport rate, rad/s.
    force_n : ndarray, shape (3,)
        Specific force in n, m/s^2.
    turn : ndarray, shape (3,)
        A rotation vector.
    mat_turn, mat_half : ndarray, shape (3, 3)
        Its matrix, and the attitude turned on one side.
    """

    rate_ie_n: Floats
    rate_in_n: Floats
    force_n: Floats
    turn: Floats
    mat_turn: Floats
    mat_half: Floats


@compiled
def new_step() -> Step:
    """Make room for steps."""
    return Step(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)))


@compiled
def propagate(
    position: Floats,
    velocity_n: Floats,
    mat_nb: Floats,
    specific_force_b: Floats,
    angular_rate_b: Floats,
    dt: float,
    step: Step,
) -> None:
    """Advance position, velocity and attitude over one interval, in place.

    The attitude takes the exact exponential on both sides; the specific force is turned to n by the mean of the
    attitudes at both ends; the position moves with the mean of the velocities.

    Parameters
    ----------
    position : ndarray, shape (3,)
        Latitude rad, longitude rad, height m; advanced.
    velocity_n : ndarray, shape (3,)
        m/s; advanced.
    mat_nb : ndarray, shape (3, 3)
        Advanced.
    specific_force_b, angular_rate_b : ndarray, shape (3,)
        Means over the interval, m/s^2 and rad/s.
    dt : float
        Length of the interval, s.
    step : Step
        Written.
    """
    latitude, height_m = position[0], position[2]
    north_radius_m = meridian_radius_m(latitude) + height_m
    east_radius_m = transverse_radius_m(latitude) + height_m
    earth_rate_n(latitude, step.rate_ie_n)
    transport_rate_n(latitude, velocity_n, north_radius_m, east_radius_m, step.rate_in_n)
    for i in range(3):
        step.rate_in_n[i] += step.rate_ie_n[i]
    _propagate_attitude(mat_nb, specific_force_b, angular_rate_b, dt, step)

    north, east, down = velocity_n
    x, y, z = (
        step.rate_ie_n[0] + step.rate_in_n[0],
        step.rate_ie_n[1] + step.rate_in_n[1],
        step.rate_ie_n[2] + step.rate_in_n[2],
    )
    velocity_n[0] += (step.force_n[0] - (y * down - z * east)) * dt
    velocity_n[1] += (step.force_n[1] - (z * north - x * down)) * dt
    velocity_n[2] += (step.force_n[2] - (x * east - y * north) + normal_gravity(latitude, height_m)) * dt

    position[0] += 0.5 * dt * (north + velocity_n[0]) / north_radius_m
    position[1] += 0.5 * dt * (east + velocity_n[1]) / (east_radius_m * math.cos(latitude))
    position[2] -= 0.5 * dt * (down + velocity_n[2])


@compiled
def _propagate_attitude(
    mat_nb: Floats, specific_force_b: Floats, angular_rate_b: Floats, dt: float, step: Step
) -> None:
    for i in range(3):
        step.turn[i] = angular_rate_b[i] * dt
    rotation_from_vector(step.turn, step.mat_turn)
    compose(mat_nb, step.mat_turn, step.mat_half)
    rotate(mat_nb, specific_force_b, step.force_n)
    for i in range(3):
        step.turn[i] = -step.rate_in_n[i] * dt
    rotation_from_vector(step.turn, step.mat_turn)
    compose(step.mat_turn, step.mat_half, mat_nb)
    rotate(mat_nb, specific_force_b, step.turn)
    for i in range(3):
        step.force_n[i] = 0.5 * (step.force_n[i] + step.turn[i])
