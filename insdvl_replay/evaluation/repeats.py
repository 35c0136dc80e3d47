"""Whether a filter of the user's gives the same answer again, and with an input that differs by nothing that matters.

An answer that moves from run to run by more than the band of equal results may be better or worse by chance. The spread
is that of two runs: the root mean square of their difference over the error of the baseline, in the quantity that may
decide, so that by the same proof as in `evidence` a smaller one cannot turn a verdict.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.quantities import label
from insdvl_replay.core.tables import share_text, two_digits
from insdvl_replay.evaluation.answers import PROVED
from insdvl_replay.evaluation.evaluate import accuracy_series, track_series
from insdvl_replay.evaluation.evidence import ErrorSeries, ReferenceNoise, compared, settling_times
from insdvl_replay.evaluation.reference_errors import reference_errors
from insdvl_replay.geometry.frames import north_east_m


class Change(Enum):
    """How the input of another run differs."""

    AGAIN = auto()  # It does not.
    STAMPS = auto()
    SAMPLES = auto()


_WHEN: Final = {
    Change.AGAIN: "in a second run",
    Change.STAMPS: "when all stamps move by 1 us",
    Change.SAMPLES: "when one IMU sample in 10,000 is repeated",
}


@dataclass(frozen=True)
class Repeat:
    """Another run of a filter over a dive, against its first."""

    change: Change
    is_equal: bool = False  # to the last bit
    moves_m: float = math.nan  # root mean square of the horizontal distance of both tracks
    quantity: str = ""  # that may decide on this dive; empty for none
    # difference of both runs in this quantity over the error of the baseline
    acts: float = math.nan
    failure: str = ""  # why the run gave nothing

    @property
    def is_off(self) -> bool:
        """Whether the answer moves so far that a verdict by it means nothing."""
        return bool(self.failure) or self.acts >= PROVED

    @property
    def when(self) -> str:
        """Say in which run, by how its input differs."""
        return _WHEN[self.change]

    def text(self, baseline: str) -> str:
        """Say how far the answer moves, and when."""
        if self.failure:
            return f"fails {self.when}: {self.failure}"
        moved = self._moved(baseline)
        if self.change == Change.AGAIN:
            return f"gives another answer {self.when}, which moves {moved}"
        return f"moves {moved}, {self.when}"

    def _moved(self, baseline: str) -> str:
        """Say what moves, and how far."""
        moved = []
        if math.isfinite(self.moves_m):
            moved.append(f"its position by {metres(self.moves_m)} (rms)")
        if math.isfinite(self.acts):
            share = f"{share_text(self.acts)} of the error of {baseline}"
            if moved and self.quantity == "position":
                moved = [f"{moved[0]}, {share}"]
            else:
                moved.append(f"its {label(self.quantity)} by {share}")
        return " and ".join(moved) or "its solution"


def metres(value: float) -> str:
    """Write a distance, a small one in mm."""
    if value >= 1.0 or value == 0.0:
        return f"{two_digits(value)} m"
    return f"{two_digits(1000.0 * value)} mm"


def apart_m(first: History, second: History) -> float:
    """Return the root mean square of the horizontal distance of two runs at the times that both have, m."""
    north_m, east_m = north_east_m(second.position, first.position, first.position)
    square_m2 = north_m**2 + east_m**2
    known = np.isfinite(square_m2)
    if known.any():
        return math.sqrt(float(np.mean(square_m2[known])))
    return math.nan


def share_moved(baseline: ErrorSeries, first: ErrorSeries, second: ErrorSeries) -> float:
    """Return the difference of two runs over the error of the baseline, all in one quantity; NaN where unknown."""
    moved = replace_errors(baseline, baseline.errors + (second.errors - first.errors))
    return compared(baseline, moved).acts


def replace_errors(series: ErrorSeries, errors: Floats) -> ErrorSeries:
    """Return a series with other errors, shape (k, d)."""
    return ErrorSeries(series.unit, errors, series.noise, series.from_s)


def errors_of_runs(
    runs: Sequence[History],  # the baseline, then runs of one filter
    reference: ReferenceColumns | None,
    noise: ReferenceNoise,
    quantity: str,
    *,
    bridged_gaps: bool,
) -> list[ErrorSeries]:
    """Return the errors of each run against the reference in one quantity; empty where a run does not have it."""
    if reference is None:
        return []
    # Errors are known by the names of filters.
    named = [replace(history, filter=str(number)) for number, history in enumerate(runs)]
    baseline = named[0]
    errors = {history.filter: reference_errors(history, reference, baseline) for history in named}
    settled_s = settling_times(baseline, errors[baseline.filter].time_ns)
    tracks = track_series(named, errors, noise, bridged_gaps=bridged_gaps)
    in_time = accuracy_series(
        named, errors, reference, noise, settled_s, bridged_gaps=bridged_gaps
    )
    found = []
    for history in named:
        series = {**tracks[history.filter], **in_time[history.filter]}
        if quantity not in series or not np.isfinite(series[quantity].errors).any():
            return []
        found.append(series[quantity])
    return found
