"""Panels as SVG: text stays text, colours and dashes are classes, and the same panel gives the same characters.

Drawn by hand, since a page has dozens of panels: thirty take 0.05 s. Long series are made short without hiding peaks.

Lines are in counts: whole numbers of a decimal step of the data, placed on the paper by a ``transform``. So each path
has the values of its samples to the printed digits, which ``cursor.js`` reads, and zooming changes the transform alone.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, Integers
from insdvl_replay.core.errors import visible
from insdvl_replay.document.looks import style_sheet
from insdvl_replay.document.parts import (
    POINT,
    REFERENCE,
    Curve,
    Figure,
    Panel,
    Scale,
)

WIDTH: Final = 360.0
HEIGHT: Final = 210.0
_LEFT = 48.0
_RIGHT = 10.0
_TOP = 26.0
_BOTTOM = 36.0
_TICKS_X = 6
_TICKS_Y = 5
_TICKS_WHOLE = 12
_PIXEL: Final = 0.7
_POINT: Final = 3.0
# Height of a name at the end of a line, and how far above the line it is.
_LABEL = 11.0
_ABOVE = 4.0
_FAR: Final = 1e7  # Counts are cut here: thousands of heights of the panel, and about what a browser's numbers hold.
# An axis is at least ten to this power counts long.
_DIGITS_X = 4
_DIGITS_Y = 3
# On a logarithmic axis values have three digits, and a decade has enough counts to tell them apart.
_LOG_DIGITS = 3
_LOG_COUNTS = 5000
# Seconds in the unit of an axis: values at the cursor are in seconds, as in files.
_SECONDS: Final = {"time [min]": 60.0, "time [h]": 3600.0}


# --- An axis: its limits, its ticks and their labels.

_STEPS: Final = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0)  # Of ticks, times a power of ten.
_MARGIN: Final = 0.05  # Share of the span that stays free at either end.
_SMALLEST_SPAN: Final = 1e-9  # Share of the size of values below which they are all the same.
_LARGEST: Final = 1e30  # Larger values, of a diverged filter, are not shown.


@dataclass(frozen=True)
class Axis:
    """From values to places on the paper."""

    low: float  # values at the ends
    high: float
    start: float  # places of the ends
    end: float
    scale: Scale = "linear"
    whole: bool = False  # ticks are whole numbers
    unit: float = 1.0  # counts are of values times this
    digits: int = _DIGITS_Y

    @property
    def decimals(self) -> int:
        """Decimals of a count, for a linear axis."""
        span = max(self.high - self.low, 1e-3 * max(abs(self.low), abs(self.high))) * self.unit
        if self.whole:
            return 0
        decimals = self.digits - math.floor(math.log10(span))
        if -self.digits <= decimals < 0:
            return 0
        return decimals

    def counts(self, values: Floats) -> Floats:
        """Return values as whole numbers of counts; NaN where a logarithmic axis has none."""
        with np.errstate(over="ignore"):
            if self.scale == "log":
                logs = np.log10(np.where(values > 0.0, np.minimum(values, _LARGEST), np.nan))
                powers = np.floor(logs)
                digits = np.rint(10.0 ** (logs - powers + _LOG_DIGITS - 1))
                numbers = _LOG_COUNTS * (np.log10(digits) + powers - _LOG_DIGITS + 1)
            else:
                numbers = values * (self.unit * 10.0**self.decimals)
        counts: Floats = np.rint(np.clip(numbers, -_FAR, _FAR))
        return counts

    @property
    def transform(self) -> tuple[float, float]:
        """Return scale and offset from counts to places."""
        if self.scale == "log":
            low = math.log10(self.low)
            scale = (self.end - self.start) / (math.log10(self.high) - low)
            return scale / _LOG_COUNTS, self.start - low * scale
        scale = (self.end - self.start) / (self.high - self.low)
        return scale / (self.unit * 10.0**self.decimals), self.start - self.low * scale

    @property
    def reading(self) -> str:
        """How ``cursor.js`` writes a count: decimals and unit, or ``log``."""
        if self.scale == "log":
            return "log"
        return f"{self.decimals} {self.unit:g}"

    def place(self, values: Floats) -> Floats:
        """Return the places of values; NaN where a logarithmic axis has none."""
        low = self.low
        high = self.high
        if self.scale == "log":
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low = math.log10(low)
            high = math.log10(high)
        places: Floats = self.start + (values - low) / (high - low) * (self.end - self.start)
        return places

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return the places of at most ``count`` ticks, and their labels."""
        if self.scale == "log":
            values = _decades(self.low, self.high, count)
            powers = np.rint(np.log10(values)).astype(int).tolist()
            labels = [_power_of_ten(power) for power in powers]
        else:
            step, values = _round_values(self.low, self.high, count, whole=self.whole)
            labels = [_multiple(value, step) for value in values.tolist()]
        ticks = zip(values.tolist(), self.place(values).tolist(), labels, strict=True)
        return [(place, label) for value, place, label in ticks if self.low <= value <= self.high]


def _power_of_ten(power: int) -> str:
    if -4 < power < 5:
        return f"{10.0**power:g}"
    return f"1e{power}"


def _multiple(value: float, step: float) -> str:
    """Write a multiple of a step, without what a division leaves of it."""
    return f"{round(value / step) * step:.6g}".replace("-", "\N{MINUS SIGN}")


def limits(values: Floats, scale: Scale = "linear") -> tuple[float, float]:
    """Return the limits of an axis with a margin; 0 and 1, or 1 and 10, without values."""
    known = values[(np.abs(values) < _LARGEST) & ((values > 1.0 / _LARGEST) | (scale == "linear"))]
    if not len(known):
        if scale == "linear":
            return (0.0, 1.0)
        return (1.0, 10.0)
    low = float(known.min())
    high = float(known.max())
    if scale == "log":
        return 10.0 ** math.floor(math.log10(low)), 10.0 ** (math.floor(math.log10(high)) + 1)
    if high - low <= _SMALLEST_SPAN * max(abs(low), abs(high)):
        half = abs(high) / 2.0 or 1.0
        return low - half, high + half
    air = _MARGIN * (high - low)
    return low - air, high + air


def _round_values(
    low: float,
    high: float,
    count: int,
    *,
    whole: bool,
) -> tuple[float, Floats]:
    """Find the smallest step that needs at most ``count`` intervals, smaller if it shows one value, and its values."""
    smallest = (high - low) / count
    if whole:
        smallest = max(smallest, 1.0)
    power = 10.0 ** math.floor(math.log10(smallest))
    fitting = []
    for share in _STEPS:
        step = share * power
        if step.is_integer() or not whole:
            fitting.append(step)
        if step >= smallest:
            break
    for step in reversed(fitting):
        first = math.floor(low / step)
        last = math.ceil(high / step)
        values = np.arange(first, last + 1, dtype=np.float64) * step
        if np.sum((values >= low) & (values <= high)) > 1:
            break
    return step, values


def _decades(low: float, high: float, count: int) -> Floats:
    """Find at most ``count`` powers of ten, equally far apart: at multiples of their distance."""
    first = math.ceil(math.log10(low))
    last = math.floor(math.log10(high))
    step = math.ceil((last - first + 1) / count) or 1
    return np.asarray(10.0 ** np.arange(-(-first // step) * step, last + 1, step))


# --- Long series are reduced to the lowest and highest value of each column of the panel.

COLUMNS: Final = 150  # Columns of a panel: about two screen pixels each.
_FEW: Final = 4  # Up to this many curves and bands have all columns. More have fewer, so that a page stays small:
_COARSER: Final = 1.35  # with twice as many, they have all together fewer points.


def envelope(x: Floats, y: Floats, columns: int = COLUMNS) -> Integers:
    """Return the rows with the lowest and the highest value of each column; x does not decrease.

    NaN remains where all of a column is missing. Lines of up to two points for each column are left as they are.
    """
    if len(x) <= 2 * columns:
        return np.arange(len(x))
    column = np.floor((x - x[0]) * (columns / (x[-1] - x[0]))).clip(max=columns - 1.0)
    known = np.flatnonzero(np.isfinite(y))
    by_size = known[np.lexsort((y[known], column[known]))]
    begins = np.diff(column[by_size], prepend=-1.0) > 0.0
    lowest = by_size[begins]
    highest = by_size[np.roll(begins, -1)]
    missing = np.unique(column, return_index=True)[1]
    missing = missing[~np.isin(column[missing], column[known])]
    return np.unique(np.concatenate([lowest, highest, missing]))


def without_standstill(x: Floats, y: Floats, step: float) -> Integers:
    """Return the rows of the first point of each stay in a cell of a grid ``step`` wide, and of the last point."""
    cells = np.floor(np.column_stack([x, y]) / step)
    moved = np.ones(len(x), dtype=bool)
    moved[1:-1] = (cells[1:-1] != cells[:-2]).any(axis=1)
    return np.flatnonzero(moved)


# --- Panels.


Legend = Sequence[tuple[str, str]]  # Style and meaning.


def panel_svg(panel: Panel, legend: Legend = ()) -> str:
    """Draw a panel; the legend names its lines at the cursor."""
    place = 'class="tall panel"' if panel.is_tall else 'class="panel"'
    return _panel(panel, place, dict(legend))


def _height(panel: Panel) -> float:
    if panel.is_tall:
        return WIDTH
    return HEIGHT


def _panel(panel: Panel, place: str, names: Mapping[str, str]) -> str:
    height = _height(panel)
    x_axis, y_axis = _axes(panel, height)
    width = WIDTH - _LEFT - _RIGHT
    tall = height - _TOP - _BOTTOM
    plot = f'x="{_LEFT:g}" y="{_TOP:g}" width="{width:g}" height="{tall:g}"'
    title = escape(panel.title)
    across, left = x_axis.transform
    down, top = y_axis.transform
    parts = [
        f'<svg {place} viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{title}" '
        f'data-x="{x_axis.reading}" data-y="{y_axis.reading}">',
        f'<text class="title" x="{_LEFT:g}" y="15">{title}</text>',
        *_grid(panel, x_axis, y_axis),
        f'<svg {plot} viewBox="{_LEFT:g} {_TOP:g} {width:g} {tall:g}">',
        f'<g transform="matrix({across:.7g} 0 0 1 {left:.7g} 0)">',
        *_shades(panel, x_axis, y_axis),
        "</g>",
        f'<g class="data" transform="matrix({across:.7g} 0 0 {down:.7g} {left:.7g} {top:.7g})">',
        *_content(panel, x_axis, y_axis, names),
        "</g>",
        *_levels(panel, x_axis, y_axis),
        *_marks(panel, x_axis, y_axis),
        "</svg>",
        *_names(panel, x_axis, y_axis),
        f'<rect class="frame" {plot}/>',
        "</svg>",
    ]
    return "".join(parts)


def _axes(panel: Panel, height: float) -> tuple[Axis, Axis]:
    """Find both axes; on equal ones the shorter span grows until a unit is as long in both directions."""
    x_low, x_high = panel.x_limits or _x_limits(panel)
    y_low, y_high = panel.y_limits or _y_limits(panel)
    right = WIDTH - _RIGHT
    bottom = height - _BOTTOM
    digits = _DIGITS_X
    if panel.equal:
        digits = _DIGITS_Y
        unit = max((x_high - x_low) / (right - _LEFT), (y_high - y_low) / (bottom - _TOP))
        x_low, x_high = _widened(x_low, x_high, unit * (right - _LEFT))
        y_low, y_high = _widened(y_low, y_high, unit * (bottom - _TOP))
    x_axis = Axis(
        x_low,
        x_high,
        _LEFT,
        right,
        panel.x_scale,
        whole=panel.x_whole,
        unit=_seconds_of_unit(panel),
        digits=digits,
    )
    return x_axis, Axis(y_low, y_high, bottom, _TOP, panel.y_scale)


def _x_limits(panel: Panel) -> tuple[float, float]:
    """Return the limits across: on a logarithmic axis without a margin, which would leave half of it empty."""
    x = np.concatenate([np.empty(0), *(curve.x for curve in panel.curves)])
    if panel.x_scale == "log":
        known = x[np.isfinite(x) & (x > 0.0)]
        if len(known) and known.min() < known.max():
            return float(known.min()), float(known.max())
    return limits(x, panel.x_scale)


def _y_limits(panel: Panel) -> tuple[float, float]:
    """Return the limits of all that is drawn over the horizontal axis."""
    values = [np.array(panel.levels)]
    for curve in panel.curves:
        values.append(curve.y)
        if curve.band is not None:
            values += curve.band
    return limits(np.concatenate(values), panel.y_scale)


def _seconds_of_unit(panel: Panel) -> float:
    if panel.x_scale == "log":
        return 1.0
    return _SECONDS.get(panel.x_label, 1.0)


def _widened(low: float, high: float, span: float) -> tuple[float, float]:
    middle = (low + high) / 2.0
    return middle - span / 2.0, middle + span / 2.0


def _shades(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw one path for each style, so that a page of many panels stays small."""
    paths: dict[str, str] = {}
    pixel = 1.0 / x_axis.transform[0]
    for shade in panel.shades:
        begin, end = x_axis.counts(np.array([shade.begin, shade.end])).tolist()
        stretch = f"M{begin:.0f} {y_axis.end:g}H{max(end, begin + pixel):.0f}V{y_axis.start:g}H{begin:.0f}Z"
        paths[shade.style] = paths.get(shade.style, "") + stretch
    for style, path in paths.items():
        yield f'<path class="shade {style}" d="{path}"/>'


def _grid(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw ticks as lines across the panel, with their labels outside."""
    bottom = y_axis.start
    top = y_axis.end
    left = x_axis.start
    right = x_axis.end
    across = x_axis.ticks(_TICKS_WHOLE if panel.x_whole else _TICKS_X)
    lines = [f"M{place:.1f} {top:g}V{bottom:g}" for place, _ in across]
    yield f'<g class="ticks"><path d="{"".join(lines)}"/>'
    for place, label in across:
        yield f'<text x="{place:.1f}" y="{bottom + 13:g}">{label}</text>'
    down = y_axis.ticks(_TICKS_Y)
    lines = [f"M{left:g} {place:.1f}H{right:g}" for place, _ in down]
    yield f'</g><g class="scale"><path d="{"".join(lines)}"/>'
    for place, label in down:
        yield f'<text x="{left - 5:g}" y="{place + 3.5:.1f}">{label}</text>'
    yield f'</g><text class="label" x="{right:g}" y="{bottom + 29:g}" text-anchor="end">{escape(panel.x_label)}</text>'


def _content(
    panel: Panel,
    x_axis: Axis,
    y_axis: Axis,
    names: Mapping[str, str],
) -> Iterator[str]:
    """Draw the bands, the first of them filled, and the lines above all of them."""
    bands: list[str] = []
    lines: list[str] = []
    crowd = _crowd(panel)
    for curve in panel.curves:
        drawn = _Drawn(curve, x_axis, y_axis, panel.equal, crowd)
        lines.append(drawn.line(_name_of(curve, names)))
        if curve.band is not None:
            bands.append(drawn.band(curve.band, filled=not bands))
    yield from bands
    yield from lines


def _crowd(panel: Panel) -> float:
    """Return how many times `_FEW` paths a panel has, at least 1; with more, fewer columns are drawn."""
    bands = [curve for curve in panel.curves if curve.band is not None]
    return max((len(panel.curves) + len(bands)) / _FEW, 1.0)


def _name_of(curve: Curve, names: Mapping[str, str]) -> str:
    """Return what a curve is called at the cursor: by itself, at its end, or by its style in the legend."""
    if curve.name is not None:
        return curve.name
    if curve.label:
        return curve.label
    first_word = curve.style.split()[0]
    return names.get(curve.style, names.get(first_word, ""))


class _Drawn:
    """A curve in counts, of which only so many rows are kept as can be seen."""

    def __init__(
        self,
        curve: Curve,
        x_axis: Axis,
        y_axis: Axis,
        is_track: bool,
        crowd: float,
    ) -> None:
        self.curve = curve
        self.y_axis = y_axis
        x = x_axis.counts(curve.x)
        y = y_axis.counts(curve.y)
        across = x_axis.place(curve.x)
        down = y_axis.place(curve.y)
        if curve.points:
            self.rows = _one_of_each_cell(across, down)
        elif is_track:
            self.rows = without_standstill(across, down, _PIXEL * crowd**2)
        else:
            self.rows = envelope(x, y, round(COLUMNS / crowd**_COARSER))
        self.x = x[self.rows]
        self.y = y[self.rows]

    def line(self, name: str) -> str:
        """Draw the line, or its points, with the name and the times that are read at the cursor."""
        curve = self.curve
        times = ""
        if curve.time is not None:
            known = self.rows[np.isfinite(self.x + self.y)]
            times = f' data-t="{_steps_of_time(curve.time[known])}"'
        if curve.points:
            kind = "points"
            path = _points(self.x, self.y)
        else:
            kind = "line"
            path = _line(self.x, self.y)
        return (
            f'<path class="{kind} {curve.style}" data-name="{escape(visible(name))}"{times} '
            f'd="{path}"/>'
        )

    def band(self, edges: tuple[Floats, Floats], *, filled: bool) -> str:
        """Draw the area between two edges, or the edges alone."""
        low = self.y_axis.counts(edges[0][self.rows])
        high = self.y_axis.counts(edges[1][self.rows])
        style = self.curve.style if filled else f"edges {self.curve.style}"
        return f'<path class="band {style}" d="{_band_path(self.x, low, high, closed=filled)}"/>'


def _levels(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Draw the levels as limits, across the panel."""
    for place in y_axis.place(np.array(panel.levels)):
        yield f'<path class="line limit" d="M{x_axis.start:g} {place:.1f}H{x_axis.end:g}"/>'


def ends_of_track(panel: Panel) -> dict[str, tuple[float, float]]:
    """Return x and y of the start and the end of a track: of the reference, else of the curve on top."""
    if not panel.equal or not panel.ends or not panel.curves:
        return {}
    curve = panel.curves[-1]
    for other in panel.curves:
        if other.style == REFERENCE:
            curve = other
            break
    known = np.flatnonzero(np.isfinite(curve.x) & np.isfinite(curve.y))
    if not len(known):
        return {}
    first = known[0]
    last = known[-1]
    return {
        "start": (float(curve.x[first]), float(curve.y[first])),
        "end": (float(curve.x[last]), float(curve.y[last])),
    }


def _marks(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Mark start and end of a track."""
    ends = ends_of_track(panel)
    if not ends:
        return
    x, y = np.array([ends["start"], ends["end"]]).T
    begin_x, end_x = x_axis.place(x).tolist()
    begin_y, end_y = y_axis.place(y).tolist()
    yield f'<circle class="start" cx="{begin_x:.1f}" cy="{begin_y:.1f}" r="4"/>'
    yield f'<rect class="end" x="{end_x - 3:.1f}" y="{end_y - 3:.1f}" width="6" height="6"/>'
    for name, across, down in (("start", begin_x, begin_y - 6.0), ("end", end_x, end_y + 13.0)):
        yield f'<text class="name" x="{across + 3:.1f}" y="{down:.1f}">{name}</text>'


def _names(panel: Panel, x_axis: Axis, y_axis: Axis) -> Iterator[str]:
    """Write names at the ends of lines, apart where lines end together; a track has no room for them."""
    if panel.equal:
        return
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


# --- Paths, in counts.


def _band_path(
    x: Floats,
    low: Floats,
    high: Floats,
    *,
    closed: bool,
) -> str:
    """Write the upper edge from left to right, then the lower one back; closed, they can be filled."""
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any():
        return ""
    there = x[known]
    back = there[::-1]
    upper = high[known]
    lower = low[known][::-1]
    if closed:
        return f"{_line(np.append(there, back), np.append(upper, lower))}Z"
    return _line(there, upper) + _line(back, lower)


def _line(x: Floats, y: Floats) -> str:
    """Write a line, each step from the place before; it is interrupted where a place is missing.

    Steps take half the characters that places do, and on a page they are most of all.
    """
    known = ~(np.isnan(x) | np.isnan(y))
    counts = np.column_stack([x, y])[known].astype(np.int64)
    begins = np.diff(np.flatnonzero(known), prepend=-2) > 1
    steps = np.diff(counts, axis=0, prepend=0)
    words = []
    is_drawing = False
    for (across, down), (right, below), is_begin in zip(
        counts.tolist(), steps.tolist(), begins.tolist(), strict=True
    ):
        if is_begin:
            words.append(f"M{across}{_behind(down)}")
        elif is_drawing:
            words.append(f"{_behind(right)}{_behind(below)}")
        else:
            words.append(f"l{right}{_behind(below)}")
        is_drawing = not is_begin
    return "".join(words)


def _points(x: Floats, y: Floats) -> str:
    """Write separate points."""
    places = zip(x.tolist(), y.tolist(), strict=True)
    return "".join(f"M{across:.0f} {down:.0f}h0" for across, down in places)


def _behind(number: int) -> str:
    """Write a number after another: a minus separates them, too."""
    if number < 0:
        return f"{number}"
    return f" {number}"


def _steps_of_time(time_s: Floats) -> str:
    """Write times as steps of a hundredth of a second."""
    return " ".join(
        map(str, np.diff(np.rint(100.0 * time_s).astype(np.int64), prepend=0).tolist())
    )


def _one_of_each_cell(x: Floats, y: Floats) -> Integers:
    """Return the first row in each occupied cell of a coarse grid."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    cells = np.round(np.column_stack([x[known], y[known]]) / _POINT)
    return known[np.sort(np.unique(cells, axis=0, return_index=True)[1])]


# --- A picture of a figure, as a file of its own.

PANELS_IN_A_ROW: Final = 3  # Panels next to each other in a picture.
# Height of a line of the legend, and width of an entry.
_LEGEND = 28.0
_ENTRY = 170.0


def sheet_svg(figure: Figure) -> bytes:
    """Draw the panels of a figure in one picture, in the colours of pages; the same figure gives the same bytes."""
    panels = []
    top = 0.0
    for first in range(0, len(figure.panels), PANELS_IN_A_ROW):
        row = figure.panels[first : first + PANELS_IN_A_ROW]
        for column, panel in enumerate(row):
            place = (
                f'x="{column * WIDTH:g}" y="{top:g}" width="{WIDTH:g}" height="{_height(panel):g}"'
            )
            panels.append(_panel(panel, place, {}))
        top += max(map(_height, row))
    width = WIDTH * min(PANELS_IN_A_ROW, len(figure.panels))
    entries = int(width // _ENTRY)
    height = top + _LEGEND * math.ceil(len(figure.legend) / entries)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f"<title>{escape(visible(figure.title))}</title>",
        f"<style>\n{style_sheet()}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
        *panels,
        *_legend_below(figure.legend, top, entries),
        "</svg>",
        "",
    ]
    return "\n".join(lines).encode()


def _legend_below(legend: Legend, top: float, entries: int) -> Iterator[str]:
    """Draw a legend, so many entries in a row."""
    for number, (style, label) in enumerate(legend):
        x = _ENTRY * (number % entries) + 48.0
        y = top + _LEGEND / 2.0 + _LEGEND * (number // entries)
        if POINT in style.split():
            yield f'<path class="{style}" d="M{x + 18:g} {y - 4:g}h0"/>'
        else:
            yield f'<path class="line {style}" d="M{x:g} {y - 4:g}h36"/>'
        yield f'<text x="{x + 44:g}" y="{y:g}">{escape(visible(label))}</text>'
