"""Rotations against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.geometry.rotation import (
    mat_from_quat,
    mat_from_rpy,
    quat_from_mat,
    rpy_from_mat,
    skew,
    vector_from_mat,
    wrap_angle,
)
from insdvl_replay.nav.algebra import rotation_from_vector, vector


@pytest.fixture
def rotations() -> Rotation:
    return Rotation.random(500, random_state=np.random.default_rng(1))


def test_roll_pitch_heading_is_heading_then_pitch_then_roll(rotations: Rotation) -> None:
    rpy = rotations.as_euler("ZYX")[:, ::-1]
    np.testing.assert_allclose(mat_from_rpy(rpy), rotations.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rpy_from_mat(rotations.as_matrix()), rpy, atol=1e-9)


def test_quaternions_agree_with_scipy(rotations: Rotation) -> None:
    quat = rotations.as_quat(canonical=True)
    np.testing.assert_allclose(mat_from_quat(3.0 * quat), rotations.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quat_from_mat(rotations.as_matrix()), quat, atol=1e-14)


def test_quaternion_of_no_length_is_missing() -> None:
    assert np.isnan(mat_from_quat(np.zeros(4))).all()


@pytest.mark.parametrize("pitch_deg", [90.0, -90.0])
@pytest.mark.parametrize("heading_deg", [-135.0, -90.0, 0.0, 30.0, 180.0])
def test_roll_pitch_heading_of_an_upright_vehicle_are_of_its_attitude(
    pitch_deg: float, heading_deg: float
) -> None:
    mat = Rotation.from_euler("ZYX", [heading_deg, pitch_deg, 20.0], degrees=True).as_matrix()
    rpy = rpy_from_mat(mat)
    assert rpy[0] == 0.0
    np.testing.assert_allclose(mat_from_rpy(rpy), mat, atol=1e-7)  # of an arcsine near 1


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi - 1e-6, np.pi])
def test_rotation_vector_agrees_with_scipy(angle: float) -> None:
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    mat = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(np.abs(vector_from_mat(mat)), np.abs(angle * axis), atol=1e-9)


@given(st.lists(st.floats(-1.8, 1.8), min_size=3, max_size=3))
def test_exponential_of_logarithm_is_the_rotation(rotation: list[float]) -> None:
    mat = np.array(rotation_from_vector(vector(np.array(rotation))))
    again = rotation_from_vector(vector(np.ascontiguousarray(vector_from_mat(mat))))
    np.testing.assert_allclose(again, mat, atol=1e-12)


@pytest.mark.parametrize("angle", [1e-12, 1e-4, 0.0099, 0.0101, 0.5, 3.0])
def test_exponential_agrees_with_scipy_on_both_sides_of_the_series(angle: float) -> None:
    rotation = angle * np.array([0.6, 0.0, -0.8])
    mat = rotation_from_vector(vector(rotation))
    np.testing.assert_allclose(
        mat, Rotation.from_rotvec(rotation).as_matrix(), rtol=0.0, atol=3e-16
    )


def test_skew_is_the_cross_product() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-4.0, 0.5, 6.0])
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b))


@given(st.floats(-50.0, 50.0))
def test_wrapped_angles_point_the_same_way(angle: float) -> None:
    wrapped: Floats = wrap_angle(np.array([angle]))
    assert -np.pi <= wrapped[0] < np.pi
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-12)
