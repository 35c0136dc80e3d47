"""The command as its user meets it: what it prints and writes, and how it refuses."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from insdvl_replay.calibration.innovations import Geometry
from insdvl_replay.calibration.rows import TABLES
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.words import Estimated


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dives")
    for seed in ("1", "2"):
        dive = str(folder / f"dive_{seed}.mcap")
        assert (
            run_command_line(
                ["simulate", "calibration", "--seed", seed, "--duration", "110", "-o", dive]
            )
            == 0
        )
    assert (
        run_command_line(
            ["simulate", "static", "--duration", "100", "-o", str(folder / "static.mcap")]
        )
        == 0
    )
    return folder


def calibrate(dives: Path, *names: str) -> list[str]:
    return ["calibrate", *(str(dives / f"{name}.mcap") for name in names), "--preset", "fog"]


def test_settings_are_written_that_a_run_takes(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tmp_path / "found.toml"
    assert run_command_line([*calibrate(dives, "dive_1", "dive_2"), "-o", str(found)]) == 0
    out, err = capsys.readouterr()
    assert "2 dives" in out.splitlines()[0]
    assert f"-c {found}`" in out
    assert err.endswith(f"wrote {found}\n")
    assert load_config("fog", found).dvl.lever_arm_m == pytest.approx((0.0, 0.0, 0.0), abs=0.03)
    run = [
        "run",
        str(dives / "dive_1.mcap"),
        "-c",
        str(found),
        "-o",
        str(tmp_path / "replay"),
        "--starts",
        "1",
    ]
    assert run_command_line(run) == 0
    assert run_command_line([*calibrate(dives, "dive_1"), "-o", str(found)]) == 2
    assert "exists" in capsys.readouterr().err


def test_later_settings_are_over_earlier_ones(tmp_path: Path) -> None:
    files = [tmp_path / "vehicle.toml", tmp_path / "found.toml"]
    files[0].write_text(
        "[dvl]\nscale = 1.1\nlatency_s = 0.5\n[filters.only]\naiding = ['velocity']\n", "utf-8"
    )
    files[1].write_text("[dvl]\nlatency_s = 0.1\n", "utf-8")
    config = load_config("fog", files)
    assert (config.dvl.scale, config.dvl.latency_s, list(config.filters)) == (1.1, 0.1, ["only"])
    assert load_config("fog", files[::-1]).dvl.latency_s == 0.5


def test_json_has_what_the_schema_describes(
    dives: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        run_command_line(
            [*calibrate(dives, "dive_1", "dive_2"), "--hold-out", "0.5", "--format", "json"]
        )
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    tables = {
        name: msgspec.convert(rows, list[TABLES[name]]) for name, rows in result["tables"].items()
    }  # type: ignore[misc]
    assert tables.keys() == {"parameters", "noise", "dives", "held_out"}
    assert [row.dive for row in tables["dives"]] == ["dive_1"]
    assert [row.dive for row in tables["held_out"]] == ["dive_2"]
    assert {row.parameter: row.status for row in tables["parameters"]}[
        "arm_x"
    ] == Estimated.ESTIMATED
    assert result["config"]["dvl"]["scale"] == 1.0


def test_csv_has_a_column_for_each_axis(dives: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line([*calibrate(dives, "dive_1"), "--format", "csv", "--only", "arm"]) == 0
    lines = capsys.readouterr().out.split("\n")
    header = next(line for line in lines if line.startswith("table,dive,"))
    assert header.endswith(
        ",".join(
            f"{name}_{axis}" for name in ("before", "after", "autocorrelation") for axis in "xyz"
        )
    )
    row = next(line for line in lines if line.startswith("dives,"))
    assert row.count(",") == header.count(",")
    assert "(" not in row


def test_nothing_estimated_is_reported_and_writes_nothing(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = tmp_path / "found.toml"
    assert run_command_line([*calibrate(dives, "static"), "-o", str(found)]) == 3
    out, err = capsys.readouterr()
    assert out
    assert err.startswith("error: ")
    assert "; hint: " in err
    assert list(tmp_path.iterdir()) == []


def test_a_dive_that_cannot_be_used_does_not_stop_the_others(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no log")
    command = [*calibrate(dives, "dive_1"), str(broken), "--format", "json"]
    assert run_command_line(command) == 3
    out, err = capsys.readouterr()
    assert len(json.loads(out)["tables"]["dives"]) == 1
    assert "broken.mcap: " in err
    assert run_command_line(["calibrate", str(broken)]) == 3
    assert capsys.readouterr().err.count("error:") == 1


@pytest.mark.parametrize(
    ("options", "wrong", "meant"),
    [
        (["--only", "arms"], "group of parameters 'arms'", "arm"),
        (["--only", ","], "no group of parameters", "arm"),
        (["--hold-out", "2"], "share to hold out", "0.3"),
        (["--hold-out", "0.5"], "all dives are held out", "fewer"),
        (["--hold-out", "dive_9"], "dive to hold out 'dive_9'", "dive_1"),
    ],
)
def test_what_is_asked_wrongly_is_refused(
    dives: Path, options: list[str], wrong: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*calibrate(dives, "dive_1"), *options]) == 2
    said, _, hint = capsys.readouterr().err.partition("; hint: ")
    assert said.startswith(f"error: {wrong}")
    assert meant in hint


def test_a_mounting_that_was_found_is_written_with_what_rests_on_it(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Configured by a right angle off; the messages tell where the beams look, which leaves four of the 24 ways."""
    wrong, found = tmp_path / "wrong.toml", tmp_path / "found.toml"
    wrong.write_text("[dvl]\nmounting_rpy_deg = [0.0, 0.0, 90.0]\n", "utf-8")
    command = [
        *calibrate(dives, "dive_1"),
        "-c",
        str(wrong),
        "--mounting",
        "unknown",
        "--only",
        "arm,delay",
    ]
    assert run_command_line([*command, "-o", str(found)]) == 0
    assert re.search(r"\b4 mountings.* roll 0, pitch 0, heading 0 deg", capsys.readouterr().out)
    dvl = load_config("fog", [wrong, found]).dvl
    assert dvl.mounting_rpy_deg == pytest.approx((0.0, 0.0, 0.0))
    assert dvl.lever_arm_m == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


def test_dives_of_the_same_name_are_held_out_one_by_one(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = []
    for name in ("dive_1", "dive_2"):
        (tmp_path / name).mkdir()
        logs.append(tmp_path / name / "dive.mcap")
        logs[-1].write_bytes((dives / f"{name}.mcap").read_bytes())
    command = [
        "calibrate",
        *map(str, logs),
        "--preset",
        "fog",
        "--hold-out",
        "0.5",
        "--format",
        "json",
    ]
    assert run_command_line(command) == 0
    tables = json.loads(capsys.readouterr().out)["tables"]
    assert (len(tables["dives"]), len(tables["held_out"])) == (1, 1)


STOPPED_WHILE_FITTING = """
import sys, time
import insdvl_replay.calibration.WHERE as module
def stop(*_, **__):
    print("busy", flush=True)
    time.sleep(60)
module.WHAT = stop
from insdvl_replay.cli import main
sys.argv = ["insdvl-replay", *sys.argv[1:]]
main()
"""


@pytest.mark.parametrize(
    "where",
    [
        "output.toml_value",
        *(
            pytest.param(one, marks=pytest.mark.nightly)
            for one in ("fit.robust_cost", "output.delay_profile")
        ),
    ],
)
@pytest.mark.parametrize(
    "signal_", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)]
)
def test_an_interruption_leaves_nothing(
    signal_: signal.Signals, where: str, dives: Path, tmp_path: Path
) -> None:
    """While it is fitted, and while the page and the settings are made."""
    module, _, name = where.partition(".")
    script = STOPPED_WHILE_FITTING.replace("WHERE", module).replace("WHAT", name)
    made = tmp_path / "temporary"
    made.mkdir()
    command = [
        sys.executable,
        "-c",
        script,
        *calibrate(dives, "dive_1"),
        "-o",
        "found.toml",
        "--page",
        "found.html",
    ]
    with subprocess.Popen(
        [*command, "--format", "csv"],
        cwd=tmp_path,
        env=os.environ | {"TMPDIR": str(made)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline() != "busy\n":
            assert process.poll() is None
        process.send_signal(signal_)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.endswith("error: interrupted\n")
    assert list(tmp_path.rglob("*")) == [made]


@pytest.mark.nightly
def test_a_terminal_sees_how_far_it_is(
    dives: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert run_command_line([*calibrate(dives, "dive_1"), "--format", "csv"]) == 0
    shown = capsys.readouterr().err
    assert "of 12" in shown
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    assert run_command_line([*calibrate(dives, "dive_1"), "--format", "csv"]) == 0
    assert capsys.readouterr().err == ""


def test_notes_of_the_dives_are_reported_when_asked(
    dives: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*calibrate(dives, "dive_1"), "--set", "span.start_s=20", "-v"]) == 0
    assert "info: dive_1: " in capsys.readouterr().err


@pytest.mark.nightly
def test_all_eight_are_shown_and_found_by_the_dive_that_is_made_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the settings that nobody has touched, whose noise is the largest."""
    log = str(tmp_path / "dive.mcap")
    put_in = [
        "--lever-arm",
        "0.3,-0.1,0.2",
        "--mounting",
        "0.5,-0.5,1.5",
        "--dvl-delay",
        "0.12",
        "--dvl-scale",
        "1.02",
    ]
    assert run_command_line(["simulate", "calibration", "--seed", "7301", "-o", log, *put_in]) == 0
    capsys.readouterr()
    assert run_command_line(["calibrate", log, "--format", "json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {row["status"] for row in result["tables"]["parameters"]} == {"estimated"}
    sd = {row["parameter"]: row["sd"] for row in result["tables"]["parameters"]}
    found = msgspec.convert(result["facts"]["after"]["dvl"], Geometry)
    for axis, value, truth in zip("xyz", found.lever_arm_m, (0.3, -0.1, 0.2), strict=True):
        assert value == pytest.approx(truth, abs=3.0 * sd[f"arm_{axis}"])
    for axis, value, truth in zip("xyz", found.mounting_rpy_deg, (0.5, -0.5, 1.5), strict=True):
        assert value == pytest.approx(truth, abs=3.0 * sd[f"mounting_{axis}"])
    assert found.latency_s == pytest.approx(0.12, abs=3.0 * sd["delay"])
    assert found.scale == pytest.approx(1.02, abs=0.03 * sd["scale"])


@pytest.mark.parametrize(
    "option",
    [
        ["--lever-arm", "1,2"],
        ["--mounting", "a,b,c"],
        ["--dvl-scale", "0"],
        ["--lever-arm", "nan,0,0"],
    ],
)
def test_a_dvl_that_cannot_be_built_in_is_not_simulated(option: list[str], tmp_path: Path) -> None:
    log = tmp_path / "dive.mcap"
    assert run_command_line(["simulate", "static", "-o", str(log), *option]) == 2
    assert not log.exists()


def test_a_span_without_pings_is_reported(dives: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line([*calibrate(dives, "static"), "--set", "span.start_s=98"]) == 3
    assert "0 pings are too few to calibrate" in capsys.readouterr().err
