"""What is installed is pinned: packages by version and digest, the steps of the example job by commit."""

import re
import tomllib
from importlib import import_module
from io import BytesIO
from pathlib import Path

import pytest
from lowest import lowest
from mcap.writer import Writer

ROOT = Path(__file__).parents[2]
# What the program uses of packages beyond their documented names; `make lowest` tries the lowest versions.
PRIVATE = {
    "numba.core.caching": ("CompileResultCacheImpl", "FunctionCache", "UserProvidedCacheLocator"),
    "mcap.writer": ("Writer",),
}
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")


def plain(name: str) -> str:
    """Write a package's name as the index does."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins() -> dict[str, str]:
    """Read constraints.txt."""
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    return {
        plain(name): version
        for name, _, version in (line.partition("==") for line in lines)
        if version
    }


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
    assert {name: version for name, (version, _) in locked().items()} == {
        name: expected[name] for name in locked()
    }


def test_the_lock_has_all_that_the_program_needs_each_with_digests() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    needed = {plain(re.split(r"[\[<>=!~ ;]", one)[0]) for one in project["dependencies"]}
    assert needed <= locked().keys()
    assert all(digests for _, digests in locked().values())


@pytest.mark.parametrize("file", ["action.yml", "examples/ci/Dockerfile"])
def test_what_installs_takes_packages_by_their_digests_alone(file: str) -> None:
    text = (ROOT / file).read_text("utf-8")
    installs = re.findall(r"pip install .*", text)
    assert len(installs) == 1
    assert re.search(
        r"pip install --require-hashes --only-binary :all: -r \S*requirements\.lock", installs[0]
    )


def test_the_base_image_can_be_pinned_by_digest() -> None:
    text = (ROOT / "examples" / "ci" / "Dockerfile").read_text("utf-8")
    assert re.findall(r"^FROM (.+)", text, re.MULTILINE) == ["${BASE}"]
    assert "--build-arg BASE=python:3.12-slim@sha256:" in text


def test_private_parts_of_packages_are_there() -> None:
    for module, names in PRIVATE.items():
        assert not [name for name in names if not hasattr(import_module(module), name)]
    assert callable(Writer.flush)
    assert {"_Writer__chunk_builder", "_Writer__statistics"} <= vars(Writer(BytesIO())).keys()


def test_each_requirement_has_a_lowest_version_that_is_tried() -> None:
    assert all(re.fullmatch(r"[\w-]+==\d+(\.\d+)*", one) for one in lowest())
