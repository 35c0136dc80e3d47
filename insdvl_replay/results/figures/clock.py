"""The time axis that all figures of a dive share."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.columns import Floats, TimeNs, seconds
from insdvl_replay.report.plots.panel import filter_style

_UNITS: Final = ((2 * 3600.0, 3600.0, "h"), (20 * 60.0, 60.0, "min"), (0.0, 1.0, "s"))
"""From this length on, this unit, of this name."""
SETTLED: Final = 0.02
"""Share of the dive after which a panel shows everything; before, a sigma may fall from fifty times as high."""
_SHOWN: Final = 0.97
"""Share of the values that a panel shows: the growth in one outage would flatten all the rest."""
_AIR: Final = 1.15


@dataclass(frozen=True)
class Clock:
    """Time since the start of a replay, in a unit that suits its length.

    Attributes
    ----------
    start_ns, end_ns : int
        Span of the replay.
    """

    start_ns: int
    end_ns: int

    @property
    def label(self) -> str:
        """What stands at a time axis."""
        return f"time [{self._unit[1]}]"

    def time(self, time_ns: TimeNs) -> Floats:
        """Give times since the start in the axis's unit, shape (k,)."""
        return seconds(time_ns, self.start_ns) / self._unit[0]

    def settled(self, time_ns: TimeNs) -> NDArray[np.bool_]:
        """Tell which times lie behind the settling at the start, shape (k,)."""
        settled: NDArray[np.bool_] = time_ns - self.start_ns >= SETTLED * (self.end_ns - self.start_ns)
        return settled

    @property
    def _unit(self) -> tuple[float, str]:
        length_s = (self.end_ns - self.start_ns) * 1e-9
        return next((size, name) for least, size, name in _UNITS if length_s >= least)


def settled_height(values: Floats) -> float:
    """Give the height that a panel needs for values behind the settling: short peaks may rise above it.

    Parameters
    ----------
    values : ndarray, shape (k,)
        Not negative.

    Returns
    -------
    float
        0 without finite values.
    """
    known = values[np.isfinite(values)]
    return _AIR * float(np.quantile(known, _SHOWN)) if len(known) else 0.0


def filter_legend(names: list[str]) -> tuple[tuple[str, str], ...]:
    """Give each filter's style and name."""
    return tuple((filter_style(number), name) for number, name in enumerate(names))
