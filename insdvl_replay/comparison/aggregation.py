"""One cell over many dives: the median of its changes, the worst, and the share of dives in which it improved."""

import math
from collections.abc import Iterable, Sequence
from statistics import median
from typing import Final

from insdvl_replay.core.changes import Aggregate, Change, Tally
from insdvl_replay.core.tables import LAYOUTS
from insdvl_replay.core.words import ChangeWord

_PRIMARY: Final = {(layout.name, column) for layout in LAYOUTS for column in (layout.primary, *layout.words)}
"""Columns that a reader looks at first, and words with a rank, which sum up numbers."""
_ORDER: Final = {layout.name: position for position, layout in enumerate(LAYOUTS)}


def aggregates(changes: Iterable[Change]) -> tuple[Aggregate, ...]:
    r"""Gather the changes of each cell over the dives.

    With :math:`p_i` the change in percent of dive i and n dives that have the row on both sides:

    * median: :math:`\operatorname{median}(p_i)` over the dives that have a percentage; with an even number the mean of
      the middle two
    * worst: the dive with the largest loss, which is :math:`|p_i|` if the word is ``worse``, :math:`-|p_i|` if it is
      ``better``, 0 if it is ``same``; a number that was lost or grew from zero exceeds every other
    * share improved: :math:`100\,n_\mathrm{better} / n`
    """
    cells: dict[tuple[str, str, str, str, str], list[Change]] = {}
    for change in changes:
        if change.word in {ChangeWord.BETTER, ChangeWord.WORSE, ChangeWord.SAME}:
            key = change.table, change.filter, change.row, change.unit, change.column
            cells.setdefault(key, []).append(change)
    gathered = [_aggregate(key, together) for key, together in cells.items()]
    return tuple(sorted(gathered, key=lambda aggregate: _ORDER[aggregate.table]))


def tally(changes: Sequence[Change]) -> Tally:
    """Count cells by word, and name the largest loss and gain."""
    counts = dict.fromkeys(ChangeWord, 0)
    for change in changes:
        counts[change.word] += 1
    losses = [change for change in changes if loss_of(change) > 0.0]
    gains = [change for change in changes if loss_of(change) < 0.0]
    return Tally(
        counts, worst_of(losses), max(gains, key=lambda change: (_is_primary(change), -loss_of(change)), default=None)
    )


def worst_of(changes: Iterable[Change]) -> Change | None:
    """Name the largest loss, in the primary column of a table before all others; the first of equals."""
    return max(changes, key=lambda change: (_is_primary(change), loss_of(change)), default=None)


def loss(word: ChangeWord, change_pct: float | None) -> float:
    """State how much a cell lost, in percent."""
    if word not in {ChangeWord.BETTER, ChangeWord.WORSE, ChangeWord.GONE}:
        return 0.0
    amount = math.inf if change_pct is None else abs(change_pct)
    return -amount if word == ChangeWord.BETTER else amount


def loss_of(change: Change) -> float:
    """State how much a cell lost, as `loss` does."""
    return loss(change.word, change.change_pct)


def _is_primary(change: Change) -> bool:
    """Return whether a cell is what a reader looks at first. Words with a rank are: they sum up all numbers."""
    return (change.table, change.column) in _PRIMARY


def _aggregate(key: tuple[str, str, str, str, str], changes: Sequence[Change]) -> Aggregate:
    words = [change.word for change in changes]
    percentages = [change.change_pct for change in changes if change.change_pct is not None]
    worst = max(changes, key=loss_of)
    return Aggregate(
        *key,
        dives=len(changes),
        better=words.count(ChangeWord.BETTER),
        worse=words.count(ChangeWord.WORSE),
        same=words.count(ChangeWord.SAME),
        share_better_pct=100.0 * words.count(ChangeWord.BETTER) / len(words),
        median_change_pct=median(percentages) if percentages else None,
        worst_log=worst.log,
        worst_change_pct=worst.change_pct,
        worst_word=worst.word,
    )
