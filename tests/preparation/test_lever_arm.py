"""The reference's point of measurement: moving it to the IMU undoes what the lever arm did."""

from dataclasses import replace

import numpy as np
import pytest
from frames import frame

from insdvl_replay.core.config import Config, Noise, Reference
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns, seconds
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.earth import meridian_radius_m, transverse_radius_m
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.preparation.prepared import reference_at_imu, with_reference_at_imu
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import exact_dive

ARM_B = np.array([1.8, -0.4, 0.3])


@pytest.fixture(scope="module")
def turning() -> Dive:
    """An exact dive through a turn at 17 deg/s, its reference fine enough to differentiate."""
    return exact_dive("figure-eight", duration_s=130.0, imu_rate_hz=50.0, reference_rate_hz=50.0)


def north_east_down_m(reference: ReferenceColumns) -> Floats:
    latitude, longitude, height_m = (reference.position - reference.position[0]).T
    start = reference.position[0, 0]
    north_m, east_m = meridian_radius_m(start), transverse_radius_m(start) * np.cos(start)
    return np.column_stack([latitude * north_m, longitude * east_m, -height_m])


def test_velocity_of_the_moved_point_is_the_rate_of_its_way(turning: Dive) -> None:
    assert turning.reference is not None
    moved = reference_at_imu(turning.reference, turning.imu, ARM_B)
    apart_n = -turning.reference.mat_nb @ ARM_B
    change_n = np.gradient(apart_n, seconds(moved.time_ns, moved.time_ns[0]), axis=0)
    inside = slice(1, -1)
    np.testing.assert_allclose(
        (moved.velocity_n - turning.reference.velocity_n)[inside],
        change_n[inside],
        rtol=0.0,
        atol=2e-3,
    )
    apart_m = north_east_down_m(moved) - north_east_down_m(turning.reference)
    np.testing.assert_allclose(apart_m, apart_n - apart_n[0], rtol=0.0, atol=0.01)


@pytest.mark.nightly
def test_reference_of_another_point_is_as_good_once_its_lever_arm_is_known(turning: Dive) -> None:
    assert turning.reference is not None
    elsewhere = replace(
        turning, reference=reference_at_imu(turning.reference, turning.imu, -ARM_B)
    )
    noise = Noise(accel_white_mps_rts=2e-3, gyro_white_rad_rts=2e-6)
    known = Config(noise=noise, reference=Reference(lever_arm_m=(1.8, -0.4, 0.3)))
    rms_m = [
        frame(replay_dive(dive, config).tables.reference_error)
        .set_index("quantity")
        .loc["position_h", "rmse"]
        for dive, config in (
            (turning, Config(noise=noise)),
            (elsewhere, known),
            (elsewhere, Config(noise=noise)),
        )
    ]
    assert rms_m[1] == pytest.approx(rms_m[0], abs=1e-3)
    assert rms_m[2] > 0.5


def test_zero_lever_arm_leaves_a_partial_reference_whole(turning: Dive) -> None:
    assert turning.reference is not None
    partial = replace(turning.reference, mat_nb=np.full_like(turning.reference.mat_nb, np.nan))
    assert reference_at_imu(partial, turning.imu, np.zeros(3)) is partial


def test_mounting_turns_the_attitude_before_the_arm_is_taken_off(turning: Dive) -> None:
    """A reference whose axes are turned and that is of another point, undone by the two keys that say so."""
    assert turning.reference is not None
    rpy_deg = (2.0, -3.0, 88.0)
    mat_br = mat_from_rpy(np.array(rpy_deg) * DEG)
    elsewhere = reference_at_imu(turning.reference, turning.imu, -ARM_B)
    turned = replace(turning, reference=replace(elsewhere, mat_nb=elsewhere.mat_nb @ mat_br))
    settings = Reference(lever_arm_m=(1.8, -0.4, 0.3), mounting_rpy_deg=rpy_deg)
    back = with_reference_at_imu(turned, Config(reference=settings)).reference
    assert back is not None
    inside = back.rows(np.isfinite(back.velocity_n).all(axis=1))
    truth = turning.reference.rows(np.isin(turning.reference.time_ns, inside.time_ns))
    np.testing.assert_allclose(inside.mat_nb, truth.mat_nb, atol=1e-12)
    np.testing.assert_allclose(inside.velocity_n, truth.velocity_n, atol=1e-9)
    np.testing.assert_allclose(inside.position, truth.position, atol=1e-12)
    unturned = with_reference_at_imu(
        turned, Config(reference=Reference(lever_arm_m=(1.8, -0.4, 0.3)))
    ).reference
    assert unturned is not None
    assert np.nanmax(np.abs(unturned.velocity_n - turning.reference.velocity_n)) > 0.2


def test_no_mounting_leaves_the_reference_to_the_bit(turning: Dive) -> None:
    assert with_reference_at_imu(turning, Config()).reference is turning.reference


def test_dependent_reference_is_noted(turning: Dive) -> None:
    replay = replay_dive(turning, Config(reference=Reference(independent=False)))
    assert "reference_not_independent" in {note.code for note in replay.notes}
