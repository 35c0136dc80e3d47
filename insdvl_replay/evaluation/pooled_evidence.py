"""The evidence of several dives together: each dive is one pair, however long it is."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.pooled_row import PooledRow
from insdvl_replay.core.quantities import DECIDING_TOGETHER, EVIDENCE_QUANTITIES
from insdvl_replay.core.rows import EvidenceRow
from insdvl_replay.core.table_layout import finite
from insdvl_replay.core.words import EvidenceWord, Judgement
from insdvl_replay.evaluation.honesty import HONESTY
from insdvl_replay.evaluation.over_dives import Pooled, pooled_ratio
from insdvl_replay.evaluation.paired_statistics import FEWEST_EFFECTIVE, word_of
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
OF_FIRST, OF_OTHERS = 0.05, 0.01
"""Largest p with which the first piece of evidence decides, and each behind it: all of eight dives agree."""


def pooled_evidence(candidate: str, dives: Sequence[Sequence[EvidenceRow]]) -> list[PooledRow]:
    """Pool what each dive holds on one candidate.

    Parameters
    ----------
    dives : sequence of sequence of EvidenceRow
        The candidate's rows of each dive in which it is judged.

    Returns
    -------
    list of PooledRow
        The piece that decides first in front; the others need a smaller p, since one of many decides by chance.
    """
    found = [(rows, pooled_ratio(_log_ratios(rows))) for rows in _by_quantity(dives)]
    return [
        _row(candidate, rows, pooled, _word(rows, pooled, OF_OTHERS if place else OF_FIRST))
        for place, (rows, pooled) in enumerate(found)
    ]


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
    named = "; ".join(_in_words(row) for row in spoken_of(judgement, pooled.rows, DECIDING_TOGETHER))
    found = named or "there is nothing to measure it by"
    left = left_undecided(judgement, pooled.rows, DECIDING_TOGETHER)
    return f"{pooled.name} {AGAINST[judgement]} {pooled.baseline} over {dives}: {found}{left}."


def _in_words(row: PooledRow) -> str:
    interval = interval_in_words(row.ratio, row.low, row.high)
    won = "sooner" if row.evidence == "convergence" else "smaller"
    return (
        f"{changed(row.quantity, finite(row.ratio))} ({interval_name(row)}: {interval}; {won} in "
        f"{row.dives_won} of {row.dives} dives, p = {finite(row.p):.2g})"
    )


def interval_name(row: PooledRow) -> str:
    """Say what low and high are: of fewer than six dives not even the range holds the ratio with 95 %."""
    return "95 %" if row.dives >= FEWEST_EFFECTIVE else "range"


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


def _word(rows: Sequence[EvidenceRow], pooled: Pooled, largest_p: float) -> EvidenceWord:
    if any((row.baseline is None) != (row.value is None) for row in rows):
        # One of the filters never settled on some dive: the dives with a ratio are those where it did.
        return EvidenceWord.UNDECIDED
    word = word_of(pooled.interval)
    decided = word in (EvidenceWord.BETTER, EvidenceWord.WORSE)
    return EvidenceWord.UNDECIDED if decided and not pooled.p < largest_p else word


def _median(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def _row(candidate: str, rows: Sequence[EvidenceRow], pooled: Pooled, word: EvidenceWord) -> PooledRow:
    first = rows[0]
    baseline, value = (_median([finite(getattr(row, name)) for row in rows]) for name in ("baseline", "value"))
    ends = pooled.ratio, pooled.low, pooled.high, pooled.dives, pooled.won, pooled.p
    return PooledRow(EVERY_DIVE, candidate, first.evidence, first.quantity, first.unit, baseline, value, *ends, word)
