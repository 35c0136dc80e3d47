"""The evidence of several dives together: each dive is one pair, however long it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import DECIDING_TOGETHER, EVIDENCE_QUANTITIES, HONESTY
from insdvl_replay.core.table import finite
from insdvl_replay.core.tables import EvidenceRow, PooledRow
from insdvl_replay.core.words import EvidenceWord, Judgement
from insdvl_replay.evaluation.paired_statistics import (
    RatioInterval,
    dives_ratio,
    what_settles,
    word_of,
)
from insdvl_replay.evaluation.verdicts import (
    AGAINST,
    changed,
    interval_in_words,
    judgement_of,
    left_undecided,
    spoken_of,
)

EVERY_DIVE: Final = "*"
"""Stands in place of a dive's name."""
FEWEST_DIVES: Final = 3
"""Fewer dives decide nothing."""


def pooled_evidence(candidate: str, dives: Sequence[Sequence[EvidenceRow]]) -> list[PooledRow]:
    """Pool what each dive holds on one candidate.

    Parameters
    ----------
    dives : sequence of sequence of EvidenceRow
        The candidate's rows of each dive in which it is judged.

    Returns
    -------
    list of PooledRow
        The piece that decides first in front.
    """
    return [_row(candidate, rows) for rows in _by_quantity(dives)]


@dataclass(frozen=True)
class PooledCandidate:
    """What several dives say of a candidate together.

    Attributes
    ----------
    rows : tuple of PooledRow
        The piece that decides first in front.
    dives, judged : int
        Dives that have the candidate, and those of them in which it is judged.
    """

    name: str
    baseline: str
    rows: tuple[PooledRow, ...]
    dives: int
    judged: int

    @property
    def judgement(self) -> Judgement:
        """The word on it."""
        return pooled_judgement(self.rows, self.dives, self.judged)


def pooled_candidate(
    name: str, baseline: str, evidence: Sequence[Sequence[EvidenceRow]], dives: int
) -> PooledCandidate:
    """Pool the evidence on one candidate, from the dives in which it is judged."""
    return PooledCandidate(name, baseline, tuple(pooled_evidence(name, evidence)), dives, len(evidence))


def pooled_sentence(pooled: PooledCandidate) -> str:
    """State in one sentence what several dives say of a candidate."""
    judgement, dives = pooled.judgement, f"{pooled.judged} of {pooled.dives} dives"
    if judgement == Judgement.NOT_JUDGED:
        found = f"it is judged in {dives}; settle the others first"
        return f"{pooled.name} is NOT JUDGED against {pooled.baseline}: {found}."
    spoken = spoken_of(judgement, pooled.rows, DECIDING_TOGETHER)
    found = "; ".join(map(_in_words, spoken)) or "there is nothing to measure it by"
    if judgement == Judgement.UNDECIDED and spoken and (needed := _what_settles(spoken[0])):
        found += f"; {needed}"
    left = left_undecided(judgement, pooled.rows, DECIDING_TOGETHER)
    return f"{pooled.name} {AGAINST[judgement]} {pooled.baseline} over {dives}: {found}{left}."


def _in_words(row: PooledRow) -> str:
    interval = interval_in_words(row.ratio, row.low, row.high)
    won = "sooner" if row.evidence == "convergence" else "smaller"
    return (
        f"{changed(row.quantity, finite(row.ratio))} (95 % over dives: {interval}; {won} in "
        f"{row.dives_won} of {row.dives} dives, p = {finite(row.p):.2g})"
    )


def _what_settles(row: PooledRow) -> str:
    ends = finite(row.ratio), finite(row.low), finite(row.high)
    interval = RatioInterval(*ends, *ends[1:], float(row.dives), row.dives - 1.0)
    return what_settles(interval, row.dives)


def pooled_judgement(rows: Sequence[PooledRow], dives: int, judged: int) -> Judgement:
    """Return what the evidence of several dives says together; nothing where half of them are not judged."""
    return Judgement.NOT_JUDGED if 2 * judged <= dives else judgement_of(rows, DECIDING_TOGETHER)


def _by_quantity(dives: Sequence[Sequence[EvidenceRow]]) -> Iterator[list[EvidenceRow]]:
    """Gather the rows of each quantity, the one that decides first in front, whichever dive has it."""
    gathered: dict[str, list[EvidenceRow]] = {}
    for row in (row for rows in dives for row in rows if row.evidence != HONESTY):
        gathered.setdefault(row.quantity, []).append(row)
    yield from (gathered[quantity] for quantity in EVIDENCE_QUANTITIES if quantity in gathered)


def _log_ratios(rows: Sequence[EvidenceRow]) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log([finite(row.ratio) for row in rows]))


def _median(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def _row(candidate: str, rows: Sequence[EvidenceRow]) -> PooledRow:
    first, logs = rows[0], _log_ratios(rows)
    interval = dives_ratio(logs)
    word = word_of(interval, FEWEST_DIVES)
    if any((row.baseline is None) != (row.value is None) for row in rows):
        # One of the filters never settled on some dive: the dives with a ratio are those where it did.
        word = EvidenceWord.UNDECIDED
    baseline, value = (_median([finite(getattr(row, name)) for row in rows]) for name in ("baseline", "value"))
    dives, won = int(np.isfinite(logs).sum()), int((logs < 0.0).sum())
    ends = interval.ratio, interval.low, interval.high, dives, won, interval.p
    return PooledRow(EVERY_DIVE, candidate, first.evidence, first.quantity, first.unit, baseline, value, *ends, word)
