"""Every note that is made has a sentence in the table, and every sentence of the table is made."""

import ast
import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from string import Formatter
from typing import NamedTuple

import notes as generator
import pytest

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.notes import SOURCES, NoteKind, explanation, explanations, note
from insdvl_replay.core.words import Severity

PROJECT = Path(__file__).resolve().parents[2]
PAGE = PROJECT / "docs" / "reference" / "notes.md"
STORED = sorted((PROJECT / "tests" / "net" / "stored").glob("*.tsv"))
KNOWN = {code: found for subject in explanations().values() for code, found in subject.items()}
# What makes a note, the place of the code among its arguments, and the fields that it fills in itself.
WRITERS = {
    "note": (0, {"count", "counted", "role", "first"}),
    "_note": (0, {"count", "counted"}),
    "keep": (1, {"count", "counted", "role", "first"}),
    "keep_where": (2, {"count", "counted", "role", "first"}),
    "keep_possible": (2, {"count", "counted", "role", "first", "values"}),
    "without_impossible": (2, {"count", "counted", "role", "first", "values"}),
    "keep_finite": (None, {"count", "counted", "role", "first"}),
    "_keep_rows": (1, {"count", "counted", "role", "first"}),
}
# Warnings whose sentence says all, or of which what to do depends on the case: `explain` tells.
WITHOUT_HINT = {
    "aiding_without_updates",
    "found_calibration failed",
    "found_calibration not_applied",
    "found_clocks",
    "result_damaged",
    "table_decimal_comma",
    "table_header first",
    "table_no_time",
    "table_on_one_side",
    "times_summed",
    "*_silent",
}
NO_FIELDS = {"code", "severity", "first", "is_expected"}
CODE = re.compile(r"[a-z_0-9*]+( [a-z_]+)?")


class Made(NamedTuple):
    """A code in the source, with * for what only a run knows, and the fields that it is made with."""

    code: str
    word: str  # of another sentence of the code
    fields: frozenset[str] | None  # None where they are given as a dictionary


@cache
def trees() -> list[ast.Module]:
    return [
        ast.parse(path.read_text("utf-8")) for path in (PROJECT / "insdvl_replay").rglob("*.py")
    ]


def constants() -> dict[str, str]:
    """Texts that have a name in a module."""
    found = {}
    for tree in trees():
        for node in tree.body:
            if not isinstance(node, ast.Assign | ast.AnnAssign):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                for target in targets:
                    found[getattr(target, "id", "")] = node.value.value
    return found


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


def texts_of(node: ast.AST, function: ast.AST, named: dict[str, str]) -> list[str]:
    """The texts that an argument can have; a variable has all that its function gives it."""
    match node:
        case ast.IfExp(body=body, orelse=orelse):
            return [text_of(body, named), text_of(orelse, named)]
        case ast.Name(id=name) if name not in named:
            found: list[str] = []
            for other in ast.walk(function):
                if isinstance(other, ast.Assign) and getattr(other.targets[0], "id", "") == name:
                    found += texts_of(other.value, function, named)
            return found or ["*"]
    return [text_of(node, named)]


@cache
def made_notes() -> frozenset[Made]:
    """The notes that the source makes."""
    named = constants()
    found = set()
    for tree in trees():
        functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
        for function in functions:
            found |= set(notes_in(function, named))
    return frozenset(found)


def notes_in(function: ast.AST, named: dict[str, str]) -> Iterator[Made]:
    for call in ast.walk(function):
        if not isinstance(call, ast.Call):
            continue
        writer = getattr(call.func, "id", getattr(call.func, "attr", ""))
        if writer not in WRITERS:
            continue
        place, filled = WRITERS[writer]
        given = {keyword.arg for keyword in call.keywords}
        codes = [keyword.value for keyword in call.keywords if keyword.arg == "code"]
        if place is not None:
            codes += call.args[place : place + 1]
        fields = None
        if None not in given:
            fields = frozenset({str(name) for name in given} - NO_FIELDS | filled)
        for node in codes:
            for text in texts_of(node, function, named):
                code, _, word = text.partition(" ")
                if code.strip("*_"):
                    yield Made(code, word, fields)


def fits(code: str, known: str) -> bool:
    """Whether a code is that of an entry; the source of a code may be added where it is made."""
    codes = (code, *(f"{source}_{code}" for source in SOURCES))
    return fnmatchcase(known, code) or any(fnmatchcase(one, known) for one in codes)


def sentences_of(made: Made) -> list[tuple[str, str]]:
    """What a note that is made can say: text and hint of its entries, the longest of which counts."""
    entries = [known for known in KNOWN if fits(made.code, known)]
    found = []
    for known in entries:
        kind = KNOWN[known]
        if made.word in kind.other:
            found.append((kind.other[made.word].text, kind.other[made.word].hint))
        elif kind.text and not made.word:
            found.append((kind.text, kind.hint))
    return found


def fields_of(text: str) -> set[str]:
    """The names of the fields of a sentence, also in the clauses of other fields."""
    found = set()
    for _, name, clause, _ in Formatter().parse(text):
        if name is not None:
            found |= {re.split(r"[.\[]", name)[0], *fields_of(clause or "")}
    return found


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


def test_collection_finds_notes_of_every_kind() -> None:
    made = {f"{note.code} {note.word}".strip() for note in made_notes()}
    assert {"imu_slow", "gaps", "gaps long", "start_*_far", "noise_far_off"} <= made
    assert {"not_finite reading", "*_coverage", "impossible samples", "table_rows"} <= made
    assert len(made) > 150
    assert {"log_damaged", "sensors_unused"} <= stored_codes()


def test_every_note_that_is_made_has_a_sentence_with_all_its_fields() -> None:
    for made in made_notes():
        sentences = sentences_of(made)
        assert sentences, made
        if made.fields is not None:
            lacking = [fields_of(text + hint) - made.fields for text, hint in sentences]
            assert set() in lacking, (made, lacking)
    for code in stored_codes():
        assert explanation(code)


def test_every_sentence_of_the_table_is_made() -> None:
    named = constants()
    texts = set()
    for tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant | ast.JoinedStr):
                texts.add(text_of(node, named))
    codes = [text.partition(" ") for text in texts if CODE.fullmatch(text) and text[-1] != "*"]
    for known, kind in KNOWN.items():
        words = [*kind.other, *([""] if kind.text else [])]
        assert words, known
        for said in words:
            assert any(word == said and fits(code, known) for code, _, word in codes), (
                known,
                said,
            )


def test_a_count_and_its_clause_agree_in_number() -> None:
    assert note("table_no_time", 1).text == "1 row has no time and is left out"
    assert note("table_no_time", 2).text == "2 rows have no time and are left out"
    more = note("files_overlap", 3, longest_s=1.25).text
    assert more == "3 files overlap with the file before, by up to 1.250 s"


def test_a_severity_that_is_given_goes_before_that_of_the_table() -> None:
    assert note("table_no_time").severity == Severity.WARNING
    assert note("table_no_time", severity=Severity.INFO).severity == Severity.INFO


@pytest.mark.parametrize("code", ["no_such_note", "table_header no_such_word", "table_rows"])
def test_a_note_that_the_table_lacks_or_a_field_without_value_is_a_programmers_mistake(
    code: str,
) -> None:
    with pytest.raises(ValueError, match=code.partition(" ")[0]):
        note(code)


def test_warnings_have_hints() -> None:
    without = set()
    for code, kind in KNOWN.items():
        if kind.text and not kind.hint and kind.severity == Severity.WARNING:
            without.add(code)
        for word, said in kind.other.items():
            if not said.hint and said.severity == Severity.WARNING:
                without.add(f"{code} {word}")
    assert without == WITHOUT_HINT


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
