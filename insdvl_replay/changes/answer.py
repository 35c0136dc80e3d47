"""The answer of a comparison: each filter, new against old, by the rule of a verdict.

The errors of one filter in two runs of a dive are paired. Their ratio is one sample of each dive, pooled as the
evidence of a candidate over several dives is.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Final

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import RowPair, is_number, paired_rows
from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.quantities import (
    CONSISTENCY,
    DRIFT_QUANTITIES,
    FEWEST_DIVES,
    WITHOUT_VERDICT,
)
from insdvl_replay.core.report import StoredReport, StoredResult
from insdvl_replay.core.tables import TABLES, EvidenceRow, Number, finite
from insdvl_replay.core.words import Role, Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import BAD, pooled_candidate, primary_of
from insdvl_replay.evaluation.evidence import role_alone
from insdvl_replay.evaluation.interval import LEVEL, level_of_candidates
from insdvl_replay.evaluation.sentences import headline

OLD: Final = "before"  # name of the old side in sentences
_TABLES: Final = [layout for layout in TABLES if layout.name in ("evidence", "drift", "outage")]
_NO_CHANGE: Final = (
    0.01  # of every value that may decide or warn: so small a change on a dive is none
)


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
        Meta(description="largest relative change of a value that may decide or warn, on any dive"),
    ]
    by_dive: Annotated[
        tuple[DiveChange, ...], Meta(description="the primary quantity, dive by dive")
    ] = ()

    @property
    def is_same(self) -> bool:
        """Whether no value differs; or, of too few dives for an interval, none that may decide by 1 %."""
        largest = finite(self.largest_change)
        return largest == 0.0 or (largest < _NO_CHANGE and self.evaluated < FEWEST_DIVES)

    @property
    def sameness(self) -> str:
        """How small the changes are, for the end of a sentence."""
        same = finite(self.largest_change) == 0.0
        if same:
            return "has the same evidence as before"
        return "changed by less than 1 % in all that may decide"

    @property
    def is_harm(self) -> bool:
        """Whether it fails `--fail-on worse`: worse, partly worse, or lost on a dive."""
        return self.verdict in BAD or self.lost > 0


class _Paired(Struct, frozen=True):
    """One filter in the dives of both sides."""

    name: str
    dives: list[tuple[StoredResult, StoredResult]]
    unsound: list[list[str]]  # why each side is not evaluated on a dive, empty if it is
    evaluated: list[tuple[StoredResult, StoredResult]]  # dives on which a side is evaluated
    evidence: list[list[EvidenceRow]]  # of these
    is_equal: bool  # whether all tables of all dives are equal

    @property
    def largest_change(self) -> float:
        """Largest relative change of a value that may decide or warn."""
        sizes = [_size_of_change(row) for rows in self.evidence for row in rows]
        return max(sizes, default=0.0 if self.is_equal else math.inf)


def answers_of(pairs: Sequence[tuple[StoredResult, StoredResult]]) -> tuple[Answer, ...]:
    """Compare each filter that both sides have with itself, over all dives."""
    # Copies of a dive count once.
    kept, _ = distinct_dives([new.report for _, new in pairs])
    distinct = {id(report) for report in kept}
    pairs = [pair for pair in pairs if id(pair[1].report) in distinct]
    having: dict[str, list[tuple[StoredResult, StoredResult]]] = {}
    for pair in pairs:
        theirs, ours = ((side.report.baseline, *side.report.filters) for side in pair)
        for name in ours:
            if name in theirs:
                having.setdefault(name, []).append(pair)
    is_equal = all(old.report.tables == new.report.tables for old, new in pairs)
    paired = [_paired(name, own, is_equal=is_equal) for name, own in having.items()]
    # Filters that changed share the error rate of one.
    level = level_of_candidates(sum(found.largest_change > 0.0 for found in paired))
    found = [_answer(one, level if one.largest_change > 0.0 else LEVEL) for one in paired]
    # What is not finite is missing, as in JSON.
    return msgspec.json.decode(msgspec.json.encode(found), type=tuple[Answer, ...])


def _paired(
    name: str, dives: list[tuple[StoredResult, StoredResult]], *, is_equal: bool
) -> _Paired:
    unsound = [[_not_evaluated(side.report, name) for side in pair] for pair in dives]
    evaluated = [pair for pair, reasons in zip(dives, unsound, strict=True) if not all(reasons)]
    evidence = [[*_paired_evidence(name, *pair)] for pair in evaluated]
    return _Paired(name, dives, unsound, evaluated, evidence, is_equal)


def _answer(paired: _Paired, level: float) -> Answer:
    name = paired.name
    settings = [new.report.config.get("evaluation", {}) for _, new in paired.dives]
    named = next((str(found["primary"]) for found in settings if found.get("primary")), "")
    pooled = pooled_candidate(
        name,
        OLD,
        paired.evidence,
        len(paired.dives),
        reasons=[new or old for old, new in paired.unsound],
        primary=primary_of(paired.evidence, named),
        level=level,
        vehicles=[new.report.vehicle for _, new in paired.evaluated],
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
        lost=sum(bool(new and not old) for old, new in paired.unsound),
        largest_change=paired.largest_change,
        by_dive=tuple(
            DiveChange(
                row.log, row.quantity, row.unit, finite(row.baseline), finite(row.value), row.ratio
            )
            for rows in paired.evidence
            for row in rows
            if row.quantity == pooled.primary
        ),
    )
    if answer.is_same and not answer.lost:
        is_equal = finite(answer.largest_change) == 0.0
        word = Verdict.NO_EFFECT if is_equal else Verdict.EQUIVALENT
        undecided = answers.Undecided.NONE
        answer = replace(
            answer, verdict=word, undecided=undecided, sentence=f"{name} {answer.sameness}."
        )
    return answer


def _not_evaluated(report: StoredReport, name: str) -> str:
    """Return why a filter is not evaluated, empty if it is. The baseline is evaluated, if any candidate is."""
    candidates = [report.filters[name]] if name in report.filters else [*report.filters.values()]
    if not candidates or any(
        candidate.get("verdict") not in WITHOUT_VERDICT for candidate in candidates
    ):
        return ""
    return str(candidates[0].get("reason") or "its result does not say why")


def _paired_evidence(name: str, old: StoredResult, new: StoredResult) -> Iterator[EvidenceRow]:
    """Yield the evidence of a filter that both sides have, new over old; of a filter alone, its drift and outage tests.

    Of the baseline, the first row counts: candidates with a start of their own, which change its values, come last.
    """
    frame = [*paired_rows(old.report, new.report, _TABLES)]
    evidence = [
        pair
        for pair in frame
        if pair.layout.name == "evidence" and pair.new.get("evidence") != CONSISTENCY
    ]
    is_baseline = name == new.report.baseline
    is_independent = new.report.config.get("reference", {}).get("independent") is not False
    done = set()
    if evidence:
        own = [pair for pair in evidence if is_baseline or pair.filter == name]
        cells = [
            _Cell(
                pair.row,
                str(pair.new.get("evidence")),
                _role(pair, is_independent=is_independent),
                pair,
            )
            for pair in own
        ]
        column = "baseline" if is_baseline else "value"
    else:
        cells = [
            *_cells_alone(
                [pair for pair in frame if pair.filter == name], is_independent=is_independent
            )
        ]
        column = ""
    for cell in cells:
        pair = cell.pair
        named = column or ("rms" if pair.layout.name == "drift" else "drift_rms_m")
        was = pair.old.get(named)
        now = pair.new.get(named)
        if is_number(was) and is_number(now) and cell.quantity not in done:
            done.add(cell.quantity)
            ratio = 1.0 if was == now else now / was if was > 0.0 else None
            yield EvidenceRow(
                log=new.name,
                filter=name,
                evidence=cell.kind,
                quantity=cell.quantity,
                unit=pair.layout.unit_of(named, pair.unit),
                baseline=float(was),
                value=float(now),
                ratio=ratio,
                reference_noise=_noise_share(pair, float(was)),
                role=cell.role,
            )


def _noise_share(pair: RowPair, was: float) -> float:
    """Return the share of the reference's noise in a squared old error, of a row that has that of the baseline."""
    share = pair.old.get("reference_noise")
    baseline = pair.old.get("baseline")
    if not is_number(share) or not is_number(baseline) or was == 0.0:
        return math.nan
    return min(share * (baseline / was) ** 2, 1.0)


class _Cell(Struct, frozen=True):
    """One value of a filter that both sides have."""

    quantity: str
    kind: str
    role: str
    pair: RowPair


def _role(pair: RowPair, *, is_independent: bool) -> str:
    """Return what a row may do, also in a result whose candidates are not evaluated, as by noise of the baseline."""
    if Role.PRIMARY in (pair.old.get("role"), pair.new.get("role")):
        return Role.PRIMARY
    samples = pair.new.get("samples")
    return role_alone(
        pair.row, int(samples) if is_number(samples) else 0, independent=is_independent
    )


def _cells_alone(pairs: Sequence[RowPair], *, is_independent: bool) -> Iterator[_Cell]:
    """Yield the drift and outage tests of a filter without candidates."""
    for pair in pairs:
        windows = pair.new.get("windows")
        count = int(windows) if is_number(windows) else 0
        name = ""
        kind = ""
        if pair.layout.name == "drift" and pair.row == "position_h":
            name = "position"
            kind = "track"
        elif pair.layout.name == "drift" and pair.row in DRIFT_QUANTITIES:
            name = pair.row
            kind = "accuracy"
        elif pair.layout.name == "outage":
            name = f"outage_{pair.row}s"
            kind = "outage"
        if name:
            yield _Cell(name, kind, role_alone(name, count, independent=is_independent), pair)


def _size_of_change(row: EvidenceRow) -> float:
    """Return the relative change of a value that may decide or warn; of others only whether they changed."""
    if row.baseline == row.value:
        return 0.0
    if row.role not in (Role.PRIMARY, Role.SECONDARY):
        return _NO_CHANGE / 2.0
    if row.ratio is None:
        return math.inf
    return abs(row.ratio - 1.0)
