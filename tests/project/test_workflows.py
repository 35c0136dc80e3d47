"""The project's own jobs: their files are what the published schemas ask for, and each calls what runs here, too."""

import json
import re
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
import sbom
from ruamel.yaml import YAML

jsonschema = pytest.importorskip("jsonschema", reason="needs check-jsonschema")
pytest.importorskip("check_jsonschema", reason="needs check-jsonschema")

PROJECT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((PROJECT / ".github" / "workflows").glob("*.yml"))
FORMS = [
    path
    for path in sorted((PROJECT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
    if path.name != "config.yml"
]
FILES = {
    "github-workflows": [*WORKFLOWS, PROJECT / "examples" / "ci" / "github.yml"],
    "github-actions": [PROJECT / "action.yml"],
    "github-issue-forms": FORMS,
    "github-issue-config": [PROJECT / ".github" / "ISSUE_TEMPLATE" / "config.yml"],
    "gitlab-ci": [PROJECT / "examples" / "ci" / "gitlab.yml"],
}
"""Files by the name of their schema, as SchemaStore has it; check-jsonschema brings these along."""


def read_yaml(path: Path) -> Any:
    return YAML(typ="safe").load(path.read_text("utf-8"))


def validator(name: str) -> Any:
    vendored = resources.files("check_jsonschema").joinpath("builtin_schemas", "vendor")
    schema = json.loads(vendored.joinpath(f"{name}.json").read_text("utf-8"))
    return jsonschema.validators.validator_for(schema)(schema)


def steps_of(workflow: dict[str, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


@pytest.mark.parametrize("schema", FILES)
def test_files_are_what_their_schema_asks_for(schema: str) -> None:
    checker = validator(schema)
    assert FILES[schema]
    for path in FILES[schema]:
        content = read_yaml(path)
        assert [error.message for error in checker.iter_errors(content)] == [], path.name
    content["no such key"] = {}
    content["jobs"] = content["body"] = content["runs"] = content["contact_links"] = 3
    content["stages"] = 3
    assert list(checker.iter_errors(content)), "the schema refuses nothing"


def test_each_job_calls_a_target_of_the_makefile() -> None:
    targets = re.findall(r"^([\w-]+):", (PROJECT / "Makefile").read_text("utf-8"), re.MULTILINE)
    called = []
    for path in WORKFLOWS:
        workflow = read_yaml(path)
        assert workflow["permissions"] == {"contents": "read"}
        for job in workflow["jobs"].values():
            assert job["timeout-minutes"] <= 90
        for step in steps_of(workflow):
            word, _, target = step.get("run", "").partition(" ")
            if word == "make":
                called.append(target)
                assert target in targets
            else:
                assert "run" not in step or step["run"].startswith("cat build/"), step
    assert sorted(called) == ["coverage", "dist", "lowest", "test"]
    [hooks] = read_yaml(PROJECT / ".pre-commit-config.yaml")["repos"]
    [hook] = hooks["hooks"]
    assert hook["entry"].removeprefix("make ") in targets


def test_what_jobs_use_is_pinned_and_runs_on_what_is_promised() -> None:
    for path in WORKFLOWS:
        text = path.read_text("utf-8")
        used = re.findall(r"uses: [\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+\n", text)
        assert len(used) == text.count("uses: ")
    matrix = read_yaml(WORKFLOWS[-1])["jobs"]["test"]["strategy"]["matrix"]
    assert [name.partition("-")[0] for name in matrix["os"]] == ["ubuntu", "macos"]
    project = (PROJECT / "pyproject.toml").read_text("utf-8")
    tested = set(matrix["python"])
    assert set(re.findall(r"Python :: (3\.\d+)", project)) <= tested
    assert min(tested) == re.findall(r'requires-python = ">=(.*)"', project)[0]


def test_a_release_publishes_what_was_attested() -> None:
    workflow = read_yaml(PROJECT / ".github" / "workflows" / "release.yml")
    build, publish = (workflow["jobs"][name] for name in ("build", "publish"))
    attested = [step["with"]["subject-path"] for step in build["steps"] if "attest" in str(step)]
    assert attested == ["dist/*"] * 2
    assert publish["permissions"] == {"id-token": "write"}
    assert "password" not in str(publish), "trusted publishing"
    kept = [step["with"] for step in build["steps"] if "upload-artifact" in step.get("uses", "")]
    taken = [step["with"] for step in publish["steps"] if "with" in step]
    assert [one["name"] for one in kept] == [one["name"] for one in taken] == ["dist"]


def test_the_list_of_packages_is_that_of_the_lock(tmp_path: Path) -> None:
    file = tmp_path / "build" / "sbom.cdx.json"
    command = [sys.executable, str(Path(sbom.__file__)), str(file)]
    subprocess.run(command, check=True, cwd=tmp_path)
    written = json.loads(file.read_text("utf-8"))
    assert (written["bomFormat"], written["specVersion"]) == ("CycloneDX", "1.6")
    lock = (PROJECT / "requirements.lock").read_text("utf-8")
    pins = re.findall(r"^([\w.-]+)==(\S+)", lock, re.MULTILINE)
    assert [(one["name"], one["version"]) for one in written["components"]] == pins
    digests = [
        digest["content"]
        for one in written["components"]
        for file_ in one["externalReferences"]
        for digest in file_["hashes"]
    ]
    assert digests == re.findall(r"--hash=sha256:(\w+)", lock)
    assert written["dependencies"][0]["dependsOn"] == [
        one["purl"] for one in written["components"]
    ]


@pytest.mark.nightly
def test_a_release_is_built_here(tmp_path: Path) -> None:
    """Source and wheel, and the wheel that is built of the source is the same."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path, PROJECT]
    subprocess.run(command, check=True, capture_output=True)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".gz", ".whl"]


@pytest.mark.nightly
def test_coverage_is_measured(tmp_path: Path) -> None:
    """Also in the workers of pytest, and in processes that tests start."""
    data = f"--data-file={tmp_path}/coverage"
    words = [sys.executable, "-m", "coverage"]
    tests = ["tests/core/test_extras.py", "tests/core/test_interrupts.py"]
    tests = [test for test in tests if (PROJECT / test).is_file()]
    plain = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--numprocesses", "2", *tests]
    subprocess.run([*words, "run", data, *plain], cwd=PROJECT, check=True, capture_output=True)
    subprocess.run([*words, "combine", "--quiet", data], cwd=PROJECT, check=True)
    report = [*words, "json", data, "-o", str(tmp_path / "report.json"), "--quiet"]
    subprocess.run(report, cwd=PROJECT, check=True)
    files = json.loads((tmp_path / "report.json").read_text("utf-8"))["files"]
    assert files["insdvl_replay/core/extras.py"]["summary"]["percent_covered"] > 90.0
