"""The answer of a comparison: each filter, new against old, by the evidence and the tests of a verdict.

The errors of one filter in two runs of a dive are paired. Their ratio is one sample of each dive, pooled as the
evidence of a candidate over several dives is. Of a single dive, its errors over time are compared.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.changes.cells import is_number, paired_rows
from insdvl_replay.core.quantities import CONSISTENCY, DECIDING_TOGETHER, DRIFT_QUANTITIES, FEWEST_DIVES
from insdvl_replay.core.result import StoredReport, StoredResult
from insdvl_replay.core.tables import TABLES, EvidenceRow, Number, PooledRow, finite
from insdvl_replay.core.words import EvidenceVerdict, Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import AGAINST, may_decide, pooled_candidate, pooled_sentence, verdict_of
from insdvl_replay.evaluation.series import paired_ratio, verdict_of_interval
from insdvl_replay.evaluation.verdicts import reason_not_evaluated
from insdvl_replay.results.folder import TRAJECTORY_FILE
from insdvl_replay.results.trajectory import read_trajectory

OLD: Final = "before"  # name of the old side in sentences
# Evidence of a single dive: columns of its trajectory, with their units.
_OVER_TIME: Final = {"position": ("position_error_m", "m"), "velocity": ("velocity_error_mps", "m/s")}
_TABLES: Final = [layout for layout in TABLES if layout.name in ("evidence", "drift", "outage")]
_NO_CHANGE: Final = 0.01  # of every value that decides: so small a change on a dive is none


class DiveChange(Struct, frozen=True):
    """The value behind an answer on one dive."""

    log: str
    quantity: str
    unit: str
    old: Number
    new: Number
    ratio: Number


class Answer(answers.Answer[PooledRow], frozen=True, kw_only=True):
    """One filter, new against old."""

    sentence: str
    lost: Annotated[int, Meta(description="dives in which only the old side is evaluated")]
    largest_change: Annotated[Number, Meta(description="largest relative change of a value that decides, on any dive")]
    rows: Annotated[tuple[PooledRow, ...], Meta(description="old values are in baseline, new ones in value")]
    by_dive: Annotated[
        tuple[DiveChange, ...], Meta(description="the first row that made the verdict, dive by dive")
    ] = ()

    @property
    def is_same(self) -> bool:
        """Whether no value differs; or, of too few dives for statistics, none that decides by 1 %."""
        largest = finite(self.largest_change)
        return largest == 0.0 or (largest < _NO_CHANGE and self.evaluated < FEWEST_DIVES)

    @property
    def sameness(self) -> str:
        """How small the changes are, for the end of a sentence."""
        same = finite(self.largest_change) == 0.0
        return "has the same evidence as before" if same else "changed by less than 1 % in all that decides"

    @property
    def is_harm(self) -> bool:
        """Whether it fails `--fail-on worse`: worse, partly worse, or lost on a dive."""
        return self.verdict in (Verdict.WORSE, Verdict.MIXED) or self.lost > 0


def answers_of(pairs: Sequence[tuple[StoredResult, StoredResult]]) -> tuple[Answer, ...]:
    """Compare each filter that both sides have with itself, over all dives."""
    having: dict[str, list[tuple[StoredResult, StoredResult]]] = {}
    for pair in pairs:
        theirs, ours = ((side.report.baseline, *side.report.filters) for side in pair)
        for name in ours:
            if name in theirs:
                having.setdefault(name, []).append(pair)
    found = []
    for name, own in having.items():
        unsound = [[_not_evaluated(side.report, name) for side in pair] for pair in own]
        evaluated = [pair for pair, reasons in zip(own, unsound, strict=True) if not all(reasons)]
        evidence = [[*_paired_evidence(name, *pair)] for pair in evaluated]
        sizes = [_size_of_change(row) for rows in evidence for row in rows]
        same_tables = all(old.report.tables == new.report.tables for old, new in pairs)
        pooled = pooled_candidate(name, OLD, evidence, len(own), reasons=[new or old for old, new in unsound])
        answer = Answer(
            filter=name,
            baseline=OLD,
            verdict=pooled.verdict,
            dives=len(own),
            evaluated=len(evaluated),
            rows=pooled.rows,
            reason=pooled.reason,
            sentence=pooled_sentence(pooled),
            lost=sum(bool(new and not old) for old, new in unsound),
            largest_change=max(sizes, default=0.0 if same_tables else math.inf),
        )
        if answer.is_same and not answer.lost:
            is_same = finite(answer.largest_change) == 0.0
            rows = tuple(
                replace(row, verdict=EvidenceVerdict.EQUIVALENT) if is_same or may_decide(row) else row
                for row in answer.rows
            )
            answer = replace(answer, verdict=Verdict.EQUIVALENT, sentence=f"{name} {answer.sameness}.", rows=rows)
        elif len(own) == len(evaluated) == 1:
            over_time = tuple(_over_one_dive(name, *own[0]))
            rows = (*over_time, *(row for row in pooled.rows if row.quantity not in _OVER_TIME))
            answer = replace(answer, verdict=verdict_of(over_time), rows=rows)
            answer = replace(answer, sentence=f"{name} {AGAINST[answer.verdict]} {OLD} on this dive: {answer.measured}")
        # The dives one by one, in the row that made the verdict, or could have.
        first = next(iter((*answer.spoken, *answer.rows)), None)
        by_dive = [
            DiveChange(row.log, row.quantity, row.unit, finite(row.baseline), finite(row.value), row.ratio)
            for rows in evidence
            for row in rows
            if first is not None and row.quantity == first.quantity
        ]
        found.append(replace(answer, by_dive=tuple(by_dive)))
    # What is not finite is missing, as in JSON.
    return msgspec.json.decode(msgspec.json.encode(found), type=tuple[Answer, ...])


def _not_evaluated(report: StoredReport, name: str) -> str:
    """Return why a filter is not evaluated, empty if it is. The baseline is evaluated, if any candidate is."""
    candidates = [report.filters[name]] if name in report.filters else [*report.filters.values()]
    if not candidates or any(candidate.get("verdict") != Verdict.NOT_EVALUATED for candidate in candidates):
        return ""
    return reason_not_evaluated(str(candidates[0].get("sentence"))) or "its result does not say why"


def _paired_evidence(name: str, old: StoredResult, new: StoredResult) -> Iterator[EvidenceRow]:
    """Yield the evidence of a filter that both sides have, new over old; of a filter alone, its drift and outage tests.

    Of the baseline, the first row counts: candidates with a start of their own, which change its values, come last.
    """
    frame = [*paired_rows(old.report, new.report, _TABLES)]
    evidence = [pair for pair in frame if pair.layout.name == "evidence" and pair.new.get("evidence") != CONSISTENCY]
    is_baseline, column = name == new.report.baseline, "baseline" if name == new.report.baseline else "value"
    cells = [
        (pair.row, str(pair.new.get("evidence")), column, pair)
        for pair in evidence
        if is_baseline or pair.filter == name
    ]
    if not evidence:
        own = [pair for pair in frame if pair.filter == name]
        cells = [(pair.row, "accuracy", "rms", pair) for pair in own if pair.layout.name == "drift"]
        cells = [cell for cell in cells if cell[0] in DRIFT_QUANTITIES and cell[0] != "position_h"]
        cells += [
            (f"outage_{pair.row}s", "outage", "drift_rms_m", pair) for pair in own if pair.layout.name == "outage"
        ]
    done = set()
    for quantity, kind, column, pair in cells:
        was, now = pair.old.get(column), pair.new.get(column)
        if is_number(was) and is_number(now) and quantity not in done:
            done.add(quantity)
            ratio = 1.0 if was == now else now / was if was > 0.0 else None
            unit, values = pair.layout.unit_of(column, pair.unit), (float(was), float(now), ratio)
            yield EvidenceRow(new.name, name, kind, quantity, unit, *values, None, None, None, 1, 0, "")


def _size_of_change(row: EvidenceRow) -> float:
    """Return the relative change of a value that decides; of others only whether they changed."""
    if row.baseline == row.value:
        return 0.0
    if row.quantity not in DECIDING_TOGETHER:
        return _NO_CHANGE / 2.0
    return math.inf if row.ratio is None else abs(row.ratio - 1.0)


def _over_one_dive(name: str, old: StoredResult, new: StoredResult) -> Iterator[PooledRow]:
    """Compare the errors of a filter over the time of one dive, if there is a reference."""
    before, after = (read_trajectory(side.folder / TRAJECTORY_FILE) for side in (old, new))
    if before is None or after is None or not (name in before.names and name in after.names):
        return
    for quantity, (column, unit) in _OVER_TIME.items():
        with np.errstate(over="ignore"):  # of a filter that diverged
            was_sq, now_sq = (side.of(name, column) ** 2 for side in (before, after))
        if was_sq.shape != now_sq.shape or not (paired := was_sq + now_sq >= 0.0).any():
            continue
        interval = paired_ratio(was_sq, now_sq)
        was, now = (math.sqrt(float(side[paired].mean())) for side in (was_sq, now_sq))
        yield PooledRow(
            new.name, name, "accuracy", quantity, unit, was, now, interval.ratio, interval.low, interval.high,
            dives=1, dives_won=int(interval.ratio < 1.0), p=interval.p, verdict=verdict_of_interval(interval),
        )  # fmt: skip
