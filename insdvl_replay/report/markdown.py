"""A document as Markdown, for a merge request.

Text is shown by `errors.visible` and cannot leave its place: no HTML and no link of its own. Backticks stay,
since hints have commands between them.
"""

import re
from collections.abc import Iterator

from insdvl_replay.core.errors import visible, visible_lines
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


def as_markdown(document: Document) -> str:
    """Render a document in Markdown, with pipe tables."""
    return "\n\n".join(block for part in parts_for("markdown", document) for block in _blocks(part)) + "\n"


def _blocks(part: Part) -> Iterator[str]:
    match part:
        case Title(text):
            yield f"## {_text(text)}"
        case str(text) | Callout(text) | Remark(text=text):
            yield _text(text)
        case Sentences(lines):
            for line in lines:
                yield from _blocks(line)
        case Code(text, language):
            yield _fenced(text, language)
        case DisplayTable():
            yield _table(part)


def _text(text: str) -> str:
    """Write a sentence on one line, without tags and links."""
    return visible(text).replace("<", "&lt;").replace("](", "]\\(")


def _fenced(text: str, language: str) -> str:
    """Write a block of code, fenced by more backticks than it holds."""
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}{language}\n{visible_lines(text.rstrip())}\n{fence}"


def _table(table: DisplayTable) -> str:
    rule = ["---:" if letter == "r" else "---" for letter in table.alignment]
    header = [" ".join(name.split()) for name in table.header]
    lines = [f"| {' | '.join(map(_cell, row))} |" for row in (header, rule, *table.rows)]
    footnote = f"\n\n{_text(table.footnote)}" if table.footnote else ""
    return f"**{_text(table.title)}**\n\n" + "\n".join(lines) + footnote


def _cell(cell: CellText) -> str:
    return "<br>".join(_text(line).replace("|", r"\|") for line in cell_lines(cell))
