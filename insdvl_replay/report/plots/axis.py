"""One axis of a panel: its limits, its ticks and their labels, and the way from values to places on the paper."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.report.plots.panel import Scale

_STEPS: Final = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0)
"""Of ticks, times a power of ten."""
_MARGIN: Final = 0.05
"""Share of the span that stays free at either end."""
_SMALLEST_SPAN: Final = 1e-9
"""Share of the size of values below which they are all the same."""
_LARGEST: Final = 1e30
"""What a filter that broke down says beyond is not shown."""


@dataclass(frozen=True)
class Axis:
    """From values to places.

    Attributes
    ----------
    low, high : float
        Values at the ends.
    start, end : float
        Places of the ends on the paper.
    scale : {'linear', 'log'}
    whole : bool
        Ticks are whole numbers alone.
    """

    low: float
    high: float
    start: float
    end: float
    scale: Scale = "linear"
    whole: bool = False

    def place(self, values: Floats) -> Floats:
        """Return the places of values; NaN where a logarithmic axis has none."""
        low, high = self.low, self.high
        if self.scale == "log":
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        places: Floats = self.start + (values - low) / (high - low) * (self.end - self.start)
        return places

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return the places of at most some ticks, and their labels."""
        if self.scale == "log":
            values = _decades(self.low, self.high, count)
            labels = [_power(value) for value in values]
        else:
            step, values = _round_values(self.low, self.high, count, whole=self.whole)
            labels = [_plain(value, step) for value in values]
        inside = (values >= self.low) & (values <= self.high)
        places = self.place(values).tolist()
        return [(place, label) for place, label, shown in zip(places, labels, inside.tolist(), strict=True) if shown]


def limits(values: Floats, scale: Scale = "linear") -> tuple[float, float]:
    """Return an axis some air around its values.

    Parameters
    ----------
    values : ndarray
        Of any shape.
    scale : {'linear', 'log'}

    Returns
    -------
    low, high : float
        Not equal; 0 and 1, or 1 and 10, where there are no values.
    """
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
    """Find the smallest step that needs no more than some intervals, smaller if it shows one value, and its values."""
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


def _plain(value: float, step: float) -> str:
    """Write a tick as short as its step allows."""
    text = f"{round(value / step) * step:.6g}"
    return text.replace("-", "\N{MINUS SIGN}")


def _power(value: float) -> str:
    exponent = round(math.log10(value))
    return f"{value:g}" if -4 < exponent < 5 else f"1e{exponent}"
