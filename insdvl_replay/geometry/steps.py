"""From position to position: how far a track goes, what its velocity says of that, and which steps nothing explains."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, seconds
from insdvl_replay.geometry.frames import north_east_m

Complex = NDArray[np.complex128]
"""North and east as one number."""

LONGEST_PAUSE_S: Final = 2.5
"""Through a longer pause of the velocity nobody saw what was between."""
AROUND: Final = 3
"""Steps before and after, of which a step that is no jump is like one."""
OUTSTANDING: Final = 10.0
"""Robust standard deviations of what usually stays unexplained, beyond which a step is a jump."""
_LONG_STEP: Final = 3.0  # in usual ones
_CURVED_S: Final = 1.5  # in longer steps a turning vehicle moves unlike in the ones around
_MEDIAN_LENGTH: Final = 1.18  # of a vector of normal noise in a plane, in standard deviations


@dataclass(frozen=True)
class Steps:
    """From each position to the next: the displacement, and the integrated velocity, m; NaN where unknown.

    Attributes
    ----------
    time_s : ndarray, shape (k,)
        Of the positions, from the first.
    by_position_m, by_velocity_m : ndarray, shape (k - 1,)
    """

    time_s: Floats
    by_position_m: Complex
    by_velocity_m: Complex


def horizontal(vectors: Floats) -> Complex:
    """Make complex numbers of the first two parts of vectors, shape (k, 3)."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def steps_of(motion: ReferenceColumns) -> Steps:
    """Take the steps of a track from each known position to the next."""
    placed, moving = motion.known["positions"], motion.known["velocities"]
    time_ns = motion.time_ns[placed]
    if len(time_ns) < 2:
        return Steps(np.empty(0), np.empty(0, complex), np.empty(0, complex))
    time_s = seconds(time_ns, time_ns[0])
    by_velocity_m = np.full(len(time_s) - 1, np.nan, complex)
    if np.count_nonzero(moving) >= 3:
        velocity_s = seconds(motion.time_ns[moving], time_ns[0])
        by_velocity_m = _integrated_m(time_s, velocity_s, horizontal(motion.velocity_n[moving]))
    return Steps(time_s, _displacements_m(motion.position[placed]), by_velocity_m)


def unexplained_m(steps: Steps) -> Floats:
    """Return how much of each step neither the velocity nor any of the steps around explains, shape (k - 1,), m.

    NaN of steps that are much longer than usual, in which a vehicle may do anything, and of too few steps.
    """
    step_s = np.diff(steps.time_s)
    if len(step_s) <= 2 * AROUND:
        return np.full(len(step_s), np.nan)
    unlike_m = np.abs(steps.by_position_m - steps.by_velocity_m)
    rates = np.where(step_s <= _CURVED_S, steps.by_position_m / step_s, np.nan)
    unlike_m = np.fmin(unlike_m, least_difference(np.column_stack([rates.real, rates.imag])) * step_s)
    unlike_m[step_s > _LONG_STEP * np.median(step_s)] = np.nan
    return np.asarray(unlike_m)


def find_jumps(unlike: Floats, smallest: float | Floats) -> NDArray[np.int64]:
    """Find the steps of which at least so much is unexplained, and `OUTSTANDING` times what usually is."""
    known: NDArray[np.bool_] = np.isfinite(unlike)
    if not known.any():
        return np.empty(0, np.int64)
    limit = np.maximum(smallest, OUTSTANDING / _MEDIAN_LENGTH * float(np.median(unlike[known])))
    return np.flatnonzero(known & (unlike > limit))


def least_difference(steps: Floats) -> Floats:
    """Return the distance of each of k vectors from the one of its neighbours that is nearest to it, shape (k,)."""
    least = np.full(len(steps), np.nan)
    for reach in range(1, AROUND + 1):
        apart = np.linalg.norm(steps[reach:] - steps[:-reach], axis=1)
        for rows in (slice(reach, None), slice(None, -reach)):  # these overlap
            least[rows] = np.fmin(least[rows], apart)
    return least


def _displacements_m(position: Floats) -> Complex:
    """Measure each step on the ellipsoid where it is made, so that long ways are as right as short ones."""
    north_m, east_m = north_east_m(position[1:], position[:-1], 0.5 * (position[1:] + position[:-1]))
    return np.asarray(north_m + 1j * east_m)


def _integrated_m(time_s: Floats, velocity_s: Floats, velocity: Complex) -> Complex:
    """Integrate the velocity from one time to the next; NaN over a pause of it, and outside of it.

    Trapezoids alone would cut the corners of a turn, by 0.7 % at 17 deg a step; what the acceleration's change adds is
    Euler and Maclaurin's.
    """
    step_s = np.diff(velocity_s)
    acceleration = np.gradient(velocity, velocity_s)
    way_m = 0.5 * (velocity[1:] + velocity[:-1]) * step_s - np.diff(acceleration) * step_s**2 / 12.0
    summed_m = np.append(0.0, np.cumsum(way_m))
    paused_s = np.append(0.0, np.cumsum(np.where(step_s > LONGEST_PAUSE_S, step_s, 0.0)))
    by_velocity_m = np.diff(np.interp(time_s, velocity_s, summed_m, np.nan, np.nan))
    return np.where(np.diff(np.interp(time_s, velocity_s, paused_s)) > 0.0, np.nan, by_velocity_m)
