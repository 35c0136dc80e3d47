"""The error model: the error states of a filter, and how they grow.

The twelve states

    F = [ -[(2 w_ie + w_en) x]   -[f_n x]     C   0 ]        D dv = w_en of the velocity dv
        [         -D            -[w_in x]     0   C ]
        [          0                0         0   0 ]
        [          0                0         0   0 ]

are equations (26) to (32) of Levy and Klein, with the rates of n where they print the gyro's output, and with D, which
gives velocity and misalignment Schuler's period. Errors of the position, in m, are three more:

    D dp = dv + T dp        D dv = ... + A dp        D phi = ... + B dp

``T`` holds the metres of a degree as they change, ``A`` the gradient of gravity and the Coriolis acceleration, ``B``
the rate of n. Derivation: docs/equations/error_model.md.
"""

from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.core.states import MORE_STATES, STATES
from insdvl_replay.nav.algebra import (
    Matrix,
    Vector,
    add,
    cross,
    nearest_turn,
    rotate,
    scale,
    scale_matrix,
    subtract,
    transpose,
)
from insdvl_replay.nav.earth_model import LocalEarth, curvatures, transport_rate_n
from insdvl_replay.nav.strapdown import Motion, NavState

TWELVE: Final = len(STATES)
"""Number of states that every filter has."""


class StateLayout(NamedTuple):
    """The first row of each block of `states.MORE_STATES`, -1 where a filter does without.

    The blocks behind the position are constants of the sensors. They do not grow, and updates add what they find, as
    with biases. The first of them has the row ``constants``. The bias of the heading is one of them, but fades.
    """

    constants: int
    position: int
    dvl_scale: int
    dvl_yaw: int
    depth_zero: int
    heading_bias: int


def layout_of(more: Collection[str]) -> StateLayout:
    """Lay some blocks behind the twelve states, in the order of `states.MORE_STATES`."""
    first = {}
    row = TWELVE
    for name, block in MORE_STATES.items():
        first[name] = -1
        if name in more:
            first[name] = row
            row += len(block)
    return StateLayout(
        TWELVE + (len(MORE_STATES["position"]) if "position" in more else 0), **first
    )


TWELVE_ALONE: Final = layout_of(())


def noise_density(
    accel_white_mps_rts: float,
    gyro_white_rad_rts: float,
    accel_bias_walk_mps2_rts: float,
    gyro_bias_walk_radps_rts: float,
) -> Floats:
    """Return the diagonal of the process noise's spectral density, diag(N_a^2, N_g^2, K_a^2, K_g^2), shape (12,).

    Parameters
    ----------
    accel_white_mps_rts, gyro_white_rad_rts : float
        White noise of the readings, m/s/sqrt(s) and rad/sqrt(s).
    accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts : float
        Random walk of the biases, m/s^2/sqrt(s) and rad/s/sqrt(s).
    """
    densities = [
        accel_white_mps_rts,
        gyro_white_rad_rts,
        accel_bias_walk_mps2_rts,
        gyro_bias_walk_radps_rts,
    ]
    return np.repeat(np.square(densities), 3)


@inlined
def error_rate(
    motion: Motion,
    velocity_error: Vector,
    misalignment: Vector,
    accel_bias: Vector,
    gyro_bias: Vector,
) -> tuple[Vector, Vector]:
    """Return the rates of the errors of velocity and attitude, the first six rows of ``F dx``."""
    coriolis = cross(velocity_error, add(motion.rate_ie_n, motion.rate_in_n))
    tilted = cross(misalignment, motion.force_n)
    velocity_error_rate = add(add(coriolis, tilted), rotate(motion.mat_nb, accel_bias))
    turned = subtract(
        cross(misalignment, motion.rate_in_n), transport_rate_n(motion.curvature, velocity_error)
    )
    return velocity_error_rate, add(turned, rotate(motion.mat_nb, gyro_bias))


@inlined
def over(motion: Motion, dt: float) -> Motion:
    """Multiply a motion by an interval. F is linear in the motion, so that the result has ``F dt``."""
    return Motion(
        scale(dt, motion.rate_ie_n),
        scale(dt, motion.rate_in_n),
        scale(dt, motion.force_n),
        scale_matrix(dt, motion.mat_nb),
        scale(dt, motion.curvature),
    )


@inlined
def _grown(
    P: Floats,
    first: int,
    stride: int,
    step: Motion,
) -> tuple[Vector, Vector]:
    """Return ``dx + F dt dx`` of velocity and attitude, for a column of P, whose entries are n apart, or for a row."""
    velocity_error = (P[first], P[first + stride], P[first + 2 * stride])
    misalignment = (P[first + 3 * stride], P[first + 4 * stride], P[first + 5 * stride])
    accel_bias = (P[first + 6 * stride], P[first + 7 * stride], P[first + 8 * stride])
    gyro_bias = (P[first + 9 * stride], P[first + 10 * stride], P[first + 11 * stride])
    velocity_growth, misalignment_growth = error_rate(
        step, velocity_error, misalignment, accel_bias, gyro_bias
    )
    return add(velocity_error, velocity_growth), add(misalignment, misalignment_growth)


@inlined
def propagate_errors(dx: Floats, each_state: tuple[float, ...], step: Motion) -> None:
    """Let errors grow over a step, ``dx <- Phi dx`` with ``Phi = I + F dt``, in place.

    Parameters
    ----------
    dx : ndarray, shape (n * n,)
        Row by row; each column is n states. The compiler knows the place of each entry of an array of one dimension,
        and lets several columns grow at once.
    each_state : tuple of n float
        Any; its type tells the compiler n, and with it the length of every loop.
    step : Motion
        From `over`.
    """
    n = len(each_state)
    for column in range(n):
        velocity_error, misalignment = _grown(dx, column, n, step)
        dx[column], dx[n + column], dx[2 * n + column] = velocity_error
        dx[3 * n + column], dx[4 * n + column], dx[5 * n + column] = misalignment


@inlined
def propagate_cov(
    P: Floats,
    motion: Motion,
    noise_density: tuple[float, ...],
    dt: float,
) -> None:
    """Advance the covariance: ``P <- Phi P Phi' + Q`` with ``Phi = I + F dt``, in place.

    The columns of P grow as errors do, then the rows of ``Phi P``. Biases do not grow, so that the second step changes
    only the upper left block. Symmetry gives the lower half. P stays symmetric to the last bit.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance, row by row.
    noise_density : tuple of n float
        Diagonal of the spectral density. Sensor noise is equal on all axes, so that rotating it by C changes nothing.
    """
    n, step = len(noise_density), over(motion, dt)
    propagate_errors(P, noise_density, step)
    for row in range(0, 3 * n, n):
        velocity_error, misalignment = _grown(P, row, 1, step)
        P[row], P[row + 1], P[row + 2] = velocity_error
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for row in range(3 * n, 6 * n, n):
        _, misalignment = _grown(P, row, 1, step)
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for i in range(6):
        for j in range(i):
            P[n * i + j] = P[n * j + i]
        for j in range(6, n):
            P[n * j + i] = P[n * i + j]
    for i in range(n):
        P[(n + 1) * i] += noise_density[i] * dt


@inlined
def add_noise(
    P: Floats,
    n: int,
    noise_density: Floats,
    dt: float,
) -> None:
    """Add white noise of a density, shape (12,), over an interval to the twelve states of P, shape (n * n,)."""
    for i in range(TWELVE):
        P[(n + 1) * i] += noise_density[i] * dt


class NoiseSteps(NamedTuple):
    """White noise of the readings beside that of the settings, constant from each of f times to the next."""

    # (f,), increasing, from the start of the filter; before the first there is none
    time_s: Floats
    density_b: Floats  # (f, 6), of accelerometers and gyros along the axes of b


@inlined
def add_noise_of_axes(
    P: Floats,
    n: int,
    mat_nb: Matrix,
    density_b: Floats,
    dt: float,
) -> None:
    """Add white noise of the readings, of a density of its own on each axis, shape (6,), to P, shape (n * n,)."""
    for first in range(0, 6, 3):
        for i in range(3):
            for j in range(3):
                density = 0.0
                for axis in range(3):
                    density += mat_nb[i][axis] * mat_nb[j][axis] * density_b[first + axis]
                P[n * (first + i) + first + j] += density * dt


@inlined
def fade(P: Floats, row: int, kept: float) -> None:
    """Let a Gauss-Markov state keep a share of its value: scale its row and column of P, shape (n, n)."""
    for i in range(P.shape[0]):
        P[row, i] *= kept
        P[i, row] *= kept


class PositionGrowth(NamedTuple):
    """The blocks of F for the position over an interval: ``T dt``, ``A dt`` and ``B dt``."""

    within: Matrix
    to_velocity: Matrix
    to_misalignment: Matrix
    dt: float  # s


@inlined
def position_growth(
    state: NavState,
    motion: Motion,
    earth: LocalEarth,
    dt: float,
) -> PositionGrowth:
    """Return the blocks of F for the position, of the state and the motion at the end of an interval."""
    north, east, down = state.velocity_n
    to_north, to_east = curvatures(earth, state.position[2])
    tangent = earth.tan_latitude
    within = (
        (-down * to_north, 0.0, north * to_north),
        (east * tangent * to_north, -down * to_east - north * tangent * to_north, east * to_east),
        (0.0, 0.0, 0.0),
    )
    rate_ie_n, rate_en_n = motion.rate_ie_n, subtract(motion.rate_in_n, motion.rate_ie_n)
    earth_by_north = (rate_ie_n[2] * to_north, 0.0, -rate_ie_n[0] * to_north)
    transport_by_north = (0.0, 0.0, -east * to_east * (1.0 + tangent * tangent) * to_north)
    transport_by_down = (rate_en_n[0] * to_east, rate_en_n[1] * to_north, rate_en_n[2] * to_east)
    coriolis_by_north = cross(
        state.velocity_n, add(scale(2.0, earth_by_north), transport_by_north)
    )
    coriolis_by_down = cross(state.velocity_n, transport_by_down)
    zero = (0.0, 0.0, 0.0)
    gravity_by_down = (0.0, 0.0, -earth.gravity_gradient)
    to_velocity = transpose((coriolis_by_north, zero, add(coriolis_by_down, gravity_by_down)))
    turned_by_north, turned_by_down = add(earth_by_north, transport_by_north), transport_by_down
    to_misalignment = transpose((scale(-1.0, turned_by_north), zero, scale(-1.0, turned_by_down)))
    return PositionGrowth(
        scale_matrix(dt, within),
        scale_matrix(dt, to_velocity),
        scale_matrix(dt, to_misalignment),
        dt,
    )


@inlined
def propagate_position_cov(
    P: Floats,
    each_state: tuple[float, ...],
    first: int,
    growth: PositionGrowth,
) -> None:
    """Let the position's errors grow over an interval, and those of velocity and attitude by them, in place.

    Call it before `propagate_cov`: each uses the other's errors at the start of the interval.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance, row by row.
    each_state : tuple of n float
        As in `propagate_errors`.
    first : int
        Row of the position's first state.
    """
    n = len(each_state)
    for column in range(n):
        _grow_position(P, column, n, first, growth)
    for row in range(n):
        _grow_position(P, n * row, 1, first, growth)
    for i in range(n):
        for j in range(i):
            P[n * i + j] = P[n * j + i] = 0.5 * (P[n * i + j] + P[n * j + i])


@inlined
def _grow_position(
    P: Floats,
    start: int,
    stride: int,
    first: int,
    growth: PositionGrowth,
) -> None:
    """Let one column of P grow, whose entries are n apart, or one row."""
    at, turn = start + first * stride, start + 3 * stride
    position_error = (P[at], P[at + stride], P[at + 2 * stride])
    velocity_error = (P[start], P[start + stride], P[start + 2 * stride])
    misalignment = (P[turn], P[turn + stride], P[turn + 2 * stride])
    moved = add(scale(growth.dt, velocity_error), rotate(growth.within, position_error))
    P[at], P[at + stride], P[at + 2 * stride] = add(position_error, moved)
    velocity_error = add(velocity_error, rotate(growth.to_velocity, position_error))
    P[start], P[start + stride], P[start + 2 * stride] = velocity_error
    misalignment = add(misalignment, rotate(growth.to_misalignment, position_error))
    P[turn], P[turn + stride], P[turn + 2 * stride] = misalignment


@inlined
def offset_n(position: Vector, from_position: Vector, earth: LocalEarth) -> Vector:
    """Return the offset of one position from another in n, m, the short way round."""
    to_north, to_east = curvatures(earth, position[2])
    return (
        (position[0] - from_position[0]) / to_north,
        nearest_turn(position[1] - from_position[1]) * earth.cos_latitude / to_east,
        from_position[2] - position[2],
    )


@inlined
def without_error(position: Vector, error_n: Vector, earth: LocalEarth) -> Vector:
    """Take an error in n, m, off a position."""
    to_north, to_east = curvatures(earth, position[2])
    return (
        position[0] - error_n[0] * to_north,
        position[1] - error_n[1] * to_east / earth.cos_latitude,
        position[2] + error_n[2],
    )
