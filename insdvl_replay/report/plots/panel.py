"""What there is to draw: a panel of curves, bands and levels, before anybody knows where on the paper they lie."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    # Only its type is needed, and whoever asks for a schema must not wait for numpy.
    from insdvl_replay.core.dive_columns import Floats

Scale = Literal["linear", "log"]

REFERENCE: Final = "reference"
LIMIT: Final = "limit"
REJECTED: Final = "rejected"
BELIEVED: Final = "sigma"
"""Beside the style of a filter: finely dotted."""
_FILTER_STYLES: Final = 6


def filter_style(number: int) -> str:
    """Return the style of a filter by its place in the configuration; the first is the baseline."""
    return f"filter{number % _FILTER_STYLES}"


@dataclass(frozen=True)
class Curve:
    """One line, or separate points.

    Attributes
    ----------
    x, y : ndarray, shape (k,)
        In the units of the panel. NaN interrupts the line.
    style : str
        Class in the style sheet.
    points : bool
        Draw points and no line.
    label : str
        Stands at the end of the line.
    """

    x: "Floats"
    y: "Floats"
    style: str
    points: bool = False
    label: str = ""


@dataclass(frozen=True)
class Shade:
    """A stretch of the horizontal axis behind everything.

    Attributes
    ----------
    begin, end : float
        In the unit of the axis.
    style : str
        Class in the style sheet.
    """

    begin: float
    end: float
    style: str


def dashes_on_top(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Draw the baseline, the first, last: through its dashes what is the same as the baseline can still be seen."""
    return (*curves[1:], *curves[:1])


@dataclass(frozen=True)
class Band:
    """What lies between two lines.

    Attributes
    ----------
    x, low, high : ndarray, shape (k,)
    style : str
        Class in the style sheet.
    """

    x: "Floats"
    low: "Floats"
    high: "Floats"
    style: str


@dataclass(frozen=True)
class Panel:
    """Curves on two axes.

    Attributes
    ----------
    title : str
        What is drawn, with the unit of the vertical axis.
    x_label : str
        What the horizontal axis is, with its unit.
    curves : tuple of Curve
        The last lies on top.
    bands : tuple of Band
        Below the curves.
    levels : tuple of float
        Horizontal lines, drawn as limits.
    x_scale, y_scale : {'linear', 'log'}
        On a logarithmic axis, what is not positive is missing.
    y_limits : tuple of float, optional
        Left out: as much as the curves need.
    equal : bool
        One unit is as long on both axes, and curves are no functions of x.
    x_whole : bool
        x counts something, and has no ticks between whole numbers.
    shades : tuple of Shade
        Behind all else.
    low : bool
        As low as others, though both axes are equal.
    """

    title: str
    x_label: str
    curves: tuple[Curve, ...]
    bands: tuple[Band, ...] = ()
    levels: tuple[float, ...] = ()
    y_scale: Scale = "linear"
    y_limits: tuple[float, float] | None = None
    equal: bool = False
    x_whole: bool = False
    x_scale: Scale = "linear"
    shades: tuple[Shade, ...] = ()
    low: bool = False


@dataclass(frozen=True)
class Figure:
    """Panels that belong together.

    Attributes
    ----------
    title : str
        What they show.
    caption : str
        How they are to be read.
    legend : tuple of tuple of str
        Style and meaning of what is drawn.
    """

    title: str
    caption: str
    panels: tuple[Panel, ...]
    legend: tuple[tuple[str, str], ...] = ()
