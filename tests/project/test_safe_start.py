"""Files beside the dives are never imported: by the image, the action, ``python -m`` and worker processes."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
STRANGE = "import pathlib, sys; pathlib.Path(__file__).with_suffix('.ran').touch(); sys.exit('a strange module ran')"
ACTION: dict[str, Any] = YAML(typ="safe").load((ROOT / "action.yml").read_text("utf-8"))
NEW_WORKERS = """
from insdvl_replay.batch.workers import do_each, local_pool
if __name__ == "__main__":
    print(sorted(result for _, result in do_each(abs, [-1, -2], local_pool(2))))
"""


@pytest.fixture
def dives(tmp_path: Path) -> Path:
    """A folder of dives, with modules named like those that the program, or Python for it, imports."""
    folder = tmp_path / "dives"
    (folder / "insdvl_replay").mkdir(parents=True)
    (folder / "insdvl_replay" / "__init__.py").write_text("")
    names = (
        "typer",
        "numpy",
        "pickle",
        "shlex",
        "selectors",
        "multiprocessing",
        "insdvl_replay/__main__",
    )
    for name in names:
        (folder / f"{name}.py").write_text(STRANGE)
    return folder


def environment(**more: str) -> dict[str, str]:
    """The environment without what this test process was told of paths."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "PYTHONSAFEPATH")
    }
    return kept | more


def image() -> tuple[dict[str, str], list[str], str]:
    """Read from the Dockerfile what its program is started with: variables, words, and by whom."""
    text = (ROOT / "examples" / "ci" / "Dockerfile").read_text("utf-8").replace("\\\n", " ")
    lines = [line.partition(" ") for line in text.splitlines()]
    variables = [
        word.split("=", 1)
        for name, _, rest in lines
        if name == "ENV"
        for word in shlex.split(rest)
    ]
    (entry,) = re.findall(r"^ENTRYPOINT (.+)", text, re.MULTILINE)
    (user,) = re.findall(r"^USER (.+)", text, re.MULTILINE)
    found = {name: value.replace("/opt/insdvl-replay", str(ROOT)) for name, value in variables}
    return found, YAML(typ="safe").load(entry), user


def ran(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob("*.ran")]


def test_the_image_imports_nothing_of_the_folder_of_the_dives(dives: Path, tmp_path: Path) -> None:
    variables, words, user = image()
    assert user != "root"
    assert variables["PYTHONSAFEPATH"] == "1"  # for each Python that is started in it
    variables["INSDVL_REPLAY_CACHE"] = str(tmp_path)
    command = [sys.executable, *words[1:], "check", "gates.toml"]
    done = subprocess.run(
        command, cwd=dives, env=environment(**variables), capture_output=True, text=True
    )
    assert (done.returncode, ran(dives)) == (2, []), done.stderr
    assert "gates.toml" in done.stderr


def test_the_action_imports_nothing_of_the_folder_of_the_dives(
    dives: Path, tmp_path: Path
) -> None:
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("python", "pip"):
        body = f'exec {sys.executable} "$@"' if name == "python" else "exit 0"
        (tools / name).write_text(f"#!/bin/sh\n{body}\n")
        (tools / name).chmod(0o755)
    given = {
        "PATH": f"{tools}:{os.environ['PATH']}",
        "SOURCE": str(ROOT),
        "GATES": "gates.toml",
        "JOBS": "2",
        "SHARD": "1/1",
        "GITHUB_OUTPUT": str(tmp_path / "output"),
    }
    given |= {"OPTIONS": "--only 'x y'", "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md")}
    steps = {step["name"]: step for step in ACTION["runs"]["steps"] if "run" in step}
    assert all(step["env"]["PYTHONSAFEPATH"] == "1" for step in steps.values())
    env = environment(**given, PYTHONSAFEPATH="1")
    for name, code in (("names", 0), ("check", 2)):
        command = ["bash", "-e", "-c", steps[name]["run"]]
        done = subprocess.run(command, cwd=dives, env=env, capture_output=True, text=True)
        assert (done.returncode, ran(dives)) == (code, []), done.stderr
    assert "gates.toml" in done.stderr


def test_a_module_of_the_program_imports_nothing_of_the_folder_of_the_dives(dives: Path) -> None:
    """Without ``-P``, Python itself looks there for the program; what the program imports is not looked for there."""
    for name in ("insdvl_replay/__main__.py", "insdvl_replay/__init__.py"):
        (dives / name).unlink()
    (dives / "insdvl_replay").rmdir()
    command = [sys.executable, "-m", "insdvl_replay", "config", "--help"]
    done = subprocess.run(
        command, cwd=dives, env=environment(PYTHONPATH=str(ROOT)), capture_output=True, text=True
    )
    assert (done.returncode, ran(dives)) == (0, []), done.stderr


def test_workers_import_nothing_of_the_folder_of_the_dives(dives: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(NEW_WORKERS)
    command = [sys.executable, str(script)]
    done = subprocess.run(
        command, cwd=dives, env=environment(PYTHONPATH=str(ROOT)), capture_output=True, text=True
    )
    assert (done.stdout, ran(dives)) == ("[1, 2]\n", []), done.stderr
