"""A report in every form in which it is printed."""

from msgspec.structs import astuple
from rich.console import Group, RenderableType
from rich.text import Text

from insdvl_replay.core.tables import each_table
from insdvl_replay.report.csv_tables import rows_csv
from insdvl_replay.report.markup import latex_page, markdown_page
from insdvl_replay.report.terminal import dressed, spoken
from insdvl_replay.results.dive_sentences import closing_lines, heading, verdict_lines
from insdvl_replay.results.dive_tables import shown_tables
from insdvl_replay.results.json_report import Report


def terminal_report(report: Report) -> Group:
    """Dress a report for a terminal.

    Parameters
    ----------
    report : Report

    Returns
    -------
    rich.console.Group
        To be printed by a rich console, which decides about width and colour.
    """
    parts: list[RenderableType] = [spoken(heading(report), "bold"), *map(spoken, verdict_lines(report))]
    for table in shown_tables(report):
        parts += [Text(), dressed(table)]
    parts += [Text(), *map(spoken, closing_lines(report))]
    return Group(*parts)


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


def report_csv(report: Report) -> str:
    """Write the tables one after the other, a blank line between them.

    Parameters
    ----------
    report : Report

    Returns
    -------
    str
        Every line begins with the column ``table``, the header's too, so that one table is easily cut out.
    """
    return "\n".join(
        rows_csv(("table", *layout.columns), ((layout.name, *astuple(row)) for row in rows))
        for layout, rows in each_table(report.tables)
    )
