"""Notes have one writer: no module but core/notes.py makes one or changes its sentence, and no document lists them."""

import ast
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.notes import explanation
from insdvl_replay.core.states import MORE_STATES

PROJECT = Path(__file__).resolve().parents[2]
PACKAGE = PROJECT / "insdvl_replay"
SOURCES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))
PAGES = sorted(path.relative_to(PROJECT).as_posix() for path in PROJECT.glob("docs/*.md"))
# The writer, and the note itself, which puts what it is about in front of its sentence.
WRITERS = {"core/notes.py", "core/errors.py"}


def places_of_notes(source: str) -> Iterator[int]:
    """Yield the lines of code that make a note, or one with another sentence."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        given = {keyword.arg for keyword in node.keywords}
        if name == "Note" or (name == "replace" and given & {"text", "code"}):
            yield node.lineno


def codes_in_rows(document: str) -> set[str]:
    """Return the codes of notes with which rows of a document's tables begin."""
    found = set()
    for cell in re.findall(r"^\| (`.*?) \|", document, re.MULTILINE):
        for code in re.findall(r"`([a-z]+(?:_[a-z]+)+)`", cell):
            # Some states have the names of notes.
            if code not in MORE_STATES:
                with suppress(ConfigError):
                    explanation(code)
                    found.add(code)
    return found


def test_what_makes_a_note_is_found() -> None:
    source = """
found.append(Note("a", "b"))
errors.Note(code="a", text="b")
replace(found, text="b")
replace(found, hint="c")
note("a")
"""
    assert sorted(places_of_notes(source)) == [2, 3, 4]
    assert codes_in_rows("| `imu_gaps`, `not_a_code` | a |\n") == {"imu_gaps"}


@pytest.mark.parametrize("source", [name for name in SOURCES if name not in WRITERS])
def test_no_other_module_makes_a_note(source: str) -> None:
    assert list(places_of_notes((PACKAGE / source).read_text("utf-8"))) == []


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", *PAGES])
def test_no_other_page_lists_notes(page: str) -> None:
    assert codes_in_rows((PROJECT / page).read_text("utf-8")) == set()
