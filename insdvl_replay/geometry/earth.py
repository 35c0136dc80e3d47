"""The WGS-84 Earth: rotation, gravity, radii of curvature.

All functions take numbers and arrays; `nav.earth_model` compiles the same text for the filter's loop. Functions with
``_of`` take sines and cosines of the latitude, which the simulation computes in its own way.
Source: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", third edition, chapters 3 and 4.
"""

from typing import Any, Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats

EARTH_RATE: Final = 7.292115e-5  # rotation rate of the Earth, rad/s
SEMI_MAJOR_M: Final = 6378137.0  # of the ellipsoid
ECCENTRICITY_2: Final = 6.69437999014e-3  # first eccentricity squared
GRAVITY_EQUATOR: Final = 9.7803253359  # m/s^2
SOMIGLIANA_K: Final = 1.931852652458e-3
FLATTENING: Final = 1.0 / 298.257223563
# centrifugal acceleration to gravity at the equator, m = w^2 a^2 b / GM
GRAVITY_RATIO: Final = 3.449786506841e-3


def earth_rate_n(latitude: float | Floats) -> Floats:
    """Return the rotation rate of the Earth in north-east-down, w_ie, rad/s, shape (..., 3); latitude in rad."""
    return np.stack(
        np.broadcast_arrays(*earth_rate_of(np.sin(latitude), np.cos(latitude))), axis=-1
    )


def earth_rate_of(sine: Any, cosine: Any) -> tuple[Any, float, Any]:
    """Return north, east and down of `earth_rate_n` where the latitude has this sine and cosine."""
    return EARTH_RATE * cosine, 0.0, -EARTH_RATE * sine


def normal_gravity(latitude: Any, height_m: Any) -> Any:
    """Return normal gravity, Somigliana's formula with the second-order height term, m/s^2.

    The latitude is in rad; the height is above the ellipsoid, negative for a dive.
    """
    return gravity_of(np.sin(latitude) ** 2, height_m)


def gravity_of(sin2: Any, height_m: Any) -> Any:
    """Return `normal_gravity` where the sine of the latitude has this square."""
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA_K * sin2) / np.sqrt(1.0 - ECCENTRICITY_2 * sin2)
    linear = 2.0 / SEMI_MAJOR_M * (1.0 + FLATTENING + GRAVITY_RATIO - 2.0 * FLATTENING * sin2)
    return surface * (1.0 - linear * height_m + 3.0 * height_m**2 / SEMI_MAJOR_M**2)


def meridian_radius_m(latitude: Any) -> Any:
    """Return the radius of curvature north-south, R_N; latitude in rad."""
    return meridian_radius_of(np.sin(latitude) ** 2)


def meridian_radius_of(sin2: Any) -> Any:
    """Return `meridian_radius_m` where the sine of the latitude has this square."""
    root = np.sqrt(1.0 - ECCENTRICITY_2 * sin2)
    return SEMI_MAJOR_M * (1.0 - ECCENTRICITY_2) / (root * root * root)


def transverse_radius_m(latitude: Any) -> Any:
    """Return the radius of curvature east-west, R_E; latitude in rad."""
    return transverse_radius_of(np.sin(latitude) ** 2)


def transverse_radius_of(sin2: Any) -> Any:
    """Return `transverse_radius_m` where the sine of the latitude has this square."""
    return SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * sin2)
