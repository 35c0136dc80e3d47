"""A figure drawn by matplotlib, for papers and slides, in the light colours of the pages."""

import math
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.result import Figure, Panel
from insdvl_replay.show.plot import PANELS_IN_A_ROW

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOKS: Final[dict[str, dict[str, Any]]] = {
    "filter0": {"color": "#c0232c", "linestyle": (0, (7, 3))},
    "filter1": {"color": "#1c5fc4", "linestyle": "-"},
    "filter2": {"color": "#1f7f45", "linestyle": (0, (4, 6))},
    "filter3": {"color": "#7a45b8", "linestyle": (0, (2, 2))},
    "filter4": {"color": "#a06400", "linestyle": (0, (14, 3))},
    "filter5": {"color": "#0a7c86", "linestyle": (0, (4, 2, 1, 2, 1, 2))},
    "reference": {"color": "#1b2330", "linewidth": 0.8},
    "limit": {"color": "#1b2330", "linestyle": (0, (4, 3)), "linewidth": 0.8},
    "zero": {"color": "#566172", "linewidth": 0.6},
    "sigma": {"linestyle": "-", "linewidth": 0.4},
}
"""The styles of the pages' style sheet."""
_STYLE: Final[Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "legend.fontsize": 7.0,
    "lines.linewidth": 0.9,
    "lines.scale_dashes": False,
    "axes.linewidth": 0.5,
    "grid.linewidth": 0.3,
    "axes.grid": True,
    "pdf.fonttype": 42,
    "svg.hashsalt": "insdvl-replay",
    "svg.fonttype": "none",
}
_MM_PER_INCH: Final = 25.4
_SHAPE: Final = 0.62
"""Height over width of a panel."""
_SLIDE_MM: Final = 90.0
"""Width of a panel on a slide."""
_UNDATED: Final = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {"Software": None}}
"""Without the time of day the same result gives the same bytes."""


def require_matplotlib() -> None:
    """Raise a ConfigError if matplotlib, an optional package, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        hint = "pip install 'insdvl-replay[figures]'"
        raise ConfigError("this picture needs matplotlib, which is not installed", hint) from error


def figure_png(figure: Figure) -> bytes:
    """Draw a figure for slides, under its title."""
    return drawn(figure, "png", _SLIDE_MM * max(min(PANELS_IN_A_ROW, len(figure.panels)), 2), headed=True)


def drawn(figure: Figure, format_: str, width_mm: float, *, headed: bool = False) -> bytes:
    """Draw a figure as pdf, svg, png or pgf, without a display and independent of user styles; headed: with its title.

    Raises a ConfigError for pgf without LaTeX.
    """
    require_matplotlib()
    from matplotlib import style
    from matplotlib.figure import Figure as Canvas
    from matplotlib.lines import Line2D

    columns = min(len(figure.panels), 1 if width_mm < 120.0 else PANELS_IN_A_ROW)
    rows, width = math.ceil(len(figure.panels) / columns), width_mm / _MM_PER_INCH
    stream = BytesIO()  # the writer of PDF loses the reason where a disk is full
    with style.context(["default", _STYLE]):
        canvas = Canvas(figsize=(width, rows * width / columns * _SHAPE + 0.7 * headed), layout="constrained")
        places = list(canvas.subplots(rows, columns, squeeze=False).flat)
        for place, panel in zip(places, figure.panels, strict=False):
            _draw(place, panel, headed=headed)
        for place in places[len(figure.panels) :]:
            place.set_visible(False)
        handles = [Line2D([], [], label=label, **_look(word)) for word, label in figure.legend]
        if headed:
            canvas.suptitle(figure.title, wrap=True)
            canvas.legend(handles=handles, loc="outside lower center", ncols=PANELS_IN_A_ROW, frameon=False)
        else:
            places[0].legend(handles=handles, frameon=False)
        try:
            canvas.savefig(stream, format=format_, dpi=150 if headed else 300, metadata=_UNDATED.get(format_))
        except (RuntimeError, FileNotFoundError) as error:
            if format_ != "pgf":
                raise
            raise ConfigError(
                "--format pgf needs LaTeX, which is not installed", "--format pdf needs no LaTeX"
            ) from error
    return stream.getvalue()


def _draw(axes: "Axes", panel: Panel, *, headed: bool) -> None:
    for curve in panel.curves:
        if curve.points:
            axes.plot(curve.x, curve.y, "o", markersize=3.0, color=_look(curve.style)["color"])
        else:
            axes.plot(curve.x, curve.y, **_look(curve.style))
    for level in panel.levels:
        axes.axhline(level, **_look("limit"))
    axes.set(xlabel=panel.x_label, xscale=panel.x_scale, yscale=panel.y_scale, ylim=panel.y_limits)
    if headed:
        axes.set_title(panel.title)
    else:
        axes.set_ylabel(panel.title)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if panel.x_whole:
        axes.locator_params(axis="x", integer=True)


def _look(style: str) -> dict[str, Any]:
    """Join the looks of the words of a style."""
    look: dict[str, Any] = {}
    for word in style.split():
        look |= _LOOKS[word]
    return look
