"""What is to be shown, before any format: the parts of a document, in the order in which they are read.

A feature builds its parts once, and `terminal`, `markdown`, `latex` and `page` render what their format can show.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from insdvl_replay.core.errors import Note
from insdvl_replay.report.display_table import ShownTable
from insdvl_replay.report.plots.panel import Figure

Format = Literal["terminal", "markdown", "latex", "html"]
PRINTED: Final[tuple[Format, ...]] = ("terminal", "markdown", "latex")
PAGE: Final[tuple[Format, ...]] = ("html",)


@dataclass(frozen=True)
class Title:
    """What the whole is, in one line."""

    text: str


@dataclass(frozen=True)
class Lead:
    """The sentence that a reader takes away; the tone, ``good`` or ``bad``, colours the edge beside it on a page."""

    text: str
    tone: str = ""


@dataclass(frozen=True)
class Remark:
    """A sentence, and what helps; the hint is empty where nothing does."""

    sentence: str
    hint: str = ""

    @property
    def text(self) -> str:
        """Both on one line."""
        return f"{self.sentence}; hint: {self.hint}" if self.hint else self.sentence


@dataclass(frozen=True)
class Sentences:
    """Sentences that stand together, apart from what is before them."""

    lines: tuple[str | Remark, ...]


@dataclass(frozen=True)
class Code:
    """Lines to be copied as they are."""

    text: str
    language: str


@dataclass(frozen=True)
class Heading:
    """Begins a part of a page, to which the page's head leads."""

    text: str


@dataclass(frozen=True)
class LinkedTable:
    """A table of a page whose rows lead somewhere: the first cell of each to its address, unless that is empty."""

    table: ShownTable
    links: tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """Facts of a page by their names."""

    named: Mapping[str, str]


@dataclass(frozen=True)
class Details:
    """A long text of a page that is folded away; on paper it is unfolded."""

    title: str
    text: str


@dataclass(frozen=True)
class Html:
    """A fragment of a page that is HTML already."""

    text: str


@dataclass(frozen=True)
class Only:
    """Parts that some formats alone show."""

    formats: tuple[Format, ...]
    parts: tuple["Part", ...]


Text = str | Title | Lead | Remark
"""Of one sentence; plain text becomes a paragraph."""
OfPage = Heading | LinkedTable | Facts | Details | Figure | Html
"""What pages alone can show."""
Part = Text | Sentences | Code | ShownTable | OfPage | Only
Document = Sequence[Part]


def parts_for(format_: Format, document: Document) -> Iterator[Part]:
    """Yield the parts that a format shows."""
    for part in document:
        if isinstance(part, Only):
            if format_ in part.formats:
                yield from part.parts
        elif format_ in PAGE or not isinstance(part, OfPage):
            yield part


def losses(notes: Iterable[Note]) -> ShownTable | str:
    """Say with counts what was dropped, assumed or found odd."""
    rows = tuple((str(note.count), note.severity, f"{note.text} [{note.code}]", note.hint) for note in notes)
    if not rows:
        return "Nothing."
    return ShownTable("Notes on reading, preparing and filtering", ("count", "", "what", "what helps"), "rlll", rows)


def settings_details(settings: str) -> Details:
    """Fold the resolved configuration away."""
    return Details("Settings, which repeat this result", settings)
