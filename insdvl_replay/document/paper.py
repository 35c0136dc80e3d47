"""A figure drawn by matplotlib, for papers and slides, in the light colours of the pages."""

import math
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.extras import install_hint
from insdvl_replay.document.parts import Figure, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure as Canvas

    from insdvl_replay.core.dive_columns import Floats

# The styles of the pages' style sheet.
LOOKS: Final[dict[str, dict[str, Any]]] = {
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
    "start": {"color": "#1b2330", "marker": "o", "markerfacecolor": "white", "linestyle": "none"},
    "end": {"color": "#1b2330", "marker": "s", "linestyle": "none"},
}
_STYLE: Final[Any] = {
    "font.size": 8.0,
    "axes.titlesize": 6.5,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "figure.titlesize": 8.0,
    "lines.linewidth": 0.9,
    "lines.markersize": 3.5,
    "lines.scale_dashes": False,
    "axes.linewidth": 0.5,
    "grid.linewidth": 0.3,
    "axes.grid": True,
    "pdf.fonttype": 42,
    "svg.hashsalt": "insdvl-replay",
    "svg.fonttype": "none",
}
NARROWEST_MM = 60.0
WIDEST_MM = 1000.0
_MM_PER_INCH: Final = 25.4
_SHAPE: Final = 0.62  # Height over width of a panel.
_LOW_MM: Final = 34.0  # Height of a panel among several, if it is wide.
_SLIDE_MM: Final = 90.0  # Width of a panel on a slide.
_PANELS_IN_A_ROW: Final = 3
_MOST_TICKS: Final = 6
_PAD_IN: Final = 0.06  # Free to the left and right of axes, inches.
_SHORT: Final = 100.0  # A logarithmic axis over a smaller factor has ticks at 1, 2 and 5.
# Without the time of day the same result gives the same bytes.
_UNDATED: Final = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {"Software": None}}


def require_matplotlib() -> None:
    """Raise a ConfigError if matplotlib, an optional package, is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        text = "this picture needs matplotlib, which is not installed"
        raise ConfigError(text, install_hint("figures")) from error


def require_width(width_mm: float, option: str) -> None:
    """Raise a ConfigError if a figure cannot have this width."""
    if not NARROWEST_MM <= width_mm <= WIDEST_MM:
        text = f"{option}: is not a width from {NARROWEST_MM:g} to {WIDEST_MM:g} mm"
        raise ConfigError(text, "88 is a column of a paper, 180 a page")


def figure_png(figure: Figure) -> bytes:
    """Draw a figure for slides, under its title."""
    return drawn(
        figure, "png", _SLIDE_MM * max(min(_PANELS_IN_A_ROW, len(figure.panels)), 2), headed=True
    )


def drawn(figure: Figure, format_: str, width_mm: float, *, headed: bool = False) -> bytes:
    """Draw a figure as pdf, svg, png or pgf, without a display and independent of user styles; headed: with its title.

    Raises a ConfigError for pgf without LaTeX.
    """
    canvas = paper_canvas(figure, width_mm, headed=headed)
    stream = BytesIO()
    from matplotlib import style

    with style.context(["default", _STYLE]):
        try:
            canvas.savefig(
                stream, format=format_, dpi=150 if headed else 300, metadata=_UNDATED.get(format_)
            )
        except (RuntimeError, FileNotFoundError) as error:
            if format_ != "pgf":
                raise
            raise ConfigError(
                "--format pgf needs LaTeX, which is not installed", "--format pdf needs no LaTeX"
            ) from error
    return stream.getvalue()


def paper_canvas(figure: Figure, width_mm: float, *, headed: bool = False) -> "Canvas":
    """Return a figure of matplotlib; panels over the same time share its axis."""
    require_matplotlib()
    from matplotlib import figure as drawing
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    class Shown(drawing.Figure):
        """A figure that a notebook shows by itself."""

        def _repr_png_(self) -> bytes:
            stream = BytesIO()
            self.savefig(stream, format="png", dpi=150)
            return stream.getvalue()

    panels = figure.panels
    rows, columns = _grid(len(panels), width_mm, headed=headed)
    is_shared = (
        not headed
        and len(panels) > 1
        and len({(panel.x_label, panel.x_scale) for panel in panels}) == 1
    )
    panel_mm = width_mm / columns
    row_mm = panel_mm * (0.85 if panels[0].equal and not headed else _SHAPE)
    row_mm = min(row_mm, max(_LOW_MM, 0.3 * panel_mm)) if is_shared else row_mm
    with style.context(["default", _STYLE]):
        canvas = Shown(
            figsize=(width_mm / _MM_PER_INCH, (rows * row_mm + 10.0 * headed) / _MM_PER_INCH),
            layout="constrained",
        )
        # The label of the last tick is half beyond its axis.
        canvas.set_layout_engine("constrained", w_pad=_PAD_IN)
        FigureCanvasAgg(canvas)
        grid = canvas.subplots(rows, columns, squeeze=False, sharex=is_shared)
        places = list(
            grid.flatten("C" if headed else "F")
        )  # column by column, so that the axes of a vector are one
        for place, panel in zip(places, panels, strict=False):
            _draw(place, panel, titled=headed or len(panels) > 1)
        for place in places[len(panels) :]:
            place.remove()
        for column in grid.T if is_shared else ():
            kept = [place for place in column if place in canvas.axes]
            for place in kept[:-1]:
                place.set_xlabel("")
            kept[-1].tick_params(labelbottom=True)
        handles = [
            Patch(label=label, alpha=0.15, **_look(word.removeprefix("band "))) if word.startswith("band ")
            else Line2D([], [], label=label, **_look(word))
            for word, label in figure.legend
        ]  # fmt: skip
        if headed:
            canvas.suptitle(figure.title, wrap=True)
        for count in range(min(len(handles), 6), 0, -1):
            legend = canvas.legend(
                handles=handles, loc="outside lower center", ncols=count, frameon=False
            )
            space = legend.get_window_extent()
            if space.width <= canvas.bbox.width or count == 1:
                canvas.set_figheight(canvas.get_figheight() + space.height / canvas.dpi)
                break
            legend.remove()
        _fit_titles(canvas)
    return canvas


def _fit_titles(canvas: "Canvas") -> None:
    """Write all titles smaller if one reaches the panel to its right, or the edge."""
    canvas.draw_without_rendering()
    shares = [1.0]
    for axes in canvas.axes:
        place = axes.get_position()
        title = axes.get_title(loc="left")
        others = [
            other.get_position().x0 for other in canvas.axes if other.get_position().x0 > place.x1
        ]
        text = axes.set_title(title, loc="left")
        room = (min(others, default=1.0) - place.x0) * canvas.bbox.width - 2.0
        shares.append(room / max(text.get_window_extent().width, room))
    for axes in canvas.axes:
        axes.set_title(
            axes.get_title(loc="left"), loc="left", fontsize=min(shares) * _STYLE["axes.titlesize"]
        )


def _grid(count: int, width_mm: float, *, headed: bool) -> tuple[int, int]:
    """Return the numbers of rows and columns of panels."""
    columns = min(count, _PANELS_IN_A_ROW)
    if not headed and width_mm < 120.0:
        columns = 2 if count > 4 and width_mm > 80.0 else 1
    elif not headed:
        columns = {4: 2, 6: 2, 12: 4 if width_mm >= 150.0 else 3}.get(count, columns)
    return math.ceil(count / columns), columns


def _draw(axes: "Axes", panel: Panel, *, titled: bool) -> None:
    for curve in panel.curves:
        look = _look(curve.style)
        if curve.band is not None:
            axes.fill_between(curve.x, *curve.band, color=look["color"], alpha=0.15, linewidth=0.0)
        if curve.points:
            axes.plot(curve.x, curve.y, **{"marker": "o", **look, "linestyle": "none"})
        else:
            axes.plot(curve.x, curve.y, **look)
    for level in panel.levels:
        axes.axhline(level, **_look("limit"))
    axes.set_xlabel(panel.x_label)
    if panel.y_limits is not None:
        axes.set_ylim(panel.y_limits)
    if panel.x_limits is not None:
        axes.set_xlim(panel.x_limits)
    if titled:
        axes.set_title(panel.title, loc="left")
    else:
        axes.set_ylabel(panel.title)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if panel.x_whole:
        axes.locator_params(axis="x", integer=True)
    for axis, name, scale in ((axes.xaxis, "x", panel.x_scale), (axes.yaxis, "y", panel.y_scale)):
        values = np.unique(
            np.concatenate([getattr(curve, name) for curve in panel.curves] or [np.empty(0)])
        )
        is_log = scale == "log" and bool(
            (values > 0.0).any()
        )  # matplotlib fails without a positive value
        axes.set(**{f"{name}scale": "log" if is_log else "linear"})
        _plain_ticks(axis, values, is_log=is_log, named=name == "x")


def _plain_ticks(axis: "Axis", values: "Floats", *, is_log: bool, named: bool) -> None:
    """Write ticks without powers of ten; named: on a logarithmic axis they are the values, if these are few."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    def plain(value: float, _place: int) -> str:
        is_plain = value == 0.0 or 1e-6 < abs(value) < 1e7  # longer numbers cannot be read
        text = (
            np.format_float_positional(float(f"{value:.9g}"), trim="-")
            if is_plain
            else f"{value:g}"
        )
        return text.replace("-", "\N{MINUS SIGN}")

    if is_log:
        low, high = axis.get_view_interval()
        digits = (1.0, 2.0, 5.0) if high < _SHORT * low else (1.0,)
        is_few = named and len(values) <= _MOST_TICKS
        axis.set_major_locator(
            FixedLocator(list(values)) if is_few else LogLocator(subs=digits, numticks=_MOST_TICKS)
        )
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(plain))


def _look(style: str) -> dict[str, Any]:
    """Join the looks of the words of a style."""
    look: dict[str, Any] = {}
    for word in style.split():
        look |= LOOKS[word]
    return look
