"""A document on a terminal: calm tables that fit 80 columns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

from rich import box
from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from insdvl_replay.core.errors import visible, visible_lines
from insdvl_replay.core.words import EvidenceWord, GateStatus, Judgement
from insdvl_replay.report.document import (
    Callout,
    CellText,
    Code,
    DisplayTable,
    Document,
    Part,
    Remark,
    Sentences,
    Title,
    cell_lines,
    parts_for,
)

_JUSTIFY: Final[dict[str, JustifyMethod]] = {"l": "left", "r": "right"}
_STYLES: Final[dict[str, str]] = {
    EvidenceWord.BETTER: "bold green",
    EvidenceWord.WORSE: "bold red",
    Judgement.MIXED: "bold yellow",
    Judgement.NOT_JUDGED: "bold red",
    GateStatus.FAILED: "bold red",
}
"""Words on filters that have a colour; all else has none."""
_TONES: Final = {"good": "bold green", "bad": "bold red"}
_ANY_WIDTH: Final = 10_000
Cell = TypeVar("Cell")


def for_terminal(document: Document) -> Group:
    """Render a document for a rich console, which decides about width and colour.

    Only code, which can be copied into a file, has lines of its own, however long.
    """
    lines = [line for part in parts_for("terminal", document) for line in _lines(part)]
    return Group(*(lines[1:] if lines and _is_blank(lines[0]) else lines))


def _is_blank(line: RenderableType) -> bool:
    return isinstance(line, Text) and not line


def spoken(sentence: str, style: str = "") -> Text:
    """Render a sentence for a terminal, which must not act on what it says."""
    return Text(visible(sentence), style=style)


def _lines(part: Part) -> Iterator[RenderableType]:
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
                yield from _lines(line)
        case Code():
            yield from _code_lines(part)
        case DisplayTable():
            yield from _table_lines(part)


def _code_lines(code: Code) -> Iterator[RenderableType]:
    """Render lines that are never folded; those of a language stand apart."""
    if code.language:
        yield Text()
    yield from (Text(visible(line), no_wrap=True, overflow="ignore") for line in code.text.splitlines())


def _table_lines(table: DisplayTable) -> Iterator[RenderableType]:
    """Render a table; one without a title belongs to what stands before it."""
    if table.title:
        yield Text()
    if table.title_apart:
        yield spoken(table.title, "bold")
    yield _Fitting(replace(table, title="") if table.title_apart else table)


@dataclass(frozen=True)
class _Fitting:
    """A table that leaves out spare columns where the terminal is too narrow for them."""

    table: DisplayTable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        spare = self.table.spare
        for count in range(len(spare) + 1):
            grid = _table(_without(self.table, spare[:count]))
            if count == len(spare):
                break  # to measure it takes as long as to print it
            needed = Measurement.get(console, options.update(max_width=_ANY_WIDTH), grid).maximum
            if needed - self.table.folds <= options.max_width:
                break
        yield grid


def _without(table: DisplayTable, columns: Sequence[int]) -> DisplayTable:
    def kept(cells: Sequence[Cell]) -> tuple[Cell, ...]:
        return tuple(cell for place, cell in enumerate(cells) if place not in columns)

    alignment = "".join(kept(tuple(table.alignment)))
    return replace(table, header=kept(table.header), alignment=alignment, rows=tuple(map(kept, table.rows)), spare=())


def _cell(cell: CellText) -> Text:
    """Write a cell; a word on a filter has a colour where there are colours."""
    text = "\n".join(cell_lines(cell))
    return Text(text, style=_STYLES.get(text.lower(), ""))


def _table(table: DisplayTable) -> Table:
    grid = Table(
        title=spoken(table.title, "bold"),
        caption=spoken(table.footnote) if table.footnote else None,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for name, letter in zip(table.header, table.alignment, strict=True):
        grid.add_column(Text(visible_lines(name)), justify=_JUSTIFY[letter], overflow="fold")
    for row in table.rows:
        grid.add_row(*map(_cell, row))
    return grid
