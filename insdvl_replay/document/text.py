"""A document as text: on a terminal, and in Markdown for a merge request.

Text is shown as everywhere (`errors.visible`) and cannot leave its place: no HTML, no link.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.words import EvidenceVerdict, GateStatus, Verdict
from insdvl_replay.document.parts import (
    Callout,
    Code,
    DisplayTable,
    Document,
    Format,
    Part,
    Remark,
    Sentences,
    Title,
)
from insdvl_replay.document.tables import cell_lines, parts_for

# --- A terminal: calm tables that fit 80 columns.

# Words that have a colour.
_STYLES: Final[dict[str, str]] = {
    EvidenceVerdict.BETTER: "bold green",
    EvidenceVerdict.WORSE: "bold red",
    Verdict.MIXED: "bold yellow",
    Verdict.NOT_EVALUATED: "bold red",
    Verdict.NOT_REPEATABLE: "bold red",
    GateStatus.FAILED: "bold red",
}
_TONES: Final = {"good": "bold green", "bad": "bold red"}
_ANY_WIDTH: Final = 10_000


def spoken(sentence: str, style: str = "") -> Text:
    """Render a sentence for a terminal, which must not act on it."""
    return Text(visible(sentence), style=style)


def for_terminal(document: Document) -> Group:
    """Render a document for a rich console, which decides about width and colour. Only code is never folded."""
    lines = [line for part in parts_for("terminal", document) for line in _terminal_lines(part)]
    return Group(*(lines[1:] if lines and isinstance(lines[0], Text) and not lines[0] else lines))


def _terminal_lines(part: Part) -> Iterator[RenderableType]:
    match part:
        case Title(text):
            yield spoken(text, "bold")
        case Callout(text, tone):
            yield spoken(text, _TONES.get(tone, ""))
        case str(text) | Remark(text, ""):
            yield spoken(text)
        case Remark(sentence, hint):
            yield from (spoken(sentence), Padding(spoken(f"hint: {hint}"), (0, 0, 0, 2)))
        case Sentences(sentences):
            yield Text()
            for line in sentences:
                yield from _terminal_lines(line)
        case Code(text, language):
            if language:
                yield Text()
            yield from (
                Text(visible(line), no_wrap=True, overflow="ignore") for line in text.splitlines()
            )
        case DisplayTable(title):
            if title:  # a table without one belongs to what is before it
                yield from (Text(), spoken(title, "bold"))
            yield _Fitting(part)


@dataclass(frozen=True)
class _Fitting:
    """A table that leaves out spare columns where the terminal is too narrow for them."""

    table: DisplayTable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        spare = [place if isinstance(place, tuple) else (place,) for place in self.table.spare]
        for count in range(len(spare) + 1):
            grid = _grid(self.table, [place for places in spare[:count] for place in places])
            if count == len(spare):
                break  # to measure it takes as long as to print it
            needed = Measurement.get(console, options.update(max_width=_ANY_WIDTH), grid).maximum
            if needed - self.table.folds <= options.max_width:
                break
        yield grid
        if self.table.footnote:
            yield spoken(self.table.footnote)


def _grid(table: DisplayTable, left_out: Sequence[int]) -> Table:
    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    kept = [place for place in range(len(table.header)) if place not in left_out]
    for place in kept:
        justify = "right" if table.alignment[place] == "r" else "left"
        grid.add_column(Text(visible_lines(table.header[place])), justify=justify, overflow="fold")  # type: ignore[arg-type]
    for row in table.rows:
        texts = ["\n".join(cell_lines(row[place])) for place in kept]
        grid.add_row(
            *(
                Text(text, style=_STYLES.get(text.lower().partition(" by ")[0], ""))
                for text in texts
            )
        )
    return grid


# --- Markdown, with pipe tables. Backticks stay, since hints have commands between them.


def as_markdown(document: Document) -> str:
    """Render a document in Markdown."""
    return "\n\n".join(_markdown(part) for part in flat("markdown", document)) + "\n"


def flat(format_: Format, document: Document) -> Iterator[Part]:
    """Yield the parts of a format, sentences one by one."""
    for part in parts_for(format_, document):
        yield from part.lines if isinstance(part, Sentences) else (part,)


def _markdown(part: Part) -> str:
    match part:
        case Title(text):
            return f"## {_markdown_text(text)}"
        case Code(text, language):
            longest = max((len(run) for run in re.findall("`+", text)), default=0)
            fence = "`" * max(3, longest + 1)
            return f"{fence}{language}\n{visible_lines(text.rstrip())}\n{fence}"
        case DisplayTable():
            rule = ["---:" if letter == "r" else "---" for letter in part.alignment]
            rows = [[" ".join(name.split()) for name in part.header], rule, *part.rows]
            cells = [
                ["<br>".join(map(_markdown_cell, cell_lines(cell))) for cell in row] for row in rows
            ]
            lines = [
                f"**{_markdown_text(part.title)}**\n",
                *(f"| {' | '.join(row)} |" for row in cells),
            ]
            return "\n".join(
                [*lines, *(["", _markdown_text(part.footnote)] if part.footnote else [])]
            )
    return _markdown_text(sentence_of(part))


def _markdown_text(text: str) -> str:
    """Write a sentence on one line, without tags and links."""
    return visible(text).replace("<", "&lt;").replace("](", "]\\(")


def _markdown_cell(line: str) -> str:
    return _markdown_text(line).replace("|", r"\|")


def sentence_of(part: Part) -> str:
    """Return the text of a part that is one sentence; empty for other parts."""
    if isinstance(part, str):
        return part
    if isinstance(part, Title | Callout | Remark):
        return part.text
    return ""
