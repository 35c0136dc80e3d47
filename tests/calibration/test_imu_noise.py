"""Noise of the IMU is not taken for a delay or an arm, however large it is."""

from dataclasses import replace

import numpy as np
import pytest
from built_in import (
    ARM_M,
    DELAY_S,
    SCALE,
    TRUTH,
    YAW_DEG,
    ReadDive,
    as_read,
    built_in_otherwise,
    shown,
)

from insdvl_replay.calibration.calibration import MANY_TIMES, Calibration, calibrate
from insdvl_replay.calibration.certainty import (
    MOTION_S,
    averaged,
    certainty_of,
    delay_weights,
    differing,
    noise_share,
)
from insdvl_replay.calibration.fit import Fit, Linearised, fit
from insdvl_replay.calibration.innovations import DELAY, NAMES, PRIOR_SD
from insdvl_replay.calibration.noise import INERTIAL
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.sim.dive import add_errors, exact_dive, late_and_long
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

GRADE_NAMES = ("fog", "tactical", "mems")
NONE = np.zeros(len(NAMES))
BUILT_IN = shown(TRUTH)


def as_configured(
    scenario: str, grade: str, seed: int, duration_s: float | None = None
) -> ReadDive:
    exact = exact_dive(scenario, duration_s=duration_s)
    return as_read(add_errors(exact, GRADES[grade], DvlErrors(), seed), load_config(grade))


def otherwise(scenario: str, grade: str, seed: int, duration_s: float | None = None) -> ReadDive:
    return built_in_otherwise(
        scenario, seed, DvlErrors(), duration_s=duration_s, config=load_config(grade), grade=grade
    )


def calibrated(read: ReadDive) -> Calibration:
    return calibrate([read.innovations()], read.config)


def moving_average(readings: np.ndarray, samples: int) -> np.ndarray:
    share = np.full(samples, 1.0 / samples)
    padded = np.pad(readings, ((samples - 1, 0), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(axis, share, mode="valid") for axis in padded.T])


def proposed(found: Calibration) -> set[str]:
    return {row.parameter for row in found.estimated}


def errors_over_sds(found: Calibration, truth: np.ndarray) -> np.ndarray:
    """Of what is proposed, in the units that are shown, NaN of the rest."""
    return np.array(
        [
            (finite(row.change) - of_one) / finite(row.sd)
            if row.status == Estimated.ESTIMATED
            else np.nan
            for row, of_one in zip(found.rows, truth, strict=True)
        ]
    )


@pytest.mark.parametrize(
    ("scenario", "grade"),
    [
        ("straight", "tactical"),
        *(
            pytest.param(scenario, grade, marks=pytest.mark.nightly)
            for scenario in ("static", "straight")
            for grade in GRADE_NAMES
            if (scenario, grade) != ("straight", "tactical")
        ),
    ],
)
def test_a_vehicle_that_does_not_turn_reports_neither_delay_nor_arm(
    scenario: str, grade: str
) -> None:
    found = calibrated(as_configured(scenario, grade, 1, 200.0))
    assert not proposed(found)
    assert found.after == found.before
    whys = {row.parameter: row.why for row in found.rows}
    assert all("noise of this IMU" in whys[name] for name in ("delay", "arm_x"))


def test_an_imu_that_smooths_its_readings_reports_no_more() -> None:
    """From sample to sample its noise hides."""
    config = load_config("mems")
    noisy = add_errors(exact_dive("static", duration_s=200.0), GRADES["mems"], DvlErrors(), 3)
    imu = replace(
        noisy.imu,
        specific_force_b=moving_average(noisy.imu.specific_force_b, 8),
        angular_rate_b=moving_average(noisy.imu.angular_rate_b, 8),
    )
    assert not proposed(calibrated(as_read(replace(noisy, imu=imu), config)))


@pytest.mark.parametrize(
    ("scenario", "grade", "share"), [("static", "mems", 1.0), ("calibration", "fog", 0.0)]
)
def test_the_share_of_noise_is_known_of_a_vehicle_that_is_still_and_of_quiet_sensors(
    scenario: str, grade: str, share: float
) -> None:
    sensors = GRADES[grade]

    noise = {key: getattr(sensors, key) for key in INERTIAL}
    config = load_config(grade, overrides=[f"noise.{key}={value}" for key, value in noise.items()])
    dive = as_read(
        add_errors(exact_dive(scenario, duration_s=200.0), sensors, DvlErrors(), 1), config
    ).innovations()
    seen = np.array([name in ("delay", "arm_x", "arm_y") for name in NAMES])
    (shares,) = noise_share(fit([dive], seen), [dive])
    assert shares[seen] == pytest.approx(share, abs=0.15 * share + 1e-3)
    assert not shares[~seen].any()


@pytest.mark.nightly
@pytest.mark.parametrize("grade", GRADE_NAMES)
@pytest.mark.parametrize("scenario", ["static", "straight"])
def test_no_such_dive_of_ten_does(scenario: str, grade: str) -> None:
    for seed in range(10):
        found = proposed(calibrated(as_configured(scenario, grade, seed, 300.0)))
        assert not found & {"delay", "arm_x", "arm_y", "arm_z"}, seed


@pytest.mark.nightly
@pytest.mark.parametrize("times", [1.0, 10.0])
def test_dives_that_are_still_take_nothing_from_one_that_shows_how_the_dvl_is_built_in(
    times: float,
) -> None:
    """Nor do they say anything of their own, with an IMU as noisy or with one that is far noisier there."""
    config, sensors = load_config("mems"), GRADES["mems"]
    noisier = replace(sensors, **{key: times * getattr(sensors, key) for key in INERTIAL})
    exact = exact_dive(
        "static", duration_s=100.0, lever_arm_m=ARM_M, mounting_rpy_deg=(0.0, 0.0, YAW_DEG)
    )
    moving = otherwise("calibration", "mems", 100, 300.0)
    still = [
        as_read(
            late_and_long(add_errors(exact, noisier, DvlErrors(), seed), DELAY_S, SCALE), config
        )
        for seed in (101, 102)
    ]
    dives = [read.innovations() for read in (moving, *still)]
    found = calibrate(dives, config)
    # What the IMU's own scale and axes may do to the yaw is not known beside one that is ten times as noisy.
    assert {"arm_x", "arm_y", "arm_z", *(["mounting_z"] if times == 1.0 else [])} <= proposed(
        found
    )
    assert np.nanmax(np.abs(errors_over_sds(found, BUILT_IN))) < 3.5
    assert max(row.birge or 0.0 for row in found.rows) <= MANY_TIMES
    assert [found.fit.change(i)[DELAY] for i in (1, 2)] == [0.0, 0.0]
    if times == 1.0:
        alone = calibrated(moving)
        assert proposed(found) == proposed(alone)
        for row, of_one in zip(found.rows, alone.rows, strict=True):
            assert finite(row.sd) < 1.1 * finite(of_one.sd)


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["tactical", "mems"])
def test_slow_turns_next_to_a_noisy_imu_show_the_arm_and_no_delay(grade: str) -> None:
    found = calibrated(as_configured("figure-eight", grade, 42))
    assert "delay" not in proposed(found)
    assert {"arm_x", "arm_y"} <= proposed(found)
    assert np.nanmax(np.abs(errors_over_sds(found, NONE))) < 3.0


@pytest.mark.parametrize("grade", ["tactical", pytest.param("mems", marks=pytest.mark.nightly)])
def test_strong_manoeuvres_show_the_delay_next_to_a_noisy_imu(grade: str) -> None:
    found = calibrated(otherwise("calibration", grade, 60))
    assert {"delay", "arm_x", "arm_y", "arm_z"} <= proposed(found)
    assert np.nanmax(np.abs(errors_over_sds(found, BUILT_IN))) < 3.5


@pytest.mark.nightly
@pytest.mark.parametrize("duration_s", [600.0, None])
def test_a_scale_that_nothing_shows_does_not_run_away_with_the_arm(
    duration_s: float | None,
) -> None:
    found = calibrated(otherwise("lawnmower", "mems", 62, duration_s))
    assert shown(found.fit.change(0))[-1] == 0.0
    assert found.after.lever_arm_m[:2] == pytest.approx((0.3, -0.1), abs=0.05)


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["tactical", "mems"])
@pytest.mark.parametrize(
    ("scenario", "duration_s"),
    [("figure-eight", None), ("calibration", None), ("lawnmower", 600.0)],
)
def test_errors_next_to_a_noisy_imu_are_as_large_as_is_said(
    scenario: str, duration_s: float | None, grade: str
) -> None:
    """Of delay and arm, over all that is proposed of seven dives as configured, and of seven built in otherwise."""
    delay_and_arm = [NAMES.index(name) for name in ("delay", "arm_x", "arm_y", "arm_z")]
    dives = [(as_configured(scenario, grade, seed, duration_s), NONE) for seed in range(60, 67)]
    dives += [(otherwise(scenario, grade, seed, duration_s), BUILT_IN) for seed in range(70, 77)]
    errors = [errors_over_sds(calibrated(read), truth) for read, truth in dives]
    of_sd = np.sqrt(np.nanmean(np.square(np.array(errors)[:, delay_and_arm])))
    assert 0.6 < of_sd < 1.5


def test_readings_are_averaged_around_each() -> None:
    """A line stays a line inside, white noise falls as the root of how many there are."""
    line = np.outer(np.arange(200.0), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(averaged(line, 0.01)[30:-30], line[30:-30])
    noise = np.random.default_rng(3).standard_normal((20_000, 3))
    assert averaged(noise, 0.01).std() == pytest.approx(
        1.0 / np.sqrt(MOTION_S / 0.01 + 1.0), rel=0.1
    )
    np.testing.assert_array_equal(averaged(line, 0.6), line)


def test_both_standard_deviations_are_alike_where_residuals_are_white() -> None:
    """By the information and by the scores, with other derivatives of the motion than of the residuals."""
    rng, free = np.random.default_rng(5), np.ones(len(NAMES), dtype=bool)
    by_motion = rng.standard_normal((4000, 3, len(NAMES)))
    jacobian = by_motion @ (
        np.eye(len(NAMES)) + 0.3 * rng.standard_normal((len(NAMES), len(NAMES)))
    )
    near = Linearised(rng.standard_normal((4000, 3)), np.ones(3), jacobian, by_motion)
    certainty = certainty_of(
        Fit((np.arange(len(NAMES)),), PRIOR_SD, free, np.zeros(len(NAMES)), (near,))
    )
    assert certainty.correlated == pytest.approx(certainty.formal, rel=0.2)


def test_dives_differ_by_what_those_say_that_say_anything() -> None:
    rng = np.random.default_rng(6)
    own, sd = rng.standard_normal((6, 2)), np.ones((6, 2))
    between, birge = differing(own, sd, sd**-2.0)
    assert between == pytest.approx(own.std(axis=0, ddof=1) / np.sqrt(6.0))
    assert birge == pytest.approx(own.std(axis=0, ddof=1))
    mute = np.full((1, 2), 1e4)
    own, sd = np.vstack([own, mute]), np.vstack([sd, mute])
    assert differing(own, sd, sd**-2.0)[0] == pytest.approx(between, rel=0.01)


def test_delays_that_differ_count_alike_and_those_that_do_not_as_they_are_sure() -> None:
    sds_s = np.array([0.001, 0.002, 0.004, 0.5])
    alike = delay_weights(np.array([0.1, 0.1, 0.1, 0.0]), sds_s)
    assert alike == pytest.approx(sds_s**-2.0)
    differing_s = delay_weights(np.array([0.1, 0.05, -0.1, 0.0]), sds_s)
    assert differing_s[:3] / differing_s[0] == pytest.approx(1.0, abs=0.01)
    assert differing_s[3] < 0.05 * differing_s[0]
    assert delay_weights(np.array([0.1]), np.array([0.01])) == pytest.approx(1e4)
