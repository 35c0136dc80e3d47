"""The documents are tested like code: what they name exists, and what they claim is so."""

import ast
import importlib
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import site_pages as site
import typer.main
from ruamel.yaml import YAML

import insdvl_replay
from insdvl_replay import __version__, nav, preparation
from insdvl_replay.cli.app import app

PROJECT = Path(__file__).resolve().parents[2]
CHAPTERS = sorted(
    f"docs/equations/{path.name}" for path in (PROJECT / "docs" / "equations").glob("*.md")
)
PAGES = sorted(f"docs/{path.name}" for path in (PROJECT / "docs").glob("*.md"))
DOCUMENTS = ("README.md", *PAGES, *CHAPTERS, "CONTRIBUTING.md", "CHANGELOG.md")
WIDTH = 140
LEFT_BEHIND = {"build", "dist", "replay", "checked", "__pycache__", "node_modules"}


def text_of(name: str) -> str:
    return (PROJECT / name).read_text("utf-8")


def project_files() -> Iterator[Path]:
    """Every file of the project, without what tools leave behind."""
    for folder, below, files in os.walk(PROJECT):
        below[:] = [
            name
            for name in below
            if name == ".ci" or (not name.startswith(".") and name not in LEFT_BEHIND)
        ]
        yield from (Path(folder, name) for name in files if name != ".git")  # a file in a worktree


# --- The chapters of docs/equations/.


class Entry(NamedTuple):
    """One equation."""

    id: str
    equation: str
    status: str
    source: str
    functions: tuple[str, ...]
    tests: tuple[str, ...]
    note: str


FORM = re.compile(
    r"(?P<id>\S+)\n\n(?P<equation>.+?)\n\n- (?P<status>as printed|corrected|derived|not used): (?P<source>.+?)\n"
    r"(?:- function: (?P<functions>.+?)\n- test: (?P<tests>.+?)\n)?(?:\n(?P<note>.*))?",
    re.DOTALL,
)


def equations() -> list[Entry]:
    """Read all equations of all chapters: a heading of the third level, and what follows it."""
    entries = []
    for chapter in CHAPTERS:
        for text in re.split(r"^### ", text_of(chapter), flags=re.MULTILINE)[1:]:
            found = FORM.fullmatch(re.split(r"^## ", text, maxsplit=1, flags=re.MULTILINE)[0])
            assert found, f"{chapter}: {text.splitlines()[0]} has not the form of the others"
            part = {name: value or "" for name, value in found.groupdict().items()}
            part["source"] = re.sub(
                r"\[([^]]+)\]\([^)]+\)", r"\1", " ".join(part["source"].split())
            )
            functions, tests = code_words(part.pop("functions")), code_words(part.pop("tests"))
            entries.append(Entry(**part, functions=functions, tests=tests))
    return entries


def code_words(cell: str) -> tuple[str, ...]:
    return tuple(re.findall(r"`([^`]+)`", cell))


@cache
def names_of_tests(file: str) -> set[str]:
    (found,) = (PROJECT / "tests").rglob(file)
    tree = ast.parse(found.read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def resolve(name: str) -> Any:
    """Find a dotted name below the package: as many modules as there are, then attributes."""
    found: Any = importlib.import_module("insdvl_replay")
    for part in name.split("."):
        if not hasattr(found, part):
            importlib.import_module(f"{found.__name__}.{part}")
        found = getattr(found, part)
    return found


def test_every_equation_has_a_name_of_its_own() -> None:
    ids = [entry.id for entry in equations()]
    assert len(ids) > 60
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("entry", equations(), ids=lambda entry: entry.id)
def test_equation_has_a_function_and_a_test(entry: Entry) -> None:
    if entry.status == "not used":
        assert not entry.functions
        assert not entry.tests
        return
    assert entry.functions
    assert entry.tests
    for function in entry.functions:
        assert callable(resolve(function)), function
    for test in entry.tests:
        file, name = test.split("::")
        assert name in names_of_tests(file), test


def test_what_is_corrected_or_not_used_is_explained() -> None:
    to_explain = [entry for entry in equations() if entry.status in {"corrected", "not used"}]
    assert [entry.id for entry in to_explain if not entry.note.strip()] == []


def test_derived_equations_name_what_they_follow_from() -> None:
    entries = equations()
    ids = {entry.id for entry in entries}
    for entry in entries:
        if entry.status == "derived":
            assert set(entry.source.split(", ")) <= ids, entry


def test_every_numbered_equation_of_the_paper_has_an_entry(paper: Path) -> None:
    printed = (paper / "paper.tex").read_text("utf-8").count(r"\begin{equation}")
    named = {
        int(number)
        for entry in equations()
        for numbers in re.findall(r"L&K ((?:\(\d+\)(?:, )?)+)", entry.source)
        for number in re.findall(r"\d+", numbers)
    }
    assert named == set(range(1, printed + 1))


def test_every_module_of_the_mathematics_has_an_equation() -> None:
    rooms = (nav, preparation)
    found = [
        module.name
        for room in rooms
        for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}.")
    ]
    modules = {name.removeprefix("insdvl_replay.") for name in found}
    # They hand a dive from step to step, settings, gaps, readings and states to the mathematics, a start to the filter,
    # results to the history.
    without = {
        "preparation.replay",
        "preparation.plugins",
        "preparation.filters",
        "preparation.solutions",
        "preparation.candidates",
        "preparation.solution_check",
        "preparation.solution_files",
        "preparation.programs",
        "preparation.user_process",
        "preparation.user_runs",
        "nav.user_candidate",
        "nav.user_measurement",
    }
    named = {
        ".".join(function.split(".")[:2]) for entry in equations() for function in entry.functions
    }
    assert modules - without == {
        name for name in named if name.startswith(("nav.", "preparation."))
    }


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_no_line_of_the_equations_is_wide(chapter: str) -> None:
    wide = [
        number for number, line in enumerate(text_of(chapter).splitlines(), 1) if len(line) > WIDTH
    ]
    assert wide == []


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_headings_of_a_chapter_have_anchors_of_their_own(chapter: str) -> None:
    headings = re.findall(r"^#+ (.+)$", text_of(chapter), re.MULTILINE)
    assert len(anchors(PROJECT / chapter)) == len(headings)


def test_every_chapter_is_in_the_table_of_contents() -> None:
    linked = re.findall(
        r"^\| \[.+\]\((.+)\) \|", text_of("docs/equations/README.md"), re.MULTILINE
    )
    assert sorted(["README.md", *linked]) == [Path(chapter).name for chapter in CHAPTERS]


def test_tests_named_in_the_text_exist() -> None:
    for document in DOCUMENTS:
        for file, name in re.findall(r"`(test_\w+\.py)::(\w+)`", text_of(document)):
            assert name in names_of_tests(file), (document, name)


# --- README.md and CONTRIBUTING.md: commands, options, exit codes.


def commands() -> dict[str, set[str]]:
    """Options by command, as the program knows them."""
    return dict(_commands("", typer.main.get_command(app)))


def _commands(name: str, command: Any) -> Iterator[tuple[str, set[str]]]:
    """Give a command with its options, and those below it."""
    yield (
        name,
        {"--help"}
        | {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
        },
    )
    for below, child in getattr(command, "commands", {}).items():
        yield from _commands(f"{name} {below}".strip(), child)


def code_of(document: str) -> list[str]:
    """Lines of fenced blocks, continuations joined, and code words in the text."""
    text = text_of(document)
    fenced = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = "\n".join(fenced).replace("\\\n", " ").splitlines()
    return lines + re.findall(
        r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    )


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_and_options_exist(document: str) -> None:
    known = commands()
    for line in code_of(document):
        for call in re.findall(r"\binsdvl-replay((?:[ ]+[^#|&;`]+)?)", line):
            command, *words = call.split() or [""]
            if command.startswith("-"):
                command, words = "", [command, *words]
            if words and f"{command} {words[0]}" in known:
                command = f"{command} {words[0]}"
            assert command in known, f"insdvl-replay{call}"
            options = {word.split("=")[0] for word in words if re.match(r"--?[a-z]", word)}
            assert options <= known[command], f"insdvl-replay{call}"
    alone = {
        word.split("=")[0]
        for line in code_of(document)
        for word in re.findall(r"^--[a-z][\w=-]*", line)
    }
    assert alone <= set().union(*known.values())


def test_every_command_is_in_the_readme() -> None:
    text = text_of("README.md")
    assert {name for name in commands() if f"insdvl-replay {name}" not in text} == set()


def test_readme_is_read_in_a_minute() -> None:
    assert len(text_of("README.md").splitlines()) <= 130


@pytest.mark.parametrize("document", ["README.md", *PAGES])
def test_python_in_the_pages_names_what_there_is(document: str) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", text_of(document), re.MULTILINE | re.DOTALL)
    for block in blocks:
        tree = ast.parse(block)
        for node in (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)):
            module = importlib.import_module(str(node.module))
            assert all(hasattr(module, alias.name) for alias in node.names)
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id == "result"
            ):
                found = insdvl_replay.DiveResult
                assert hasattr(found, node.attr) or node.attr in found.__annotations__
    assert blocks or document != "docs/python.md"


# --- The site.


def test_every_page_of_the_site_can_be_reached(tmp_path: Path) -> None:
    pytest.importorskip("latex2mathml", reason="needs latex2mathml")
    site.gather(tmp_path)
    contents = YAML(typ="safe").load(text_of("mkdocs.yml"))
    named = {place for entry in contents["nav"] for place in entry.values()}
    made = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.md")}
    assert made - named == {place for place in made if place.startswith("equations/")} - {
        "equations/README.md"
    }
    for path in tmp_path.rglob("*.md"):
        for target in re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", path.read_text("utf-8")):
            assert re.match(r"[a-z]+:", target) or (path.parent / target).is_file(), (
                path.name,
                target,
            )


@pytest.mark.nightly
def test_the_site_is_built_strictly(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="needs mkdocs")
    pytest.importorskip("latex2mathml", reason="needs latex2mathml")
    site.gather(tmp_path / "build" / "pages")
    shutil.copy(PROJECT / "mkdocs.yml", tmp_path)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "build" / "site" / "verdict.html").is_file()


def test_formulas_of_the_site_are_mathml_and_code_stays(tmp_path: Path) -> None:
    pytest.importorskip("latex2mathml", reason="needs latex2mathml")
    site.gather(tmp_path)
    for path in tmp_path.rglob("*.md"):
        assert "```math" not in path.read_text("utf-8"), path.name
    for chapter in (tmp_path / "equations").glob("*.md"):
        assert "$" not in chapter.read_text("utf-8"), chapter.name
    page = (tmp_path / "equations" / "kalman_filter.md").read_text("utf-8")
    assert '<p class="formula"><math' in page
    assert "$ insdvl-replay inspect" in (tmp_path / "vehicle.md").read_text("utf-8")


# --- Exit codes, make targets.


def test_exit_codes_are_those_of_the_contract() -> None:
    table = text_of("docs/comparing.md").split("## Exit codes")[1].split("\nNext: ")[0]
    assert re.findall(r"^\| *(\d+) *\|", table, re.MULTILINE) == ["0", "1", "2", "3", "4", "130"]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_make_targets_exist(document: str) -> None:
    targets = set(re.findall(r"^(\w+):", text_of("Makefile"), re.MULTILINE))
    assert {
        target for line in code_of(document) for target in re.findall(r"\bmake (\w+)", line)
    } <= targets


def test_continuous_integration_runs_everything() -> None:
    assert re.search(r"^make test$", text_of(".ci/run"), re.MULTILINE)


# --- All files.


def test_relative_links_lead_somewhere() -> None:
    for path in project_files():
        if path.suffix != ".md":
            continue
        for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text("utf-8")):
            if re.match(r"[a-z]+:", target):
                continue
            file, _, anchor = target.partition("#")
            linked = path.parent / file if file else path
            assert linked.exists(), f"{path.name}: {target}"
            assert not anchor or anchor in anchors(linked), f"{path.name}: {target}"


def anchors(markdown: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", markdown.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_nothing_is_left_to_do_and_no_machine_is_named() -> None:
    unfinished = re.compile(r"\b(TO[D]O|FIX[M]E|XX[X])\b")
    machine = re.compile(r"(?<![\w.~>/)}])/(home|Users|tmp|root|work|mnt|media)/\w|\b[A-Z]:\\\w")
    for path in project_files():
        try:
            text = path.read_text("utf-8")
        except UnicodeDecodeError:
            continue
        assert not unfinished.search(text), path
        assert not machine.search(text), path


def test_citation_has_what_it_needs_and_the_version() -> None:
    citation = YAML(typ="safe").load(text_of("CITATION.cff"))
    assert citation["cff-version"] == "1.2.0"
    assert {
        "message",
        "title",
        "type",
        "authors",
        "license",
        "version",
        "references",
    } <= citation.keys()
    assert (citation["type"], citation["license"]) == ("software", "Apache-2.0")
    assert citation["version"] == __version__
    paper, *_ = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Levy", "Klein"]


def test_changelog_reports_of_this_version() -> None:
    first = re.findall(r"^## (\S+)", text_of("CHANGELOG.md"), re.MULTILINE)[0]
    assert first == __version__


def test_each_table_of_measurements_has_date_and_commit() -> None:
    sections = re.split(r"^# ", text_of("benchmarks/RESULTS.md"), flags=re.MULTILINE)[1:]
    assert len(sections) > 20
    undated = [
        part.partition("\n")[0]
        for part in sections
        if not re.search(r"20\d\d-\d\d-\d\d, [0-9a-f]{8}\b", part)
    ]
    assert undated == []
