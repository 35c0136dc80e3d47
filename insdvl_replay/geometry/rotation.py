"""Rotations: matrices, quaternions, roll-pitch-heading and rotation vectors, as numpy formulae over rows.

All functions take arrays with any leading dimensions: vectors (..., 3), quaternions (..., 4), matrices (..., 3, 3).
Source: Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd edition, chapter 2.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats

_UPRIGHT: Final = 1e-12  # cosine of a pitch at which roll and heading are about one axis


def skew(vector: Floats) -> Floats:
    """Return the matrix of the cross product: ``skew(a) @ b = a x b``."""
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -vector[..., 2], vector[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = vector[..., 2], -vector[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return matrix


def mat_from_rpy(rpy: Floats) -> Floats:
    """Return the matrix body to north-east-down of roll, pitch, heading in rad, shape (..., 3).

    Heading turns first, then pitch, then roll.
    """
    return mat_from_sines(np.sin(rpy), np.cos(rpy))


def mat_from_sines(sine: Floats, cosine: Floats) -> Floats:
    """Return the matrix of `mat_from_rpy` from sines and cosines of roll, pitch, heading, shape (..., 3)."""
    (sr, sp, sh), (cr, cp, ch) = np.moveaxis(sine, -1, 0), np.moveaxis(cosine, -1, 0)
    rows = [
        [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
        [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turned(mat: Floats, vector: Floats) -> Floats:
    """Return ``mat @ vector``, with sums in the same order on every processor.

    The shapes (..., m, 3) and (..., 3) give (..., m).
    """
    x, y, z = (vector[..., None, i] for i in range(3))
    product: Floats = mat[..., 0] * x + mat[..., 1] * y + mat[..., 2] * z
    return product


def rpy_from_mat(mat_nb: Floats) -> Floats:
    """Return roll, pitch, heading in rad; heading in (-pi, pi], roll 0 where the bow points up or down."""
    roll = np.arctan2(mat_nb[..., 2, 1], mat_nb[..., 2, 2])
    pitch = -np.arcsin(np.clip(mat_nb[..., 2, 0], -1.0, 1.0))
    heading = np.arctan2(mat_nb[..., 1, 0], mat_nb[..., 0, 0])
    upright = np.hypot(mat_nb[..., 2, 1], mat_nb[..., 2, 2]) < _UPRIGHT
    if np.any(upright):
        # Roll and heading are about the same axis there, and the elements above are both zero.
        roll = np.where(upright, 0.0, roll)
        heading = np.where(upright, np.arctan2(-mat_nb[..., 0, 1], mat_nb[..., 1, 1]), heading)
    return np.stack([roll, pitch, heading], axis=-1)


def mat_from_quat(quat: Floats) -> Floats:
    """Return the matrices of quaternions x, y, z, w, the order of ROS, of any length; NaN for length zero."""
    norm = np.linalg.norm(quat, axis=-1, keepdims=True)
    unit = quat / np.where(norm > 0.0, norm, np.nan)
    vector, w = unit[..., :3], unit[..., 3, None, None]
    outer = vector[..., :, None] * vector[..., None, :]
    squares = np.sum(vector * vector, axis=-1)[..., None, None]
    rotation: Floats = (w * w - squares) * np.eye(3) + 2.0 * outer + 2.0 * w * skew(vector)
    return rotation


def quat_from_mat(mat: Floats) -> Floats:
    """Return quaternions x, y, z, w with w >= 0.

    The largest of the four squared components comes first, so that no division is by a small number.
    Source: Shepperd, "Quaternion from Rotation Matrix", 1978.
    """
    xx, yy, zz = mat[..., 0, 0], mat[..., 1, 1], mat[..., 2, 2]
    xy, xz, yz = (
        mat[..., 1, 0] + mat[..., 0, 1],
        mat[..., 2, 0] + mat[..., 0, 2],
        mat[..., 2, 1] + mat[..., 1, 2],
    )
    wx, wy, wz = (
        mat[..., 2, 1] - mat[..., 1, 2],
        mat[..., 0, 2] - mat[..., 2, 0],
        mat[..., 1, 0] - mat[..., 0, 1],
    )
    columns = [
        [1 + xx - yy - zz, xy, xz, wx],
        [xy, 1 - xx + yy - zz, yz, wy],
        [xz, yz, 1 - xx - yy + zz, wz],
        [wx, wy, wz, 1 + xx + yy + zz],
    ]
    candidates = np.stack([np.stack(column, axis=-1) for column in columns], axis=-2)
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    quat = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    signed: Floats = np.where(quat[..., 3:] < 0.0, -quat, quat)
    return signed


def vector_from_mat(mat: Floats) -> Floats:
    """Return rotation vectors in rad, the logarithm of a rotation; their length is in [0, pi]."""
    quat = quat_from_mat(mat)
    sine = np.linalg.norm(quat[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quat[..., 3:])
    factor: Floats = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 1e-12)
    vector: Floats = factor * quat[..., :3]
    return vector


def mat_from_vector(vector: Floats) -> Floats:
    """Return the matrices of rotation vectors in rad, the exponential of a rotation."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    # numpy's sinc(x) is sin(pi x) / (pi x).
    return mat_from_quat(
        np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)
    )


def wrap_angle(angle: Floats) -> Floats:
    """Bring angles into [-pi, pi)."""
    wrapped: Floats = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped
