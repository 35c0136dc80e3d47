"""The vehicle's own solution as a filter: what is put into it stands in the tables, whatever its frames are."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vehicles_own import Told, off, truth_of, write_nav_solution, write_odometry, write_tum

from insdvl_replay.calibration.innovations import read_dive as read_for_calibration
from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Initial, Reference, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, SolutionColumns, seconds
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.states import DEG
from insdvl_replay.evaluation.credibility import credibility_table, state_errors
from insdvl_replay.evaluation.verdicts import credibility_of
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.columns.reference import no_covariances
from insdvl_replay.logs.write import write_dive
from insdvl_replay.nav.levelling import drawn_starts
from insdvl_replay.preparation.prepared import prepare_dive, read_checked_dive
from insdvl_replay.preparation.replay import Replay, replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.preparation.solutions import recorded_history
from insdvl_replay.show.answers import answers_of
from insdvl_replay.show.result_files import report_of
from insdvl_replay.sim.dive import simulate_dive

MEMS = load_config("mems")
POSE_SD = np.array([0.3, 0.2, 0.1, 0.01, 0.02, 0.03])  # east, north, up, m; about these, rad
TWIST_SD = np.array([0.05, 0.03, 0.02])  # forward, port, up, m/s


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("lawnmower", seed=1, duration_s=200.0, grade="mems")


def config(*solutions: str | Solution, starts: int = 1, **changes: Any) -> Config:
    """A baseline, and solutions that are called ``onboard``, ``onboard1`` and so on."""
    named = {
        f"onboard{number or ''}": Filter(solution=one) for number, one in enumerate(solutions)
    }
    filters = {"baseline": Filter(aiding=("velocity",)), **named}
    fitting = msgspec.structs.replace(MEMS, dvl=Dvl(velocity_sd_mps=0.005))
    return msgspec.structs.replace(
        fitting, filters=filters, evaluation=Evaluation(starts=starts), **changes
    )


def replayed(folder: Path, dive: Dive, settings: Config, *parts: Path) -> Replay:
    """Write the dive, read it with the logs of its vehicle, and replay it."""
    write_dive(folder / "dive.mcap", dive)
    return replay_dive(read_dive([folder / "dive.mcap", *parts], settings), settings)


def rows(replay: Replay, table: str, name: str = "onboard") -> dict[str, Any]:
    found = [row for row in getattr(replay.tables, table) if row.filter == name]
    return {getattr(row, "quantity", getattr(row, "state", "")): row for row in found}


def codes(replay: Replay) -> list[str]:
    return [note.code for note in replay.notes if note.code.startswith("solution")]


def slow_errors(told: Told) -> tuple[Told, Floats]:
    """Errors of which tables can be foretold: a drift of 1 cm/s north and 2 cm/s west, and of 1 deg in heading."""
    since_s = seconds(told.time_ns, told.time_ns[0])[:, None]
    velocity_n = np.array([0.03, -0.04, 0.02])
    wrong = off(
        told,
        moved_n=since_s * [0.01, -0.02, 0.005],
        velocity_n=velocity_n,
        turn_n=np.array([0.0, 0.0, DEG]),
    )
    return wrong, velocity_n


def test_errors_drift_and_jumps_are_those_that_were_put_in(dive: Dive, tmp_path: Path) -> None:
    told, velocity_n = slow_errors(truth_of(dive))
    replay = replayed(
        tmp_path, dive, config("/odometry"), write_odometry(tmp_path / "own.mcap", told)
    )
    error, drift = rows(replay, "reference_error"), rows(replay, "drift")
    for axis, expected in zip("ned", velocity_n, strict=True):
        assert error[f"velocity_{axis}"].rmse == pytest.approx(abs(expected), rel=1e-6)
        assert error[f"velocity_{axis}"].final == pytest.approx(expected, rel=1e-6)
    assert error["heading"].rmse == pytest.approx(1.0, rel=1e-6)
    assert max(error["roll"].rmse, error["pitch"].rmse) < 1e-6
    last_s = seconds(replay.errors["onboard"].time_ns[-1:], replay.start_ns)[0]
    assert error["position_h"].final == pytest.approx(np.hypot(0.01, 0.02) * last_s, rel=1e-4)
    assert error["depth"].final == pytest.approx(0.005 * last_s, rel=1e-4)
    assert drift["drift_60s"].p50 == pytest.approx(60.0 * np.hypot(0.01, 0.02), rel=1e-3)
    assert drift["velocity_along"].worst <= np.hypot(0.03, 0.04) + 1e-9
    assert [(row.jumps, row.filter) for row in replay.tables.jumps] == [(0, "onboard")]
    assert {row.status for row in error.values()} == {"compared"}
    assert codes(replay) == ["solution_aligned", "solution_without_covariance"]


def test_what_it_does_not_say_has_no_rows_and_is_noted(dive: Dive, tmp_path: Path) -> None:
    """No belief, no innovations, no outage: no row is made up, and words say so."""
    parts = write_odometry(tmp_path / "own.mcap", truth_of(dive))
    replay = replayed(tmp_path, dive, config("/odometry"), parts)
    for table in ("improvement", "convergence", "consistency", "credibility", "outage"):
        assert rows(replay, table) == {}
    candidate = replay.verdicts["onboard"]
    assert (candidate.consistency, candidate.credibility, candidate.prediction) == (
        "not available",
        "not available",
        "undecided",
    )
    assert np.isnan(
        [candidate.mean_improvement_pct, candidate.mean_convergence_improvement_pct]
    ).all()
    assert "%" not in candidate.sentence.rpartition("onboard")[2]


@pytest.mark.parametrize("axes", ["enu_flu", "ned_frd"])
def test_a_tum_file_is_read_in_either_axes(dive: Dive, tmp_path: Path, axes: str) -> None:
    told, _ = slow_errors(truth_of(dive))
    write_tum(tmp_path / "own.tum", told, east_north_up=axes == "enu_flu")
    settings = config(Solution(file=str(tmp_path / "own.tum"), axes=axes))  # type: ignore[arg-type]
    replay = replayed(tmp_path, dive, settings)
    error = rows(replay, "reference_error")
    assert error["heading"].rmse == pytest.approx(1.0, rel=1e-6)
    assert rows(replay, "drift")["drift_60s"].p50 == pytest.approx(
        60.0 * np.hypot(0.01, 0.02), rel=1e-3
    )
    assert {error[f"velocity_{axis}"].status for axis in "ned"} == {"not in solution"}
    assert np.isnan(error["velocity_n"].baseline_rmse)
    assert "solution_lacks" in codes(replay)


def test_a_file_without_a_number_is_refused(dive: Dive, tmp_path: Path) -> None:
    told, _ = slow_errors(truth_of(dive))
    write_tum(tmp_path / "own.tum", told)
    lines = [
        line.split()[0] + " nan" * 7
        for line in (tmp_path / "own.tum").read_text("utf-8").splitlines()
    ]
    (tmp_path / "own.tum").write_text("\n".join(lines), "utf-8")
    with pytest.raises(LogError, match=r"own\.tum"):
        replayed(tmp_path, dive, config(Solution(file=str(tmp_path / "own.tum"))))


def correlated(told: Told, seed: int, factor: float = 1.0) -> tuple[Told, dict[str, Floats]]:
    """White errors as the covariances say, times a factor: the twist's in the body, the pose's in its frame."""
    rng, count = np.random.default_rng(seed), len(told.time_ns)
    pose, twist = (
        rng.normal(size=(count, 6)) * POSE_SD * factor,
        rng.normal(size=(count, 3)) * TWIST_SD * factor,
    )
    pose[0, :3] = 0.0  # where it is laid
    moved_n, turn_n = (
        part[:, [1, 0, 2]] * [1.0, 1.0, -1.0] for part in (pose[:, :3], pose[:, 3:])
    )
    turned = Rotation.from_rotvec(turn_n) * told.attitude
    velocity_b = told.attitude.inv().apply(told.velocity_n) + twist * [1.0, -1.0, -1.0]
    covs = {
        "pose.covariance": np.tile(np.diag(POSE_SD**2), (count, 1, 1)),
        "twist.covariance": np.tile(
            np.diag(np.append(TWIST_SD, [1.0, 1.0, 1.0]) ** 2), (count, 1, 1)
        ),
    }
    return Told(told.time_ns, told.moved_n + moved_n, turned.apply(velocity_b), turned), covs


@pytest.mark.parametrize("factor", [1.0, 3.0, 0.2])
def test_nees_is_by_its_own_covariance(dive: Dive, tmp_path: Path, factor: float) -> None:
    """With errors in the body and a heading error the covariance in n is full; each group has its NEES."""
    told, covs = correlated(truth_of(dive), seed=3, factor=factor)
    replay = replayed(
        tmp_path, dive, config("/odometry"), write_odometry(tmp_path / "own.mcap", told, covs)
    )
    found = rows(replay, "credibility")
    assert list(found)[-4:] == ["velocity", "attitude", "position", "all"]
    for group in ("velocity", "attitude", "position"):
        assert found[group].mean_nees == pytest.approx(3.0 * factor**2, rel=0.12)
    word = {1.0: "consistent", 3.0: "overconfident", 0.2: "conservative"}[factor]
    assert {found[group].verdict for group in ("velocity", "attitude", "position", "all")} == {
        word
    }
    assert replay.verdicts["onboard"].credibility == word
    assert f"onboard is {word} " in replay.verdicts["onboard"].sentence
    assert len(rows(replay, "improvement")) == len(rows(replay, "convergence")) == 6  # no bias


@pytest.mark.nightly
def test_the_words_on_its_covariance_are_right_over_seeds(dive: Dive, tmp_path: Path) -> None:
    """Of twelve honest solutions at most one is called something else; of those a half too sure none is honest."""
    settings = config("/odometry")
    first = replayed(
        tmp_path, dive, settings, write_odometry(tmp_path / "own.mcap", truth_of(dive))
    )
    words: dict[float, list[str]] = {1.0: [], 1.5: []}
    for seed in range(12):
        for factor, found in words.items():
            told, covs = correlated(truth_of(dive), 100 + seed, factor)
            parts = [tmp_path / "dive.mcap", write_odometry(tmp_path / "own.mcap", told, covs)]
            found.append(word_on_groups(read_dive(parts, settings), settings, first))
    assert words[1.0].count("consistent") >= 11
    assert words[1.5] == ["overconfident"] * 12


def word_on_groups(dive: Dive, settings: Config, first: Replay) -> str:
    """Judge a solution by its errors, beside the baseline of another replay of the same dive."""
    assert dive.reference is not None
    evaluated_ns = dive.reference.time_ns[dive.reference.time_ns <= first.end_ns]
    recorded, baseline = settings.solutions["onboard"], first.histories[0]
    history, _, _ = recorded_history(
        "onboard", dive.solutions["onboard"], recorded, dive.imu, baseline, evaluated_ns
    )
    errors = state_errors(history, dive.reference, None).after(first.start_ns)
    return credibility_of(credibility_table("dive", ["onboard"], {"onboard": errors}), "onboard")


def test_a_jump_is_counted_with_its_size_and_time(dive: Dive, tmp_path: Path) -> None:
    told = truth_of(dive)
    since_s = seconds(told.time_ns, told.time_ns[0])
    jumped = off(told, moved_n=np.where(since_s[:, None] >= 80.0, [1.2, 1.6, 0.0], 0.0))
    parts = write_odometry(tmp_path / "own.mcap", jumped)
    write_tum(tmp_path / "own.tum", jumped)
    replay = replayed(
        tmp_path, dive, config("/odometry", Solution(file=str(tmp_path / "own.tum"))), parts
    )
    for row in replay.tables.jumps:
        assert (row.jumps, row.largest_m) == (1, pytest.approx(2.0, rel=1e-3))
        assert row.largest_at_s == pytest.approx(80.0, abs=0.21)
    assert [row.filter for row in replay.tables.jumps] == ["onboard", "onboard1"]


def test_where_it_is_silent_nobody_is_evaluated(dive: Dive, tmp_path: Path) -> None:
    """From 40 to 120 s, with a hole: the baseline's numbers beside it are of the same instants."""
    told = truth_of(dive)
    since_s = seconds(told.time_ns, told.time_ns[0])
    keep = (since_s > 39.9) & (since_s < 120.1) & ~((since_s > 60.1) & (since_s < 79.9))
    part = Told(told.time_ns[keep], told.moved_n[keep], told.velocity_n[keep], told.attitude[keep])
    replay = replayed(
        tmp_path, dive, config("/odometry", starts=8), write_odometry(tmp_path / "own.mcap", part)
    )
    own, baseline = replay.errors["onboard"], replay.errors["baseline"]
    silent = ~np.isfinite(own.velocity_error_n[:, 0])
    at_s = seconds(own.time_ns, replay.start_ns)
    np.testing.assert_array_equal(
        silent, (at_s < 39.9) | (at_s > 120.1) | ((at_s > 60.1) & (at_s < 79.9))
    )
    row = rows(replay, "reference_error")["velocity_n"]
    assert row.baseline_rmse == pytest.approx(
        np.sqrt(np.mean(baseline.velocity_error_n[~silent, 0] ** 2))
    )
    assert (row.samples, row.status) == (int((~silent).sum()), "partly covered")
    assert "solution_coverage" in codes(replay)
    compared = rows(replay, "evidence")["velocity_along"]
    assert (compared.ratio or 1.0) < 0.5
    assert compared.samples <= int((~silent).sum()), "where it is silent nobody is compared"


def test_its_start_is_aligned_on_the_baseline_and_only_if_asked_turned(
    dive: Dive, tmp_path: Path
) -> None:
    told = truth_of(dive)
    # The frame itself is turned: ways, velocities and attitude alike.
    turn = Rotation.from_rotvec([0.0, 0.0, 20.0 * DEG])
    turned = Told(
        told.time_ns, turn.apply(told.moved_n), turn.apply(told.velocity_n), turn * told.attitude
    )
    asked = config("/odometry", Solution(topic="/odometry", align="heading"))
    replay = replayed(tmp_path, dive, asked, write_odometry(tmp_path / "own.mcap", turned))
    own, aligned = rows(replay, "reference_error"), rows(replay, "reference_error", "onboard1")
    assert own["heading"].rmse == pytest.approx(20.0, rel=1e-6)
    assert own["position_h"].rmse > 1.0
    # What is left is what the baseline's heading is off by at the start: nothing.
    assert (
        max(aligned["heading"].rmse, aligned["position_h"].rmse, aligned["velocity_n"].rmse) < 1e-4
    )
    (text,) = (note.text for note in replay.notes if note.code == "solution_turned")
    assert "-20.00 deg" in text


def test_what_is_turned_keeps_its_covariance_and_its_mounting(dive: Dive, tmp_path: Path) -> None:
    """Turned by 70 deg, in axes that lie across the IMU's, and without a covariance of the position: NEES stays."""
    told, covs = correlated(truth_of(dive), seed=5)
    covs["pose.covariance"][:, :3] = covs["pose.covariance"][:, :, :3] = 0.0
    turn = Rotation.from_rotvec([0.0, 0.0, 70.0 * DEG])
    mounting = Rotation.from_euler("Z", 90.0, degrees=True)
    turned = Told(
        told.time_ns, turn.apply(told.moved_n), turn.apply(told.velocity_n), turn * told.attitude
    )
    part = write_odometry(tmp_path / "plain.mcap", turned, covs)
    found = rows(
        replayed(tmp_path, dive, config(Solution(topic="/odometry", align="heading")), part),
        "credibility",
    )
    assert "position" not in found
    assert found["velocity"].verdict == "consistent"
    across = Told(turned.time_ns, turned.moved_n, turned.velocity_n, turned.attitude * mounting)
    settings = config(
        Solution(topic="/odometry", align="heading", mounting_rpy_deg=(0.0, 0.0, 90.0))
    )
    replay = replayed(tmp_path, dive, settings, write_odometry(tmp_path / "across.mcap", across))
    assert (
        rows(replay, "reference_error")["heading"].rmse < 4.0
    )  # what the first attitude was off by, and noise
    (text,) = (note.text for note in replay.notes if note.code == "solution_turned")
    assert re.search(r" -[67][\d.]* deg", text)


def test_a_lever_arm_and_a_mounting_are_taken_off(dive: Dive, tmp_path: Path) -> None:
    told = truth_of(dive)
    arm_b, mounting = (
        np.array([1.5, -0.5, 0.3]),
        Rotation.from_euler("ZYX", [90.0, 3.0, -2.0], degrees=True),
    )
    moved = Told(
        told.time_ns,
        told.moved_n + told.attitude.apply(arm_b),
        told.velocity_n,
        told.attitude * mounting,
    )
    part = write_odometry(tmp_path / "own.mcap", moved)
    replay = replayed(
        tmp_path,
        dive,
        config(
            Solution(
                topic="/odometry", lever_arm_m=tuple(arm_b), mounting_rpy_deg=(-2.0, 3.0, 90.0)
            )
        ),
        part,
    )
    error = rows(replay, "reference_error")
    assert max(error[name].rmse for name in ("roll", "pitch", "heading")) < 1e-6
    assert max(error["position_h"].rmse, error["depth"].rmse) < 1e-4


def test_without_attitude_a_lever_arm_is_refused(dive: Dive) -> None:
    settings = config(Solution(topic="/odometry", lever_arm_m=(1.0, 0.0, 0.0)))
    reference = dive.reference
    assert reference is not None
    lacking = replace(reference, mat_nb=np.full_like(reference.mat_nb, np.nan))
    with pytest.raises(ConfigError, match=r"filters\.onboard\.solution .*attitude"):
        replay_dive(
            replace(
                dive, solutions={"onboard": SolutionColumns(lacking, None, *no_covariances())}
            ),
            settings,
        )


def test_a_solution_of_another_time_is_refused(dive: Dive, tmp_path: Path) -> None:
    told = truth_of(dive)
    write_tum(tmp_path / "own.tum", replace(told, time_ns=told.time_ns + 10**12))
    settings = config(Solution(file=str(tmp_path / "own.tum")))
    with pytest.raises(LogError, match=r"filters\.onboard\.solution: ") as caught:
        replayed(tmp_path, dive, settings)
    assert "filters.onboard.solution.latency_s" in caught.value.hint


def test_without_a_reference_its_jumps_are_left(dive: Dive, tmp_path: Path) -> None:
    told = truth_of(dive)
    jumped = off(
        told, moved_n=np.where(np.arange(len(told.time_ns))[:, None] > 500, [0.0, 5.0, 0.0], 0.0)
    )
    level = Initial(source="level", heading_deg=0.0, latitude_deg=32.8)
    alone = replace(dive, reference=None, truth=None)
    part = write_odometry(tmp_path / "own.mcap", jumped)
    replay = replayed(tmp_path, alone, config("/odometry", initial=level), part)
    assert [row.jumps for row in replay.tables.jumps] == [1]
    assert not [row for row in replay.tables.evidence if row.filter == "onboard"]
    assert replay.verdicts["onboard"].verdict == "undecided"


def test_who_looks_at_the_baseline_alone_needs_no_solution(dive: Dive, tmp_path: Path) -> None:
    """One file of settings serves calibration, too, whose logs lack the topic."""
    write_dive(tmp_path / "dive.mcap", dive)
    assert read_for_calibration(tmp_path / "dive.mcap", config("/odometry")).dive.solutions == {}


@pytest.mark.parametrize(
    ("solution", "reference"),
    [
        ("/reference", Reference(topic="/reference")),
        ("/nowhere", Reference()),
        ("/imu", Reference()),
    ],
)
def test_what_cannot_be_a_solution_is_refused(
    dive: Dive, tmp_path: Path, solution: str, reference: Reference
) -> None:
    write_dive(tmp_path / "dive.mcap", dive)
    with pytest.raises(LogError) as caught:
        read_dive(tmp_path / "dive.mcap", config(solution, reference=reference))
    assert f"'{solution}'" in caught.value.message
    assert "filters.onboard.solution" in caught.value.message
    assert caught.value.hint


def test_a_file_that_is_named_as_a_topic_is_reported_its_key(dive: Dive, tmp_path: Path) -> None:
    write_dive(tmp_path / "dive.mcap", dive)
    with pytest.raises(LogError) as caught:
        read_dive(tmp_path / "dive.mcap", config(Solution(topic="flown.tum", align="heading")))
    assert 'filters.onboard.solution.file = "flown.tum"' in caught.value.hint


def test_the_only_odometry_is_not_the_reference_if_it_is_a_solution(
    dive: Dive, tmp_path: Path
) -> None:
    """Found by type it would be both, and free of error."""
    write_dive(tmp_path / "dive.mcap", replace(dive, reference=None))
    parts = [tmp_path / "dive.mcap", write_odometry(tmp_path / "own.mcap", truth_of(dive))]
    assert read_dive(parts, config()).reference is not None
    assert read_dive(parts, config("/odometry")).reference is None


def test_the_projects_own_message_is_taken_as_it_is(dive: Dive, tmp_path: Path) -> None:
    """A geographic position has an origin: an offset stays an error, unless its start is to be laid, too."""
    reference = dive.reference
    assert reference is not None
    higher = replace(reference, position=reference.position + np.array([0.0, 0.0, 2.5]))
    asked = config("/vehicle", Solution(topic="/vehicle", align="position"))
    settings = msgspec.structs.replace(asked, reference=Reference(topic="/reference"))
    replay = replayed(tmp_path, dive, settings, write_nav_solution(tmp_path / "own.mcap", higher))
    assert rows(replay, "reference_error")["depth"].rmse == pytest.approx(2.5, abs=1e-6)
    assert rows(replay, "reference_error", "onboard1")["depth"].rmse < 1e-6


def test_what_is_the_reference_by_another_name_is_not_evaluated(
    dive: Dive, tmp_path: Path
) -> None:
    """Evo's file of the reference, or its topic recorded twice."""
    write_tum(tmp_path / "own.tum", truth_of(dive))
    write_dive(tmp_path / "dive.mcap", dive)
    settings = config(Solution(file=str(tmp_path / "own.tum")))
    read = read_checked_dive(tmp_path / "dive.mcap", settings)
    replay = replay_dive(read, settings)
    assert "solution_onboard_is_reference" in codes(replay)
    assert replay.verdicts["onboard"].verdict == "not evaluated"


def test_the_reference_in_disguise_is_found(dive: Dive, tmp_path: Path) -> None:
    """A latency of the reference, as `calibrate --reference` finds it, is not that of what was recorded beside it."""
    write_tum(tmp_path / "own.tum", truth_of(dive))
    write_dive(tmp_path / "dive.mcap", dive)
    settings = config(
        Solution(file=str(tmp_path / "own.tum")), reference=Reference(latency_s=-0.000405)
    )
    replay = replay_dive(read_checked_dive(tmp_path / "dive.mcap", settings), settings)
    assert "solution_onboard_is_reference" in codes(replay)


@pytest.mark.parametrize(("east_m_per_s", "told"), [(0.0, True), (0.001, False)])
def test_a_track_in_metres_that_is_the_references_is_found(
    dive: Dive, tmp_path: Path, east_m_per_s: float, told: bool
) -> None:
    """The odometry of the INS whose fixes are the reference: no attitude or position is common to both. A millimetre a
    second is a solution of its own."""
    own = truth_of(dive)
    since_s = seconds(own.time_ns, own.time_ns[0])[:, None]
    write_tum(
        tmp_path / "own.tum",
        off(own, moved_n=since_s * [0.0, east_m_per_s, 0.0], turn_n=np.array([0, 0, DEG])),
    )
    assert dive.reference is not None
    nothing = np.full_like(dive.reference.velocity_n, np.nan)
    fixes = replace(dive.reference.without_attitude(), velocity_n=nothing)
    write_dive(tmp_path / "dive.mcap", replace(dive, reference=fixes))
    settings = config(
        Solution(file=str(tmp_path / "own.tum")), initial=Initial(source="level", heading_deg=0.0)
    )
    read = read_checked_dive(tmp_path / "dive.mcap", settings)
    assert ("solution_onboard_is_reference" in [note.code for note in read.notes]) == told


@pytest.mark.parametrize("late_ns", [0, 30_000_000])
def test_a_good_solution_is_evaluated_whenever_it_is_stamped(
    dive: Dive, tmp_path: Path, late_ns: int
) -> None:
    """At the reference's instants, and at none of them: what is as near as 0.3 m is not therefore the same."""
    reference = dive.reference
    assert reference is not None
    near = replace(
        reference,
        time_ns=reference.time_ns + late_ns,
        position=reference.position + np.array([0.3 / 6.4e6, 0.0, 0.1]),
        velocity_n=reference.velocity_n + 0.002,
        mat_nb=reference.mat_nb @ Rotation.from_rotvec([0.0, 0.0, 0.1 * DEG]).as_matrix(),
    )
    settings = msgspec.structs.replace(config("/vehicle"), reference=Reference(topic="/reference"))
    parts = [tmp_path / "dive.mcap", write_nav_solution(tmp_path / "own.mcap", near)]
    write_dive(parts[0], dive)
    replay = replay_dive(read_checked_dive(parts, settings), settings)
    assert "solution_onboard_is_reference" not in codes(replay)
    assert rows(replay, "reference_error")["position_h"].rmse == pytest.approx(0.3, abs=0.05)


@pytest.mark.nightly
@pytest.mark.all_starts
@pytest.mark.parametrize(("factor", "word"), [(1.0, "undecided"), (5.0, "worse"), (0.2, "better")])
def test_the_baseline_from_another_start_is_neither_better_nor_worse(
    factor: float, word: str
) -> None:
    """What flies is often the same filter. From one start a dive it scatters as the baseline does, for which intervals
    allow. With errors five times as large, or as small, over five dives, words are said. One dive has none."""
    settings = config(Solution(topic="/odometry", align="none"), starts=16)
    tactical = load_config("tactical", None, ["dvl.velocity_sd_mps=0.005"])
    settings = msgspec.structs.replace(tactical, filters=settings.filters)
    reports = []
    for seed in range(1, 6):
        made = simulate_dive("figure-eight", seed=seed, duration_s=400.0, grade="tactical")
        onboard = flown_from_a_drawn_start(made, settings, seed, factor)
        replay = replay_dive(replace(made, solutions={"onboard": onboard}), settings)
        assert replay.verdicts["onboard"].verdict == "undecided"
        reports.append(report_of(replay))
    (answer,) = answers_of(reports)
    assert answer.verdict == word


def flown_from_a_drawn_start(
    dive: Dive, settings: Config, seed: int, factor: float
) -> SolutionColumns:
    """Run the baseline as if it flew, from a start as wrong as it says, and make its errors larger by a factor."""
    prepared, reference = prepare_dive(dive, settings), dive.reference
    assert reference is not None
    _, start = drawn_starts(prepared.alignment.start, 2, (seed, 77))
    begun = replace(prepared, alignment=replace(prepared.alignment, start=start))
    onboard = run_one(prepared.filters[0], begun, prepared_timeline(dive, prepared)).motion()
    onboard = onboard.rows(np.isin(onboard.time_ns, reference.time_ns))
    true = reference.rows(np.isin(reference.time_ns, onboard.time_ns))
    turn = Rotation.from_matrix(onboard.mat_nb @ true.mat_nb.swapaxes(1, 2)).as_rotvec()
    wrong = replace(
        onboard,
        position=true.position + factor * (onboard.position - true.position),
        velocity_n=true.velocity_n + factor * (onboard.velocity_n - true.velocity_n),
        mat_nb=Rotation.from_rotvec(factor * turn).as_matrix() @ true.mat_nb,
    )
    return SolutionColumns(wrong, None, *no_covariances())
