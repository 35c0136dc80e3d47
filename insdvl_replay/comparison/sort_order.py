"""In which order changes are shown, and which of them."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Literal

from insdvl_replay.comparison.aggregation import loss, loss_of
from insdvl_replay.core.changes import Aggregate, Change, Comparison

Order = Literal["table", "name", "change", "worse"]
"""As in the reports; by row; largest change first; largest loss first."""


def arranged(comparison: Comparison, order: Order, *, only_changed: bool) -> Comparison:
    """Put changes and aggregates into an order; counts stay those of all.

    Parameters
    ----------
    only_changed : bool
        Leave out what is the same, and of the aggregates what is the same in all dives.
    """
    changes, overall = comparison.changes, comparison.aggregates
    if only_changed:
        changes = tuple(change for change in changes if change.word != "same")
        overall = tuple(aggregate for aggregate in overall if aggregate.same < aggregate.dives)
    if order != "table":
        changes = tuple(sorted(changes, key=_CHANGE_KEYS[order]))
        overall = tuple(sorted(overall, key=_AGGREGATE_KEYS[order]))
    return replace(comparison, changes=changes, aggregates=overall)


def _size(change_pct: float | None) -> float:
    return math.inf if change_pct is None else abs(change_pct)


_CHANGE_KEYS: Final[dict[str, Callable[[Change], str | float]]] = {
    "name": lambda change: change.row,
    "change": lambda change: 0.0 if change.word == "same" else -_size(change.change_pct),
    "worse": lambda change: -loss_of(change),
}
_AGGREGATE_KEYS: Final[dict[str, Callable[[Aggregate], str | float]]] = {
    "name": lambda aggregate: aggregate.row,
    "change": lambda aggregate: -_size(aggregate.median_change_pct),
    "worse": lambda aggregate: -loss(aggregate.worst_word, aggregate.worst_change_pct),
}
