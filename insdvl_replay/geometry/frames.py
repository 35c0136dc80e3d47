"""Frames and the plane that touches the Earth: north-east-down, and east-north-up as ROS has it (REP 103)."""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.rotation import quat_from_mat, wrap_angle

MAT_ENU_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Takes coordinates east-north-up to north-east-down, and back."""
MAT_FRD_FLU: Final = np.diag([1.0, -1.0, -1.0])
"""Takes coordinates forward-port-up to forward-starboard-down, and back."""


def north_east_m(position: Floats, origin: Floats, touching: Floats) -> tuple[Floats, Floats]:
    """Return the way from an origin to a position, north and east on the plane that touches the Earth somewhere.

    Parameters
    ----------
    position, origin, touching : ndarray, shape (..., 3)
        Latitude rad, longitude rad, height m. Where the height of ``touching`` is not finite the ellipsoid's counts.

    Returns
    -------
    north_m, east_m : ndarray, shape (...,)
    """
    latitude, longitude = position[..., 0] - origin[..., 0], wrap_angle(position[..., 1] - origin[..., 1])
    radius_north_m, radius_east_m, cosine = _radii_m(touching)
    return latitude * radius_north_m, longitude * radius_east_m * cosine


def north_east_down_m(position: Floats, origin: Floats) -> Floats:
    """Return the way from an origin to a near position, on the plane that touches the Earth at the origin.

    Parameters
    ----------
    position, origin : ndarray, shape (..., 3)
        Latitude rad, longitude rad, height m.

    Returns
    -------
    ndarray, shape (..., 3), m
    """
    return np.stack([*north_east_m(position, origin, origin), origin[..., 2] - position[..., 2]], axis=-1)


def east_north_up_m(position: Floats, origin: Floats) -> Floats:
    """Return the way from an origin along the ellipsoid, with the radii halfway, so that up is height.

    Parameters
    ----------
    position : ndarray, shape (k, 3)
        Latitude rad, longitude rad, height m.
    origin : ndarray, shape (3,)
        Likewise.

    Returns
    -------
    ndarray, shape (k, 3), m
    """
    latitude, longitude, up_m = (position - origin).T
    radius_north_m, radius_east_m, cosine = _radii_m((position + origin) / 2.0)
    return np.stack([wrap_angle(longitude) * (radius_east_m * cosine), latitude * radius_north_m, up_m], axis=-1)


def moved_position(position: Floats, way_n: Floats) -> Floats:
    """Move positions by short ways north, east, down: the inverse of `north_east_down_m`.

    Parameters
    ----------
    position : ndarray, shape (..., 3)
        Latitude rad, longitude rad, height m.
    way_n : ndarray, shape (..., 3), m

    Returns
    -------
    ndarray, shape (..., 3)
        Latitude rad, longitude rad, height m.
    """
    radius_north_m, radius_east_m, cosine = _radii_m(position)
    north, east = way_n[..., 0] / radius_north_m, way_n[..., 1] / (radius_east_m * cosine)
    return position + np.stack([north, east, -way_n[..., 2]], axis=-1)


def _radii_m(position: Floats) -> tuple[Floats, Floats, Floats]:
    """Return R_N + h, R_E + h and the cosine of the latitude; a height that is not finite counts as 0."""
    latitude, height_m = position[..., 0], position[..., 2]
    level_m = np.where(np.isfinite(height_m), height_m, 0.0)
    return meridian_radius_m(latitude) + level_m, transverse_radius_m(latitude) + level_m, np.cos(latitude)


def quat_enu_flu(mat_nb: Floats) -> Floats:
    """Turn attitudes into quaternions x, y, z, w, forward-port-up to east-north-up.

    Parameters
    ----------
    mat_nb : ndarray, shape (k, 3, 3)

    Returns
    -------
    ndarray, shape (k, 4)
    """
    return quat_from_mat(MAT_ENU_NED @ mat_nb @ MAT_FRD_FLU)
