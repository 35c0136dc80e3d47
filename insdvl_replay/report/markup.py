"""A report as Markdown, for a merge request, and as LaTeX, for a paper."""

import re
from collections.abc import Sequence
from typing import Final

from insdvl_replay.report.dive_sentences import closing_lines, heading, verdict_lines
from insdvl_replay.report.dive_tables import shown_tables
from insdvl_replay.report.json_report import Report
from insdvl_replay.report.shown import ShownTable

_LATEX: Final = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}


def markdown_report(report: Report) -> str:
    """Dress a report in Markdown with pipe tables.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
    """
    return markdown_page(heading(report), verdict_lines(report), shown_tables(report), closing_lines(report))


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
    return "\n\n".join([f"## {title}", *opening, *map(_markdown_table, tables), *closing]) + "\n"


def latex_report(report: Report) -> str:
    """Dress a report in LaTeX, one ``table`` with booktabs rules for each table.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        Needs ``\\usepackage{booktabs}``.
    """
    return latex_page(heading(report), [*verdict_lines(report), *closing_lines(report)], shown_tables(report))


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
    comments = "\n".join(f"% {line}" for line in (title, *opening))
    return "\n\n".join([comments, *map(_latex_table, tables)]) + "\n"


def _markdown_table(table: ShownTable) -> str:
    rule = ["---:" if letter == "r" else "---" for letter in table.alignment]
    header = [" ".join(name.split()) for name in table.header]
    rows = [header, rule, *table.rows]
    lines = [f"| {' | '.join(map(_markdown_cell, row))} |" for row in rows]
    footnote = f"\n\n{table.footnote}" if table.footnote else ""
    return f"**{table.title}**\n\n" + "\n".join(lines) + footnote


def _markdown_cell(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", "<br>")


def _latex_table(table: ShownTable) -> str:
    rows = [" & ".join(_latex(" ".join(cell.split())) for cell in row) + r" \\" for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_latex(table.title)}}}",
            rf"\begin{{tabular}}{{{table.alignment}}}",
            r"\toprule",
            " & ".join(_latex(" ".join(name.split())) for name in table.header) + r" \\",
            r"\midrule",
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
            *([rf"\par {_latex(table.footnote)}"] if table.footnote else []),
            r"\end{table}",
        ]
    )


def _latex(text: str) -> str:
    return re.sub(r"[\\^~&%$#_{}]", lambda match: _LATEX[match.group()], text)
