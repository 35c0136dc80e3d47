"""Windows in which the DVL is withheld from the filters: where in a dive they lie, and which of them say nothing."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.dive_columns import NS_PER_S, TimeNs, is_new
from insdvl_replay.core.quantities import COASTING_WINDOWS_S

WINDOWS_S: Final = tuple(map(int, COASTING_WINDOWS_S))
BURN_IN_S: Final = 100
"""A filter that still finds its start is not told by how it coasts."""
SHOWN_S: Final = 60
SHOWN_EVERY_S: Final = 30
"""Windows for a picture of the drift over time may overlap."""
OUTAGE: Final = 2.5
"""A pause of so many usual intervals is a real outage; one ping that is missing alone is none."""
FEWEST_PINGS: Final = 6
"""With fewer in a window the trapezoid, from a velocity error of zero on, makes the drift over 1 % too large."""

InGap = Callable[[TimeNs, TimeNs], NDArray[np.bool_]]


@dataclass(frozen=True)
class Windows:
    """The windows of one length, each from a ping that is used to the last one that is withheld.

    Attributes
    ----------
    window_s : int
        Length; from ping to ping it differs by less than two intervals.
    first, last : ndarray of int, shape (w,)
        Rows of these pings.
    left_out : int
        Windows in which the DVL or the IMU fell silent by itself.
    """

    window_s: int
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    left_out: int


@dataclass(frozen=True)
class CoastingPlan:
    """All windows of a dive.

    Attributes
    ----------
    ping_ns : ndarray, shape (m,)
        Times of the pings of whose rows the windows speak.
    judged : tuple of Windows
        By length; those of one length do not overlap. A length is missing where the dive is too short for it, or its
        pings too rare.
    shown : Windows
        Overlapping, for the drift over time.
    """

    ping_ns: TimeNs
    judged: tuple[Windows, ...]
    shown: Windows

    @cached_property
    def runs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The pings from which a filter coasts, each once, and how far: the longest window that begins there.

        Returns
        -------
        first, last : ndarray of int, shape (r,)
            Rows of pings; the first strictly increase.
        """
        every = (*self.judged, self.shown)
        first, last = (np.concatenate(rows) for rows in ([w.first for w in every], [w.last for w in every]))
        order = np.lexsort((-last, first))
        longest = order[is_new(first[order])]
        return first[longest], last[longest]

    @property
    def start_ns(self) -> TimeNs:
        """Times at which a history has to hold P for the filter to coast from there, shape (r,)."""
        return self.ping_ns[self.runs[0]]

    @property
    def windows_ns(self) -> Iterator[tuple[int, int]]:
        """Times of the last used and of the last withheld ping of each run."""
        first, last = self.runs
        return zip(self.ping_ns[first].tolist(), self.ping_ns[last].tolist(), strict=True)


def plan_coasting(ping_ns: TimeNs, in_gap: InGap, start_ns: int, end_ns: int) -> CoastingPlan:
    """Lay windows into a dive, none of which begins before the filters have settled.

    Parameters
    ----------
    ping_ns : ndarray, shape (m,)
        Times of the pings with a velocity.
    in_gap : callable
        Whether the IMU has a long gap between some times and others, as `nav.timeline.Gaps.overlap`.
    start_ns, end_ns : int
        Span of the replay.
    """
    span_ns = start_ns, end_ns
    judged = [_windows(ping_ns, in_gap, span_ns, window_s, window_s) for window_s in WINDOWS_S]
    return CoastingPlan(
        ping_ns,
        tuple(windows for windows in judged if len(windows.first) + windows.left_out),
        _windows(ping_ns, in_gap, span_ns, SHOWN_S, SHOWN_EVERY_S),
    )


def _windows(ping_ns: TimeNs, in_gap: InGap, span_ns: tuple[int, int], window_s: int, every_s: int) -> Windows:
    usual_ns = float(np.median(np.diff(ping_ns))) if len(ping_ns) > 1 else np.inf
    begun_ns = _begun_ns(ping_ns, span_ns, usual_ns, window_s, every_s)
    if not len(begun_ns):
        return Windows(window_s, begun_ns, begun_ns, 0)
    first = _nearest(ping_ns, begun_ns)
    ended_ns = ping_ns[first] + window_s * NS_PER_S
    last = _nearest(ping_ns, ended_ns)
    away_ns = np.maximum(abs(ping_ns[first] - begun_ns), abs(ping_ns[last] - ended_ns))
    outages_before = np.cumsum(np.diff(ping_ns, prepend=ping_ns[:1]) > OUTAGE * usual_ns)
    silent = (away_ns > 0.5 * OUTAGE * usual_ns) | (outages_before[first] < outages_before[last])
    whole = ~silent & ~in_gap(ping_ns[first], ping_ns[last])
    return Windows(window_s, first[whole], last[whole], int(np.sum(~whole)))


def _begun_ns(ping_ns: TimeNs, span_ns: tuple[int, int], usual_ns: float, window_s: int, every_s: int) -> TimeNs:
    """Return the times at which windows are to begin; none where the dive is too short, or the pings too rare."""
    start_ns, end_ns = span_ns
    if end_ns - start_ns < (BURN_IN_S + 2 * window_s) * NS_PER_S or window_s * NS_PER_S < FEWEST_PINGS * usual_ns:
        return np.empty(0, np.int64)
    if end_ns - ping_ns[-1] <= OUTAGE * usual_ns:  # else the DVL fell silent, and what follows is left out
        end_ns = min(end_ns, int(ping_ns[-1] + 0.5 * usual_ns))
    latest_s = (end_ns - start_ns) // NS_PER_S - window_s
    return start_ns + np.arange(BURN_IN_S, latest_s + 1, every_s) * NS_PER_S


def _nearest(ping_ns: TimeNs, time_ns: TimeNs) -> NDArray[np.int64]:
    """Return the row of the ping that is nearest to each time."""
    middle_ns = ping_ns[:-1] + np.diff(ping_ns) // 2
    return np.searchsorted(middle_ns, time_ns)
