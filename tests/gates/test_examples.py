"""The example archive is made by its script, holds its gates, and the jobs to copy run what exists."""

import hashlib
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from insdvl_replay.cli import run_command_line

EXAMPLES = Path(__file__).parents[2] / "examples"
ARCHIVE = EXAMPLES / "archive"
COMMANDS = [
    line.split()
    for line in (ARCHIVE / "make.sh").read_text("utf-8").splitlines()
    if line.startswith('"$program" simulate')
]


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ARCHIVE, tmp_path / "archive"))


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[2])
def test_the_dives_are_made_again_byte_for_byte(command: list[str], tmp_path: Path) -> None:
    _, *arguments, place = command
    log = tmp_path / Path(place.strip('"')).name
    assert run_command_line([*arguments, str(log)]) == 0
    digests = dict(
        reversed(line.split()) for line in (ARCHIVE / "dives" / "SHA256SUMS").read_text("utf-8").splitlines()
    )
    assert hashlib.sha256(log.read_bytes()).hexdigest() == digests[log.name]


def test_the_dives_are_small_and_all_have_a_baseline() -> None:
    dives = sorted((ARCHIVE / "dives").glob("*.mcap"))
    assert len(dives) == len(COMMANDS) == 4
    assert sum(dive.stat().st_size for dive in dives) < 1_000_000
    assert [dive.stem for dive in dives] == sorted(path.stem for path in (ARCHIVE / "baselines").iterdir())


def test_the_archive_holds_its_gates(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["check", str(archive / "gates.toml"), "--results", str(archive / "checked")]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "5 gates on 4 dives: 20 passed"


def test_a_worse_setting_fails_and_says_what_moved(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["check", str(archive / "gates.toml"), "--results", str(archive / "checked")]
    assert run_command_line([*arguments, "--set", "dvl.scale=1.02"]) == 1
    assert re.search(r"sd went from [\d.]+ to [\d.]+ \S+: worse by|rmse is [\d.]+ m, at most", capsys.readouterr().out)


def steps_of(name: str) -> list[str]:
    """Every shell command of a job, as a runner's YAML reader sees it."""
    workflow: dict[str, Any] = YAML(typ="safe").load((EXAMPLES / "ci" / name).read_text("utf-8"))
    if name == "github.yml":
        assert {"name", "on", "jobs"} <= workflow.keys()
        return [step["run"] for step in workflow["jobs"]["check"]["steps"] if "run" in step]
    return list(workflow["dives"]["script"])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "said"), [("github.yml", "::error"), ("gitlab.yml", "FAILED")])
def test_the_jobs_run(
    name: str, said: str, archive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(archive)
    install, check = (step.split() for step in steps_of(name))
    assert install == ["pip", "install", "insdvl-replay"]
    program, *arguments = (word.replace('"$GITHUB_STEP_SUMMARY"', "summary.md") for word in check)
    assert program == "insdvl-replay"
    assert run_command_line(arguments) == 0
    assert run_command_line([*arguments, "--set", "noise.accel_white_mps_rts=0.4"]) == 1
    assert said in capsys.readouterr().out
    assert (archive / ("summary.md" if name == "github.yml" else "gates.xml")).is_file()
