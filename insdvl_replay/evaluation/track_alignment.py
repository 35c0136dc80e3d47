"""The rotation, shift and scale that align a track with another one by least squares, as users of evo know them.

Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991. About the
vertical alone the same sum of squares is least for the angle between the two tracks as complex numbers.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.rotation import mat_from_rpy

FEWEST_POINTS: Final = 3


class Align(StrEnum):
    """What is fitted before tracks are compared."""

    NONE = "none"
    YAW = "yaw"  # shift and heading: what an inertial system cannot observe without a position
    SE3 = "se3"  # shift and rotation
    SIM3 = "sim3"  # shift, rotation and scale


@dataclass(frozen=True)
class TrackTransform:
    """A point becomes ``scale * mat @ point + shift_m``."""

    mat: Floats  # (3, 3)
    shift_m: Floats  # (3,)
    scale: float = 1.0

    def moved(self, track_m: Floats) -> Floats:
        """Transform points, shape (k, 3)."""
        return np.asarray(self.scale * track_m @ self.mat.T + self.shift_m)


UNCHANGED: Final = TrackTransform(np.eye(3), np.zeros(3))


class NoAlignmentError(ValueError):
    """Two tracks do not determine a rotation."""


def aligned(track_m: Floats, reference_m: Floats, align: Align) -> TrackTransform:
    """Find the transform that brings a track, shape (k, 3), nearest to another one; rows with NaN do not count.

    Raises
    ------
    NoAlignmentError
        There are too few points, or they are on a line or in one place.
    """
    if align == Align.NONE:
        return UNCHANGED
    known = np.isfinite(track_m).all(axis=1) & np.isfinite(reference_m).all(axis=1)
    if np.count_nonzero(known) < FEWEST_POINTS:
        raise NoAlignmentError
    points = track_m[known]
    targets = reference_m[known]
    centre = points.mean(axis=0)
    target = targets.mean(axis=0)
    points = points - centre
    targets = targets - target
    if align == Align.YAW:
        mat = _turn(points, targets)
        scale = 1.0
    else:
        mat, scale = _similarity(points, targets, with_scale=align == Align.SIM3)
    return TrackTransform(mat, target - scale * mat @ centre, scale)


def _turn(points: Floats, targets: Floats) -> Floats:
    """Return the rotation about down that brings centred points nearest to others."""
    along = float(np.sum(points[:, :2] * targets[:, :2]))
    across = float(np.sum(points[:, 0] * targets[:, 1] - points[:, 1] * targets[:, 0]))
    size = np.sqrt(np.sum(points[:, :2] ** 2) * np.sum(targets[:, :2] ** 2))
    if not np.hypot(along, across) > np.finfo(np.float64).eps * size:
        raise NoAlignmentError
    return mat_from_rpy(np.array([0.0, 0.0, np.arctan2(across, along)]))


def _similarity(points: Floats, targets: Floats, *, with_scale: bool) -> tuple[Floats, float]:
    """Return rotation and scale that bring centred points nearest to others (Umeyama, equations 38 to 43)."""
    count = len(points)
    left, sizes, right = np.linalg.svd(targets.T @ points / count)
    if np.count_nonzero(sizes > np.finfo(np.float64).eps * max(sizes[0], 1.0)) < 2:
        raise NoAlignmentError
    signs = np.ones(3)
    if np.linalg.det(left) * np.linalg.det(right) < 0.0:
        signs[2] = -1.0
    mat = (left * signs) @ right
    scale = 1.0
    if with_scale:
        scale = float(np.sum(sizes * signs) / (np.sum(points**2) / count))
    return mat, scale
