"""The words of the glossary: what documents, screens, notes and names never say.

`docs/glossary.md` has the words that are used instead.
"""

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
IN_PROSE = (
    "believes", "believed", "belief", "borne out", "honest", "honesty", "over-cautious", "over-confident",
    "coasting", "withheld", "judgement", "judgements", "not judged", "unfit", "misled", "lost its way", "laid on",
    "gravest", "own code", "obstacle", "obstacles", "mistake of ours", "passed over", "gauge", "anew", "whoever",
    "nothing shows it",
)  # fmt: skip
IN_NAMES = frozenset((
    "told", "believe", "believes", "believed", "belief", "honest", "honesty", "coasting", "withheld", "judgement",
    "judgements", "judged", "unfit", "misled", "gravest", "obstacle", "obstacles", "doubt", "doubts", "doubtful",
    "mistake", "gauge", "anew", "whoever", "beside", "laid",
))  # fmt: skip
PATTERN = re.compile(
    rf"\b(?:{'|'.join(map(re.escape, IN_PROSE))}|stands(?! for))\b", re.IGNORECASE
)
DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "docs/*.md",
    "docs/reference/*.md",
)
SCREENS = ("tests/cli/golden/*.txt", "tests/words/golden/*.txt", "insdvl_replay/core/notes.toml")


@pytest.mark.parametrize("places", [DOCUMENTS, SCREENS], ids=["documents", "screens"])
def test_prose_and_screens_say_the_glossarys_words(places: tuple[str, ...]) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {word}"
        for place in places
        for path in sorted(ROOT.glob(place))
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        for word in PATTERN.findall(line)
        if "glossary" not in path.name and not _is_old_name(path, line)
    ]
    assert not found, "\n".join(found)


def test_names_in_code_are_the_glossarys() -> None:
    found = sorted({name for path in ROOT.glob("insdvl_replay/**/*.py") for name in _names(path)})
    assert not found


def _is_old_name(path: Path, line: str) -> bool:
    """Return whether a line of the changelog says what a name was before."""
    return path.name == "CHANGELOG.md" and " is now " in line


def _names(path: Path) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(path.read_text("utf-8")).readline):
        if token.type == tokenize.NAME:
            words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", token.string)
            if IN_NAMES.intersection(word.lower() for word in words):
                yield f"{path.relative_to(ROOT)}: {token.string}"
