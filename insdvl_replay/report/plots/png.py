"""A figure as PNG, for slides: the same panels, drawn by matplotlib in the colours that pages have by day."""

import io
import math
from typing import TYPE_CHECKING, Any, Final

from insdvl_replay.report.plots.panel import Figure, Panel
from insdvl_replay.report.plots.svg import COLUMNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOKS: Final[dict[str, dict[str, Any]]] = {
    "filter0": {"color": "#c0232c", "linestyle": (0, (7, 3))},
    "filter1": {"color": "#1c5fc4"},
    "filter2": {"color": "#1f7f45", "linestyle": (0, (4, 6))},
    "filter3": {"color": "#7a45b8", "linestyle": (0, (2, 2))},
    "filter4": {"color": "#a86a00", "linestyle": (0, (14, 3))},
    "filter5": {"color": "#0a7c86", "linestyle": (0, (4, 2, 1, 2, 1, 2))},
    "reference": {"color": "#1b2330", "linewidth": 1.0},
    "limit": {"color": "#1b2330", "linestyle": (0, (4, 3)), "linewidth": 1.0},
    "zero": {"color": "#566172", "linewidth": 0.7},
}
"""The styles of the pages' style sheet, as far as studies use them."""
_OWN_STYLE: Final[dict[str, Any]] = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.5,
    "lines.scale_dashes": False,
}
_PIXELS_PER_INCH: Final = 150
_WIDTH, _HEIGHT, _LEGEND = 3.6, 2.4, 0.7
"""Of a panel, and of title and legend together, in inches."""


def figure_png(figure: Figure) -> bytes:
    """Draw a figure without a screen, in no user's style, and to the same bytes each time."""
    from matplotlib import style
    from matplotlib.figure import Figure as Canvas
    from matplotlib.lines import Line2D

    columns = min(COLUMNS, len(figure.panels))
    rows = math.ceil(len(figure.panels) / columns)
    with style.context(["default", _OWN_STYLE]):
        canvas = Canvas(figsize=(_WIDTH * max(columns, 2), _HEIGHT * rows + _LEGEND), layout="constrained")
        places = canvas.subplots(rows, columns, squeeze=False).flat
        for axes, panel in zip(places, figure.panels, strict=False):
            _draw(axes, panel)
        canvas.suptitle(figure.title, wrap=True)
        handles = [Line2D([], [], label=label, **_look(word)) for word, label in figure.legend]
        canvas.legend(handles=handles, loc="outside lower center", ncols=COLUMNS, frameon=False)
        stream = io.BytesIO()
        canvas.savefig(stream, format="png", dpi=_PIXELS_PER_INCH, metadata={"Software": None})
    return stream.getvalue()


def _draw(axes: "Axes", panel: Panel) -> None:
    for curve in panel.curves:
        if curve.points:
            axes.plot(curve.x, curve.y, "o", color=_look(curve.style)["color"])
        else:
            axes.plot(curve.x, curve.y, **_look(curve.style))
    for level in panel.levels:
        axes.axhline(level, **_look("limit"))
    axes.set_title(panel.title, fontsize="medium")
    axes.set(xlabel=panel.x_label, xscale=panel.x_scale, yscale=panel.y_scale, ylim=panel.y_limits)
    if panel.x_whole:
        axes.locator_params(axis="x", integer=True)


def _look(style: str) -> dict[str, Any]:
    """Join the looks of the words of a style."""
    look: dict[str, Any] = {}
    for word in style.split():
        look |= _LOOKS[word]
    return look
