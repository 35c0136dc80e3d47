"""Files stand on each other in one direction, by all imports: also those in functions, and those for types alone."""

import ast
import tomllib
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = "insdvl_replay"
MOST_FLOORS = 10
PAGE = ".__init__"  # ends the name of the page of a package


def read_sources(root: Path, package: str) -> dict[str, str]:
    """Read the source of every module below a folder, by its dotted name."""
    sources = {}
    for path in sorted((root / package).rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        sources[name] = path.read_text("utf-8")
    return sources


def imported_names(module: str, source: str) -> Iterator[str]:
    """Yield what a module imports by dotted names, each of which is a module or something in one."""
    package = module.rpartition(".")[0]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            place = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                yield f"{place}.{alias.name}"


def module_of(name: str, modules: Mapping[str, str]) -> str | None:
    """Return the module that a dotted name means or that holds it; None if it is of another package."""
    place = name
    while place:
        for module in (place, place + PAGE):
            if module in modules:
                return module
        place = place.rpartition(".")[0]
    return None


def find_circle(sources: Mapping[str, str]) -> list[str]:
    """Return modules of which each imports the next, the first again at the end; none if there is no circle."""
    arrows: dict[str, set[str]] = {}
    for module, source in sources.items():
        arrows[module] = set()
        for name in imported_names(module, source):
            target = module_of(name, sources)
            if target is not None:
                arrows[module].add(target)
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []


def test_no_files_stand_in_a_circle() -> None:
    sources = read_sources(ROOT, PACKAGE)
    assert f"{PACKAGE}.core.version" in sources
    assert find_circle(sources) == []


@pytest.mark.parametrize(
    "back",
    [
        "from tool.low import name",
        "from tool import low",
        "import tool.low",
        "from . import low",
        "from .low import name as other",
        "def asked():\n    from tool.low import name",
        "if TYPE_CHECKING:\n    from tool.low import name",
    ],
)
def test_a_way_back_is_found(back: str) -> None:
    sources = {
        "tool.__init__": "from tool.high import name",
        "tool.high": back,
        "tool.low": "import os\nfrom tool.high import name",
    }
    circle = find_circle(sources)
    assert circle[0] == circle[-1]
    assert set(circle) == {"tool.high", "tool.low"}


def test_the_page_of_a_package_may_be_in_a_circle() -> None:
    sources = {"tool.__init__": "from tool.high import name", "tool.high": "import tool"}
    assert set(find_circle(sources)) == {"tool.__init__", "tool.high"}


def test_a_module_may_be_imported_from_above_alone() -> None:
    sources = {
        "tool.__init__": "",
        "tool.high": "import numpy.linalg\nfrom tool.low import name",
        "tool.low": "from pathlib import Path",
    }
    assert find_circle(sources) == []


def test_floors_are_few_and_without_exceptions() -> None:
    rules = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    floors = rules["contracts"][0]
    assert floors["type"] == "layers"
    assert floors["exhaustive"]
    assert len(floors["layers"]) <= MOST_FLOORS
    assert not any("ignore_imports" in contract for contract in rules["contracts"])
