"""A calibration finds what was put in, as surely as it says, and leaves alone what a dive does not show."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from built_in import (
    ARM_M,
    CONFIG,
    DELAY_S,
    SCALE,
    TRUTH,
    WHITE,
    YAW_DEG,
    ReadDive,
    as_read,
    built_in_otherwise,
    shown,
)
from scipy.stats import norm

from insdvl_replay.calibration import noise
from insdvl_replay.calibration.calibration import Calibration, calibrate, held_out_row
from insdvl_replay.calibration.certainty import (
    BEAM_ERRORS,
    certainty_of,
    mean_change,
    newey_west,
    with_estimated_imu_errors,
)
from insdvl_replay.calibration.fit import (
    AXES,
    Fit,
    Linearised,
    fit,
    likeliest_mounting,
    possible_axes,
    scatter_of,
)
from insdvl_replay.calibration.innovations import (
    ALL_GROUPS,
    ARM,
    DELAY,
    MOUNTING,
    NAMES,
    PARAMETERS,
    PRIOR_SD,
    DiveInnovations,
    read_dive,
)
from insdvl_replay.calibration.noise import (
    AT_MOST,
    OF_CLASS,
    UNSURE,
    FittedNoise,
    determined_noise,
    fit_noise,
    levelled,
    nis_per_dof,
    noise_of,
    relative_sds,
)
from insdvl_replay.calibration.output import calibration_toml
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import DvlColumns
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

MAKEFILE = Path(__file__).parents[2] / "Makefile"
SHARED = Path(__file__).parents[3] / "shared" / "data"
SNAPIR = Path(__file__).parents[2] / "examples" / "snapir.toml"
BLUEYE, UFMIL = SNAPIR.with_name("blueye_x3.toml"), SNAPIR.with_name("ufmil.toml")
ALL = np.ones(len(NAMES), dtype=np.bool_)
QUIET = load_config(
    "fog",
    overrides=[
        "noise.accel_white_mps_rts=1e-4",
        "noise.gyro_white_rad_rts=3e-7",
        "dvl.beam_sd_mps=0.0042",
    ],
)
SEEDS = range(7000, 7020)


def calibrated(*dives: ReadDive, only: tuple[str, ...] = ALL_GROUPS) -> Calibration:
    return calibrate([dive.innovations() for dive in dives], dives[0].config, only)


def status(found: Calibration) -> dict[str, Estimated]:
    return {row.parameter: row.status for row in found.rows}


@pytest.mark.nightly
@pytest.mark.parametrize("scenario", ["figure-eight", "calibration"])
@pytest.mark.parametrize(
    "beams", [DvlErrors(), WHITE], ids=["beams as makers say", "perfect beams"]
)
def test_errors_are_as_large_as_is_said(beams: DvlErrors, scenario: str) -> None:
    """Of what is proposed. The IMU has no errors of scale, and some beams have none: the standard deviations are those
    without them, which would hide whether the noise is weighed rightly.
    """
    errors = []
    for seed in SEEDS:
        found = calibrated(built_in_otherwise(scenario, seed, beams))
        of_beams = 0.0 if beams is WHITE else si([finite(row.beams_sd) for row in found.rows])
        sd = np.hypot(certainty_of(found.fit).sd, of_beams)
        estimated = np.array([row.status == Estimated.ESTIMATED for row in found.rows])
        assert (found.change[~estimated] == 0.0).all()
        errors.append(np.where(estimated, found.change - TRUTH, np.nan) / sd)
    of_sd = np.sqrt(np.nanmean(np.square(errors), axis=0))
    told = {name: round(float(size), 2) for name, size in zip(NAMES, of_sd, strict=True)}
    assert (of_sd > 0.6).all(), told
    assert (of_sd < 1.5).all(), told
    # Of normal errors one in a hundred times two such sets has a larger one; both kinds of beams have the same IMU.
    assert np.nanmax(np.abs(errors)) < norm.isf(0.005 / 2.0 / np.size(errors))


def si(values: list[float]) -> np.ndarray:
    """Turn what is shown to SI."""
    return np.array(values) / shown(np.ones(len(NAMES)))


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["tactical", "mems"])
def test_noise_of_healthy_sensors_is_found(grade: str) -> None:
    """From the preset, whose noise is up to ten times theirs; that of the gyros as far as these dives show it."""
    config = load_config(grade)
    sensors = GRADES[grade]
    for seed in range(6100, 6103):
        found = calibrated(
            built_in_otherwise("calibration", seed, DvlErrors(), config=config, grade=grade)
        )
        after = found.noise.after
        assert {row.status for row in found.noise_rows} == {Estimated.ESTIMATED}
        assert after["beam_sd_mps"] == pytest.approx(DvlErrors().beam_sd_mps, rel=0.1)
        assert abs(np.log(after["accel_white_mps_rts"] / sensors.accel_white_mps_rts)) < np.log(
            2.0
        )
        assert abs(np.log(after["gyro_white_rad_rts"] / sensors.gyro_white_rad_rts)) < np.log(4.0)


@pytest.mark.nightly
def test_noise_too_small_to_be_seen_is_that_of_the_class_of_the_imu() -> None:
    """Accelerometers of `fog` add 0.1 mm/s in the second between pings, of which the DVL says 4 mm/s; gyros even less.

    No dive shows more than a limit, by which a filter would be too sure. The noise of the DVL is found all the same.
    """
    class_noise = load_config("fog").noise
    imu_noise = {
        "accel_white_mps_rts": class_noise.accel_white_mps_rts,
        "gyro_white_rad_rts": class_noise.gyro_white_rad_rts,
    }
    other = msgspec.structs.replace(
        class_noise, **{key: 3.0 * value for key, value in imu_noise.items()}
    )
    for seed in range(6100, 6103):
        for configured in (class_noise, other):
            config = msgspec.structs.replace(load_config("fog"), noise=configured)
            found = calibrated(
                built_in_otherwise("calibration", seed, DvlErrors(), config=config, grade="fog")
            )
            rows = {row.parameter: row for row in found.noise_rows}
            assert rows["beam_sd_mps"].status == Estimated.ESTIMATED
            beam_sd_mps = found.noise.after["beam_sd_mps"]
            assert beam_sd_mps == pytest.approx(DvlErrors().beam_sd_mps, rel=0.1)
            for key, of_class in imu_noise.items():
                assert found.noise.after[key] == of_class > getattr(GRADES["fog"], key)
                is_class = getattr(configured, key) == of_class
                expected = Estimated.NOT_DETERMINED if is_class else Estimated.OF_CLASS
                assert rows[key].status == expected
                assert rows[key].is_proposed != is_class


def test_a_straight_line_reports_no_noise_to_be_applied() -> None:
    """What is wrong in a geometry that nobody knows would be taken for noise, unless noise alone is asked for."""
    straight = built_in_otherwise("straight", 0, duration_s=200.0)
    held, alone = (
        calibrated(straight, only=("arm", "noise")),
        calibrated(straight, only=("noise",)),
    )
    assert {row.status for row in held.noise_rows} == {Estimated.HELD}
    assert not held.proposes_noise
    of_noise = {row.parameter: row for row in alone.noise_rows}
    assert of_noise["beam_sd_mps"].status == Estimated.ESTIMATED
    assert alone.proposes_noise
    assert alone.after == alone.before


def test_noise_that_the_baseline_has_of_its_own_is_not_proposed() -> None:
    own = msgspec.structs.replace(CONFIG.filters["baseline"], gyro_white_rad_rts=1e-6)
    config = msgspec.structs.replace(CONFIG, filters={"baseline": own})
    found = calibrated(
        built_in_otherwise("calibration", 1, duration_s=150.0, config=config),
        only=("arm", "noise"),
    )
    told = {row.parameter: row.status for row in found.noise_rows}
    assert told["gyro_white_rad_rts"] == Estimated.HELD
    assert told["accel_white_mps_rts"] != Estimated.HELD
    assert "gyro_white_rad_rts =" not in calibration_toml(found, [0])


def test_noise_of_a_dvl_alone_is_as_sure_as_so_many_normal_numbers_make_it() -> None:
    """Beside an IMU that is far less noisy: the logarithm of a standard deviation has 1 / (2 n) as variance."""
    dive = as_read(
        add_errors(exact_dive("static", duration_s=150.0), GRADES["fog"], WHITE, 1), QUIET
    ).innovations()
    before = noise_of(dive.filter)
    sds = relative_sds(FittedNoise(before, before), [dive], [np.zeros(len(NAMES))])
    assert sds[2] == pytest.approx((2.0 * 3.0 * dive.count) ** -0.5, rel=0.25)
    assert sds[0] > UNSURE
    assert sds[1] > UNSURE


def test_slow_errors_that_explain_innovations_leave_noise_undetermined() -> None:
    dive = as_read(
        add_errors(exact_dive("static", duration_s=60.0), GRADES["fog"], WHITE, 1), QUIET
    ).innovations()
    before = noise_of(dive.filter)
    as_before, none = FittedNoise(before, before), np.zeros(len(NAMES))
    sure, unsure = (relative_sds(as_before, [dive], [none], nis) for nis in (0.0, 30.0))
    assert (unsure > sure).all()
    kept, rows = determined_noise(as_before, [dive], [none], 30.0, QUIET.filters["baseline"])
    status = {row.parameter: row.status for row in rows}
    assert status["accel_white_mps_rts"] == Estimated.NOT_DETERMINED
    assert kept.after["accel_white_mps_rts"] == before["accel_white_mps_rts"]
    assert status["beam_sd_mps"] == Estimated.ESTIMATED


def still_dive() -> DiveInnovations:
    read = add_errors(exact_dive("static", duration_s=60.0), GRADES["fog"], WHITE, 1)
    return as_read(read, QUIET).innovations()


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_levelled_noise_has_a_mean_nis_of_its_degrees_of_freedom(factor: float) -> None:
    dive = still_dive()
    none = np.zeros(len(NAMES))
    before = noise_of(dive.filter)
    configured = {key: factor * value for key, value in before.items()}
    found = levelled(FittedNoise(configured, configured), [dive], [none])
    assert nis_per_dof(found.applied(dive), none) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(
    ("share", "expected"), [(0.09, Estimated.ESTIMATED), (0.11, Estimated.NOT_DETERMINED)]
)
def test_noise_of_the_imu_is_undetermined_where_slow_errors_explain_a_tenth_of_the_nis(
    share: float, expected: Estimated, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the likelihood alone would be sure of it."""
    monkeypatch.setattr(noise, "relative_sds", lambda *_: np.full(3, 0.1))
    dive = still_dive()
    before = noise_of(dive.filter)
    _, rows = determined_noise(
        FittedNoise(before, before),
        [dive],
        [np.zeros(len(NAMES))],
        share * 3.0 * dive.count,
        QUIET.filters["baseline"],
    )
    status = {row.parameter: row.status for row in rows}
    assert status["accel_white_mps_rts"] == expected
    assert status["beam_sd_mps"] == Estimated.ESTIMATED


def test_dives_contradict_a_noise_that_is_less_likely_by_three_standard_deviations() -> None:
    dive = still_dive()
    changes = [np.zeros(len(NAMES))]
    before = noise_of(dive.filter)
    fitted = fit_noise([dive], changes)
    search = noise._Search.of(before, [dive], changes)
    least = search.likelihood(fitted.after)
    contradicted = {}
    for factor in np.geomspace(1.0, 2.0, 25):
        after = fitted.after | {"beam_sd_mps": factor * fitted.after["beam_sd_mps"]}
        less_likely_by = search.likelihood(after) - least
        proposed = FittedNoise(before, after)
        contradicted[less_likely_by] = noise._contradicts(proposed, fitted, [dive], changes)
    assert contradicted == {by: by > 9.0 for by in contradicted}
    assert any(1.0 < by <= 9.0 for by in contradicted)
    assert any(by > 9.0 for by in contradicted)


def test_next_to_a_noise_that_no_gyro_has_the_others_are_of_the_class_of_the_imu_and_a_limit() -> (
    None
):
    dive = as_read(
        add_errors(exact_dive("static", duration_s=60.0), GRADES["fog"], WHITE, 1), QUIET
    ).innovations()
    before, none = noise_of(dive.filter), np.zeros(len(NAMES))
    fitted = {
        key: 0.01 if key == "gyro_white_rad_rts" else 3.0 * value for key, value in before.items()
    }
    kept, rows = determined_noise(
        FittedNoise(before, fitted), [dive], [none], 0.0, QUIET.filters["baseline"]
    )
    told = {row.parameter: (row.status, row.why) for row in rows}
    assert told["gyro_white_rad_rts"][0] == Estimated.IMPLAUSIBLE
    assert told["accel_white_mps_rts"] == (Estimated.OF_CLASS, OF_CLASS.format(preset="fog"))
    assert kept.after["accel_white_mps_rts"] == load_config("fog").noise.accel_white_mps_rts
    assert told["beam_sd_mps"] == (Estimated.NOT_DETERMINED, AT_MOST)
    assert kept.after["gyro_white_rad_rts"] == before["gyro_white_rad_rts"]
    assert nis_per_dof(kept.applied(dive), none) < 1.1


def test_noise_that_no_sensor_has_is_not_written() -> None:
    """A DVL without noise."""
    found = calibrated(as_read(exact_dive("calibration", duration_s=60.0)), only=("noise",))
    assert Estimated.IMPLAUSIBLE in {row.status for row in found.noise_rows}
    assert not found.proposes_noise
    assert all(row.after == row.before for row in found.noise_rows)
    text = calibration_toml(found, [0])
    assert "less than DVLs can have" in text
    assert not re.search("^(beam|velocity|accel|gyro)", text, re.MULTILINE)


def test_a_derivative_that_looks_like_an_error_of_the_imu_keeps_what_its_prior_leaves() -> None:
    """Of k rows with weights of 1 alike in both the information is k, beside the 1 of the prior."""
    alike = np.ones((8, 3, 1))
    effects = np.zeros((8, 3, BEAM_ERRORS + 18))
    effects[:, :, BEAM_ERRORS : BEAM_ERRORS + 1] = alike
    near = Linearised(np.zeros((8, 3)), np.ones(3), alike, alike)
    fitted = Fit((np.arange(8),), PRIOR_SD, ALL, np.zeros(8), (near,))
    (left,) = with_estimated_imu_errors(fitted, [effects]).dives
    np.testing.assert_allclose(left.by_motion, alike / (24.0 + 1.0))


def test_errors_of_the_imu_count_in_the_standard_deviations() -> None:
    """Scales of 1500 ppm and axes 1 mrad off."""
    exact = exact_dive("calibration", duration_s=150.0, lever_arm_m=ARM_M)
    off = np.eye(3) + np.array(
        [[1.5e-3, 1e-3, -1e-3], [1e-3, -1.5e-3, 1e-3], [-1e-3, 1e-3, 1.5e-3]]
    )
    imu = replace(
        exact.imu,
        specific_force_b=exact.imu.specific_force_b @ off.T,
        angular_rate_b=exact.imu.angular_rate_b @ off,
    )
    dive = add_errors(replace(exact, imu=imu), GRADES["tactical"], DvlErrors(), 1)
    found = calibrated(as_read(dive, load_config("tactical")), only=("arm", "delay", "noise"))
    for row, truth in zip(found.rows[ARM], ARM_M, strict=True):
        assert abs(finite(row.change) - truth) < 3.0 * finite(row.sd)
        assert finite(row.sd) ** 2 >= finite(row.imu_sd) ** 2 + finite(row.formal_sd) ** 2
    surer = certainty_of(found.fit).sd[ARM][1:]
    assert (np.array([finite(row.sd) for row in found.rows[ARM][1:]]) > 1.2 * surer).all()


@pytest.mark.nightly
def test_wild_pings_do_not_make_the_noise_larger(eight: ReadDive) -> None:
    """The baseline's gate keeps them out; without it they would be the noise."""
    beams = eight.dive.dvl.beam_velocity_mps
    assert beams is not None
    wild = np.random.default_rng(5).random(len(beams)) < 0.02
    beams = np.where(wild[:, None], beams + 0.1, beams)
    shaken = replace(
        eight, dive=replace(eight.dive, dvl=replace(eight.dive.dvl, beam_velocity_mps=beams))
    )
    assert (
        calibrated(shaken).noise.after["beam_sd_mps"]
        < 1.5 * calibrated(eight).noise.after["beam_sd_mps"]
    )


@pytest.fixture(scope="module")
def eight() -> ReadDive:
    return built_in_otherwise("figure-eight", 3)


@pytest.fixture(scope="module")
def found(eight: ReadDive) -> Calibration:
    return calibrated(eight)


def test_what_was_put_in_is_found(found: Calibration) -> None:
    for row, truth in zip(found.rows, shown(TRUTH), strict=True):
        assert abs(finite(row.change) - truth) < 3.0 * finite(row.sd), row.parameter
    assert {row.parameter for row in found.estimated} >= {
        "delay",
        "mounting_z",
        "arm_x",
        "arm_y",
        "arm_z",
        "scale",
    }
    after = found.after
    assert after.lever_arm_m[:2] == pytest.approx(ARM_M[:2], abs=0.02)
    assert after.mounting_rpy_deg[2] == pytest.approx(YAW_DEG, abs=0.4)
    assert after.latency_s == pytest.approx(DELAY_S, abs=0.1)
    assert after.scale == pytest.approx(SCALE, abs=0.005)


def test_a_straight_line_moves_nothing_to_the_bit() -> None:
    held = calibrated(built_in_otherwise("straight", 0, duration_s=200.0))
    assert held.estimated == ()
    assert held.after == held.before
    assert not held.change.any()
    assert set(status(held).values()) == {Estimated.HELD}


@pytest.mark.nightly
def test_turns_alone_show_the_arm_in_their_plane_and_not_along_their_axis() -> None:
    found = calibrated(built_in_otherwise("lawnmower", 1), only=("arm",))
    assert status(found) == {
        **dict.fromkeys(NAMES, Estimated.NOT_ASKED),
        "arm_x": Estimated.ESTIMATED,
        "arm_y": Estimated.ESTIMATED,
        "arm_z": Estimated.HELD,
    }
    assert found.after.lever_arm_m[2] == found.before.lever_arm_m[2]


@pytest.mark.nightly
def test_turns_alone_next_to_errors_of_single_beams_err_as_much_as_is_said() -> None:
    """Beams that are off by 1 mm/s and 0.2 % say of a slow vehicle that its DVL is turned: that is held."""
    errors: dict[str, list[float]] = {}
    for seed in range(8000, 8008):
        found = calibrated(built_in_otherwise("lawnmower", seed, DvlErrors()))
        for row, truth in zip(found.rows, shown(TRUTH), strict=True):
            if row.status == Estimated.ESTIMATED:
                errors.setdefault(row.parameter, []).append(
                    (finite(row.change) - truth) / finite(row.sd)
                )
    of_sd = {name: float(np.sqrt(np.mean(np.square(of_one)))) for name, of_one in errors.items()}
    assert {"delay", "arm_x", "arm_y"} <= of_sd.keys()
    assert "mounting_z" not in of_sd
    assert max(of_sd.values()) < 1.5, of_sd


@pytest.mark.nightly
def test_a_few_wild_pings_hardly_move_it(eight: ReadDive) -> None:
    beams = eight.dive.dvl.beam_velocity_mps
    assert beams is not None
    wild = np.random.default_rng(5).random(len(beams)) < 0.05
    beams = np.where(wild[:, None], 10.0 * beams, beams)
    shaken = replace(
        eight, dive=replace(eight.dive, dvl=replace(eight.dive.dvl, beam_velocity_mps=beams))
    )
    before, after = fit([eight.innovations()], ALL), fit([shaken.innovations()], ALL)
    assert 10 < shaken.innovations().left_out < 0.08 * len(beams)
    moved = np.abs(mean_change(after) - mean_change(before)) / certainty_of(before).sd
    assert moved.max() < 1.0, dict(zip(NAMES, moved, strict=True))


@pytest.mark.nightly
def test_several_dives_share_a_vehicle_and_each_has_its_delay(eight: ReadDive) -> None:
    other = built_in_otherwise("figure-eight", 4)
    later = replace(
        other,
        dive=replace(
            other.dive,
            name="later",
            dvl=replace(other.dive.dvl, time_ns=other.dive.dvl.time_ns + 100_000_000),
        ),
    )
    found = calibrated(eight, later)
    first, second = found.dives
    assert finite(second.delay_s) - finite(first.delay_s) == pytest.approx(
        0.1, abs=4.0 * finite(first.delay_sd_s)
    )
    rows = {row.parameter: row for row in found.rows}
    assert finite(rows["arm_x"].formal_sd) < finite(calibrated(eight).rows[ARM.start].formal_sd)
    assert rows["arm_x"].between_dives_sd is not None
    assert finite(rows["arm_x"].birge) < 3.0
    assert calibrated(eight).rows[ARM.start].between_dives_sd is None


@pytest.mark.nightly
def test_a_dvl_turned_by_a_right_angle_is_found_or_refused_and_never_predicted() -> None:
    turned = built_in_otherwise("figure-eight", 6, yaw_deg=90.0)
    astray = calibrated(turned)
    assert status(astray)["mounting_z"] != Estimated.ESTIMATED or astray.after.mounting_rpy_deg[
        2
    ] == pytest.approx(90.0, abs=1.0)
    mounting = likeliest_mounting([turned])
    assert mounting == pytest.approx((0.0, 0.0, 90.0))
    config = msgspec.structs.replace(
        CONFIG, dvl=msgspec.structs.replace(CONFIG.dvl, mounting_rpy_deg=mounting)
    )
    found = calibrated(turned.with_config(config))
    assert found.after.mounting_rpy_deg[2] == pytest.approx(90.0, abs=0.5)
    assert found.after.lever_arm_m[:2] == pytest.approx(ARM_M[:2], abs=0.03)


@pytest.mark.nightly
def test_a_dive_that_hardly_rolls_does_not_lay_the_dvl_on_its_back() -> None:
    """Turned about its course by half a turn a DVL says the same of a vehicle that stays level, but for noise."""
    for seed in range(6000, 6005):
        turned = built_in_otherwise("figure-eight", seed, DvlErrors(), yaw_deg=90.0)
        assert likeliest_mounting([turned]) == pytest.approx((0.0, 0.0, 90.0)), seed


def test_scatter_of_an_axis_is_the_standard_deviation_of_normal_residuals_and_not_of_wild_ones() -> (
    None
):
    sd = np.array([0.5, 1.0, 20.0])
    # In equal steps of their probability.
    residuals = np.outer(norm.ppf((np.arange(2000) + 0.5) / 2000), sd)
    assert scatter_of(residuals) == pytest.approx(sd, rel=1e-3)
    residuals[::100] = 1e6
    assert scatter_of(residuals) == pytest.approx(sd, rel=0.02)


def test_axes_are_the_24_right_handed_ones() -> None:
    assert len({tuple(turn.ravel()) for turn in AXES}) == 24
    for turn in AXES:
        np.testing.assert_array_equal(turn @ turn.T, np.eye(3))
        assert np.linalg.det(turn) == pytest.approx(1.0)
        # As they are written in settings.
        np.testing.assert_allclose(mat_from_rpy(rpy_from_mat(turn)), turn, atol=1e-12)


def test_ways_with_which_the_beams_of_a_dvl_look_up_or_aside_are_not_tried() -> None:
    ways = possible_axes(
        DvlColumns(np.arange(3), velocity_d=np.zeros((3, 3)), look_d=np.array([0.0, -0.9, 0.1]))
    )
    assert len(ways) == 4
    assert all((turn @ [0.0, -1.0, 0.0])[2] == 1.0 for turn in ways)


def test_sum_of_correlated_scores_scatters_as_newey_and_west_say() -> None:
    """An autoregressive series: its long-run variance is 1 / (1 - rho)^2 of its innovations'."""
    rng, rho, n = np.random.default_rng(7), 0.4, 4000
    series = rng.standard_normal((n, 1))
    for k in range(1, n):
        series[k] += rho * series[k - 1]
    assert newey_west(series)[0, 0] / n == pytest.approx(1.0 / (1.0 - rho) ** 2, rel=0.15)


def test_a_fragment_is_read_back_and_replays_the_proposal(
    found: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / "calibrated.toml"
    path.write_text(calibration_toml(found, [1_700_000_000_000_000_000]), "utf-8")
    dvl = load_config("fog", [path]).dvl
    assert dvl.lever_arm_m == pytest.approx(found.after.lever_arm_m, abs=1e-6)
    assert dvl.mounting_rpy_deg == pytest.approx(found.after.mounting_rpy_deg, abs=1e-6)
    assert (dvl.latency_s, dvl.scale) == pytest.approx(
        (found.after.latency_s, found.after.scale), abs=1e-6
    )
    text = path.read_text("utf-8")
    assert re.search(r"\b1 dive\b.* 2023-11-14.* figure-eight", text)
    assert all(f"# {row.parameter}: " in text for row in found.rows)


def test_a_dive_that_was_not_fitted_says_whether_it_helped(found: Calibration) -> None:
    row = held_out_row(built_in_otherwise("figure-eight", 9), found.change)
    assert finite(row.nis_per_dof_after) < 0.2 * finite(row.nis_per_dof_before)
    assert row.windows >= 2
    assert finite(row.drift_after_m) < finite(row.drift_before_m)


@pytest.mark.nightly
def test_perfect_settings_are_left_where_they_are() -> None:
    exact = as_read(exact_dive("figure-eight", duration_s=250.0))
    found = calibrated(exact)
    assert np.abs(shown(found.change)).max() < 0.002


def test_parameters_have_groups_that_can_be_asked_for() -> None:
    assert {parameter.group for parameter in PARAMETERS} == {"arm", "mounting", "delay", "scale"}
    assert NAMES[DELAY] == "delay"
    assert NAMES[MOUNTING] == ("mounting_x", "mounting_y", "mounting_z")


# --- Real dives.


@pytest.mark.nightly
def test_dives_of_snapir_tell_the_arm_that_others_confirm(snapir: Path) -> None:
    """From the arm of another point, 1.8 m off: four dives tell it, and four others confirm it.

    The mounting is that of the example, within some of the sds that are said.
    """
    config = load_config(
        "fog", SNAPIR, ["dvl.lever_arm_m=[-1.834,0,0.3]", "dvl.mounting_rpy_deg=[0,0,0]"]
    )
    dives = {
        name: read_dive(snapir / f"snapir_{name}.mcap", config)
        for name in ("01", "02", "05", "08", "07", "09", "11")
    }
    found = calibrated(*(dives[name] for name in ("01", "02", "05", "08")))
    assert found.after.lever_arm_m == pytest.approx((-0.076, -0.011, 0.199), abs=0.02)
    assert found.after.mounting_rpy_deg == pytest.approx((-0.12, 0.01, -0.27), abs=0.1)
    assert max(finite(row.birge) for row in found.rows if row.parameter.startswith("arm")) < 3.0
    others = [held_out_row(dives[name], found.change) for name in ("07", "09", "11")]
    for row in others:
        assert finite(row.nis_per_dof_after) < 0.1 * finite(row.nis_per_dof_before)
    drifts = np.array([[finite(row.drift_before_m), finite(row.drift_after_m)] for row in others])
    assert np.median(drifts[:, 0] / drifts[:, 1]) > 2.0


@pytest.mark.nightly
@pytest.mark.parametrize("dive", ["auto_square", "gnss_challenging"])
def test_dives_of_blueye_tell_the_documented_arm_and_how_late_it_is(
    blueye: Path, dive: str
) -> None:
    """The arm of the vehicle's description, from an arm of zero and no delay."""
    config = load_config(file=BLUEYE, overrides=["dvl.lever_arm_m=[0,0,0]", "dvl.latency_s=0.0"])
    found = calibrated(read_dive(blueye / f"{dive}.mcap", config))
    assert found.after.lever_arm_m == pytest.approx((-0.17, 0.0, 0.26), abs=0.05)
    assert 0.10 < found.after.latency_s < 0.16


@pytest.mark.nightly
@pytest.mark.parametrize("dive", ["run_1", "run_2"])
def test_dives_of_ufmil_tell_that_the_dvl_is_turned_by_a_right_angle(
    ufmil: Path, dive: str
) -> None:
    config = load_config(file=UFMIL, overrides=["dvl.mounting_rpy_deg=[0,0,0]"])
    read = read_dive(ufmil / f"{dive}.mcap", config)
    mounting = likeliest_mounting([read])
    assert mounting == pytest.approx((0.0, 0.0, 90.0))
    turned = msgspec.structs.replace(config.dvl, mounting_rpy_deg=mounting)
    found = calibrated(read.with_config(msgspec.structs.replace(config, dvl=turned)))
    assert found.after.mounting_rpy_deg[2] == pytest.approx(90.0, abs=3.0)
    assert 0.06 < found.after.latency_s < 0.10


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("example", "dives"), [("snapir", "snapir"), ("blueye_x3", "blueye_x3"), ("ufmil", "ufmil")]
)
def test_examples_are_what_their_target_makes(example: str, dives: str, tmp_path: Path) -> None:
    """As `make calibrated` does it, and near the numbers with which the examples are replayed."""
    if not (SHARED / dives).is_dir():
        pytest.skip(f"needs ../shared/data/{dives} (real dives)")
    recipes = re.findall(
        r"^\t\$\(BIN\)/insdvl-replay (calibrate .*)$", MAKEFILE.read_text("utf-8"), re.MULTILINE
    )
    unknown = re.search(r"^UNKNOWN := (.*)$", MAKEFILE.read_text("utf-8"), re.MULTILINE)
    assert unknown is not None
    (recipe,) = (recipe for recipe in recipes if f"-c examples/{example}.toml" in recipe)
    made = tmp_path / "made.toml"
    quiet = " ".join(
        f"$(DATA)/snapir/snapir_{run}.mcap" for run in ("01", "02", "05", "07", "08", "12")
    )
    recipe = (
        recipe.replace("$(UNKNOWN)", unknown[1])
        .replace("$(QUIET)", quiet)
        .replace("$(DATA)", str(SHARED))
    )
    recipe = recipe.replace(f"examples/calibrated/{example}.toml", str(made))
    recipe = recipe.replace("-c examples/", f"-c {SNAPIR.parent}/")
    assert run_command_line(shlex.split(recipe)) == 0
    kept = SNAPIR.parent / "calibrated" / f"{example}.toml"
    assert made.read_text("utf-8") == kept.read_text("utf-8")
    found, used = (
        load_config(file=kept).dvl,
        load_config(file=SNAPIR.with_name(f"{example}.toml")).dvl,
    )
    assert used.lever_arm_m == pytest.approx(found.lever_arm_m, abs=1e-3)
    assert used.mounting_rpy_deg == pytest.approx(found.mounting_rpy_deg, abs=5e-3), (
        "an eighth of the smallest sd"
    )
    assert used.latency_s == pytest.approx(found.latency_s, abs=1e-3)
    if example != "blueye_x3":  # its scale is the track's, its noise the stamps'
        assert used.scale == pytest.approx(found.scale, abs=1e-4)
        # All dives of the Snapir together are noisier than the six that tell its geometry.
        assert (used.beam_sd_mps or 0.0) == pytest.approx(found.beam_sd_mps or 0.0, rel=0.15)
