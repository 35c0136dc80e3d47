"""The recipes of examples/fleet are parsed, and what they run on many machines is run here."""

import os
import re
import shlex
import stat
import subprocess
from pathlib import Path
from typing import Any

import pytest
from in_process import done_here
from ruamel.yaml import YAML

from insdvl_replay.logs import write_dive
from insdvl_replay.sim.dive import simulate_dive

PROJECT = Path(__file__).parents[2]
FLEET = PROJECT / "examples" / "fleet"
STUB = """#!/bin/bash
printf '%s\\n' "$*" >> "$CALLS"
exit ${CODE:-0}
"""
VEHICLE = """
[dvl]
velocity_sd_mps = 0.004
[noise]
accel_white_mps_rts = 0.005
gyro_white_rad_rts = 1.2e-6
gyro_bias_walk_radps_rts = 2e-10
[evaluation]
starts = 1
"""


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the recipes name: an archive, a manifest and settings."""
    folder = tmp_path_factory.mktemp("vehicle")
    (folder / "archive").mkdir()
    entries = ['[[dive]]\npath = "archive/broken.mcap"\n']
    for seed in range(1, 7):
        name = f"archive/dive_{seed}.mcap"
        dive = simulate_dive("straight", seed=seed, duration_s=20.0, imu_rate_hz=50.0)
        write_dive(folder / name, dive)
        entries.append(f'[[dive]]\npath = "{name}"\n')
    (folder / "archive" / "broken.mcap").write_bytes(b"no log" * 100)
    (folder / "dives.toml").write_text("".join(entries))
    (folder / "vehicle.toml").write_text(VEHICLE)
    assert (
        done_here("run", "archive", "-c", "vehicle.toml", "-o", "whole", cwd=folder).returncode
        == 3
    )
    return folder


def run_bash(script: str, folder: Path, code: int = 0, **variables: str) -> tuple[int, list[str]]:
    """Run a script with programs that only note how they are called; return its exit code and the calls."""
    stubs = folder / "stubs"
    stubs.mkdir(exist_ok=True)
    for name in ("insdvl-replay", "aws", "pip"):
        stub = stubs / name
        stub.write_text(STUB)
        stub.chmod(stub.stat().st_mode | stat.S_IXUSR)
    calls = folder / "calls"
    calls.write_text("")
    environment = {"PATH": f"{stubs}:{os.environ['PATH']}", "CALLS": str(calls), "CODE": str(code)}
    done = subprocess.run(
        ["bash", "-e", "-c", script],
        cwd=folder,
        env=environment | variables,
        timeout=30,
        check=False,
    )
    return done.returncode, calls.read_text().splitlines()


def replay(calls: list[str], vehicle: Path, output: Path) -> Any:
    """Run the calls of all shards and of the merge, in this process, into a folder of the test."""
    done = None
    for call in calls:
        words = shlex.split(call)
        place = words.index("-o") + 1
        words[place] = str(output / words[place])
        if words[0] == "merge":
            words[1] = str(output / words[1])
        done = done_here(*words, cwd=vehicle)
        assert done.returncode in (0, 3), done.stderr
    return done


def assert_whole(calls: list[str], vehicle: Path, output: Path) -> None:
    done = replay(calls, vehicle, output)
    assert done.returncode == 3
    results = output / "results"
    whole = vehicle / "whole"
    for name in ("summary.csv", "answers.csv", "evidence.csv", "where.csv", "index.html"):
        assert (results / name).read_bytes() == (whole / name).read_bytes()
    assert sorted(path.name for path in results.iterdir()) == sorted(
        path.name for path in whole.iterdir()
    )


def merge_in(text: str) -> str:
    """The command by which the comments of a recipe merge the parts."""
    found = re.search(r"insdvl-replay (merge parts -o results)", text)
    assert found is not None
    return found[1]


@pytest.mark.nightly
def test_a_slurm_array(vehicle: Path, tmp_path: Path) -> None:
    text = (FLEET / "slurm.sh").read_text("utf-8")
    assert subprocess.run(["bash", "-n", FLEET / "slurm.sh"], check=False).returncode == 0
    first, last = map(int, re.findall(r"--array=(\d+)-(\d+)", text)[0])
    calls = []
    for task in range(first, last + 1):
        code, called = run_bash(text, tmp_path, code=3, SLURM_ARRAY_TASK_ID=str(task))
        assert code == 0
        calls += called
    assert run_bash(text, tmp_path, code=2, SLURM_ARRAY_TASK_ID="7")[0] != 0
    _, [alone] = run_bash(text, tmp_path, SLURM_ARRAY_TASK_ID="7", SLURM_CPUS_PER_TASK="4")
    assert "--shard 7/20 --jobs 4" in alone
    assert_whole([*calls, merge_in(text)], vehicle, tmp_path)


@pytest.mark.nightly
def test_an_array_job_of_aws_batch(vehicle: Path, tmp_path: Path) -> None:
    text = (FLEET / "aws_batch.sh").read_text("utf-8")
    assert subprocess.run(["bash", "-n", FLEET / "aws_batch.sh"], check=False).returncode == 0
    calls = []
    for index in range(4):
        variables = {"AWS_BATCH_JOB_ARRAY_INDEX": str(index), "SHARDS": "4", "BUCKET": "s3://logs"}
        code, called = run_bash(text.replace("\naws ", "\nCODE=0 aws "), tmp_path, 3, **variables)
        assert code == 0
        assert called[1:] == ["s3 sync parts s3://logs/parts"]
        calls.append(called[0])
        code, called = run_bash(text, tmp_path, 2, **variables)
        assert (code, len(called)) == (1, 1)
    assert_whole([*calls, merge_in(text)], vehicle, tmp_path)


def using(action: str, job: dict[str, Any]) -> dict[str, Any]:
    """The values that a job gives to an action."""
    [found] = [step["with"] for step in job["steps"] if action in step.get("uses", "")]
    return dict(found)


def test_a_matrix_of_github_jobs(vehicle: Path, tmp_path: Path) -> None:
    workflow = YAML(typ="safe").load(FLEET / "github.yml")
    replays = workflow["jobs"]["replay"]
    merge = workflow["jobs"]["merge"]
    assert merge["needs"] == "replay"
    assert not replays["strategy"]["fail-fast"]
    shards = replays["strategy"]["matrix"]["shard"]
    calls = []
    for shard in shards:
        for step in replays["steps"]:
            script = step.get("run", "").replace("${{ matrix.shard }}", str(shard))
            assert "${{" not in script
            code, called = run_bash(
                script, tmp_path, 3 * ("replay run" in script), INSDVL_REPLAY="x"
            )
            assert code == 0
            calls += [call for call in called if call.startswith("run")]
    up = using("upload-artifact", replays)
    down = using("download-artifact", merge)
    assert up["name"].startswith(down["pattern"].removesuffix("*"))
    assert (up["path"], down["merge-multiple"]) == (down["path"], True)
    for step in merge["steps"]:
        calls += [
            call
            for call in run_bash(step.get("run", ""), tmp_path, INSDVL_REPLAY="x")[1]
            if call.startswith("merge")
        ]
    assert f"--shard {shards[-1]}/{len(shards)} " in calls[-2]
    assert_whole(calls, vehicle, tmp_path)


@pytest.mark.nightly
def test_a_workflow_of_snakemake(vehicle: Path, tmp_path: Path) -> None:
    """Its targets are the files that shards leave, and its commands make them."""
    rules = dict(
        re.findall(r"^rule (\w+):\n((?:    .*\n)+)", (FLEET / "Snakefile").read_text(), re.M)
    )
    assert list(rules) == ["results", "shard"]
    numbers = re.findall(r"^SHARDS = (\d+)$", (FLEET / "Snakefile").read_text(), re.M)
    shards = int(numbers[0])
    [wanted] = re.findall(r'input: expand\("(.+?)"', rules["results"])
    [made] = re.findall(r'output: "(.+)"', rules["shard"])
    assert wanted == made
    calls = []
    for number in range(1, shards + 1):
        [command] = re.findall(r'shell: "(.+)"', rules["shard"])
        for wildcard, value in {"number": number, "shards": shards}.items():
            command = command.replace(f"{{wildcards.{wildcard}}}", str(value))
        script = f"set -euo pipefail; {command.format(threads=1)}"
        code, called = run_bash(script, tmp_path, 3)
        assert code == 0
        calls += called
    [command] = re.findall(r'shell: "(.+)"', rules["results"])
    calls += run_bash(command, tmp_path)[1]
    assert_whole(calls, vehicle, tmp_path)
    for number in range(1, shards + 1):
        assert (tmp_path / made.format(number=number, shards=shards)).is_file()
    [summary] = re.findall(r'output: "(.+)"', rules["results"])
    assert (tmp_path / summary).is_file()


@pytest.mark.parametrize("name", ["slurm.sh", "github.yml", "aws_batch.sh", "Snakefile"])
def test_the_page_names_each_recipe(name: str) -> None:
    assert f"(../examples/fleet/{name})" in (PROJECT / "docs" / "many_dives.md").read_text("utf-8")
