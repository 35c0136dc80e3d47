"""Every code that a note can have is explained, and every explanation is of a code that there is."""

import ast
import re
from collections import defaultdict
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import notes as generator
import pytest

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.notes import SOURCES, NoteKind, explanation, explanations

PROJECT = Path(__file__).resolve().parents[2]
PAGE = PROJECT / "docs" / "reference" / "notes.md"
STORED = sorted((PROJECT / "tests" / "net" / "stored").glob("*.tsv"))
KNOWN = {code: found for subject in explanations().values() for code, found in subject.items()}


@cache
def trees() -> list[ast.Module]:
    return [
        ast.parse(path.read_text("utf-8")) for path in (PROJECT / "insdvl_replay").rglob("*.py")
    ]


@cache
def nodes() -> dict[type[ast.AST], list[ast.AST]]:
    found = defaultdict(list)
    for tree in trees():
        for node in ast.walk(tree):
            found[type(node)].append(node)
    return found


def every(kind: type[ast.AST]) -> list[ast.AST]:
    return nodes()[kind]


def constants() -> dict[str, str]:
    """Texts that have a name in a module."""
    found = {}
    for node in (
        node
        for tree in trees()
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
    ):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found |= {
                target.id: node.value.value for target in targets if isinstance(target, ast.Name)
            }
    return found


def places_of_codes() -> dict[str, int]:
    """Functions and classes that take a code, and at which place."""
    places = {}
    for node in every(ast.FunctionDef):
        names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
        names = names[names[:1] in (["self"], ["cls"]) :]
        if "code" in names:
            places[node.name] = names.index("code")
    for node in every(ast.ClassDef):
        names = [field.target.id for field in node.body if isinstance(field, ast.AnnAssign)]
        places |= {node.name: names.index("code")} if "code" in names else {}
    return places


def text_of(node: ast.AST, named: dict[str, str]) -> str:
    """A text, with * for what only a run knows."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.Name(id=name):
            return named.get(name, "*")
        case ast.JoinedStr(values=parts):
            return "".join(text_of(part, named) for part in parts)
        case ast.FormattedValue(value=value):
            return text_of(value, named)
    return "*"


@cache
def made_codes() -> frozenset[str]:
    """Codes in calls of what takes one, and in variables with this name; of some of them a source is left out."""
    named, places, found = constants(), places_of_codes(), set[str]()
    for call in every(ast.Call):
        name = getattr(call.func, "id", getattr(call.func, "attr", ""))
        if name in places:
            given = [keyword.value for keyword in call.keywords if keyword.arg == "code"]
            found |= {text_of(node, named) for node in [*given, *call.args[places[name] :][:1]]}
    for node in every(ast.Assign):
        for target in node.targets:
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = list(zip(target.elts, node.value.elts, strict=False))
            else:
                pairs = [(target, node.value)]
            found |= {
                text_of(value, named) for name, value in pairs if getattr(name, "id", "") == "code"
            }
    # What a generator of warnings yields: code, text, count and hint.
    yielded = [node.value.elts for node in every(ast.Yield) if isinstance(node.value, ast.Tuple)]
    found |= {text_of(parts[0], named) for parts in yielded if len(parts) == 4}
    # In a table of sentences, fields stand in braces, and what is behind a blank tells sentences of one code apart.
    found = {re.sub(r"\{[^}]*\}", "*", text.partition(" ")[0]) for text in found}
    return frozenset(
        code for code in found if code.strip("*_") and code.replace("*", "x").isidentifier()
    )


def stored_codes() -> set[str]:
    """Codes of the notes in stored results."""
    found = set()
    for path in STORED:
        column = None
        for cells in (line.split("\t") for line in path.read_text("utf-8").splitlines()):
            if cells[0].endswith("notes[]"):
                column = cells.index("code") if "code" in cells else None
            elif cells[0].endswith("notes") and column is not None and len(cells) > column:
                found.add(cells[column])
    return found


def is_explained(code: str) -> bool:
    """Whether there is an explanation; the source of a code may be added where it is made."""
    codes = (code, *(f"{source}_{code}" for source in SOURCES))
    return any(fnmatchcase(code, known) for known in KNOWN for code in codes) or any(
        fnmatchcase(known, code) for known in KNOWN
    )


def test_collection_finds_codes_of_every_kind() -> None:
    made = made_codes()
    assert {"imu_slow", "gaps", "*_wrong_stamps", "start_*_far", "noise_far_off"} <= made
    assert len(made) > 100
    assert {"log_damaged", "sensors_unused"} <= stored_codes()


def test_every_code_is_explained() -> None:
    assert sorted(code for code in made_codes() if not is_explained(code)) == []
    for code in stored_codes():
        assert explanation(code)


def test_every_explanation_is_of_a_code_that_there_is() -> None:
    named = constants()
    made = made_codes() | {
        node.value for node in every(ast.Constant) if isinstance(node.value, str)
    }
    patterns = made | {
        text for node in every(ast.JoinedStr) if (text := text_of(node, named)).count("*") == 1
    }
    patterns = {
        text
        for text in patterns
        if "*" in text and text.replace("*", "x").isidentifier() and text[-1] != "*"
    }

    def is_made(known: str) -> bool:
        without_source = {known.removeprefix(f"{source}_") for source in ("*", *SOURCES)}
        return bool(made & {known, *without_source}) or any(
            fnmatchcase(known, pattern) for pattern in patterns
        )

    assert sorted(known for known in KNOWN if not is_made(known)) == []


def test_explanations_are_short_sentences() -> None:
    for code, found in KNOWN.items():
        for text in (found.what, found.effect, found.cure):
            assert text[0].isupper() or text[0] == "`", code
            assert text[-1] == ".", code
            assert len(text) < 150, code


@pytest.mark.parametrize(
    ("code", "entry"),
    [
        ("imu_gaps", "imu_gaps"),
        ("topics.range_repeats", "*_repeats"),
        ("solution_ekf_is_reference", "*_is_reference"),
        ("solution_coverage", "solution_coverage"),
        ("start_height_far", "start_*_far"),
        ("*_repeats", "*_repeats"),
    ],
)
def test_code_of_a_source_has_the_explanation_of_all_sources(code: str, entry: str) -> None:
    found = explanation(code)
    assert isinstance(found, NoteKind)
    assert found == KNOWN[entry]


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        ("imu_gap", "did you mean imu_gaps?"),
        ("depth_stuk", "did you mean depth_stuck?"),
        ("xyzzy", "`insdvl-replay explain` lists all codes"),
    ],
)
def test_unknown_code_names_the_nearest(code: str, hint: str) -> None:
    with pytest.raises(ConfigError) as raised:
        explanation(code)
    assert (raised.value.message, raised.value.hint) == (f"code '{code}' is not known", hint)


def test_page_is_current() -> None:
    assert generator.written() == PAGE.read_text("utf-8"), "run `make reference`"
