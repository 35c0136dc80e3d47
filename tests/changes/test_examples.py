"""The example archive is made by its script, holds its gates, and the jobs to copy run what exists."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
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
        reversed(line.split())
        for line in (ARCHIVE / "dives" / "SHA256SUMS").read_text("utf-8").splitlines()
    )
    assert hashlib.sha256(log.read_bytes()).hexdigest() == digests[log.name]


def test_the_dives_are_small_and_all_have_expected_values() -> None:
    dives = sorted((ARCHIVE / "dives").glob("*.mcap"))
    assert len(dives) == len(COMMANDS) == 4
    assert sum(dive.stat().st_size for dive in dives) < 1_000_000
    assert [dive.stem for dive in dives] == sorted(
        path.stem for path in (ARCHIVE / "expected").glob("*.json")
    )


def test_the_archive_holds_its_gates(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run_command_line(
            ["check", str(archive / "gates.toml"), "--results", str(archive / "checked")]
        )
        == 0
    )
    assert re.findall(r"\d+", capsys.readouterr().out.splitlines()[0]) == ["8", "4", "29"]


def test_a_worse_setting_fails_and_says_what_moved(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", str(archive / "gates.toml"), "--results", str(archive / "checked")]
    assert run_command_line([*arguments, "--set", "dvl.scale=1.02"]) == 1
    said = capsys.readouterr().out
    assert re.search(r"(sd|rms) .*\d\.\d+", said)
    assert "settings differ: dvl.scale 1.0 -> 1.02" in said


def job_of(name: str) -> dict[str, Any]:
    """A job as a runner's YAML reader sees it."""
    workflow: dict[str, Any] = YAML(typ="safe").load((EXAMPLES / "ci" / name).read_text("utf-8"))
    if name == "github.yml":
        assert {"name", "on", "jobs", "env", "permissions"} <= workflow.keys()
        return dict(workflow["jobs"]["check"])
    return dict(workflow["dives"])


ACTION: dict[str, Any] = YAML(typ="safe").load((EXAMPLES.parent / "action.yml").read_text("utf-8"))


def shell_steps(name: str) -> list[str]:
    """The steps that a shell runs, in their order."""
    if name == "action.yml":
        return [step["run"] for step in ACTION["runs"]["steps"] if "run" in step]
    job = job_of(name)
    return (
        [step["run"] for step in job["steps"] if "run" in step]
        if "steps" in job
        else list(job["script"])
    )


def run_steps(name: str, folder: Path, **more: str) -> list[subprocess.CompletedProcess[str]]:
    """Run the shell steps of a job, with programs on the path that stand for pip and GitHub's own."""
    tools = folder / "tools"
    tools.mkdir(exist_ok=True)
    for tool, body in {
        "pip": f'echo "pip $*" >> {folder}/called',
        "gh": f'echo "gh $*" >> {folder}/called',
        "insdvl-replay": f'exec {sys.executable} -m insdvl_replay "$@"',
        "python": f'exec {sys.executable} "$@"',
    }.items():
        (tools / tool).write_text(f"#!/bin/sh\n{body}\n")
        (tools / tool).chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tools}:{os.environ['PATH']}", "PYTHONPATH": str(EXAMPLES.parent),
        "INSDVL_REPLAY": "insdvl-replay==0.1.0", "GITHUB_STEP_SUMMARY": str(folder / "step.md"), "NUMBER": "7",
        "PAGES": "https://example.org/run", "GATES": "gates.toml", "JOBS": "1", "OPTIONS": "", "SOURCE": "/action",
    } | more  # fmt: skip
    return [
        subprocess.run(
            ["bash", "-e", "-c", step],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        for step in shell_steps(name)
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["github.yml", "gitlab.yml", "action.yml"])
def test_the_jobs_run_green_and_red(name: str, archive: Path) -> None:
    done = run_steps(name, archive)
    assert [step.returncode for step in done] == [0] * len(done), [step.stderr for step in done]
    assert "pip install " in (archive / "called").read_text()
    gates = (archive / "gates.toml").read_text()
    (archive / "gates.toml").write_text(gates.replace("max = 0.5", "max = 0.0001"))
    red = run_steps(name, archive)
    assert sum(step.returncode == 1 for step in red) == 1, "the check alone fails"
    said = {"github.yml": "::error", "gitlab.yml": "", "action.yml": "::error"}[name]
    assert any(said in step.stdout for step in red)
    written = {"github.yml": "step.md", "gitlab.yml": "summary.md", "action.yml": "step.md"}[name]
    assert "position stays near the reference" in (archive / written).read_text()
    assert (archive / "checked" / "transit" / "report.html").is_file(), "what is kept as a page"
    if name == "gitlab.yml":
        assert "<failure" in (archive / "gates.xml").read_text()
    if name == "github.yml":
        assert "gh pr comment 7 --body-file summary.md" in (archive / "called").read_text()
        assert "(https://example.org/run)" in (archive / "summary.md").read_text()


@pytest.mark.nightly
def test_options_of_the_action_are_split_like_a_shells_and_run_nothing(archive: Path) -> None:
    options = "--only 'position*' --shard 1/2 '$(touch pwned)'"
    done = run_steps("action.yml", archive, OPTIONS=options)
    assert not (archive / "pwned").exists()
    assert "$(touch pwned): " in done[-1].stderr + done[-1].stdout, (
        "it is a dive that does not exist"
    )
    done = run_steps("action.yml", archive, OPTIONS="--only 'position*' --shard 1/2")
    assert "2 gates on 2 dives: 4 " in done[-1].stdout


def test_red_nights_keep_their_cache_and_their_pages() -> None:
    for steps in (job_of("github.yml")["steps"], ACTION["runs"]["steps"]):
        used = {step["uses"].split("@")[0]: step for step in steps if "uses" in step}
        assert "actions/cache" not in used
        restored, saved = (used[f"actions/cache/{what}"]["with"] for what in ("restore", "save"))
        assert (restored["path"], restored["key"]) == (saved["path"], saved["key"])
        for what in ("actions/cache/save", "actions/upload-artifact"):
            assert used[what]["if"] == "always()"
        order = [step.get("uses", "").split("@")[0] for step in steps]
        assert order.index("actions/cache/restore") < order.index("actions/cache/save")
    gitlab = job_of("gitlab.yml")
    assert gitlab["cache"]["when"] == gitlab["artifacts"]["when"] == "always"
    assert gitlab["timeout"]
    assert job_of("github.yml")["timeout-minutes"] <= 60


def test_everything_that_is_used_is_pinned() -> None:
    for path in (EXAMPLES / "ci" / "github.yml", EXAMPLES.parent / "action.yml"):
        used = re.findall(r"uses: (\S+)@(\S+) # (v[\d.]+)", path.read_text("utf-8"))
        assert len(used) == path.read_text("utf-8").count("uses:")
        assert all(re.fullmatch(r"[0-9a-f]{40}", digest) for _, digest, _ in used)
    for name in ("github.yml", "gitlab.yml"):
        assert re.search(
            r"INSDVL_REPLAY: \"\S+@v\d+\.\d+\.\d+\"", (EXAMPLES / "ci" / name).read_text("utf-8")
        )


def dockerfile() -> list[tuple[str, str]]:
    """Instructions of the container file, with lines that go on joined."""
    text = re.sub(r"\\\n", " ", (EXAMPLES / "ci" / "Dockerfile").read_text("utf-8"))
    lines = [line for line in text.split("\n") if line and not line.startswith("#")]
    return [(line.split()[0], line.split(None, 1)[1]) for line in lines]


def test_the_container_file_is_in_order() -> None:
    found = dockerfile()
    words = [
        "ARG",
        "FROM",
        "ENV",
        "COPY",
        "RUN",
        "COPY",
        "COPY",
        "RUN",
        "RUN",
        "USER",
        "WORKDIR",
        "ENTRYPOINT",
        "CMD",
    ]
    assert [word for word, _ in found] == words
    assert re.fullmatch(r"BASE=python:3\.\d+-slim", found[0][1])
    assert json.loads(dict(found)["ENTRYPOINT"]) == ["python", "-P", "-m", "insdvl_replay"]


@pytest.mark.nightly
def test_steps_of_the_image_run_where_there_is_nothing_but_the_package(tmp_path: Path) -> None:
    """As the image does it: compile ahead, and run the command. What it installs is here already."""
    for _, what in [line for line in dockerfile() if line[0] == "COPY"][1:]:
        source, target = what.split()
        shutil.copytree(
            EXAMPLES.parent / source, tmp_path / Path(target).relative_to("/opt/insdvl-replay")
        )
    inside = os.environ | {
        "PYTHONPATH": str(tmp_path),
        "INSDVL_REPLAY_CACHE": str(tmp_path / "opt"),
    }
    installs, compiles, adds_user = (text for word, text in dockerfile() if word == "RUN")
    assert installs.startswith("pip install --require-hashes ")
    assert adds_user.startswith("useradd ")
    compiles = compiles.partition(" && chmod ")[0]
    for words, said in (
        (compiles.split(), "compiled in"),
        (["python", "-m", "insdvl_replay", "--help"], "Usage: "),
    ):
        command = [sys.executable, *words[1:]]
        done = subprocess.run(
            command, cwd=tmp_path, env=inside, capture_output=True, text=True, check=True
        )
        assert said in done.stdout
