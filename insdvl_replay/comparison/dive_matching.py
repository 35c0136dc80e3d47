"""Which result of the new set is of the same dive as which of the old: by the hash of the log, else by name."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.errors import ConfigError
from insdvl_replay.core.stored_report import StoredResult
from insdvl_replay.core.words import MatchedBy

_Key = Callable[[StoredResult], Hashable]


@dataclass(frozen=True)
class Matching:
    """Who belongs to whom.

    Attributes
    ----------
    pairs : tuple of (StoredResult, StoredResult, str)
        Old, new, and what they were matched by; in the order of the new ones.
    removed, new : tuple of StoredResult
        Without counterpart.
    """

    pairs: tuple[tuple[StoredResult, StoredResult, MatchedBy], ...]
    removed: tuple[StoredResult, ...]
    new: tuple[StoredResult, ...]


# Results of one log in several folders are told apart by their place, then by their name.
_KEYS: Final[tuple[tuple[MatchedBy, _Key], ...]] = (
    (MatchedBy.HASH, lambda result: (result.report.log.sha256, result.below)),
    (MatchedBy.HASH, lambda result: (result.report.log.sha256, result.name)),
    (MatchedBy.HASH, lambda result: result.report.log.sha256),
    (MatchedBy.NAME, lambda result: (result.name, result.below)),
    (MatchedBy.NAME, lambda result: result.name),
)


def match_dives(old: Sequence[StoredResult], new: Sequence[StoredResult]) -> Matching:
    """Match results of the same dive.

    Two single results are matched whatever they are: they were meant.
    """
    if len(old) == len(new) == 1:
        return Matching(((old[0], new[0], _how_alike(old[0], new[0])),), (), ())
    left = {id(result): result for result in old}
    found: dict[int, tuple[StoredResult, MatchedBy]] = {}
    for how, key in _KEYS:
        unmatched = [result for result in new if id(result) not in found]
        theirs, ours = (_unique(results, how, key) for results in (left.values(), unmatched))
        for value in theirs.keys() & ours.keys():
            found[id(ours[value])] = theirs[value], how
            del left[id(theirs[value])]
    pairs = tuple((found[id(result)][0], result, found[id(result)][1]) for result in new if id(result) in found)
    unmatched = [result for result in new if id(result) not in found]
    _require_unambiguous(list(left.values()), unmatched)
    if not pairs:
        raise ConfigError(
            f"no dive of {_names(old)} is among {_names(new)}, by hash or by name",
            "name two folders that hold results of the same logs, or two single results",
        )
    return Matching(pairs, tuple(left.values()), tuple(unmatched))


def _how_alike(old: StoredResult, new: StoredResult) -> MatchedBy:
    if old.report.log.sha256 and old.report.log.sha256 == new.report.log.sha256:
        return MatchedBy.HASH
    return MatchedBy.NAME if old.name == new.name else MatchedBy.CHOICE


def _unique(results: Iterable[StoredResult], how: MatchedBy, key: _Key) -> dict[Hashable, StoredResult]:
    """Return the results that are alone with their key. A dive that was never a file has no hash."""
    by_key: dict[Hashable, list[StoredResult]] = {}
    for result in results:
        if how != MatchedBy.HASH or result.report.log.sha256:
            by_key.setdefault(key(result), []).append(result)
    return {value: together[0] for value, together in by_key.items() if len(together) == 1}


def _require_unambiguous(old: Sequence[StoredResult], new: Sequence[StoredResult]) -> None:
    """Raise if a dive is left on both sides: it has several results, and nothing says which belong together."""
    shared = {result.name for result in old} & {result.name for result in new}
    hashes = {result.report.log.sha256 for result in old} & {result.report.log.sha256 for result in new} - {""}
    for result in new:
        if result.name in shared or result.report.log.sha256 in hashes:
            folders = [str(other.folder) for other in (*old, *new) if other.name == result.name]
            raise ConfigError(
                f"{result.name}: several results could belong together: {', '.join(folders)}",
                "name the two folders that are to be compared",
            )


def _names(results: Sequence[StoredResult]) -> str:
    names = [result.name for result in results]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
