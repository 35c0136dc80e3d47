"""Strapdown mechanisation in north-east-down on the rotating WGS-84 Earth.

The functions work on small arrays in place, since the filter calls them once for each IMU sample.
Source: equations (24) and (25) of Levy and Klein; Groves, chapter 5.
"""

import math

import numpy as np

from insdvl_replay import earth
from insdvl_replay.columns import Floats
from insdvl_replay.nav.compiled import compiled
from insdvl_replay.nav.kalman import multiply

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
def transport_rate_n(position: Floats, velocity_n: Floats, rate_n: Floats) -> None:
    """Write the rate w_en at which n turns because the vehicle moves over the curved Earth.

    Parameters
    ----------
    position : ndarray, shape (3,)
        Latitude rad, longitude rad, height m.
    velocity_n : ndarray, shape (3,)
        m/s
    rate_n : ndarray, shape (3,)
        Written, rad/s.
    """
    latitude, height_m = position[0], position[2]
    east_radius_m = transverse_radius_m(latitude) + height_m
    rate_n[0] = velocity_n[1] / east_radius_m
    rate_n[1] = -velocity_n[0] / (meridian_radius_m(latitude) + height_m)
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
def rotate(mat: Floats, vector: Floats, rotated: Floats) -> None:
    """Write ``mat @ vector``; ``rotated`` is not ``vector``."""
    for i in range(3):
        rotated[i] = mat[i, 0] * vector[0] + mat[i, 1] * vector[1] + mat[i, 2] * vector[2]


@compiled
def rotate_back(mat: Floats, vector: Floats, rotated: Floats) -> None:
    """Write ``mat.T @ vector``; ``rotated`` is not ``vector``."""
    for i in range(3):
        rotated[i] = mat[0, i] * vector[0] + mat[1, i] * vector[1] + mat[2, i] * vector[2]


@compiled
def propagate(
    position: Floats,
    velocity_n: Floats,
    mat_nb: Floats,
    specific_force_b: Floats,
    angular_rate_b: Floats,
    dt: float,
    rate_ie_n: Floats,
    rate_in_n: Floats,
    force_n: Floats,
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
    rate_ie_n, rate_in_n, force_n : ndarray, shape (3,)
        Written: Earth rate, w_ie + w_en, and specific force in n, for the error model.
    """
    earth_rate_n(position[0], rate_ie_n)
    transport_rate_n(position, velocity_n, rate_in_n)
    for i in range(3):
        rate_in_n[i] += rate_ie_n[i]
    _propagate_attitude(mat_nb, specific_force_b, angular_rate_b, rate_in_n, dt, force_n)

    north, east, down = velocity_n
    x, y, z = rate_ie_n[0] + rate_in_n[0], rate_ie_n[1] + rate_in_n[1], rate_ie_n[2] + rate_in_n[2]
    velocity_n[0] += (force_n[0] - (y * down - z * east)) * dt
    velocity_n[1] += (force_n[1] - (z * north - x * down)) * dt
    velocity_n[2] += (force_n[2] - (x * east - y * north) + normal_gravity(position[0], position[2])) * dt

    latitude = position[0]
    position[0] += 0.5 * dt * (north + velocity_n[0]) / (meridian_radius_m(latitude) + position[2])
    position[1] += (
        0.5 * dt * (east + velocity_n[1]) / ((transverse_radius_m(latitude) + position[2]) * math.cos(latitude))
    )
    position[2] -= 0.5 * dt * (down + velocity_n[2])


@compiled
def _propagate_attitude(
    mat_nb: Floats, specific_force_b: Floats, angular_rate_b: Floats, rate_in_n: Floats, dt: float, force_n: Floats
) -> None:
    turn, mat_turn, mat_half = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        turn[i] = angular_rate_b[i] * dt
    rotation_from_vector(turn, mat_turn)
    multiply(mat_nb, mat_turn, mat_half)
    rotate(mat_nb, specific_force_b, force_n)
    for i in range(3):
        turn[i] = -rate_in_n[i] * dt
    rotation_from_vector(turn, mat_turn)
    multiply(mat_turn, mat_half, mat_nb)
    for i in range(3):
        after = (
            mat_nb[i, 0] * specific_force_b[0] + mat_nb[i, 1] * specific_force_b[1] + mat_nb[i, 2] * specific_force_b[2]
        )
        force_n[i] = 0.5 * (force_n[i] + after)
