"""A document as text: on a terminal, and in Markdown for a merge request.

Text is shown as everywhere (`errors.visible`) and cannot leave its place: no HTML, no link.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.words import EvidenceVerdict, GateStatus, Verdict
from insdvl_replay.document.parts import (
    Callout,
    CellText,
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
_FEWEST_LETTERS: Final = 12  # of a column whose texts are folded


def spoken(sentence: str, style: str = "") -> Text:
    """Render a sentence for a terminal, which must not act on it."""
    return Text(visible(sentence), style=style)


def for_terminal(document: Document) -> Group:
    """Render a document for a rich console, which decides about width and colour. Only code is never folded."""
    lines: list[RenderableType] = []
    for part in parts_for("terminal", document):
        lines += _terminal_lines(part)
    # Nothing is before the first part, from which an empty line would keep it apart.
    if lines and isinstance(lines[0], Text) and not lines[0]:
        del lines[0]
    return Group(*lines)


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
            for said in sentences:
                yield from _terminal_lines(said)
        case Code(text, language):
            if language:
                yield Text()
            for line in text.splitlines():
                yield Text(visible(line), no_wrap=True, overflow="ignore")
        case DisplayTable(title):
            if title:  # a table without one belongs to what is before it
                yield from (Text(), spoken(title, "bold"))
            yield _Fitting(part)


@dataclass(frozen=True)
class _Fitting:
    """A table that leaves out spare columns where the terminal is too narrow for them."""

    table: DisplayTable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self.table.whole and not options.is_terminal:
            yield from self._in_whole_lines(console, options)
            return
        left_out: list[int] = []
        grid = _grid(self.table, left_out)
        at_any_width = options.update(max_width=_ANY_WIDTH)
        for places in self.table.spare:
            needed = Measurement.get(console, at_any_width, grid).maximum
            if needed - self.table.folds <= options.max_width:
                break
            left_out += places if isinstance(places, tuple) else (places,)
            grid = _grid(self.table, left_out)
        _keep_words_whole(grid, self.table, left_out, options.max_width)
        yield grid
        if self.table.footnote:
            yield spoken(self.table.footnote)

    def _in_whole_lines(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the rows with a line each, for programs that search them."""
        grid = _grid(self.table, ())
        yield from console.render(grid, options.update(width=_ANY_WIDTH))
        if self.table.footnote:
            yield spoken(self.table.footnote)


def _keep_words_whole(
    grid: Table, table: DisplayTable, left_out: Sequence[int], width: int
) -> None:
    """Let columns of single words keep their width where the others have room to be folded."""
    kept = [place for place in range(len(table.header)) if place not in left_out]
    single = []
    needed = 0
    for column, place in zip(grid.columns, kept, strict=True):
        texts = table.header[place].split("\n")
        for row in table.rows:
            texts += cell_lines(row[place])
        if any(" " in text for text in texts):
            needed += _FEWEST_LETTERS
        else:
            single.append(column)
            needed += max(map(cell_len, texts)) + 1
    if needed <= width:
        for column in single:
            column.no_wrap = True


def _grid(table: DisplayTable, left_out: Sequence[int]) -> Table:
    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    kept = [place for place in range(len(table.header)) if place not in left_out]
    for place in kept:
        justify = "right" if table.alignment[place] == "r" else "left"
        grid.add_column(Text(visible_lines(table.header[place])), justify=justify, overflow="fold")  # type: ignore[arg-type]
    for row in table.rows:
        grid.add_row(*(_coloured(row[place]) for place in kept))
    return grid


def named_texts(texts: Mapping[str, str], widest: int = 0) -> RenderableType:
    """Render texts behind their names, below each other; ``widest`` is the least width of the names."""
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(no_wrap=True, min_width=widest)
    grid.add_column()
    for name, text in texts.items():
        grid.add_row(spoken(name), spoken(text))
    return Padding(grid, (0, 0, 0, 2))


def _coloured(cell: CellText) -> Text:
    """Return a cell; a verdict has a colour, also where what it is made by follows it."""
    text = "\n".join(cell_lines(cell))
    word = text.lower().partition(" by ")[0]
    return Text(text, style=_STYLES.get(word, ""))


# --- Markdown, with pipe tables. Backticks stay, since hints have commands between them.


def as_markdown(document: Document) -> str:
    """Render a document in Markdown."""
    return "\n\n".join(_markdown(part) for part in flat("markdown", document)) + "\n"


def flat(format_: Format, document: Document) -> Iterator[Part]:
    """Yield the parts of a format, sentences one by one."""
    for part in parts_for(format_, document):
        if isinstance(part, Sentences):
            yield from part.lines
        else:
            yield part


def _markdown(part: Part) -> str:
    match part:
        case Title(text):
            return f"## {_markdown_text(text)}"
        case Code(text, language):
            longest = max((len(run) for run in re.findall("`+", text)), default=0)
            fence = "`" * max(3, longest + 1)
            return f"{fence}{language}\n{visible_lines(text.rstrip())}\n{fence}"
        case DisplayTable():
            return _markdown_table(part)
    return _markdown_text(sentence_of(part))


def _markdown_table(table: DisplayTable) -> str:
    """Write a table under its title, with its footnote below it."""
    lines = [
        f"**{_markdown_text(table.title)}**\n",
        _markdown_row([" ".join(name.split()) for name in table.header]),
        _markdown_row([_RULES[letter] for letter in table.alignment]),
    ]
    for row in table.rows:
        lines.append(_markdown_row(row))
    if table.footnote:
        lines += ["", _markdown_text(table.footnote)]
    return "\n".join(lines)


_RULES: Final = {"l": "---", "r": "---:"}  # By the letter of the alignment.


def _markdown_row(row: Sequence[CellText]) -> str:
    texts = ["<br>".join(map(_markdown_cell, cell_lines(cell))) for cell in row]
    return f"| {' | '.join(texts)} |"


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
