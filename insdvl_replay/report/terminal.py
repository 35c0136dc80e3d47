"""Tables and sentences on a terminal: calm tables that fit 80 columns."""

from typing import Final

from rich import box
from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

from insdvl_replay.core.plain_text import visible, visible_lines
from insdvl_replay.report.display_table import ShownTable, cell_lines

_JUSTIFY: Final[dict[str, JustifyMethod]] = {"l": "left", "r": "right"}


def spoken(sentence: str, style: str = "") -> Text:
    """Dress a sentence for a terminal, which must not act on what it says.

    Parameters
    ----------
    sentence : str
    style : str

    Returns
    -------
    rich.text.Text
    """
    return Text(visible(sentence), style=style)


def dressed(table: ShownTable) -> Table:
    """Dress one table for a terminal.

    Parameters
    ----------
    table : ShownTable

    Returns
    -------
    rich.table.Table
    """
    cloth = Table(
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
        cloth.add_column(Text(visible_lines(name)), justify=_JUSTIFY[letter], overflow="fold")
    for row in table.rows:
        cloth.add_row(*(Text("\n".join(cell_lines(cell))) for cell in row))
    return cloth
