"""What the plots of a dive have in common: the curves of filters, their legend, and what a stored result has."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.report import Row
from insdvl_replay.core.states import State
from insdvl_replay.document.parts import (
    PREDICTED,
    Curve,
    Figure,
    Panel,
    dashes_on_top,
    filter_style,
)
from insdvl_replay.results.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd

Legend = tuple[tuple[str, str], ...]  # Style and meaning.
TIME_S: Final = "time [s]"  # The label of an axis of time in figures for a paper.


class Series(NamedTuple):
    """The values of one filter, before they have a style."""

    filter: str
    x: Floats  # (k,)
    y: Floats  # (k,)


@dataclass(frozen=True)
class StoredDive:
    """What a figure for a paper is drawn from."""

    trajectory: Trajectory
    tables: Mapping[str, Sequence[Row]]  # of the report, by name
    states: tuple[str, ...] = ()  # beginnings of the states that are wanted; none: all
    reference: "pd.DataFrame | None" = None  # known for the track only

    def over_time(self, column: str) -> list[Series]:
        """Return a column of the trajectory, of each filter."""
        time_s = self.trajectory.time_s
        return [
            Series(name, time_s, self.trajectory.of(name, column))
            for name in self.trajectory.names
        ]


def filter_curves(series: Iterable[Series], *, named: bool = False) -> tuple[Curve, ...]:
    """Return a curve for each filter, in the order of the settings; named at their ends."""
    drawn = []
    for number, (name, x, y) in enumerate(series):
        label = name if named else ""
        drawn.append(Curve(x, y, filter_style(number), label=label))
    return dashes_on_top(drawn)


def thin_curves(series: Iterable[Series], meaning: str) -> tuple[Curve, ...]:
    """Return what belongs to each filter's own curve, such as its prediction, as a thin curve."""
    drawn = []
    for number, (name, x, y) in enumerate(series):
        style = f"{filter_style(number)} {PREDICTED}"
        drawn.append(Curve(x, y, style, name=f"{name} {meaning}"))
    return tuple(drawn)


def filter_legend(names: Iterable[str]) -> Legend:
    """Return the legend of the filters, in the order of the settings."""
    return tuple((filter_style(number), name) for number, name in enumerate(names))


def is_known(curves: Iterable[Curve]) -> bool:
    """Return whether any of the curves has a value."""
    return any(np.isfinite(curve.y).any() for curve in curves)


def title_of(state: State) -> str:
    """Return the title of a panel of a state, with its unit."""
    return f"{state.label} [{state.unit}]"


def figure_for_paper(
    dive: StoredDive, panels: Iterable[Panel], more: Sequence[tuple[str, str]] = ()
) -> Figure:
    """Return panels with the legend of the filters, and what else it explains; a paper has its own caption."""
    legend = (*filter_legend(dive.trajectory.names), *more)
    return Figure("", "", tuple(panels), legend)


def known_number(value: object) -> float:
    """Return the number in a cell of a stored table; NaN for what is missing."""
    if isinstance(value, int | float):
        return float(value)
    return math.nan
