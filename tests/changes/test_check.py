"""`insdvl-replay check`: exit codes, expected values, and output as those read it for whom it is written."""

import contextlib
import io
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
import xmlschema
from small_results import content, write

from insdvl_replay.changes.findings import CheckResult, GateOutcome
from insdvl_replay.changes.formats import (
    MOST_ANNOTATIONS,
    CheckReport,
    badge_json,
    github_annotations,
    junit_xml,
)
from insdvl_replay.cli import run_command_line

DIVES = Path(__file__).parents[2] / "examples" / "archive" / "dives"
# A noise that is given, so that none is fitted. The vibration is large enough for the accelerations to be of use.
VEHICLE = """
[dvl]
velocity_sd_mps = 0.00334

[initial]
accel_bias_sd_mg = 0.1
gyro_bias_sd_degph = 0.05

[noise]
accel_white_mps_rts = 0.005
gyro_white_rad_rts = 1.2e-6
gyro_bias_walk_radps_rts = 2e-10

[filters]
baseline.aiding = ["velocity"]
aided.aiding = ["velocity", "acceleration"]
aided.acceleration = {}
"""
SCHEMA = xmlschema.XMLSchema(Path(__file__).with_name("junit.xsd"))
TOOL = [sys.executable, "-m", "insdvl_replay"]
PASSING = """
[[gate]]
name = "ba_z converges"
table = "improvement"
filter = "aided"
row = "ba_z"
column = "improvement_pct"
min = 20
"""
NAME = "ba_z converges"
FAILING = PASSING.replace("converges", "converges fully").replace("20", "99")
WARNING = FAILING + 'level = "warn"\n'
EXPECTED = """
[[gate]]
name = "no state becomes less certain"
table = "improvement"
column = "sd"
expected = "expected/{log}.json"
max_worse_pct = 1
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two dives, which checks find unchanged."""
    output = tmp_path_factory.mktemp("checked")
    vehicle = tmp_path_factory.mktemp("settings") / "vehicle.toml"
    vehicle.write_text(VEHICLE, "utf-8")
    logs = [str(DIVES / f"{name}.mcap") for name in ("transit", "outage")]
    assert run_command_line(["run", *logs, "-c", str(vehicle), "-o", str(output)]) == 0
    return output


@pytest.fixture
def team(checked: Path, tmp_path: Path) -> Path:
    """A folder with two dives, the settings with their noise, and their results where `check` keeps them."""
    (tmp_path / "dives").mkdir()
    for name in ("transit", "outage"):
        shutil.copy(DIVES / f"{name}.mcap", tmp_path / "dives")
    (tmp_path / "vehicle.toml").write_text(VEHICLE, "utf-8")
    shutil.copytree(checked, tmp_path / "checked")
    return tmp_path


Done = subprocess.CompletedProcess[str]


def write_gates(folder: Path, gates: str, dives: str) -> None:
    """Write a gate file; settings of the folder are named in it, so that no noise is fitted."""
    names_settings = (folder / "vehicle.toml").exists() and "config = " not in gates
    settings = 'config = "vehicle.toml"\n' if names_settings else ""
    (folder / "gates.toml").write_text(f"dives = {dives}\n{settings}{gates}", "utf-8")


def started(folder: Path, gates: str, *arguments: str, dives: str = '["dives/*.mcap"]') -> Done:
    """Check in a process of its own, whose exit code is what a job sees."""
    write_gates(folder, gates, dives)
    command = [*TOOL, "check", "gates.toml", *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


def check(folder: Path, gates: str, *arguments: str, dives: str = '["dives/*.mcap"]') -> Done:
    """Check in this process, which is faster."""
    write_gates(folder, gates, dives)
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = run_command_line(["check", "gates.toml", *arguments])
    return Done(["check"], code, out.getvalue(), err.getvalue())


def counts(told: str) -> list[int]:
    """Return the numbers of the first line: gates, dives, and how many of each status in their order."""
    return [int(number) for number in re.findall(r"\b\d+\b", told.splitlines()[0])]


# --- Exit codes.


def test_all_passed_is_0(team: Path) -> None:
    done = started(team, PASSING)
    assert (done.returncode, done.stderr) == (0, "")
    assert counts(done.stdout) == [1, 2, 2]


def test_one_failed_is_1_and_says_the_number_and_its_limit(team: Path) -> None:
    done = started(team, PASSING + FAILING)
    assert done.returncode == 1
    _, _, first, reason, *_ = done.stdout.splitlines()
    assert first.split() == ["FAILED", "outage:", *NAME.split(), "fully"]
    assert re.fullmatch(r" +aided accelerometer bias z improvement .*\d\.\d+ %.* 99", reason)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: ")
    assert counts(last)[:4] == [2, 2, 2, 2]
    assert "outage" in last


def test_only_warnings_is_0_but_no_pass(team: Path) -> None:
    done = check(team, WARNING)
    assert (done.returncode, done.stderr) == (0, "")
    assert counts(done.stdout) == [1, 2, 2]
    assert done.stdout.count("WARNING  ") == 2


def test_missing_expected_values_are_1_and_names_the_command(team: Path) -> None:
    done = check(team, EXPECTED)
    assert done.returncode == 1
    assert "expected/transit.json: " in done.stdout
    assert "`insdvl-replay check gates.toml --update`" in done.stdout


def test_bad_toml_is_2_with_line_and_key(team: Path) -> None:
    done = check(team, PASSING.replace("min", "mim"))
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"error: gates\.toml: gate 1: .*'mim'.*; hint: .*\bmin\b.*\n", done.stderr)


def test_a_typo_in_a_state_is_2_before_any_replay(team: Path) -> None:
    shutil.rmtree(team / "checked")
    done = check(team, PASSING.replace('"ba_z"', '"ba_zz"'))
    assert done.returncode == 2
    assert re.fullmatch(
        r"error: gates\.toml:4: gate 'ba_z converges': .*'ba_zz'.*; hint: .*\bba_z\b.*\n",
        done.stderr,
    )
    assert not (team / "checked").exists()


def test_an_unreadable_dive_is_3_and_the_others_are_evaluated(team: Path) -> None:
    (team / "dives" / "bad.mcap").write_bytes(b"not a log")
    done = started(team, PASSING + FAILING, "--format", "junit")
    assert done.returncode == 3
    suites = {suite.attrib["name"]: suite.attrib for suite in ElementTree.fromstring(done.stdout)}
    assert (suites["bad"]["errors"], suites["bad"]["failures"]) == ("2", "0")
    assert (suites["outage"]["errors"], suites["outage"]["failures"]) == ("0", "1")
    assert "bad: ba_z converges: dives/bad.mcap: " in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("dives", "place"),
    [('["dives/*.bag"]', "dives/*.bag"), ("[]", "gates.toml")],
)
def test_no_dive_is_2(dives: str, place: str, team: Path) -> None:
    done = started(team, PASSING, dives=dives)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {place}: ")


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.nightly)])
def test_interrupted_is_130(jobs: str, team: Path) -> None:
    shutil.rmtree(team / "checked")
    (team / "gates.toml").write_text(f'dives = ["dives/*.mcap"]\n{PASSING}')
    command = [*TOOL, "check", "gates.toml", "--jobs", jobs]
    with subprocess.Popen(
        command, cwd=team, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        while not (team / "checked").exists():
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "error: interrupted\n")


# --- What is judged.


def test_replays_are_kept_and_used_again(team: Path) -> None:
    shutil.rmtree(team / "checked")
    assert check(team, PASSING).returncode == 0
    saved = team / "checked" / "transit" / "report.json"
    first = saved.stat().st_mtime_ns
    assert check(team, PASSING).returncode == 0
    assert saved.stat().st_mtime_ns == first
    assert check(team, PASSING, "--rerun").returncode == 0
    assert saved.stat().st_mtime_ns > first


def test_settings_of_the_gate_file_and_the_command_line(team: Path) -> None:
    (team / "vehicle.toml").write_text(VEHICLE.replace("[dvl]", "[dvl]\nscale = 1.02"))
    (team / "other.toml").write_text(VEHICLE.replace("[dvl]", "[dvl]\nscale = 1.03"))

    def scale(*arguments: str) -> float:
        check(
            team,
            'config = "vehicle.toml"\npreset = "fog"\n' + PASSING,
            "dives/transit.mcap",
            *arguments,
        )
        report = json.loads((team / "checked" / "transit" / "report.json").read_bytes())
        return float(report["config"]["dvl"]["scale"])

    assert scale() == 1.02
    assert scale("-c", "other.toml") == 1.03
    assert scale("--set", "dvl.scale=1.04") == 1.04
    (team / "vehicle.toml").unlink()
    refused = check(team, 'config = "vehicle.toml"\n' + PASSING)
    assert refused.returncode == 2
    assert "vehicle.toml" in refused.stderr


def test_results_are_evaluated_as_they_are(team: Path) -> None:
    before = (team / "checked" / "transit" / "report.json").read_bytes()
    for dive in ("checked/transit", "checked/transit/report.json", "checked"):
        done = check(team, PASSING, dive, "--set", "dvl.scale=1.5")
        assert done.returncode == 0, done.stderr
    assert (team / "checked" / "transit" / "report.json").read_bytes() == before


def test_a_dive_whose_results_are_not_numbers_fails(tmp_path: Path) -> None:
    report = content()
    for row in report["tables"]["improvement"]:
        row.update(sd=None, improvement_pct=None, status="not finite")
    write(tmp_path / "dive", report)
    done = check(tmp_path, PASSING.replace("ba_z", "ba_x"), "dive")
    assert done.returncode == 1
    assert re.search(r"aided accelerometer bias x improvement .*\(not finite\)", done.stdout)


def test_a_result_that_cannot_be_read_is_3(tmp_path: Path) -> None:
    write(tmp_path / "dive", {"tables": 1})
    done = check(tmp_path, PASSING, "dive")
    assert done.returncode == 3
    assert "\nNO RESULT  dive: ba_z converges\n    dive/report.json: " in done.stdout


@pytest.mark.parametrize("column", ["filter", "state"])
def test_a_result_with_a_row_without_a_name_does_not_stop_the_others(
    column: str, tmp_path: Path
) -> None:
    report = content("broken")
    del report["tables"]["improvement"][1][column]
    write(tmp_path / "broken", report)
    write(tmp_path / "dive", content())
    done = check(tmp_path, PASSING.replace("ba_z", "ba_x"), "broken", "dive")
    assert done.returncode == 3
    place = "broken/report.json: table improvement, row 2: "
    assert re.search(
        rf"\nNO RESULT  broken: ba_x converges\n    {place}.* {column}\n", done.stdout
    )
    assert counts(done.stdout) == [1, 2, 1, 1]
    (tmp_path / "expected").mkdir()
    shutil.copy(tmp_path / "broken" / "report.json", tmp_path / "expected" / "dive.json")
    done = check(tmp_path, EXPECTED, "dive")
    assert done.returncode == 1
    assert "expected/dive.json: " in done.stdout


# --- Expected values.


def test_update_shows_what_moves_before_it_writes_it(team: Path) -> None:
    first = check(team, EXPECTED + PASSING, "--update")
    assert first.returncode == 0, first.stderr
    assert "transit: aided accelerometer bias z sd is new: " in first.stdout
    assert first.stderr == "wrote expected/outage.json\nwrote expected/transit.json\n"
    again = check(team, EXPECTED + PASSING, "--update")
    assert re.findall(r"\d+", again.stdout.splitlines()[0]) == ["0", "24"]
    assert check(team, EXPECTED).returncode == 0

    worse = check(team, EXPECTED, "--set", "noise.accel_white_mps_rts=0.006")
    assert worse.returncode == 1
    sentence = r"aided accelerometer bias z sd [\d.]+ -> [\d.]+ mg \(\+[\d.]+ %, limit \+1 %\)"
    assert re.search(sentence, worse.stdout)
    taken = check(team, EXPECTED, "--set", "noise.accel_white_mps_rts=0.006", "--update")
    assert taken.returncode == 0
    assert re.search(rf"^outage: {sentence}$", taken.stdout, re.MULTILINE)
    assert check(team, EXPECTED, "--set", "noise.accel_white_mps_rts=0.006").returncode == 0


def test_a_failure_names_the_settings_that_differ_from_the_stored_ones(team: Path) -> None:
    trajectory = '[[gate]]\nname = "nothing changes"\ntable = "trajectory"\nexpected = "expected/{log}.npz"\n'
    for gates in (EXPECTED, trajectory):
        assert check(team, gates, "--set", "dvl.scale=1.0002", "--update").returncode == 0
        for format_ in ("text", "junit", "json", "md", "github"):
            done = check(team, gates + FAILING, "--set", "dvl.scale=1.02", "--format", format_)
            assert done.returncode == 1
            assert re.search(
                r"settings differ: dvl\.scale 1\.0002 -(>|&gt;|&lt;) 1\.02\b", done.stdout
            ), format_
        unchanged = check(team, gates + FAILING, "--set", "dvl.scale=1.0002")
        assert unchanged.returncode == 1
        assert "differ" not in unchanged.stdout


def test_a_failure_names_another_version_and_another_log(tmp_path: Path) -> None:
    write(tmp_path / "dive", content())
    check(tmp_path, EXPECTED, "dive", "--update")
    report = content(sha256="another", ba_x_sd=2.0)
    report["tool"]["version"] = "0.2.0"
    write(tmp_path / "dive", report)
    done = check(tmp_path, EXPECTED, "dive")
    assert done.returncode == 1
    assert "version of the tool differs: 0.1.0 -> 0.2.0" in done.stdout
    assert "the log differs: SHA-256 hash of dive -> another" in done.stdout


def test_expected_values_hold_no_time_of_day(team: Path) -> None:
    assert check(team, EXPECTED, "--update").returncode == 0
    first = (team / "expected" / "transit.json").read_bytes()
    assert check(team, EXPECTED, "--update", "--rerun").returncode == 0
    assert (team / "expected" / "transit.json").read_bytes() == first


def test_expected_values_of_another_log_do_not_count(team: Path) -> None:
    assert check(team, EXPECTED, "--update").returncode == 0
    shutil.copy(team / "expected" / "outage.json", team / "expected" / "transit.json")
    done = check(team, EXPECTED)
    assert done.returncode == 1
    assert "expected/transit.json: " in done.stdout
    assert "expected/outage.json" not in done.stdout


def test_broken_expected_values_are_reported_and_made_again(team: Path) -> None:
    (team / "expected").mkdir()
    (team / "expected" / "transit.json").write_text('{"tool": ')
    done = check(team, EXPECTED)
    assert done.returncode == 1
    assert "transit.json: " in done.stdout
    assert check(team, EXPECTED, "--update").returncode == 0
    assert check(team, EXPECTED).returncode == 0


def test_dives_do_not_share_expected_values(team: Path) -> None:
    done = check(team, EXPECTED.replace("{log}", "all"), "--update")
    assert done.returncode == 2
    assert "expected/all.json" in done.stderr
    assert not (team / "expected").exists()


@pytest.mark.parametrize(
    "name", ["../../pwned", "/etc/pwned", "a/b", "..", ".", "", "a\0b", "a" * 300]
)
def test_update_never_leaves_the_folder_of_the_expected_values(name: str, tmp_path: Path) -> None:
    write(tmp_path / "team" / "result", content(name))
    (tmp_path / "team" / "expected").mkdir()
    before = sorted(path for path in tmp_path.rglob("*"))
    done = check(tmp_path / "team", EXPECTED, "--update", dives='["result"]')
    assert done.returncode == 3
    assert f"error: result/report.json: log.name = {name[:255]!r} " in done.stderr
    assert sorted(path for path in tmp_path.rglob("*")) == sorted(
        [*before, tmp_path / "team" / "gates.toml"]
    )


def test_update_without_expected_values_is_an_error(team: Path) -> None:
    done = check(team, PASSING, "--update")
    assert done.returncode == 2
    assert done.stderr.startswith("error: gates.toml: ")


def test_expected_values_are_the_gated_ones_and_the_settings(team: Path) -> None:
    assert check(team, EXPECTED, "--update").returncode == 0
    text = (team / "expected" / "transit.json").read_text("utf-8")
    stored = json.loads(text)
    assert set(stored) == {"tool", "log", "tables", "baseline", "filters", "config"}
    assert set(stored["tables"]) == {"improvement"}
    assert {key for row in stored["tables"]["improvement"] for key in row} == {
        "log",
        "filter",
        "state",
        "unit",
        "sd",
    }
    assert len(text.split("\n")) < 120, "its changes can be read in a review"


def test_no_empty_table_is_stored_for_a_gate_without_a_row(tmp_path: Path) -> None:
    write(tmp_path / "dive", content())
    rowless = (
        EXPECTED.replace("no state becomes less certain", "has no row")
        .replace("improvement", "outage")
        .replace('"sd"', '"drift_rms_m"')
    )
    assert check(tmp_path, EXPECTED + rowless, "dive", "--update").returncode == 1
    stored = json.loads((tmp_path / "expected" / "dive.json").read_text("utf-8"))
    assert list(stored["tables"]) == ["improvement"]


# --- Some gates, some dives, all dives together.


def test_gates_are_chosen_by_their_names(team: Path) -> None:
    done = check(team, PASSING + FAILING, "--only", "* converges")
    assert (done.returncode, counts(done.stdout)) == (0, [1, 2, 2])
    done = check(team, PASSING + FAILING, "--skip", "*fully")
    assert (done.returncode, counts(done.stdout)) == (0, [1, 2, 2])
    done = check(team, PASSING, "--only", "ba_y*")
    assert done.returncode == 2
    assert re.search(r"'ba_y\*'.*; hint: .*ba_z converges", done.stderr)
    assert check(team, PASSING, "--skip", "*").returncode == 2


def test_shards_are_all_dives_once(team: Path) -> None:
    told = [check(team, FAILING, "--shard", f"{part}/2").stdout for part in (1, 2)]
    assert sorted(re.findall(r"FAILED  (\w+):", "".join(told))) == ["outage", "transit"]
    for wrong in ("3/2", "0/2", "half", "1/"):
        assert check(team, FAILING, "--shard", wrong).returncode == 2


def test_a_shard_without_a_dive_passes(team: Path) -> None:
    done = check(team, PASSING, "--shard", "9/9")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_dive_that_cannot_be_used_and_has_no_gate_is_3(tmp_path: Path) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"no log" * 100)
    gate = """
[[gate]]
name = "of another dive"
table = "evidence"
column = "ratio"
max = 5
dives = ["monday"]
"""
    done = check(tmp_path, gate, dives='["broken.mcap"]')
    assert done.returncode == 3
    [said] = done.stderr.splitlines()
    assert "broken.mcap: is not an MCAP file" in said


def test_a_gate_may_mean_some_dives(team: Path) -> None:
    done = check(team, FAILING + 'dives = ["tr*"]\n')
    assert re.findall(r"FAILED  (\w+):", done.stdout) == ["transit"]
    assert counts(done.stdout) == [1, 1, 1]


def test_a_gate_may_hold_for_a_share_of_the_dives(team: Path) -> None:
    """At the mean of their improvements one of the two dives passes."""
    values = {
        row["log"]: row["improvement_pct"]
        for name in ("transit", "outage")
        for row in json.loads((team / "checked" / name / "report.json").read_text())["tables"][
            "improvement"
        ]
        if row["state"] == "ba_z"
    }
    between = sum(values.values()) / 2.0
    gate = PASSING.replace("min = 20", f"min = {between}")
    assert check(team, gate).returncode == 1
    half = check(team, gate + "share_of_dives_pct = 50\n")
    assert half.returncode == 0
    assert re.search(r"\b1 of 2 dives, .*50 %", half.stdout)
    assert check(team, gate + "share_of_dives_pct = 51\n").returncode == 1


POOLED = """
[[gate]]
name = "together"
table = "pooled"
filter = "aided"
row = "position"
column = "ratio"
max = 5.0
"""


def test_a_gate_may_mean_all_dives_together(team: Path) -> None:
    done = check(team, POOLED)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "\ntogether: passed" in done.stdout
    assert counts(done.stdout) == [1, 1]
    failed = check(team, POOLED.replace("5.0", "0.001"))
    assert failed.returncode == 1
    assert re.search(
        r"FAILED  \*: together\n    aided position ratio .*[\d.]+.* 0\.001", failed.stdout
    )
    assert check(team, POOLED + 'dives = ["tr*"]\n').returncode == 2
    assert check(team, POOLED.replace("position", "positio")).returncode == 2


def test_the_summary_has_expected_and_found_values(team: Path) -> None:
    assert check(team, EXPECTED, "--update").returncode == 0
    done = check(
        team, EXPECTED, "--set", "noise.accel_white_mps_rts=0.006", "--summary-file", "summary.md"
    )
    assert done.returncode == 1
    text = (team / "summary.md").read_text("utf-8")
    assert re.search(r"^aided against the baseline: \d+ \w+", text, re.MULTILINE)
    sentence = r"aided accelerometer bias z sd [\d.]+ -> [\d.]+ mg \(\+[\d.]+ %, limit \+"
    assert re.search(
        rf"\| FAILED \| transit \| no state becomes less certain \| .*{sentence}1 %\)", text
    )
    wide = EXPECTED.replace("max_worse_pct = 1", "max_worse_pct = 1000")
    done = check(team, wide, "--set", "noise.accel_white_mps_rts=0.006", "--format", "md")
    assert done.returncode == 0
    assert re.search(rf"\| transit \| {sentence}1000 %\) \|", done.stdout)


def test_results_of_a_check_are_small_unless_histories_are_wanted(team: Path) -> None:
    shutil.rmtree(team / "checked")
    assert check(team, PASSING).returncode == 0
    assert not (team / "checked" / "transit" / "replay.mcap").exists()
    assert (team / "checked" / "transit" / "report.html").is_file()
    assert check(team, PASSING, "--keep-histories").returncode == 0
    assert (team / "checked" / "transit" / "replay.mcap").is_file()


def test_quiet_is_a_line(team: Path) -> None:
    quiet = check(team, PASSING, "-q").stdout
    assert (quiet.count("\n"), counts(quiet)) == (1, [1, 2, 2])


# --- Output.


@pytest.mark.parametrize("option", ["--output", "--summary-file", "--badge"])
@pytest.mark.parametrize("name", ["gates.toml", "dives/transit.mcap", "dives"])
def test_what_is_checked_is_not_written_over(option: str, name: str, team: Path) -> None:
    before = (team / "dives" / "transit.mcap").read_bytes()
    done = check(team, PASSING, option, name)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {option}: {name}: ")
    assert (team / "gates.toml").read_text().endswith(PASSING)
    assert (team / "dives" / "transit.mcap").read_bytes() == before


@pytest.mark.parametrize("option", ["--output", "--badge"])
def test_files_of_settings_and_of_stored_results_are_not_written_over(
    option: str, team: Path, tmp_path: Path
) -> None:
    result = tmp_path / "stored"
    result.mkdir()
    (result / "report.json").write_text("{}")
    settings = tmp_path / "vehicle.toml"
    settings.write_text("")
    for given, file in (
        ([result], result / "report.json"),
        ([result / "report.json"], result / "report.json"),
        ([result], result / "new.json"),
        (["-c", settings], settings),
    ):
        done = check(team, PASSING, option, str(file), *map(str, given))
        assert done.returncode == 2
        assert f"error: {option}: {file}: is an input of this check" in done.stderr
    assert (result / "report.json").read_text() == "{}"
    assert settings.read_text() == ""


def test_two_outputs_in_one_file_are_refused(team: Path) -> None:
    done = check(team, PASSING, "--output", "both", "--badge", "both")
    assert done.returncode == 2
    assert "error: --badge: both: is also that of --output" in done.stderr
    assert not (team / "both").exists()


def judged(*statuses: str, reasons: Sequence[str] = ("because",)) -> CheckResult:
    return CheckResult(
        "gates.toml",
        tuple(
            msgspec.convert(
                {
                    "dive": "d",
                    "gate": f"gate {number}",
                    "status": status,
                    "reasons": reasons,
                    "line": 7,
                },
                GateOutcome,
            )
            for number, status in enumerate(statuses)
        ),
        elapsed_s={"d": 3.0},
    )


def test_junit_is_valid_and_counts_each_kind() -> None:
    text = junit_xml(
        judged(
            "unusable",
            "failed",
            "failed",
            "warning",
            "off",
            "passed",
            reasons=["a < b & \x1b[0m", "c"],
        )
    )
    SCHEMA.validate(text)
    (suite,) = ElementTree.fromstring(text.encode())
    counts = {"tests": "6", "failures": "2", "errors": "1", "skipped": "2", "time": "3.000"}
    assert suite.attrib == {"name": "d"} | counts
    assert {(case.get("time"), case.get("file"), case.get("line")) for case in suite} == {
        ("0.500", "gates.toml", "7")
    }
    assert [[child.tag for child in case] for case in suite] == [
        ["error"], ["failure"], ["failure"], ["skipped"], ["skipped"], [],
    ]  # fmt: skip
    assert suite[1][0].text == "a < b & \\x1b[0m\nc\ngates.toml:7"


@pytest.mark.parametrize(
    ("statuses", "message", "color"),
    [
        (("passed", "passed", "off"), "1 off, 2 passed", "brightgreen"),
        (("warning", "passed"), "1 with a warning, 1 passed", "yellow"),
        (("failed", "warning", "passed"), "1 failed, 1 with a warning, 1 passed", "red"),
        (("unusable", "passed"), "1 without a result, 1 passed", "red"),
        (("off",), "1 off", "lightgrey"),
    ],
)
def test_a_badge_is_what_shields_reads(statuses: Sequence[str], message: str, color: str) -> None:
    badge = json.loads(badge_json(judged(*statuses)))
    assert badge == {"schemaVersion": 1, "label": "gates", "message": message, "color": color}


def test_a_badge_is_written_in_place_of_an_older_one(team: Path) -> None:
    for gates, color, code in ((PASSING, "brightgreen", 0), (FAILING, "red", 1)):
        done = check(team, gates, "checked", "--badge", "badge.json")
        assert done.returncode == code
        assert json.loads((team / "badge.json").read_bytes())["color"] == color


def test_junit_has_a_case_for_each_dive_and_gate(team: Path) -> None:
    done = check(team, PASSING + FAILING, "--format", "junit", "--output", "gates.xml")
    assert done.returncode == 1
    assert "\nFAILED  outage: " in done.stdout
    SCHEMA.validate(str(team / "gates.xml"))
    suites = ElementTree.parse(team / "gates.xml").getroot()
    cases = list(suites.iter("testcase"))
    for suite in suites:
        report = json.loads((team / "checked" / suite.attrib["name"] / "report.json").read_bytes())
        assert float(suite.attrib["time"]) == pytest.approx(report["tool"]["elapsed_s"], abs=1e-3)
    lines = (team / "gates.toml").read_text("utf-8").split("\n")
    assert {lines[int(case.attrib["line"])] for case in cases} == {
        f'name = "{NAME}"',
        f'name = "{NAME} fully"',
    }
    names = [(case.attrib["classname"], case.attrib["name"], len(case)) for case in cases]
    assert sorted(names) == [
        ("outage", NAME, 0), ("outage", f"{NAME} fully", 1),
        ("transit", NAME, 0), ("transit", f"{NAME} fully", 1),
    ]  # fmt: skip


def as_a_runner_reads(line: str) -> tuple[str, dict[str, str], str]:
    """Take a workflow command apart: level, properties, message."""
    match = re.fullmatch(r"::(\w+) (.*?)::(.*)", line)
    assert match
    level, properties, message = match.groups()

    def plain(text: str) -> str:
        for code, character in (
            ("%2C", ","),
            ("%3A", ":"),
            ("%0A", "\n"),
            ("%0D", "\r"),
            ("%25", "%"),
        ):
            text = text.replace(code, character)
        return text

    pairs = (pair.split("=", 1) for pair in properties.split(","))
    return level, {name: plain(value) for name, value in pairs}, plain(message)


def test_github_reads_back_what_was_said() -> None:
    first, last = github_annotations(
        judged("failed", reasons=["50 %: a, b", "::error::c"])
    ).splitlines()
    assert as_a_runner_reads(first) == (
        "error", {"file": "gates.toml", "line": "7", "title": "d: gate 0"}, "50 %: a, b\n::error::c"
    )  # fmt: skip
    assert not last.startswith("::")


def test_github_annotations_are_capped_by_level() -> None:
    lines = github_annotations(
        judged(*["failed"] * 14, "unusable", *["warning"] * MOST_ANNOTATIONS)
    ).splitlines()
    commands = [as_a_runner_reads(line) for line in lines if line.startswith("::")]
    assert [level for level, _, _ in commands] == ["error"] * MOST_ANNOTATIONS + [
        "warning"
    ] * MOST_ANNOTATIONS
    assert commands[MOST_ANNOTATIONS - 1][2].startswith("6 ")


def test_json_and_the_summary(team: Path) -> None:
    (team / "summary.md").write_text("# Before\n")
    done = check(team, PASSING + FAILING, "--format", "json", "--summary-file", "summary.md")
    report = msgspec.json.decode(done.stdout, type=CheckReport)
    assert (report.failed, report.passed, len(report.outcomes)) == (2, 2, 4)
    assert report.outcomes[0].findings[0].row == "ba_z"
    summary = (team / "summary.md").read_text()
    assert summary.startswith("# Before\n## Gates\n")
    assert f"| FAILED | outage | {NAME} fully | aided accelerometer bias z " in summary


def test_the_same_check_gives_the_same_bytes(team: Path) -> None:
    outputs: dict[str, Any] = {}
    for format_ in ("text", "md", "json", "junit", "github"):
        outputs[format_] = check(team, PASSING + FAILING, "--format", format_).stdout
        assert (
            check(team, PASSING + FAILING, "--format", format_, "--jobs", "2").stdout
            == outputs[format_]
        )
    assert len(set(outputs.values())) == 5
