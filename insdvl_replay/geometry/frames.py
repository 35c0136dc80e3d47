"""Frames, the plane that touches the Earth, the beams of a DVL, and the steps of a track."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, seconds
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.rotation import mat_from_rpy, quat_from_mat, wrap_angle

MAT_ENU_NED: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # and back
MAT_FRD_FLU: Final = np.diag([1.0, -1.0, -1.0])  # and back


def north_east_m(position: Floats, origin: Floats, touching: Floats) -> tuple[Floats, Floats]:
    """Return the offset of a position from an origin, north and east on the plane that touches the Earth somewhere.

    Positions are latitude rad, longitude rad, height m, shape (..., 3). Where the height of ``touching`` is not finite,
    that of the ellipsoid counts.
    """
    latitude = position[..., 0] - origin[..., 0]
    longitude = wrap_angle(position[..., 1] - origin[..., 1])
    radius_north_m, radius_east_m, cosine = _radii_m(touching)
    return latitude * radius_north_m, longitude * radius_east_m * cosine


def north_east_down_m(position: Floats, origin: Floats) -> Floats:
    """Return the offset of a near position, m, shape (..., 3), on the plane that touches the Earth at the origin."""
    return np.stack(
        [*north_east_m(position, origin, origin), origin[..., 2] - position[..., 2]], axis=-1
    )


def east_north_up_m(position: Floats, origin: Floats) -> Floats:
    """Return the offset along the ellipsoid, m, shape (k, 3), with the radii halfway, so that up is height."""
    latitude, longitude, up_m = (position - origin).T
    radius_north_m, radius_east_m, cosine = _radii_m((position + origin) / 2.0)
    return np.stack(
        [wrap_angle(longitude) * (radius_east_m * cosine), latitude * radius_north_m, up_m],
        axis=-1,
    )


def moved_position(position: Floats, moved_n: Floats) -> Floats:
    """Move positions by short ways north, east, down, m: the inverse of `north_east_down_m`."""
    radius_north_m, radius_east_m, cosine = _radii_m(position)
    north = moved_n[..., 0] / radius_north_m
    east = moved_n[..., 1] / (radius_east_m * cosine)
    return position + np.stack([north, east, -moved_n[..., 2]], axis=-1)


def _radii_m(position: Floats) -> tuple[Floats, Floats, Floats]:
    """Return R_N + h, R_E + h and the cosine of the latitude."""
    latitude = position[..., 0]
    height_m = position[..., 2]
    level_m = np.where(np.isfinite(height_m), height_m, 0.0)
    return (
        meridian_radius_m(latitude) + level_m,
        transverse_radius_m(latitude) + level_m,
        np.cos(latitude),
    )


def quat_enu_flu(mat_nb: Floats) -> Floats:
    """Return attitudes as quaternions x, y, z, w, forward-port-up to east-north-up, shape (k, 4)."""
    return quat_from_mat(MAT_ENU_NED @ mat_nb @ MAT_FRD_FLU)


TILT_DEG: Final = 30.0  # from the z axis; most instruments have 20, 22.5, 25 or 30
AZIMUTH_DEG: Final = (45.0, 135.0, 225.0, 315.0)  # from forward towards starboard
# least part along z of the mean beam of a DVL that looks down, whatever its tilt
_DOWN: Final = 0.5


@dataclass(frozen=True)
class DvlMounting:
    """The place and axes of a DVL in a vehicle."""

    lever_arm_b: Floats = field(default_factory=lambda: np.zeros(3))  # (3,), IMU to DVL, m
    mat_bd: Floats = field(default_factory=lambda: np.eye(3))  # (3, 3), mounting rotation C_d^b
    scale: float = 1.0  # measured over true velocity

    @classmethod
    def from_rpy(
        cls,
        lever_arm_m: Sequence[float],
        rpy_deg: Sequence[float],
        scale: float,
    ) -> "DvlMounting":
        """Return a mounting from a lever arm in b, from roll, pitch and heading from d to b, and a scale."""
        return cls(np.array(lever_arm_m), mat_from_rpy(np.array(rpy_deg) * DEG), scale)

    def velocity_b(self, velocity_d: Floats) -> Floats:
        """Divide the scale out of velocities in d, shape (m, 3), and turn them to b."""
        return velocity_d @ self.mat_bd.T / self.scale


def look_down(look: Floats) -> bool:
    """Return whether beams look down, of their mean direction in forward-starboard-down, shape (3,)."""
    return bool(look[2] >= _DOWN * np.linalg.norm(look))


def beam_vectors(tilt_deg: float = TILT_DEG, azimuth_deg: Sequence[float] = AZIMUTH_DEG) -> Floats:
    """Return the unit vectors of the beams in d, from the instrument towards the seabed, shape (beams, 3).

    Levy and Klein print vectors of rank 2 that are not of unit length; see docs/equations/beams.md.
    """
    tilt = tilt_deg * DEG
    azimuth = np.array(azimuth_deg) * DEG
    down = np.full_like(azimuth, np.cos(tilt))
    return np.column_stack([np.cos(azimuth) * np.sin(tilt), np.sin(azimuth) * np.sin(tilt), down])


def solve_beams(
    beam_velocity_mps: Floats,  # (m, beams), NaN where a beam is lost
    vectors_d: Floats,  # (beams, 3), unit vectors
    weights: Floats | None = None,  # (beams,), inverse relative variances; all 1 when left out
) -> tuple[Floats, Floats, Floats]:
    """Solve velocities from beams by weighted least squares over the beams that are not NaN.

    Equations (6) to (8) of Levy and Klein, with weights. Returned are ``velocity_d``, shape (m, 3), NaN where the valid
    beams do not span three dimensions; its covariance for unit variance at weight 1, ``(H' W H)^-1``, shape (m, 3, 3);
    and the weighted rms residual over its degrees of freedom, shape (m,), NaN where no beam is redundant.
    """
    valid = np.isfinite(beam_velocity_mps)
    # Pings that have lost the same beams share their matrices.
    _, first, alike = np.unique(
        valid @ (1 << np.arange(len(vectors_d))), return_index=True, return_inverse=True
    )
    weight_of = valid[first] * (np.ones(len(vectors_d)) if weights is None else weights)
    normal = np.einsum("mi,ij,ik->mjk", weight_of, vectors_d, vectors_d)
    solvable = np.linalg.cond(normal) < 1e8
    shape_of = np.full_like(normal, np.nan)
    shape_of[solvable] = np.linalg.inv(normal[solvable])
    unit_cov_d = shape_of[alike]
    weight = weight_of[alike]
    measured = np.where(valid, beam_velocity_mps, 0.0)
    velocity_d = np.einsum(
        "mjk,mi,ik,mi->mj", unit_cov_d, weight, vectors_d, measured, optimize=True
    )
    residuals = measured - velocity_d @ vectors_d.T
    redundancy = valid.sum(axis=1) - 3
    squares = np.einsum("mi,mi->m", weight, residuals**2)
    return (
        velocity_d,
        unit_cov_d,
        np.sqrt(
            np.divide(squares, redundancy, out=np.full(len(squares), np.nan), where=redundancy > 0)
        ),
    )


def whole_ping_cov(vectors_d: Floats) -> Floats:
    """Return the covariance of a velocity from all beams, each with unit variance, shape (3, 3)."""
    return np.linalg.pinv(vectors_d.T @ vectors_d).astype(np.float64)


Complex = NDArray[np.complex128]  # north and east as one number

LONGEST_PAUSE_S: Final = 2.5  # the velocity is not integrated over a longer pause
AROUND: Final = 3  # steps before and after; a step that is no jump is like one of them
OUTSTANDING: Final = 10.0  # a jump is so many robust standard deviations of the unexplained part
_LONG_STEP: Final = 3.0  # in usual ones
_CURVED_S: Final = 1.5  # in longer steps a turning vehicle moves unlike in the ones around
_MEDIAN_LENGTH: Final = 1.18  # of a vector of normal noise in a plane, in standard deviations


@dataclass(frozen=True)
class Steps:
    """From each position to the next: the displacement, and the integrated velocity, m; NaN where unknown."""

    time_s: Floats  # (k,), of the positions, from the first
    by_position_m: Complex  # (k - 1,)
    by_velocity_m: Complex  # (k - 1,)


def horizontal(vectors: Floats) -> Complex:
    """Return the first two parts of vectors, shape (k, 3), as complex numbers."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def steps_of(motion: ReferenceColumns) -> Steps:
    """Return the steps of a track from each known position to the next."""
    placed = motion.known["positions"]
    moving = motion.known["velocities"]
    time_ns = motion.time_ns[placed]
    if len(time_ns) < 2:
        return Steps(np.empty(0), np.empty(0, complex), np.empty(0, complex))
    time_s = seconds(time_ns, time_ns[0])
    by_velocity_m = np.full(len(time_s) - 1, np.nan, complex)
    if np.count_nonzero(moving) >= 3:
        velocity_s = seconds(motion.time_ns[moving], time_ns[0])
        velocity = horizontal(motion.velocity_n[moving])
        # Trapezoids alone would cut the corners of a turn, by 0.7 % at 17 deg a step. The change of the acceleration is
        # the next term of Euler and Maclaurin.
        step_s = np.diff(velocity_s)
        acceleration = np.gradient(velocity, velocity_s)
        moved_m = (
            0.5 * (velocity[1:] + velocity[:-1]) * step_s
            - np.diff(acceleration) * step_s**2 / 12.0
        )
        summed_m = np.append(0.0, np.cumsum(moved_m))
        paused_s = np.append(0.0, np.cumsum(np.where(step_s > LONGEST_PAUSE_S, step_s, 0.0)))
        by_velocity_m = np.diff(np.interp(time_s, velocity_s, summed_m, np.nan, np.nan))
        by_velocity_m = np.where(
            np.diff(np.interp(time_s, velocity_s, paused_s)) > 0.0, np.nan, by_velocity_m
        )
    # Each step is measured on the ellipsoid where it is made, so that long ways are as right as short ones.
    position = motion.position[placed]
    north_m, east_m = north_east_m(
        position[1:], position[:-1], 0.5 * (position[1:] + position[:-1])
    )
    return Steps(time_s, np.asarray(north_m + 1j * east_m), by_velocity_m)


def unexplained_m(steps: Steps) -> Floats:
    """Return the part of each step that neither the velocity nor any of the steps around explains, shape (k - 1,), m.

    NaN for steps that are much longer than usual, and for too few steps.
    """
    step_s = np.diff(steps.time_s)
    if len(step_s) <= 2 * AROUND:
        return np.full(len(step_s), np.nan)
    unlike_m = np.abs(steps.by_position_m - steps.by_velocity_m)
    rates = np.where(step_s <= _CURVED_S, steps.by_position_m / step_s, np.nan)
    unlike_m = np.fmin(
        unlike_m, least_difference(np.column_stack([rates.real, rates.imag])) * step_s
    )
    unlike_m[step_s > _LONG_STEP * np.median(step_s)] = np.nan
    return np.asarray(unlike_m)


def find_jumps(unlike: Floats, smallest: float | Floats) -> NDArray[np.int64]:
    """Return the steps whose unexplained part is at least ``smallest``, and `OUTSTANDING` times the usual one."""
    known: NDArray[np.bool_] = np.isfinite(unlike)
    if not known.any():
        return np.empty(0, np.int64)
    limit = np.maximum(smallest, OUTSTANDING / _MEDIAN_LENGTH * float(np.median(unlike[known])))
    return np.flatnonzero(known & (unlike > limit))


def least_difference(steps: Floats) -> Floats:
    """Return the distance of each of k vectors from the nearest of its neighbours, shape (k,)."""
    least = np.full(len(steps), np.nan)
    for reach in range(1, AROUND + 1):
        apart = np.linalg.norm(steps[reach:] - steps[:-reach], axis=1)
        for rows in (slice(reach, None), slice(None, -reach)):  # these overlap
            least[rows] = np.fmin(least[rows], apart)
    return least
