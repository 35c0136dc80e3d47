"""The judgement in words: what all evidence says of a candidate, and whether it may believe what it does.

Measured comes first: better, worse, mixed, equivalent or undecided, by the words of each piece of evidence. That a
filter believes in smaller errors is a second statement, which what was measured bears out or not; whether its
innovations and errors are as large as it says is a third. Of a filter that is dead or set wrong, or is held against one
that is, nothing is said of gain or loss.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, Protocol, TypeVar

import numpy as np

from insdvl_replay.core.quantities import (
    ALL_CREDIBILITY_GROUPS,
    DECIDING,
    HONESTY,
    VERDICTS_BEST_FIRST,
    is_beam,
    is_used,
    label,
)
from insdvl_replay.core.states import DVL_AIDING, NINE
from insdvl_replay.core.table import Number, finite
from insdvl_replay.core.tables import Candidate, ConsistencyRow, CredibilityRow, EvidenceRow, Tables
from insdvl_replay.core.words import Belief, Consistency, EvidenceWord, Judgement, ReferenceStatus
from insdvl_replay.evaluation.believed import mean_over_nine, nearest_over_nine, unchanged_over_nine
from insdvl_replay.evaluation.coasting import outage_alarm
from insdvl_replay.evaluation.paired_statistics import RatioInterval, what_settles

NOTABLE_PCT: Final = 5.0
"""A smaller gain is not spoken of as one that somebody believes in."""
BORNE_OUT: Final = 0.5
"""Share of the believed improvement that has to be measured."""
COMPARED: Final = ("velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "heading", "position_h")
"""Quantities whose median change stands for the error against the reference."""
GRAVEST_FIRST: Final = (*reversed(VERDICTS_BEST_FIRST), Consistency.TOO_FEW)
FEWEST_STARTS: Final = 8
"""From fewer drawn starts nothing is said of what is believed: it is mostly that errors of the start wear off."""
MANY_TIMES: Final = 3.0
"""From here on, nobody reads percent."""
MOST_NAMED: Final = 2
"""So many pieces of evidence stand in the sentence with their numbers; the others are in the table."""


class Piece(Protocol):
    """One piece of evidence, of one dive or of several."""

    @property
    def evidence(self) -> str: ...  # noqa: D102
    @property
    def quantity(self) -> str: ...  # noqa: D102
    @property
    def word(self) -> str: ...  # noqa: D102


P = TypeVar("P", bound=Piece)


def verdicts(
    tables: Tables, baseline: str, candidates: Sequence[str], unsound: Mapping[str, str], *, independent: bool
) -> dict[str, Candidate]:
    """Judge each candidate.

    Parameters
    ----------
    baseline : str
        Name of the first filter.
    candidates : sequence of str
        Names of the others.
    unsound : mapping of str to str
        By candidate what keeps it from being judged, from `sound_filters`.
    independent : bool
        Whether the reference shares no sensors with the filters.
    """
    return {candidate: _verdict(tables, baseline, candidate, unsound, independent) for candidate in candidates}


def judgement_of(rows: Iterable[Piece], deciding: Collection[str] = DECIDING) -> Judgement:
    """Return what the evidence on one candidate says together: better in something and worse in nothing, and so on."""
    words = [row.word for row in rows if row.quantity in deciding]
    better, worse = EvidenceWord.BETTER in words, EvidenceWord.WORSE in words
    if better or worse:
        return Judgement.MIXED if better and worse else Judgement.BETTER if better else Judgement.WORSE
    return Judgement.EQUIVALENT if words and words[0] == EvidenceWord.EQUIVALENT else Judgement.UNDECIDED


def belief_of(believed_pct: float, rows: Sequence[EvidenceRow]) -> Belief:
    """Return whether at least half of what is believed was measured; undecided where the interval holds both."""
    measured = [row for row in rows if row.evidence == "accuracy" and row.ratio is not None]
    if not measured or not believed_pct >= NOTABLE_PCT or not _has_starts(measured):
        return Belief.UNDECIDED
    least_pct, most_pct = (
        100.0 * (1.0 - float(np.median([finite(getattr(row, end)) for row in measured]))) for end in ("high", "low")
    )
    if least_pct >= BORNE_OUT * believed_pct:
        return Belief.BORNE_OUT
    return Belief.NOT_BORNE_OUT if most_pct < BORNE_OUT * believed_pct else Belief.UNDECIDED


def _has_starts(measured: Iterable[EvidenceRow]) -> bool:
    return max(row.starts for row in measured) >= FEWEST_STARTS


def consistency_of(table: Sequence[ConsistencyRow], filter_name: str) -> str:
    """Return the gravest verdict among a filter's measurements.

    Their axes say where and do not count: of eight tests one fails by chance in every third honest filter.
    """
    words = [row.verdict for row in table if row.filter == filter_name and is_used(row.measurement)]
    return _gravest(words) if words else Consistency.NOT_TOLD


def credibility_of(table: Sequence[CredibilityRow], filter_name: str) -> str:
    """Return the gravest verdict among the groups of states, of errors against the reference.

    All states together may be consistent with roll and pitch far off, below velocities that hardly err. Where no group
    could be compared, what the first says of that is returned; early results have no groups.
    """
    words = [row.verdict for row in _groups(table, filter_name)]
    if table and not any(row.filter == filter_name for row in table):
        return Consistency.NOT_TOLD
    return _gravest(words) if set(words) & set(GRAVEST_FIRST) else next(iter(words), Consistency.NO_REFERENCE)


def _groups(table: Sequence[CredibilityRow], filter_name: str) -> list[CredibilityRow]:
    return [row for row in table if row.filter == filter_name and row.quantity in ALL_CREDIBILITY_GROUPS]


def _gravest(words: Iterable[str]) -> str:
    found = set(words)
    return next((word for word in GRAVEST_FIRST if word in found), Consistency.TOO_FEW)


def _verdict(tables: Tables, baseline: str, candidate: str, unsound: Mapping[str, str], independent: bool) -> Candidate:
    believed_pct = mean_over_nine(tables.improvement, candidate)
    evidence = [row for row in tables.evidence if row.filter == candidate]
    wrong = unsound.get(candidate, "")
    judgement = Judgement.NOT_JUDGED if wrong else judgement_of(evidence)
    belief = Belief.UNDECIDED if wrong else belief_of(believed_pct, evidence)
    measured = (
        f"{candidate} is NOT JUDGED against {baseline}: {wrong}; settle that first"
        if wrong
        else f"{_measured(candidate, baseline, judgement, evidence)}"
        f"{_on_belief(candidate, baseline, believed_pct, tables)}{_of_belief(believed_pct, belief, tables, evidence)}"
    )
    trust = trust_sentence(tables, candidate, baseline)
    shared = "" if independent or not _has_reference(tables) else f" {SHARED}"
    return Candidate(
        verdict=f"{measured}. {trust}{shared}",
        improvement=judgement,
        consistency=consistency_of(tables.consistency, candidate),
        mean_improvement_pct=believed_pct,
        mean_convergence_improvement_pct=mean_over_nine(tables.convergence, candidate),
        reference_improvement_pct=_median_pct(tables, candidate),
        credibility=credibility_of(tables.credibility, candidate),
        belief=belief,
        mean_convergence_unchanged_pct=unchanged_over_nine(tables.convergence, candidate),
        mean_nearest_approach_improvement_pct=nearest_over_nine(tables.convergence, candidate),
    )


SHARED: Final = "The reference shares sensors with the filters: errors that they have in common are not seen."
AGAINST: Final = {
    Judgement.BETTER: "is BETTER than",
    Judgement.WORSE: "is WORSE than",
    Judgement.MIXED: "is better in some and WORSE in other things than",
    Judgement.EQUIVALENT: "is as good as",
    Judgement.UNDECIDED: "is undecided against",
}


def _measured(candidate: str, baseline: str, judgement: Judgement, evidence: Sequence[EvidenceRow]) -> str:
    """State what was measured, by the pieces of evidence that decided, or those that could have."""
    named = "; ".join(map(_in_words, spoken_of(judgement, evidence))) or "there is nothing to measure it by"
    left = left_undecided(judgement, evidence) or _what_settles(judgement, evidence)
    return f"{candidate} {AGAINST[judgement]} {baseline}: {named}{left}{_on_honesty(judgement, evidence)}"


def _what_settles(judgement: Judgement, evidence: Sequence[EvidenceRow]) -> str:
    """Say what would decide an undecided dive, by the first piece of evidence that is not about a single stretch."""
    rows = [row for row in evidence if row.quantity in DECIDING and not row.why]
    if judgement != Judgement.UNDECIDED or not rows:
        return ""
    ends = finite(rows[0].ratio), finite(rows[0].low), finite(rows[0].high)
    samples = finite(rows[0].effective_samples)
    needed = what_settles(RatioInterval(*ends, *ends[1:], samples, max(samples - 1.0, 1.0)), 1)
    return f"; {needed}" if needed else ""


def left_undecided(judgement: Judgement, rows: Iterable[Piece], deciding: Collection[str] = DECIDING) -> str:
    """Name what is undecided where the first piece alone makes filters equivalent, as the end of a sentence."""
    words = (row.quantity for row in rows if row.quantity in deciding and row.word == EvidenceWord.UNDECIDED)
    names = [label(quantity) for quantity in words] if judgement == Judgement.EQUIVALENT else []
    return f"; undecided: {', '.join(names)}" if names else ""


def spoken_of(judgement: Judgement, rows: Iterable[P], deciding: Collection[str] = DECIDING) -> list[P]:
    """Choose pieces of evidence of each word that made the judgement, or could have: the first of each kind."""
    of_judgement: dict[Judgement, tuple[EvidenceWord, ...]] = {
        Judgement.BETTER: (EvidenceWord.BETTER,),
        Judgement.WORSE: (EvidenceWord.WORSE,),
        Judgement.MIXED: (EvidenceWord.BETTER, EvidenceWord.WORSE),
        Judgement.EQUIVALENT: (EvidenceWord.EQUIVALENT,),
    }
    words = of_judgement.get(judgement, (EvidenceWord.UNDECIDED,))
    known = [row for row in rows if row.quantity in deciding]
    first = ({row.evidence: row for row in reversed(known) if row.word == word} for word in words)
    return [row for kinds in first for row in [*reversed(kinds.values())][: MOST_NAMED // len(words)]]


def changed(quantity: str, ratio: float) -> str:
    """State by how much a quantity is smaller or larger, or sooner or later."""
    if not np.isfinite(ratio):
        return f"{label(quantity)} unknown"
    if ratio >= MANY_TIMES:
        return f"{label(quantity)} {ratio:.3g} times as {'late' if quantity.startswith('convergence') else 'large'}"
    smaller, larger = ("sooner", "later") if quantity.startswith("convergence") else ("smaller", "larger")
    return f"{label(quantity)} {abs(100.0 * (ratio - 1.0)):.1f} % {smaller if ratio <= 1.0 else larger}"


def interval_in_words(ratio: Number, low: Number, high: Number) -> str:
    """Write the interval of a ratio, in percent or, as the ratio itself, in times."""
    if finite(ratio) >= MANY_TIMES:
        return f"{finite(low):.3g} to {finite(high):.3g} times"
    low_pct, high_pct = (100.0 * (finite(end) - 1.0) for end in (low, high))
    return f"{low_pct:+z.1f} to {high_pct:+z.1f} %"


def _in_words(row: EvidenceRow) -> str:
    ratio = finite(row.ratio)
    if not np.isfinite(ratio):
        return changed(row.quantity, ratio)
    values = f"{finite(row.baseline):.3g} {row.unit}, now {finite(row.value):.3g} {row.unit}"
    interval = interval_in_words(row.ratio, row.low, row.high)
    why = f"; {row.why}" if row.why else ""
    return f"{changed(row.quantity, ratio)} (this dive: {values}; 95 % on this dive: {interval}{why})"


def _on_honesty(judgement: Judgement, evidence: Sequence[EvidenceRow]) -> str:
    words = {row.word for row in evidence if row.evidence == HONESTY} & {EvidenceWord.BETTER, EvidenceWord.WORSE}
    if len(words) != 1:
        return ""
    is_more = EvidenceWord.BETTER in words
    joined = "but" if is_more == (judgement == Judgement.WORSE) else "and"
    return f"; {joined} it is {'more' if is_more else 'less'} honest"


def _median_pct(tables: Tables, candidate: str) -> float:
    """Return the median improvement of the compared quantities that have one, NaN without any."""
    changes = [
        finite(row.improvement_pct)
        for row in tables.reference_error
        if row.filter == candidate and row.status == ReferenceStatus.COMPARED and row.quantity in COMPARED
    ]
    known = [change for change in changes if np.isfinite(change)]
    return float(np.median(known)) if known else float("nan")


def _has_reference(tables: Tables) -> bool:
    return any(row.samples for row in tables.reference_error)


def _on_belief(candidate: str, baseline: str, believed_pct: float, tables: Tables) -> str:
    """Begin the sentence on what is believed; of a solution that says nothing of that there is none."""
    told = {row.state for row in tables.improvement if row.filter == candidate}
    if told >= {state.id for state in NINE}:
        return f". It {_believes(believed_pct, baseline)}"
    return ". It says how sure it is of some states alone" if told else ""


def _believes(believed_pct: float, baseline: str) -> str:
    if not np.isfinite(believed_pct):
        return "believes in nothing finite"
    if abs(believed_pct) < NOTABLE_PCT:
        return f"believes in errors as large as those of {baseline} ({believed_pct:+z.1f} %)"
    return f"believes in {abs(believed_pct):.1f} % {'smaller' if believed_pct > 0 else 'larger'} errors"


def _of_belief(believed_pct: float, belief: Belief, tables: Tables, evidence: Sequence[EvidenceRow]) -> str:
    """State whether what is believed is borne out; that there is no reference is said of the dive, once."""
    if not believed_pct >= NOTABLE_PCT or not _has_reference(tables):
        return ""
    measured = [row for row in evidence if row.evidence == "accuracy"]
    if not measured:
        return ", and the reference does not tell whether that is so"
    if not _has_starts(measured):
        return f", and it takes {FEWEST_STARTS} drawn starts to tell whether that is so"
    return {
        Belief.BORNE_OUT: ", and that is borne out",
        Belief.NOT_BORNE_OUT: ", and that is NOT borne out",
        Belief.UNDECIDED: ", and whether that is so is undecided",
    }[belief]


def _trust(tables: Tables, name: str) -> str:
    """Join what innovations and errors say; the one word where they agree or only one of them speaks."""
    consistency, credibility = consistency_of(tables.consistency, name), credibility_of(tables.credibility, name)
    if credibility == Consistency.TOO_FEW or credibility not in GRAVEST_FIRST:
        return consistency
    if consistency == Consistency.NOT_TOLD:
        return f"{credibility}{_where(tables.credibility, name, credibility)} against the reference"
    where = _where(tables.credibility, name, credibility)
    if consistency == credibility:
        return f"{consistency} by the innovations, and{where} against the reference" if where else consistency
    if consistency == Consistency.TOO_FEW:
        return f"{credibility}{where} against the reference"
    return f"{consistency} by the innovations and {credibility}{where} against the reference"


def _where(table: Sequence[CredibilityRow], name: str, credibility: str) -> str:
    """Name the groups of states that have the gravest verdict, where others have a better one."""
    groups = [row for row in _groups(table, name) if row.verdict in VERDICTS_BEST_FIRST]
    grave = [row.quantity.replace("_", " ") for row in groups if row.verdict == credibility]
    return f" in {' and '.join(grave)}" if len(grave) < len(groups) else ""


def trust_sentence(tables: Tables, candidate: str, baseline: str) -> str:
    """State whether errors, innovations and NIS without DVL of candidate and baseline are as large as each says.

    A candidate that is aided by a sensor beside the DVL has the NIS of each of its sensors in the sentence.
    """
    return f"{_on_trust(tables, candidate, baseline)}{outage_alarm(tables.coasting, (baseline, candidate))}"


def _on_trust(tables: Tables, candidate: str, baseline: str) -> str:
    trust, of_baseline = _trust(tables, candidate), _trust(tables, baseline)
    if trust == Consistency.NOT_TOLD:
        return f"{candidate} does not say how sure it is, {baseline} is {of_baseline}."
    if trust != of_baseline:
        sentence = f"{candidate} is {trust}, {baseline} {of_baseline}."
    else:
        sentence = "Too few updates to judge either." if trust == Consistency.TOO_FEW else f"Both filters are {trust}."
    used = [row for row in tables.consistency if row.filter == candidate and is_used(row.measurement)]
    if all(row.measurement in DVL_AIDING or is_beam(row.measurement) for row in used):
        return sentence
    sizes = ", ".join(f"{row.measurement} {finite(row.mean_nis) / row.dof:.3g}" for row in used)
    return f"{sentence} NIS / dof of {candidate}: {sizes}."
