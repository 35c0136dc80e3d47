"""The beams of a DVL: where those of a Janus point, tilted from the z axis and evenly around it, and what they tell."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy

TILT_DEG: Final = 30.0
"""From the z axis; most instruments have 20, 22.5, 25 or 30."""
AZIMUTH_DEG: Final = (45.0, 135.0, 225.0, 315.0)
"""From forward towards starboard."""

_DOWN: Final = 0.5
"""The beams of a DVL that looks down have together at least such a part along z, whatever tilt they have."""


@dataclass(frozen=True)
class DvlMounting:
    """How a DVL is built into a vehicle.

    Attributes
    ----------
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    mat_bd : ndarray, shape (3, 3)
        Mounting rotation C_d^b.
    scale : float
        Measured over true velocity.
    """

    lever_arm_b: Floats = field(default_factory=lambda: np.zeros(3))
    mat_bd: Floats = field(default_factory=lambda: np.eye(3))
    scale: float = 1.0

    @classmethod
    def of(cls, lever_arm_m: Sequence[float], rpy_deg: Sequence[float], scale: float) -> "DvlMounting":
        """Make it of a lever arm in b, of roll, pitch and heading from d to b, and of a scale."""
        return cls(np.array(lever_arm_m), mat_from_rpy(np.array(rpy_deg) * DEG), scale)

    def velocity_b(self, velocity_d: Floats) -> Floats:
        """Divide the scale out of velocities in d, shape (m, 3), and turn them to b."""
        return velocity_d @ self.mat_bd.T / self.scale


def look_down(look: Floats) -> bool:
    """Return whether beams look down that look on average along a vector, shape (3,), of forward-starboard-down."""
    return bool(look[2] >= _DOWN * np.linalg.norm(look))


def beam_vectors(tilt_deg: float = TILT_DEG, azimuth_deg: Sequence[float] = AZIMUTH_DEG) -> Floats:
    """Make the unit vectors of the beams, from the instrument towards the seabed.

    Levy and Klein print vectors of rank 2 that are not of unit length; see equations/beams.md.

    Parameters
    ----------
    tilt_deg : float
        Angle from the DVL's z axis.
    azimuth_deg : sequence of float
        One for each beam, from forward towards starboard.

    Returns
    -------
    ndarray, shape (beams, 3)
        In d.
    """
    tilt, azimuth = tilt_deg * DEG, np.array(azimuth_deg) * DEG
    down = np.full_like(azimuth, np.cos(tilt))
    return np.column_stack([np.cos(azimuth) * np.sin(tilt), np.sin(azimuth) * np.sin(tilt), down])


def solve_beams(
    beam_velocity_mps: Floats, vectors_d: Floats, weights: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Solve velocities from beams by weighted least squares over the beams that are not NaN.

    Equations (6) to (8) of Levy and Klein, with weights.

    Parameters
    ----------
    beam_velocity_mps : ndarray, shape (m, beams)
        NaN where a beam is lost.
    vectors_d : ndarray, shape (beams, 3)
        Unit vectors.
    weights : ndarray, shape (beams,), optional
        Inverse relative variances; all 1 when left out.

    Returns
    -------
    velocity_d : ndarray, shape (m, 3)
        NaN where the valid beams do not span three dimensions.
    unit_cov_d : ndarray, shape (m, 3, 3)
        ``(H' W H)^-1``, the covariance for unit variance at weight 1.
    residual_mps : ndarray, shape (m,)
        Weighted root mean square residual over its degrees of freedom; NaN where no beam is redundant.
    """
    valid = np.isfinite(beam_velocity_mps)
    # Pings that have lost the same beams share their matrices.
    _, first, alike = np.unique(valid @ (1 << np.arange(len(vectors_d))), return_index=True, return_inverse=True)
    weight_of = valid[first] * (np.ones(len(vectors_d)) if weights is None else weights)
    normal = np.einsum("mi,ij,ik->mjk", weight_of, vectors_d, vectors_d)
    solvable = np.linalg.cond(normal) < 1e8
    shape_of = np.full_like(normal, np.nan)
    shape_of[solvable] = np.linalg.inv(normal[solvable])
    unit_cov_d, weight, measured = shape_of[alike], weight_of[alike], np.where(valid, beam_velocity_mps, 0.0)
    velocity_d = np.einsum("mjk,mi,ik,mi->mj", unit_cov_d, weight, vectors_d, measured, optimize=True)
    residuals = measured - velocity_d @ vectors_d.T
    redundancy = valid.sum(axis=1) - 3
    squares = np.einsum("mi,mi->m", weight, residuals**2)
    return (
        velocity_d,
        unit_cov_d,
        np.sqrt(np.divide(squares, redundancy, out=np.full(len(squares), np.nan), where=redundancy > 0)),
    )


def whole_ping_cov(vectors_d: Floats) -> Floats:
    """Return the covariance of a velocity from all beams, each with unit variance, shape (3, 3)."""
    return np.linalg.pinv(vectors_d.T @ vectors_d).astype(np.float64)
