"""A heading that only positions tell is found, with the gyro's bias, as surely as is said, or it is said that not."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.states import DEG_PER_HOUR
from insdvl_replay.evaluation.drift import heading_fit
from insdvl_replay.logs import write_dive
from insdvl_replay.nav.timeline import Gaps
from insdvl_replay.preparation.prepared import with_reference_at_imu
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import _before_a_gap, _tracked, fitted_start
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

FIT = "initial.heading_deg=fit"
M_TO_RAD = 1.0 / 6.37e6


def among_positions(truth: Dive, seed: int, bias_degph: float, grade: str = "mems") -> Dive:
    """Leave a reference its positions, with 1 m of noise, and let the gyro about down be off by what is known."""
    assert truth.reference is not None
    dive = add_errors(truth, replace(GRADES[grade], gyro_bias_sd_radps=0.0), DvlErrors(), seed)
    rate_b = dive.imu.angular_rate_b + np.array([0.0, 0.0, bias_degph * DEG_PER_HOUR])
    position = truth.reference.position.copy()
    position[:, :2] += M_TO_RAD * np.random.default_rng(seed).standard_normal((len(position), 2))
    nothing = {
        name: np.full_like(getattr(truth.reference, name), np.nan)
        for name in ("mat_nb", "velocity_n")
    }
    return replace(
        dive,
        imu=replace(dive.imu, angular_rate_b=rate_b),
        reference=replace(truth.reference, position=position, **nothing),
    )


def heading_deg(mat_nb: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(mat_nb[1, 0], mat_nb[0, 0])))


def turned_deg(one: float, other: float) -> float:
    return (one - other + 180.0) % 360.0 - 180.0


@pytest.fixture(scope="module")
def truth() -> Dive:
    return exact_dive("calibration", duration_s=300.0, imu_rate_hz=50.0)


@pytest.fixture(scope="module")
def long_truth() -> Dive:
    """All the manoeuvres, which determine the bias to 10 deg/h."""
    return exact_dive("calibration")


@pytest.mark.nightly
def test_heading_and_bias_err_as_much_as_is_said(long_truth: Dive) -> None:
    assert long_truth.reference is not None
    start_deg, config = (
        heading_deg(long_truth.reference.mat_nb[0]),
        load_config("mems", overrides=[FIT]),
    )
    errors = []
    for seed in range(20):
        bias_degph = 100.0 * np.random.default_rng([seed, 1]).standard_normal()
        found = fitted_start(
            with_reference_at_imu(among_positions(long_truth, seed, bias_degph), config), config
        )
        heading = turned_deg(found.heading_deg, start_deg) / found.heading_sd_deg
        errors.append((heading, (found.gyro_bias_degph - bias_degph) / found.gyro_bias_sd_degph))
        assert found.heading_sd_deg < 1.0
        assert found.gyro_bias_sd_degph < 10.0
    of_sd = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ((of_sd > 0.6) & (of_sd < 1.5)).all(), of_sd


@pytest.mark.nightly
def test_fixes_at_both_ends_of_a_dive_give_a_heading_that_errs_as_much_as_is_said(
    truth: Dive,
) -> None:
    """A vehicle has fixes before it dives and after it surfaces, and none in between."""
    reference = reference_of(truth)
    start_deg = heading_deg(reference.mat_nb[0])
    config = load_config("tactical", overrides=[FIT])
    errors = []
    for seed in range(20):
        dive = surfaced(among_positions(truth, seed, 1.0, "tactical"), 40.0)
        found = fitted_start(with_reference_at_imu(dive, config), config)
        errors.append(turned_deg(found.heading_deg, start_deg) / found.heading_sd_deg)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def reference_of(dive: Dive) -> ReferenceColumns:
    assert dive.reference is not None
    return dive.reference


def surfaced(dive: Dive, length_s: float) -> Dive:
    """Leave a reference the positions of the beginning and of the end, each so long."""
    reference = reference_of(dive)
    time_s = (reference.time_ns - reference.time_ns[0]) * 1e-9
    position = reference.position.copy()
    position[(time_s > length_s) & (time_s < time_s[-1] - length_s)] = np.nan
    return replace(dive, reference=replace(reference, position=position))


def test_a_pause_of_the_reference_does_not_hide_a_heading(truth: Dive) -> None:
    """Half a minute of fixes before and behind a pause are enough, as a minute without one is."""
    config = load_config("tactical", overrides=[FIT])
    dive = surfaced(among_positions(truth, 3, 0.0, "tactical"), 30.0)
    found = fitted_start(with_reference_at_imu(dive, config), config)
    start_deg = heading_deg(reference_of(truth).mat_nb[0])
    assert found.heading_sd_deg < 2.0
    assert turned_deg(found.heading_deg, start_deg) == pytest.approx(
        0.0, abs=4.0 * found.heading_sd_deg
    )


def test_a_replay_starts_from_what_it_fits_and_says_so(truth: Dive) -> None:
    assert truth.reference is not None
    dive = among_positions(truth, 31, 200.0)
    replay = replay_dive(dive, once("mems"))
    (note,) = (note for note in replay.notes if note.code == "start_heading_fitted")
    started_deg = heading_deg(replay.histories[0].mat_nb[0])
    assert turned_deg(started_deg, heading_deg(truth.reference.mat_nb[0])) == pytest.approx(
        0.0, abs=1.0
    )
    assert f"{started_deg % 360.0:.2f} +- " in note.text
    assert replay.config.initial.heading_deg == "fit"


def once(preset: str, *overrides: str) -> Config:
    return load_config(preset, overrides=[FIT, "evaluation.starts=1", *overrides])


def test_what_is_known_of_the_bias_is_one_measurement_more() -> None:
    """A straight track that is made of its derivatives, and noise: the prior's and the track's share are known."""
    time_ns = np.arange(400) * 1_000_000_000
    track_m = np.stack([2.0 * np.arange(400.0), np.zeros(400)], axis=1)
    per_heading_m = np.stack([np.zeros(400), track_m[:, 0]], axis=1)
    per_bias_m = np.stack([np.zeros(400), np.arange(400.0) ** 2], axis=1)
    noise_m = np.cumsum(0.05 * np.random.default_rng(3).standard_normal((400, 2)), axis=0)
    reference_m = 1.02 * track_m + 0.1 * per_heading_m + 1e-4 * per_bias_m + noise_m
    unknown = heading_fit(time_ns, track_m, per_heading_m, per_bias_m, reference_m, (0.0, 1.0))
    known = heading_fit(time_ns, track_m, per_heading_m, per_bias_m, reference_m, (2e-5, 1e-12))
    assert unknown is not None
    assert known is not None
    assert unknown.bias == pytest.approx(1e-4, abs=4.0 * unknown.bias_sd)
    assert unknown.heading == pytest.approx(0.1, abs=4.0 * unknown.heading_sd)
    assert known.bias == pytest.approx(-2e-5, abs=1e-9)
    assert known.heading_sd < unknown.heading_sd
    assert known.heading - unknown.heading == pytest.approx(
        (unknown.bias + 2e-5) * 400.0 / 2.0, rel=0.3
    )


def test_drift_in_a_pause_of_the_dvl_does_not_turn_the_heading() -> None:
    """Behind a pause the track is 15 m aside; each piece has its own shift, and the heading is that of both."""
    second = np.append(np.arange(200), np.arange(230, 400))
    time_ns = second * 1_000_000_000
    track_m = np.stack([100.0 * np.sin(0.02 * second), 60.0 * np.sin(0.04 * second)], axis=1)
    per_heading_m = np.stack([-track_m[:, 1], track_m[:, 0]], axis=1)
    per_bias_m = 0.5 * second[:, None] * per_heading_m
    noise_m = np.cumsum(0.01 * np.random.default_rng(3).standard_normal((len(second), 2)), axis=0)
    reference_m = track_m + 0.1 * per_heading_m + noise_m
    reference_m[200:] += [9.0, -12.0]
    columns = (time_ns, track_m, per_heading_m, per_bias_m, reference_m, (0.0, 1e-9))
    whole = heading_fit(*columns)
    pieces = heading_fit(*columns, piece=(second >= 230).astype(np.int64))
    assert whole is not None
    assert pieces is not None
    assert pieces.heading == pytest.approx(0.1, abs=0.003)
    assert pieces.heading_sd < 0.2 * whole.heading_sd


def test_times_without_dvl_are_in_no_piece() -> None:
    ping_ns = np.append(np.arange(10, 50), np.arange(80, 100)) * 1_000_000_000
    time_ns = np.arange(0, 120) * 1_000_000_000
    kept_ns, piece = _tracked(time_ns, ping_ns)
    np.testing.assert_array_equal(kept_ns // 1_000_000_000, [*range(5, 50), *range(80, 105)])
    np.testing.assert_array_equal(np.bincount(piece), [45, 25])


def test_the_track_behind_a_gap_of_the_imu_does_not_tell_the_heading_at_the_start() -> None:
    second = np.arange(0, 100, dtype=np.int64) * 1_000_000_000
    gaps = Gaps(second[60:61], second[64:65], np.zeros((1, 12)))
    np.testing.assert_array_equal(_before_a_gap(second, gaps), second[:61])
    np.testing.assert_array_equal(_before_a_gap(second, gaps.where(np.zeros(1, np.bool_))), second)
    early = Gaps(second[10:11], second[14:15], np.zeros((1, 12)))
    np.testing.assert_array_equal(_before_a_gap(second, early), second)


def test_a_dive_whose_track_reports_no_heading_says_so(truth: Dive) -> None:
    dive = among_positions(truth, 5, 0.0)
    with pytest.raises(LogError, match="start heading"):
        replay_dive(dive, once("mems", "span.end_s=25"))
    assert dive.reference is not None
    nowhere = replace(
        dive,
        reference=replace(dive.reference, position=np.full_like(dive.reference.position, np.nan)),
    )
    level = once("mems", "initial.source=level", "initial.latitude_deg=32.8")
    with pytest.raises(ConfigError, match="positions"):
        replay_dive(replace(nowhere, reference=None), level)


def test_an_attitude_to_start_from_goes_before_it() -> None:
    dive = exact_dive("figure-eight", duration_s=100.0)
    fitted, configured = (
        replay_dive(dive, load_config("fog", overrides=of)) for of in ([FIT], [])
    )
    np.testing.assert_array_equal(fitted.histories[0].mat_nb, configured.histories[0].mat_nb)
    assert not any(note.code == "start_heading_fitted" for note in fitted.notes)


@pytest.mark.nightly
def test_commands_take_it_from_a_file(
    truth: Dive, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, settings = tmp_path / "dive.mcap", tmp_path / "settings.toml"
    write_dive(log, among_positions(truth, 6, 50.0))
    settings.write_text('[initial]\nheading_deg = "fit"\n', "utf-8")
    command = [str(log), "-c", str(settings), "--preset", "mems"]
    assert run_command_line(["run", *command, "-o", str(tmp_path / "out"), "--starts", "1"]) == 0
    assert run_command_line(["calibrate", *command, "--reference", "--format", "json"]) == 0
    result = msgspec.json.decode(capsys.readouterr().out.partition("{")[2].join(["{", ""]))
    assert result["config"]["initial"]["heading_deg"] == "fit"
    (start,) = result["tables"]["starts"]
    assert truth.reference is not None
    off_deg = turned_deg(start["heading_deg"], heading_deg(truth.reference.mat_nb[0]))
    assert abs(off_deg) < 3.0 * start["heading_sd_deg"] < 3.0
    assert abs(start["gyro_bias_degph"] - 50.0) < 3.0 * start["gyro_bias_sd_degph"]
    found = tmp_path / "found.toml"
    assert run_command_line(["calibrate", *command, "--reference", "-o", str(found)]) == 0
    assert load_config("mems", found).initial.heading_deg == "fit"
    assert "positions" in capsys.readouterr().out
    assert (
        run_command_line(
            ["run", str(log), "--set", "initial.heading_deg=north", "-o", str(tmp_path / "no")]
        )
        == 2
    )
    assert "initial.heading_deg" in capsys.readouterr().err
