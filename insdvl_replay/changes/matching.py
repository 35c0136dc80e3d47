"""Match the results of two sets: dives by the hash of their logs, else by name; filters by name, or as asked."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace as with_fields
from typing import Final

from msgspec.structs import replace

from insdvl_replay.core.errors import ConfigError, listed, require_known
from insdvl_replay.core.result import StoredReport, StoredResult
from insdvl_replay.core.words import MatchedBy

# Results of one log in several folders are matched by their place, then by their name.
_KEYS: Final[tuple[tuple[MatchedBy, Callable[[StoredResult], Hashable]], ...]] = (
    (MatchedBy.HASH, lambda result: (result.report.log.sha256, result.below)),
    (MatchedBy.HASH, lambda result: (result.report.log.sha256, result.name)),
    (MatchedBy.HASH, lambda result: result.report.log.sha256),
    (MatchedBy.NAME, lambda result: (result.name, result.below)),
    (MatchedBy.NAME, lambda result: result.name),
)


def match_dives(
    old: Sequence[StoredResult], new: Sequence[StoredResult]
) -> list[tuple[StoredResult | None, StoredResult | None, MatchedBy]]:
    """Match results of the same dive, by the hash of the log, else by name; those without counterpart come last.

    Two single results are always matched.
    """
    found, before, after = dict[int, tuple[StoredResult, MatchedBy]](), list(old), list(new)
    for how, key in _KEYS:
        alone = []
        for results in (before, after):
            # A dive that was not read from a file has no hash.
            known = [result for result in results if how != MatchedBy.HASH or result.report.log.sha256]
            times = Counter(map(key, known))
            alone.append({key(result): result for result in known if times[key(result)] == 1})
        theirs, ours = alone
        found |= {id(ours[value]): (theirs[value], how) for value in theirs.keys() & ours.keys()}
        taken = {id(was) for was, _ in found.values()}
        before = [result for result in before if id(result) not in taken]
        after = [result for result in after if id(result) not in found]
    if len(old) == len(new) == 1 and not found:
        return [(old[0], new[0], MatchedBy.CHOICE)]
    # A dive that is left on both sides has several results, and the matching ones are not known.
    for result in after:
        digest = result.report.log.sha256
        if any(other.name == result.name or (digest and other.report.log.sha256 == digest) for other in before):
            folders = [str(other.folder) for other in (*before, *after) if other.name == result.name]
            raise ConfigError(
                f"{result.name}: several results could match: {', '.join(folders)}", "name the two folders to compare"
            )
    if not found:
        old_names, new_names = ([result.name for result in results] for results in (old, new))
        raise ConfigError(
            f"no dive of the old results ({listed(old_names)}) is in the new ones ({listed(new_names)})",
            "name two folders that hold results of the same logs, or two single results",
        )
    return [
        *((found[id(result)][0], result, found[id(result)][1]) for result in new if id(result) in found),
        *((result, None, MatchedBy.NOTHING) for result in before),
        *((None, result, MatchedBy.NOTHING) for result in after),
    ]


def parse_pairs(texts: Iterable[str]) -> dict[str, str]:
    """Read pairs such as ``aided=windowed``, the new name by the old one."""
    pairs = {}
    for text in texts:
        old, _, new = text.partition("=")
        if not (old and new):
            raise ConfigError(f"--pair {text}: is not of the form OLD=NEW", "write --pair aided=windowed")
        pairs[old] = new
    return pairs


def with_new_names(results: Sequence[StoredResult], pairs: Mapping[str, str]) -> list[StoredResult]:
    """Return old results with the new names of their filters."""
    names = list(dict.fromkeys(name for result in results for name in (result.report.baseline, *result.report.filters)))
    for old, new in pairs.items():
        require_known("filter", old, names)
        if new in names and new not in pairs:
            raise ConfigError(
                f"--pair {old}={new}: the old results also have a filter {new}", f"add --pair {new}={new}_before"
            )

    def renamed(report: StoredReport) -> StoredReport:
        return replace(
            report,
            tables={
                table: [{**row, "filter": pairs.get(str(row.get("filter")), row.get("filter"))} for row in rows]
                for table, rows in report.tables.items()
            },
            filters={pairs.get(name, name): candidate for name, candidate in report.filters.items()},
            baseline=pairs.get(report.baseline, report.baseline),
        )

    return [with_fields(result, report=renamed(result.report)) for result in results]
