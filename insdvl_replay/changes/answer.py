"""The answer of a comparison: each filter, new against old, by the evidence and the tests of a verdict.

The errors of one filter in two runs of a dive are paired. Their ratio is one sample of each dive, pooled as the
evidence of a candidate over several dives is. Of a single dive, its errors over time are compared.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.core.quantities import CONSISTENCY, DECIDING_TOGETHER, DRIFT_QUANTITIES, FEWEST_DIVES
from insdvl_replay.core.result import StoredReport, StoredResult
from insdvl_replay.core.tables import EvidenceRow, Number, PooledRow, finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import AGAINST, pooled_candidate, pooled_sentence, verdict_of
from insdvl_replay.evaluation.series import paired_ratio, verdict_of_interval
from insdvl_replay.evaluation.verdicts import reason_not_evaluated
from insdvl_replay.results.folder import TRAJECTORY_FILE
from insdvl_replay.results.trajectory import read_trajectory

OLD: Final = "before"  # name of the old side in sentences
# Evidence of a single dive: columns of its trajectory, with their units.
_OVER_TIME: Final = {"position": ("position_error_m", "m"), "velocity": ("velocity_error_mps", "m/s")}
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
        if answer.is_same:
            answer = replace(answer, verdict=Verdict.EQUIVALENT, sentence=f"{name} {answer.sameness}.")
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
    """Yield the values of a filter that both sides have, new over old."""
    before, after = _values_of(old.report, name), _values_of(new.report, name)
    for quantity, (evidence, unit, was) in before.items():
        if quantity in after:
            now = after[quantity][2]
            ratio = 1.0 if was == now else now / was if was > 0.0 else None
            yield EvidenceRow(new.name, name, evidence, quantity, unit, was, now, ratio, None, None, None, 1, 0, "")


def _values_of(report: StoredReport, name: str) -> Mapping[str, tuple[str, str, float]]:
    """Return kind, unit and value of a filter's evidence by quantity; of a filter alone, its drift and outage tests."""
    settings = report.config.get("filters")
    filters = settings if isinstance(settings, dict) else {}
    is_baseline, rows = name == report.baseline, report.tables.get("evidence", [])
    rows = [row for row in rows if row.get("evidence") != CONSISTENCY]
    if rows:
        # An onboard solution has a start of its own, and its rows other values of the baseline: they come last.
        solutions = [other for other, own in filters.items() if isinstance(own, dict) and own.get("solution")]
        rows = sorted(rows, key=lambda row: row["filter"] in solutions)
        column = "baseline" if is_baseline else "value"
        cells = [
            (row["quantity"], row.get("evidence"), row.get("unit"), row.get(column))
            for row in rows
            if is_baseline or row["filter"] == name
        ]
    else:
        drift, outage = (
            [row for row in report.tables.get(table, []) if row["filter"] == name] for table in ("drift", "outage")
        )
        cells = [
            *((row["quantity"], "accuracy", row.get("unit"), row.get("rms")) for row in drift),
            *((f"outage_{row['window_s']}s", "outage", "m", row.get("drift_rms_m")) for row in outage),
        ]
        cells = [cell for cell in cells if cell[1] == "outage" or cell[0] in _DRIFT]
    values: dict[str, tuple[str, str, float]] = {}
    for quantity, evidence, unit, value in cells:
        if isinstance(value, int | float):
            values.setdefault(str(quantity), (str(evidence), str(unit), float(value)))
    return values


_DRIFT: Final = [quantity for quantity in DRIFT_QUANTITIES if quantity != "position_h"]


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
