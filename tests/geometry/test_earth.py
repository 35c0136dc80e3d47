"""The Earth against published values."""

import numpy as np
import pytest

from insdvl_replay.geometry.earth import meridian_radius_m, normal_gravity, transverse_radius_m


@pytest.mark.parametrize(
    ("latitude_deg", "gravity"),
    [
        (0.0, 9.7803253359),
        (45.0, 9.806197769),
        (90.0, 9.8321849379),
    ],  # NIMA TR8350.2, tables 3.3 and 3.4; 45 deg by Somigliana
)
def test_normal_gravity_on_the_ellipsoid(latitude_deg: float, gravity: float) -> None:
    assert normal_gravity(np.deg2rad(latitude_deg), 0.0) == pytest.approx(gravity, abs=2e-9)


def test_gravity_grows_with_depth_by_the_free_air_gradient() -> None:
    per_metre = normal_gravity(np.deg2rad(45.0), -1.0) - normal_gravity(np.deg2rad(45.0), 0.0)
    assert per_metre == pytest.approx(3.0849e-6, abs=2e-9)


def test_radii_of_curvature() -> None:
    assert transverse_radius_m(0.0) == pytest.approx(6378137.0)
    assert meridian_radius_m(0.0) == pytest.approx(6335439.327, abs=1e-3)
    polar = 6399593.6258  # NIMA TR8350.2, radius of curvature at the pole
    assert transverse_radius_m(np.pi / 2) == pytest.approx(polar, abs=1e-3)
    assert meridian_radius_m(np.pi / 2) == pytest.approx(polar, abs=1e-3)


def test_arrays_and_numbers_give_the_same() -> None:
    latitude = np.deg2rad([10.0, 60.0])
    np.testing.assert_array_equal(normal_gravity(latitude, -30.0), [normal_gravity(lat, -30.0) for lat in latitude])
