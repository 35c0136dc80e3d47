"""Each H of a sensor beside the DVL, and of the states beside the twelve, against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import Rotation

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.nav.algebra import matrix, vector
from insdvl_replay.nav.earth_model import local_earth_at
from insdvl_replay.nav.error_model import layout_of, without_error
from insdvl_replay.nav.measurements import (
    BEAM,
    DEPTH,
    FIX,
    HEADING,
    VELOCITY,
    InsNow,
    Measurement,
    Memory,
    linearise,
    sensor_measurement,
    stacked,
)

POSITION = (0.57, 0.6, -20.0)
VELOCITY_N = np.array([0.9, -0.4, 0.1])
MAT_NB = Rotation.from_euler("ZYX", [2.0, -0.3, 0.25]).as_matrix()
ARM_B = np.array([-1.8, -0.3, 0.2])
LAYOUT, STATES = layout_of(("position", "dvl_scale", "dvl_yaw", "heading_bias")), 18
SCALE, YAW, BIAS = 0.03, 0.2, 0.1


def ins_off_by(dx: Floats) -> InsNow:
    """An INS whose errors are dx: estimated minus true."""
    place, nothing = local_earth_at(POSITION[0], POSITION[2]), np.zeros((1, 3))
    return InsNow(
        without_error(POSITION, vector(-dx[12:15]), place),
        vector(VELOCITY_N + dx[:3]),
        matrix(Rotation.from_rotvec(dx[3:6]).as_matrix() @ MAT_NB),
        (0.0, 0.0, -9.8),
        Memory(nothing, nothing, nothing),
        9.8,
        (0.0, 0.0, 0.0),
        place,
        (0.0, 0.0, 0.0),
        np.array([SCALE, YAW, BIAS]) - dx[15:],
    )


def of_kind(kind: int, reading: Floats) -> Measurement:
    made = sensor_measurement("", "", kind, np.arange(1), reading[None], np.ones(len(reading)))
    made.sensor_arm_b[:] = ARM_B
    return made


def linearised(kind: int, reading: Floats, dx: Floats) -> tuple[Floats, Floats]:
    z, H = np.empty(len(reading)), np.full((len(reading), STATES), np.nan)
    linearise(stacked([of_kind(kind, reading)]), 0, 0, ins_off_by(dx), LAYOUT, None, z, H)
    return z, H


@pytest.mark.parametrize(
    ("kind", "reading"),
    [
        (DEPTH, np.array([20.0])),
        (HEADING, np.array([2.0])),
        (FIX, np.array(POSITION)),
        (FIX, np.array(POSITION[:2])),
    ],
)
def test_jacobian(kind: int, reading: Floats) -> None:
    _, H = linearised(kind, reading, np.zeros(STATES))
    assert_jacobian(
        H, lambda dx: linearised(kind, reading, dx)[0], np.zeros(STATES), atol=1e-6, step=1e-3
    )


def test_jacobian_of_a_beam_whatever_the_measurement_before_has_left_in_it() -> None:
    slanted_b = np.array([0.6, -0.3, 0.74])
    beam = replace(of_kind(BEAM, np.array([0.5])), direction_b=slanted_b)

    def innovation(dx: Floats) -> Floats:
        linearise(stacked([beam]), 0, 0, ins_off_by(dx), LAYOUT, None, z, H)
        return z.copy()

    z, H = np.empty(1), np.full((3, STATES), np.nan)
    innovation(np.zeros(STATES))
    assert_jacobian(H[:1].copy(), innovation, np.zeros(STATES), atol=1e-6, step=1e-4)


def test_jacobian_of_a_velocity_whose_scale_and_yaw_are_estimated() -> None:
    pings = np.array([[0.9, -0.4, 0.1]])
    velocity = replace(
        of_kind(VELOCITY, pings[0]),
        velocity_weights=np.zeros((1, 1)),
        interval_weights=np.zeros((1, 0)),
    )

    def innovation(dx: Floats) -> Floats:
        linearise(stacked([velocity]), 0, 0, ins_off_by(dx), LAYOUT, None, z, H)
        return z.copy()

    z, H = np.empty(3), np.full((3, STATES), np.nan)
    innovation(np.zeros(STATES))
    assert_jacobian(H.copy(), innovation, np.zeros(STATES), atol=1e-6, step=1e-4)
    reading_b = MAT_NB.T @ VELOCITY_N * (1.0 + SCALE)
    turned = Rotation.from_euler("z", -YAW).apply(reading_b) - pings[0]
    np.testing.assert_allclose(innovation(np.zeros(STATES)), turned, atol=1e-12)


def test_headings_on_both_sides_of_south_are_near_each_other() -> None:
    z, _ = linearised(HEADING, np.array([2.0 - 2.0 * np.pi + BIAS + 0.01]), np.zeros(STATES))
    assert z[0] == pytest.approx(-0.01, abs=1e-9)


def test_depth_is_that_of_the_depth_sensor() -> None:
    """A gauge 1.8 m behind the IMU of a vehicle whose bow is down is higher."""
    z, _ = linearised(DEPTH, np.array([20.0]), np.zeros(STATES))
    assert z[0] == pytest.approx((MAT_NB @ ARM_B)[2])
