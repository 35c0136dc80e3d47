"""The demonstration ends with the three words, says each stage, and touches no folder of others."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from in_process import done_here

import insdvl_replay
from insdvl_replay.batch import demo
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.errors import ConfigError
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors

ANSWERS = {"lever_arm": "BETTER", "scale": "WORSE", "gate": "NO EFFECT"}
MOST_CPU_S = 120.0


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three dives of a minute: too short for the three words, and enough for the screen."""
    monkeypatch.setattr(demo, "DURATION_S", 60.0)
    three = {
        "lawnmower_1": "lawnmower",
        "figure_eight_2": "figure-eight",
        "straight_3": "straight",
    }
    monkeypatch.setattr(demo, "DIVES", three)


@pytest.mark.usefixtures("short")
@pytest.mark.nightly
def test_each_stage_has_a_line_and_each_answer_a_page(tmp_path: Path) -> None:
    done = done_here("demo", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "simulating 3 dives of 60 s: demo/dives"
    stages = [line for line in lines if re.match(r"\d of 3: ", line)]
    assert [stage[0] for stage in stages] == ["1", "2", "3"]
    assert len([line for line in lines if line.startswith("baseline  ")]) == 3
    [pages] = [
        line.removeprefix("pages: ").split() for line in lines if line.startswith("pages: ")
    ]
    assert pages == [f"demo/{name}.html" for name in ANSWERS]
    for page in pages:
        assert "<html" in (tmp_path / page).read_text("utf-8")
    # What is shown can be typed: the settings are found.
    [typed] = [line for line in lines if "--against dvl.scale" in line and line.startswith("  $ ")]
    words = typed.removeprefix("  $ insdvl-replay ").split()
    again = done_here(*words, "-q", cwd=tmp_path)
    assert again.stdout.splitlines()[0] in lines
    assert lines[-3:] == [line for line in lines if line.startswith("  insdvl-replay ")]
    # Again, in Python: the same answers, by the results that are there.
    found = insdvl_replay.demo(tmp_path / "demo")
    assert list(found) == list(ANSWERS)
    for name, result in found.items():
        compared = insdvl_replay.compare(
            tmp_path / "demo" / name / "before", tmp_path / "demo" / name / "after"
        )
        assert result.tables["answer"].equals(compared.tables["answer"])


@pytest.mark.usefixtures("short")
def test_a_folder_of_others_is_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "demo" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    done = done_here("demo", cwd=tmp_path)
    assert done.returncode == 2
    assert "error: demo: holds something else than a demonstration; hint: " in done.stderr
    assert [path.name for path in mine.parent.iterdir()] == ["mine.txt"]
    with pytest.raises(ConfigError, match="holds something else"):
        insdvl_replay.demo(mine)


def test_the_settings_are_those_of_the_simulation(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(demo.SETTINGS, "utf-8")
    assert tomllib.loads(demo.SETTINGS).keys() == {"dvl", "noise", "filters"}
    config = load_config(file=file)
    assert config.dvl.lever_arm_m == demo.LEVER_ARM_M
    assert config.dvl.latency_s == demo.DELAY_S
    assert config.dvl.beam_sd_mps == DvlErrors().beam_sd_mps
    errors = GRADES["tactical"]
    assert config.noise.accel_white_mps_rts == errors.accel_white_mps_rts
    assert config.noise.gyro_white_rad_rts == pytest.approx(errors.gyro_white_rad_rts, rel=0.01)
    assert config.noise.accel_bias_walk_mps2_rts == errors.accel_bias_walk_mps2_rts
    assert config.noise.gyro_bias_walk_radps_rts == errors.gyro_bias_walk_radps_rts


@pytest.mark.nightly
@pytest.mark.all_starts
def test_the_demonstration_ends_with_the_three_words(tmp_path: Path) -> None:
    """As it is, in a new process: decided answers, in a pipe, within two minutes of processor time."""
    script = (
        "import os, sys\nfrom insdvl_replay.cli import run_command_line\n"
        "code = run_command_line(['demo'])\nused = os.times()\n"
        "print(used.user + used.system + used.children_user + used.children_system)\nsys.exit(code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    *lines, cpu_s = done.stdout.splitlines()
    answers = [line.removeprefix("baseline  ") for line in lines if line.startswith("baseline  ")]
    for answer, word in zip(answers, ANSWERS.values(), strict=True):
        assert answer.startswith(f"{word}  "), answer
    assert float(cpu_s) < MOST_CPU_S
