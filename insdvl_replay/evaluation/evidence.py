"""The evidence on each candidate beside the baseline: what was measured, its interval, and a word.

Both filters ran on the same dive from the same starts, so that everything is paired. *Accuracy* is against the
reference, *coasting* while the DVL is withheld, *withheld* by other sensors that no filter was told of, *convergence*
from starts that err as much as the filters allow for, *honesty* whether innovations and errors are as large as a filter
says; the last says nothing of gain or loss. The word of a piece is that of `paired_statistics.word_of`, and what
`_corrected` leaves of it.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import (
    CONVERGED,
)
from insdvl_replay.core.rows import ConsistencyRow, CredibilityRow, EvidenceRow
from insdvl_replay.core.table_layout import finite
from insdvl_replay.core.words import EvidenceWord
from insdvl_replay.evaluation.consistency import NORMAL_95
from insdvl_replay.evaluation.honesty import honesty_rows
from insdvl_replay.evaluation.losses import Losses
from insdvl_replay.evaluation.measured_convergence import MeasuredConvergence
from insdvl_replay.evaluation.over_dives import holm
from insdvl_replay.evaluation.paired_statistics import (
    RatioInterval,
    paired_ratio,
    ratio_beside_starts,
    windows_ratio,
    word_of,
)

SOONER: Final = 0.25
"""A smaller difference of convergence decides nothing: its interval is over starts, and the sensors err once a dive."""
NOISY: Final = 0.4
"""Share of a root mean square that is the noise of what it is taken against, above which likeness says nothing."""
FAR: Final = 0.1
"""Margin of all pieces but the first: of a dozen, one is often off by more than 5 % on one dive."""
CHANCE: Final = 0.05
"""Largest p, after Holm, with which a piece decides."""


@dataclass(frozen=True)
class Measured:
    """What was measured of all filters of a dive, by filter.

    Attributes
    ----------
    losses : mapping of str to mapping of str to Losses
        By filter and quantity of `quantities.ACCURACY`; empty without a reference.
    coasting : mapping of str to mapping of str to ndarray
        By filter and length of window the horizontal drifts, shape (n,), m.
    convergence : mapping of str to mapping of str to MeasuredConvergence
        By candidate and quantity.
    withheld : mapping of str to mapping of str to Losses
        By filter and quantity of `quantities.WITHHELD_QUANTITIES`; empty where no sensor is withheld.
    beside : mapping of str to (mapping of str to Losses, mapping of str to Losses)
        By candidate that is a solution that was read: the baseline's losses and its own, at the same instants.
    """

    losses: Mapping[str, Mapping[str, Losses]]
    coasting: Mapping[str, Mapping[str, Floats]]
    convergence: Mapping[str, Mapping[str, MeasuredConvergence]]
    withheld: Mapping[str, Mapping[str, Losses]]
    beside: Mapping[str, tuple[Mapping[str, Losses], Mapping[str, Losses]]] = field(default_factory=dict)


def evidence_table(
    log: str,
    baseline: str,
    candidates: Sequence[str],
    measured: Measured,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
) -> list[EvidenceRow]:
    """Hold each candidate against the baseline, piece by piece.

    Parameters
    ----------
    log : str
        Name of the dive.
    baseline : str
        Name of the first filter.
    candidates : sequence of str
        Names of the others.

    Returns
    -------
    list of EvidenceRow
        For each candidate, the piece that decides first in front.
    """
    rows: list[EvidenceRow] = []
    for candidate in candidates:
        named = log, candidate
        deciding = [
            *_accuracy(named, measured, baseline),
            *_coasting(named, measured, baseline),
            *_withheld(named, measured, baseline),
            *_convergence(named, measured),
        ]
        rows += [
            *_corrected(deciding),
            *honesty_rows(named, consistency, credibility, baseline, candidate in measured.beside),
        ]
    return rows


def without_words(rows: Sequence[EvidenceRow], not_judged: Collection[str]) -> list[EvidenceRow]:
    """Take the words from the evidence on candidates that are not judged: no gate on them may pass."""
    return [replace(row, word="") if row.filter in not_judged else row for row in rows]


_Named = tuple[str, str]
"""Dive and candidate."""


def _corrected(rows: Sequence[EvidenceRow]) -> list[EvidenceRow]:
    """Let better and worse stand where one of so many pieces is not so by chance, behind the first where it is far."""
    adjusted = holm(np.array([_chance(row) for row in rows]))
    return [
        replace(row, word=EvidenceWord.UNDECIDED)
        if _is_decided(row) and (p >= CHANCE or (place > 0 and not _is_far(row)))
        else row
        for place, (row, p) in enumerate(zip(rows, adjusted, strict=True))
    ]


def _is_far(row: EvidenceRow) -> bool:
    return not 1.0 / (1.0 + FAR) < finite(row.ratio) < 1.0 + FAR


def _is_decided(row: EvidenceRow) -> bool:
    return row.word in (EvidenceWord.BETTER, EvidenceWord.WORSE)


def _chance(row: EvidenceRow) -> float:
    """Return the two-sided p of a ratio as the normal distribution has it that its interval is of; 1 where unknown.

    The interval is Student's, whose tails are heavier: of few blocks or windows p is too small. Holm's correction, in
    turn, allows for pieces that tell nothing of each other, and most tell the same. How often the words are right is
    measured (`make judge`).
    """
    ratio, low, high = finite(row.ratio), finite(row.low), finite(row.high)
    if not (ratio > 0.0 and 0.0 < low < high < math.inf):
        return 1.0
    sds = abs(math.log(ratio)) / (math.log(high / low) / (2.0 * NORMAL_95))
    return math.erfc(sds / math.sqrt(2.0))


def _accuracy(named: _Named, measured: Measured, baseline: str) -> Iterator[EvidenceRow]:
    if named[1] in measured.beside:
        yield from _of_losses(named, "accuracy", *measured.beside[named[1]], _from_one_start)
    elif named[1] in measured.losses:
        pair = measured.losses[baseline], measured.losses[named[1]]
        yield from _of_losses(named, "accuracy", *pair, _from_same_starts)


def _withheld(named: _Named, measured: Measured, baseline: str) -> Iterator[EvidenceRow]:
    """Compare what sensors say of both that were withheld: nothing of a solution that was read."""
    if ours := measured.withheld.get(named[1]):
        yield from _of_losses(named, "withheld", measured.withheld[baseline], ours, _from_same_starts)


def _of_losses(
    named: _Named,
    evidence: str,
    befores: Mapping[str, Losses],
    afters: Mapping[str, Losses],
    compare: Callable[[Losses, Losses], tuple[float, float, RatioInterval]],
) -> Iterator[EvidenceRow]:
    for quantity, before in ((quantity, losses) for quantity, losses in befores.items() if quantity in afters):
        starts, windows = before.squared.shape
        of_baseline, value, interval = compare(before, afters[quantity])
        largest = max(of_baseline, value)
        word = _word_above_noise(word_of(interval), before.floor / largest if largest else math.inf)
        values = of_baseline, value, *_ends(interval)
        yield EvidenceRow(*named, evidence, quantity, before.unit, *values, starts, windows, word)


def _from_same_starts(before: Losses, after: Losses) -> tuple[float, float, RatioInterval]:
    """Compare the losses of two filters that ran from the same starts: values of both, and their ratio."""
    interval = paired_ratio(before.squared, after.squared, least_block=before.least_block)
    return _rms(before.squared), _rms(after.squared), interval


def _from_one_start(before: Losses, after: Losses) -> tuple[float, float, RatioInterval]:
    """Compare a filter from its starts with a run that may have had any of them: usual values, and their ratio."""
    if len(before.squared) == 1:
        return _from_same_starts(before, after)
    interval = ratio_beside_starts(before.squared, after.squared[0], least_block=before.least_block)
    return _usual_rms(before.squared), _usual_rms(after.squared), interval


def _usual_rms(squared: Floats) -> float:
    """Return the geometric mean over starts of root mean squares, shape (s, k)."""
    each = [_rms(of_start) for of_start in squared]
    return math.exp(float(np.mean(np.log(each)))) if min(each) > 0.0 else _rms(squared)


def _word_above_noise(word: EvidenceWord, share: float) -> EvidenceWord:
    """Let a word stand where not all is the noise of the yardstick, and likeness where hardly anything is."""
    drowned = share >= 1.0 or (share > NOISY and word == EvidenceWord.EQUIVALENT)
    return EvidenceWord.UNDECIDED if drowned else word


def _coasting(named: _Named, measured: Measured, baseline: str) -> Iterator[EvidenceRow]:
    for window, before in measured.coasting.get(baseline, {}).items():
        after = measured.coasting.get(named[1], {}).get(window)
        if after is None or not len(before):
            continue
        interval = windows_ratio(before, after)
        values = _rms(before**2), _rms(after**2)
        quantity, word = f"coasting_{window}", word_of(interval)
        yield EvidenceRow(*named, "coasting", quantity, "m", *values, *_ends(interval), 1, len(before), word)


def _convergence(named: _Named, measured: Measured) -> Iterator[EvidenceRow]:
    converged = measured.convergence.get(named[1], {})
    for quantity, name in CONVERGED.items():
        if (found := converged.get(name)) is not None:
            ends = found.ratio, found.low, found.high, found.low90, found.high90
            interval = RatioInterval(*ends, float(found.starts))
            values = found.baseline_s, found.candidate_s
            word = _word_of_convergence(interval)
            name = f"convergence_{quantity}"
            yield EvidenceRow(*named, "convergence", name, "s", *values, *_ends(interval), found.starts, 0, word)


def _word_of_convergence(interval: RatioInterval) -> EvidenceWord:
    """Return the word on times of which a few of the drawn starts may make others: such are no equal ones, either."""
    word = word_of(interval)
    if word == EvidenceWord.EQUIVALENT:
        return word if _is_near(interval.low) and _is_near(interval.high) else EvidenceWord.UNDECIDED
    return EvidenceWord.UNDECIDED if _is_near(interval.ratio) else word


def _is_near(ratio: float) -> bool:
    return 1.0 / (1.0 + SOONER) < ratio < 1.0 + SOONER


def _ends(interval: RatioInterval) -> tuple[float, float, float, float]:
    return interval.ratio, interval.low, interval.high, interval.independent


def _rms(squared: Floats) -> float:
    known = squared[np.isfinite(squared)]
    return math.sqrt(float(known.mean())) if known.size else math.nan
