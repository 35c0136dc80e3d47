"""A report as Markdown, for a merge request, and as LaTeX, for a paper."""

import re
from typing import Final

from insdvl_replay.report.json_report import Report
from insdvl_replay.report.shown import ShownTable, closing_lines, heading, shown_tables, verdict_lines

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
    parts = [
        f"## {heading(report)}",
        *verdict_lines(report),
        *(_markdown_table(table) for table in shown_tables(report)),
        *closing_lines(report),
    ]
    return "\n\n".join(parts) + "\n"


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
    comments = [f"% {line}" for line in (heading(report), *verdict_lines(report), *closing_lines(report))]
    return "\n\n".join(["\n".join(comments), *(_latex_table(table) for table in shown_tables(report))]) + "\n"


def _markdown_table(table: ShownTable) -> str:
    rule = ["---:" if letter == "r" else "---" for letter in table.alignment]
    header = [name.replace("\n", " ") for name in table.header]
    rows = [header, rule, *table.rows]
    lines = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    footnote = f"\n\n{table.footnote}" if table.footnote else ""
    return f"**{table.title}**\n\n" + "\n".join(lines) + footnote


def _latex_table(table: ShownTable) -> str:
    rows = [" & ".join(_latex(cell) for cell in row) + r" \\" for row in table.rows]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{_latex(table.title)}}}",
            rf"\begin{{tabular}}{{{table.alignment}}}",
            r"\toprule",
            " & ".join(_latex(name.replace("\n", " ")) for name in table.header) + r" \\",
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
