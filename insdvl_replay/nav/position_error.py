"""Errors of the position as three more states, m: how they grow out of the others, and what they do to them.

    D dp = dv + T dp        D dv = ... + A dp        D phi = ... + B dp

A position that is off is one where the Earth turns n in another direction, curves otherwise and pulls otherwise. ``T``
holds the metres of a degree as they change, ``A`` the gradient of gravity and the Coriolis acceleration, ``B`` the rate
of n. That velocity and misalignment swing with Schuler's period does not take a position: it stands in the twelve
states, see `error_model`. Derivation: equations/error_model.md.
"""

from typing import NamedTuple

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined
from insdvl_replay.nav.local_earth import Place, curvatures
from insdvl_replay.nav.strapdown import Motion, NavState
from insdvl_replay.nav.vector_algebra import (
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
