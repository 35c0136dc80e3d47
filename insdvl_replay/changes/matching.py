"""Which result of an old set belongs to which of a new one, and which filter to which."""

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from insdvl_replay.core.errors import ConfigError, hint_for, listed, require_known
from insdvl_replay.core.report import Row, StoredReport, StoredResult
from insdvl_replay.core.words import MatchedBy


class Pair(NamedTuple):
    """The results of one dive on both sides."""

    old: StoredResult
    new: StoredResult


@dataclass(frozen=True)
class Match:
    """A dive that both sides have, and how it was found."""

    pair: Pair
    by: MatchedBy


@dataclass(frozen=True)
class Matching:
    """The dives that both sides have, in the order of the new results, and those without a counterpart."""

    both: Sequence[Match]
    gone: Sequence[StoredResult]  # only the old side has them
    added: Sequence[StoredResult]  # only the new side has them


# --- Dives.


def match_dives(old: Sequence[StoredResult], new: Sequence[StoredResult]) -> Matching:
    """Match results of the same dive, by the hash of the log, else by name. Two single results are always matched."""
    found = dict[Path, Match]()  # by the folder of the new result
    before = list(old)
    after = list(new)
    for key in _KEYS:
        theirs = _alone(before, key.of)
        for value, result in _alone(after, key.of).items():
            if value in theirs:
                found[result.folder] = Match(Pair(theirs[value], result), key.by)
        taken = {match.pair.old.folder for match in found.values()}
        before = [result for result in before if result.folder not in taken]
        after = [result for result in after if result.folder not in found]
    if len(old) == len(new) == 1 and not found:
        return Matching([Match(Pair(old[0], new[0]), MatchedBy.CHOICE)], [], [])
    _require_one_counterpart(before, after)
    if not found:
        raise _nothing_in_common(old, new)
    both = [found[result.folder] for result in new if result.folder in found]
    return Matching(both, before, after)


@dataclass(frozen=True)
class _Key:
    """By what results are matched; a result without it has an empty value."""

    by: MatchedBy
    of: Callable[[StoredResult], Hashable]


def _hash_and_place(result: StoredResult) -> Hashable:
    digest = _hash(result)
    return digest and (digest, result.below)


def _hash_and_name(result: StoredResult) -> Hashable:
    digest = _hash(result)
    return digest and (digest, result.name)


def _hash(result: StoredResult) -> str:
    """Return the hash of the log; empty without a file."""
    return result.report.log.sha256


def _name_and_place(result: StoredResult) -> Hashable:
    return (result.name, result.below)


def _name(result: StoredResult) -> str:
    return result.name


# Results of one log in several folders are matched by their place, then by their name.
_KEYS: Final = (
    _Key(MatchedBy.HASH, _hash_and_place),
    _Key(MatchedBy.HASH, _hash_and_name),
    _Key(MatchedBy.HASH, _hash),
    _Key(MatchedBy.NAME, _name_and_place),
    _Key(MatchedBy.NAME, _name),
)


def _alone(
    results: Sequence[StoredResult], key: Callable[[StoredResult], Hashable]
) -> dict[Hashable, StoredResult]:
    """Return the results by their key, without those that share it with others, or have none."""
    values = [key(result) for result in results]
    times = Counter(values)
    alone = dict[Hashable, StoredResult]()
    for value, result in zip(values, results, strict=True):
        if value and times[value] == 1:
            alone[value] = result
    return alone


def _nothing_in_common(old: Sequence[StoredResult], new: Sequence[StoredResult]) -> ConfigError:
    """Return the error for two sets of results without a common dive."""
    old_names = listed(result.name for result in old)
    new_names = listed(result.name for result in new)
    return ConfigError(
        f"no dive of the old results ({old_names}) is in the new ones ({new_names})",
        "name two folders that hold results of the same logs, or two single results",
    )


def _require_one_counterpart(
    before: Sequence[StoredResult], after: Sequence[StoredResult]
) -> None:
    """Raise if a dive is left on both sides: it has several results, and the matching ones are not known."""
    for result in after:
        if not any(_may_match(other, result) for other in before):
            continue
        left = [*before, *after]
        folders = [str(other.folder) for other in left if other.name == result.name]
        text = f"{result.name}: several results could match: {', '.join(folders)}"
        raise ConfigError(text, "name the two folders to compare")


def _may_match(one: StoredResult, other: StoredResult) -> bool:
    """Return whether two results bear the same name, or are of the same log."""
    is_same_log = _hash(one) != "" and _hash(one) == _hash(other)
    return one.name == other.name or is_same_log


# --- Filters.


def with_new_names(
    results: Sequence[StoredResult],
    pairs: Mapping[str, str],  # the new name by the old one
) -> list[StoredResult]:
    """Return old results with the new names of their filters."""
    known = list[str]()
    for result in results:
        known += [result.report.baseline, *result.report.filters]
    names = list(dict.fromkeys(known))
    for old, new in pairs.items():
        require_known("filter", old, names)
        if new in names and new not in pairs:
            text = f"--pair {old}={new}: the old results also have a filter {new}"
            raise ConfigError(text, f"add --pair {new}={new}_before")
    return [replace(result, report=_renamed(result.report, pairs)) for result in results]


def require_new_names(results: Sequence[StoredResult], pairs: Mapping[str, str]) -> None:
    """Require that new results have the filters that old ones are paired with.

    A filter that gives its name away may get one that no result has.
    """
    known = list[str]()
    for result in results:
        known += [result.report.baseline, *result.report.filters]
    names = list(dict.fromkeys(known))
    for old, new in pairs.items():
        if new not in names and old not in pairs.values():
            text = f"--pair {old}={new}: the new results have no filter {new}"
            raise ConfigError(text, hint_for(new, names))


def _renamed(report: StoredReport, pairs: Mapping[str, str]) -> StoredReport:
    """Return a report in which some filters have other names."""
    tables = dict[str, list[Row]]()
    for table, rows in report.tables.items():
        tables[table] = []
        for row in rows:
            name = row.get("filter")
            tables[table].append({**row, "filter": pairs.get(str(name), name)})
    filters = {pairs.get(name, name): candidate for name, candidate in report.filters.items()}
    baseline = pairs.get(report.baseline, report.baseline)
    return msgspec.structs.replace(report, tables=tables, filters=filters, baseline=baseline)
