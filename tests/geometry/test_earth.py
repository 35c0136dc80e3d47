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


def test_gravity_far_below_and_above_the_pole_is_that_of_the_ellipsoids_field() -> None:
    """Heiskanen and Moritz, "Physical geodesy", 2-6: on the axis the field of a level ellipsoid is known."""
    axis_m, pole_m, gm, turn = 6378137.0, 6356752.314245, 3.986004418e14, 7.292115e-5
    focus_m = np.sqrt(axis_m**2 - pole_m**2)

    x = focus_m / pole_m
    q = 0.5 * ((1.0 + 3.0 / x**2) * np.arctan(x) - 3.0 / x)
    for height_m in (-3000.0, 3000.0):
        u_m = pole_m + height_m
        step_m = 10.0
        ends = [0.5 * ((1.0 + 3.0 * u**2 / focus_m**2) * np.arctan(focus_m / u) - 3.0 * u / focus_m)
                for u in (u_m - step_m, u_m + step_m)]  # fmt: skip
        by_turning = turn**2 * axis_m**2 / 3.0 * (ends[1] - ends[0]) / (2.0 * step_m) / q
        exact = gm / (u_m**2 + focus_m**2) - by_turning
        assert normal_gravity(np.pi / 2.0, height_m) == pytest.approx(exact, rel=1e-7)


def test_radii_of_curvature() -> None:
    assert transverse_radius_m(0.0) == pytest.approx(6378137.0)
    assert meridian_radius_m(0.0) == pytest.approx(6335439.327, abs=1e-3)
    polar = 6399593.6258  # NIMA TR8350.2, radius of curvature at the pole
    assert transverse_radius_m(np.pi / 2) == pytest.approx(polar, abs=1e-3)
    assert meridian_radius_m(np.pi / 2) == pytest.approx(polar, abs=1e-3)


def test_arrays_and_numbers_give_the_same() -> None:
    latitude = np.deg2rad([10.0, 60.0])
    np.testing.assert_array_equal(
        normal_gravity(latitude, -30.0), [normal_gravity(lat, -30.0) for lat in latitude]
    )
