"""The answer of a comparison: each filter, new against old, by the rule of a verdict.

The errors of one filter in two runs of a dive are paired. Their ratio is one sample of each dive, pooled as the
evidence of a candidate over several dives is.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from typing import Annotated, Final, NamedTuple

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import RowPair, is_number, paired_rows
from insdvl_replay.changes.matching import Pair
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.of_reference import is_independent
from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DRIFT_QUANTITIES,
    FEWEST_DIVES,
    WITHOUT_VERDICT,
)
from insdvl_replay.core.report import StoredReport
from insdvl_replay.core.tables import TABLES, EvidenceRow, Number, WhereRow, finite
from insdvl_replay.core.words import ReasonCode, Role, Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import BAD, pooled_candidate, primary_of
from insdvl_replay.evaluation.evidence import role_alone
from insdvl_replay.evaluation.interval import LEVEL, level_of_candidates
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.evaluation.where import pooled_where, where_between

OLD: Final = "before"  # name of the old side in sentences
_TABLES: Final = [layout for layout in TABLES if layout.name in ("evidence", "drift", "outage")]
# of every value that may decide or warn: so small a change on a dive is none
_NO_CHANGE: Final = 0.01


class DiveChange(Struct, frozen=True):
    """The value behind an answer on one dive."""

    log: str
    quantity: str
    unit: str
    old: Number
    new: Number
    ratio: Number


class Answer(answers.Answer, frozen=True, kw_only=True):
    """One filter, new against old; in its rows the old values are in ``baseline``, the new ones in ``value``."""

    sentence: str
    lost: Annotated[int, Meta(description="dives in which only the old side is evaluated")]
    largest_change: Annotated[
        Number,
        Meta(
            description="largest relative change of a value that may decide or warn, on any dive"
        ),
    ]
    by_dive: Annotated[
        tuple[DiveChange, ...], Meta(description="the primary quantity, dive by dive")
    ] = ()

    @property
    def is_equal(self) -> bool:
        """Whether no value differs."""
        return finite(self.largest_change) == 0.0

    @property
    def is_same(self) -> bool:
        """Whether no value differs; or, of too few dives for an interval, none that may decide by 1 %."""
        if self.is_equal:
            return True
        return finite(self.largest_change) < _NO_CHANGE and self.evaluated < FEWEST_DIVES

    @property
    def sameness(self) -> str:
        """How small the changes are, for the end of a sentence."""
        if self.is_equal:
            return "has the same evidence as before"
        return "changed by less than 1 % in all that may decide"

    @property
    def is_harm(self) -> bool:
        """Whether it fails `--fail-on worse`: worse, partly worse, or lost on a dive."""
        return self.verdict in BAD or self.lost > 0


class _Paired(Struct, frozen=True):
    """One filter in the dives of both sides."""

    name: str
    pairs: list[Pair]  # the dives
    # why it is not evaluated on a dive of them, on the new side or on the old one; empty if it is
    reasons: list[str]
    lost: int  # dives in which only the old side is evaluated
    evaluated: list[Pair]  # dives on which a side is evaluated
    evidence: list[list[EvidenceRow]]  # of these
    is_equal: bool  # whether all tables of all dives are equal

    @property
    def largest_change(self) -> float:
        """Largest relative change of a value that may decide or warn."""
        rows = chain.from_iterable(self.evidence)
        return max(map(_size_of_change, rows), default=0.0 if self.is_equal else math.inf)

    @property
    def primary(self) -> str:
        """The quantity that decides: as the settings name it, else by what the logs contain."""
        for pair in self.pairs:
            named = pair.new.report.config.get("evaluation", {}).get("primary")
            if named:
                return primary_of(self.evidence, str(named))
        return primary_of(self.evidence, "")


class ComparedFilters(NamedTuple):
    """Each filter that both sides have, new against old."""

    answers: tuple[Answer, ...]
    where: tuple[
        WhereRow, ...
    ]  # the drift of all of them by what the vehicle does, over several dives


def answers_of(pairs: Sequence[Pair]) -> tuple[Answer, ...]:
    """Compare each filter that both sides have with itself, over all dives."""
    return compared_filters(pairs).answers


def compared_filters(pairs: Sequence[Pair]) -> ComparedFilters:
    """Compare each filter that both sides have with itself, over all dives, and by what the vehicle does."""
    pairs = _without_copies(pairs)
    having: dict[str, list[Pair]] = {}
    for pair in pairs:
        theirs = (pair.old.report.baseline, *pair.old.report.filters)
        for name in (pair.new.report.baseline, *pair.new.report.filters):
            if name in theirs:
                having.setdefault(name, []).append(pair)
    is_equal = all(old.report.tables == new.report.tables for old, new in pairs)
    paired = [_paired(name, own, is_equal=is_equal) for name, own in having.items()]
    # Filters that changed share the error rate of one.
    changed = [found.name for found in paired if found.largest_change > 0.0]
    level = level_of_candidates(len(changed))
    found = list[Answer]()
    where = list[WhereRow]()
    for one in paired:
        own_level = level if one.name in changed else LEVEL
        answer = _answer(one, own_level)
        found.append(answer)
        if len(one.evaluated) > 1 and answer.verdict not in WITHOUT_VERDICT:
            where += _where(one, own_level)
    # What is not finite is missing, as in JSON.
    known = msgspec.json.encode(ComparedFilters(tuple(found), tuple(where)))
    return msgspec.json.decode(known, type=ComparedFilters)


def _without_copies(pairs: Sequence[Pair]) -> list[Pair]:
    """Count copies of a dive once."""
    kept, _ = distinct_dives([pair.new.report for pair in pairs])
    distinct = {id(report) for report in kept}
    return [pair for pair in pairs if id(pair.new.report) in distinct]


def _paired(name: str, pairs: list[Pair], *, is_equal: bool) -> _Paired:
    """Collect the evidence of one filter, new over old, of the dives on which a side is evaluated."""
    reasons = list[str]()
    evaluated = list[Pair]()
    lost = 0
    for pair in pairs:
        reason_before = _not_evaluated(pair.old.report, name)
        reason_now = _not_evaluated(pair.new.report, name)
        reasons.append(reason_now or reason_before)
        if reason_now and not reason_before:
            lost += 1
        if not (reason_now and reason_before):
            evaluated.append(pair)
    evidence = [list(_paired_evidence(name, pair)) for pair in evaluated]
    return _Paired(name, pairs, reasons, lost, evaluated, evidence, is_equal)


def _answer(paired: _Paired, level: float) -> Answer:
    """Return the answer for one filter, at the level of its interval.

    Its verdict is that of the pooled evidence, unless the evidence is the same as before and no dive is lost.
    """
    name = paired.name
    pooled = pooled_candidate(
        name,
        OLD,
        paired.evidence,
        len(paired.pairs),
        reasons=paired.reasons,
        primary=paired.primary,
        level=level,
        vehicles=[pair.new.report.vehicle for pair in paired.evaluated],
    )
    answer = Answer(
        filter=name,
        baseline=OLD,
        verdict=pooled.verdict,
        dives=pooled.dives,
        evaluated=pooled.evaluated,
        rows=pooled.rows,
        primary=pooled.primary,
        settling=pooled.settling,
        undecided=pooled.undecided,
        reason=pooled.reason,
        sentence=f"{name} against {OLD}: {headline(pooled)}.",
        lost=paired.lost,
        largest_change=paired.largest_change,
        by_dive=_by_dive(paired.evidence, pooled.primary),
    )
    if answer.lost or not answer.is_same:
        return answer
    verdict = Verdict.EQUIVALENT
    if answer.is_equal:
        verdict = Verdict.NO_EFFECT
    return replace(
        answer,
        verdict=verdict,
        undecided=ReasonCode.NONE,
        sentence=f"{name} {answer.sameness}.",
    )


def _where(paired: _Paired, level: float) -> list[WhereRow]:
    """Return the drift of one filter by what the vehicle does, new over old, over all dives."""
    dives = [_where_on_dive(paired.name, pair) for pair in paired.evaluated]
    vehicles = [pair.new.report.vehicle for pair in paired.evaluated]
    return pooled_where(dives, level=level, vehicles=vehicles)


def _where_on_dive(name: str, pair: Pair) -> list[WhereRow]:
    """Return the rows of a filter on one dive, new over old, of the bins that both sides have."""
    old = _where_rows(pair.old.report, name)
    rows = []
    for bin_, now in _where_rows(pair.new.report, name).items():
        if bin_ not in old:
            continue
        row = where_between(old[bin_], now)
        if row is not None:
            rows.append(row)
    return rows


def _where_rows(report: StoredReport, name: str) -> dict[str, WhereRow]:
    """Return the rows of a filter by bin; early results have none."""
    found = dict[str, WhereRow]()
    for row in report.tables.get("where", []):
        if row["filter"] == name:
            found[str(row["bin"])] = msgspec.convert(row, WhereRow)
    return found


def _by_dive(evidence: Sequence[Sequence[EvidenceRow]], primary: str) -> tuple[DiveChange, ...]:
    """Return the primary quantity, dive by dive."""
    changes = list[DiveChange]()
    for row in chain.from_iterable(evidence):
        if row.quantity == primary:
            change = DiveChange(
                log=row.log,
                quantity=row.quantity,
                unit=row.unit,
                old=finite(row.baseline),
                new=finite(row.value),
                ratio=row.ratio,
            )
            changes.append(change)
    return tuple(changes)


def _not_evaluated(report: StoredReport, name: str) -> str:
    """Return why a filter is not evaluated in a result, empty if it is.

    The verdict on a candidate says it. The baseline has no verdict: it is evaluated if any candidate is, or if there is
    no candidate.
    """
    candidates = list(report.filters.values())
    if name in report.filters:
        candidates = [report.filters[name]]
    if not candidates:
        return ""
    for candidate in candidates:
        if candidate.get("verdict") not in WITHOUT_VERDICT:
            return ""
    return str(candidates[0].get("reason") or "its result does not say why")


# --- The evidence of one filter on one dive, new over old.


class _Cell(Struct, frozen=True):
    """One value of a filter, as it is in the results of both sides."""

    quantity: str  # of the evidence, such as `position` or `outage_60s`
    kind: str  # of the evidence, such as `accuracy` or `outage`
    role: str  # what it may do to the verdict, one of `Role`
    column: str  # which value of the pair
    pair: RowPair


def _paired_evidence(name: str, dive: Pair) -> Iterator[EvidenceRow]:
    """Yield the evidence of a filter on one dive, new over old, of each quantity that is a number on both sides.

    The evidence compares candidates with the baseline. If neither side has any, as in replays of the baseline alone,
    the drift and outage tests of the filter take its place.

    The baseline's values are in the rows of every candidate. The first row counts: candidates with a start of their
    own, which change its values, come last.
    """
    report = dive.new.report
    rows = list(paired_rows(dive.old.report, report, _TABLES))
    may_vote = partial(
        role_alone, independent=is_independent(report.config), delay=report.reference_delay
    )
    if any(map(_is_evidence, rows)):
        is_baseline = name == report.baseline
        cells = _cells_of_evidence(rows, "" if is_baseline else name, may_vote)
    else:
        own = [pair for pair in rows if pair.filter == name]
        cells = _cells_alone(own, may_vote)
    done = set[str]()
    for cell in cells:
        was = cell.pair.old.get(cell.column)
        now = cell.pair.new.get(cell.column)
        if is_number(was) and is_number(now) and cell.quantity not in done:
            done.add(cell.quantity)
            yield EvidenceRow(
                log=dive.new.name,
                filter=name,
                evidence=cell.kind,
                quantity=cell.quantity,
                unit=cell.pair.layout.unit_of(cell.column, cell.pair.unit),
                baseline=float(was),
                value=float(now),
                ratio=_ratio(was, now),
                reference_noise=_noise_share(cell.pair, float(was)),
                role=cell.role,
            )


def _ratio(was: float, now: float) -> float | None:
    """Return new over old; None where the old value is zero and the new one is not."""
    if was == now:
        return 1.0
    if was > 0.0:
        return now / was
    return None


def _is_evidence(pair: RowPair) -> bool:
    return pair.layout.name == "evidence" and pair.new.get("evidence") != CONSISTENCY


def _cells_of_evidence(
    rows: Sequence[RowPair],
    candidate: str,  # empty for the baseline, which has a value in the rows of all candidates
    may_vote: Callable[[str, int], Role],
) -> Iterator[_Cell]:
    """Yield the values of a filter in the evidence."""
    column = "value" if candidate else "baseline"
    for pair in rows:
        if _is_evidence(pair) and candidate in ("", pair.filter):
            role = _role(pair, may_vote)
            yield _Cell(pair.row, str(pair.new.get("evidence")), role, column, pair)


def _noise_share(pair: RowPair, was: float) -> float:
    """Return the share of the reference's noise in a squared old error, of a row that has that of the baseline."""
    share = pair.old.get("reference_noise")
    baseline = pair.old.get("baseline")
    if not is_number(share) or not is_number(baseline) or was == 0.0:
        return math.nan
    return min(share * (baseline / was) ** 2, 1.0)


def _role(pair: RowPair, may_vote: Callable[[str, int], Role]) -> str:
    """Return what a row may do, also in a result whose candidates are not evaluated, as by noise of the baseline."""
    if Role.PRIMARY in (pair.old.get("role"), pair.new.get("role")):
        return Role.PRIMARY
    return may_vote(pair.row, _count(pair, "samples"))


def _count(pair: RowPair, column: str) -> int:
    """Return a count of the new side; 0 without one."""
    count = pair.new.get(column)
    if is_number(count):
        return int(count)
    return 0


def _cells_alone(rows: Sequence[RowPair], may_vote: Callable[[str, int], Role]) -> Iterator[_Cell]:
    """Yield the drift and outage tests of a filter without candidates."""
    for pair in rows:
        if pair.layout.name == "outage":
            name = f"outage_{pair.row}s"
            kind = "outage"
            column = "drift_rms_m"
        elif pair.layout.name == "drift" and pair.row == "position_h":
            name = "position"
            kind = "track"
            column = "rms"
        elif pair.layout.name == "drift" and pair.row in DRIFT_QUANTITIES:
            name = pair.row
            kind = "accuracy"
            column = "rms"
        else:
            continue
        role = may_vote(name, _count(pair, "windows"))
        yield _Cell(name, kind, role, column, pair)


def _size_of_change(row: EvidenceRow) -> float:
    """Return the relative change of a value that may decide or warn; of others only whether they changed."""
    if row.baseline == row.value:
        return 0.0
    if row.role not in (Role.PRIMARY, Role.SECONDARY):
        return _NO_CHANGE / 2.0
    if row.ratio is None:
        return math.inf
    return abs(row.ratio - 1.0)
