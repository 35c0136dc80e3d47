"""A report on a terminal: calm tables that fit 80 columns."""

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from insdvl_replay.report.json_report import Report
from insdvl_replay.report.shown import ShownTable, closing_lines, heading, shown_tables


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
    parts: list[RenderableType] = [Text(heading(report), style="bold")]
    for table in shown_tables(report):
        parts += [Text(), _dressed(table)]
    parts += [Text(), *(Text(line) for line in closing_lines(report))]
    return Group(*parts)


def _dressed(table: ShownTable) -> Table:
    dressed = Table(
        title=Text(table.title, style="bold"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for column, name in enumerate(table.header):
        dressed.add_column(Text(name), justify="right" if table.is_number(column) else "left", overflow="fold")
    for row in table.rows:
        dressed.add_row(*(Text(cell) for cell in row))
    return dressed
