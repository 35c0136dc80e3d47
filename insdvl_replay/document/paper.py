"""A figure drawn by matplotlib, for papers and slides, in the light colours of the pages."""

import math
from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.extras import install_hint
from insdvl_replay.document.looks import strokes
from insdvl_replay.document.parts import LIMIT, REFERENCE, Curve, Figure, Panel
from insdvl_replay.document.plot import ends_of_track

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure as Canvas
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from insdvl_replay.core.dive_columns import Floats

# What styles have on paper beside the colours and dashes of the style sheet.
_ON_PAPER: Final[dict[str, dict[str, Any]]] = {
    "reference": {"linewidth": 0.8},
    "limit": {"linewidth": 0.8},
    "zero": {"linewidth": 0.6},
    "sigma": {"linestyle": "-", "linewidth": 0.4},  # thin: fine dots close up in print
    "start": {"marker": "o", "markerfacecolor": "white", "linestyle": "none"},
    "end": {"marker": "s", "linestyle": "none"},
}
_BAND: Final = "band "  # Begins the style of an area in the legend.
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
_WIDE_MM: Final = 120.0  # From this width on panels are side by side.
_SHAPE: Final = 0.62  # Height over width of a panel.
_SHAPE_OF_TRACK: Final = 0.85
_TITLE_MM: Final = 10.0
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
    from matplotlib import style

    with style.context(["default", _STYLE]):
        canvas = _draw_panels(figure.panels, width_mm, headed=headed)
        if headed:
            canvas.suptitle(figure.title, wrap=True)
        _add_legend(canvas, figure)
        _fit_titles(canvas)
    return canvas


def _draw_panels(panels: Sequence[Panel], width_mm: float, *, headed: bool) -> "Canvas":
    """Draw the panels in rows, or, without a title above them, column by column: so the axes of a vector are one."""
    rows, columns = _grid(len(panels), width_mm, headed=headed)
    is_shared = not headed and _share_an_axis(panels)
    panel_mm = width_mm / columns
    row_mm = panel_mm * _SHAPE
    if panels[0].equal and not headed:
        row_mm = panel_mm * _SHAPE_OF_TRACK
    if is_shared:
        row_mm = min(row_mm, max(_LOW_MM, 0.3 * panel_mm))
    height_mm = rows * row_mm
    if headed:
        height_mm += _TITLE_MM
    canvas = _new_canvas(width_mm, height_mm)
    grid = canvas.subplots(rows, columns, squeeze=False, sharex=is_shared)
    places = list(grid.flatten("C" if headed else "F"))
    for place, panel in zip(places, panels, strict=False):
        _draw(place, panel, titled=headed or len(panels) > 1)
    for place in places[len(panels) :]:
        place.remove()
    if is_shared:
        for column in grid.T:
            _label_lowest([place for place in column if place in canvas.axes])
    return canvas


def _share_an_axis(panels: Sequence[Panel]) -> bool:
    """Return whether panels have the same horizontal axis."""
    axes = {(panel.x_label, panel.x_scale) for panel in panels}
    return len(panels) > 1 and len(axes) == 1


def _new_canvas(width_mm: float, height_mm: float) -> "Canvas":
    """Return an empty figure of a size."""
    from matplotlib import figure as drawing
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    class Shown(drawing.Figure):
        """A figure that a notebook shows by itself."""

        def _repr_png_(self) -> bytes:
            stream = BytesIO()
            self.savefig(stream, format="png", dpi=150)
            return stream.getvalue()

    size_in = (width_mm / _MM_PER_INCH, height_mm / _MM_PER_INCH)
    canvas = Shown(figsize=size_in, layout="constrained")
    # The label of the last tick is half beyond its axis.
    canvas.set_layout_engine("constrained", w_pad=_PAD_IN)
    FigureCanvasAgg(canvas)
    return canvas


def _label_lowest(column: Sequence["Axes"]) -> None:
    """Label the shared axis below the lowest of the panels of a column."""
    *others, lowest = column
    for axes in others:
        axes.set_xlabel("")
    lowest.tick_params(labelbottom=True)


def _add_legend(canvas: "Canvas", figure: Figure) -> None:
    """Write the legend below the panels, in as many columns as there is room for, and make the figure higher by it."""
    entries = list(figure.legend)
    if any(ends_of_track(panel) for panel in figure.panels):
        entries += [(f"{REFERENCE} {name}", name) for name in ("start", "end")]
    handles = [_key(style, meaning) for style, meaning in entries]
    for count in range(min(len(handles), 6), 0, -1):
        legend = canvas.legend(
            handles=handles, loc="outside lower center", ncols=count, frameon=False
        )
        space = legend.get_window_extent()
        if space.width <= canvas.bbox.width or count == 1:
            canvas.set_figheight(canvas.get_figheight() + space.height / canvas.dpi)
            break
        legend.remove()


def _key(style: str, meaning: str) -> "Patch | Line2D":
    """Return the legend key of a style."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if style.startswith(_BAND):
        return Patch(label=meaning, alpha=0.15, **_look(style.removeprefix(_BAND)))
    return Line2D([], [], label=meaning, **_look(style))


def _fit_titles(canvas: "Canvas") -> None:
    """Write all titles smaller if one reaches the panel to its right, or the edge."""
    canvas.draw_without_rendering()
    begins = [axes.get_position().x0 for axes in canvas.axes]
    shares = [1.0]
    for axes in canvas.axes:
        place = axes.get_position()
        text = axes.set_title(axes.get_title(loc="left"), loc="left")
        edge = min((begin for begin in begins if begin > place.x1), default=1.0)
        room = (edge - place.x0) * canvas.bbox.width - 2.0
        shares.append(room / max(text.get_window_extent().width, room))
    size = min(shares) * _STYLE["axes.titlesize"]
    for axes in canvas.axes:
        axes.set_title(axes.get_title(loc="left"), loc="left", fontsize=size)


def _grid(count: int, width_mm: float, *, headed: bool) -> tuple[int, int]:
    """Return the numbers of rows and columns of panels."""
    columns = min(count, _PANELS_IN_A_ROW)
    if not headed:
        columns = _columns_on_paper(count, width_mm)
    return math.ceil(count / columns), columns


def _columns_on_paper(count: int, width_mm: float) -> int:
    """Return the number of columns of panels in a figure without a title."""
    if width_mm < _WIDE_MM:
        if count > 4 and width_mm > 80.0:
            return 2
        return 1
    if count in (4, 6):
        return 2
    if count == 12 and width_mm >= 150.0:
        return 4
    return min(count, _PANELS_IN_A_ROW)


def _draw(axes: "Axes", panel: Panel, *, titled: bool) -> None:
    """Draw a panel; one that is alone has its title at the vertical axis."""
    for curve in panel.curves:
        _draw_curve(axes, curve)
    for name, (x, y) in ends_of_track(panel).items():
        axes.plot([x], [y], **_look(f"{REFERENCE} {name}"))
    for level in panel.levels:
        axes.axhline(level, **_look(LIMIT))
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
    across = _different_values(curve.x for curve in panel.curves)
    is_log = panel.x_scale == "log" and _has_positive(across)
    axes.set(xscale="log" if is_log else "linear")
    _plain_ticks(axes.xaxis, across, is_log=is_log, named=True)
    down = _different_values(curve.y for curve in panel.curves)
    is_log = panel.y_scale == "log" and _has_positive(down)
    axes.set(yscale="log" if is_log else "linear")
    _plain_ticks(axes.yaxis, down, is_log=is_log, named=False)


def _draw_curve(axes: "Axes", curve: Curve) -> None:
    look = _look(curve.style)
    if curve.band is not None:
        axes.fill_between(curve.x, *curve.band, color=look["color"], alpha=0.15, linewidth=0.0)
    if curve.points:
        look = {"marker": "o", **look, "linestyle": "none"}
    axes.plot(curve.x, curve.y, **look)


def _different_values(values: "Iterable[Floats]") -> "Floats":
    return np.unique(np.concatenate([np.empty(0), *values]))


def _has_positive(values: "Floats") -> bool:
    """Return whether values can be on a logarithmic axis, on which matplotlib fails without a positive one."""
    return bool((values > 0.0).any())


def _plain_ticks(axis: "Axis", values: "Floats", *, is_log: bool, named: bool) -> None:
    """Write ticks without powers of ten; named: on a logarithmic axis they are the values, if these are few."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    if is_log:
        low, high = axis.get_view_interval()
        if named and len(values) <= _MOST_TICKS:
            axis.set_major_locator(FixedLocator(list(values)))
        elif high < _SHORT * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=_MOST_TICKS))
        else:
            axis.set_major_locator(LogLocator(subs=(1.0,), numticks=_MOST_TICKS))
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_plain))


def _plain(value: float, _place: int) -> str:
    """Write the label of a tick without a power of ten, where that stays short."""
    text = f"{value:g}"
    if value == 0.0 or 1e-6 < abs(value) < 1e7:
        text = np.format_float_positional(float(f"{value:.9g}"), trim="-")
    return text.replace("-", "\N{MINUS SIGN}")


def _look(style: str) -> dict[str, Any]:
    """Join the looks of the words of a style: those of the style sheet, and what they have on paper alone."""
    look: dict[str, Any] = {}
    for word in style.split():
        stroke = strokes().get(word)
        if stroke is not None and stroke.colour is not None:
            look["color"] = stroke.colour
        if stroke is not None and stroke.dashes is not None:
            look["linestyle"] = (0, stroke.dashes) if stroke.dashes else "-"
        look |= _ON_PAPER.get(word, {})
    return look
