"""Settings name code; it runs with ``--allow-code`` alone, and cannot end a check as if all gates had been passed."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import insdvl_replay
from insdvl_replay.batch.workers import local_pool
from insdvl_replay.cli import run_command_line
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError

DIVE = Path(__file__).parents[2] / "examples" / "archive" / "dives" / "transit.mcap"
TURNING = Path(__file__).parents[2] / "sample_logs" / "figure_eight.mcap"
SETTINGS = """[filters.baseline]
aiding = ["velocity"]

[filters.mine]
aiding = ["velocity", "told_code:Down"]
"""
GATES = """[[gate]]
name = "any"
table = "improvement"
row = "ba_z"
column = "improvement_pct"
min = -1e9
"""


@pytest.fixture
def vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Settings with a module that says so when it is imported, and ends its process."""
    (tmp_path / "told_code.py").write_text(
        "import os\nopen('imported', 'w').close()\nos._exit(0)\n"
    )
    (tmp_path / "vehicle.toml").write_text(SETTINGS)
    (tmp_path / "gates.toml").write_text(GATES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path / "vehicle.toml"
    assert "told_code" not in sys.modules


@pytest.mark.parametrize(
    "command",
    [
        ["run", str(DIVE)],
        ["check", "gates.toml", str(DIVE)],
        ["calibrate", str(DIVE)],
        ["study", "montecarlo", "straight"],
    ],
)
def test_what_runs_filters_refuses_code_before_it_is_imported(
    command: list[str], vehicle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*command, "-c", str(vehicle)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {vehicle}: filters.mine.aiding[1] ")
    assert "told_code:Down; hint: " in said
    assert "--allow-code" in said
    assert sorted(path.name for path in vehicle.parent.iterdir()) == [
        "gates.toml",
        "told_code.py",
        "vehicle.toml",
    ]


@pytest.mark.parametrize(
    "command",
    [
        ["config"],
        ["inspect", "--deep", str(DIVE)],
        ["inspect", str(DIVE)],
        ["study", "window", str(DIVE), "--longest", "2"],
        [
            "calibrate",
            str(TURNING),
            "--set",
            "span.end_s=200",
            "--allow-code",
        ],  # the baseline alone is run
    ],
)
def test_what_runs_no_filter_runs_no_code(
    command: list[str], vehicle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line([*command, "-c", str(vehicle)]) == 0
    assert not (vehicle.parent / "imported").exists()
    if command[0] == "inspect":
        assert "told_code:Down" in capsys.readouterr().err


def test_code_on_the_command_line_and_in_python_is_refused_too(vehicle: Path) -> None:
    with pytest.raises(ConfigError, match=r"--set .*: filters.mine.aiding\[0\] .*told_code:Down"):
        load_config(overrides=['filters.mine.aiding=["told_code:Down"]'])
    with pytest.raises(ConfigError, match=r"told_code:Down"):
        insdvl_replay.load_config(vehicle)
    assert insdvl_replay.load_config(vehicle, allow_code=True).code == ("told_code:Down",)


def test_settings_without_their_code_are_settings() -> None:
    given = [
        'filters.own.aiding=["told_code:Down"]',
        'filters.aided.aiding=["velocity","told_code:Down"]',
    ]
    config = load_config(overrides=given, allow_code=True).without_code()
    assert config.code == ()
    assert {name: filter_.aiding for name, filter_ in config.filters.items()} == {
        "baseline": ("velocity",),
        "aided": ("velocity",),
    }


def test_code_runs_in_a_process_of_its_own() -> None:
    assert local_pool(1) is None
    assert local_pool(1, runs_code=True) is not None


LEAVING = """
import os

import numpy as np

from insdvl_replay import UserNoise


class Noise(UserNoise):
    def noise_factors(self, dive):
        if dive.name == "transit":
            os._exit(0)
        return dive.imu.time_ns[:1], np.ones((1, 2))
"""


@pytest.mark.nightly
def test_code_that_ends_its_process_fails_one_dive_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "leaving.py").write_text(LEAVING)
    monkeypatch.syspath_prepend(str(tmp_path))
    noise = ["--preset", "fog", "--set", "dvl.beam_sd_mps=0.006"]
    settings = [
        "--starts",
        "1",
        "--allow-code",
        *noise,
        "--set",
        "filters.aided.noise_factors=leaving:Noise",
    ]
    dives = [str(DIVE), str(DIVE.with_name("outage.mcap"))]
    assert run_command_line(["run", *dives, "-o", str(tmp_path), "--jobs", "2", *settings]) == 3
    said = capsys.readouterr().err
    assert (
        f"error: {DIVE}: its process ended twice; it runs the code of filters.aided (leaving:Noise); hint: "
        in said
    )
    assert "--set filters.aided=false" in said
    assert (tmp_path / "outage" / "report.json").exists()


@pytest.mark.nightly
def test_code_that_ends_its_process_fails_the_check(
    vehicle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(vehicle.parent))  # where the module of the settings is
    command = [
        sys.executable,
        "-m",
        "insdvl_replay",
        "check",
        "gates.toml",
        str(DIVE),
        "-c",
        str(vehicle),
    ]
    done = subprocess.run(
        [*command, "--allow-code"], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 3
    assert "\nNO RESULT  " in done.stdout
    assert (
        "its process ended twice; it runs the code of filters.mine (told_code:Down); hint: "
        in done.stderr
    )
    assert (vehicle.parent / "imported").exists()
