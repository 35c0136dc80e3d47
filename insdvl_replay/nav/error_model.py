"""Where the states that a filter has beside the twelve stand in its error state.

The error model: how errors of the mechanisation grow. These are the twelve states; `position_error` has three more.

F = [ -[(2 w_ie + w_en) x]   -[f_n x]     C   0 ]        D dv = w_en of the velocity dv
    [         -D            -[w_in x]     0   C ]
    [          0                0         0   0 ]
    [          0                0         0   0 ]

Equations (26) to (32) of Levy and Klein, with the rates of n where they print the gyro's output, and with D, which lets
velocity and misalignment swing with Schuler's period; see equations/error_model.md.

Errors of the position as three more states, m: how they grow out of the others, and what they do to them.

    D dp = dv + T dp        D dv = ... + A dp        D phi = ... + B dp

A position that is off is one where the Earth turns n in another direction, curves otherwise and pulls otherwise. ``T``
holds the metres of a degree as they change, ``A`` the gradient of gravity and the Coriolis acceleration, ``B`` the rate
of n. That velocity and misalignment swing with Schuler's period does not take a position: it stands in the twelve
states, see `error_model`. Derivation: equations/error_model.md.
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
from insdvl_replay.nav.earth_model import Place, curvatures, transport_rate_n
from insdvl_replay.nav.strapdown import Motion, NavState

ABSENT: Final = -1
"""In place of a row, of a state that a filter does not have."""


TWELVE: Final = len(STATES)
"""Rows of the states that every filter has."""


class StateLayout(NamedTuple):
    """The first row of each block of `states.MORE_STATES`, `ABSENT` where a filter does without.

    Those behind the position are constants of the sensors: nothing lets them grow, and what is found of them is added
    to what they are taken to be, as with biases. The first of them has the row ``constants``, or would have it. The
    bias of the heading is among them, but fades.
    """

    constants: int
    position: int
    dvl_scale: int
    dvl_yaw: int
    depth_zero: int
    heading_bias: int


def layout_of(more: Collection[str]) -> StateLayout:
    """Lay some blocks behind the twelve states, in the order of `states.MORE_STATES`."""
    first, row = {}, TWELVE
    for name, block in MORE_STATES.items():
        first[name] = row if name in more else ABSENT
        row += len(block) if name in more else 0
    return StateLayout(TWELVE + (len(MORE_STATES["position"]) if "position" in more else 0), **first)


TWELVE_ALONE: Final = layout_of(())
"""Of a filter that has no more."""


EACH_OF_TWELVE: Final = (0.0,) * TWELVE
"""A number for each of the twelve states."""


@inlined
def error_rate(
    motion: Motion, velocity_error: Vector, misalignment: Vector, accel_bias: Vector, gyro_bias: Vector
) -> tuple[Vector, Vector]:
    """Return how fast the errors of velocity and attitude grow, the first six rows of ``F dx``; biases stay."""
    coriolis = cross(velocity_error, add(motion.rate_ie_n, motion.rate_in_n))
    tilted = cross(misalignment, motion.force_n)
    velocity_error_rate = add(add(coriolis, tilted), rotate(motion.mat_nb, accel_bias))
    turned = subtract(cross(misalignment, motion.rate_in_n), transport_rate_n(motion.curvature, velocity_error))
    return velocity_error_rate, add(turned, rotate(motion.mat_nb, gyro_bias))


@inlined
def propagate_errors(dx: Floats, motion: Motion, dt: float) -> None:
    """Let errors of the twelve states grow over an interval: ``dx <- Phi dx`` with ``Phi = I + F dt``, in place.

    Parameters
    ----------
    dx : ndarray, shape (144,)
        Twelve errors, each a column of twelve states, row by row. Of an array of one dimension the compiler knows where
        each entry stands, and lets several columns grow at once.
    dt : float
        Length of the interval, s.
    """
    _grow_columns(dx, EACH_OF_TWELVE, over(motion, dt))


@inlined
def propagate_cov(P: Floats, motion: Motion, noise_density: tuple[float, ...], dt: float) -> None:
    """Advance the covariance: ``P <- Phi P Phi' + Q`` with ``Phi = I + F dt``, in place.

    In ``Phi P`` the columns of P have grown as errors do, and in ``(Phi P) Phi'`` its rows have grown so, too. States
    from the biases on do not grow: the second step changes no more than the upper left block, and symmetry gives the
    lower half of that. P stays symmetric to the last bit.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance of the n states, row by row, advanced.
    noise_density : tuple of n float
        Diagonal of the noise's spectral density; sensor noise is alike on all axes, so turning it with C changes
        nothing. The compiler knows its length, and with it that of every loop.
    dt : float
        Length of the interval, s.
    """
    n, step = len(noise_density), over(motion, dt)
    _grow_columns(P, noise_density, step)
    for row in range(0, 3 * n, n):
        velocity_error, misalignment = grown(step, entries(P, row, 1))
        P[row], P[row + 1], P[row + 2] = velocity_error
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for row in range(3 * n, 6 * n, n):
        _, misalignment = grown(step, entries(P, row, 1))
        P[row + 3], P[row + 4], P[row + 5] = misalignment
    for i in range(6):
        for j in range(i):
            P[n * i + j] = P[n * j + i]
        for j in range(6, n):
            P[n * j + i] = P[n * i + j]
    for i in range(n):
        P[(n + 1) * i] += noise_density[i] * dt


@inlined
def fade(P: Floats, row: int, kept: float) -> None:
    """Let a state that is a Gauss-Markov process forget its value but for a share, in its row and column of P."""
    for i in range(P.shape[0]):
        P[row, i] *= kept
        P[i, row] *= kept


@inlined
def over(motion: Motion, dt: float) -> Motion:
    """Return what a motion comes to in an interval; since F is linear in it, the F of that is ``F dt``."""
    return Motion(
        scale(dt, motion.rate_ie_n),
        scale(dt, motion.rate_in_n),
        scale(dt, motion.force_n),
        scale_matrix(dt, motion.mat_nb),
        scale(dt, motion.curvature),
    )


@inlined
def _grow_columns(dx: Floats, each_state: tuple[float, ...], step: Motion) -> None:
    n = len(each_state)  # a number for the compiler, which as an argument it would not be
    for column in range(n):
        velocity_error, misalignment = grown(step, entries(dx, column, n))
        dx[column], dx[n + column], dx[2 * n + column] = velocity_error
        dx[3 * n + column], dx[4 * n + column], dx[5 * n + column] = misalignment


@inlined
def entries(P: Floats, first: int, apart: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Read the twelve states of a column of P, whose entries stand n apart, or of a row, which stand side by side."""
    return (
        (P[first], P[first + apart], P[first + 2 * apart]),
        (P[first + 3 * apart], P[first + 4 * apart], P[first + 5 * apart]),
        (P[first + 6 * apart], P[first + 7 * apart], P[first + 8 * apart]),
        (P[first + 9 * apart], P[first + 10 * apart], P[first + 11 * apart]),
    )


@inlined
def grown(step: Motion, dx: tuple[Vector, Vector, Vector, Vector]) -> tuple[Vector, Vector]:
    """Return the errors of velocity and attitude after an interval, ``dx + F dt dx``."""
    velocity_error_growth, misalignment_growth = error_rate(step, dx[0], dx[1], dx[2], dx[3])
    return add(dx[0], velocity_error_growth), add(dx[1], misalignment_growth)


@inlined
def add_noise(P: Floats, n: int, noise_density: Floats, dt: float) -> None:
    """Add what white noise leaves behind in the twelve states after an interval, ``P <- P + Q``, in place.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance, row by row.
    noise_density : ndarray, shape (12,)
        Diagonal of the spectral density.
    dt : float
        Length of the interval, s.
    """
    for i in range(TWELVE):
        P[(n + 1) * i] += noise_density[i] * dt


def noise_density(
    accel_white_mps_rts: float,
    gyro_white_rad_rts: float,
    accel_bias_walk_mps2_rts: float,
    gyro_bias_walk_radps_rts: float,
) -> Floats:
    """Return the diagonal of the process noise's spectral density, diag(N_a^2, N_g^2, K_a^2, K_g^2).

    Parameters
    ----------
    accel_white_mps_rts, gyro_white_rad_rts : float
        White noise of the readings, m/s/sqrt(s) and rad/sqrt(s).
    accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts : float
        Random walk of the biases, m/s^2/sqrt(s) and rad/s/sqrt(s).

    Returns
    -------
    ndarray, shape (12,)
    """
    densities = [accel_white_mps_rts, gyro_white_rad_rts, accel_bias_walk_mps2_rts, gyro_bias_walk_radps_rts]
    return np.repeat(np.square(densities), 3)


class PositionGrowth(NamedTuple):
    """The blocks of F that have to do with the position, over an interval of ``dt``, s.

    Attributes
    ----------
    within, to_velocity, to_misalignment : tuple of 3 rows
        ``T dt``, ``A dt`` and ``B dt``.
    """

    within: Matrix
    to_velocity: Matrix
    to_misalignment: Matrix
    dt: float


@inlined
def position_growth(state: NavState, motion: Motion, place: Place, dt: float) -> PositionGrowth:
    """Return what F says of the position over an interval, of which the state and the motion are those at its end."""
    north, east, down = state.velocity_n
    to_north, to_east = curvatures(place, state.position[2])
    tangent = place.tan_latitude
    within = (
        (-down * to_north, 0.0, north * to_north),
        (east * tangent * to_north, -down * to_east - north * tangent * to_north, east * to_east),
        (0.0, 0.0, 0.0),
    )
    rate_ie_n, rate_en_n = motion.rate_ie_n, subtract(motion.rate_in_n, motion.rate_ie_n)
    earth_by_north = (rate_ie_n[2] * to_north, 0.0, -rate_ie_n[0] * to_north)
    transport_by_north = (0.0, 0.0, -east * to_east * (1.0 + tangent * tangent) * to_north)
    transport_by_down = (rate_en_n[0] * to_east, rate_en_n[1] * to_north, rate_en_n[2] * to_east)
    coriolis_by_north = cross(state.velocity_n, add(scale(2.0, earth_by_north), transport_by_north))
    coriolis_by_down = cross(state.velocity_n, transport_by_down)
    unmoved = (0.0, 0.0, 0.0)
    gravity_by_down = (0.0, 0.0, -place.gravity_gradient)
    to_velocity = transpose((coriolis_by_north, unmoved, add(coriolis_by_down, gravity_by_down)))
    turned_by_north, turned_by_down = add(earth_by_north, transport_by_north), transport_by_down
    to_misalignment = transpose((scale(-1.0, turned_by_north), unmoved, scale(-1.0, turned_by_down)))
    return PositionGrowth(
        scale_matrix(dt, within), scale_matrix(dt, to_velocity), scale_matrix(dt, to_misalignment), dt
    )


@inlined
def propagate_position_cov(P: Floats, each_state: tuple[float, ...], first: int, growth: PositionGrowth) -> None:
    """Let the position's errors grow over an interval, and those of velocity and attitude by them, in place.

    To be called before the twelve states grow, `error_model.propagate_cov`: each takes the other's errors as they were
    at the start of the interval, but for the position, which moves by the velocity error of the start.

    Parameters
    ----------
    P : ndarray, shape (n * n,)
        Covariance, row by row.
    each_state : tuple of n float
        Any, of whose type the compiler takes n.
    first : int
        Row of the position's first state.
    growth : PositionGrowth
        Of the interval.
    """
    n = len(each_state)
    for column in range(n):
        _grow(P, column, n, first, growth)
    for row in range(n):
        _grow(P, n * row, 1, first, growth)
    for i in range(n):
        for j in range(i):
            P[n * i + j] = P[n * j + i] = 0.5 * (P[n * i + j] + P[n * j + i])


@inlined
def _grow(P: Floats, start: int, apart: int, first: int, growth: PositionGrowth) -> None:
    """Let one column of P grow, whose entries stand n apart, or one row, whose entries stand side by side."""
    at = start + first * apart
    position_error = (P[at], P[at + apart], P[at + 2 * apart])
    velocity_error = (P[start], P[start + apart], P[start + 2 * apart])
    misalignment = (P[start + 3 * apart], P[start + 4 * apart], P[start + 5 * apart])
    moved = add(scale(growth.dt, velocity_error), rotate(growth.within, position_error))
    _write(P, at, apart, add(position_error, moved))
    _write(P, start, apart, add(velocity_error, rotate(growth.to_velocity, position_error)))
    _write(P, start + 3 * apart, apart, add(misalignment, rotate(growth.to_misalignment, position_error)))


@inlined
def _write(P: Floats, at: int, apart: int, values: Vector) -> None:
    P[at], P[at + apart], P[at + 2 * apart] = values


@inlined
def offset_n(position: Vector, from_position: Vector, place: Place) -> Vector:
    """Return how far one position, latitude rad, longitude rad, height m, is from another, in n, m, the short way."""
    to_north, to_east = curvatures(place, position[2])
    return (
        (position[0] - from_position[0]) / to_north,
        nearest_turn(position[1] - from_position[1]) * place.cos_latitude / to_east,
        from_position[2] - position[2],
    )


@inlined
def without_error(position: Vector, error_n: Vector, place: Place) -> Vector:
    """Take an error in n, m, off a position."""
    to_north, to_east = curvatures(place, position[2])
    return (
        position[0] - error_n[0] * to_north,
        position[1] - error_n[1] * to_east / place.cos_latitude,
        position[2] + error_n[2],
    )
