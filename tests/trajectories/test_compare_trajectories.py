"""The verdict on trajectories of any program, from files to exit codes."""

import json
import os
import shutil
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from in_process import done_here
from made_tracks import error_m, truth_m, write_dives, write_tum

from insdvl_replay import compare_trajectories
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.tables import finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.trajectories.comparison import TrajectoryAnswer, TrajectoryComparison


@pytest.fixture
def sides(tmp_path: Path) -> Path:
    """Four dives, on which new errs half as much as old."""
    write_dives(tmp_path)
    return tmp_path


def compared(folder: Path, *, new: str = "new", **options: Any) -> TrajectoryComparison:
    found = compare_trajectories(folder / "old", folder / new, folder / "truth", **options)
    comparison: TrajectoryComparison = found.content.data
    return comparison


def answer_of(comparison: TrajectoryComparison) -> TrajectoryAnswer:
    [answer] = comparison.answers
    return answer


def codes(comparison: TrajectoryComparison) -> list[str]:
    return [note.code for note in comparison.notes]


def command(folder: Path, *words: str) -> CompletedProcess[str]:
    return done_here("compare", "old", "new", "--reference", "truth", *words, cwd=folder)


# --- The verdict.


def test_half_of_the_error_is_better_by_its_ratio(sides: Path) -> None:
    answer = answer_of(compared(sides))
    row = answer.decisive
    assert row is not None
    assert (answer.verdict, answer.primary, answer.dives) == (Verdict.BETTER, "position", 4)
    assert row.ratio == pytest.approx(0.5, rel=3e-3)
    assert finite(row.low) < 0.5 < finite(row.high)


def test_the_position_error_is_the_rms_over_the_dive(sides: Path) -> None:
    rows = compared(sides).evidence
    [found] = [row for row in rows if row.log == "dive_2" and row.quantity == "position"]
    horizontal = error_m(2)[1:, :2]
    wanted = np.sqrt(np.mean(np.sum(horizontal**2, axis=1)))
    # On the Earth's surface, whose radius is not that of a plane.
    assert found.baseline == pytest.approx(wanted, rel=1e-5)


def test_the_other_way_round_it_is_worse_by_the_inverse(sides: Path) -> None:
    forth = answer_of(compared(sides)).decisive
    found = compare_trajectories(sides / "new", sides / "old", sides / "truth").content.data
    back = answer_of(found).decisive
    assert forth is not None
    assert back is not None
    assert finite(back.ratio) == pytest.approx(1.0 / finite(forth.ratio), rel=1e-12)
    assert answer_of(found).verdict == Verdict.WORSE


def test_a_copy_has_no_effect(sides: Path) -> None:
    shutil.copytree(sides / "old", sides / "copy")
    answer = answer_of(compared(sides, new="copy"))
    assert answer.verdict == Verdict.NO_EFFECT
    assert {row.acts_most for row in answer.rows if row.acts is not None} == {0.0}


def test_a_copy_with_every_other_row_has_no_effect(sides: Path) -> None:
    for number in range(4):
        track = truth_m(number) + error_m(number)
        path = sides / "sparse" / f"dive_{number}.tum"
        write_tum(path, track, number, rows=slice(None, None, 2))
    assert answer_of(compared(sides, new="sparse")).verdict == Verdict.NO_EFFECT


def test_a_worse_heading_makes_a_better_position_mixed(sides: Path) -> None:
    rng = np.random.default_rng(1)
    for number in range(4):
        track = truth_m(number)
        name = f"dive_{number}.tum"
        wrong = rng.normal(0.0, 0.01, 400)
        write_tum(sides / "old" / name, track + error_m(number), number, yaw=0.3 + wrong)
        write_tum(sides / "new" / name, track + 0.5 * error_m(number), number, yaw=0.3 + 5 * wrong)
    answer = answer_of(compared(sides))
    assert answer.verdict == Verdict.MIXED
    assert [row.quantity for row in answer.warnings] == ["heading"]


def test_one_dive_has_no_verdict(sides: Path) -> None:
    answer = answer_of(compared(sides, dives="dive_1"))
    assert (answer.verdict, answer.undecided) == (Verdict.UNDECIDED, "one dive")


def test_several_candidates_share_the_error_rate(sides: Path) -> None:
    for number in range(4):
        track = truth_m(number) + 0.9 * error_m(number)
        write_tum(sides / "third" / f"dive_{number}.tum", track, number)
    names = [sides / "new", sides / "third"]
    found = compare_trajectories(sides / "old", names, sides / "truth").content.data
    assert [answer.filter for answer in found.answers] == ["new", "third"]
    levels = {answer.decisive.level_pct for answer in found.answers if answer.decisive}
    assert levels == {97.5}


def test_the_quantity_that_is_named_decides(sides: Path) -> None:
    answer = answer_of(compared(sides, primary="drift_10s"))
    assert answer.decisive is not None
    assert answer.decisive.quantity == "drift_10s"
    with pytest.raises(ConfigError, match="drift_11s"):
        compared(sides, primary="drift_11s")


def test_relative_errors_are_there_where_the_track_is_long_enough(sides: Path) -> None:
    quantities = {row.quantity for row in compared(sides).evidence}
    assert {"drift_10s", "drift_60s", "drift_100s", "drift_100m", "drift_200m"} <= quantities
    assert "drift_800m" not in quantities


# --- Which files belong together.


def test_files_without_a_counterpart_are_counted_and_named(sides: Path) -> None:
    (sides / "new" / "dive_3.tum").unlink()
    (sides / "truth" / "dive_0.tum").unlink()
    (sides / "old" / "readme.md").write_text("not a trajectory", "utf-8")
    done = command(sides)
    assert done.returncode == 0
    assert "2 dives" in done.stdout
    assert "2 files are only in old: " in done.stderr
    assert "dive_0.tum, dive_3.tum" in done.stderr
    assert "1 file is only in new" in done.stderr


def test_repeated_runs_are_one_dive_and_their_spread_is_the_floor(sides: Path) -> None:
    shutil.rmtree(sides / "new")
    for number in range(4):
        for run, factor in ((1, 0.5), (2, 1.1)):
            track = truth_m(number) + factor * error_m(number)
            write_tum(sides / "new" / f"run_{run}" / f"dive_{number}.tum", track, number)
    comparison = compared(sides)
    answer = answer_of(comparison)
    row = answer.decisive
    assert row is not None
    assert answer.dives == 4
    assert row.ratio == pytest.approx(np.sqrt((0.5**2 + 1.1**2) / 2.0), rel=1e-6)
    # The four dives agree, but the runs do not.
    assert finite(row.scatter) < 1e-6
    assert answer.verdict == Verdict.UNDECIDED
    # The standard deviation of two logarithms, and Student's t with four degrees of freedom.
    half = 2.7764451 * np.log(1.1 / 0.5) / np.sqrt(2.0)
    assert finite(row.high) / finite(row.ratio) == pytest.approx(np.exp(half), rel=1e-6)
    assert answer.run_factor == pytest.approx(np.exp(half), rel=1e-6)


def test_runs_that_repeat_leave_the_interval_as_it_is(sides: Path) -> None:
    alone = answer_of(compared(sides)).decisive
    for side in ("old", "new"):
        for run in ("run_1", "run_2"):
            shutil.copytree(sides / side, sides / "twice" / side / run)
    shutil.copytree(sides / "truth", sides / "twice" / "truth")
    again = answer_of(compared(sides / "twice")).decisive
    assert alone is not None
    assert again is not None
    assert (again.low, again.high, again.dives) == (alone.low, alone.high, 4)


def test_a_copy_of_a_dive_under_another_name_counts_once(sides: Path) -> None:
    for side in ("old", "new", "truth"):
        shutil.copy(sides / side / "dive_1.tum", sides / side / "copy.tum")
    comparison = compared(sides)
    assert answer_of(comparison).dives == 4
    assert "dives_same" in codes(comparison)


def test_single_files_need_no_common_name(sides: Path) -> None:
    files = [sides / side / "dive_1.tum" for side in ("old", "new", "truth")]
    old, new, truth = files
    found = compare_trajectories(old, new, truth.rename(sides / "gt.tum")).content.data
    assert found.baseline == "old_dive_1"
    assert answer_of(found).filter == "new_dive_1"
    assert [dive.log for dive in found.dives] == ["gt"]


def test_names_in_any_letters(tmp_path: Path) -> None:
    folder = tmp_path / "Tauchgänge 深海"
    write_dives(folder, dives=3)
    done = command(folder)
    assert done.returncode == 0
    assert "BETTER" in done.stdout


# --- Frames.


def test_an_alignment_takes_out_a_turned_frame(sides: Path) -> None:
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    for side, ratio in (("old", 1.0), ("new", 0.5)):
        for number in range(4):
            track = (truth_m(number) + ratio * error_m(number)) @ turn.T + [400.0, 70.0, 3.0]
            write_tum(sides / side / f"dive_{number}.tum", track, number)
    as_given = compared(sides)
    assert answer_of(as_given).verdict == Verdict.NOT_EVALUATED
    assert "--align yaw" in answer_of(as_given).reason
    for align in ("yaw", "se3", "sim3"):
        aligned = compared(sides, align=align)
        row = answer_of(aligned).decisive
        assert row is not None
        assert row.ratio == pytest.approx(0.5, rel=0.01)
        assert aligned.align == align


def test_exchanged_axes_are_an_error_with_the_option_that_reads_them(sides: Path) -> None:
    for number in range(4):
        track = (truth_m(number) + error_m(number))[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        write_tum(sides / "ned" / f"dive_{number}.tum", track, number)
    with pytest.raises(LogError, match="north and east are exchanged") as refusal:
        compare_trajectories(sides / "ned", sides / "ned", sides / "truth")
    assert "--axes ned_frd" in refusal.value.hint


def test_clocks_without_a_common_time_are_an_error(sides: Path) -> None:
    for number in range(4):
        track = truth_m(number)
        write_tum(sides / "new" / f"dive_{number}.tum", track, number, late_s=7200.0)
    done = command(sides)
    assert done.returncode == 3
    assert "nothing in common" in done.stderr
    assert "2 h" in done.stderr


def test_a_dive_that_cannot_be_compared_is_named_and_the_others_go_on(sides: Path) -> None:
    (sides / "new" / "dive_2.tum").write_text("1 2 3\n", "utf-8")
    comparison = compared(sides)
    assert answer_of(comparison).dives == 3
    [found] = [note for note in comparison.notes if note.code == "trajectory_failed"]
    assert "dive_2.tum: line 1 is no pose" in found.text


def test_pipes_and_links_to_themselves_are_named_and_the_others_go_on(sides: Path) -> None:
    for side in ("old", "new", "truth"):
        os.mkfifo(sides / side / "pipe.txt")
        (sides / side / "loop.tum").symlink_to("loop.tum")
    comparison = compared(sides)
    assert answer_of(comparison).dives == 4
    found = [note.text for note in comparison.notes if note.code == "trajectory_failed"]
    assert len(found) == 2
    assert "pipe.txt: is a pipe or a device" in found[1]
    assert "loop.tum: cannot be read: Too many levels of symbolic links" in found[0]


def test_more_poses_than_there_are_give_no_relative_errors(sides: Path) -> None:
    comparison = compared(sides, rpe=["99999999999999999999f"])
    kinds = {row.quantity[:3] for row in comparison.trajectory_errors}
    assert kinds == {"ape"}


def test_the_reference_itself_is_refused(sides: Path) -> None:
    shutil.copytree(sides / "truth", sides / "same")
    with pytest.raises(LogError, match="its error would be 0"):
        compared(sides, new="same")


def test_a_filter_that_stops_early_is_compared_on_its_part_or_not_evaluated(sides: Path) -> None:
    for number, count in ((0, 300), (1, 150)):
        track = truth_m(number) + 0.5 * error_m(number)
        path = sides / "new" / f"dive_{number}.tum"
        write_tum(path, track, number, rows=slice(0, count))
    comparison = compared(sides)
    reasons = {dive.log: dive.reason for dive in comparison.dives}
    assert reasons["dive_0"] == ""
    assert reasons["dive_1"] == "new covers 37 % of the dive"
    [found] = [note for note in comparison.notes if note.code == "trajectory_coverage"]
    assert found.text.endswith("on 2 dives: dive_0 (75 %), dive_1 (37 %)")


@pytest.mark.parametrize(
    ("text", "code"), [("", 3), ("# only a comment\n", 3), ("1.0 0 0 0 0 0 0 1\n", 3)]
)
def test_files_without_enough_poses_are_an_error(sides: Path, text: str, code: int) -> None:
    for path in (sides / "new").iterdir():
        path.write_text(text, "utf-8")
    done = command(sides)
    assert (done.returncode, "Traceback" in done.stderr) == (code, False)
    assert "dive_0.tum" in done.stderr


# --- The command.


def test_json_has_the_verdict_of_each_filter(sides: Path) -> None:
    done = command(sides, "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    [answer] = found["answers"]
    assert (answer["filter"], answer["verdict"]) == ("new", "better")
    assert answer["rows"][0]["role"] == "primary"


def test_worse_fails_on_request(sides: Path) -> None:
    words = ["compare", "new", "old", "--reference", "truth", "--fail-on"]
    assert done_here(*words, "worse", cwd=sides).returncode == 1
    assert done_here(*words, "undecided", cwd=sides).returncode == 1
    assert done_here(*words, "5%", cwd=sides).returncode == 2
    assert command(sides, "--fail-on", "worse").returncode == 0


@pytest.mark.parametrize(
    "words",
    [
        ["--all"],
        ["--tolerance", "1%"],
        ["--rpe", "5 km"],
        ["--rpe", "1.5f"],
        ["--rpe", "9" * 400 + "m"],
        ["--table", "outage"],
        ["--dive", "dive_9"],
        ["--primary", "outage_60s"],
        ["--max-diff", "nan"],
    ],
)
def test_options_that_do_not_fit_are_usage_errors(sides: Path, words: list[str]) -> None:
    done = command(sides, *words)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert "hint: " in done.stderr


def test_options_of_trajectories_need_a_reference(sides: Path) -> None:
    done = done_here("compare", "old", "new", "--align", "yaw", cwd=sides)
    assert (done.returncode, "--reference" in done.stderr) == (2, True)
    done = done_here("compare", "old", "new", "truth", cwd=sides)
    assert (done.returncode, "--reference" in done.stderr) == (2, True)


def test_a_named_table_is_printed_alone(sides: Path) -> None:
    done = command(sides, "--table", "trajectory_errors", "--format", "csv", "--rpe", "100m")
    header, *rows = done.stdout.splitlines()
    assert header.startswith("log,filter,run,quantity")
    assert len(rows) == 4 * 2 * 8
    assert any(",100 m,consecutive," in row for row in rows)


def test_the_page_shows_the_verdict_and_each_dive(sides: Path) -> None:
    text = command(sides, "--format", "html").stdout
    assert "BETTER" in text
    assert all(f"dive_{number}" in text for number in range(4))


# --- Noise of the reference.


def test_noise_of_the_reference_is_no_equality(sides: Path) -> None:
    rng = np.random.default_rng(5)
    for number in range(4):
        track = truth_m(number) + rng.normal(0.0, 3.0, (400, 3))
        write_tum(sides / "truth" / f"dive_{number}.tum", track, number)
    comparison = compared(sides)
    answer = answer_of(comparison)
    assert (answer.verdict, answer.undecided) == (Verdict.UNDECIDED, "noise of the reference")
    [found] = [note for note in comparison.notes if note.code == "trajectory_noise"]
    sizes = [
        float(part.split("(")[1].split(" ")[0]) for part in found.text.split(": ")[1].split(", ")
    ]
    assert sizes == pytest.approx([3.0] * 4, rel=0.15)


def test_without_noise_equal_errors_are_equivalent(sides: Path) -> None:
    for number in range(4):
        track = truth_m(number) + error_m(number)[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
        write_tum(sides / "new" / f"dive_{number}.tum", track, number)
    assert answer_of(compared(sides)).verdict == Verdict.EQUIVALENT


def test_a_filter_without_positions_is_not_evaluated(sides: Path) -> None:
    for path in (sides / "new").iterdir():
        lines = [line.split() for line in path.read_text("utf-8").splitlines()]
        texts = [" ".join([words[0], "nan", "nan", "nan", *words[4:]]) for words in lines]
        path.write_text("\n".join(texts) + "\n", "utf-8")
    comparison = compared(sides)
    answer = answer_of(comparison)
    assert (answer.verdict, answer.reason) == (Verdict.NOT_EVALUATED, "new has no positions")
    assert "trajectory_lacks" in codes(comparison)
