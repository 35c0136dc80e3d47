"""Tables and sentences as Markdown, for a merge request, and as LaTeX, for a paper.

Text is shown as everywhere (`plain_text`) and cannot leave its place: no HTML and no link of its own in Markdown, no
line break that would end a comment in LaTeX. Backticks stay, since hints have commands between them.
"""

import re
from collections.abc import Sequence
from typing import Final

from insdvl_replay.core.plain_text import visible, visible_lines
from insdvl_replay.report.display_table import CellText, ShownTable, cell_lines

_LATEX: Final = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}


def markdown_page(title: str, opening: Sequence[str], tables: Sequence[ShownTable], closing: Sequence[str] = ()) -> str:
    """Dress tables in Markdown.

    Parameters
    ----------
    title : str
    opening, closing : sequence of str
        Paragraphs before and after the tables.
    tables : sequence of ShownTable

    Returns
    -------
    str
    """
    parts = [
        f"## {markdown_text(title)}",
        *map(markdown_text, opening),
        *map(_markdown_table, tables),
        *map(markdown_text, closing),
    ]
    return "\n\n".join(parts) + "\n"


def markdown_text(text: str) -> str:
    """Write a sentence in Markdown.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        On one line, without tags and links.
    """
    return visible(text).replace("<", "&lt;").replace("](", "]\\(")


def markdown_code(text: str, language: str) -> str:
    """Write a block of code in Markdown, fenced by more backticks than it holds.

    Parameters
    ----------
    text : str
    language : str

    Returns
    -------
    str
    """
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}{language}\n{visible_lines(text.rstrip())}\n{fence}"


def latex_page(title: str, opening: Sequence[str], tables: Sequence[ShownTable]) -> str:
    """Dress tables in LaTeX.

    Parameters
    ----------
    title : str
    opening : sequence of str
        Sentences, which become comments.
    tables : sequence of ShownTable

    Returns
    -------
    str
        Needs ``\\usepackage{booktabs}``.
    """
    comments = "\n".join(f"% {visible(line)}" for line in (title, *opening))
    return "\n\n".join([comments, *map(_latex_table, tables)]) + "\n"


def _markdown_table(table: ShownTable) -> str:
    rule = ["---:" if letter == "r" else "---" for letter in table.alignment]
    header = [" ".join(name.split()) for name in table.header]
    rows = [header, rule, *table.rows]
    lines = [f"| {' | '.join(map(_markdown_cell, row))} |" for row in rows]
    footnote = f"\n\n{markdown_text(table.footnote)}" if table.footnote else ""
    return f"**{markdown_text(table.title)}**\n\n" + "\n".join(lines) + footnote


def _markdown_cell(cell: CellText) -> str:
    return "<br>".join(markdown_text(line).replace("|", r"\|") for line in cell_lines(cell))


def _latex_table(table: ShownTable) -> str:
    rows = [_latex_row(row) for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_latex(table.title)}}}",
            rf"\begin{{tabular}}{{{table.alignment}}}",
            r"\toprule",
            _latex_row([" ".join(name.split()) for name in table.header]),
            r"\midrule",
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
            *([rf"\par {_latex(table.footnote)}"] if table.footnote else []),
            r"\end{table}",
        ]
    )


def _latex_row(row: Sequence[CellText]) -> str:
    """Write a row; braces before what would be an option of the one above, or a command to a job runner."""
    text = " & ".join(_latex(" ".join(" ".join(cell_lines(cell)).split())) for cell in row)
    return re.sub(r"^(?=[\[*:])", "{}", text) + r" \\"


def _latex(text: str) -> str:
    return re.sub(r"[\\^~&%$#_{}]", lambda match: _LATEX[match.group()], visible(text))
