"""Dives of one vehicle that differ: settings of their own, and a heading for each, also of short ones."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from made_reports import report as made_report

from insdvl_replay.batch import search
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions, plan_jobs
from insdvl_replay.batch.replaying import Replaying
from insdvl_replay.calibration.found import FoundSettings, Given, stored_settings
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import Note
from insdvl_replay.core.report import Report
from insdvl_replay.inspection import automatic
from insdvl_replay.inspection.automatic import settings_of_one
from insdvl_replay.logs import write_dive
from insdvl_replay.preparation.run import fitted_start
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.trajectories import HEADING_DEG


def with_fixes_alone(dive: Dive) -> Dive:
    assert dive.reference is not None
    nothing = {
        name: np.full_like(getattr(dive.reference, name), np.nan)
        for name in ("mat_nb", "velocity_n")
    }
    return replace(dive, truth=None, reference=replace(dive.reference, **nothing))


def test_heading_of_a_short_dive_is_fitted_to_its_fixes() -> None:
    dive = simulate_dive(
        "figure-eight", seed=2, duration_s=90.0, imu_rate_hz=20.0, reference_rate_hz=1.0
    )
    config = load_config("fog", overrides=["initial.source=level", "initial.heading_deg=fit"])
    assert fitted_start(with_fixes_alone(dive), config).heading_deg == pytest.approx(
        HEADING_DEG, abs=1.0
    )


def test_what_differs_is_named() -> None:
    imu = msgspec.structs.replace(Config().imu, specific_force_scale=0.54)
    found = FoundSettings(msgspec.structs.replace(Config(), imu=imu), ())
    own = settings_of_one(found, "dive_2", Config())
    (note,) = own.notes
    assert note.code == "found_own"
    assert "dive_2" in note.text
    assert "accelerometers 0.54 times" in note.text
    assert "found_own" not in own.text
    assert "0.54 times" in own.text


def test_stored_settings_are_those_found_beside_the_same_given_ones(tmp_path: Path) -> None:
    """By the keys that the file names, whatever its comments say."""
    given = Given(load_config(overrides=["dvl.scale=1.01"]))
    notes = (Note("found_imu", "as given: nothing"),)
    found = FoundSettings(given.config, notes, tuple(given.keys))
    file = tmp_path / "vehicle.toml"
    file.write_text(found.text)
    assert stored_settings(tmp_path, given) == given.config
    more = Given(given.config, ["dvl.scale", "dvl.latency_s"])
    assert stored_settings(tmp_path, more) is None
    file.write_text(replace(found, given=()).text)
    assert stored_settings(tmp_path, given) is None


def dives_of_two_axes(folder: Path, given: Given) -> list[ReplayJob]:
    """Two dives of one vehicle, planned with the settings of the first; the IMU of the second is turned."""
    dive = simulate_dive("figure-eight", seed=2, duration_s=20.0, imu_rate_hz=20.0)
    turn = np.array([-1.0, -1.0, 1.0])
    imu = replace(
        dive.imu,
        specific_force_b=dive.imu.specific_force_b * turn,
        angular_rate_b=dive.imu.angular_rate_b * turn,
    )
    logs = [folder / "dive_1.mcap", folder / "dive_2.mcap"]
    write_dive(logs[0], dive)
    write_dive(logs[1], replace(dive, imu=imu))
    found = FoundSettings(given.config, (), tuple(given.keys))
    options = ReplayOptions(given.config, histories=False, vehicle=found.text)
    return plan_jobs([*map(FoundDive, logs)], folder / "results", options)


def test_result_of_common_settings_is_replaced_by_that_of_own_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where this run has written it, and without --force; a second run finds it up to date."""
    common = load_config("fog", overrides=["evaluation.starts=1"])
    own = load_config("fog", overrides=["evaluation.starts=1", "imu.axes=-x-y+z"])
    given = Given(common)
    dives = dives_of_two_axes(tmp_path, given)
    searched = []

    def find_own(logs: list[tuple[Path, ...]], *_: object, **__: object) -> FoundSettings:
        searched.append(logs)
        return FoundSettings(own, (), tuple(given.keys))

    monkeypatch.setattr(automatic, "find_settings", find_own)
    outcomes = [*search._outcomes_by_groups(dives, given, common, Replaying())]
    assert searched == [[dives[1].logs]]
    assert [outcome.job.target.name for outcome in outcomes] == ["dive_1", "dive_2"]
    axes = []
    for outcome in outcomes:
        assert isinstance(outcome.result, Report)
        axes.append(outcome.result.config["imu"]["axes"])
    assert axes == [common.imu.axes, "-x-y+z"]
    again = [*search.outcomes_without_settings(dives, Replaying())]
    assert [outcome.unchanged for outcome in again] == [True, True]
    assert [outcome.result for outcome in again] == [outcome.result for outcome in outcomes]


@pytest.mark.parametrize(
    ("codes", "rejected", "contradicts"),
    [
        (("gate_reopened", "not_evaluated"), 36, True),
        (("gate_reopened", "not_evaluated"), 0, False),  # the candidate diverged alone
        (("gate_reopened",), 36, False),  # it came back, and has a verdict
        ((), 36, False),
    ],
)
def test_dive_whose_baseline_diverges_contradicts_one_that_is_followed(
    codes: tuple[str, ...], rejected: int, contradicts: bool, tmp_path: Path
) -> None:
    (job,) = plan_jobs([FoundDive(tmp_path / "dive.mcap")], tmp_path, ReplayOptions(Config()))
    followed = made_report()
    rows = []
    for row in followed.tables.consistency:
        if row.filter == followed.baseline:
            row = msgspec.structs.replace(row, used=750 - rejected, rejected=rejected)
        rows.append(row)
    other = msgspec.structs.replace(
        followed,
        tables=msgspec.structs.replace(followed.tables, consistency=rows),
        notes=[Note(code, "as it was met") for code in codes],
    )
    assert search._contradicts(Outcome(job, other), Outcome(job, followed)) == contradicts
    assert not search._contradicts(Outcome(job, other), Outcome(job, other))


@pytest.mark.nightly
def test_dive_with_another_scale_gets_settings_of_its_own(tmp_path: Path) -> None:
    logs = [tmp_path / f"dive_{number}.mcap" for number in (1, 2, 3)]
    for seed, log in enumerate(logs):
        dive = simulate_dive(
            "calibration", seed=seed, grade="tactical", duration_s=150.0, imu_rate_hz=50.0
        )
        scale = 0.54 if log.stem == "dive_2" else 1.0
        scaled = replace(dive.imu, specific_force_b=scale * dive.imu.specific_force_b)
        write_dive(log, with_fixes_alone(replace(dive, imu=scaled)))
    output = tmp_path / "replay"
    assert (
        run_command_line(["run", *map(str, logs), "-o", str(output), "--starts", "1", "-q"]) == 0
    )
    scales = [
        load_config(file=output / log.stem / "vehicle.toml").imu.specific_force_scale
        for log in logs
    ]
    assert scales == [1.0, pytest.approx(0.54, abs=0.01), 1.0]
