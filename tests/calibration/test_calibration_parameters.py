"""Another geometry, put into a prepared dive, is what reading the log with it would have given."""

import msgspec
import numpy as np
import pytest
from built_in import CONFIG, as_read

from insdvl_replay.calibration.innovations import (
    ARM,
    DELAY,
    MOUNTING,
    NAMES,
    SCALE,
    SKIPPED,
    Geometry,
    moved_mounting,
    moved_pings,
    with_dvl,
)
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import skew
from insdvl_replay.preparation.filters import dvl_mounting
from insdvl_replay.preparation.run import prepare_with_heading
from insdvl_replay.sim.dive import exact_dive

CHANGE = np.array([0.03, 0.02, -0.01, 0.05, 0.3, -0.1, 0.2, 0.01])
CONFIGURED = Geometry(0.1, (1.0, 2.0, 3.0), (4.0, -5.0, 60.0), 1.02)


@pytest.fixture(scope="module")
def exact() -> Dive:
    return exact_dive("figure-eight", duration_s=120.0, imu_rate_hz=100.0)


def test_moved_pings_are_those_of_a_log_that_is_read_with_the_new_settings(exact: Dive) -> None:
    read = as_read(exact)
    proposed = CONFIGURED.changed(CHANGE)
    before, expected = (
        prepare_with_heading(read.dive, with_dvl(CONFIG, geometry))
        for geometry in (CONFIGURED, proposed)
    )
    moved = moved_pings(before.velocities, CHANGE)
    inside = slice(1, -1)
    np.testing.assert_allclose(
        moved.velocity_b[inside], expected.velocities.velocity_b[inside], atol=1e-13
    )
    np.testing.assert_allclose(
        moved.unit_cov_b[inside], expected.velocities.unit_cov_b[inside], atol=1e-13
    )
    np.testing.assert_array_equal(moved.time_ns, before.velocities.time_ns - 30_000_000)
    mounting, wanted = (
        moved_mounting(before.mounting, CHANGE),
        dvl_mounting(with_dvl(CONFIG, proposed)),
    )
    np.testing.assert_allclose(mounting.mat_bd, wanted.mat_bd, atol=1e-13)
    np.testing.assert_allclose(mounting.lever_arm_b, wanted.lever_arm_b, atol=1e-15)
    assert mounting.scale == pytest.approx(wanted.scale, rel=1e-15)
    assert proposed.latency_s == pytest.approx(0.13)


def test_what_does_not_change_stays_to_the_bit() -> None:
    assert CONFIGURED.changed(np.zeros(len(NAMES))) == CONFIGURED
    one = np.zeros(len(NAMES))
    one[ARM.start] = 0.1
    moved = CONFIGURED.changed(one)
    assert (moved.latency_s, moved.mounting_rpy_deg, moved.scale, moved.lever_arm_m[1:]) == (
        CONFIGURED.latency_s,
        CONFIGURED.mounting_rpy_deg,
        CONFIGURED.scale,
        CONFIGURED.lever_arm_m[1:],
    )


def test_derivatives_of_innovations_have_their_closed_forms(exact: Dive) -> None:
    """Of a filter that never listens, so that the innovations are those of the INS alone, and the sensors are exact."""
    deaf_mps = 1e6
    config = msgspec.structs.replace(
        CONFIG, dvl=msgspec.structs.replace(CONFIG.dvl, velocity_sd_mps=deaf_mps)
    )
    asked = as_read(exact).with_config(config).innovations()
    jacobian = deaf_mps * asked.jacobian(np.zeros(len(NAMES)), np.ones(len(NAMES), dtype=np.bool_))
    assert np.abs(deaf_mps * asked.residuals(np.zeros(len(NAMES)))).max() < 2e-3
    pings = asked.prepared.velocities
    velocity_b = pings.velocity_b[SKIPPED:-SKIPPED]
    imu_s, ping_s = (
        times * 1e-9
        for times in (
            exact.imu.time_ns - exact.imu.time_ns[0],
            pings.time_ns - exact.imu.time_ns[0],
        )
    )
    rate_b = np.column_stack(
        [np.interp(ping_s, imu_s, column) for column in exact.imu.angular_rate_b.T]
    )
    np.testing.assert_allclose(jacobian[:, :, ARM], skews(rate_b[SKIPPED:-SKIPPED]), atol=2e-3)
    np.testing.assert_allclose(jacobian[:, :, MOUNTING], skews(velocity_b), atol=5e-3)
    np.testing.assert_allclose(jacobian[:, :, SCALE], velocity_b, atol=5e-3)
    # The DVL's own velocities, a second apart, give the slope where it hardly bends.
    slope = np.gradient(pings.velocity_b, ping_s, axis=0)[SKIPPED:-SKIPPED]
    straight = np.abs(np.gradient(slope, axis=0)).max(axis=1) < 2e-3
    assert straight.sum() > 20
    np.testing.assert_allclose(jacobian[straight][:, :, DELAY], -slope[straight], atol=5e-3)


def skews(vectors: Floats) -> Floats:
    return np.stack([skew(vector) for vector in vectors])


def test_scale_of_a_turn_is_about_its_axis() -> None:
    yawed = np.zeros(len(NAMES))
    yawed[MOUNTING.stop - 1] = 2.0 * DEG
    assert Geometry(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 10.0), 1.0).changed(
        yawed
    ).mounting_rpy_deg == pytest.approx((0.0, 0.0, 12.0))
