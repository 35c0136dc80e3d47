"""A figure as one picture: its panels in rows, its legend below, and the page's colours, for light and dark."""

import re
from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files
from typing import Final

from insdvl_replay.report.plots.panel import Figure, Panel
from insdvl_replay.report.plots.svg import WIDTH, panel_height, panel_svg

_COLUMNS: Final = 3
_CLASS: Final = re.compile(r'<svg class="[^"]*"')
_LEGEND: Final = 28.0
_ENTRY: Final = 170.0


def sheet_svg(figure: Figure) -> bytes:
    """Draw the panels of a figure in one picture.

    Parameters
    ----------
    figure : Figure
        A row is as high as its highest panel.

    Returns
    -------
    bytes
        An SVG file; the same figure gives the same bytes.
    """
    rows = [figure.panels[first : first + _COLUMNS] for first in range(0, len(figure.panels), _COLUMNS)]
    heights = [max(map(panel_height, row)) for row in rows]
    width, height = WIDTH * min(_COLUMNS, len(figure.panels)), sum(heights) + _LEGEND
    style = files("insdvl_replay.report").joinpath("page.css").read_text("utf-8")
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f"<title>{escape(figure.title)}</title>",
        f"<style>\n{style}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
        *_panels(rows, heights),
        *_legend(figure, height - _LEGEND / 2.0),
        "</svg>",
        "",
    ]
    return "\n".join(lines).encode()


def _panels(rows: Sequence[Sequence[Panel]], heights: Sequence[float]) -> Iterator[str]:
    top = 0.0
    for row, height in zip(rows, heights, strict=True):
        for column, panel in enumerate(row):
            place = f'<svg x="{column * WIDTH:g}" y="{top:g}" width="{WIDTH:g}" height="{panel_height(panel):g}"'
            yield _CLASS.sub(place, panel_svg(panel), count=1)
        top += height


def _legend(figure: Figure, y: float) -> Iterator[str]:
    for number, (style, label) in enumerate(figure.legend):
        x = _ENTRY * number + 48.0
        yield f'<path class="line {style}" d="M{x:g} {y - 4:g}h36"/>'
        yield f'<text x="{x + 44:g}" y="{y:g}">{escape(label)}</text>'
