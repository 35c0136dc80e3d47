"""What is said of long outages of the DVL, and the height at which gravity is taken through them."""

import dataclasses
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import LogError
from insdvl_replay.logs import write_dive
from insdvl_replay.nav.earth_model import HOLD_AFTER_S, GravityHeight, followed
from insdvl_replay.preparation.prepared import (
    FEWEST_PINGS,
    coverage_notes,
    outage_notes,
    read_checked_dive,
)
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim import dive as sim_dive
from insdvl_replay.sim.dive import exact_dive, simulate_dive
from insdvl_replay.sim.trajectories import Scenario, Wave
from insdvl_replay.studies.montecarlo import make_setup, run_seed, simulated_run


def pings_ns(*spans_s: tuple[float, float]) -> np.ndarray:
    return np.concatenate([np.arange(start_s, end_s) * 1e9 for start_s, end_s in spans_s]).astype(
        np.int64
    )


@pytest.mark.parametrize(
    ("spans_s", "count", "words"),
    [
        ([(1.0, 300.0), (590.0, 2000.0)], 0, ""),
        ([(1.0, 300.0), (601.0, 2000.0)], 1, "302 s .*299 s"),
        ([(400.0, 900.0), (1300.0, 2000.0)], 2, "401 s .*899 s"),
        ([(1.0, 700.0)], 1, "1301 s .*699 s"),
    ],
)
def test_long_outages_are_reported(
    spans_s: list[tuple[float, float]], count: int, words: str
) -> None:
    notes = outage_notes(pings_ns(*spans_s), 0, 2_000_000_000_000)
    assert [(note.code, note.severity, note.count) for note in notes] == [
        ("dvl_outages", "warning", count)
    ] * bool(count)
    assert not notes or re.search(words, notes[0].text)


@pytest.mark.parametrize(("last_s", "outside"), [(100.0, 0), (81.0, 0), (53.0, 48), (2.0, 99)])
def test_many_pings_outside_the_samples_of_the_imu_are_a_warning(
    last_s: float, outside: int
) -> None:
    samples_ns = pings_ns((1.0, last_s))
    found = coverage_notes(samples_ns, pings_ns((1.0, 101.0)))
    expected = [("dvl_outside_imu", "warning", outside)] * bool(outside)
    assert [(note.code, note.severity, note.count) for note in found] == expected


@pytest.mark.parametrize(("last_s", "noted"), [(52.0, False), (48.0, True)])
def test_a_dvl_that_covers_less_than_half_of_the_dive_is_a_warning(
    last_s: float, noted: bool
) -> None:
    found = coverage_notes(pings_ns((0.0, 101.0)), pings_ns((1.0, last_s)))
    assert [(note.code, note.severity) for note in found] == [
        ("dvl_covers_little", "warning")
    ] * noted


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_dive_of_one_or_two_pings_is_refused(count: int, tmp_path: Path) -> None:
    dive = simulate_dive("straight", seed=1, duration_s=8.0, imu_rate_hz=50.0)
    write_dive(
        tmp_path / "dive.mcap",
        dataclasses.replace(dive, dvl=dive.dvl.rows(np.arange(len(dive.dvl.time_ns)) < count)),
    )
    if count < FEWEST_PINGS:
        with pytest.raises(LogError, match=f"{count} pings? of the DVL can be used"):
            read_checked_dive(tmp_path / "dive.mcap", load_config())
    else:
        assert len(read_checked_dive(tmp_path / "dive.mcap", load_config()).dvl.time_ns) == count


def test_gravity_follows_the_height_and_is_held_without_velocities() -> None:
    gravity = followed(GravityHeight(-20.0, 0.0, 0.0), -21.0, HOLD_AFTER_S)
    assert gravity == GravityHeight(-21.0, 0.0, 0.0)
    gravity = followed(gravity, 400.0, HOLD_AFTER_S + 1.0)
    assert gravity == GravityHeight(-21.0, 421.0, 0.0)
    again = GravityHeight(gravity.height_m, gravity.drift_m, 1000.0)
    assert followed(again, 395.0, 1001.0) == GravityHeight(-26.0, 421.0, 1000.0)


def test_gravity_that_is_held_costs_little_in_a_descent() -> None:
    """Twelve minutes down at 0.7 m/s before the DVL finds the bottom are 490 m."""
    sinking = Scenario("", 1000.0, Wave(2.0), pitch_deg=Wave(-20.0))
    config = load_config("fog", overrides=["initial.accel_bias_sd_mg=0.04"])
    config = msgspec.structs.replace(config, filters={"baseline": config.filters["baseline"]})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sim_dive, "SCENARIOS", {"sinking": sinking})
        exact = exact_dive(
            "sinking", imu_rate_hz=20.0, reference_at_pings=True, outages=[(0.0, 720.0)]
        )
    world = dataclasses.replace(make_setup("straight", config, "matched", 10.0), exact=exact)
    runs = [simulated_run(world, run_seed(1, run))[0] for run in range(20)]
    assert np.mean([run.nees[-1] for run in runs]) < 25.0


def test_published_accelerations_take_gravity_where_the_mechanisation_does() -> None:
    """After an outage the INS's height is off by 400 m, which is 1.2 mm/s^2 of gravity."""
    config = load_config("tactical", overrides=["filters.aided.acceleration.model='published'"])
    dive = simulate_dive(
        "straight", seed=1, duration_s=1700.0, grade="tactical", outages=[(20.0, 1300.0)]
    )
    aided = replay_dive(dive, config).histories[1]
    published = aided.innovations[1]
    late = published.time_ns > dive.imu.time_ns[0] + 1_400_000_000_000
    assert abs(aided.position[-1, 2] + 20.0) > 100.0
    assert abs(published.innovation[late, 2].mean()) < 3e-4
