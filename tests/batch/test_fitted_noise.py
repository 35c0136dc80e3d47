"""Noise that nobody gives is fitted to the dives, once for all of a run; what is given is never fitted over."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from insdvl_replay import check, compare_settings, load_config, replay_log
from insdvl_replay.calibration import fitted_noise
from insdvl_replay.calibration.found import FoundSettings
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config import Noise
from insdvl_replay.core.misfit import LEAST_NIS, MOST_NIS
from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

EIGHT = Path("sample_logs/figure_eight.mcap").absolute()
ONE_START = ("--starts", "1")


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write three short dives of one vehicle."""
    folder = tmp_path_factory.mktemp("dives")
    paths = [folder / f"{name}.mcap" for name in ("first", "second", "third")]
    for seed, path in enumerate(paths):
        dive = simulate_dive(
            "figure-eight", duration_s=60.0, imu_rate_hz=50.0, seed=seed, grade="tactical"
        )
        write_dive(path, dive)
    return paths


def replayed(logs: Sequence[Path], folder: Path, *options: str) -> dict[str, Any]:
    """Run the command over logs, and return the report of each dive by its name."""
    assert run_command_line(["run", *map(str, logs), "-o", str(folder), *ONE_START, *options]) == 0
    return {log.stem: json.loads((folder / log.stem / "report.json").read_text()) for log in logs}


def nis_per_dof(report: dict[str, Any]) -> float:
    row = report["tables"]["consistency"][0]
    assert (row["filter"], row["measurement"]) == ("baseline", "velocity")
    return float(row["mean_nis"] / row["dof"])


def without_tool(report: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in report.items() if key not in ("tool", "files")}


@pytest.mark.nightly
def test_a_dive_without_a_noise_gets_one_that_fits_and_a_line_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = replayed([EIGHT], tmp_path / "out")["figure_eight"]
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "noise fitted" in line]
    assert line.startswith("found: noise fitted to these dives, class fog: ")
    assert LEAST_NIS < nis_per_dof(report) < MOST_NIS
    assert report["config"]["noise"]["fit"] == []
    # The result is known again, and its vehicle.toml repeats it.
    assert replayed([EIGHT], tmp_path / "out") == {"figure_eight": report}
    said = capsys.readouterr().err
    assert "unchanged" in said
    assert line in said
    vehicle = str(tmp_path / "out" / "figure_eight" / "vehicle.toml")
    again = replayed([EIGHT], tmp_path / "again", "-c", vehicle)["figure_eight"]
    assert again["config"] == report["config"]
    assert again["tables"] == report["tables"]
    assert "noise fitted" not in capsys.readouterr().err


@pytest.mark.nightly
def test_python_fits_the_same_noise_as_the_command(tmp_path: Path) -> None:
    report = replayed([EIGHT], tmp_path / "out")["figure_eight"]
    result = replay_log(EIGHT, load_config(settings={"evaluation.starts": 1}))
    stored = json.loads((result.save(tmp_path / "saved") / "report.json").read_text())
    assert (stored["config"], stored["tables"]) == (report["config"], report["tables"])
    assert "found_noise" in {note["code"] for note in stored["notes"]}


@pytest.mark.parametrize(
    "given",
    [
        ("--preset", "levy-klein"),
        ("--set", "noise.gyro_white_rad_rts=3.7e-5"),
        ("--set", "noise.fit=[]"),
    ],
)
def test_a_noise_that_is_given_stays(
    given: tuple[str, str], dives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = replayed(dives[:1], tmp_path / "out", *given)["first"]["config"]
    paper = Noise()
    assert {key: config["noise"][key] for key in paper.__struct_fields__ if key != "fit"} == {
        key: getattr(paper, key) for key in paper.__struct_fields__ if key != "fit"
    }
    assert (config["dvl"]["velocity_sd_mps"], config["dvl"]["beam_sd_mps"]) == (0.02, None)
    assert "noise fitted" not in capsys.readouterr().err


def test_what_is_given_beside_the_noise_stays(dives: list[Path], tmp_path: Path) -> None:
    file = tmp_path / "vehicle.toml"
    file.write_text(
        "[dvl]\nvelocity_sd_mps = 0.02\n[initial]\ngyro_bias_sd_degph = 10.0\n", "utf-8"
    )
    config = replayed(dives[:1], tmp_path / "out", "-c", str(file))["first"]["config"]
    assert (config["dvl"]["velocity_sd_mps"], config["dvl"]["beam_sd_mps"]) == (0.02, None)
    assert (config["initial"]["gyro_bias_sd_degph"], config["initial"]["accel_bias_sd_mg"]) == (
        10.0,
        50.0,
    )
    assert config["noise"]["accel_white_mps_rts"] < 0.1 * Noise().accel_white_mps_rts


def test_dives_of_a_run_have_one_noise_which_moves_with_a_dive_that_is_added(
    dives: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, file = tmp_path / "out", tmp_path / "vehicle.toml"
    file.write_text("[dvl]\nscale = 1.0\n", "utf-8")
    two = replayed(dives[:2], out, "-c", str(file))
    assert two["first"]["config"] == two["second"]["config"]
    assert capsys.readouterr().err.count("noise fitted") == 1
    three = replayed(
        dives, out, "-c", str(file)
    )  # replaces what was fitted to two, without --force
    assert len({json.dumps(report["config"]) for report in three.values()}) == 1
    assert capsys.readouterr().err.count("noise fitted") == 1
    assert replayed(dives, out, "-c", str(file)) == three
    assert capsys.readouterr().err.count("unchanged ") == 3


def test_a_result_with_another_noise_is_not_replaced(dives: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    replayed(dives[:1], out, "--preset", "levy-klein")
    assert run_command_line(["run", str(dives[0]), "-o", str(out), *ONE_START]) != 0
    replayed(dives[:1], out, "--force")


@pytest.mark.parametrize(
    ("change", "key", "value"),
    [
        ("noise.gyro_white_rad_rts=1e-4", "noise.gyro_white_rad_rts", 1e-4),
        ("dvl.velocity_sd_mps=0.02", "dvl.velocity_sd_mps", 0.02),
    ],
)
@pytest.mark.nightly
def test_both_sides_of_a_change_have_the_noise_before_it(
    change: str, key: str, value: float, dives: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert (
        run_command_line(["run", str(dives[0]), "-o", str(out), *ONE_START, "--against", change])
        == 0
    )
    before, after = (
        json.loads((out / side / "first" / "report.json").read_text())
        for side in ("before", "after")
    )
    section, name = key.split(".")
    assert after["config"][section][name] == value
    expected = json.loads(json.dumps(before["config"]))
    expected[section][name] = value
    if section == "dvl":
        expected["dvl"]["beam_sd_mps"] = None  # which would override it
    assert after["config"] == expected
    assert before["config"]["noise"]["accel_white_mps_rts"] < 0.1 * Noise().accel_white_mps_rts


@pytest.mark.nightly
def test_compare_settings_and_check_of_python_fit_it_too(
    dives: list[Path], tmp_path: Path
) -> None:
    before = load_config(settings={"evaluation.starts": 1})
    after = load_config(settings={"evaluation.starts": 1, "dvl.scale": 1.01})
    compare_settings(dives[:1], before, after, tmp_path / "sides")
    reports = [
        json.loads((tmp_path / "sides" / side / "first" / "report.json").read_text())
        for side in ("before", "after")
    ]
    assert reports[0]["config"]["noise"] == reports[1]["config"]["noise"]
    assert reports[0]["config"]["noise"]["accel_white_mps_rts"] < 0.1 * Noise().accel_white_mps_rts
    gates = tmp_path / "gates.toml"
    gate = (
        '[[gate]]\nname = "fits"\ntable = "consistency"\nfilter = "baseline"\nrow = "velocity"\n'
    )
    gates.write_text(f'{gate}column = "mean_nis"\nmin = 0.9\nmax = 9.0\n', "utf-8")
    found = check(gates, dives[0], results=tmp_path / "checked")
    assert list(found.tables["gates"]["status"]) == ["passed"]
    assert (
        run_command_line(
            ["check", str(gates), str(dives[0]), "--results", str(tmp_path / "command")]
        )
        == 0
    )
    ours, theirs = (
        json.loads((tmp_path / side / "first" / "report.json").read_text())
        for side in ("checked", "command")
    )
    assert without_tool(ours) == without_tool(theirs)


def test_a_log_that_changes_behind_the_fit_has_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "dive.mcap"
    write_dive(log, simulate_dive("straight", seed=1, duration_s=60.0, imu_rate_hz=50.0))
    other = simulate_dive("straight", seed=2, duration_s=60.0, imu_rate_hz=50.0)
    fit = fitted_noise.fit_noise_of_logs

    def fit_and_replace(*arguments: Any, **options: Any) -> FoundSettings:
        found = fit(*arguments, **options)
        write_dive(log, other)
        return found

    monkeypatch.setattr(fitted_noise, "fit_noise_of_logs", fit_and_replace)
    arguments = ["run", str(log), "-o", str(tmp_path / "out"), "--starts", "1", "--no-auto"]
    assert run_command_line(arguments) == 3
    assert "the log has changed since its settings were found" in capsys.readouterr().err
    assert not (tmp_path / "out" / "dive").exists()
