"""Filters of the user's: a program or a class gets the evidence of any candidate, and its failures change no other."""

import json
import re
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest
from baseline_as_candidate import FITTING, Baseline

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.config_file import load_config, render_toml
from insdvl_replay.core.dive_columns import Dive, DvlColumns, SensorColumns
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import EvidenceRow, each_table
from insdvl_replay.core.words import Verdict
from insdvl_replay.geometry.frames import moved_position, north_east_down_m, quat_enu_flu
from insdvl_replay.geometry.rotation import mat_from_rpy, rpy_from_mat
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.logs.write import components, stamped, write_log
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.user_candidate import Candidate, CandidateError, CandidateStart, Solution
from insdvl_replay.nav.user_measurement import load_class
from insdvl_replay.preparation.candidates import history_of_candidate
from insdvl_replay.preparation.replay import Replay, replay_dive, replay_log
from insdvl_replay.preparation.solution_check import checked_solution
from insdvl_replay.preparation.solution_files import (
    ATTITUDE,
    POSITION,
    VELOCITY,
    read_solution,
)
from insdvl_replay.preparation.source_errors import ATTITUDE_FLOOR, VELOCITY_FLOOR_MPS
from insdvl_replay.preparation.user_process import run_over_files
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.sim.sensor_errors import SensorErrors

HERE = "baseline_as_candidate"
FAILING = "failing_candidates"
FILTERS = {"baseline": Filter(aiding=("velocity",)), "beams": Filter(aiding=("beams",))}
HEADER = ",".join(["time_ns", *POSITION, *VELOCITY, *ATTITUDE])
FIRST_LINES = (
    "import json, pathlib, sys\ndive, start, solution = map(pathlib.Path, sys.argv[1:])\n"
)


@pytest.fixture(scope="module")
def dive() -> Dive:
    return simulate_dive("lawnmower", seed=3, duration_s=220.0, imu_rate_hz=50.0)


@pytest.fixture(scope="module")
def short() -> Dive:
    """A dive without the windows of an outage test, over which a filter has fewer runs."""
    return simulate_dive("lawnmower", seed=3, duration_s=60.0, imu_rate_hz=50.0)


@pytest.fixture(scope="module")
def short_alone(short: Dive) -> Replay:
    return replay_dive(short, config())


@pytest.fixture(scope="module")
def alone(dive: Dive) -> Replay:
    """The other candidates without one of the user's."""
    return replay_dive(dive, config())


@pytest.fixture(scope="module")
def written(dive: Dive, alone: Replay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The baseline's trajectory as a program would write it."""
    path, baseline = tmp_path_factory.mktemp("solution") / "solution.csv", alone.histories[0]
    write_solution(
        path, Solution(baseline.time_ns, baseline.position, baseline.velocity_n, baseline.mat_nb)
    )
    return path


def write_solution(path: Path, solution: Solution) -> None:
    """Write a solution as a program does, with all digits."""
    assert solution.position is not None
    assert solution.velocity_n is not None
    assert solution.mat_nb is not None
    degrees = solution.position / [DEG, DEG, 1.0], rpy_from_mat(solution.mat_nb) / DEG
    numbers = np.column_stack([degrees[0], solution.velocity_n, degrees[1]]).tolist()
    rows = (
        ",".join(map(repr, [time_ns, *row]))
        for time_ns, row in zip(solution.time_ns.tolist(), numbers, strict=True)
    )
    path.write_text("\n".join([HEADER, *rows, ""]))


def config(mine: Filter | None = None, **evaluation: Any) -> Config:
    filters = FILTERS if mine is None else {**FILTERS, "mine": mine}
    return settings_of(filters, **({"starts": 1, "repeats": False} | evaluation))


def settings_of(filters: dict[str, Filter], **evaluation: Any) -> Config:
    """Return settings whose noise is that of the simulated sensors, so that candidates are evaluated."""
    return msgspec.structs.replace(FITTING, filters=filters, evaluation=Evaluation(**evaluation))


def program(folder: Path, script: str, **settings: Any) -> Filter:
    """Write a program that begins with its three paths."""
    path = folder / "mine.py"
    path.write_text(FIRST_LINES + script)
    return Filter(
        program=(sys.executable, "-S", "-E", str(path), "{dive}", "{start}", "{solution}"),
        **settings,
    )


def copying(written: Path) -> str:
    return f"solution.write_bytes(pathlib.Path({str(written)!r}).read_bytes())\n"


def evidence(replay: Replay) -> dict[str, EvidenceRow]:
    return {row.quantity: row for row in replay.tables.evidence if row.filter == "mine"}


def rows_of_others(replay: Replay) -> bytes:
    tables = {
        layout.name: [row for row in rows if getattr(row, "filter", "") != "mine"]
        for layout, rows in each_table(replay.tables)
    }
    verdicts = {name: verdict for name, verdict in replay.verdicts.items() if name != "mine"}
    return msgspec.json.encode([tables, verdicts])


# --- The same evidence.


@pytest.mark.nightly
def test_the_baseline_as_a_class_has_no_effect_in_any_evidence(dive: Dive, alone: Replay) -> None:
    replay = replay_dive(dive, config(Filter(candidate=f"{HERE}:Baseline")))
    rows = evidence(replay)
    assert {"drift_30s", "velocity_along", "outage_30s", "position"} <= set(rows)
    ratios = {quantity: row.ratio for quantity, row in rows.items() if row.ratio is not None}
    assert ratios == pytest.approx(dict.fromkeys(ratios, 1.0), abs=1e-6)
    assert replay.verdicts["mine"].verdict == Verdict.NO_EFFECT
    assert rows_of_others(replay) == rows_of_others(alone)
    assert not any(row.filter == "mine" for row in replay.tables.consistency)
    assert not any(row.filter == "mine" for row in replay.tables.credibility)


def test_covariance_gives_nees_and_innovations_give_nis(short: Dive) -> None:
    replay = replay_dive(short, config(Filter(candidate=f"{HERE}:BaselineWithCov")))
    nis = {row.filter: row for row in replay.tables.consistency if row.measurement == "velocity_x"}
    assert nis["mine"].mean_nis == pytest.approx(nis["baseline"].mean_nis, rel=1e-6)
    nees = {row.filter: row for row in replay.tables.credibility if row.quantity == "attitude"}
    assert nees["mine"].mean_nees == pytest.approx(nees["baseline"].mean_nees, rel=0.05)


def test_a_program_is_given_what_the_filters_get_and_nothing_that_judges_them(
    dive: Dive, written: Path, tmp_path: Path
) -> None:
    script = (
        copying(written)
        + f"pathlib.Path({str(tmp_path)!r}, dive.name).write_bytes(dive.read_bytes())\n"
    )
    script += f"pathlib.Path({str(tmp_path)!r}, 'start.json').write_bytes(start.read_bytes())\n"
    replay_dive(dive, config(program(tmp_path, script)))
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == [
        "dive.mcap", "outage_1.mcap", "outage_2.mcap", "outage_3.mcap",
    ]  # fmt: skip
    given = {path.stem: read_dive(path, Config()) for path in tmp_path.glob("*.mcap")}
    assert all(found.reference is None and found.truth is None for found in given.values())
    absent = [set(dive.dvl.time_ns) - set(given[f"outage_{i}"].dvl.time_ns) for i in (1, 2, 3)]
    start_ns = int(dive.dvl.time_ns[0])
    assert all(len(times) >= 30 for times in absent)
    assert sum(map(len, absent)) == len(set.union(*absent))
    assert set.union(*absent) <= set(dive.dvl.time_ns[dive.dvl.time_ns > start_ns + 99 * 10**9])
    start = json.loads((tmp_path / "start.json").read_text())
    assert start["time_ns"] == dive.imu.time_ns[0]
    # Of a reference without noise.
    assert start["velocity_ned_mps_sd"] == [VELOCITY_FLOOR_MPS] * 3
    level, _, heading = ATTITUDE_FLOOR / DEG
    assert start["roll_pitch_heading_deg_sd"] == pytest.approx([level, level, heading], rel=0.01)


@pytest.mark.parametrize("held_out", [(), ("depth",)])
def test_a_program_is_given_the_log_without_what_judges_it(
    held_out: tuple[str, ...], written: Path, tmp_path: Path
) -> None:
    sensors = {"depth": SensorErrors(0.05, 4.0)}
    dive = simulate_dive("lawnmower", seed=3, duration_s=220.0, imu_rate_hz=50.0, sensors=sensors)
    write_dive(tmp_path / "dive.mcap", dive)
    script = (
        copying(written)
        + f"pathlib.Path({str(tmp_path)!r}, dive.name).write_bytes(dive.read_bytes())\n"
    )
    mine = program(tmp_path, script, input="log")
    assert (
        not replay_log(tmp_path / "dive.mcap", config(mine, held_out=held_out))
        .histories[-1]
        .failure
    )
    files = sorted(tmp_path.glob("*_log.mcap"))
    assert [path.name for path in files] == [
        "dive_log.mcap",
        *(f"outage_{i}_log.mcap" for i in (1, 2, 3)),
    ]
    whole, *outages = (read_dive(path, Config()) for path in files)
    np.testing.assert_array_equal(whole.imu.specific_force_b, dive.imu.specific_force_b)
    np.testing.assert_array_equal(whole.dvl.time_ns, dive.dvl.time_ns)
    assert {channel.topic for channel in whole.channels} == {
        "/imu",
        "/dvl",
        *(() if held_out else ["/pressure"]),
    }
    absent = [set(dive.dvl.time_ns) - set(found.dvl.time_ns) for found in outages]
    assert sum(map(len, absent)) == len(set.union(*absent)) >= 90


def test_a_dive_without_a_file_has_no_log_to_give(
    dive: Dive, written: Path, tmp_path: Path
) -> None:
    replay = replay_dive(dive, config(program(tmp_path, copying(written), input="log")))
    assert "its input is the log" in replay.verdicts["mine"].sentence


@pytest.mark.parametrize(
    ("held_out", "given"), [((), "given ['depth']"), (("depth",), "given []")]
)
def test_a_class_is_not_given_a_sensor_that_is_held_out(
    held_out: tuple[str, ...], given: str
) -> None:
    sensors = {"depth": SensorErrors(0.05, 4.0)}
    dive = simulate_dive("lawnmower", seed=3, duration_s=30.0, imu_rate_hz=50.0, sensors=sensors)
    replay = replay_dive(dive, config(Filter(candidate=f"{FAILING}:Depths"), held_out=held_out))
    assert given in replay.verdicts["mine"].sentence


@pytest.mark.all_starts
def test_a_program_that_ignores_its_start_is_reported(
    dive: Dive, written: Path, tmp_path: Path
) -> None:
    replay = replay_dive(dive, config(program(tmp_path, copying(written)), starts=3))
    assert "candidate_ignores_start" in {note.code for note in replay.notes}
    assert evidence(replay)["drift_30s"].starts == 1, (
        "accuracy is from the start that the dive had"
    )


# --- Failures.

LINES = "lines = solution.read_text().splitlines(keepends=True)\n"
FAILURES = {
    "exit code": (
        "sys.stderr.write('singular matrix')\nsys.exit(3)",
        "ended with exit code 3: singular matrix",
    ),
    "signal": ("import os\nos.abort()", "was ended by the signal SIGABRT"),
    "no output": ("solution.unlink()", "wrote no solution"),
    "empty": ("solution.write_text('')", "wrote an empty solution"),
    "no numbers": ("solution.write_text('time_ns,height_m\\n1,deep\\n')", "is not CSV of numbers"),
    "unknown column": (
        "solution.write_text('time_ns,vn\\n1,2\\n')",
        "column 'vn', which is not known",
    ),
    "half a group": (
        "solution.write_text('time_ns,roll_deg\\n1,2\\n')",
        "without pitch_deg and heading_deg",
    ),
    "NaN": (
        LINES
        + "lines[9] = lines[9].split(',')[0] + ',nan' * 9 + '\\n'\nsolution.write_text(''.join(lines))",
        "not finite in 1 of",
    ),
    "wrong times": (
        LINES + "solution.write_text(lines[0] + ''.join('2' + line[1:] for line in lines[1:]))",
        "wrong times",
    ),
    "half a file": (
        LINES + "solution.write_text(''.join(lines[: len(lines) // 2]))",
        "only 50 % of the replay",
    ),
    "a header alone": ("solution.write_text('time_ns,height_m')", "without rows"),
    "an endless time": (
        "solution.write_text(f'time_ns,roll_deg,pitch_deg,heading_deg\\n{9 ** 40},1,1,1\\n')",
        "not whole nanoseconds",
    ),
    "a comma too many": (
        "solution.write_text('time_ns,roll_deg\\n1,2,\\n')",
        "longer than its header",
    ),
    "a folder": ("solution.unlink()\nsolution.mkdir()", "wrote a solution: "),
    "an unknown signal": ("import os\nos.kill(os.getpid(), 40)", "the signal 40"),
    "cut off": ("solution.write_text(solution.read_text()[:-70])", "is cut off in line"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_is_not_evaluated_and_changes_no_other_candidate(
    failure: str, dive: Dive, alone: Replay, written: Path, tmp_path: Path
) -> None:
    script, reason = FAILURES[failure]
    replay = replay_dive(dive, config(program(tmp_path, copying(written) + script)))
    verdict = replay.verdicts["mine"]
    assert verdict.verdict == Verdict.NOT_EVALUATED
    assert reason in verdict.sentence
    assert {row.role for row in evidence(replay).values()} <= {"shown"}, "nothing decides or warns"
    assert rows_of_others(replay) == rows_of_others(alone)


def test_a_program_that_hangs_is_ended(short: Dive, tmp_path: Path) -> None:
    script = "import subprocess, time\nsubprocess.Popen(['sleep', '77'])\nprint('now', flush=True)\ntime.sleep(77)"
    replay = replay_dive(short, config(program(tmp_path, script, timeout_s=0.3)))
    assert "mine did not end within 0.3 s" in replay.verdicts["mine"].sentence
    assert "now\n" in replay.printed["mine"]


@pytest.mark.parametrize("end", ["sys.exit(0)", "os.abort()"])
def test_what_a_program_has_started_ends_with_it(end: str, short: Dive, tmp_path: Path) -> None:
    script = "import os, subprocess\nchild = subprocess.Popen(['sleep', '77'])\n"
    script += f"pathlib.Path({str(tmp_path)!r}, 'pid').write_text(str(child.pid))\n"
    replay_dive(short, config(program(tmp_path, script + end)))
    child = Path("/proc", (tmp_path / "pid").read_text(), "stat")
    until = time.monotonic() + 5.0
    while child.exists() and child.read_text().split()[2] != "Z" and time.monotonic() < until:
        time.sleep(0.01)
    assert not child.exists() or child.read_text().split()[2] == "Z"


def test_a_program_cannot_change_the_dive_of_others(
    dive: Dive, written: Path, tmp_path: Path
) -> None:
    filters = dict(FILTERS)
    for name, script in (
        ("mine", "dive.write_bytes(b'')"),
        ("other", "sys.exit(not dive.read_bytes())"),
    ):
        (tmp_path / name).mkdir()
        filters[name] = program(tmp_path / name, f"{copying(written)}{script}")
    replay = replay_dive(dive, settings_of(filters, starts=1))
    for name in ("mine", "other"):
        assert replay.verdicts[name].verdict != Verdict.NOT_EVALUATED
        [position] = (
            row
            for row in replay.tables.evidence
            if (row.filter, row.quantity) == (name, "position")
        )
        assert position.ratio == pytest.approx(1.0, abs=1e-6)


def test_a_program_that_is_not_there(short: Dive) -> None:
    replay = replay_dive(short, config(Filter(program=("./nowhere", "{dive}", "{solution}"))))
    assert "cannot be started: ./nowhere: No such file" in replay.verdicts["mine"].sentence


@pytest.mark.parametrize("scenario", ["figure-eight", "straight"])
def test_the_solution_of_another_dive(scenario: str, dive: Dive, tmp_path: Path) -> None:
    other = simulate_dive(scenario, seed=3, duration_s=220.0, imu_rate_hz=50.0)
    run = replay_dive(other, config()).histories[0]
    write_solution(
        tmp_path / "other.csv", Solution(run.time_ns, run.position, run.velocity_n, run.mat_nb)
    )
    replay = replay_dive(dive, config(program(tmp_path, copying(tmp_path / "other.csv"))))
    assert "not of this dive" in replay.verdicts["mine"].sentence


def test_a_solution_that_turns_as_the_gyros_is_of_this_dive_though_the_baseline_does_not(
    dive: Dive, alone: Replay
) -> None:
    own, velocities = alone.histories[0], dvl_velocities(dive.dvl)
    heading = np.linspace(0.0, 6.0, len(own.time_ns))
    turning = mat_from_rpy(np.column_stack([0.0 * heading, 0.0 * heading, heading])) @ own.mat_nb
    right, wrong = (
        Solution(own.time_ns, own.position, own.velocity_n, mat_nb)
        for mat_nb in (own.mat_nb, turning)
    )
    start, none = start_of(dive), own.time_ns[:0]
    bad_baseline = replace(own, mat_nb=turning)
    history_of_candidate(
        "mine", right, start, start.time_ns, dive.imu, velocities, bad_baseline, none
    )
    with pytest.raises(CandidateError, match="its turns in 10 s differ from the gyros' by 16 deg"):
        history_of_candidate("mine", wrong, start, start.time_ns, dive.imu, velocities, own, none)


def test_a_solution_that_begins_after_the_baseline_broke_down_is_not_compared_with_it(
    dive: Dive, alone: Replay
) -> None:
    own = alone.histories[0]
    count = len(own.time_ns)
    is_broken = np.arange(count) >= count // 20
    broken = replace(
        own,
        velocity_n=np.where(is_broken[:, None], np.nan, own.velocity_n),
        mat_nb=np.where(is_broken[:, None, None], np.nan, own.mat_nb),
    )
    # A first row before the start, and a pause in which nothing is known.
    kept = np.arange(count) >= count // 15
    kept[0] = True
    time_ns = own.time_ns[kept]
    time_ns[0] -= 1
    late = Solution(time_ns, own.position[kept], own.velocity_n[kept], own.mat_nb[kept])
    start = start_of(dive)
    velocities = dvl_velocities(dive.dvl)
    history, _ = history_of_candidate(
        "mine", late, start, start.time_ns, dive.imu, velocities, broken, own.time_ns[:0]
    )
    assert 0.92 < np.isfinite(history.velocity_n[:, 0]).mean() < 0.94


def test_a_solution_in_degrees_is_said_to_be(dive: Dive, alone: Replay) -> None:
    own = alone.histories[0]
    in_degrees = own.position * [180.0 / np.pi, 180.0 / np.pi, 1.0]
    start = start_of(dive)
    velocities = dvl_velocities(dive.dvl)
    with pytest.raises(CandidateError, match="rad, so its angles may be degrees"):
        history_of_candidate(
            "mine",
            Solution(own.time_ns, in_degrees),
            start,
            start.time_ns,
            dive.imu,
            velocities,
            own,
            own.time_ns[:0],
        )


@pytest.mark.parametrize(
    ("word", "reason", "printed"),
    [
        ("Failing", "failing_candidates.py: ZeroDivisionError: here", "before\n"),
        ("Leaving", "ended with exit code 7", "to the descriptor\n"),
        ("Unfinished", "returns NoneType, not Solution", ""),
        ("Writing", "wrote into the pipe of its answer", ""),
    ],
)
def test_a_class_that_fails(
    word: str,
    reason: str,
    printed: str,
    short: Dive,
    short_alone: Replay,
    capfd: pytest.CaptureFixture[str],
) -> None:
    replay = replay_dive(short, config(Filter(candidate=f"{FAILING}:{word}")))
    assert reason in replay.verdicts["mine"].sentence
    assert rows_of_others(replay) == rows_of_others(short_alone)
    assert replay.printed.get("mine", "") == printed
    assert capfd.readouterr() == ("", "")


def test_a_class_that_hangs_is_ended(short: Dive, short_alone: Replay) -> None:
    replay = replay_dive(short, config(Filter(candidate=f"{FAILING}:Sleeping", timeout_s=0.5)))
    assert "mine did not end within 0.5 s" in replay.verdicts["mine"].sentence
    assert replay.verdicts["mine"].verdict == Verdict.NOT_EVALUATED
    assert rows_of_others(replay) == rows_of_others(short_alone)


@pytest.mark.nightly
def test_a_process_that_a_class_left_behind_is_not_waited_for(short: Dive) -> None:
    began_s = time.monotonic()
    replay = replay_dive(short, config(Filter(candidate=f"{FAILING}:Daemon")))
    assert "mine ended with exit code 7" in replay.verdicts["mine"].sentence
    assert time.monotonic() - began_s < 15.0


def test_a_class_may_return_its_own_kind_of_solution(
    short: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(sys.modules[HERE], "OwnSolution")  # this process does not know it
    replay = replay_dive(short, config(Filter(candidate=f"{HERE}:Deriving")))
    assert replay.verdicts["mine"].verdict == Verdict.NO_EFFECT


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        (f"{FAILING}:Failng", "is not in failing_candidates; the nearest name is Failing"),
        ("not_there:Mine", "cannot be imported: No module named 'not_there'"),
        (f"{__name__}:config", "is not a class derived from Candidate"),
    ],
)
def test_a_class_that_is_not_there_is_reported(word: str, reason: str) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)):
        load_class(word, Candidate)


def test_a_class_that_is_not_there_is_an_error_of_the_settings(short: Dive) -> None:
    with pytest.raises(ConfigError, match=r":Failng is not in .*; the nearest name is Failing"):
        replay_dive(short, config(Filter(candidate=f"{FAILING}:Failng")))


def test_files_of_the_current_folder_are_not_modules_of_a_class(
    short: Dive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pickle.py").write_text("raise SystemExit(3)\n")
    replay = replay_dive(short, config(Filter(candidate=f"{FAILING}:Failing")))
    assert "ZeroDivisionError: here" in replay.verdicts["mine"].sentence


def test_a_class_cannot_change_the_dive_of_others(short: Dive) -> None:
    scaling = Filter(candidate=f"{FAILING}:Scaling")
    filters = {**FILTERS, "mine": scaling, "other": scaling}
    verdicts = replay_dive(short, settings_of(filters, starts=1)).verdicts
    first, second = (verdicts[name].sentence for name in ("mine", "other"))
    assert re.findall(r"given \S+", first) == re.findall(r"given \S+", second) != []


# --- Readings as CSV.

PLAIN = """
import csv, pathlib, sys
for name in sys.argv[3:]:
    pathlib.Path(sys.argv[2], pathlib.Path(name).name).write_bytes(pathlib.Path(name).read_bytes())
assert {pathlib.Path(name).suffix for name in sys.argv[3:]} == {".csv"}
assert not list(pathlib.Path(sys.argv[3]).parent.glob("*.mcap")), "nobody reads it"
"""


def numbers_in(path: Path) -> dict[str, list[float]]:
    """Read a table of readings by its titles: whole numbers of the time, and NaN of an empty cell."""
    titles, *rows = (line.split(",") for line in path.read_text().splitlines())
    columns: dict[str, list[float]] = {title: [] for title in titles}
    for row in rows:
        for title, cell in zip(titles, row, strict=True):
            columns[title].append(int(cell) if title == "time_ns" else float(cell or "nan"))
    return columns


def test_a_program_may_read_csv_with_the_numbers_of_the_dive(
    dive: Dive, written: Path, tmp_path: Path
) -> None:
    """The files hold all digits of what filters get, and a sensor that the dive lacks is a header alone."""
    keep = tmp_path / "kept"
    keep.mkdir()
    script = tmp_path / "mine.py"
    script.write_text(PLAIN + f"solution = pathlib.Path(sys.argv[1])\n{copying(written)}")
    files = ("{imu_csv}", "{dvl_csv}", "{depth_csv}", "{heading_csv}", "{position_csv}")
    words = (sys.executable, "-S", "-E", str(script), "{solution}", str(keep), *files)
    deep = replace(
        dive,
        sensors={
            "depth": SensorColumns(
                dive.dvl.time_ns, np.linspace(1, 2, len(dive.dvl.time_ns))[:, None]
            )
        },
    )
    filters = {"baseline": Filter(aiding=("velocity", "depth")), "mine": Filter(program=words)}
    replay = replay_dive(deep, settings_of(filters, starts=1))
    assert replay.verdicts["mine"].verdict != Verdict.NOT_EVALUATED, replay.verdicts["mine"]
    imu = numbers_in(keep / "dive_imu.csv")
    inside = np.isin(dive.imu.time_ns, imu["time_ns"])
    assert inside.sum() == len(imu["time_ns"]) > 0.9 * len(dive.imu.time_ns)
    for axis, name in enumerate("xyz"):
        force = dive.imu.specific_force_b[inside, axis]
        rate = dive.imu.angular_rate_b[inside, axis]
        assert imu[f"specific_force_{name}_mps2"] == force.tolist()
        assert imu[f"angular_rate_{name}_radps"] == rate.tolist()
    velocities = dvl_velocities(deep.dvl)
    dvl = numbers_in(keep / "dive_dvl.csv")
    at = np.isin(velocities.time_ns, dvl["time_ns"])
    for axis, name in enumerate("xyz"):
        np.testing.assert_allclose(
            dvl[f"velocity_{name}_mps"], velocities.velocity_b[at, axis], atol=1e-12
        )
    depth = numbers_in(keep / "dive_depth.csv")
    assert depth["depth_m"][0] == pytest.approx(1.0, abs=0.1)
    assert len(numbers_in(keep / "outage_1_dvl.csv")["time_ns"]) < len(dvl["time_ns"])
    for name in ("heading", "position"):
        assert numbers_in(keep / f"dive_{name}.csv")["time_ns"] == []
    assert {"stamps", "samples"} & {path.name.split("_")[1] for path in keep.iterdir()}


# --- Settings.


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ('filters.mine.program=["./a"]', "no argument with {dive} or {imu_csv} and {solution}"),
        ('filters.mine.program=["./a", "{imu_csv}"]', "no argument with {solution}"),
        (
            'filters.mine={program=["./a", "{imu_csv}", "{solution}"], input="log"}',
            "filters.mine.input has no use without {dive}",
        ),
        ("filters.mine.program=[]", "program is empty"),
        ("filters.mine.candidate=Mine", "not of the form module:Class"),
        ('filters.mine={candidate="a:B", aiding=["velocity"]}', "filters.mine.aiding has no use"),
        ('filters.baseline={candidate="a:B"}', "cannot be the baseline"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        load_config(overrides=[settings], allow_code=True)


def test_settings_of_a_program_are_written_and_read(tmp_path: Path) -> None:
    words = '["./mine", "{dive}", "../{solution}"]'
    (tmp_path / "a.toml").write_text(
        f'[filters.baseline]\naiding = ["velocity"]\n[filters.mine]\nprogram = {words}\n'
    )
    found = load_config(file=tmp_path / "a.toml", allow_code=True)
    assert found.filters["mine"].program == (
        str(tmp_path / "mine"),
        "{dive}",
        str(tmp_path / "../{solution}"),
    )
    (tmp_path / "b.toml").write_text(render_toml(found))
    assert load_config(file=tmp_path / "b.toml", allow_code=True) == found
    assert found.without_code().filters.keys() == {"baseline"}
    with pytest.raises(ConfigError, match=r"a\.toml: filters\.mine\.program names code: .*/mine "):
        load_config(file=tmp_path / "a.toml")


@pytest.mark.nightly
@pytest.mark.all_starts
def test_the_baseline_as_a_program_has_no_effect_in_any_evidence(dive: Dive) -> None:
    script = str(Path(__file__).with_name(f"{HERE}.py"))
    replay = replay_dive(
        dive,
        config(
            Filter(program=(sys.executable, script, "{dive}", "{start}", "{solution}")), starts=16
        ),
    )
    rows = evidence(replay)
    assert {"drift_30s", "level", "heading", "outage_30s", "convergence_velocity"} <= set(rows)
    drawn = {quantity: row.starts for quantity, row in rows.items() if row.starts > 1}
    converging = [quantity for quantity in rows if quantity.startswith("convergence_")]
    assert drawn == dict.fromkeys(converging, 15), "beside the dive's own start"
    ratios = {
        quantity: row.ratio
        for quantity, row in rows.items()
        if row.ratio is not None and row.ratio > 0.0
    }
    assert ratios == pytest.approx(dict.fromkeys(ratios, 1.0), abs=1e-6)
    assert replay.verdicts["mine"].verdict == Verdict.NO_EFFECT


# --- The example, as a class and as a program.

EXAMPLES = Path(__file__).parents[2] / "examples" / "candidates"


def test_the_example_as_a_class_is_evaluated(dive: Dive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    replay = replay_dive(dive, config(Filter(candidate="dead_reckoning:DeadReckoning")))
    assert replay.verdicts["mine"].verdict != Verdict.NOT_EVALUATED
    assert {"drift_30s", "velocity_across", "outage_30s"} <= set(evidence(replay))
    assert evidence(replay)["drift_30s"].value < 1.0


def start_of(dive: Dive) -> CandidateStart:
    assert dive.reference is not None
    return CandidateStart(
        dive.reference.position[0],
        dive.reference.velocity_n[0],
        dive.reference.mat_nb[0],
        np.diag(np.full(12, 1e-6)),
        np.full(3, 0.01),
        np.full(3, 1e-5),
        time_ns=int(dive.imu.time_ns[0]),
        dvl_lever_arm_b=np.array([1.0, -0.2, 0.3]),
    )


def test_the_files_of_a_program_hold_what_a_class_is_given(dive: Dive, tmp_path: Path) -> None:
    """The same filter as a class, and by the files that a program reads and writes."""
    start = start_of(dive)
    velocities = dvl_velocities(dive.dvl)
    given = Dive(
        "dive", dive.imu, DvlColumns(velocities.time_ns, velocity_d=velocities.velocity_b)
    )
    write_dive(tmp_path / "dive.mcap", given)
    (tmp_path / "start.json").write_bytes(start.to_json())
    run_over_files(
        Baseline, tmp_path / "dive.mcap", tmp_path / "start.json", tmp_path / "solution"
    )
    read, direct = read_solution(tmp_path / "solution", start), Baseline().run(given, start)
    np.testing.assert_array_equal(read.time_ns, direct.time_ns)
    np.testing.assert_allclose(read.velocity_n, direct.velocity_n, atol=1e-9)
    np.testing.assert_allclose(read.position, direct.position, atol=1e-12)
    np.testing.assert_allclose(read.mat_nb, direct.mat_nb, atol=1e-12)


class Idle(Candidate):
    """Lack what a candidate must have."""


def test_a_class_without_run_says_so(dive: Dive) -> None:
    with pytest.raises(NotImplementedError, match=r"has no method run\(self, dive, start\)"):
        Idle().run(dive, start_of(dive))


class Sensing(Candidate):
    """Keep what is given, and answer with a time that is before the last one."""

    sensors: ClassVar[dict[str, SensorColumns]] = {}

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        Sensing.sensors = dict(dive.sensors)
        return Solution(np.array([start.time_ns, start.time_ns - 1]), velocity_n=np.zeros((2, 3)))


def test_a_program_reads_the_sensors_of_its_file_and_writes_no_solution_that_cannot_be(
    tmp_path: Path,
) -> None:
    kinds = ("depth", "heading", "position")
    errors = {kind: SensorErrors(0.05, 4.0) for kind in kinds}
    dive = simulate_dive("lawnmower", seed=3, duration_s=10.0, imu_rate_hz=50.0, sensors=errors)
    paths = [tmp_path / name for name in ("dive.mcap", "start.json", "solution")]
    write_dive(paths[0], replace(dive, reference=None, truth=None))
    paths[1].write_bytes(start_of(dive).to_json())
    with pytest.raises(CandidateError, match="times that are not increasing"):
        run_over_files(Sensing, *paths)
    assert not paths[2].exists()
    assert set(Sensing.sensors) == set(kinds)
    for kind in kinds:
        ours = Sensing.sensors[kind]
        np.testing.assert_array_equal(ours.time_ns, dive.sensors[kind].time_ns)


def test_standard_deviations_of_a_file_become_a_covariance(tmp_path: Path) -> None:
    names = (
        "velocity_n_mps",
        "velocity_e_mps",
        "velocity_d_mps",
        "roll_deg",
        "pitch_deg",
        "heading_deg",
    )
    header = ",".join(["time_ns", *names, *(f"{name}_sd" for name in names)])
    (tmp_path / "a.csv").write_text(f"{header}\n5,1,0,0,0,0,90,0.1,0.2,0.3,1,2,3\n")
    cov = read_solution(
        tmp_path / "a.csv", start_of(simulate_dive("straight", duration_s=20.0))
    ).cov
    assert cov is not None
    np.testing.assert_allclose(np.diagonal(cov[0])[:3], [0.01, 0.04, 0.09])
    # At a heading of 90 deg, roll is about east and pitch about south.
    np.testing.assert_allclose(np.sqrt(np.diagonal(cov[0])[3:6]), np.deg2rad([2.0, 1.0, 3.0]))
    assert np.isnan(np.diagonal(cov[0])[6:]).all()


# --- Other formats.


def write_odometry(path: Path, solution: Solution, origin: np.ndarray, *, fix: bool) -> None:
    """Write what nodes of ROS 2 publish: odometry from an origin of its own, and fixes."""
    assert solution.position is not None
    assert solution.velocity_n is not None
    assert solution.mat_nb is not None
    time_ns, quat = solution.time_ns, quat_enu_flu(solution.mat_nb)
    enu_m = north_east_down_m(solution.position, np.broadcast_to(origin, solution.position.shape))[
        :, [1, 0, 2]
    ]
    twist_b = np.einsum("kji,kj->ki", solution.mat_nb, solution.velocity_n) * [1.0, -1.0, -1.0]
    columns = {
        **components("pose.pose.position", enu_m * [1.0, 1.0, -1.0]),
        **components("pose.pose.orientation", quat, "xyzw"),
        **components("twist.twist.linear", twist_b),
        **components("twist.twist.angular", 0.0),
        "pose.covariance": tuple(np.diag([4.0, 4.0, 4.0, 1e-4, 1e-4, 1e-4]).ravel()),
        "twist.covariance": tuple(np.diag([0.01] * 6).ravel()),
    }
    batches = [stamped("/odometry", "nav_msgs/msg/Odometry", time_ns, "odom", columns)]
    if fix:
        latitude_deg, longitude_deg = np.rad2deg(solution.position[:, :2]).T
        columns = {
            "latitude": latitude_deg,
            "longitude": longitude_deg,
            "altitude": solution.position[:, 2],
        }
        batches.append(stamped("/fix", "sensor_msgs/msg/NavSatFix", time_ns, "base_link", columns))
    write_log(path, batches, {})


@pytest.mark.parametrize("kind", ["odometry", "odometry with fixes", "tum"])
def test_solutions_in_other_formats_are_recognised_by_their_first_bytes(
    kind: str, dive: Dive, tmp_path: Path
) -> None:
    assert dive.reference is not None
    start, path = start_of(dive), tmp_path / "solution"
    motion = dive.reference.rows(np.arange(0, len(dive.reference.time_ns), 5))
    solution = Solution(motion.time_ns, motion.position, motion.velocity_n, motion.mat_nb)
    origin = moved_position(start.position, np.array([30.0, -20.0, 5.0]))
    if kind == "tum":
        enu_m = north_east_down_m(motion.position, np.broadcast_to(origin, motion.position.shape))[
            :, [1, 0, 2]
        ]
        poses = np.column_stack([enu_m * [1.0, 1.0, -1.0], quat_enu_flu(motion.mat_nb)])
        times = [f"{time // 10**9}.{time % 10**9:09d}" for time in motion.time_ns.tolist()]
        rows = (
            f"{time} {' '.join(map(repr, row))}\n"
            for time, row in zip(times, poses.tolist(), strict=True)
        )
        path.write_text("# time x y z qx qy qz qw\n" + "".join(rows))
    else:
        write_odometry(path, solution, origin, fix="fixes" in kind)
    read = read_solution(path, start)
    np.testing.assert_array_equal(read.time_ns, solution.time_ns)
    assert read.position is not None
    off_m = north_east_down_m(read.position, motion.position)
    np.testing.assert_allclose(off_m, 0.0, atol=1e-3)
    np.testing.assert_allclose(read.mat_nb, motion.mat_nb, atol=1e-9)
    if kind == "tum":
        assert read.velocity_n is read.cov is None
        return
    np.testing.assert_allclose(read.velocity_n, motion.velocity_n, atol=1e-9)
    assert read.cov is not None
    np.testing.assert_allclose(np.diagonal(read.cov[0])[3:], [1e-4] * 3 + [4.0] * 3)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"5 0 0 0 0 0 0 1\n4 0 0 0 0 0 0 1\n", "an earlier time than the line above"),
        (b"5 0 0 0\n", "line 1 is no pose"),
        (b"\x89MCAP0\r\n", "cannot be read"),
        (b"PK\x03\x04 and more", "not of run_as_program"),
        (
            b"time_ns,velocity_n_mps,velocity_e_mps,velocity_d_mps\n1,1,5,1,7,0,3\n",
            "longer than its header",
        ),
    ],
)
def test_files_that_are_no_solutions(
    content: bytes, reason: str, dive: Dive, tmp_path: Path
) -> None:
    (tmp_path / "solution").write_bytes(content)
    with pytest.raises(CandidateError, match=reason):
        read_solution(tmp_path / "solution", start_of(dive))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"time_ns": np.array([3, 2, 1], np.uint64)}, "times that are not increasing"),
        (
            {"cov": np.broadcast_to(np.eye(9), (3, 9, 9)), "cov_ns": np.array([0.0, 1.0, 2.0])},
            "cov_ns that are not",
        ),
        ({"cov": np.broadcast_to(-np.eye(9), (3, 9, 9))}, "cov with negative variances"),
        ({"innovation_b": np.zeros((3, 3))}, "innovations without their covariance"),
        (
            {"mat_nb": np.multiply.outer([1.0, -1.0, 2.0], np.eye(3))},
            "no rotations in 2 of 3 rows, the first is row 1",
        ),
    ],
)
def test_columns_that_make_no_sense(changes: dict[str, np.ndarray], reason: str) -> None:
    good = Solution(np.array([1, 2, 3]), velocity_n=np.zeros((3, 3)))
    checked_solution(good)
    with pytest.raises(CandidateError, match=reason):
        checked_solution(replace(good, **changes))


def test_a_late_solution_begins_where_the_baseline_is(dive: Dive, tmp_path: Path) -> None:
    """Its first row is later than the start; radians for degrees would be kilometres away."""
    assert dive.reference is not None
    start, path = start_of(dive), tmp_path / "solution"
    motion = dive.reference.rows(np.arange(50, len(dive.reference.time_ns), 5))
    solution = Solution(motion.time_ns, motion.position, motion.velocity_n, motion.mat_nb)
    write_odometry(path, solution, start.position, fix=False)
    read = read_solution(path, start)
    assert read.position is not None
    np.testing.assert_allclose(north_east_down_m(read.position, motion.position), 0.0, atol=1e-3)


@pytest.mark.nightly
def test_the_example_as_a_program_gives_the_same(
    dive: Dive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    words = (
        sys.executable,
        str(EXAMPLES / "dead_reckoning.py"),
        "{dive}",
        "{start}",
        "{solution}",
    )
    found = [
        evidence(replay_dive(dive, config(settings)))
        for settings in (Filter(candidate="dead_reckoning:DeadReckoning"), Filter(program=words))
    ]
    assert found[0].keys() == found[1].keys()
    for quantity, row in found[0].items():
        if row.value is not None:
            assert found[1][quantity].value == pytest.approx(
                row.value, rel=1e-6, abs=1e-9, nan_ok=True
            )
