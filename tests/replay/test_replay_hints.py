"""What a replay says of its settings: nothing where they are right, and which command to follow where they are not."""

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from insdvl_replay.batch.noise_tuning import replay_with_tuned_baseline
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DEG_PER_HOUR, MG
from insdvl_replay.core.tables import finite
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.replay import replay_dive, replay_log
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

WHITE = DvlErrors(beam_bias_sd_mps=0.0, beam_scale_sd=0.0)
HINTS = ("innovations_apart", "track_off", "noise_far_off")


def told_the_truth(grade: str, *overrides: str) -> Config:
    """Tell the filters what the sensors are."""
    sensors = GRADES[grade]
    white = (
        "accel_white_mps_rts",
        "gyro_white_rad_rts",
        "accel_bias_walk_mps2_rts",
        "gyro_bias_walk_radps_rts",
    )
    truth = [f"noise.{key}={getattr(sensors, key)!r}" for key in white]
    truth += [
        "initial.uncertainty=settings",
        f"dvl.beam_sd_mps={WHITE.beam_sd_mps}",
        f"initial.accel_bias_sd_mg={sensors.accel_bias_sd_mps2 / MG}",
        f"initial.gyro_bias_sd_degph={sensors.gyro_bias_sd_radps / DEG_PER_HOUR}",
        "evaluation.starts=1",
    ]
    return load_config("levy-klein", overrides=[*truth, *overrides])


def dived(
    scenario: str,
    grade: str = "fog",
    seed: int = 1,
    duration_s: float = 600.0,
    imu_rate_hz: float = 50.0,
    **built_in: tuple[float, float, float],
) -> Dive:
    exact = exact_dive(scenario, duration_s=duration_s, imu_rate_hz=imu_rate_hz, **built_in)
    return add_errors(exact, GRADES[grade], WHITE, seed)


def hints(dive: Dive, config: Config) -> dict[str, Note]:
    return {note.code: note for note in replay_dive(dive, config).notes if note.code in HINTS}


def test_nothing_is_said_of_sensors_that_are_as_configured() -> None:
    assert hints(dived("figure-eight", "tactical"), told_the_truth("tactical")) == {}


@pytest.mark.nightly
@pytest.mark.parametrize("grade", ["fog", "tactical", "mems"])
@pytest.mark.parametrize("scenario", ["lawnmower", "figure-eight", "straight"])
def test_nothing_is_said_of_any_sensors_that_are_as_configured(scenario: str, grade: str) -> None:
    for seed in (1, 2, 3):
        dive = dived(scenario, grade, seed, imu_rate_hz=100.0)
        assert hints(dive, told_the_truth(grade)) == {}


def test_axes_that_beams_see_unlike_are_no_reason() -> None:
    """The filter takes all axes of a velocity for alike, beams at 30 deg not: six times less variance down."""
    truth = told_the_truth("fog", "dvl.velocity_sd_mps=0.006")
    alike = msgspec.structs.replace(
        truth, dvl=msgspec.structs.replace(truth.dvl, beam_sd_mps=None)
    )
    rows = {
        row.measurement: row.mean_nis
        for row in replay_dive(dived("straight"), alike).tables.consistency
    }
    assert finite(rows["velocity_x"]) > 5.0 * finite(rows["velocity_z"])
    assert hints(dived("straight"), alike) == {}


@pytest.mark.parametrize("arm_m", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
@pytest.mark.parametrize(
    "scenario", [pytest.param("lawnmower", marks=pytest.mark.nightly), "figure-eight"]
)
def test_an_arm_that_nobody_reported_of_is_seen_along_the_axes(
    scenario: str, arm_m: tuple[float, float, float]
) -> None:
    found = hints(dived(scenario, lever_arm_m=arm_m), told_the_truth("fog"))["innovations_apart"]
    assert found.severity == "info"
    assert "insdvl-replay calibrate" in found.hint
    # Turns move an arm that points forward to starboard, and one that points to starboard backwards.
    largest = "y" if arm_m[0] else "x"
    assert f" {largest} is " in found.text


@pytest.mark.parametrize(
    "scenario", [pytest.param("lawnmower", marks=pytest.mark.nightly), "figure-eight"]
)
def test_a_turned_dvl_is_seen_in_the_track(scenario: str) -> None:
    config = told_the_truth("fog", "initial.misalignment_sd_deg=[0.05, 0.05, 0.1]")
    found = hints(dived(scenario, mounting_rpy_deg=(0.0, 0.0, 3.0)), config)["track_off"]
    assert re.search(r"turn .*\+\d", found.text)
    assert "insdvl-replay calibrate" in found.hint


@pytest.mark.parametrize("factor", [1.02, 0.97])
def test_a_dvl_that_reads_long_or_short_is_seen_in_the_track(factor: float) -> None:
    dive = dived("lawnmower")
    assert dive.dvl.beam_velocity_mps is not None
    long = replace(
        dive, dvl=replace(dive.dvl, beam_velocity_mps=factor * dive.dvl.beam_velocity_mps)
    )
    found = re.match(
        r"a scale of (\S+) % \(sd (\S+) %\) would",
        hints(long, told_the_truth("fog"))["track_off"].text,
    )
    assert found
    assert abs(float(found[1]) - 100.0 * (1.0 / factor - 1.0)) < 3.0 * float(found[2])


def test_a_heading_of_which_the_filter_is_unsure_may_turn_the_track() -> None:
    dive = dived("lawnmower", mounting_rpy_deg=(0.0, 0.0, 3.0))
    assert "track_off" not in hints(
        dive, told_the_truth("fog", "initial.misalignment_sd_deg=[0.5, 0.5, 3.0]")
    )


@pytest.mark.parametrize(
    ("beam_sd_mps", "size", "number"), [(0.03, "smaller", "0.02"), (0.001, "larger", "17")]
)
def test_noise_that_is_set_far_off_points_at_the_control(
    beam_sd_mps: float, size: str, number: str
) -> None:
    config = told_the_truth("fog", f"dvl.beam_sd_mps={beam_sd_mps}")
    found = hints(dived("lawnmower", imu_rate_hz=100.0), config)["noise_far_off"]
    assert re.search(rf"{size} .*NIS / dof .*velocity .*{number}", found.text)
    assert "run --control" in found.hint


def test_noise_that_is_off_by_less_says_nothing() -> None:
    for beam_sd_mps in (0.0025, 0.008):
        config = told_the_truth("fog", f"dvl.beam_sd_mps={beam_sd_mps}")
        assert "noise_far_off" not in hints(dived("lawnmower"), config)


def test_a_control_that_is_there_already_is_not_pointed_at(tmp_path: Path) -> None:
    log, config = (
        tmp_path / "log.mcap",
        told_the_truth("fog", "dvl.beam_sd_mps=0.03", "span.end_s=60"),
    )
    write_dive(log, dived("lawnmower", duration_s=90.0))
    assert "noise_far_off" in {note.code for note in replay_log(log, config).notes}
    assert "noise_far_off" not in {
        note.code for note in replay_with_tuned_baseline(log, config).notes
    }
