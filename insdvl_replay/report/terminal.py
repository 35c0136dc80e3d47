"""A document on a terminal: calm tables that fit 80 columns."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from rich import box
from rich.console import Group, JustifyMethod, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from insdvl_replay.core.plain_text import visible, visible_lines
from insdvl_replay.report.document import (
    Callout,
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


def for_terminal(document: Document) -> Group:
    """Render a document for a rich console, which decides about width and colour.

    Only code, which can be copied into a file, has lines of its own, however long.
    """
    return Group(*(line for part in parts_for("terminal", document) for line in _lines(part)))


def spoken(sentence: str, style: str = "") -> Text:
    """Render a sentence for a terminal, which must not act on what it says."""
    return Text(visible(sentence), style=style)


def _lines(part: Part) -> Iterator[RenderableType]:
    match part:
        case Title(text):
            yield spoken(text, "bold")
        case str(text) | Callout(text) | Remark(text, ""):
            yield spoken(text)
        case Remark(sentence, hint):
            yield from (spoken(sentence), Padding(spoken(f"hint: {hint}"), (0, 0, 0, 2)))
        case Sentences(sentences):
            yield Text()
            for line in sentences:
                yield from _lines(line)
        case Code(text):
            yield Text()
            yield from (Text(visible(line), no_wrap=True, overflow="ignore") for line in text.splitlines())
        case DisplayTable(title, title_apart=apart):
            yield Text()
            yield from (spoken(title, "bold"), _table(replace(part, title=""))) if apart else (_table(part),)


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
        grid.add_row(*(Text("\n".join(cell_lines(cell))) for cell in row))
    return grid
