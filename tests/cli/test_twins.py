"""Each command and its twin in Python, on the same input: the same results, the same errors, the same exit codes."""

import contextlib
import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from in_process import done_here
from made_tracks import write_dives
from small_results import content, write

import insdvl_replay
from insdvl_replay import DiveResult, load_config, replay_log
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.inspect_logs import Look, inspect_dive
from insdvl_replay.batch.manifest import fetch_dives
from insdvl_replay.batch.schemas import SCHEMAS, schema_text
from insdvl_replay.batch.studies import StudyFolder, WindowStudy, window_study
from insdvl_replay.core.config_file import SCHEMA_LINE, render_toml
from insdvl_replay.core.errors import ConfigError, UserError
from insdvl_replay.core.report import as_json
from insdvl_replay.document.parts import Result
from insdvl_replay.document.render import result_json
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

ONE_START = {"evaluation.starts": 1}
GIVEN = ["--set", "evaluation.starts=1"]
REMOTE = "https://logs.example/dive.mcap"
VEHICLE = """
[dvl]
velocity_sd_mps = 0.004

[noise]
accel_white_mps_rts = 0.005
gyro_white_rad_rts = 1.2e-6
gyro_bias_walk_radps_rts = 2e-10

[evaluation]
starts = 1

[filters]
baseline.aiding = ["velocity"]
aided.aiding = ["velocity", "acceleration"]
aided.acceleration = {}
"""
GATE = """
[[gate]]
name = "scale"
table = "improvement"
row = "ba_z"
column = "sd"
expected = "expected/{log}.json"
max_worse_pct = 1
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dive, one that nobody has described, and a file that is no log."""
    folder = tmp_path_factory.mktemp("logs")
    dive = simulate_dive("figure-eight", seed=1, duration_s=45.0, imu_rate_hz=50.0)
    write_dive(folder / "dive.mcap", dive)
    still = simulate_dive("static", seed=1, duration_s=45.0, imu_rate_hz=50.0)
    write_dive(folder / "still.mcap", replace(still, truth=None))
    (folder / "broken.mcap").write_bytes(b"no log" * 100)
    return folder


@pytest.fixture
def team(logs: Path, tmp_path: Path) -> Path:
    """A folder with a dive, its settings and gates, beside a folder from which somebody works."""
    archive = tmp_path / "archive"
    archive.mkdir()
    (tmp_path / "desk").mkdir()
    shutil.copy(logs / "dive.mcap", archive)
    (archive / "vehicle.toml").write_text(VEHICLE, "utf-8")
    (archive / "gates.toml").write_text(f'config = "vehicle.toml"\n{GATE}', "utf-8")
    return archive


def refused(call: Callable[[], Any], place: Path) -> tuple[int, str]:
    """Return exit code and sentence of the error that a function raises, called in a folder."""
    with contextlib.chdir(place), pytest.raises(UserError) as refusal:
        call()
    error = refusal.value
    return error.exit_code, f"error: {error.message}; hint: {error.hint}"


def report_of(folder: Path) -> dict[str, Any]:
    """Read the report in a result folder, but for the tool, which has the time."""
    report: dict[str, Any] = json.loads((folder / "report.json").read_text("utf-8"))
    return {key: value for key, value in report.items() if key not in ("tool", "files")}


def same_replay(result: DiveResult, command: Path, place: Path) -> None:
    """Assert that a replay in Python is that of a command, once it is stored."""
    stored = report_of(result.save(place))
    for key, value in report_of(command).items():
        assert stored[key] == value, key


# --- run


def test_a_replay(logs: Path, tmp_path: Path) -> None:
    log = logs / "dive.mcap"
    assert done_here("run", log, "-o", "out", *GIVEN, cwd=tmp_path).returncode == 0
    result = replay_log(log, load_config(settings=ONE_START), auto=True)
    same_replay(result, tmp_path / "out" / "dive", tmp_path / "saved")
    assert "found_noise" in {note.code for note in result.report.notes}


def test_after_a_failed_search_the_settings_that_do_not_fit_are_used(
    logs: Path, tmp_path: Path
) -> None:
    log = logs / "still.mcap"
    assert done_here("run", log, "-o", "out", *GIVEN, cwd=tmp_path).returncode == 0
    result = replay_log(log, load_config(settings=ONE_START), auto=True)
    same_replay(result, tmp_path / "out" / "still", tmp_path / "saved")
    assert "found_nothing" in {note.code for note in result.report.notes}


def test_settings_in_a_file_are_used_without_a_search(logs: Path, tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text(VEHICLE, "utf-8")
    log = logs / "still.mcap"
    done = done_here("run", log, "-o", "out", "-c", "vehicle.toml", cwd=tmp_path)
    assert done.returncode == 0
    result = replay_log(log, tmp_path / "vehicle.toml")
    same_replay(result, tmp_path / "out" / "still", tmp_path / "saved")


# --- run --shard, merge


@pytest.mark.nightly
def test_shards_and_their_merge(logs: Path, tmp_path: Path) -> None:
    config = load_config(settings=ONE_START)
    for number in (1, 2):
        share = f"{number}/2"
        command = ["run", logs, "-o", f"part_{number}", *GIVEN, "--no-auto", "--shard", share]
        done = done_here(*command, cwd=tmp_path)
        part = insdvl_replay.run_shard(logs, share, tmp_path / f"python_{number}", config)
        assert done.stdout == f"{part.content.sentences[0]}\n"
        assert done.returncode == 3 * ("failed" in set(part.tables["shard"]["status"]))
    command = ["merge", "part_1", "part_2", "-o", "merged", "--table", "summary"]
    done = done_here(*command, "--format", "csv", cwd=tmp_path)
    assert done.returncode == 3
    parts = [tmp_path / "python_1", tmp_path / "python_2"]
    results = insdvl_replay.merge(parts, tmp_path / "python")
    assert list(results.dives) == ["dive", "still"]
    assert list(results.tables["summary"]["status"]) == ["failed", "done", "done"]
    for name in ("summary.csv", "answers.csv", "evidence.csv", "where.csv", "index.html"):
        python = (tmp_path / "python" / name).read_bytes()
        assert python == (tmp_path / "merged" / name).read_bytes()
    for name in results.dives:
        assert report_of(tmp_path / "python" / name) == report_of(tmp_path / "merged" / name)


def test_a_missing_shard_is_the_same_error(logs: Path, tmp_path: Path) -> None:
    command = ["run", logs / "dive.mcap", "-o", "part", *GIVEN, "--shard", "1/2"]
    assert done_here(*command, cwd=tmp_path).returncode == 0
    done = done_here("merge", "part", "-o", "merged", cwd=tmp_path)
    found = refused(lambda: insdvl_replay.merge("part", "merged"), tmp_path)
    assert found == (done.returncode, done.stderr.strip())


# --- Results of the last run.


def test_a_later_run_of_one_dive_is_the_last_run(logs: Path, tmp_path: Path) -> None:
    """Two dives, one of them with another setting, then a third: each time the results are those of that run."""
    first = tmp_path / "first.mcap"
    second = tmp_path / "second.mcap"
    for log in (first, second):
        shutil.copy(logs / "dive.mcap", log)
    (tmp_path / "vehicle.toml").write_text(VEHICLE, "utf-8")
    given = ("-o", "out", "-c", "vehicle.toml")

    def last_run(*command: str | Path) -> tuple[list[str], str]:
        done = done_here("run", *command, *given, cwd=tmp_path)
        assert done.returncode in (0, 3)
        results = insdvl_replay.read_results(tmp_path / "out")
        notes = " ".join(note.code for note in results.content.notes)
        assert notes == " ".join(
            {"earlier_results"} & set(done.stderr.replace("[", "]").split("]"))
        )
        return list(results.dives), notes

    assert last_run(second) == (["second"], "")
    assert last_run(first) == (["first", "second"], ""), "without a summary all count"
    assert last_run(first, second) == (["first", "second"], "")
    assert last_run(first) == (["first", "second"], ""), "nothing was replayed"
    changed = last_run(first, "--set", "dvl.scale=1.1", "--force")
    assert changed == (["first"], "earlier_results")
    shutil.copy(logs / "broken.mcap", second)
    assert last_run(first, second, "--force") == (["first"], "earlier_results")
    assert 'href="second' not in (tmp_path / "out" / "index.html").read_text("utf-8")


# --- run --against


def test_a_change_of_settings(logs: Path, tmp_path: Path) -> None:
    command = ["run", logs / "dive.mcap", "-o", "out", *GIVEN, "--against", "dvl.scale=1.1"]
    done = done_here(*command, "--format", "json", cwd=tmp_path)
    assert done.returncode == 0
    found = insdvl_replay.compare_settings(
        logs / "dive.mcap",
        load_config(settings=ONE_START),
        load_config(settings={**ONE_START, "dvl.scale": 1.1}),
        tmp_path / "python",
    )
    printed = json.loads(done.stdout)
    theirs = json.loads(result_json(found.content))
    for side in ("old", "new"):  # the folders alone are others
        assert printed.pop(side) != theirs.pop(side)
    for dive in (*printed["dives"], *theirs["dives"]):
        del dive["old"], dive["new"]
    assert printed == theirs
    for side in ("before", "after"):
        ours, python = (tmp_path / place / side / "dive" for place in ("out", "python"))
        assert report_of(ours) == report_of(python)


@pytest.mark.parametrize(
    ("settings", "against", "said"),
    [
        ({}, {"dvl.scale": 1.0}, "is the setting already"),
        (
            {"dvl.beam_sd_mps": 0.01},
            {"dvl.velocity_sd_mps": 0.006},
            "has no effect, since dvl.beam_sd_mps = 0.01 decides",
        ),
    ],
)
def test_a_change_that_changes_nothing(
    settings: dict[str, float], against: dict[str, float], said: str, logs: Path, tmp_path: Path
) -> None:
    words: list[str] = []
    for key, value in settings.items():
        words += ["--set", f"{key}={value}"]
    for key, value in against.items():
        words += ["--against", f"{key}={value}"]
    done = done_here("run", logs / "dive.mcap", *words, cwd=tmp_path)
    code, sentence = refused(
        lambda: insdvl_replay.compare_settings(
            logs / "dive.mcap",
            load_config(settings=settings),
            load_config(settings=settings | against),
            "out",
        ),
        tmp_path,
    )
    assert done.returncode == code
    assert said in done.stderr
    assert said in sentence


# --- check


def checked(place: Path, gates: Path, *words: str | Path, **named: Any) -> dict[str, Any]:
    """Check in both ways from a folder; return what the gates say, which is the same."""
    results = ["--results", "checked", "--format", "json"]
    done = done_here("check", gates, *words, *results, cwd=place)
    with contextlib.chdir(place):
        content = insdvl_replay.check(gates, results="python", **named).content
    report: dict[str, Any] = json.loads(done.stdout[done.stdout.index("{") :])
    assert json.loads(result_json(content)) == report
    assert (done.returncode != 0) == (report["failed"] + report["unusable"] > 0)
    return report


def test_settings_of_a_gate_file_are_relative_to_it_from_any_folder(team: Path) -> None:
    desk = team.parent / "desk"
    # Another file of the same name is not meant.
    (desk / "vehicle.toml").write_text("[dvl]\nscale = 1.2\n", "utf-8")
    gates = team / "gates.toml"
    gates.write_text(
        gates.read_text("utf-8").replace(
            'expected = "expected/{log}.json"\nmax_worse_pct = 1', "max = 1e9"
        )
    )
    report = checked(desk, gates, team / "dive.mcap", dives=[team / "dive.mcap"])
    assert report["passed"] == 1
    own, python = (report_of(desk / name / "dive") for name in ("checked", "python"))
    assert own == python
    assert own["config"]["dvl"]["scale"] == 1.0
    assert own["config"]["dvl"]["velocity_sd_mps"] == 0.004


def test_settings_that_replace_those_of_the_gate_file_leave_its_preset(team: Path) -> None:
    desk = team.parent / "desk"
    (desk / "mine.toml").write_text("[evaluation]\nstarts = 1\n[dvl]\nscale = 1.1\n", "utf-8")
    gates = team / "gates.toml"
    gates.write_text(
        f'preset = "levy-klein"\n{gates.read_text("utf-8")}'.replace(
            'expected = "expected/{log}.json"\nmax_worse_pct = 1', "max = 1e-12"
        )
    )
    words = [team / "dive.mcap", "-c", "mine.toml"]
    report = checked(desk, gates, *words, dives=team / "dive.mcap", config="mine.toml")
    assert report["failed"] == 1
    own, python = (report_of(desk / name / "dive") for name in ("checked", "python"))
    assert own == python
    assert own["config"]["dvl"]["scale"] == 1.1
    assert own["config"]["noise"] == json.loads(as_json(load_config(preset="levy-klein").noise))


def test_expected_values_are_stored_and_met(team: Path) -> None:
    gates = team / "gates.toml"
    python = team.parent / "python"
    shutil.copytree(team, python)
    log = team / "dive.mcap"
    done = done_here("check", gates, log, "--update", "--badge", "badge.json", cwd=team)
    assert done.returncode == 0
    with contextlib.chdir(python):
        found = insdvl_replay.check("gates.toml", log, update=True, badge="badge.json")
        with pytest.raises(ConfigError, match=r"badge: gates\.toml: is an input of this check"):
            insdvl_replay.check("gates.toml", log, badge="gates.toml")
    assert found.tables["gates"]["status"].tolist() == ["passed"]
    stored = [folder / "expected" / "dive.json" for folder in (team, python)]
    assert stored[0].read_bytes() == stored[1].read_bytes()
    assert (team / "badge.json").read_bytes() == (python / "badge.json").read_bytes()
    for file in stored:  # a gain that is lost
        file.write_text(file.read_text("utf-8").replace('"sd": ', '"sd": 0.000'), "utf-8")
    report = checked(team, gates, team / "checked", dives=team / "checked")
    assert report["failed"] == 1


@pytest.mark.parametrize(
    ("gates", "words", "named"),
    [
        (f'dives = ["dive.mcap"]\nconfig = "other.toml"\n{GATE}', [], {}),
        (GATE, [], {}),
        (GATE.replace("ba_z", "ba_w"), ["dive.mcap"], {"dives": "dive.mcap"}),
        (
            GATE.replace('expected = "expected/{log}.json"\nmax_worse_pct = 1', "max = 1"),
            ["dive.mcap", "--update"],
            {"dives": "dive.mcap", "update": True},
        ),
        (f'dives = ["nothing/*.mcap"]\n{GATE}', [], {}),
    ],
    ids=["no settings", "no dives", "unknown row", "nothing expected", "no dive of a pattern"],
)
def test_a_wrong_check(gates: str, words: list[str], named: dict[str, Any], team: Path) -> None:
    (team / "gates.toml").write_text(gates, "utf-8")
    done = done_here("check", "gates.toml", *words, cwd=team)
    refusal = refused(lambda: insdvl_replay.check("gates.toml", **named), team)
    assert (done.returncode, done.stderr.splitlines()[-1]) == refusal


# --- inspect, calibrate


def test_what_is_in_a_log(logs: Path) -> None:
    for words, named in (([], {}), (["--deep"], {"deep": True})):
        done = done_here("inspect", "dive.mcap", "--format", "json", *words, cwd=logs)
        assert done.returncode == 0
        with contextlib.chdir(logs):
            found = insdvl_replay.inspect("dive.mcap", **named)
        assert as_json(found.content.data).decode() == done.stdout


@pytest.mark.parametrize(
    ("look", "expected"),
    [
        (Look(), []),
        (Look(allow_damaged=True), []),
        (Look(deep=True), [("online", "whole")]),
        (Look(one_dive=True), [("online", "whole")]),
        (Look(offline=True), [("offline", "what is there")]),
    ],
)
def test_of_a_remote_log_the_summary_is_enough_unless_more_is_asked_for(
    look: Look, expected: list[tuple[str, str]]
) -> None:
    asked = list[tuple[str, str]]()

    def fetch(
        dives: Sequence[FoundDive], *, offline: bool = False, whole: bool = False
    ) -> list[FoundDive]:
        where = "offline" if offline else "online"
        what = "whole" if whole else "what is there"
        asked.append((where, what))
        return list(dives)

    found = find_dives([REMOTE])
    assert look.fetched(found, fetch) == found
    assert asked == expected


def test_a_look_at_a_remote_log_that_is_not_in_the_cache(tmp_path: Path) -> None:
    done = done_here("inspect", REMOTE, "--offline", cwd=tmp_path)
    look = Look(offline=True)
    files = look.fetched(find_dives([REMOTE]), fetch_dives)
    refusal = refused(lambda: inspect_dive(files, load_config(), look), tmp_path)
    assert (done.returncode, done.stderr.splitlines()[-1]) == refusal


def test_settings_that_are_proposed(logs: Path, tmp_path: Path) -> None:
    (tmp_path / "given.toml").write_text("[dvl]\nscale = 1.0\n", "utf-8")
    log = logs / "still.mcap"
    done = done_here("inspect", log, "-c", "given.toml", "--propose", "found.toml", cwd=tmp_path)
    assert done.returncode == 0
    proposed = insdvl_replay.propose(log, tmp_path / "given.toml")
    assert proposed.settings == (tmp_path / "found.toml").read_text("utf-8")
    said = done.stderr.splitlines()
    assert set(proposed.content.sentences) <= set(said)
    for key in proposed.tables["missing"]["key"]:
        assert f"--set {key}=..." in said[-1]


def test_a_calibration(logs: Path, tmp_path: Path) -> None:
    log = logs / "dive.mcap"
    words = ["--only", "arm", "--format", "json", "-o", "found.toml"]
    done = done_here("calibrate", log, *words, cwd=tmp_path)
    found = insdvl_replay.calibrate(log, only=["arm"])
    assert json.loads(done.stdout) == json.loads(result_json(replace(found.content, settings="")))
    assert (done.returncode, found.settings) == (0, (tmp_path / "found.toml").read_text("utf-8"))


def test_a_calibration_that_finds_nothing_proposes_nothing(logs: Path, tmp_path: Path) -> None:
    log = logs / "still.mcap"
    done = done_here("calibrate", log, "--only", "arm", "-o", "found.toml", cwd=tmp_path)
    assert done.returncode == 3
    assert "nothing could be estimated" in done.stderr
    assert not (tmp_path / "found.toml").exists()
    assert insdvl_replay.calibrate(log, only=["arm"]).settings == ""


# --- study


def windows_of(folder: Path, *logs: Path | str, offline: bool = False) -> WindowStudy:
    """Study the windows of logs as the command does."""
    found = fetch_dives(find_dives([str(log) for log in logs]), offline=offline)
    config = load_config(settings=ONE_START)
    return window_study(found, config, 3, StudyFolder(folder), lambda _: None)


def test_a_study_of_windows(logs: Path, tmp_path: Path) -> None:
    words = ["--longest", "3", "--format", "json", *GIVEN]
    for name in ("dive", "broken"):
        shutil.copy(logs / f"{name}.mcap", tmp_path)
    dive = tmp_path / "dive.mcap"
    broken = tmp_path / "broken.mcap"
    for place, files in (("good", [dive]), ("some", [dive, broken])):
        command = ["study", "window", *files, *words, "-o", place]
        done = done_here(*command, cwd=tmp_path)
        found = windows_of(tmp_path / place / "python", *files)
        assert found.result is not None
        assert json.loads(result_json(found.result)) == json.loads(done.stdout)
        assert done.returncode == found.exit_code
        assert len(found.left_out) == (broken in files)
        ours = report_of(tmp_path / place / "window")
        assert report_of(tmp_path / place / "python") == ours


def test_a_study_of_logs_that_cannot_be_had(tmp_path: Path) -> None:
    done = done_here("study", "window", REMOTE, "--offline", cwd=tmp_path)
    found = windows_of(tmp_path / "python", REMOTE, offline=True)
    assert found.result is None
    assert (done.returncode, len(found.missing)) == (found.exit_code, 1)
    assert found.exit_code != 0
    assert not any(tmp_path.iterdir())


def test_a_study_does_not_begin_where_it_cannot_be_stored(tmp_path: Path) -> None:
    (tmp_path / "window").mkdir()
    (tmp_path / "window" / "mine.txt").touch()

    def study() -> Result:
        pytest.fail("the study began")

    code, _ = refused(lambda: StudyFolder(tmp_path / "window").keep(study), tmp_path)
    command = ["study", "montecarlo", "straight", "--runs", "2", "-o", "here"]
    (tmp_path / "window").rename(tmp_path / "montecarlo-straight")
    (tmp_path / "here").mkdir()
    (tmp_path / "montecarlo-straight").rename(tmp_path / "here" / "montecarlo-straight")
    assert done_here(*command, cwd=tmp_path).returncode == code


# --- schema


@pytest.mark.parametrize("name", [None, *SCHEMAS, "insdvl_msgs/msg/NavSolution"])
def test_a_schema(name: str | None, tmp_path: Path) -> None:
    words = [] if name is None else [name]
    done = done_here("schema", *words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, schema_text(name))


# --- Stored results, simulated dives, settings


def test_stored_results(tmp_path: Path) -> None:
    for side, size in (("old", 0.4), ("new", 0.6)):
        for name in ("monday", "tuesday"):
            write(tmp_path / side / name, content(name, rmse=size))
    for words, named in (
        ([], {}),
        (
            ["--table", "reference_error", "--column", "rmse"],
            {"tables": ["reference_error"], "columns": ["rmse"]},
        ),
        (["--dive", "monday", "--tolerance", "60%"], {"dives": ["monday"], "tolerance_pct": 60.0}),
        (["--pair", "aided=aided"], {"pairs": {"aided": "aided"}}),
    ):
        done = done_here("compare", "old", "new", "--format", "json", *words, cwd=tmp_path)
        with contextlib.chdir(tmp_path):
            found = insdvl_replay.compare("old", "new", **named)
        assert json.loads(done.stdout) == json.loads(result_json(found.content))
        assert done.returncode == 0


def test_a_simulated_dive(tmp_path: Path) -> None:
    words = [
        "straight",
        "-o",
        "command.mcap",
        "--duration",
        "20",
        "--seed",
        "7",
        "--lever-arm",
        "1,0,0",
    ]
    assert done_here("simulate", *words, "--outage", "5:8", cwd=tmp_path).returncode == 0
    python = insdvl_replay.simulate(
        "straight",
        tmp_path / "python.mcap",
        duration_s=20.0,
        seed=7,
        lever_arm_m=(1.0, 0.0, 0.0),
        outages=[(5.0, 8.0)],
    )
    assert python.read_bytes() == (tmp_path / "command.mcap").read_bytes()


def test_resolved_settings(team: Path) -> None:
    words = ["--preset", "fog", "-c", "vehicle.toml", "--set", "dvl.scale=1.01"]
    done = done_here("config", *words, cwd=team)
    found = load_config(team / "vehicle.toml", preset="fog", settings={"dvl.scale": 1.01})
    assert (done.returncode, done.stdout) == (0, SCHEMA_LINE + render_toml(found))


# --- Errors


@pytest.mark.parametrize(
    "call",
    [
        lambda: insdvl_replay.calibrate("dive.mcap", only="arms"),
        lambda: insdvl_replay.calibrate("dive.mcap", only=[]),
        lambda: insdvl_replay.calibrate("dive.mcap", only="arm", hold_out=1.5),
        lambda: insdvl_replay.calibrate("dive.mcap", only="arm", hold_out="monday"),
        lambda: insdvl_replay.calibrate("dive.mcap", only="arm", hold_out=0.3),
        lambda: insdvl_replay.compare("old", "new", tolerance_pct=-1.0),
        lambda: insdvl_replay.compare("old", "new", tolerance_pct=math.nan),
        lambda: insdvl_replay.simulate("straight", "x.mcap", duration_s=1e-3),
        lambda: insdvl_replay.simulate("straight", "x.mcap", duration_s=1e9),
        lambda: insdvl_replay.simulate("straight", "x.mcap", outages=[(1e6, 2e6)]),
        lambda: insdvl_replay.simulate("straight", "x.mcap", duration_s=1.0, seed=-1),
        lambda: insdvl_replay.simulate("straight", "x.mcap", lever_arm_m=(1.0, 2.0)),
    ],
)
def test_a_wrong_argument_is_not_named_as_an_option(call: Callable[[], Any], logs: Path) -> None:
    _, said = refused(call, logs)
    assert "hint: " in said
    assert "--" not in said


def test_an_option_of_a_simulation_that_is_not_known(logs: Path) -> None:
    def call() -> Path:
        return insdvl_replay.simulate("straight", "x.mcap", duration=60.0)

    _, said = refused(call, logs)
    assert said == "error: option 'duration' is not known; hint: did you mean duration_s?"
    with pytest.raises(TypeError):
        call()


def test_one_name_is_a_list_of_one(logs: Path, tmp_path: Path) -> None:
    log = logs / "dive.mcap"
    for given in ("arm", ["arm"]):
        found = insdvl_replay.calibrate(log, only=given)
        asked = found.tables["parameters"].query("status != 'not asked'")
        assert set(asked["parameter"]) == {"arm_x", "arm_y", "arm_z"}
    assert load_config(settings="dvl.scale=1.01").dvl.scale == 1.01


@pytest.mark.parametrize(
    ("words", "call"),
    [
        ("run broken.mcap", lambda: replay_log("broken.mcap")),
        ("run missing.mcap", lambda: replay_log("missing.mcap")),
        ("run missing.mcap -c missing.toml", lambda: replay_log("missing.mcap", "missing.toml")),
        ("inspect broken.mcap", lambda: insdvl_replay.inspect("broken.mcap")),
        ("inspect missing.mcap --deep", lambda: insdvl_replay.inspect("missing.mcap", deep=True)),
        ("calibrate broken.mcap", lambda: insdvl_replay.calibrate("broken.mcap")),
        (
            "calibrate dive.mcap --only arms",
            lambda: insdvl_replay.calibrate("dive.mcap", only=["arms"]),
        ),
        (
            "calibrate dive.mcap --only arm --hold-out 0.3",
            lambda: insdvl_replay.calibrate("dive.mcap", only=["arm"], hold_out=[0.3]),
        ),
        ("compare old new", lambda: insdvl_replay.compare("old", "new")),
        ("check gates.toml", lambda: insdvl_replay.check("gates.toml")),
        ("plan nowhere", lambda: insdvl_replay.plan("nowhere")),
        ("plan", lambda: insdvl_replay.plan()),
        ("plan nowhere --tracks 5", lambda: insdvl_replay.plan("nowhere", tracks=5)),
        ("plan --tracks 5 --ratio 0.97", lambda: insdvl_replay.plan(tracks=5, ratio=0.97)),
        ("simulate circle -o x.mcap", lambda: insdvl_replay.simulate("circle", "x.mcap")),
        (
            "simulate straight -o dive.mcap",
            lambda: insdvl_replay.simulate("straight", "dive.mcap"),
        ),
        ("schema reprot", lambda: schema_text("reprot")),
        ("config --preset foggy", lambda: load_config(preset="foggy")),
        ("config --set dvl.scle=1", lambda: load_config(settings=["dvl.scle=1"])),
    ],
)
def test_a_mistake(words: str, call: Callable[[], Any], logs: Path) -> None:
    done = done_here(*words.split(), cwd=logs)
    assert (done.returncode, done.stderr.splitlines()[-1]) == refused(call, logs)
    assert not (logs / "replay").exists()


# --- lake


def test_a_lake_is_compacted(tmp_path: Path) -> None:
    from made_lakes import named

    from insdvl_replay.results.lake import add_to_lake

    pytest.importorskip("pyarrow", reason="needs pyarrow")
    for lake in ("here", "there"):
        for dive in ("one", "two"):
            add_to_lake(tmp_path / lake, named(dive))
    done = done_here("lake", "compact", "here", "--format", "json", cwd=tmp_path)
    result = insdvl_replay.compact_lake(tmp_path / "there")
    assert json.loads(done.stdout) == json.loads(result_json(result.content))
    assert result.tables["lake"].to_dict("records") == [
        {"replays": 2, "rows": 10, "files_before": 2, "files": 1}
    ]
    done = done_here("lake", "compact", "absent", cwd=tmp_path)
    said = refused(lambda: insdvl_replay.compact_lake("absent"), tmp_path)
    assert (done.returncode, done.stderr.rstrip()) == said


def test_a_history_is_shown(tmp_path: Path) -> None:
    from made_lakes import named

    from insdvl_replay.results.lake import LakeWriter, require_lake

    pytest.importorskip("pyarrow", reason="needs pyarrow")
    require_lake(tmp_path / "lake", ())
    for revision in ("v1", "v2"):
        writer = LakeWriter(tmp_path / "lake", revision)
        for dive in ("one", "two", "three"):
            writer.add(named(dive))
    words = ["--quantity", "position"]
    done = done_here("history", "lake", *words, "--format", "json", cwd=tmp_path)
    result = insdvl_replay.history(tmp_path / "lake", "position")
    assert json.loads(done.stdout) == json.loads(result_json(result.content))
    assert result.tables["version"]["name"].tolist() == ["v1", "v2"]
    done = done_here("history", "lake", "--quantity", "nothing", cwd=tmp_path)
    said = refused(lambda: insdvl_replay.history("lake", "nothing"), tmp_path)
    assert (done.returncode, done.stderr.rstrip()) == said


# --- compare --reference


def test_trajectories_are_compared(tmp_path: Path) -> None:
    write_dives(tmp_path)
    words = ["compare", "old", "new", "--reference", "truth", "--align", "yaw", "--rpe", "50m"]
    done = done_here(*words, "--all-pairs", "--json", cwd=tmp_path)
    with contextlib.chdir(tmp_path):
        result = insdvl_replay.compare_trajectories(
            "old", "new", "truth", align="yaw", rpe="50m", all_pairs=True
        )
    assert json.loads(done.stdout) == json.loads(result_json(result.content))
    assert result.tables["answer"]["verdict"].iloc[0] == "better"
    assert "BETTER" in str(result)


@pytest.mark.parametrize(
    ("words", "sides", "options"),
    [
        ("old nowhere --reference truth", ("old", "nowhere", "truth"), {}),
        ("old old --reference old", ("old", "old", "old"), {}),
        ("old new --reference truth --rpe 3km", ("old", "new", "truth"), {"rpe": "3km"}),
        ("old new --reference truth --dive x", ("old", "new", "truth"), {"dives": "x"}),
        ("old new --reference truth --primary x", ("old", "new", "truth"), {"primary": "x"}),
    ],
)
def test_a_mistake_in_a_comparison_of_trajectories(
    words: str, sides: tuple[str, str, str], options: dict[str, Any], tmp_path: Path
) -> None:
    write_dives(tmp_path, dives=1)
    done = done_here("compare", *words.split(), cwd=tmp_path)
    said = refused(lambda: insdvl_replay.compare_trajectories(*sides, **options), tmp_path)
    assert (done.returncode, done.stderr.rstrip()) == said
