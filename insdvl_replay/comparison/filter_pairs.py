"""Filters of the old results and of the new: pairs of different names, and those that only one side has."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import msgspec

from insdvl_replay.core.errors import ConfigError, Note, require_known
from insdvl_replay.core.stored_report import StoredReport, StoredResult
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


def require_common_candidate(pairs: Iterable[tuple[StoredResult, StoredResult]]) -> list[Note]:
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
