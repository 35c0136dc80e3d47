"""A start is as uncertain as what it comes from: the squares of its errors over their variances have the mean 1."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import msgspec
import numpy as np
import pytest

from insdvl_replay.core.config import Config, Heading, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import (
    Dive,
    Floats,
    ReferenceColumns,
    SensorColumns,
    StatedErrors,
    TruthColumns,
)
from insdvl_replay.core.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.preparation.alignment import Alignment
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.run import drawn_part
from insdvl_replay.preparation.source_errors import (
    ATTITUDE_FLOOR,
    VELOCITY_FLOOR_MPS,
    reference_sd,
    third_difference_sd,
)
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors

GYRO_SD_DEGPH, ACCEL_SD_MG = 20.0, 1.0
IMU: Final = ImuErrors(
    accel_white_mps_rts=1e-3,
    gyro_white_rad_rts=2e-5,
    accel_bias_sd_mps2=ACCEL_SD_MG * MG,
    gyro_bias_sd_radps=GYRO_SD_DEGPH * DEG_PER_HOUR,
)
DVL: Final = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
BIASES: Final = {"accel_bias_sd_mg": ACCEL_SD_MG, "gyro_bias_sd_degph": GYRO_SD_DEGPH}
HEADING_SD_DEG = 2.0
LEVEL: Final = Initial(
    source="level", misalignment_sd_deg=(0.5, 0.5, HEADING_SD_DEG), heading_deg=0.0, **BIASES
)
BY_AHRS: Final = Initial(source="sensor", **BIASES)


@pytest.fixture(scope="module")
def exact() -> Dive:
    return exact_dive(
        "figure-eight", duration_s=100.0, imu_rate_hz=20.0, sensor_rates_hz={"heading": 4.0}
    )


def with_errors(exact: Dive, seed: int) -> Dive:
    heading = exact.sensors
    return replace(add_errors(replace(exact, sensors={}), IMU, DVL, seed), sensors=heading)


def settings(initial: Initial, heading: Heading = Heading()) -> Config:
    return msgspec.structs.replace(load_config("tactical"), initial=initial, heading=heading)


def noisy(
    reference: ReferenceColumns, seed: int, level_deg: float, heading_deg: float
) -> ReferenceColumns:
    """A reference with white noise, and 5 cm/s and 1.5 m."""
    rng, rows = np.random.default_rng([seed, 7]), len(reference.time_ns)
    turn = np.array([level_deg, level_deg, heading_deg]) * DEG * rng.standard_normal((rows, 3))
    return replace(
        reference,
        position=moved_position(reference.position, 1.5 * rng.standard_normal((rows, 3))),
        velocity_n=reference.velocity_n + 0.05 * rng.standard_normal((rows, 3)),
        mat_nb=mat_from_vector(turn) @ reference.mat_nb,
    )


def known(reference: ReferenceColumns | None) -> ReferenceColumns:
    assert reference is not None
    return reference


def error_of(alignment: Alignment, exact: Dive, truth: TruthColumns | None) -> Floats:
    """Return the error of the twelve states at the start, and that of the position, (15,)."""
    start, reference = alignment.start, known(exact.reference)
    row = int(np.searchsorted(reference.time_ns, alignment.start_ns))
    assert truth is not None
    phi = vector_from_mat(start.mat_nb @ reference.mat_nb[row].T)
    # The velocity error beside a misalignment, see `nav.levelling.start_with_error`.
    velocity = mat_from_vector(phi) @ reference.velocity_n[row]
    return np.concatenate([
        start.velocity_n - velocity + np.cross(phi, start.velocity_n),
        phi,
        truth.accel_bias_b[row] - start.accel_bias_b,
        truth.gyro_bias_b[row] - start.gyro_bias_b,
    ])  # fmt: skip


def by_reference(exact: Dive, dive: Dive, seed: int) -> tuple[Dive, Config]:
    return replace(dive, reference=noisy(known(exact.reference), seed, 0.2, 0.6)), settings(
        Initial(**BIASES)
    )


def by_ahrs(exact: Dive, dive: Dive, seed: int) -> tuple[Dive, Config]:
    """An AHRS whose messages state its variances."""
    ahrs, rng = exact.sensors["heading"], np.random.default_rng([seed, 8])
    assert ahrs.mat_nb is not None
    sd = np.array([0.7, 0.7, 1.5]) * DEG
    mat_nb = mat_from_vector(sd * rng.standard_normal((len(ahrs.time_ns), 3))) @ ahrs.mat_nb
    stated = SensorColumns(ahrs.time_ns, ahrs.values, mat_nb, np.tile(sd, (len(ahrs.time_ns), 1)))
    return replace(dive, sensors={"heading": stated}), settings(BY_AHRS)


def by_nothing(exact: Dive, dive: Dive, seed: int) -> tuple[Dive, Config]:
    """A heading that somebody read off a compass."""
    true_deg = np.degrees(np.arctan2(*known(exact.reference).mat_nb[0, [1, 0], 0]))
    read_deg = true_deg + HEADING_SD_DEG * np.random.default_rng([seed, 9]).standard_normal()
    return dive, settings(msgspec.structs.replace(LEVEL, heading_deg=float(read_deg)))


WAYS: Final = {"reference": by_reference, "ahrs": by_ahrs, "level": by_nothing}


def nees_per_state(
    exact: Dive, way: Callable[[Dive, Dive, int], tuple[Dive, Config]], seeds: range
) -> tuple[Floats, float]:
    """Return the mean square of each error over its variance, (12,), and of all of them together over 12."""
    alone, together = np.zeros(12), 0.0
    for seed in seeds:
        dive, config = way(exact, with_errors(exact, seed), seed)
        alignment = prepare_dive(dive, config).alignment
        error = error_of(alignment, exact, dive.truth)
        alone += error**2 / np.diagonal(alignment.start.cov)
        together += error @ np.linalg.solve(alignment.start.cov, error) / 12.0
    return alone / len(seeds), together / len(seeds)


@pytest.mark.parametrize("way", WAYS)
def test_a_start_errs_by_what_it_says(exact: Dive, way: str) -> None:
    """Of 6 starts, in groups of three states: chi-square of 18, which is between a quarter and two and a half times."""
    alone, _ = nees_per_state(exact, WAYS[way], range(6))
    groups = [alone[states].mean() for states in (DV, PHI, BA, BG)]
    assert np.all((np.array(groups) > 0.25) & (np.array(groups) < 2.5)), alone


@pytest.mark.nightly
@pytest.mark.parametrize("way", WAYS)
def test_each_state_of_a_start_errs_by_what_it_says(exact: Dive, way: str) -> None:
    alone, together = nees_per_state(exact, WAYS[way], range(200))
    assert np.all((alone > 0.5) & (alone < 2.0)), alone
    assert 0.5 < together < 2.0


# --- What each source shows.


def found_sd(
    exact: Dive, reference: ReferenceColumns, **of_reference: Any
) -> tuple[Floats, Floats]:
    """Return the standard deviations of attitude and velocity that a reference is given."""
    dive = replace(with_errors(exact, 1), reference=reference)
    config = settings(Initial(**BIASES))
    stated = msgspec.structs.replace(config.reference, **of_reference)
    config = msgspec.structs.replace(config, reference=stated)
    start_ns = int(reference.time_ns[0])
    sd = reference_sd(
        dive, config, dvl_velocities(dive.dvl), start_ns, float(reference.position[0, 0])
    )
    return sd.attitude, sd.velocity


def test_a_reference_without_noise_has_the_floor(exact: Dive) -> None:
    """But where it is compared with a DVL of 6 mm/s."""
    attitude, velocity = found_sd(exact, known(exact.reference), independent=False)
    np.testing.assert_allclose(attitude, ATTITUDE_FLOOR)
    assert np.all((velocity >= VELOCITY_FLOOR_MPS) & (velocity < 0.006))
    sd = third_difference_sd(
        known(exact.reference).time_ns, np.zeros_like(known(exact.reference).velocity_n)
    )
    np.testing.assert_array_equal(sd, 0.0)


def test_a_heading_that_wanders_is_as_uncertain_as_it_wanders(exact: Dive) -> None:
    """By a sine of 1 deg in 40 s, whose absolute median is 0.71; no noise of single rows shows it."""
    reference = known(exact.reference)
    wander = DEG * np.sin(2.0 * np.pi * (reference.time_ns - reference.time_ns[0]) * 1e-9 / 40.0)
    turned = mat_from_vector(wander[:, None] * np.array([0.0, 0.0, 1.0])) @ reference.mat_nb
    attitude, _ = found_sd(exact, replace(reference, mat_nb=turned), independent=False)
    assert attitude[2] == pytest.approx(0.71 * 1.48 * DEG, rel=0.25)
    np.testing.assert_allclose(attitude[:2], ATTITUDE_FLOOR[:2])


def test_a_heading_that_is_off_shows_in_the_direction_of_the_velocity(exact: Dive) -> None:
    """If the reference does not have its velocity from the DVL."""
    reference = known(exact.reference)
    turned = mat_from_vector(np.array([0.0, 0.0, 2.0 * DEG])) @ reference.mat_nb
    off, _ = found_sd(exact, replace(reference, mat_nb=turned))
    blind, _ = found_sd(exact, replace(reference, mat_nb=turned), independent=False)
    assert off[2] == pytest.approx(2.0 * DEG, rel=0.1)
    assert blind[2] == ATTITUDE_FLOOR[2]


def test_what_is_stated_goes_before_what_is_estimated(exact: Dive) -> None:
    """By the settings, then by the messages; never below the noise of single rows."""
    reference = known(exact.reference)
    cov = np.diag(np.repeat([0.03, 0.7 * DEG, 2.0], 3) ** 2)
    stated = replace(reference, stated=StatedErrors(reference.time_ns[:1], cov[None]))
    attitude, velocity = found_sd(exact, stated)
    np.testing.assert_allclose(attitude, 0.7 * DEG)
    np.testing.assert_allclose(velocity, 0.03)
    np.testing.assert_allclose(found_sd(exact, stated, attitude_sd_deg=0.3)[0], 0.3 * DEG)
    rough = replace(noisy(reference, 1, 0.5, 3.0), stated=stated.stated)
    assert found_sd(exact, rough)[0][2] == pytest.approx(3.0 * DEG, rel=0.2)


def test_few_rows_leave_the_settings(exact: Dive) -> None:
    few = known(exact.reference).rows(slice(0, 12))
    attitude, velocity = found_sd(exact, few)
    assert np.isnan(attitude).all()
    assert np.isnan(velocity).all()
    dive = replace(with_errors(exact, 1), reference=few)
    sd = prepare_dive(dive, settings(Initial(**BIASES))).alignment.start.sd
    np.testing.assert_allclose(sd[DV], 0.1)
    np.testing.assert_allclose(sd[PHI], 0.5 * DEG)


def test_random_starts_keep_the_settings(exact: Dive) -> None:
    dive = with_errors(exact, 1)
    prepared = prepare_dive(dive, settings(Initial(**BIASES)))
    (own, *others), _, _ = drawn_part(dive, prepared, 3, 0)
    np.testing.assert_allclose(own.sd[PHI], ATTITUDE_FLOOR, rtol=0.2)
    for start in others:
        np.testing.assert_allclose(start.sd[PHI], 0.5 * DEG)
        assert (
            0.05 * DEG < np.linalg.norm(vector_from_mat(start.mat_nb @ own.mat_nb.T)) < 3.0 * DEG
        )
    as_set = prepare_dive(dive, settings(Initial(uncertainty="settings", **BIASES))).alignment
    np.testing.assert_allclose(as_set.start.sd[PHI], 0.5 * DEG)
    assert as_set.spread_cov is None
    assert "start_source" not in {note.code for note in as_set.notes}
