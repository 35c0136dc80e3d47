"""One cell over many dives: the median of its changes, the worst, and the share of dives in which it improved."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Final

import msgspec

from insdvl_replay.core.changes import Aggregate, Change, Tally
from insdvl_replay.core.errors import ConfigError, Note, require_known
from insdvl_replay.core.tables import LAYOUTS, StoredReport, StoredResult
from insdvl_replay.core.words import ChangeWord, Severity


def parse_pairs(texts: Iterable[str]) -> dict[str, str]:
    """Read pairs such as ``aided=windowed``.

    Returns
    -------
    dict of str to str
        New name by old name.

    Raises
    ------
    ConfigError
        One of them is something else.
    """
    pairs = {}
    for text in texts:
        old, equals, new = text.partition("=")
        if not (old and equals and new):
            raise ConfigError(f"--pair {text}: is not of the form OLD=NEW", "write --pair aided=windowed")
        pairs[old] = new
    return pairs


def with_new_names(results: Sequence[StoredResult], pairs: Mapping[str, str]) -> list[StoredResult]:
    """Return old results with the new names of their filters."""
    for old, new in pairs.items():
        names = list(dict.fromkeys(name for result in results for name in filter_names(result.report)))
        require_known("filter", old, names)
        if new in names and new not in pairs:
            raise ConfigError(
                f"--pair {old}={new}: the old results have a filter {new} too", f"add --pair {new}={new}_before"
            )
    return [StoredResult(result.folder, result.below, _renamed(result.report, pairs)) for result in results]


def filter_names(report: StoredReport) -> list[str]:
    """Return the baseline and the candidates."""
    return [report.baseline, *report.filters]


def require_no_strangers(pairs: Iterable[tuple[StoredResult, StoredResult]]) -> list[Note]:
    """Raise if no candidate is on both sides of any dive; note those that are on one side only."""
    sides: dict[str, Counter[str]] = {"old": Counter(), "new": Counter()}
    only: dict[str, Counter[str]] = {"old": Counter(), "new": Counter()}
    for old, new in pairs:
        before, after = set(old.report.filters), set(new.report.filters)
        sides["old"].update(before)
        sides["new"].update(after)
        only["old"].update(before - after)
        only["new"].update(after - before)
    if only["old"] == sides["old"] and only["new"] == sides["new"] and sides["old"] and sides["new"]:
        theirs, ours = (sorted(sides[side]) for side in ("old", "new"))
        raise ConfigError(
            f"no candidate of the old results ({', '.join(theirs)}) is among the new ones ({', '.join(ours)})",
            f"say which belong together with --pair {theirs[0]}={ours[0]}",
        )
    return [_one_sided(name, side, only[side][name]) for side in only for name in sorted(only[side])]


def _one_sided(name: str, side: str, count: int) -> Note:
    word = ChangeWord.GONE if side == "old" else ChangeWord.NEW
    return Note(
        "filter_on_one_side",
        f"filter {name} is in the {side} results alone (dives: {count}); its rows are {word}",
        count,
        Severity.WARNING,
        "--pair OLD=NEW compares filters of different names",
    )


def _renamed(report: StoredReport, pairs: Mapping[str, str]) -> StoredReport:
    tables = {
        table: [{**row, "filter": pairs.get(str(row.get("filter")), row.get("filter"))} for row in rows]
        for table, rows in report.tables.items()
    }
    filters = {pairs.get(name, name): candidate for name, candidate in report.filters.items()}
    baseline = pairs.get(report.baseline, report.baseline)
    return msgspec.structs.replace(report, tables=tables, filters=filters, baseline=baseline)


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
