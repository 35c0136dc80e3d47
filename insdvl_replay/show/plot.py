"""Panels as SVG: text stays text, colours and dashes are classes, and the same panel gives the same characters.

Drawn by hand, since a page has dozens of panels: thirty take 0.05 s. Long series are made short without hiding peaks.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from itertools import pairwise
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import visible
from insdvl_replay.core.result import Band, Curve, Figure, Panel, Scale

WIDTH: Final = 360.0
HEIGHT: Final = 210.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 48.0, 10.0, 26.0, 36.0
_TICKS_X, _TICKS_Y, _TICKS_WHOLE = 6, 5, 12
_PIXEL: Final = 0.7
_POINT: Final = 3.0
_LABEL, _ABOVE = 11.0, 4.0
"""Height of a name at the end of a line, and how far above the line it is."""
_FAR: Final = 1e4
"""Lines are cut at this distance from the panel."""


def style_sheet() -> str:
    """Return the style sheet of pages and pictures."""
    return files("insdvl_replay.show").joinpath("page.css").read_text("utf-8")


# --- An axis: its limits, its ticks and their labels.

_STEPS: Final = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0)
"""Of ticks, times a power of ten."""
_MARGIN: Final = 0.05
"""Share of the span that stays free at either end."""
_SMALLEST_SPAN: Final = 1e-9
"""Share of the size of values below which they are all the same."""
_LARGEST: Final = 1e30
"""Larger values, of a diverged filter, are not shown."""


@dataclass(frozen=True)
class Axis:
    """From values to places on the paper."""

    low: float  # values at the ends
    high: float
    start: float  # places of the ends
    end: float
    scale: Scale = "linear"
    whole: bool = False  # ticks are whole numbers

    def place(self, values: Floats) -> Floats:
        """Return the places of values; NaN where a logarithmic axis has none."""
        low, high = self.low, self.high
        if self.scale == "log":
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        places: Floats = self.start + (values - low) / (high - low) * (self.end - self.start)
        return places

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return the places of at most ``count`` ticks, and their labels."""
        if self.scale == "log":
            values = _decades(self.low, self.high, count)
            powers = np.rint(np.log10(values)).astype(int).tolist()
            labels = [f"{10.0**power:g}" if -4 < power < 5 else f"1e{power}" for power in powers]
        else:
            step, values = _round_values(self.low, self.high, count, whole=self.whole)
            rounded = (round(value / step) * step for value in values)
            labels = [f"{value:.6g}".replace("-", "\N{MINUS SIGN}") for value in rounded]
        inside = (values >= self.low) & (values <= self.high)
        places = self.place(values).tolist()
        return [(place, label) for place, label, shown in zip(places, labels, inside.tolist(), strict=True) if shown]


def limits(values: Floats, scale: Scale = "linear") -> tuple[float, float]:
    """Return the limits of an axis with a margin; 0 and 1, or 1 and 10, without values."""
    known = values[(np.abs(values) < _LARGEST) & ((values > 1.0 / _LARGEST) | (scale == "linear"))]
    if not len(known):
        return (0.0, 1.0) if scale == "linear" else (1.0, 10.0)
    low, high = float(known.min()), float(known.max())
    if scale == "log":
        return 10.0 ** math.floor(math.log10(low)), 10.0 ** (math.floor(math.log10(high)) + 1)
    if high - low <= _SMALLEST_SPAN * max(abs(low), abs(high)):
        half = abs(high) / 2.0 or 1.0
        return low - half, high + half
    air = _MARGIN * (high - low)
    return low - air, high + air


def _round_values(low: float, high: float, count: int, *, whole: bool) -> tuple[float, Floats]:
    """Find the smallest step that needs at most ``count`` intervals, smaller if it shows one value, and its values."""
    smallest = max((high - low) / count, 1.0 if whole else 0.0)
    steps = [share * 10.0 ** math.floor(math.log10(smallest)) for share in _STEPS]
    fitting = [
        step for before, step in pairwise([0.0, *steps]) if before < smallest and (step.is_integer() or not whole)
    ]
    for step in reversed(fitting):
        values = np.arange(math.floor(low / step), math.ceil(high / step) + 1, dtype=np.float64) * step
        if np.sum((values >= low) & (values <= high)) > 1:
            break
    return step, values


def _decades(low: float, high: float, count: int) -> Floats:
    """Find some powers of ten, equally far apart: at multiples of their distance, where that loses none."""
    first, last = math.ceil(math.log10(low)), math.floor(math.log10(high))
    number = last - first + 1
    shown = min(count, math.ceil(number / (number // (count + 1) + 1)))
    if shown < 2:
        return np.asarray(10.0 ** np.arange(first, last + 1))
    stride = (number - 1) // (shown - 1)
    if stride * shown < number:
        stride = number // shown
    fewest, most = max(number - stride * shown, 0), min(number - stride * (shown - 1), stride)
    offset = -first % stride
    begin = first + (offset if fewest <= offset < most else fewest)
    return np.asarray(10.0 ** np.arange(begin, last + 1, stride))


# --- Long series are reduced to the lowest and highest value of each column of the panel.

COLUMNS: Final = 150
"""Columns of a panel: about two screen pixels each."""
_FEW: Final = 4
"""Up to this many curves have all columns; more curves share them, to limit the size of the page."""


def envelope(x: Floats, y: Floats, columns: int = COLUMNS) -> tuple[Floats, Floats]:
    """Keep the lowest and the highest value of each column, where they are; x does not decrease.

    NaN remains where all of a column is missing. Lines of up to two points for each column are left as they are.
    """
    if len(x) <= 2 * columns:
        return x, y
    column = _column_of(x, columns)
    known = np.flatnonzero(np.isfinite(y))
    by_size = known[np.lexsort((y[known], column[known]))]
    begins = np.diff(column[by_size], prepend=-1.0) > 0.0
    lowest, highest = by_size[begins], by_size[np.roll(begins, -1)]
    missing = np.unique(column, return_index=True)[1]
    missing = missing[~np.isin(column[missing], column[known])]
    kept = np.unique(np.concatenate([lowest, highest, missing]))
    return x[kept], y[kept]


def band_envelope(x: Floats, low: Floats, high: Floats, columns: int = COLUMNS) -> tuple[Floats, Floats, Floats]:
    """Keep the lowest of the lower and the highest of the upper edge of a band in each column."""
    if len(x) <= columns:
        return x, low, high
    starts = np.flatnonzero(np.diff(_column_of(x, columns), prepend=-1.0))
    ends = np.append(starts[1:], len(x)) - 1
    return (x[starts] + x[ends]) / 2.0, np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


def without_standstill(x: Floats, y: Floats, step: float) -> tuple[Floats, Floats]:
    """Keep the first point of each stay in a cell of a grid ``step`` wide, and the last point of all."""
    cells = np.floor(np.column_stack([x, y]) / step)
    moved = np.ones(len(x), dtype=bool)
    moved[1:-1] = (cells[1:-1] != cells[:-2]).any(axis=1)
    return x[moved], y[moved]


def _column_of(x: Floats, columns: int) -> Floats:
    column: Floats = np.floor((x - x[0]) * (columns / (x[-1] - x[0])))
    return column.clip(max=columns - 1.0)


# --- Panels.


def panel_svg(panel: Panel) -> str:
    """Draw a panel."""
    tall = panel.equal and not panel.low
    return _panel(panel, f'class="{"tall " if tall else ""}panel"')


def _height(panel: Panel) -> float:
    return WIDTH if panel.equal and not panel.low else HEIGHT


def _panel(panel: Panel, place: str) -> str:
    height = _height(panel)
    x_axis, y_axis = _axes(panel, height)
    width, tall = WIDTH - _LEFT - _RIGHT, height - _TOP - _BOTTOM
    plot = f'x="{_LEFT:g}" y="{_TOP:g}" width="{width:g}" height="{tall:g}"'
    title = escape(panel.title)
    return "".join(
        [
            f'<svg {place} viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{title}">',
            f'<text class="title" x="{_LEFT:g}" y="15">{title}</text>',
            *_shades(panel, x_axis, y_axis),
            *_grid(panel, x_axis, y_axis),
            f'<svg {plot} viewBox="{_LEFT:g} {_TOP:g} {width:g} {tall:g}">',
            *_content(panel, x_axis, y_axis),
            "</svg>",
            *_names(panel, x_axis, y_axis),
            f'<rect class="frame" {plot}/>',
            "</svg>",
        ]
    )


def _axes(panel: Panel, height: float) -> tuple[Axis, Axis]:
    """Find both axes; on equal ones the shorter span grows until a unit is as long in both directions."""
    x = np.concatenate([np.empty(0), *(curve.x for curve in panel.curves), *(band.x for band in panel.bands)])
    edges = [edge for band in panel.bands for edge in (band.low, band.high)]
    y = np.concatenate([*(curve.y for curve in panel.curves), *edges, np.array(panel.levels)])
    x_low, x_high = limits(x, panel.x_scale)
    known = x[np.isfinite(x) & (x > 0.0)]
    if panel.x_scale == "log" and len(known) and known.min() < known.max():
        x_low, x_high = float(known.min()), float(known.max())  # with a margin, half of the axis would be empty
    y_low, y_high = panel.y_limits or limits(y, panel.y_scale)
    right, bottom = WIDTH - _RIGHT, height - _BOTTOM
    if panel.equal:
        unit = max((x_high - x_low) / (right - _LEFT), (y_high - y_low) / (bottom - _TOP))
        x_low, x_high = _widened(x_low, x_high, unit * (right - _LEFT))
        y_low, y_high = _widened(y_low, y_high, unit * (bottom - _TOP))
    x_axis = Axis(x_low, x_high, _LEFT, right, panel.x_scale, whole=panel.x_whole)
    return x_axis, Axis(y_low, y_high, bottom, _TOP, panel.y_scale)


def _widened(low: float, high: float, span: float) -> tuple[float, float]:
    middle = (low + high) / 2.0
    return middle - span / 2.0, middle + span / 2.0


def _shades(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw one path for each style, so that a page of many panels stays small."""
    paths: dict[str, str] = {}
    for shade in panel.shades:
        begin, end = np.clip(x_axis.place(np.array([shade.begin, shade.end])), x_axis.start, x_axis.end)
        stretch = f"M{begin:.1f} {y_axis.end:.1f}H{max(end, begin + 1.0):.1f}V{y_axis.start:.1f}H{begin:.1f}Z"
        paths[shade.style] = paths.get(shade.style, "") + stretch
    yield from (f'<path class="shade {style}" d="{path}"/>' for style, path in paths.items())


def _grid(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw ticks as lines across the panel, with their labels outside."""
    bottom, top, left, right = y_axis.start, y_axis.end, x_axis.start, x_axis.end
    for place, label in x_axis.ticks(_TICKS_WHOLE if panel.x_whole else _TICKS_X):
        yield f'<path class="grid" d="M{place:.1f} {top:.1f}V{bottom:.1f}"/>'
        yield f'<text class="tick" x="{place:.1f}" y="{bottom + 13:.1f}" text-anchor="middle">{label}</text>'
    for place, label in y_axis.ticks(_TICKS_Y):
        yield f'<path class="grid" d="M{left:.1f} {place:.1f}H{right:.1f}"/>'
        yield f'<text class="tick" x="{left - 5:.1f}" y="{place + 3.5:.1f}" text-anchor="end">{label}</text>'
    yield f'<text class="label" x="{right:.1f}" y="{bottom + 29:.1f}" text-anchor="end">{escape(panel.x_label)}</text>'


def _content(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    columns = COLUMNS * _FEW // max(len(panel.curves), _FEW)
    for band in panel.bands:
        yield f'<path class="band {band.style}" d="{_band_path(band, x_axis, y_axis, columns)}"/>'
    for place in y_axis.place(np.array(panel.levels)):
        yield f'<path class="line limit" d="M{x_axis.start:.1f} {place:.1f}H{x_axis.end:.1f}"/>'
    for curve in panel.curves:
        x, y = x_axis.place(curve.x), y_axis.place(curve.y)
        if curve.points:
            path = _points(x, y)
        else:
            path = _line(*(without_standstill(x, y, _PIXEL) if panel.equal else envelope(x, y, columns)))
        yield f'<path class="{"points" if curve.points else "line"} {curve.style}" d="{path}"/>'


def _names(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Write names at the ends of lines, apart where lines end together."""
    ends: list[tuple[float, Curve]] = []
    for curve in panel.curves:
        known = np.flatnonzero(np.isfinite(curve.x) & np.isfinite(curve.y))
        if curve.label and len(known):
            place = float(y_axis.place(curve.y[known[-1:]])[0]) - _ABOVE
            ends.append((min(max(place, y_axis.end + _LABEL), y_axis.start - _ABOVE), curve))
    lowest = -math.inf
    for place, curve in sorted(ends, key=lambda end: end[0]):
        lowest = max(place, lowest + _LABEL)
        x = float(x_axis.place(curve.x[np.isfinite(curve.x)][-1:])[0])
        anchor = "end" if x > (x_axis.start + x_axis.end) / 2.0 else "start"
        yield (
            f'<text class="name {curve.style.split()[0]}" x="{min(x, x_axis.end - 3.0):.1f}" y="{lowest:.1f}" '
            f'text-anchor="{anchor}">{escape(visible(curve.label))}</text>'
        )


# --- Paths.


def _band_path(band: Band, x_axis: Axis, y_axis: Axis, columns: int) -> str:
    known = np.isfinite(band.low) & np.isfinite(band.high)
    if not known.any():
        return ""
    x, low, high = band_envelope(band.x[known], band.low[known], band.high[known], columns)
    there = _line(x_axis.place(x), y_axis.place(high))
    back = _line(x_axis.place(x)[::-1], y_axis.place(low)[::-1])
    return f"{there}L{back[1:]}Z"


def _line(x: Floats, y: Floats) -> str:
    """Write a line in tenths of a pixel, each step from the place before; it is interrupted where a place is missing.

    Steps take half the characters that places do, and on a page they are most of all.
    """
    known = ~(np.isnan(x) | np.isnan(y))
    tenths = np.rint(10.0 * np.clip(np.column_stack([x, y])[known], -_FAR, _FAR)).astype(np.int64)
    begins = np.diff(np.flatnonzero(known), prepend=-2) > 1
    steps = np.diff(tenths, axis=0, prepend=0)
    words, drawing = [], False
    for (across, down), (right, below), begin in zip(tenths.tolist(), steps.tolist(), begins.tolist(), strict=True):
        if begin:
            words.append(f"M{_tenths(across)}{_behind(down)}")
        elif not drawing:
            words.append(f"l{_tenths(right)}{_behind(below)}")
        elif right or below:
            words.append(f"{_behind(right)}{_behind(below)}")
        drawing = not begin
    return "".join(words)


def _tenths(number: int) -> str:
    """Write a number of tenths in as few characters as there are: ``-.3``, ``12``, ``4.5``."""
    whole, rest = divmod(abs(number), 10)
    text = f"{whole or ''}.{rest}" if rest else f"{whole}"
    return f"-{text}" if number < 0 else text


def _behind(number: int) -> str:
    """Write a number after another: a minus separates them, too."""
    return _tenths(number) if number < 0 else f" {_tenths(number)}"


def _points(x: Floats, y: Floats) -> str:
    """Write each occupied cell of a coarse grid as one point, a line of no length."""
    known = np.isfinite(x) & np.isfinite(y)
    cells = np.unique(np.round(np.column_stack([x[known], y[known]]) / _POINT), axis=0) * _POINT
    return "".join(f"M{across:.1f} {down:.1f}h0" for across, down in cells.tolist())


# --- A picture of a figure, as a file of its own.

PANELS_IN_A_ROW: Final = 3
"""Panels next to each other in a picture."""
_LEGEND, _ENTRY = 28.0, 170.0
"""Height of a line of the legend, and width of an entry."""


def sheet_svg(figure: Figure) -> bytes:
    """Draw the panels of a figure in one picture, in the colours of pages; the same figure gives the same bytes."""
    panels, top = [], 0.0
    for first in range(0, len(figure.panels), PANELS_IN_A_ROW):
        row = figure.panels[first : first + PANELS_IN_A_ROW]
        for column, panel in enumerate(row):
            place = f'x="{column * WIDTH:g}" y="{top:g}" width="{WIDTH:g}" height="{_height(panel):g}"'
            panels.append(_panel(panel, place))
        top += max(map(_height, row))
    width = WIDTH * min(PANELS_IN_A_ROW, len(figure.panels))
    entries = int(width // _ENTRY)
    legend = []
    for number, (style, label) in enumerate(figure.legend):
        x, y = _ENTRY * (number % entries) + 48.0, top + _LEGEND / 2.0 + _LEGEND * (number // entries)
        legend.append(f'<path class="line {style}" d="M{x:g} {y - 4:g}h36"/>')
        legend.append(f'<text x="{x + 44:g}" y="{y:g}">{escape(visible(label))}</text>')
    height = top + _LEGEND * math.ceil(len(figure.legend) / entries)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f"<title>{escape(visible(figure.title))}</title>",
        f"<style>\n{style_sheet()}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
        *panels,
        *legend,
        "</svg>",
        "",
    ]
    return "\n".join(lines).encode()
