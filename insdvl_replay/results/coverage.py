"""What the filters had to go on: which part of the dive each sensor covers, as strips, so that gaps are seen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import Floats, TimeNs
from insdvl_replay.report.plots.axis import Axis
from insdvl_replay.results.filter_figures import Clock

_COLUMNS: Final = 300
_HEIGHT: Final = 20
_LASTS: Final = 2.5
"""A sample stands for the time up to the next, but for no more than this many of the usual steps."""
_TICKS: Final = 5


@dataclass(frozen=True)
class Source:
    """One sensor, or one beam.

    Attributes
    ----------
    time_ns : ndarray, shape (k,)
        Times of all its samples.
    valid : ndarray of bool, shape (k,)
        Whether a sample says anything.
    """

    name: str
    time_ns: TimeNs
    valid: NDArray[np.bool_]


def coverage_strips(sources: Sequence[Source], clock: Clock) -> str:
    """Draw a strip for each source: as high as the share of the time that it covers."""
    rows = "".join(_row(source, clock) for source in sources)
    return f'<div class="strips">{rows}<div></div><div class="times">{"".join(_times(clock))}</div></div>'


def covered_shares(source: Source, start_ns: int, end_ns: int, columns: int = _COLUMNS) -> Floats:
    """Return the share of each column of a span that valid samples cover.

    Returns
    -------
    ndarray, shape (columns,)
        From 0 to 1.
    """
    if len(source.time_ns) < 2:
        return np.zeros(columns)
    lasts = np.empty(len(source.time_ns))
    np.subtract(source.time_ns[1:], source.time_ns[:-1], out=lasts[:-1], casting="unsafe")
    usual = float(np.median(lasts[:-1]))
    lasts[-1] = usual
    np.minimum(lasts, _LASTS * usual, out=lasts)
    lasts[~source.valid] = 0.0
    edges_ns = np.linspace(start_ns, end_ns, columns + 1, dtype=np.int64)
    shares: Floats = np.clip(np.diff(_covered_ns(source.time_ns, lasts, edges_ns)) / np.diff(edges_ns), 0.0, 1.0)
    return shares


def _covered_ns(begins_ns: TimeNs, lasts: Floats, until_ns: TimeNs) -> Floats:
    """Add up what samples cover, of which each lasts for a while, until some times."""
    before = np.zeros(len(lasts) + 1)
    np.cumsum(lasts, out=before[1:])
    rows = np.searchsorted(begins_ns, until_ns, side="right")
    latest = np.maximum(rows - 1, 0)
    unfinished = np.maximum(lasts[latest] - (until_ns - begins_ns[latest]), 0.0)
    return np.asarray(before[rows] - np.where(rows > 0, unfinished, 0.0))


def _row(source: Source, clock: Clock) -> str:
    shares = covered_shares(source, clock.start_ns, clock.end_ns)
    view = f"0 0 {_COLUMNS} {_HEIGHT}"
    strip = f'<svg class="strip" viewBox="{view}" preserveAspectRatio="none"><path d="{_steps(shares)}"/></svg>'
    percent = f"{100.0 * float(shares.mean()):.1f} %"
    return f'<div class="source"><span>{escape(source.name)}</span><span class="share">{percent}</span></div>{strip}'


def _steps(shares: Floats) -> str:
    """Draw columns of the same height as one step."""
    heights = np.round(shares * _HEIGHT).astype(int)
    changes = np.flatnonzero(np.diff(heights, prepend=-1))
    steps = "".join(f"H{column}V{_HEIGHT - heights[column]}" for column in changes.tolist())
    return f"M0 {_HEIGHT}{steps}H{_COLUMNS}V{_HEIGHT}Z"


def _times(clock: Clock) -> Iterator[str]:
    whole = float(clock.time(np.array([clock.end_ns]))[0])
    for percent, label in Axis(0.0, whole, 0.0, 100.0).ticks(_TICKS):
        yield f'<span style="left:{percent:.1f}%">{label}</span>'
    yield f'<span class="last">{clock.label}</span>'
