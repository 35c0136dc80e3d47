"""The time axis of figures: since the start of a replay, in a unit that suits its length."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, TimeNs, seconds

# By unit of a time axis its size, and the length from which it is used, in seconds.
_UNITS: Final = {"h": (3600.0, 2 * 3600.0), "min": (60.0, 20 * 60.0), "s": (1.0, 0.0)}


@dataclass(frozen=True)
class Clock:
    """Time since the start of a replay, in a unit that suits its length."""

    start_ns: int
    end_ns: int

    @property
    def unit(self) -> str:
        """The unit of a time axis."""
        length_s = (self.end_ns - self.start_ns) * 1e-9
        for unit, (_, least_s) in _UNITS.items():
            if length_s >= least_s:
                return unit
        raise ValueError("the end of a replay is before its start")

    @property
    def label(self) -> str:
        """The label of a time axis."""
        return f"time [{self.unit}]"

    @property
    def limits(self) -> tuple[float, float]:
        """The limits of a time axis."""
        return 0.0, float(self.time(np.array([self.end_ns]))[0])

    def time(self, time_ns: TimeNs) -> Floats:
        """Return times since the start in the axis's unit, shape (k,)."""
        return seconds(time_ns, self.start_ns) / _UNITS[self.unit][0]
