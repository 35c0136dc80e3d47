"""Strips: how much of the dive the samples of each sensor cover."""

from collections.abc import Iterator
from html import escape
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Dive, Floats, Mask, ReferenceColumns, TimeNs
from insdvl_replay.document.plot import Axis
from insdvl_replay.document.time_axis import Clock
from insdvl_replay.preparation.replay import Replay

_COLUMNS = 300
_HEIGHT = 20
_TICKS = 5
# Pixels from the strips to the feet of the times, and of the label of their axis.
_TICK_DOWN = 12
_LABEL_DOWN = 28
_RIGHTMOST: Final = 97.0  # Labels from here on end at their place, in percent of the width.
_FEWEST_BEAMS: Final = 3  # With fewer valid beams a ping has no velocity.
_MISSING: Final = 2.5  # A gap is longer than this many usual steps.


def coverage_strips(replay: Replay) -> str:
    """Draw a strip for each sensor, as HTML: as high as the share of the time that its valid samples cover."""
    clock = Clock(replay.start_ns, replay.end_ns)
    strips = []
    for name, time_ns, valid in _sources(replay.dive):
        shares = covered_shares(time_ns, valid, clock.start_ns, clock.end_ns)
        strips.append(_strip(name, shares))
    return f'<div class="strips">{"".join(strips)}<div></div><svg class="times">{_ticks(clock)}</svg></div>'


def _strip(name: str, shares: Floats) -> str:
    """Draw the coverage by one sensor, with its name and its share of the dive."""
    heights = np.round(shares * _HEIGHT).astype(int)
    changes = np.flatnonzero(np.diff(heights, prepend=-1)).tolist()
    steps = "".join(f"H{column}V{_HEIGHT - heights[column]}" for column in changes)
    return (
        f'<div class="source"><span>{escape(name)}</span>'
        f'<span class="share">{100.0 * float(shares.mean()):.1f} %</span></div>'
        f'<svg class="strip" viewBox="0 0 {_COLUMNS} {_HEIGHT}" preserveAspectRatio="none">'
        f'<path d="M0 {_HEIGHT}{steps}H{_COLUMNS}V{_HEIGHT}Z"/></svg>'
    )


def _ticks(clock: Clock) -> str:
    """Write the times below the strips, and the label of their axis at the right, below them."""
    texts = []
    for across, label in Axis(*clock.limits, 0.0, 100.0).ticks(_TICKS):
        texts.append(_text(across, _TICK_DOWN, label))
    texts.append(_text(100.0, _LABEL_DOWN, clock.label))
    return "".join(texts)


def _text(across: float, down: int, label: str) -> str:
    anchor = "end" if across > _RIGHTMOST else "middle"
    return f'<text class="tick" x="{across:.1f}%" y="{down}" text-anchor="{anchor}">{label}</text>'


Samples = tuple[str, TimeNs, Mask]  # Name, times (k,), and which are valid (k,).


def _sources(dive: Dive) -> Iterator[Samples]:
    """Yield the samples of each sensor, or of each beam."""
    yield "IMU", dive.imu.time_ns, np.ones(len(dive.imu.time_ns), dtype=bool)
    if dive.dvl.beam_velocity_mps is not None:
        valid = np.isfinite(dive.dvl.beam_velocity_mps)
        for beam, column in enumerate(valid.T):
            yield f"DVL beam {beam}", dive.dvl.time_ns, column
        yield "DVL, three beams or more", dive.dvl.time_ns, valid.sum(axis=1) >= _FEWEST_BEAMS
    elif dive.dvl.velocity_d is not None:
        yield "DVL velocity", dive.dvl.time_ns, np.isfinite(dive.dvl.velocity_d.sum(axis=1))
    if dive.reference is not None:
        yield from _of_reference(dive.reference)


def _of_reference(reference: ReferenceColumns) -> Iterator[Samples]:
    """Yield one strip where each row has all that the reference ever has, else one for each quantity."""
    known = {quantity: rows for quantity, rows in reference.known.items() if rows.any()}
    if all(rows.all() for rows in known.values()):
        known = {"": np.ones(len(reference.time_ns), dtype=bool)}
    for quantity, rows in known.items():
        yield f"reference {quantity}".strip(), reference.time_ns[rows], rows[rows]


def covered_shares(
    time_ns: TimeNs,
    valid: Mask,
    start_ns: int,
    end_ns: int,
    columns: int = _COLUMNS,
) -> Floats:
    """Return the share of each column of a span, (columns,), that valid samples, (k,), cover, from 0 to 1."""
    if len(time_ns) < 2:
        return np.zeros(columns)
    # A sample lasts until the next, but no longer than some usual steps.
    steps_ns = np.diff(time_ns).astype(np.float64)
    usual_ns = float(np.median(steps_ns))
    lasts_ns = np.minimum(np.append(steps_ns, usual_ns), _MISSING * usual_ns) * valid
    # What is covered until each edge: the samples before it, less what of the last is still to come.
    edges_ns = np.linspace(start_ns, end_ns, columns + 1, dtype=np.int64)
    before_ns = np.append(0.0, np.cumsum(lasts_ns))
    rows = np.searchsorted(time_ns, edges_ns, side="right")
    latest = np.maximum(rows - 1, 0)
    unfinished_ns = np.maximum(lasts_ns[latest] - (edges_ns - time_ns[latest]), 0.0)
    covered_ns = before_ns[rows] - np.where(rows > 0, unfinished_ns, 0.0)
    shares: Floats = np.clip(np.diff(covered_ns) / np.diff(edges_ns), 0.0, 1.0)
    return shares
