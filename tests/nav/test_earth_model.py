"""What is kept of the Earth for a while, against what it is where the vehicle has got to."""

import numpy as np
import pytest

from insdvl_replay.geometry.earth import (
    EARTH_RATE,
    meridian_radius_m,
    normal_gravity,
    transverse_radius_m,
)
from insdvl_replay.nav.earth_model import (
    REACH_M,
    REACH_RAD,
    curvatures,
    gravity_at,
    local_earth_at,
    local_earth_near,
    transport_curvature,
    transport_rate_n,
)

LATITUDES = np.deg2rad([-75.0, -1.0, 0.0, 32.8, 45.0, 75.0])
EDGES = [(REACH_RAD, REACH_M), (-REACH_RAD, REACH_M), (REACH_RAD, -REACH_M)]


@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize(("to_north", "up_m"), EDGES)
def test_at_the_edge_of_its_reach_a_place_is_off_by_no_more_than_it_says(
    latitude: float, to_north: float, up_m: float
) -> None:
    there, height_m = latitude + 0.999 * to_north, -20.0 + 0.999 * up_m
    kept = local_earth_at(latitude, -20.0)
    assert local_earth_near((there, 0.0, height_m), kept) == kept
    assert gravity_at(kept, height_m) == pytest.approx(normal_gravity(there, height_m), abs=7e-9)
    earth_rate = EARTH_RATE * np.array([np.cos(there), 0.0, -np.sin(there)])
    np.testing.assert_allclose(kept.rate_ie_n, earth_rate, rtol=0.0, atol=8e-12)
    radii = 1.0 / np.array(curvatures(kept, height_m))
    exact = np.array([meridian_radius_m(there), transverse_radius_m(there)]) + height_m
    np.testing.assert_allclose(radii, exact, rtol=1.1e-9)
    assert kept.cos_latitude == pytest.approx(
        np.cos(there), rel=1e-7 * abs(np.tan(latitude)) + 1e-14
    )


@pytest.mark.parametrize("latitude", LATITUDES)
def test_turn_of_the_frame_is_that_of_the_place(latitude: float) -> None:
    north, east, down = transport_rate_n(
        transport_curvature(local_earth_at(latitude, -20.0), -20.0), (1.2, -0.7, 0.3)
    )
    east_radius_m = transverse_radius_m(latitude) - 20.0
    assert north == pytest.approx(-0.7 / east_radius_m, rel=1e-14)
    assert east == pytest.approx(-1.2 / (meridian_radius_m(latitude) - 20.0), rel=1e-14)
    assert down == pytest.approx(0.7 * np.tan(latitude) / east_radius_m, rel=1e-13)


@pytest.mark.parametrize(("to_north", "up_m"), [(1.001 * REACH_RAD, 0.0), (0.0, -1.001 * REACH_M)])
def test_reach_ends_where_it_says(to_north: float, up_m: float) -> None:
    there, height_m = 0.57 + to_north, -20.0 + up_m
    assert local_earth_near((there, 0.0, height_m), local_earth_at(0.57, -20.0)) == local_earth_at(
        there, height_m
    )
