"""Help that teaches: every example of every command runs as it stands, and the shell completes."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from made_tracks import write_dives, write_odometry
from recorded_parts import write_part

from insdvl_replay.cli import run_command_line
from insdvl_replay.cli.app import app

PROJECT = Path(__file__).resolve().parents[2]
SHORTER = {"study montecarlo": ["--runs", "2", "--duration", "20"]}
"""Options that make a long example short, by how it begins."""
EARLIER = {"300:480": "8:12"}
"""What has to happen earlier in it."""
ELSEWHERE = "dives:/"
"""How an example names a topic of dives, which here are in the folder of dives with trajectories."""


GATES = """
dives = ["archive"]

[[gate]]
name = "position error stays small"
table = "reference_error"
row = "position_h"
column = "rmse"
max = 10.0
"""


def helped(name: str, command: Any) -> Iterator[tuple[str, str]]:
    """Each command and its help."""
    yield name, command.help or ""
    for below, child in getattr(command, "commands", {}).items():
        yield from helped(f"{name} {below}".strip(), child)


COMMANDS = dict(helped("", typer.main.get_command(app)))
EXAMPLES = [
    (name, line)
    for name, text in COMMANDS.items()
    for line in re.findall(r"^\s*insdvl-replay (.+)$", text.partition("Example:")[2], re.MULTILINE)
]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the examples name: dives, shards, trajectories, results, settings and gates."""
    folder = tmp_path_factory.mktemp("workshop")
    dive = str(folder / "dive.mcap")
    assert run_command_line(["simulate", "straight", "-o", dive, "--duration", "190"]) == 0
    (folder / "dives").mkdir()
    for number in ("1", "2"):
        log = str(folder / "dives" / f"{number}.mcap")
        assert (
            run_command_line(
                ["simulate", "figure-eight", "-o", log, "--duration", "120", "--seed", number]
            )
            == 0
        )
    written = Path(dive).read_bytes()
    write_part(folder / "sensors.mcap", lambda topic, _: topic != "/reference", log=written)
    write_part(folder / "gnss.mcap", lambda topic, _: topic == "/reference", log=written)
    shutil.copytree(folder / "dives", folder / "archive")
    (folder / "gates.toml").write_text(GATES, "utf-8")
    for results in ("before", "after", "replay"):
        run = ["run", dive, "-o", str(folder / results), "--lake", str(folder / "lake")]
        assert run_command_line(run) == 0
    for number in ("1", "2", "3", "4"):
        shard = str(folder / f"part_{number}")
        run = ["run", str(folder / "dives"), "--shard", f"{number}/4", "-o", shard]
        assert run_command_line(run) == 0
        shutil.copytree(shard, folder / "parts", dirs_exist_ok=True)
    write_dives(folder)
    for number in range(3):
        write_odometry(folder / "odometry" / f"dive_{number}.mcap", number)
    (folder / "vehicle.toml").write_text("[dvl]\nvelocity_sd_mps = 0.03\n", "utf-8")
    (folder / "calibrated.toml").write_text("[dvl]\nlatency_s = 0.01\n", "utf-8")
    return folder


def test_every_command_has_two_examples_of_itself() -> None:
    for name, text in COMMANDS.items():
        if name in ("study", "lake"):
            continue
        own = [line for command, line in EXAMPLES if command == name and line.startswith(name)]
        assert len(own) >= 2, f"{name}: {text}"


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "example"), EXAMPLES, ids=[line for _, line in EXAMPLES])
def test_example_runs_as_it_is(
    name: str, example: str, workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "here"
    shutil.copytree(workshop, folder, symlinks=True)
    monkeypatch.chdir(folder)
    words = [
        EARLIER.get(word, word).replace(ELSEWHERE, "odometry:/")
        for word in shlex.split(example.partition(">")[0])
    ]
    arguments = [
        found for word in words for found in sorted(map(str, Path().glob(word))) or [word]
    ]
    if "simulate" in arguments:
        (folder / "dive.mcap").unlink()
    if "calibrate" in arguments:
        (folder / "calibrated.toml").unlink()
    if "run" in arguments:
        shutil.rmtree(folder / "replay")
        shutil.rmtree(folder / "parts")
    arguments += next(
        (options for begin, options in SHORTER.items() if example.startswith(begin)), []
    )
    assert run_command_line(arguments) == 0


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("insdvl-replay si", ["simulate"]),
        pytest.param("insdvl-replay run --pre", ["--preset"], marks=pytest.mark.nightly),
        ("insdvl-replay run --preset t", ["tactical"]),
        pytest.param(
            "insdvl-replay simulate s", ["straight", "static"], marks=pytest.mark.nightly
        ),
        pytest.param(
            "insdvl-replay simulate straight --imu f", ["fog"], marks=pytest.mark.nightly
        ),
        pytest.param("insdvl-replay run --format m", ["md"], marks=pytest.mark.nightly),
    ],
)
def test_the_shell_completes(typed: str, offered: list[str]) -> None:
    words = typed.split()
    asked = {
        "COMP_WORDS": typed,
        "COMP_CWORD": str(len(words) - 1),
        "_INSDVL_REPLAY_COMPLETE": "complete_bash",
    }
    command = [sys.executable, "-m", "insdvl_replay"]
    done = subprocess.run(
        command,
        env={**os.environ, **asked},
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert sorted(done.stdout.split()) == sorted(offered)
    assert done.stderr == ""
