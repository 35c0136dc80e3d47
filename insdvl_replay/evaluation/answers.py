"""The answer for a candidate over several dives, or on one: one primary quantity, its interval, and its word.

The primary quantity is chosen by what the logs contain, before anything is compared. Its interval over dives gives the
verdict (`interval.word_of_interval`). Other quantities can warn and cannot win. Convergence is a second answer by the
same rule. One dive has no verdict, except where it is proved how little the candidate does.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Final, TypeVar

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DRAWN_HEADING,
    EVIDENCE_QUANTITIES,
    FEWEST_DIVES,
    PREDICTION,
    PRIMARIES,
    SECONDARIES,
    WITHOUT_VERDICT,
)
from insdvl_replay.core.tables import (
    AnswerRow,
    AssayRow,
    EvidenceRow,
    Number,
    PooledRow,
    finite,
)
from insdvl_replay.core.words import (
    EvidenceVerdict,
    Prediction,
    ReasonCode,
    Role,
    Settling,
    Verdict,
)
from insdvl_replay.evaluation.interval import (
    BAND,
    LEVEL,
    NO_SPREAD,
    Interval,
    RunSpread,
    holm_levels,
    is_by_vehicle,
    level_of_candidates,
    log_ratio_interval,
    widened,
    word_of_interval,
)

NOTABLE_PCT: Final = 5.0  # A smaller predicted gain is not checked.
CONFIRMED: Final = 0.5  # Share of the predicted improvement that has to be measured.
NO_EFFECT: Final = 0.01  # A candidate that moves every error by less has no effect.
# A candidate that moves an error by less cannot leave the band, on whatever dives.
PROVED: Final = 1.0 - 1.0 / BAND
# Share of the reference's noise above which equality of filters is that of the noise.
NOISY: Final = 0.5
EVERY_DIVE: Final = "*"  # Instead of a dive's name.
CONTROL: Final = "tuned"  # The filter that `--control` adds.
DECIDED: Final = (EvidenceVerdict.BETTER, EvidenceVerdict.WORSE)
# The words that contradict a decided one.
_OPPOSITE: Final = {
    EvidenceVerdict.BETTER: (EvidenceVerdict.WORSE,),
    EvidenceVerdict.WORSE: (EvidenceVerdict.BETTER,),
}

_SETTLING: Final = {
    EvidenceVerdict.BETTER: Settling.SOONER,
    EvidenceVerdict.EQUIVALENT: Settling.SAME,
    EvidenceVerdict.UNDECIDED: Settling.UNDECIDED,
    EvidenceVerdict.WORSE: Settling.LATER,
}
_WITHOUT_DVL: Final = {
    Verdict.BETTER: Verdict.BETTER_WITHOUT_DVL,
    Verdict.EQUIVALENT: Verdict.EQUIVALENT_WITHOUT_DVL,
    Verdict.WORSE: Verdict.WORSE_WITHOUT_DVL,
}
# Verdicts by which a candidate is better, and by which it is worse, in whatever quantity decides.
GOOD: Final = (Verdict.BETTER, Verdict.BETTER_WITHOUT_DVL)
BAD: Final = (Verdict.WORSE, Verdict.WORSE_WITHOUT_DVL, Verdict.MIXED)


class Answer(Struct, frozen=True, kw_only=True):
    """The verdict on a filter against another, by one dive or by several together."""

    filter: str
    baseline: str
    verdict: Verdict
    dives: Annotated[
        int, Meta(description="dives that have the filter; of a comparison, on both sides")
    ]
    evaluated: Annotated[
        int,
        Meta(description="of them, those in which it is evaluated; of a comparison, on a side"),
    ]
    rows: tuple[
        PooledRow, ...
    ]  # the primary row, those that can warn, convergence, and the others
    primary: Annotated[str, Meta(description="the quantity that decides; empty for none")] = ""
    settling: Annotated[
        str,
        Meta(description="the second answer: sooner, later, same or undecided; empty: not known"),
    ]
    undecided: Annotated[
        ReasonCode, Meta(description="why the verdict is undecided; empty where it is not")
    ] = ReasonCode.NONE
    reason: Annotated[
        str,
        Meta(
            description="why it is not evaluated, or has no evidence, on a dive: the most common reason"
        ),
    ] = ""

    @property
    def known(self) -> list[PooledRow]:
        """The rows that have a ratio."""
        return [row for row in self.rows if math.isfinite(finite(row.ratio))]

    @property
    def decisive(self) -> PooledRow | None:
        """The primary row."""
        return _row_with(self.rows, Role.PRIMARY)

    @property
    def warnings(self) -> list[PooledRow]:
        """The rows that can warn and whose word is not that of the primary row."""
        word = EvidenceVerdict.UNDECIDED
        if self.decisive is not None:
            word = EvidenceVerdict(self.decisive.verdict)
        wanted = _OPPOSITE.get(word, DECIDED)
        warned = [row for row in self.rows if row.role == Role.SECONDARY and row.verdict in wanted]
        # The prediction only vetoes.
        if word == EvidenceVerdict.BETTER:
            warned += [row for row in self.rows if row.role == Role.VETO and row.verdict in wanted]
        return warned

    @property
    def from_drawn_heading(self) -> PooledRow | None:
        """The row of the position from a drawn heading, where only the reference gave that of the start."""
        return _drawn_row(self.rows)

    @property
    def is_by_heading(self) -> bool:
        """Whether the word depends on the heading at the start."""
        return starts_contradict(self.decisive, self.from_drawn_heading)

    @property
    def settles(self) -> PooledRow | None:
        """The row of the second answer."""
        return _row_with(self.rows, Role.SETTLING)

    @property
    def acting(self) -> PooledRow | None:
        """The row of the error that the candidate changes most, for its size."""
        known = [row for row in self.rows if math.isfinite(finite(row.acts))]
        return max(known, key=lambda row: finite(row.acts), default=None)


A = TypeVar("A", bound=Answer)


class CandidateAnswer(Answer, frozen=True, kw_only=True):
    """The verdict on a candidate of a replay, or of several, and what it predicts by its own covariance."""

    log: str = EVERY_DIVE
    verdict_always: Verdict  # by the intervals that may be looked at after every dive
    predicted_pct: Number  # how much smaller its predicted sigma is; of several dives the median
    prediction: Prediction  # whether it is confirmed


def _row_with(rows: Iterable[PooledRow], role: Role) -> PooledRow | None:
    """Return the first row with a role; None if there is none."""
    for row in rows:
        if row.role == role:
            return row
    return None


def _drawn_row(rows: Iterable[PooledRow]) -> PooledRow | None:
    """Return the row of the position from a drawn heading; None if there is none."""
    for row in rows:
        if row.quantity == DRAWN_HEADING:
            return row
    return None


# --- The primary quantity.


def primary_of(dives: Sequence[Sequence[EvidenceRow]], named: str = "") -> str:
    """Choose the quantity that decides, by what the dives contain; empty if there is none.

    Position decides if at least half of the dives have it, and at least three of three or more. An outage row decides
    if every dive has it.
    """
    if named:
        return named
    if not dives:
        return ""
    having = Counter[str]()
    for rows in dives:
        having.update(row.quantity for row in rows if row.role == Role.PRIMARY)
    for quantity in PRIMARIES:
        if having[quantity] >= _fewest_dives_with(quantity, len(dives)):
            return quantity
    return ""


def _fewest_dives_with(quantity: str, dives: int) -> int:
    """Return how many of some dives must have a quantity, so that it may decide over them."""
    if quantity == "position":
        return max(min(dives, FEWEST_DIVES), math.ceil(dives / 2))
    return dives


# --- The rows over several dives.


def pooled_evidence(
    candidate: str,
    # the candidate's rows of each dive in which it is evaluated
    dives: Sequence[Sequence[EvidenceRow]],
    *,
    primary: str | None = None,  # the quantity that decides; None: by `primary_of`
    level: float = LEVEL,
    vehicles: Sequence[str] | None = None,  # of each dive
    spreads: Mapping[str, RunSpread] = MappingProxyType({}),  # of repeated runs, by quantity
) -> list[PooledRow]:
    """Pool the evidence of several dives on one candidate; the row that decides is in front."""
    if primary is None:
        primary = primary_of(dives)
    if vehicles is None:
        vehicles = [""] * len(dives)
    by_quantity: dict[str, list[tuple[EvidenceRow, str]]] = {}
    for rows, vehicle in zip(dives, vehicles, strict=True):
        for row in rows:
            if row.evidence != CONSISTENCY:
                by_quantity.setdefault(row.quantity, []).append((row, vehicle))
    quantities = [quantity for quantity in EVIDENCE_QUANTITIES if quantity in by_quantity]
    roles = _roles(quantities, primary, _may_warn(by_quantity))
    # Secondary rows share the error of one.
    secondary = [quantity for quantity in quantities if roles[quantity] == Role.SECONDARY]
    p_values = [_interval(by_quantity[quantity], level).p for quantity in secondary]
    levels = dict(zip(secondary, holm_levels(p_values, level), strict=True))
    pooled = list[PooledRow]()
    for quantity in quantities:
        of_quantity = _pooled_row(
            candidate,
            by_quantity[quantity],
            roles[quantity],
            levels.get(quantity, level),
            spreads.get(quantity, NO_SPREAD),
        )
        pooled.append(of_quantity)
    order = list(Role)
    return sorted(pooled, key=lambda row: order.index(Role(row.role)))


def _may_warn(by_quantity: Mapping[str, Sequence[tuple[EvidenceRow, str]]]) -> set[str]:
    """Return the quantities that can warn on at least half of their dives."""
    found = set[str]()
    for quantity, rows in by_quantity.items():
        may_warn = sum(row.role in (Role.PRIMARY, Role.SECONDARY) for row, _ in rows)
        if 2 * may_warn >= len(rows):
            found.add(quantity)
    return found


def _roles(quantities: Sequence[str], primary: str, may_warn: Collection[str]) -> dict[str, Role]:
    """Give each quantity its role: one decides, the first known of each kind can warn, one is the second answer."""
    roles = dict.fromkeys(quantities, Role.SHOWN)
    for kind in SECONDARIES.values():
        known = [quantity for quantity in kind if quantity in may_warn]
        if known and primary not in kind:
            roles[known[0]] = Role.SECONDARY
    settling = [quantity for quantity in quantities if quantity.startswith("convergence")]
    if settling:
        roles[settling[0]] = Role.SETTLING
    if PREDICTION in roles:
        roles[PREDICTION] = Role.VETO
    if primary in roles:
        roles[primary] = Role.PRIMARY
    return roles


def _interval(rows: Sequence[tuple[EvidenceRow, str]], level: float) -> Interval:
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log([finite(row.ratio) for row, _ in rows])
    return log_ratio_interval(logs, level=level, vehicles=[vehicle for _, vehicle in rows])


def _pooled_row(
    candidate: str,
    rows_of_dives: Sequence[tuple[EvidenceRow, str]],
    role: Role,
    level: float,
    spread: RunSpread,  # of repeated runs
) -> PooledRow:
    rows = [row for row, _ in rows_of_dives]
    compared = _compared(rows)
    interval = widened(_interval(rows_of_dives, level), spread, level)
    acts_most = _largest(row.acts for row in rows)
    noise_share = median_of(finite(row.reference_noise) for row in rows)
    word = _word_of(rows, interval.low, interval.high, acts_most, noise_share)
    word_always = _word_of(rows, interval.low_always, interval.high_always, acts_most, noise_share)
    return PooledRow(
        log=EVERY_DIVE,
        filter=candidate,
        evidence=rows[0].evidence,
        quantity=rows[0].quantity,
        unit=rows[0].unit,
        baseline=median_of(finite(row.baseline) for row in compared),
        value=median_of(finite(row.value) for row in compared),
        ratio=interval.ratio,
        low=interval.low,
        high=interval.high,
        level_pct=100.0 * level,
        low_always=interval.low_always,
        high_always=interval.high_always,
        dives=interval.dives,
        dives_won=sum(finite(row.ratio) < 1.0 for row in compared),
        scatter=math.nan if is_by_vehicle(interval) else interval.scatter,
        p=interval.p,
        moves=median_of(finite(row.moves) for row in rows),
        acts=median_of(finite(row.acts) for row in rows),
        acts_most=acts_most,
        reference_noise=noise_share,
        role=role,
        verdict=word,
        verdict_always=word_always,
        vehicles=_vehicles_named(rows_of_dives, interval),
    )


def _compared(rows: Sequence[EvidenceRow]) -> Sequence[EvidenceRow]:
    """Return the rows whose ratio counts, so that values and ratio are those of the same dives; all if none counts."""
    compared = [row for row in rows if finite(row.ratio) > 0.0]
    if compared:
        return compared
    return rows


def _vehicles_named(rows: Sequence[tuple[EvidenceRow, str]], interval: Interval) -> int:
    """Return how many vehicles an interval has, 0 if no dive says which vehicle made it."""
    if any(vehicle for _, vehicle in rows):
        return interval.vehicles
    return 0


def _word_of(
    rows: Sequence[EvidenceRow],
    low: float,
    high: float,
    acts_most: float,
    noise_share: float,
) -> EvidenceVerdict | Settling:
    """Return the word of the interval of some rows, in the words of the second answer for convergence."""
    word = word_of_interval(low, high)
    is_settling = rows[0].evidence == "convergence"
    if acts_most < PROVED:
        word = EvidenceVerdict.EQUIVALENT
    elif is_settling and _is_unsettled(rows):
        word = EvidenceVerdict.UNDECIDED
    elif word == EvidenceVerdict.EQUIVALENT:
        word = _equal_or_noise(noise_share)
    if is_settling:
        return _SETTLING[word]
    return word


def _equal_or_noise(noise_share: float) -> EvidenceVerdict:
    """Return the word of errors that are equal: undecided where most of them is noise of the reference."""
    if noise_share > NOISY:
        return EvidenceVerdict.UNDECIDED
    return EvidenceVerdict.EQUIVALENT


def _is_unsettled(rows: Sequence[EvidenceRow]) -> bool:
    """Return whether on some dive one of the filters never settled: only where both settled there is a ratio."""
    return any((row.baseline is None) != (row.value is None) for row in rows)


def _largest(numbers: Iterable[Number]) -> float:
    """Return the largest number, NaN if one is missing."""
    known = [finite(number) for number in numbers]
    if known:
        return float(np.max(known))
    return math.nan


def median_of(numbers: Iterable[float]) -> float:
    """Return the median of the finite numbers, NaN for none."""
    known = [number for number in numbers if math.isfinite(number)]
    if known:
        return float(np.median(known))
    return math.nan


# --- What the dives could have shown.


def assay_rows(dives: Sequence[Sequence[AssayRow]], primary: str) -> list[PooledRow]:
    """Pool the controls of several dives: what each quantity would have said of each planted fault."""
    by_control: dict[str, list[list[EvidenceRow]]] = {}
    for rows in dives:
        of_dive: dict[str, list[EvidenceRow]] = {}
        for row in rows:
            of_dive.setdefault(row.filter, []).append(_as_evidence(row))
        for control, evidence in of_dive.items():
            by_control.setdefault(control, []).append(evidence)
    pooled = list[PooledRow]()
    for control, found in by_control.items():
        pooled += pooled_evidence(control, found, primary=primary)
    return pooled


def _as_evidence(row: AssayRow) -> EvidenceRow:
    return EvidenceRow(
        log=row.log,
        filter=row.filter,
        evidence="assay",
        quantity=row.quantity,
        unit=row.unit,
        baseline=row.baseline,
        value=row.value,
        ratio=row.ratio,
        role=row.role,
    )


def seen_controls(rows: Sequence[PooledRow]) -> tuple[list[str], list[str]]:
    """Return the controls that the primary quantity would have seen as better or worse, and the others."""
    primary = [row for row in rows if row.role == Role.PRIMARY]
    seen = [row.filter for row in primary if row.verdict in DECIDED]
    return seen, [row.filter for row in primary if row.filter not in seen]


# --- The verdict.


def verdict_of(rows: Sequence[PooledRow], dives: int) -> tuple[Verdict, ReasonCode]:
    """Return the verdict of the rows of one candidate, and why it is undecided."""
    most = largest_acts(rows)
    if most < NO_EFFECT:
        return Verdict.NO_EFFECT, ReasonCode.NONE
    primary = _row_with(rows, Role.PRIMARY)
    if most < PROVED:
        return _of_quantity(Verdict.EQUIVALENT, primary), ReasonCode.NONE
    if dives == 1:
        return Verdict.UNDECIDED, ReasonCode.ONE_DIVE
    if primary is None or not math.isfinite(finite(primary.ratio)):
        return Verdict.UNDECIDED, ReasonCode.NO_PRIMARY
    if starts_contradict(primary, _drawn_row(rows)):
        return Verdict.MIXED, ReasonCode.NONE
    word = EvidenceVerdict(primary.verdict)
    if word == EvidenceVerdict.UNDECIDED:
        return Verdict.UNDECIDED, _why_undecided(primary)
    if word == EvidenceVerdict.BETTER and _is_warned(rows):
        return Verdict.MIXED, ReasonCode.NONE
    return _of_quantity(Verdict(word.value), primary), ReasonCode.NONE


def _is_warned(rows: Sequence[PooledRow]) -> bool:
    """Return whether a row that can warn is worse."""
    warning = [row for row in rows if row.role in (Role.SECONDARY, Role.VETO)]
    return any(row.verdict == EvidenceVerdict.WORSE for row in warning)


def largest_acts(rows: Sequence[PooledRow]) -> float:
    """Return how far the candidate moves an error at most; NaN where that is not known of all errors that it moves."""
    moved = [
        row for row in rows if math.isfinite(finite(row.moves)) or math.isfinite(finite(row.acts))
    ]
    return _largest(row.acts_most for row in moved)


def starts_contradict(primary: PooledRow | None, drawn: PooledRow | None) -> bool:
    """Return whether position says another thing from the drawn heading than from the reference's.

    One of the two rows is better or worse. The other has another word, or it is undecided and lies on the other side:
    its ratio beyond the band, or its interval beyond 1.
    """
    if (
        primary is None
        or drawn is None
        or primary.evidence != "track"
        or not primary.quantity.startswith("position")
    ):
        return False
    return _denies(primary, drawn) or _denies(drawn, primary)


def _denies(row: PooledRow, other: PooledRow) -> bool:
    """Return whether a row is decided, and another one cannot stand beside it."""
    if row.verdict not in DECIDED:
        return False
    if other.verdict != EvidenceVerdict.UNDECIDED:
        return other.verdict != row.verdict
    if row.verdict == EvidenceVerdict.BETTER:
        return finite(other.ratio) > BAND or finite(other.low) > 1.0
    return finite(other.ratio) < 1.0 / BAND or finite(other.high) < 1.0


def _of_quantity(verdict: Verdict, primary: PooledRow | None) -> Verdict:
    """Give the words of an outage their object: how well a filter navigates with the DVL was not measured."""
    is_outage = primary is not None and primary.evidence == "outage"
    if is_outage:
        return _WITHOUT_DVL[verdict]
    return verdict


def _why_undecided(primary: PooledRow) -> ReasonCode:
    if primary.dives < FEWEST_DIVES:
        return ReasonCode.FEW_DIVES
    if word_of_interval(finite(primary.low), finite(primary.high)) == EvidenceVerdict.EQUIVALENT:
        return ReasonCode.NOISE
    return ReasonCode.WIDE


def pooled_candidate(
    name: str,
    baseline: str,
    evidence: Sequence[Sequence[EvidenceRow]],  # of each dive in which it is evaluated
    dives: int,
    predicted_pct: Iterable[Number] = (),  # of each of these dives
    reasons: Iterable[str] = (),  # why it is not evaluated in the other dives
    *,
    primary: str | None = None,
    level: float = LEVEL,
    vehicles: Sequence[str] | None = None,
    not_repeatable: int = 0,  # of the other dives, those on which it does not repeat
    spreads: Mapping[str, RunSpread] = MappingProxyType({}),  # of repeated runs, by quantity
) -> CandidateAnswer:
    """Answer for one candidate by the rows of its dives, one dive or more.

    It is not evaluated if at least half of the dives are not. If it does not repeat on most of the dives that are not
    evaluated, this is the word.
    """
    if primary is None:
        primary = primary_of(evidence)
    rows = tuple(
        pooled_evidence(
            name, evidence, primary=primary, level=level, vehicles=vehicles, spreads=spreads
        )
    )
    pct = median_of(map(finite, predicted_pct))
    reason = _most_common(reasons)
    verdict, undecided = verdict_of(rows, len(evidence))
    always, _ = verdict_of([_for_every_look(row) for row in rows], len(evidence))
    # Two vehicles that cancel each other may look equivalent together.
    if vehicles is not None:
        words = _words_of_two(evidence, primary, level, vehicles)
        if _contradict(word for word, _ in words):
            verdict = Verdict.MIXED
            undecided = ReasonCode.NONE
        if _contradict(word_always for _, word_always in words):
            always = Verdict.MIXED
    if 2 * len(evidence) <= dives:
        verdict = Verdict.NOT_EVALUATED
        if 2 * not_repeatable > dives - len(evidence):
            verdict = Verdict.NOT_REPEATABLE
        always = verdict
        undecided = ReasonCode.NONE
        reason = reason or "too few dives are evaluated"
    settling_row = _row_with(rows, Role.SETTLING)
    return CandidateAnswer(
        filter=name,
        baseline=baseline,
        verdict=verdict,
        verdict_always=always,
        dives=dives,
        evaluated=len(evidence),
        rows=rows,
        primary=primary,
        settling="" if settling_row is None else settling_row.verdict,
        undecided=undecided,
        reason=reason,
        predicted_pct=pct,
        prediction=prediction_of(pct, rows),
    )


class CandidateOnDive(Struct, frozen=True, kw_only=True):
    """What the result of one dive says of a candidate."""

    log: str  # name of the dive
    baseline: str
    vehicle: str  # empty: nobody said
    verdict: str
    reason: str  # why it is not evaluated; empty if it is
    predicted_pct: Number
    rows: Sequence[EvidenceRow]


def answer_over_dives(
    name: str,
    dives: Sequence[CandidateOnDive],
    *,
    primary: str = "",
    level: float = LEVEL,
    spreads: Mapping[str, RunSpread] = MappingProxyType({}),
) -> CandidateAnswer:
    """Answer for one candidate by the results of the dives that have it.

    Parameters
    ----------
    name : str
        The candidate.
    dives : sequence of CandidateOnDive
        All dives that have it, evaluated or not.
    primary : str
        The quantity that the settings name; empty for the one that the dives choose.
    level : float
        Confidence of the interval.
    spreads : mapping of str to RunSpread
        How far repeated runs differ, by quantity. No interval is narrower.
    """
    evaluated = [dive for dive in dives if dive.verdict not in WITHOUT_VERDICT]
    evidence = [dive.rows for dive in evaluated]
    answer = pooled_candidate(
        name,
        " or ".join(sorted({dive.baseline for dive in dives})),
        evidence,
        len(dives),
        [dive.predicted_pct for dive in evaluated],
        [dive.reason for dive in dives],
        primary=primary_of(evidence, primary),
        level=level,
        vehicles=[dive.vehicle for dive in evaluated],
        not_repeatable=sum(dive.verdict == Verdict.NOT_REPEATABLE for dive in dives),
        spreads=spreads,
    )
    if len(dives) == 1:
        answer = replace(answer, log=dives[0].log)
    return answer


def _most_common(reasons: Iterable[str]) -> str:
    """Return the most common reason; empty if there is none."""
    given = Counter(reason for reason in reasons if reason)
    if not given:
        return ""
    [(reason, _)] = given.most_common(1)
    return reason


def levels_of(answers: Sequence[Answer], named: str = "") -> dict[str, float]:
    """Return the confidence of the interval of each candidate, by name; several share the error rate of one.

    ``named`` is the candidate that the settings name. Controls, and candidates without any effect, do not count.
    """
    levels = dict.fromkeys((answer.filter for answer in answers), LEVEL)
    sharing = [
        answer.filter
        for answer in answers
        if answer.filter != CONTROL and answer.verdict != Verdict.NO_EFFECT
    ]
    for name in sharing:
        levels[name] = level_of_candidates(
            len(sharing), named=named in sharing, is_named=name == named
        )
    return levels


def answers_together(
    names: Iterable[str], answer_at: Callable[[str, float], A], named: str = ""
) -> dict[str, A]:
    """Answer for several candidates, each with its share of the error rate.

    Parameters
    ----------
    names : iterable of str
        The candidates.
    answer_at : callable
        Gives the answer for a candidate at a confidence.
    named : str
        The candidate that the settings name.
    """
    alone = {name: answer_at(name, LEVEL) for name in names}
    levels = levels_of(list(alone.values()), named)
    together = dict(alone)
    for name, level in levels.items():
        if level != LEVEL:
            together[name] = answer_at(name, level)
    return together


def _words_of_two(
    evidence: Sequence[Sequence[EvidenceRow]],
    primary: str,
    level: float,
    vehicles: Sequence[str],
) -> list[tuple[EvidenceVerdict, EvidenceVerdict]]:
    """Return the words of each of two vehicles, once and for every look; none if there are not two vehicles."""
    names = set(vehicles)
    words = list[tuple[EvidenceVerdict, EvidenceVerdict]]()
    if len(names) != 2:
        return words
    for name in names:
        own: list[tuple[EvidenceRow, str]] = []
        for rows, vehicle in zip(evidence, vehicles, strict=True):
            if vehicle == name:
                own += [(row, name) for row in rows if row.quantity == primary]
        interval = _interval(own, level)
        word = word_of_interval(interval.low, interval.high)
        word_always = word_of_interval(interval.low_always, interval.high_always)
        words.append((word, word_always))
    return words


def _contradict(words: Iterable[EvidenceVerdict]) -> bool:
    """Return whether the candidate is better on one vehicle, and worse on the other."""
    return {*words} == {*DECIDED}


def _for_every_look(row: PooledRow) -> PooledRow:
    """Return a row with the interval, and the word, that may be looked at after every dive."""
    return replace(row, low=row.low_always, high=row.high_always, verdict=row.verdict_always)


def prediction_of(predicted_pct: float, rows: Sequence[PooledRow]) -> Prediction:
    """Return whether at least half of a predicted improvement was measured in the primary quantity."""
    primary = _row_with(rows, Role.PRIMARY)
    if primary is None or not predicted_pct >= NOTABLE_PCT:
        return Prediction.UNDECIDED
    needed_pct = CONFIRMED * predicted_pct
    least_pct = 100.0 * (1.0 - finite(primary.high))
    most_pct = 100.0 * (1.0 - finite(primary.low))
    if least_pct >= needed_pct:
        return Prediction.CONFIRMED
    # A proof that the candidate does nearly nothing refutes it, too.
    if most_pct < needed_pct or 100.0 * finite(primary.acts_most) < needed_pct:
        return Prediction.NOT_CONFIRMED
    return Prediction.UNDECIDED


# --- The answer for scripts.


def answer_row(answer: CandidateAnswer) -> AnswerRow:
    """Return an answer as a row of its table."""
    found = AnswerRow(
        log=answer.log,
        filter=answer.filter,
        baseline=answer.baseline,
        verdict=answer.verdict,
        verdict_always=answer.verdict_always,
        primary=answer.primary,
        ratio=None,
        low=None,
        high=None,
        dives=answer.dives,
        evaluated=answer.evaluated,
        vehicles=0,
        convergence=answer.settling,
        reason_code=reason_code_of(answer),
    )
    row = answer.decisive
    if row is None:
        return found
    return replace(
        found,
        ratio=row.ratio,
        low=row.low,
        high=row.high,
        vehicles=row.vehicles,
    )


def reason_code_of(answer: Answer) -> ReasonCode:
    """Return why an answer is no plain word of its primary quantity, as a word for scripts."""
    if answer.verdict in WITHOUT_VERDICT:
        return ReasonCode.EXCLUDED
    if answer.verdict != Verdict.MIXED:
        return answer.undecided
    if answer.is_by_heading:
        return ReasonCode.START
    primary = answer.decisive
    is_better = primary is not None and primary.verdict == EvidenceVerdict.BETTER
    if is_better and _is_warned(answer.rows):
        return ReasonCode.WARNING
    return ReasonCode.VEHICLES
