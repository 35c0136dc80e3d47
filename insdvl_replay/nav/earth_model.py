"""What the mechanisation has to know of the Earth where the vehicle is: its rotation, its curvature, its gravity.

All of it changes so slowly that it is computed anew only after `REACH_RAD` of latitude, 0.6 m on the way north or
south, or `REACH_M` of height. Until then these are off by at most 7e-9 m/s^2 (gravity), 8e-12 rad/s (Earth rate),
1.1e-9 of the radii, and (tan L + 1 / tan L) 1e-7 of the rate of the longitude and of the turn of n about down.
"""

import math
from typing import Final, NamedTuple

from insdvl_replay.core.runtime import inlined
from insdvl_replay.geometry import earth
from insdvl_replay.nav.algebra import Vector

REACH_RAD: Final = 1e-7
REACH_M: Final = 30.0

for _formula in (earth.earth_rate_of, earth.gravity_of, earth.meridian_radius_of, earth.transverse_radius_of):
    inlined(_formula)
normal_gravity = inlined(earth.normal_gravity)
_meridian_radius_m = inlined(earth.meridian_radius_m)
_transverse_radius_m = inlined(earth.transverse_radius_m)


class Place(NamedTuple):
    """The Earth at a latitude, and its gravity about a height.

    Attributes
    ----------
    latitude : float
        rad
    height_m : float
        Above the ellipsoid.
    rate_ie_n : tuple of 3 float
        The Earth's rotation rate w_ie in n, rad/s.
    meridian_radius_m, transverse_radius_m : float
        Radii of curvature R_N and R_E, at height 0.
    gravity : float
        At the height, m/s^2.
    gravity_gradient : float
        Its growth with the height, 1/s^2.
    """

    latitude: float
    height_m: float
    cos_latitude: float
    tan_latitude: float
    rate_ie_n: Vector
    meridian_radius_m: float
    transverse_radius_m: float
    gravity: float
    gravity_gradient: float


@inlined
def place_at(latitude: float, height_m: float) -> Place:
    """Compute what there is to know of a place."""
    gravity = normal_gravity(latitude, height_m)
    return Place(
        latitude,
        height_m,
        math.cos(latitude),
        math.tan(latitude),
        earth.earth_rate_of(math.sin(latitude), math.cos(latitude)),
        _meridian_radius_m(latitude),
        _transverse_radius_m(latitude),
        gravity,
        (normal_gravity(latitude, height_m + REACH_M) - gravity) / REACH_M,
    )


@inlined
def place_about(position: Vector, place: Place) -> Place:
    """Return the place where the vehicle is now: the last one, as long as that still stands for it."""
    latitude, height_m = position[0], position[2]
    if abs(latitude - place.latitude) <= REACH_RAD and abs(height_m - place.height_m) <= REACH_M:
        return place
    return place_at(latitude, height_m)


@inlined
def gravity_at(place: Place, height_m: float) -> float:
    """Return normal gravity at a height near a place, m/s^2."""
    return place.gravity + (height_m - place.height_m) * place.gravity_gradient


@inlined
def curvatures(place: Place, height_m: float) -> tuple[float, float]:
    """Return the curvatures north-south and east-west, 1 / (R_N + h) and 1 / (R_E + h), 1/m."""
    return 1.0 / (place.meridian_radius_m + height_m), 1.0 / (place.transverse_radius_m + height_m)


@inlined
def transport_curvature(place: Place, height_m: float) -> Vector:
    """Return what a velocity of 1 m/s turns n by as it moves over the curved Earth, see `transport_rate_n`."""
    to_north, to_east = curvatures(place, height_m)
    return to_east, to_north, to_east * place.tan_latitude


@inlined
def transport_rate_n(curvature: Vector, velocity_n: Vector) -> Vector:
    """Return the rate w_en at which n turns because the vehicle moves over the curved Earth."""
    return velocity_n[1] * curvature[0], -velocity_n[0] * curvature[1], -velocity_n[1] * curvature[2]


HOLD_AFTER_S: Final = 300.0
"""Without a velocity for so long, an acceleration error a has moved the height by a T^2 / 2, and gravity there by 14 %
of a; after 600 s it is 55 %."""


class GravityHeight(NamedTuple):
    """Where gravity is taken: at the INS's own height as long as velocities hold it, then at the last of those.

    Gravity falls by 3.1e-6 m/s^2 a metre. An unaided INS that takes it at its own height drives that height away,
    e-fold in 570 s, and leaves a wrong gravity behind when velocities return, which the filter takes for an
    accelerometer bias. Twelve states have no height in which that uncertainty could stand. A vehicle stays near its
    depth.

    Attributes
    ----------
    drift_m : float
        What the INS's height has moved by while this one was held: how much higher it is.
    aided_s : float
        When a velocity was used last, seconds from the start.
    """

    height_m: float
    drift_m: float
    aided_s: float


@inlined
def followed(gravity: GravityHeight, height_m: float, time_s: float) -> GravityHeight:
    """Let the height of gravity follow that of the INS, or hold it."""
    if time_s - gravity.aided_s <= HOLD_AFTER_S:
        return GravityHeight(height_m - gravity.drift_m, gravity.drift_m, gravity.aided_s)
    return GravityHeight(gravity.height_m, height_m - gravity.height_m, gravity.aided_s)
