"""The Earth at the vehicle, for the mechanisation: rotation, curvature and gravity.

These change slowly. They are computed again after `REACH_RAD` of latitude, 0.6 m on the way north or south, or after
`REACH_M` of height. Until then they are off by at most 7e-9 m/s^2 (gravity), 8e-12 rad/s (Earth rate), 1.1e-9 of the
radii, and (tan L + 1 / tan L) 1e-7 of the rate of the longitude and of the rotation of n about down.
"""

import math
from typing import Final, NamedTuple

from insdvl_replay.core.runtime import inlined
from insdvl_replay.geometry import earth as wgs84
from insdvl_replay.nav.algebra import Vector

REACH_RAD: Final = 1e-7
REACH_M: Final = 30.0

for _formula in (
    wgs84.earth_rate_of,
    wgs84.gravity_of,
    wgs84.meridian_radius_of,
    wgs84.transverse_radius_of,
):
    inlined(_formula)
normal_gravity = inlined(wgs84.normal_gravity)
_meridian_radius_m = inlined(wgs84.meridian_radius_m)
_transverse_radius_m = inlined(wgs84.transverse_radius_m)


class LocalEarth(NamedTuple):
    """The Earth at a latitude, and its gravity near a height."""

    latitude: float  # rad
    height_m: float  # above the ellipsoid
    cos_latitude: float
    tan_latitude: float
    rate_ie_n: Vector  # the Earth's rotation w_ie in n, rad/s
    meridian_radius_m: float  # R_N at height 0
    transverse_radius_m: float  # R_E at height 0
    gravity: float  # at the height, m/s^2
    gravity_gradient: float  # by height, 1/s^2


NOWHERE: Final = LocalEarth(
    math.nan, math.nan, 1.0, 0.0, (0.0, 0.0, 0.0), math.nan, math.nan, math.nan, math.nan
)
"""What `local_earth_near` replaces wherever the vehicle is."""


@inlined
def local_earth_at(latitude: float, height_m: float) -> LocalEarth:
    """Compute the Earth at a latitude and height."""
    gravity = normal_gravity(latitude, height_m)
    return LocalEarth(
        latitude,
        height_m,
        math.cos(latitude),
        math.tan(latitude),
        wgs84.earth_rate_of(math.sin(latitude), math.cos(latitude)),
        _meridian_radius_m(latitude),
        _transverse_radius_m(latitude),
        gravity,
        (normal_gravity(latitude, height_m + REACH_M) - gravity) / REACH_M,
    )


@inlined
def local_earth_near(position: Vector, earth: LocalEarth) -> LocalEarth:
    """Return the last Earth as long as it is near enough, else a new one."""
    latitude, height_m = position[0], position[2]
    if abs(latitude - earth.latitude) <= REACH_RAD and abs(height_m - earth.height_m) <= REACH_M:
        return earth
    return local_earth_at(latitude, height_m)


@inlined
def gravity_at(earth: LocalEarth, height_m: float) -> float:
    """Return normal gravity at a height, m/s^2."""
    return earth.gravity + (height_m - earth.height_m) * earth.gravity_gradient


@inlined
def curvatures(earth: LocalEarth, height_m: float) -> tuple[float, float]:
    """Return the curvatures north-south and east-west, 1 / (R_N + h) and 1 / (R_E + h), 1/m."""
    return 1.0 / (earth.meridian_radius_m + height_m), 1.0 / (earth.transverse_radius_m + height_m)


@inlined
def transport_curvature(earth: LocalEarth, height_m: float) -> Vector:
    """Return the rotation of n for a velocity of 1 m/s, see `transport_rate_n`."""
    to_north, to_east = curvatures(earth, height_m)
    return to_east, to_north, to_east * earth.tan_latitude


@inlined
def transport_rate_n(curvature: Vector, velocity_n: Vector) -> Vector:
    """Return w_en, the rate at which n turns because the vehicle moves over the curved Earth."""
    return (
        velocity_n[1] * curvature[0],
        -velocity_n[0] * curvature[1],
        -velocity_n[1] * curvature[2],
    )


HOLD_AFTER_S: Final = 300.0
"""Without a velocity for so long, an acceleration error a has moved the height by a T^2 / 2, and gravity there by 14 %
of a; after 600 s it is 55 %."""


class GravityHeight(NamedTuple):
    """The height at which gravity is taken: the INS's own while velocities hold it, then the last of those.

    Gravity falls by 3.1e-6 m/s^2 a metre. An unaided INS that takes it at its own height drives that height away,
    e-fold in 570 s. When velocities return, the wrong gravity looks like an accelerometer bias. Twelve states have no
    height for that uncertainty. A vehicle stays near its depth.
    """

    height_m: float
    drift_m: float  # how far the INS's height has moved while this one was held
    aided_s: float  # time of the last velocity that was used, seconds from the start


@inlined
def followed(gravity: GravityHeight, height_m: float, time_s: float) -> GravityHeight:
    """Let the height of gravity follow that of the INS, or hold it."""
    if time_s - gravity.aided_s <= HOLD_AFTER_S:
        return GravityHeight(height_m - gravity.drift_m, gravity.drift_m, gravity.aided_s)
    return GravityHeight(gravity.height_m, height_m - gravity.height_m, gravity.aided_s)
