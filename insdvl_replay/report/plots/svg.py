"""Panels as SVG: text stays text, colours and dashes are classes, and the same panel gives the same characters."""

import math
import re
from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import visible
from insdvl_replay.report.plots.axis import Axis, limits
from insdvl_replay.report.plots.envelope import band_envelope, envelope, shared_columns, without_standstill
from insdvl_replay.report.plots.panel import Band, Curve, Figure, Panel

WIDTH: Final = 360.0
HEIGHT: Final = 210.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 48.0, 10.0, 26.0, 36.0
_TICKS_X, _TICKS_Y = 6, 5
_TICKS_WHOLE: Final = 12
_PIXEL: Final = 0.7
_POINT: Final = 3.0
COLUMNS: Final = 3
"""Panels beside each other in a picture."""
_CLASS: Final = re.compile(r'<svg class="[^"]*"')
_LEGEND: Final = 28.0
_ENTRY: Final = 170.0
_LABEL, _ABOVE = 11.0, 4.0
"""Height of a name at the end of a line, and how far above the line it stands."""
_FAR: Final = 1e4
"""Lines that leave the paper, to infinity even, end here."""


def panel_height(panel: Panel) -> float:
    """Return the height of a panel that is `WIDTH` wide."""
    return WIDTH if panel.equal and not panel.low else HEIGHT


def panel_svg(panel: Panel) -> str:
    """Draw a panel."""
    height = panel_height(panel)
    x_axis, y_axis = _axes(panel, height)
    width, tall = WIDTH - _LEFT - _RIGHT, height - _TOP - _BOTTOM
    plot = f'x="{_LEFT:g}" y="{_TOP:g}" width="{width:g}" height="{tall:g}"'
    kind = "tall panel" if panel.equal and not panel.low else "panel"
    title = escape(panel.title)
    return "".join(
        [
            f'<svg class="{kind}" viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{title}">',
            f'<text class="title" x="{_LEFT:g}" y="15">{title}</text>',
            *_shades(panel, x_axis, y_axis),
            *_grid(panel, x_axis, y_axis),
            f'<svg {plot} viewBox="{_LEFT:g} {_TOP:g} {width:g} {tall:g}">',
            *_content(panel, x_axis, y_axis),
            "</svg>",
            *_labels(panel, x_axis, y_axis),
            f'<rect class="frame" {plot}/>',
            "</svg>",
        ]
    )


def sheet_svg(figure: Figure) -> bytes:
    """Draw the panels of a figure in one picture, in the colours of pages; the same figure gives the same bytes."""
    rows = [figure.panels[first : first + COLUMNS] for first in range(0, len(figure.panels), COLUMNS)]
    heights = [max(map(panel_height, row)) for row in rows]
    width, tall = WIDTH * min(COLUMNS, len(figure.panels)), sum(heights)
    entries = int(width // _ENTRY)
    height = tall + _LEGEND * math.ceil(len(figure.legend) / entries)
    style = files("insdvl_replay.report").joinpath("page.css").read_text("utf-8")
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f"<title>{escape(visible(figure.title))}</title>",
        f"<style>\n{style}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
        *_panels(rows, heights),
        *_legend(figure, tall + _LEGEND / 2.0, entries),
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


def _legend(figure: Figure, top: float, entries: int) -> Iterator[str]:
    for number, (style, label) in enumerate(figure.legend):
        x, y = _ENTRY * (number % entries) + 48.0, top + _LEGEND * (number // entries)
        yield f'<path class="line {style}" d="M{x:g} {y - 4:g}h36"/>'
        yield f'<text x="{x + 44:g}" y="{y:g}">{escape(visible(label))}</text>'


def _axes(panel: Panel, height: float) -> tuple[Axis, Axis]:
    """Find both axes; on equal ones the shorter span grows until a unit is as long in both directions."""
    x_all = [curve.x for curve in panel.curves] + [band.x for band in panel.bands]
    y_all = [curve.y for curve in panel.curves] + [edge for band in panel.bands for edge in (band.low, band.high)]
    y_all.append(np.array(panel.levels))
    x_low, x_high = _x_limits(panel, np.concatenate([np.empty(0), *x_all]))
    y_low, y_high = panel.y_limits or limits(np.concatenate(y_all), panel.y_scale)
    right, bottom = WIDTH - _RIGHT, height - _BOTTOM
    if panel.equal:
        unit = max((x_high - x_low) / (right - _LEFT), (y_high - y_low) / (bottom - _TOP))
        x_low, x_high = _widened(x_low, x_high, unit * (right - _LEFT))
        y_low, y_high = _widened(y_low, y_high, unit * (bottom - _TOP))
    x_axis = Axis(x_low, x_high, _LEFT, right, panel.x_scale, whole=panel.x_whole)
    return x_axis, Axis(y_low, y_high, bottom, _TOP, panel.y_scale)


def _x_limits(panel: Panel, x: Floats) -> tuple[float, float]:
    """Find what the horizontal axis shows; a logarithmic one ends with its values, or half of it would be empty."""
    known = x[np.isfinite(x) & (x > 0.0)]
    if panel.x_scale == "log" and len(known) and known.min() < known.max():
        return float(known.min()), float(known.max())
    return limits(x, panel.x_scale)


def _widened(low: float, high: float, span: float) -> tuple[float, float]:
    middle = (low + high) / 2.0
    return middle - span / 2.0, middle + span / 2.0


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


def _shades(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw what lies behind: one path for each style, so that a page of many panels stays small."""
    for style in dict.fromkeys(shade.style for shade in panel.shades):
        path = []
        for shade in panel.shades:
            if shade.style == style:
                begin, end = np.clip(x_axis.place(np.array([shade.begin, shade.end])), x_axis.start, x_axis.end)
                path.append(
                    f"M{begin:.1f} {y_axis.end:.1f}H{max(end, begin + 1.0):.1f}V{y_axis.start:.1f}H{begin:.1f}Z"
                )
        yield f'<path class="shade {style}" d="{"".join(path)}"/>'


def _labels(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Write names at the ends of lines, apart where lines end together."""
    ends = []
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


def _content(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    columns = shared_columns(len(panel.curves))
    for band in panel.bands:
        yield f'<path class="band {band.style}" d="{_band_path(band, x_axis, y_axis, columns)}"/>'
    for place in y_axis.place(np.array(panel.levels)):
        yield f'<path class="line limit" d="M{x_axis.start:.1f} {place:.1f}H{x_axis.end:.1f}"/>'
    for curve in panel.curves:
        kind = "points" if curve.points else "line"
        yield f'<path class="{kind} {curve.style}" d="{_curve_path(panel, curve, x_axis, y_axis, columns)}"/>'


def _band_path(band: Band, x_axis: Axis, y_axis: Axis, columns: int) -> str:
    known = np.isfinite(band.low) & np.isfinite(band.high)
    if not known.any():
        return ""
    x, low, high = band_envelope(band.x[known], band.low[known], band.high[known], columns)
    there = _line(x_axis.place(x), y_axis.place(high))
    back = _line(x_axis.place(x)[::-1], y_axis.place(low)[::-1])
    return f"{there}L{back[1:]}Z"


def _curve_path(panel: Panel, curve: Curve, x_axis: Axis, y_axis: Axis, columns: int) -> str:
    x, y = x_axis.place(curve.x), y_axis.place(curve.y)
    if curve.points:
        return _points(x, y)
    return _line(*(without_standstill(x, y, _PIXEL) if panel.equal else envelope(x, y, columns)))


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
    """Write a number behind another: a minus separates them, too."""
    return _tenths(number) if number < 0 else f" {_tenths(number)}"


def _points(x: Floats, y: Floats) -> str:
    """Write each occupied cell of a coarse grid as one point, a line of no length."""
    known = np.isfinite(x) & np.isfinite(y)
    cells = np.unique(np.round(np.column_stack([x[known], y[known]]) / _POINT), axis=0) * _POINT
    return "".join(f"M{across:.1f} {down:.1f}h0" for across, down in cells.tolist())
