"""The evidence of several dives together: each dive is one pair, however long it is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.quantities import CONSISTENT, DECIDING_TOGETHER, EVIDENCE_QUANTITIES
from insdvl_replay.core.tables import EvidenceRow, PooledRow, finite
from insdvl_replay.core.words import EvidenceWord, Judgement
from insdvl_replay.evaluation.series import RatioInterval, dives_ratio, what_settles, word_of
from insdvl_replay.evaluation.verdicts import (
    AGAINST,
    changed,
    interval_in_words,
    judgement_of,
    left_undecided,
    spoken_of,
)

EVERY_DIVE: Final = "*"  # In place of a dive's name.
FEWEST_DIVES: Final = 3  # Fewer dives decide nothing.


def pooled_evidence(
    candidate: str,
    dives: Sequence[Sequence[EvidenceRow]],  # the candidate's rows of each dive in which it is evaluated
) -> list[PooledRow]:
    """Pool what each dive holds on one candidate; the piece that decides first is in front."""
    gathered: dict[str, list[EvidenceRow]] = {}
    for row in (row for rows in dives for row in rows if row.evidence != CONSISTENT):
        gathered.setdefault(row.quantity, []).append(row)
    pooled = []
    for rows in (gathered[quantity] for quantity in EVIDENCE_QUANTITIES if quantity in gathered):
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.asarray(np.log([finite(row.ratio) for row in rows]))
        interval = dives_ratio(logs)
        word = word_of(interval, FEWEST_DIVES)
        if any((row.baseline is None) != (row.value is None) for row in rows):
            # One of the filters never settled on some dive: the dives with a ratio are those where it did.
            word = EvidenceWord.UNDECIDED
        medians = [float("nan"), float("nan")]
        for i, values in enumerate(([finite(row.baseline) for row in rows], [finite(row.value) for row in rows])):
            told = [value for value in values if np.isfinite(value)]
            medians[i] = float(np.median(told)) if told else float("nan")
        baseline, value = medians
        known, won = int(np.isfinite(logs).sum()), int((logs < 0.0).sum())
        ends = interval.ratio, interval.low, interval.high, known, won, interval.p
        pooled.append(
            PooledRow(
                EVERY_DIVE, candidate, rows[0].evidence, rows[0].quantity, rows[0].unit, baseline, value, *ends, word
            )
        )
    return pooled


@dataclass(frozen=True)
class PooledCandidate:
    """What several dives say of a candidate together."""

    name: str
    baseline: str
    rows: tuple[PooledRow, ...]  # the piece that decides first in front
    dives: int  # that have the candidate
    judged: int  # in which it is evaluated

    @property
    def judgement(self) -> Judgement:
        """The verdict on it."""
        return pooled_judgement(self.rows, self.dives, self.judged)


def pooled_candidate(
    name: str, baseline: str, evidence: Sequence[Sequence[EvidenceRow]], dives: int
) -> PooledCandidate:
    """Pool the evidence on one candidate, from the dives in which it is evaluated."""
    return PooledCandidate(name, baseline, tuple(pooled_evidence(name, evidence)), dives, len(evidence))


def pooled_judgement(rows: Sequence[PooledRow], dives: int, judged: int) -> Judgement:
    """Return what the evidence of several dives says together; nothing where half of them are not evaluated."""
    return Judgement.NOT_EVALUATED if 2 * judged <= dives else judgement_of(rows, DECIDING_TOGETHER)


def pooled_sentence(pooled: PooledCandidate) -> str:
    """Say in one sentence what several dives say of a candidate."""
    judgement, dives = pooled.judgement, f"{pooled.judged} of {pooled.dives} dives"
    if judgement == Judgement.NOT_EVALUATED:
        found = f"it is judged in {dives}; settle the others first"
        return f"{pooled.name} is NOT EVALUATED against {pooled.baseline}: {found}."
    spoken, pieces = spoken_of(judgement, pooled.rows, DECIDING_TOGETHER), []
    for row in spoken:
        interval = interval_in_words(row.ratio, row.low, row.high)
        won = "sooner" if row.evidence == "convergence" else "smaller"
        pieces.append(
            f"{changed(row.quantity, finite(row.ratio))} (95 % over dives: {interval}; {won} in "
            f"{row.dives_won} of {row.dives} dives, p = {finite(row.p):.2g})"
        )
    if not pieces:
        pieces = ["there is nothing to measure it by"]
    elif judgement == Judgement.UNDECIDED:
        row = spoken[0]
        ends = finite(row.ratio), finite(row.low), finite(row.high)
        needed = what_settles(RatioInterval(*ends, *ends[1:], float(row.dives), row.dives - 1.0), row.dives)
        pieces += [needed] if needed else []
    left = left_undecided(judgement, pooled.rows, DECIDING_TOGETHER)
    return f"{pooled.name} {AGAINST[judgement]} {pooled.baseline} over {dives}: {'; '.join(pieces)}{left}."
