"""What is installed is pinned: packages by version and digest, the steps of the example job by commit."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")


def plain(name: str) -> str:
    """Write a package's name as the index does."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins() -> dict[str, str]:
    """Read constraints.txt."""
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    return {plain(name): version for name, _, version in (line.partition("==") for line in lines) if version}


def locked() -> dict[str, tuple[str, list[str]]]:
    """Read the lock: version and digests by name."""
    text = (ROOT / "requirements.lock").read_text("utf-8").replace("\\\n", " ")
    found = {}
    for line in text.splitlines():
        if not line.startswith("#"):
            pin, *_ = line.split()
            name, _, version = pin.partition("==")
            found[name] = (version, HASH.findall(line))
    return found


def test_the_lock_has_the_versions_that_are_tested_with() -> None:
    expected = pins()
    assert {name: version for name, (version, _) in locked().items()} == {name: expected[name] for name in locked()}


def test_the_lock_has_all_that_the_program_needs_each_with_digests() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed = {plain(re.split(r"[\[<>=!~ ;]", one)[0]) for one in project["dependencies"]}
    assert needed <= locked().keys()
    assert all(digests for _, digests in locked().values())


def test_the_steps_of_the_example_job_are_pinned_by_commit() -> None:
    job = (ROOT / "examples" / "ci" / "github.yml").read_text("utf-8")
    used = re.findall(r"uses: (.+)", job)
    assert used
    assert all(re.fullmatch(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", one) for one in used)
