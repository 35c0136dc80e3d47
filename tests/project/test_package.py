"""The package as it is installed: what a wheel holds."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import index_readme
import pytest
from ruamel.yaml import YAML

PROJECT = Path(__file__).resolve().parents[2]


def test_wheel_holds_types_presets_and_message_definitions(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(tmp_path),
        str(PROJECT),
    ]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    messages = (PROJECT / "schemas" / "insdvl_msgs" / "msg").glob("*.msg")
    definitions = (PROJECT / "insdvl_replay" / "logs" / "definitions").rglob("*.msg")
    wanted = {
        "insdvl_replay/py.typed",
        "insdvl_replay/presets/fog.toml",
        "insdvl_replay/core/notes.toml",
    }
    wanted |= {"insdvl_replay/document/page.css"}
    wanted |= {f"insdvl_replay/schemas/insdvl_msgs/msg/{path.name}" for path in messages}
    wanted |= {path.relative_to(PROJECT).as_posix() for path in definitions}
    assert wanted <= names
    assert [name for name in names if name.endswith(".dist-info/licenses/THIRD_PARTY.md")]
    assert not [name for name in names if name.startswith("tests/")]
    (described,) = (name for name in names if name.endswith("/METADATA"))
    text = zipfile.ZipFile(wheel).read(described).decode()
    assert "# insdvl-replay" in text
    # No link of the README leads to a file that an index lacks.
    assert not re.findall(r"\]\((?![a-z]+:|#)", text)


def test_links_of_the_readme_lead_to_the_repository_from_an_index() -> None:
    page = "[a](docs/a.md#b) [c](https://c.example) [d](#d) ![e](docs/e.svg)"
    there = "https://git.example.org/x"
    linked = f"[a]({there}/blob/HEAD/docs/a.md#b) [c](https://c.example) [d](#d) ![e]({there}/raw/HEAD/docs/e.svg)"
    assert index_readme.for_index(page, there) == linked
    assert index_readme.for_index(page, "") == "a [c](https://c.example) [d](#d) "


def test_classifiers_are_those_of_the_index() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    known = pytest.importorskip("trove_classifiers", reason="needs trove-classifiers").classifiers
    assert set(project["classifiers"]) <= set(known)


def test_the_pre_commit_hook_is_a_command_of_the_program() -> None:
    (hook,) = YAML(typ="safe").load((PROJECT / ".pre-commit-hooks.yaml").read_text("utf-8"))
    assert (hook["id"], hook["entry"]) == ("check", "insdvl-replay check")
    assert hook["pass_filenames"] is False


def test_no_module_is_named_like_one_of_the_standard_library() -> None:
    names = {path.stem for path in (PROJECT / "insdvl_replay").rglob("*.py")}
    assert not (names - {"__future__", "__main__"}) & sys.stdlib_module_names


@pytest.mark.nightly
def test_scripts_call_the_package_as_it_is(tmp_path: Path) -> None:
    """No test runs every benchmark, so a renamed function would be missed."""
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--config-file",
        os.devnull,
        "--cache-dir",
        str(tmp_path),
    ]
    command += ["--check-untyped-defs", "--ignore-missing-imports", "benchmarks", "docs/generate"]
    env = {**os.environ, "MYPYPATH": "tests:benchmarks:docs/generate"}
    done = subprocess.run(
        command, cwd=PROJECT, env=env, capture_output=True, text=True, check=False
    )
    assert "source files" in done.stdout, done.stderr
    found = [
        line
        for line in done.stdout.splitlines()
        if line.endswith(("[attr-defined]", "[call-arg]", "[name-defined]"))
    ]
    # numba's stubs lack a module that it has; a starred map has as many parts as it needs
    known = ("_nrt_python", 'Too many arguments for "MeanSquares"')
    assert [line for line in found if not any(text in line for text in known)] == []
