"""The noise of long and of fast dives is fitted to a bounded part, which gives what all of it would give."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insdvl_replay.calibration import division
from insdvl_replay.calibration.dives import calibrate_dives
from insdvl_replay.calibration.division import LONGEST_S, Division, beginning, bounded
from insdvl_replay.calibration.fitted_noise import _Parts, fit_noise_of_logs
from insdvl_replay.calibration.innovations import NOISE, ReadDive
from insdvl_replay.calibration.rows import NoiseRow
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import replay_log
from insdvl_replay.sim.dive import simulate_dive

EVERY_SAMPLE = 10**9
EVERY_SECOND = 1e9
DIVE_S = 300.0
RATE_HZ = 200.0


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive(
        "lawnmower", seed=4, grade="tactical", duration_s=DIVE_S, imu_rate_hz=RATE_HZ
    )


def noise_rows(read: ReadDive, config: Config) -> dict[str, NoiseRow]:
    found = calibrate_dives(Division.nothing_held_out([read]), config, [NOISE]).found
    return {row.parameter: row for row in found.noise_rows}


def test_each_few_readings_are_one_where_there_are_too_many(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = ReadDive(dive, load_config(overrides=["span.start_s=100", "span.end_s=200"]))
    assert bounded(read) is read
    monkeypatch.setattr(division, "MOST_SAMPLES", 5000)
    few = bounded(read)
    assert few.config.span == Config().span
    imu = few.dive.imu
    assert len(imu.time_ns) == 5000
    inside = read.imu_in_span
    assert inside.time_ns[0] < imu.time_ns[0] < inside.time_ns[4]
    quarter = inside.angular_rate_b[:4].mean(axis=0)
    np.testing.assert_allclose(imu.angular_rate_b[0], quarter, rtol=1e-12)
    assert imu.usual_step_s == pytest.approx(4.0 / RATE_HZ)


def test_no_mean_is_taken_over_a_pause(dive: Dive, monkeypatch: pytest.MonkeyPatch) -> None:
    # One sample more, so that the pause is inside of four.
    heard = np.r_[0:20001, 20600 : len(dive.imu.time_ns)]
    paused = replace(dive, imu=dive.imu.rows(heard))
    monkeypatch.setattr(division, "MOST_SAMPLES", 12_500)
    few = bounded(ReadDive(paused, load_config())).dive.imu
    steps_s = np.diff(few.time_ns) * 1e-9
    assert np.count_nonzero(steps_s > 2.0 * few.usual_step_s) == 1
    assert steps_s.max() == pytest.approx(600 / RATE_HZ, abs=12.0 / RATE_HZ)


def test_a_long_dive_begins_with_its_first_ping(dive: Dive) -> None:
    assert beginning(ReadDive(dive, Config())).config == Config()
    length_ns = int((LONGEST_S + 500.0) * 1e9)
    first_ns = int(dive.imu.time_ns[0])
    late_ns = first_ns + np.linspace(0, length_ns, len(dive.imu.time_ns)).astype(np.int64)
    later = dive.dvl.rows(dive.dvl.time_ns > dive.imu.time_ns[0] + int(100e9))
    long = replace(dive, imu=replace(dive.imu, time_ns=late_ns), dvl=later)
    span = beginning(ReadDive(long, Config())).config.span
    assert span.start_s == 0.0
    assert span.end_s == pytest.approx(LONGEST_S + 100.0, abs=2.0)


@pytest.mark.nightly
def test_the_same_noise_is_found_with_fewer_readings(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = load_config("mems")  # far from what the dive has
    of_all = noise_rows(ReadDive(dive, config), config)
    monkeypatch.setattr(division, "MOST_SAMPLES", 15_000)
    few = bounded(ReadDive(dive, config))
    assert len(few.dive.imu.time_ns) == 15_000
    of_few = noise_rows(few, config)
    assert {row.status for row in of_all.values()} == {"estimated"}
    for key, row in of_all.items():
        assert of_few[key].status == row.status
        assert row.sd is not None
        assert of_few[key].after == pytest.approx(row.after, abs=row.sd)


def test_where_the_middle_cannot_be_run_the_beginning_is_fitted(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert dive.reference is not None
    monkeypatch.setattr(division, "LONGEST_S", 100.0)
    early_ns = dive.imu.time_ns[0] + int(90e9)  # the middle begins at 100 s
    known = dive.reference.rows(dive.reference.time_ns < early_ns)
    of_middle = _Parts.of(dive, Config()).middle
    of_beginning = _Parts.of(replace(dive, reference=known), Config()).middle
    assert of_middle.span_s == pytest.approx((100.0, 200.0), abs=1.0)
    assert of_beginning.span_s == pytest.approx((0.0, 100.0), abs=1.5)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("duration_s", "rate_hz"), [(600.0, 1000.0), (5400.0, 100.0)], ids=["fast", "long"]
)
def test_a_fast_or_long_dive_gets_the_noise_and_the_word_of_all_its_readings(
    duration_s: float, rate_hz: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "dive.mcap"
    write_dive(log, simulate_dive("lawnmower", seed=4, duration_s=duration_s, imu_rate_hz=rate_hz))
    config = load_config(overrides=["evaluation.starts=1"])
    found = fit_noise_of_logs([[log]], config).config
    monkeypatch.setattr(division, "MOST_SAMPLES", EVERY_SAMPLE)
    monkeypatch.setattr(division, "LONGEST_S", EVERY_SECOND)
    of_all = fit_noise_of_logs([[log]], config).config
    assert found.noise == of_all.noise
    assert found.dvl.beam_sd_mps == pytest.approx(of_all.dvl.beam_sd_mps, rel=0.02)
    few, every = (replay_log(log, each) for each in (found, of_all))
    words = [{name: v.verdict for name, v in each.verdicts.items()} for each in (few, every)]
    assert words[0] == words[1]
