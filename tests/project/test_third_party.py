"""Each definition of others that comes with the program has its line in THIRD_PARTY.md."""

import re
from pathlib import Path

import pytest

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.topics import TYPES
from insdvl_replay.logs.formats.definitions import definition_text

ROOT = Path(__file__).parents[2]
DEFINITIONS = ROOT / "insdvl_replay" / "logs" / "definitions"
SHIPPED, LEFT_OUT = (ROOT / "THIRD_PARTY.md").read_text("utf-8").split("## Left out\n")


def rows(text: str) -> list[list[str]]:
    """Read the rows of a table whose first cell is a package."""
    return [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| `")]


def test_each_definition_has_its_line() -> None:
    listed = [
        f"{package.strip('`')}/{name}"
        for package, names, *_ in rows(SHIPPED)
        for name in names.split(", ")
    ]
    there = [f"{path.parts[-3]}/{path.stem}" for path in DEFINITIONS.glob("*/msg/*.msg")]
    assert sorted(listed) == sorted(there)
    assert len(there) == len(list(DEFINITIONS.rglob("*.msg")))


def test_each_line_has_repository_commit_and_licence() -> None:
    for _, _, repository, commit, licence in rows(SHIPPED):
        assert re.fullmatch(r"[\w-]+/[\w-]+|not found.*", repository)
        assert re.fullmatch(r"`[0-9a-f]{40}`|not found", commit)
        assert re.match(r"Apache-2\.0$|BSD(-3-Clause)?$|MIT$|not (stated|found)", licence)


@pytest.mark.parametrize("package", [row[0].strip("`") for row in rows(LEFT_OUT)])
def test_what_is_left_out_is_known_by_the_definitions_of_logs_alone(package: str) -> None:
    known = [name for group in TYPES.values() for name in group if name.startswith(f"{package}/")]
    assert known
    for name in known:
        with pytest.raises(LogError, match="no definition of this type comes with the tool"):
            definition_text(name)
