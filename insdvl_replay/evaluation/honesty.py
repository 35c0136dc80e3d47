"""Honesty: whether innovations and errors are as large as a filter says, beside the baseline; of no weight for gain."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from insdvl_replay.core.quantities import ALL_CREDIBILITY_GROUPS, HONESTY, VERDICTS_BEST_FIRST, is_used
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow
from insdvl_replay.core.words import Consistency, EvidenceWord

NOTABLY: Final = 1.1
"""A mean NIS or NEES nearer to its degrees of freedom by less is as honest."""


def honesty_rows(
    named: tuple[str, str],
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
    baseline: str,
    is_read: bool,
) -> Iterator[EvidenceRow]:
    """Compare how far the mean NIS, and the mean NEES, is from what each filter expects.

    Of the baseline's measurements, and of the groups of states, the gravest stands for a filter; beside a solution that
    was read, of the groups of which that tells. Of the candidate's further sensors those count in which it is
    over-confident.
    """
    of_both = {row.measurement for row in consistency if row.filter == baseline}
    told = {row.quantity for row in credibility if row.filter == named[1]}
    groups = told & set(ALL_CREDIBILITY_GROUPS) if is_read else ALL_CREDIBILITY_GROUPS
    sizes = {
        "nis": [
            (row.filter, _Size(_mean(row.mean_nis, row.dof), row.verdict))
            for row in consistency
            if is_used(row.measurement) and (row.measurement in of_both or row.verdict == Consistency.OVER_CONFIDENT)
        ],
        "nees": [
            (row.filter, _Size(_mean(row.mean_nees, row.dof), row.verdict))
            for row in credibility
            if row.quantity in groups
        ],
    }
    for quantity, found in sizes.items():
        before, after = (_gravest(size for name, size in found if name == one) for one in (baseline, named[1]))
        if not (math.isfinite(before.mean) and math.isfinite(after.mean)):
            continue
        ratio, nan = math.exp(_off(after.mean) - _off(before.mean)), math.nan
        word = _more_honest(before, after, ratio)
        yield EvidenceRow(*named, HONESTY, quantity, "", before.mean, after.mean, ratio, nan, nan, nan, 1, 0, word)


class _Size(NamedTuple):
    """A mean over its degrees of freedom, 1 is expected, and its verdict."""

    mean: float
    verdict: str


def _more_honest(before: _Size, after: _Size, ratio: float) -> EvidenceWord:
    """Judge whose mean is nearer to 1; a candidate is not the more honest for being over-confident instead."""
    if Consistency.TOO_FEW in (before.verdict, after.verdict):
        return EvidenceWord.UNDECIDED
    if before.verdict == after.verdict == Consistency.OVER_CAUTIOUS:
        return EvidenceWord.EQUIVALENT  # both promise less than they keep
    graver = _gravity(after) > _gravity(before)
    if ratio < 1.0 / NOTABLY and before.verdict != Consistency.CONSISTENT and not graver:
        return EvidenceWord.BETTER
    if after.verdict != Consistency.CONSISTENT and (ratio > NOTABLY or graver):
        return EvidenceWord.WORSE
    return EvidenceWord.EQUIVALENT


def _gravity(size: _Size) -> int:
    return VERDICTS_BEST_FIRST.index(Consistency(size.verdict)) if size.verdict in VERDICTS_BEST_FIRST else -1


def _gravest(sizes: Iterable[_Size]) -> _Size:
    """Return the size with the gravest verdict, of those the largest; NaN without any.

    Small ones say less: a filter starts on the reference, and what it keeps of that is as small as it happens to be.
    """
    ranks = ((_gravity(size), -1.0 if math.isnan(size.mean) else size.mean, size) for size in sizes)
    return max(ranks, default=(-1, -1.0, _Size(math.nan, "")))[-1]


def _mean(mean: float | None, dof: int) -> float:
    return finite(mean) / dof if dof else math.nan


def _off(size: float) -> float:
    """Return how far a mean is from what is expected, whichever way; NaN is nearest."""
    return abs(math.log(size)) if size > 0.0 else 0.0 if math.isnan(size) else math.inf
