"""The evidence on each candidate beside the baseline: what was measured, its interval, and a word.

Both filters ran on the same dive from the same starts, so that everything is paired. *Accuracy* is against the
reference, *coasting* while the DVL is withheld, *withheld* by other sensors that no filter was told of, *convergence*
from starts that err as much as the filters allow for, *honesty* whether innovations and errors are as large as a filter
says; the last says nothing of gain or loss. The word of a piece is that of `paired_statistics.word_of`.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from msgspec.structs import replace

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import CONVERGED, TRACK
from insdvl_replay.core.tables import ConsistencyRow, CredibilityRow, EvidenceRow
from insdvl_replay.core.words import EvidenceWord
from insdvl_replay.evaluation.honesty import honesty_rows
from insdvl_replay.evaluation.losses import Losses, ReferenceNoise
from insdvl_replay.evaluation.measured_convergence import MeasuredConvergence
from insdvl_replay.evaluation.paired_statistics import (
    FEWEST_EFFECTIVE,
    STRETCHES,
    RatioInterval,
    paired_ratio,
    ratio_beside_starts,
    windows_ratio,
    word_of,
)

SOONER: Final = 0.25
"""A smaller difference of convergence decides nothing: its interval is over starts, and the sensors err once a dive."""
NOISE_OF_REFERENCE: Final = "mostly noise of the reference"
NOISY: Final = 0.4
"""Share of a root mean square that is the noise of what it is taken against, above which likeness says nothing."""


@dataclass(frozen=True)
class Measured:
    """What was measured of all filters of a dive, by filter or candidate, then by quantity.

    ``losses`` are those against the reference, ``coasting`` the horizontal drifts, m, in windows of a length,
    ``withheld`` the losses against sensors that are held out. ``beside`` holds the baseline's losses and those of a
    solution that was read, at the same instants. ``track`` holds the baseline's error of the whole dive, and the
    candidate's.
    """

    losses: Mapping[str, Mapping[str, Losses]]
    coasting: Mapping[str, Mapping[str, Floats]]
    convergence: Mapping[str, Mapping[str, MeasuredConvergence]]
    withheld: Mapping[str, Mapping[str, Losses]]
    beside: Mapping[str, tuple[Mapping[str, Losses], Mapping[str, Losses]]] = field(default_factory=dict)
    track: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)


def evidence_table(
    log: str,
    baseline: str,
    candidates: Sequence[str],
    measured: Measured,
    consistency: Sequence[ConsistencyRow],
    credibility: Sequence[CredibilityRow],
) -> list[EvidenceRow]:
    """Hold each candidate against the baseline, piece by piece; the piece that decides first is in front."""
    rows: list[EvidenceRow] = []
    for candidate in candidates:
        named = log, candidate
        rows += [
            *_accuracy(named, measured, baseline),
            *_coasting(named, measured, baseline),
            *_withheld(named, measured, baseline),
            *_convergence(named, measured),
            *_track(named, measured),
            *honesty_rows(named, consistency, credibility, baseline, candidate in measured.beside),
        ]
    return rows


def without_words(rows: Sequence[EvidenceRow], not_judged: Collection[str]) -> list[EvidenceRow]:
    """Take the words from the evidence on candidates that are not judged: no gate on them may pass."""
    return [replace(row, word="") if row.filter in not_judged else row for row in rows]


def nothing_better(rows: Iterable[EvidenceRow]) -> list[EvidenceRow]:
    """Take the word *better* from evidence on a filter that a sensor surprises."""
    return [replace(row, word=EvidenceWord.UNDECIDED) if row.word == EvidenceWord.BETTER else row for row in rows]


_Named = tuple[str, str]
"""Dive and candidate."""


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
    compare: Callable[[Losses, Losses], RatioInterval],
) -> Iterator[EvidenceRow]:
    of_drift: RatioInterval | None = None
    for quantity, before in ((quantity, losses) for quantity, losses in befores.items() if quantity in afters):
        (starts, windows), after = before.squared.shape, afters[quantity]
        interval, largest = compare(before, after), max(_rms(before.squared), _rms(after.squared))
        if quantity.startswith("drift"):
            # Longer segments smear one stretch over its neighbours: the shortest ones tell for all.
            of_drift = of_drift or interval
            if of_drift.stretch is not None:
                samples = min(interval.effective_samples, of_drift.effective_samples)
                interval = interval._replace(effective_samples=samples, stretch=of_drift.stretch)
        share = before.floor / largest if largest else math.inf
        word = _word_above_noise(word_of(interval), share if interval.low < interval.high else 0.0)
        own = [one.squared[0] if one.own is None else one.own for one in (before, after)]
        known = np.isfinite(own[0]) & np.isfinite(own[1])
        values = _rms(own[0][known]), _rms(own[1][known]), *_ends(interval)
        why = _why(interval, before.span_s) or (NOISE_OF_REFERENCE if word != word_of(interval) else "")
        yield EvidenceRow(*named, evidence, quantity, before.unit, *values, starts, windows, word, interval.p, why)


def _why(interval: RatioInterval, span_s: tuple[float, float] = (0.0, 0.0)) -> str:
    """Say why a row cannot decide: one stretch of the dive holds nearly all of the errors, or the samples are few."""
    if interval.effective_samples >= FEWEST_EFFECTIVE:
        return ""
    if interval.stretch is None:
        return f"fewer than {FEWEST_EFFECTIVE:.0f} effective samples"
    stretch_s = (span_s[1] - span_s[0]) / STRETCHES
    begun_s = span_s[0] + interval.stretch * stretch_s
    return f"nearly all of it from {begun_s:.0f} to {begun_s + stretch_s:.0f} s, which is one sample"


def _from_same_starts(before: Losses, after: Losses) -> RatioInterval:
    """Compare the losses of two filters that ran from the same starts."""
    return paired_ratio(before.squared, after.squared, least_block=before.least_block)


def _from_one_start(before: Losses, after: Losses) -> RatioInterval:
    """Compare a filter from its starts with a run that may have had any of them."""
    if len(before.squared) == 1:
        return _from_same_starts(before, after)
    return ratio_beside_starts(before.squared, after.squared[0], least_block=before.least_block)


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
        quantity, word, why = f"coasting_{window}", word_of(interval), _why(interval)
        ends = *values, *_ends(interval)
        yield EvidenceRow(*named, "coasting", quantity, "m", *ends, 1, len(before), word, interval.p, why)


def _track(named: _Named, measured: Measured) -> Iterator[EvidenceRow]:
    """Compare the errors of the whole track from the dive's own start: one sample, which decides nothing alone."""
    for quantity, (before, after) in measured.track.get(named[1], {}).items():
        ratio = after / before if before > 0.0 else math.nan
        values, unit = (before, after, ratio, math.nan, math.nan, 1.0), TRACK[quantity][0]
        yield EvidenceRow(*named, "track", quantity, unit, *values, 1, 0, EvidenceWord.UNDECIDED)


def _convergence(named: _Named, measured: Measured) -> Iterator[EvidenceRow]:
    converged = measured.convergence.get(named[1], {})
    for quantity, name in CONVERGED.items():
        if (found := converged.get(name)) is not None:
            ends = found.ratio, found.low, found.high, found.low90, found.high90
            interval = RatioInterval(*ends, float(found.starts), drawn_p=found.p)
            values = found.baseline_s, found.candidate_s
            word = _word_of_convergence(interval)
            name = f"convergence_{quantity}"
            starts, p = found.starts, interval.p
            yield EvidenceRow(*named, "convergence", name, "s", *values, *_ends(interval), starts, 0, word, p)


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


__all__ = [
    "NOISE_OF_REFERENCE",
    "NOISY",
    "SOONER",
    "Measured",
    "ReferenceNoise",
    "evidence_table",
    "nothing_better",
    "without_words",
]
