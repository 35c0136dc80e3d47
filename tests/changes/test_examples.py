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


OWN_ACTION = "OWNER/insdvl-replay"


def read_yaml(path: Path) -> dict[str, Any]:
    """A file as a runner's YAML reader sees it."""
    return dict(YAML(typ="safe").load(path.read_text("utf-8")))


GITHUB = read_yaml(EXAMPLES / "ci" / "github.yml")
GITLAB = read_yaml(EXAMPLES / "ci" / "gitlab.yml")["dives"]
ACTION = read_yaml(EXAMPLES.parent / "action.yml")
JOBS = GITHUB["jobs"]
SHARDS = JOBS["check"]["strategy"]["matrix"]["shard"]


class Runner:
    """Runs the steps of a job as GitHub does, with programs on the path that stand for pip and GitHub's own.

    What other actions would do is kept in ``used``: their names, and what they are given.
    """

    def __init__(self, folder: Path, job: str, **context: str) -> None:
        self.folder = folder
        self.used: list[tuple[str, dict[str, str]]] = []
        self.done: dict[str, subprocess.CompletedProcess[str]] = {}
        self.context = {
            "github.job": job,
            "github.action_path": str(EXAMPLES.parent),
            "github.event_name": "pull_request",
            "github.event.pull_request.number": "7",
            "github.repository": "team/dives",
            "github.run_id": "41",
            "github.run_attempt": "1",
            "github.server_url": "https://git.example.org",
            "github.token": "secret",
            "steps.code.outputs.cache-hit": "",
            **context,
        }
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
        self.environment = os.environ | {
            "PATH": f"{tools}:{os.environ['PATH']}",
            "PYTHONPATH": str(EXAMPLES.parent),
            "GITHUB_STEP_SUMMARY": str(folder / "step.md"),
            "GITHUB_OUTPUT": str(folder / "output"),
        }

    def expanded(self, text: str) -> str:
        """A text with what its expressions stand for; one that is not known is an error."""
        return re.sub(r"\$\{\{ (.+?) \}\}", lambda found: self.context[found[1]], text)

    @property
    def failed(self) -> bool:
        return any(done.returncode for done in self.done.values())

    def wants(self, step: dict[str, Any]) -> bool:
        """Whether a step runs: after a failure, only one that always does."""
        condition = step.get("if", "")
        if condition == "always()":
            return True
        if self.failed or not condition:
            return not self.failed
        name, sign, value = condition.split(" ")
        is_equal = self.context[name] == value.strip("'")
        return is_equal == (sign == "==")

    def run(self, steps: list[dict[str, Any]]) -> None:
        for step in steps:
            if not self.wants(step):
                continue
            if "run" in step:
                self.run_shell(step)
                continue
            action = step["uses"].split("@")[0]
            given = {key: self.expanded(str(value)) for key, value in step.get("with", {}).items()}
            if action == OWN_ACTION:
                self.run_action(given)
            else:
                self.used.append((action, given))

    def run_action(self, given: dict[str, str]) -> None:
        """Run the action of this repository."""
        assert given.keys() <= ACTION["inputs"].keys()
        for name, described in ACTION["inputs"].items():
            self.context[f"inputs.{name}"] = given.get(name, described["default"])
        self.run(ACTION["runs"]["steps"])

    def run_shell(self, step: dict[str, Any]) -> None:
        output = self.folder / "output"
        output.write_text("")
        env = {name: self.expanded(value) for name, value in step.get("env", {}).items()}
        done = subprocess.run(
            ["bash", "-e", "-c", step["run"]],
            cwd=self.folder,
            env=self.environment | env,
            capture_output=True,
            text=True,
            check=False,
        )
        self.done[step["name"]] = done
        for line in output.read_text().splitlines():
            name, _, value = line.partition("=")
            self.context[f"steps.{step['id']}.outputs.{name}"] = value

    def given(self, action: str) -> list[dict[str, str]]:
        """What an action of others was given, each time."""
        return [given for name, given in self.used if name == action]


def checked(folder: Path, shard: str, **inputs: str) -> Runner:
    """Run the job of the example for one part of the dives."""
    runner = Runner(folder, "check", **{"matrix.shard": shard})
    steps = [dict(step) for step in JOBS["check"]["steps"]]
    for step in steps:
        if step["uses"].startswith(OWN_ACTION):
            step["with"] = {**step["with"], **inputs}
    runner.run(steps)
    return runner


def summaries(folder: Path, runner: Runner) -> str:
    """Put the pages of a job where the job of the comment finds them, and return the name of the artifact."""
    [pages] = runner.given("actions/upload-artifact")
    place = folder / "parts" / pages["name"]
    for pattern in pages["path"].splitlines():
        found = sorted(folder.glob(pattern))
        assert found, pattern
        for file in found:
            (place / file.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, place / file.relative_to(folder))
    return place.name


def commented(folder: Path) -> str:
    """Run the job of the comment, and return how it calls GitHub."""
    runner = Runner(folder, "comment")
    runner.run(JOBS["comment"]["steps"])
    assert not runner.failed, runner.done["comment"].stderr
    [download] = runner.given("actions/download-artifact")
    kept = sorted((folder / download["path"]).glob(download["pattern"]))
    assert kept == sorted((folder / "parts").iterdir())
    return (folder / "called").read_text().splitlines()[-1]


@pytest.mark.nightly
def test_the_job_of_a_part_runs_as_it_stands(archive: Path) -> None:
    """One of four dives: what is installed, the names of caches and pages, and the comment."""
    runner = checked(archive, "1/4")
    assert not runner.failed, [step.stderr for step in runner.done.values()]
    assert list(runner.done) == ["install", "names", "compile", "check"]
    assert "pip install --require-hashes" in (archive / "called").read_text()
    assert re.search(r"8 gates on 1 dive: \d+ passed", runner.done["check"].stdout)
    assert summaries(archive, runner) == "insdvl-replay-check-1-of-4"
    code, results = runner.given("actions/cache/restore")
    assert re.fullmatch(
        r"insdvl-replay-compiled-[0-9a-f]+-numba-[\w.]+-cpython-3\d+-[\w-]+", code["key"]
    )
    assert results["key"] == "insdvl-replay-results-check-1-of-4-41-1"
    assert results["restore-keys"] == "insdvl-replay-results-check-1-of-4-"
    call = commented(archive)
    assert call == "gh pr comment 7 --body-file summary.md --edit-last --create-if-none"
    said = (archive / "summary.md").read_text()
    assert "position stays near the reference" in said
    assert "(https://git.example.org/team/dives/actions/runs/41)" in said
    assert JOBS["comment"]["steps"][-1]["continue-on-error"] is True, (
        "a fork's token may not write"
    )


@pytest.mark.nightly
def test_the_jobs_run_green_and_red(archive: Path) -> None:
    green = [checked(archive, shard) for shard in SHARDS]
    assert not [
        step.stderr for runner in green for step in runner.done.values() if step.returncode
    ]
    gates = (archive / "gates.toml").read_text()
    (archive / "gates.toml").write_text(gates.replace("max = 0.5", "max = 0.0001"))
    names = []
    for shard in SHARDS:
        red = checked(archive, shard)
        codes = {name: step.returncode for name, step in red.done.items()}
        assert codes == {"install": 0, "names": 0, "compile": 0, "check": 1}
        assert "::error" in red.done["check"].stdout
        names.append(summaries(archive, red))
    assert names == ["insdvl-replay-check-1-of-2", "insdvl-replay-check-2-of-2"]
    commented(archive)
    said = (archive / "summary.md").read_text()
    assert said.count("position stays near the reference") >= 2
    assert "position stays near the reference" in (archive / "step.md").read_text()
    assert (archive / "checked" / "transit" / "report.html").is_file(), "what is kept as a page"


@pytest.mark.nightly
def test_the_job_of_gitlab_runs_green_and_red(archive: Path) -> None:
    runner = Runner(archive, "dives")
    part = {"CI_NODE_INDEX": "1", "CI_NODE_TOTAL": str(GITLAB["parallel"])}
    runner.environment |= part | {"INSDVL_REPLAY": GITLAB["variables"]["INSDVL_REPLAY"]}
    steps = [{"name": line, "run": line} for line in GITLAB["script"]]
    runner.run(steps)
    assert not runner.failed, [step.stderr for step in runner.done.values()]
    assert (
        f"pip install {GITLAB['variables']['INSDVL_REPLAY']}" in (archive / "called").read_text()
    )
    gates = (archive / "gates.toml").read_text()
    (archive / "gates.toml").write_text(gates.replace("max = 0.5", "max = 0.0001"))
    runner.run(steps)
    assert [step.returncode for step in runner.done.values()] == [0, 1], "the check alone fails"
    assert "<failure" in (archive / "gates.xml").read_text()
    for pattern in GITLAB["artifacts"]["paths"]:
        assert list(archive.glob(pattern)), pattern


@pytest.mark.nightly
def test_options_of_the_action_are_split_like_a_shells_and_run_nothing(archive: Path) -> None:
    pwned = checked(archive, "1/2", options="--only 'position*' '$(touch pwned)'").done["check"]
    assert not (archive / "pwned").exists()
    assert "$(touch pwned): " in pwned.stderr + pwned.stdout, "it is a dive that does not exist"
    done = checked(archive, "1/2", options="--only 'position*'").done["check"]
    assert "2 gates on 2 dives: 4 " in done.stdout
    for hostile in ("1/2\ncode=x", "$(touch pwned)", "1/2; touch pwned"):
        runner = checked(archive, hostile)
        assert runner.done["check"].returncode == 2
        assert re.fullmatch(r"[A-Za-z0-9-]+", runner.context["steps.names.outputs.part"])
    assert not (archive / "pwned").exists()


def test_red_nights_keep_their_cache_and_their_pages() -> None:
    steps = ACTION["runs"]["steps"]
    used = [step["uses"].split("@")[0] for step in steps if "uses" in step]
    assert "actions/cache" not in used, "one step for both saves nothing when the job fails"
    named = {step["name"]: step for step in steps}
    for what in ("code", "results"):
        restored, saved = (named[f"{how} {what}"]["with"] for how in ("restore", "save"))
        assert (restored["path"], restored["key"]) == (saved["path"], saved["key"])
    for name in ("save results", "pages"):
        assert named[name]["if"] == "always()"
    order = list(named)
    assert order.index("save code") < order.index("check") < order.index("save results")
    assert GITLAB["cache"]["when"] == GITLAB["artifacts"]["when"] == "always"
    assert GITLAB["timeout"]
    assert JOBS["check"]["timeout-minutes"] <= 60


def test_everything_that_is_used_is_pinned() -> None:
    for path in (EXAMPLES / "ci" / "github.yml", EXAMPLES.parent / "action.yml"):
        text = path.read_text("utf-8")
        used = re.findall(r"uses: (\S+)@(\S+)(?: # (v\d+\.\d+\.\d+))?\n", text)
        assert len(used) == text.count("uses: ")
        for action, digest, version in used:
            if action == OWN_ACTION:
                assert re.fullmatch(r"v\d+\.\d+\.\d+", digest)
            else:
                assert re.fullmatch(r"[0-9a-f]{40}", digest), action
                assert version
    assert re.search(r"@v\d+\.\d+\.\d+$", GITLAB["variables"]["INSDVL_REPLAY"])


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
