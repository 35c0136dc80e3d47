"""A figure as one picture: its panels in rows, its legend below, and the page's colours, for light and dark."""

from collections.abc import Iterator
from html import escape
from importlib.resources import files
from typing import Final

from insdvl_replay.report.plots.panel import Figure
from insdvl_replay.report.plots.svg import HEIGHT, WIDTH, panel_svg

_COLUMNS: Final = 3
_LEGEND: Final = 28.0
_ENTRY: Final = 170.0


def sheet_svg(figure: Figure) -> bytes:
    """Draw the panels of a figure in one picture.

    Parameters
    ----------
    figure : Figure
        Its panels are as high as each other.

    Returns
    -------
    bytes
        An SVG file; the same figure gives the same bytes.
    """
    rows = -(-len(figure.panels) // _COLUMNS)
    width, height = WIDTH * _COLUMNS, HEIGHT * rows + _LEGEND
    style = files("insdvl_replay.report").joinpath("page.css").read_text("utf-8")
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f"<title>{escape(figure.title)}</title>",
        f"<style>\n{style}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
        *_panels(figure),
        *_legend(figure, height - _LEGEND / 2.0),
        "</svg>",
        "",
    ]
    return "\n".join(lines).encode()


def _panels(figure: Figure) -> Iterator[str]:
    for number, panel in enumerate(figure.panels):
        row, column = divmod(number, _COLUMNS)
        place = f'<svg x="{column * WIDTH:g}" y="{row * HEIGHT:g}" width="{WIDTH:g}" height="{HEIGHT:g}"'
        yield panel_svg(panel).replace('<svg class="panel"', place, 1)


def _legend(figure: Figure, y: float) -> Iterator[str]:
    for number, (style, label) in enumerate(figure.legend):
        x = _ENTRY * number + 48.0
        yield f'<path class="line {style}" d="M{x:g} {y - 4:g}h36"/>'
        yield f'<text x="{x + 44:g}" y="{y:g}">{escape(label)}</text>'
