"""Whether a noise can be its sensor's: the scatter of readings against noise that is known, and the classes' edges."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from insdvl_replay.core.config import Filter
from insdvl_replay.core.config_file import PRESETS, load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.evaluation.notes import (
    CLASSES,
    beyond_the_sensor,
    readings_scatter,
    sensor_class,
)
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import GRADES

STEP_S = 0.01
DENSITY = 2e-3
ACCEL, GYRO = "accel_white_mps_rts", "gyro_white_rad_rts"


def white_noise(samples: int = 20_000) -> Floats:
    return DENSITY / np.sqrt(STEP_S) * np.random.default_rng(8).standard_normal((samples, 3))


def test_scatter_of_white_noise_is_its_density_whatever_the_vehicle_does_meanwhile() -> None:
    noise = white_noise()
    assert readings_scatter(noise, STEP_S) == pytest.approx(DENSITY, rel=0.03)
    time_s = STEP_S * np.arange(len(noise))
    swinging = 0.3 * np.sin(2.0 * np.pi * 0.5 * time_s)[:, None]
    assert readings_scatter(noise + swinging, STEP_S) == pytest.approx(DENSITY, rel=0.03)
    noise[1000:1005] = 50.0
    noise[:, 1] += 0.02 * time_s
    assert readings_scatter(noise, STEP_S) == pytest.approx(DENSITY, rel=0.03)


def test_scatter_is_that_of_the_noisiest_axis_and_missing_without_three_readings() -> None:
    noise = white_noise() * [1.0, 3.0, 0.1]
    assert readings_scatter(noise, STEP_S) == pytest.approx(3.0 * DENSITY, rel=0.03)
    assert readings_scatter(noise[:3], STEP_S) > 0.0
    assert np.isnan(readings_scatter(noise[:2], STEP_S))


def test_readings_smoothed_to_ten_hertz_are_within_what_is_allowed_for() -> None:
    """A filter of first order, with which the noise over seconds is as dense as ever, and that between samples less."""
    pole = np.exp(-2.0 * np.pi * 10.0 * STEP_S)
    smoothed = lfilter([1.0 - pole], [1.0, -pole], white_noise(), axis=0)
    assert 0.1 * DENSITY < readings_scatter(smoothed, STEP_S) < 0.5 * DENSITY


@pytest.mark.parametrize("grade", GRADES)
def test_simulated_imus_scatter_by_their_noise_and_are_of_their_class(grade: str) -> None:
    imu, errors = simulate_dive("figure-eight", grade=grade, duration_s=120.0).imu, GRADES[grade]
    for key, readings in ((ACCEL, imu.specific_force_b), (GYRO, imu.angular_rate_b)):
        noise = getattr(errors, key)
        assert readings_scatter(readings, imu.usual_step_s) == pytest.approx(noise, rel=0.1)
        assert sensor_class(key, noise) == grade


def test_gyros_of_the_presets_are_of_their_class() -> None:
    for preset in PRESETS[1:]:
        assert sensor_class(GYRO, load_config(preset).noise.gyro_white_rad_rts) == preset


def test_classes_are_best_first_and_bear_the_keys_of_a_filter() -> None:
    for key, sensors in CLASSES.items():
        assert key in Filter.__struct_fields__
        assert list(sensors.worst.values()) == sorted(sensors.worst.values())
        assert sensor_class(key, 1.0) == ""


@pytest.mark.parametrize(
    ("key", "noise", "scatter", "expected"),
    [
        (
            GYRO,
            9e-6,
            3e-7,
            [],
        ),  # more than the readings show, but within the best class: small errors of all kinds
        (GYRO, 1.1e-5, 3e-7, ["37", "3e-07"]),
        (GYRO, 2.9e-4, 3e-5, []),
        (GYRO, 2e-3, 3e-5, ["67", "3e-05", "0.001"]),
        (GYRO, 2e-3, 1.1e-3, []),  # the readings show it
        (GYRO, 2e-3, 9e-4, ["0.001"]),
        (ACCEL, 0.011, 0.0, ["0.01"]),
        ("velocity_sd_mps", 0.09, 0.0, []),
        ("beam_sd_mps", 0.11, 0.0, ["0.1"]),
        (GYRO, 2e-4, np.nan, []),
        ("beam_sd_mps", 8.92e-6, 0.0, ["0.0003"]),
        (ACCEL, 1.3e-6, 1e-3, ["1e-05"]),
    ],
)
def test_noise_beyond_its_sensor(
    key: str, noise: float, scatter: float, expected: list[str]
) -> None:
    told = beyond_the_sensor(key, noise, scatter)
    assert re.findall(r"\d[\d.e-]*", told) == expected
    assert bool(told) == bool(expected)
