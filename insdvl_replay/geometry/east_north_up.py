"""Positions and attitudes as ROS has them (REP 103): east-north-up at a first position, forward-port-up in the body."""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.rotation import quat_from_mat, wrap_angle

MAT_ENU_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MAT_FRD_FLU: Final = np.diag([1.0, -1.0, -1.0])


def east_north_up_m(position: Floats, origin: Floats) -> Floats:
    """Measure along the ellipsoid with the radii halfway, so that up is height wherever the dive leads.

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
    middle_latitude, _, middle_height_m = ((position + origin) / 2.0).T
    north_m = latitude * (meridian_radius_m(middle_latitude) + middle_height_m)
    parallel_radius_m = (transverse_radius_m(middle_latitude) + middle_height_m) * np.cos(middle_latitude)
    return np.stack([wrap_angle(longitude) * parallel_radius_m, north_m, up_m], axis=-1)


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
