"""Beside a reference: its arm, mounting and clock and the DVL's scale are found as surely as is said."""

import json
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
from built_in import CONFIG, WHITE

from insdvl_replay.calibration.calibration import Calibration, calibrate
from insdvl_replay.calibration.innovations import (
    CLOCK,
    REFERENCE_ARM,
    REFERENCE_GROUPS,
    REFERENCE_MOUNTING,
    SHARED,
    Geometry,
    ReadDive,
)
from insdvl_replay.calibration.output import calibration_result, calibration_toml
from insdvl_replay.calibration.reference import ATTITUDE, MOTION, reference_dive, with_reference
from insdvl_replay.calibration.rows import ParameterRow
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns, nanoseconds, seconds
from insdvl_replay.core.errors import LogError
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Estimated
from insdvl_replay.document.render import document, render
from insdvl_replay.document.text import for_terminal
from insdvl_replay.geometry.rotation import mat_from_rpy
from insdvl_replay.preparation.prepared import reference_at_imu, with_reference_at_imu
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES

ARM_M, YAW_DEG, CLOCK_S, SCALE = (0.5, -0.2, 0.3), 0.5, 0.2, 1.01
PUT_IN = {
    "reference_clock": CLOCK_S,
    "reference_mounting_z": YAW_DEG,
    **{f"reference_arm_{axis}": value for axis, value in zip("xyz", ARM_M, strict=True)},
    "scale": 100.0 * float(np.log(SCALE)),
}
SEEDS = range(5100, 5120)
KNOWN_NOISE = msgspec.structs.replace(
    CONFIG,
    noise=msgspec.structs.replace(
        CONFIG.noise,
        accel_white_mps_rts=GRADES["fog"].accel_white_mps_rts,
        gyro_white_rad_rts=GRADES["fog"].gyro_white_rad_rts,
    ),
)


@cache
def exact(scenario: str, duration_s: float | None = None) -> Dive:
    return exact_dive(scenario, duration_s=duration_s)


def beside(
    scenario: str,
    seed: int,
    *,
    velocity: bool = True,
    attitude: bool = True,
    config: Config = CONFIG,
    duration_s: float | None = None,
) -> ReadDive:
    """Simulate a dive beside a reference that sits elsewhere, is turned and late; its DVL reads too much."""
    truth = exact(scenario, duration_s)
    assert truth.reference is not None
    dive = add_errors(truth, GRADES["fog"], WHITE, seed)
    reference = elsewhere(truth)
    if not velocity:
        reference = replace(reference, velocity_n=np.full_like(reference.velocity_n, np.nan))
    if not attitude:
        reference = replace(reference, mat_nb=np.full_like(reference.mat_nb, np.nan))
    assert dive.dvl.beam_velocity_mps is not None
    dvl = replace(dive.dvl, beam_velocity_mps=SCALE * dive.dvl.beam_velocity_mps)
    late = replace(dive, reference=reference, dvl=dvl)
    # Where it has no attitude, the start is the configuration's.
    initial = (
        config.initial
        if attitude
        else msgspec.structs.replace(config.initial, heading_deg=heading_deg(truth))
    )
    config = msgspec.structs.replace(config, initial=initial)
    return ReadDive(with_reference_at_imu(late, config), config, reference)


def elsewhere(truth: Dive) -> ReferenceColumns:
    assert truth.reference is not None
    moved = reference_at_imu(truth.reference, truth.imu, -np.array(ARM_M))
    mat_br = mat_from_rpy(np.array([0.0, 0.0, YAW_DEG]) * DEG)
    late_ns = moved.time_ns + nanoseconds(CLOCK_S)
    late = replace(moved, mat_nb=moved.mat_nb @ mat_br, time_ns=late_ns)
    return late.rows(np.isfinite(late.velocity_n).all(axis=1))


def heading_deg(dive: Dive) -> float:
    assert dive.reference is not None
    return float(np.arctan2(dive.reference.mat_nb[0, 1, 0], dive.reference.mat_nb[0, 0, 0])) / DEG


def calibrated(*reads: ReadDive, only: tuple[str, ...] = REFERENCE_GROUPS) -> Calibration:
    asked = [read.innovations() for read in reads]
    return with_reference(calibrate(asked, reads[0].config, only), reads, asked, only)


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibrated(beside("figure-eight", 1))


def errors_of_sd(
    seeds: Iterable[int], config: Config, *, velocity: bool
) -> dict[str, list[float]]:
    """Return the errors of what was put in over their standard deviations, by parameter; all are estimated."""
    errors: dict[str, list[float]] = {name: [] for name in PUT_IN}
    for seed in seeds:
        read = beside("figure-eight", seed, velocity=velocity, config=config)
        rows = {row.parameter: row for row in calibrated(read).all_rows}
        for name, truth in PUT_IN.items():
            assert rows[name].status == Estimated.ESTIMATED, (seed, name)
            errors[name].append((finite(rows[name].change) - truth) / finite(rows[name].sd))
    return errors


@pytest.mark.nightly
@pytest.mark.parametrize("velocity", [True, False])
def test_errors_are_as_large_as_is_said(velocity: bool) -> None:
    """With velocities, and by positions alone, which see turns of the arm and the way; the noise of the IMU is known.

    The arm along down is half as far off as is said: how sure the DVL's own arm is enters as if it came from elsewhere,
    and it comes from the same dive.
    """
    errors = errors_of_sd(SEEDS, KNOWN_NOISE, velocity=velocity)
    of_sd = {name: float(np.sqrt(np.mean(np.square(found)))) for name, found in errors.items()}
    assert min(of_sd.values()) > 0.45, of_sd
    assert max(of_sd.values()) < 1.5, of_sd
    in_the_mean = {name: np.mean(found) * np.sqrt(len(SEEDS)) for name, found in errors.items()}
    assert max(abs(mean) for mean in in_the_mean.values()) < 3.5, in_the_mean


@pytest.mark.nightly
@pytest.mark.parametrize("velocity", [True, False])
def test_errors_are_at_most_as_large_as_is_said_with_the_noise_of_a_class(velocity: bool) -> None:
    """A preset has 50 times the noise of these accelerometers, which no dive shows."""
    seeds = SEEDS[:8]
    errors = errors_of_sd(seeds, CONFIG, velocity=velocity)
    of_sd = {name: float(np.sqrt(np.mean(np.square(found)))) for name, found in errors.items()}
    assert max(of_sd.values()) < 1.5, of_sd
    in_the_mean = {name: np.mean(found) * np.sqrt(len(seeds)) for name, found in errors.items()}
    assert max(abs(mean) for mean in in_the_mean.values()) < 3.5, in_the_mean


@pytest.mark.nightly
def test_perfect_sensors_show_what_was_put_in_although_the_start_is_the_references(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a filter that stayed at the start that a turned and late reference gives, the scale was off by 0.05 %."""
    perfect = {
        grade: replace(errors, **dict.fromkeys(vars(errors), 0.0))
        for grade, errors in GRADES.items()
    }
    monkeypatch.setattr(f"{__name__}.GRADES", perfect)
    monkeypatch.setattr(f"{__name__}.WHITE", replace(WHITE, beam_sd_mps=0.0, beam_quantum_mps=0.0))
    rows = {row.parameter: row for row in calibrated(beside("figure-eight", 1)).all_rows}
    assert finite(rows["scale"].change) == pytest.approx(PUT_IN["scale"], abs=0.01)
    assert finite(rows["reference_mounting_z"].change) == pytest.approx(YAW_DEG, abs=0.03)
    assert finite(rows["reference_clock"].change) == pytest.approx(CLOCK_S, abs=1e-3)


def test_what_was_put_in_is_found(found: Calibration) -> None:
    assert found.reference is not None
    after = found.reference.after
    assert after.lever_arm_m == pytest.approx(ARM_M, abs=0.1)
    assert after.lever_arm_m[:2] == pytest.approx(ARM_M[:2], abs=0.015)
    assert after.mounting_rpy_deg == pytest.approx((0.0, 0.0, YAW_DEG), abs=0.3)
    assert after.latency_s == pytest.approx(CLOCK_S, abs=0.001)
    assert found.after.scale == pytest.approx(SCALE, abs=0.0015)
    (dive,) = found.reference.dives
    # The noise of the class of the IMU, which is more than that of this one, lets the filter follow its pings.
    assert dive.rms_after < 0.15 * dive.rms_before
    assert finite(dive.track_scale_before_pct) < -0.4
    assert abs(finite(dive.track_scale_after_pct)) < 0.2


@pytest.mark.nightly
def test_a_straight_line_shows_neither_arm_nor_whose_axes_are_turned() -> None:
    held = calibrated(beside("straight", 2, duration_s=150.0))
    assert held.reference is not None
    rows = {row.parameter: row for row in held.reference.rows}
    for name in ("reference_arm_x", "reference_arm_y", "reference_arm_z", "reference_mounting_z"):
        assert rows[name].status == Estimated.HELD, name
        assert rows[name].why
    assert held.reference.after.lever_arm_m == held.reference.before.lever_arm_m
    assert held.after.scale == pytest.approx(SCALE, abs=0.002)


@pytest.mark.nightly
def test_a_reference_whose_axes_are_known_reports_the_heading_of_the_dvl() -> None:
    """On a straight line, too: the sum of both turns is seen, and all of it is given to the DVL."""
    told = calibrated(beside("straight", 2), only=("mounting", "scale"))
    assert told.reference is not None
    assert told.reference.after == told.reference.before
    assert {row.status for row in told.reference.rows} == {Estimated.NOT_ASKED}
    # The DVL is in line with the IMU; the reference, taken to be so, is half a degree off.
    assert told.after.mounting_rpy_deg[2] == pytest.approx(-YAW_DEG, abs=0.1)


@pytest.mark.nightly
def test_without_attitude_clock_and_scale_alone_are_reported() -> None:
    told = calibrated(beside("figure-eight", 3, attitude=False))
    assert told.reference is not None
    rows = {row.parameter: row for row in told.reference.rows}
    held = [name for name in rows if name != "reference_clock"]
    assert len({rows[name].why for name in held}) == 1
    assert all("attitude" in rows[name].why for name in held)
    assert told.reference.after.lever_arm_m == told.reference.before.lever_arm_m
    scale = told.rows[-1]
    assert scale.status == Estimated.ESTIMATED
    assert abs(finite(scale.change) - PUT_IN["scale"]) < 3.0 * finite(scale.sd)


def test_what_reference_and_baseline_differ_by_has_its_closed_form() -> None:
    """Of exact sensors: derivatives by clock, mounting and arm, against motion that is known."""
    truth = exact("figure-eight")
    assert truth.reference is not None
    read = ReadDive(with_reference_at_imu(truth, CONFIG), CONFIG, truth.reference)
    geometry = Geometry.of(CONFIG.reference)
    dive = reference_dive(
        read.innovations(), truth.reference, geometry, np.zeros(8), gives_start=True
    )
    assert dive is not None
    none = np.zeros(len(SHARED))
    compared = dive.compared(none)
    assert np.abs(compared.values[compared.family == MOTION]).max() < 1e-3
    free = np.arange(len(SHARED)) >= CLOCK
    jacobian = dive.jacobian(none, free)[compared.family == MOTION]
    at = np.isin(truth.reference.time_ns, dive.reference.time_ns)
    time_s = seconds(truth.reference.time_ns, truth.imu.time_ns[0])
    velocity_b = np.einsum("kji,kj->ki", truth.reference.mat_nb, truth.reference.velocity_n)
    rate_b = np.column_stack(
        [
            np.interp(time_s, seconds(truth.imu.time_ns, truth.imu.time_ns[0]), of)
            for of in truth.imu.angular_rate_b.T
        ]
    )
    for column in range(3):
        axis = np.eye(3)[column]
        np.testing.assert_allclose(
            jacobian[:, :, REFERENCE_ARM.start + column], np.cross(rate_b, axis)[at], atol=2e-3
        )
        np.testing.assert_allclose(
            jacobian[:, :, REFERENCE_MOUNTING.start + column],
            np.cross(velocity_b, axis)[at],
            atol=2e-3,
        )
    slope = np.gradient(velocity_b, time_s, axis=0)
    smooth = at & (np.abs(np.gradient(slope, axis=0)).max(axis=1) < 2e-3)
    assert smooth.sum() > 100
    np.testing.assert_allclose(jacobian[smooth[at]][:, :, CLOCK], -slope[smooth], atol=5e-3)
    assert np.abs(compared.values[compared.family == ATTITUDE]).max() < 1e-4


@pytest.mark.nightly
def test_dives_together_are_surer_and_their_scatter_is_reported(found: Calibration) -> None:
    second = beside("figure-eight", 2)
    both, other = calibrated(beside("figure-eight", 1), second), calibrated(second)
    assert both.reference is not None
    assert other.reference is not None
    assert found.reference is not None
    for together, alone in zip(both.reference.rows, found.reference.rows, strict=True):
        assert (alone.between_dives_sd, alone.birge) == (None, None)
        assert finite(together.sd) >= finite(together.between_dives_sd) > 0.0
    clock, *alone = (
        of_one.reference.rows[0] for of_one in (both, found, other) if of_one.reference is not None
    )
    information = sum(finite(row.formal_sd) ** -2.0 for row in alone)
    assert finite(clock.formal_sd) == pytest.approx(information**-0.5, rel=0.15)
    assert finite(clock.birge) < 3.0


@pytest.mark.nightly
def test_a_dependent_reference_is_doubted_and_none_is_an_error() -> None:
    read = beside("straight", 1, duration_s=60.0)
    settings = msgspec.structs.replace(read.config.reference, independent=False)
    told = calibrated(read.with_config(msgspec.structs.replace(read.config, reference=settings)))
    assert any("independent = false" in warning for warning in told.warnings)
    with pytest.raises(LogError, match="reference"):
        calibrated(replace(read, as_read=None))


@pytest.mark.nightly
def test_a_clock_that_is_off_by_more_than_is_looked_for_is_not_proposed() -> None:
    read = beside("figure-eight", 2)
    assert read.as_read is not None
    later = replace(read.as_read, time_ns=read.as_read.time_ns + nanoseconds(1.6))
    told = calibrated(replace(read, as_read=later))
    assert told.reference is not None
    row = told.reference.rows[0]
    assert (row.parameter, row.status) == ("reference_clock", Estimated.IMPLAUSIBLE)
    assert told.reference.after.latency_s == told.reference.before.latency_s


def test_files_and_screen_say_the_same(found: Calibration, tmp_path: Path) -> None:
    assert found.reference is not None
    path = tmp_path / "found.toml"
    path.write_text(calibration_toml(found, [1_700_000_000_000_000_000]), "utf-8")
    read_back = load_config("fog", [path]).reference
    after = found.reference.after
    assert read_back.lever_arm_m == pytest.approx(after.lever_arm_m, abs=1e-6)
    assert read_back.mounting_rpy_deg == pytest.approx(after.mounting_rpy_deg, abs=1e-6)
    assert read_back.latency_s == pytest.approx(after.latency_s, abs=1e-6)
    result = calibration_result(found, CONFIG)
    printed = json.loads(render(result, "json"))
    rows = msgspec.convert(printed["tables"]["parameters"], list[ParameterRow])
    assert rows == list(found.all_rows)
    assert printed["facts"]["after"]["reference"]["latency_s"] == after.latency_s
    assert "reference_arm_x" in render(result, "csv")
    assert for_terminal(document(result)) is not None


def test_the_command_asks_for_it_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(tmp_path / "dive.mcap")
    assert run_command_line(["simulate", "lawnmower", "-o", log, "--duration", "150"]) == 0
    capsys.readouterr()
    asked = ["calibrate", log, "--preset", "fog", "--only", "reference_clock,scale"]
    assert run_command_line(asked) == 2
    assert "reference_clock" in capsys.readouterr().err
    assert run_command_line([*asked, "--reference"]) == 0
    screen = capsys.readouterr().out
    assert "ref. clock [s]" in screen
