"""Long gaps of the IMU: where they are, which nodes a time line needs in them, and the longest part without one."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import Floats, TimeNs, seconds
from insdvl_replay.core.states import STATES

BRIDGE_STEP_S: Final = 1.0
"""Spacing of the nodes inside a gap: short enough that growing uncertainties see each other grow."""


@dataclass(frozen=True)
class Gaps:
    """The long gaps of one dive, in the order of time.

    Attributes
    ----------
    start_ns, end_ns : ndarray, shape (g,)
        The samples before and after each gap.
    noise_density : ndarray, shape (g, 12)
        What each adds to the diagonal of the process noise's spectral density, see `error_model.noise_density`.
    rate_sd_radps : float
        How fast the vehicle may turn in them, unseen.
    """

    start_ns: TimeNs
    end_ns: TimeNs
    noise_density: Floats
    rate_sd_radps: float = 0.0

    @property
    def length_s(self) -> Floats:
        """How long each gap is, shape (g,)."""
        return seconds(self.end_ns, self.start_ns)

    def where(self, keep: NDArray[np.bool_]) -> "Gaps":
        """Keep some of the gaps."""
        return Gaps(self.start_ns[keep], self.end_ns[keep], self.noise_density[keep], self.rate_sd_radps)

    def within(self, start_ns: int, end_ns: int) -> "Gaps":
        """Keep the gaps that a span touches."""
        return self.where((self.start_ns < end_ns) & (self.end_ns > start_ns))

    def overlap(self, from_ns: TimeNs, to_ns: TimeNs) -> NDArray[np.bool_]:
        """Tell which of some intervals hold part of a gap; an interval of no length, whether it lies inside one.

        Parameters
        ----------
        from_ns, to_ns : ndarray, shape (k,)
            Ends of the intervals.

        Returns
        -------
        ndarray of bool, shape (k,)
        """
        begun = np.searchsorted(self.start_ns, to_ns, side="left")
        over = np.searchsorted(self.end_ns, from_ns, side="right")
        return np.asarray(begun > over)

    def after(self, time_ns: TimeNs) -> NDArray[np.int64]:
        """Give the row of the gap that lies after each of some times, -1 for none; shape as the times."""
        row = np.searchsorted(self.start_ns, time_ns, side="right") - 1
        over = np.searchsorted(self.end_ns, time_ns, side="right") - 1
        return np.where(row > over, row, -1)

    def node_ns(self) -> TimeNs:
        """Give the times at which a time line needs nodes: both ends of each gap and some between, shape (n,)."""
        steps = np.ceil(self.length_s / BRIDGE_STEP_S).astype(np.int64)
        nodes = [
            start + np.linspace(0, end - start, int(count) + 1, dtype=np.int64)  # times since 1970 are no floats
            for start, end, count in zip(self.start_ns, self.end_ns, steps, strict=True)
        ]
        return np.concatenate([np.empty(0, np.int64), *nodes])

    def longest_stretch(self, start_ns: int, end_ns: int) -> tuple[int, int]:
        """Give the longest part of a span that has no gap.

        Returns
        -------
        tuple of int
            Start and end, ns.
        """
        inside = self.within(start_ns, end_ns)
        starts = np.concatenate([[start_ns], inside.end_ns])
        ends = np.concatenate([inside.start_ns, [end_ns]])
        longest = int(np.argmax(ends - starts))
        return int(starts[longest]), int(ends[longest])


NO_GAPS: Final = Gaps(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, len(STATES))))
"""What a gapless dive has."""
