"""The answer of a comparison: each filter, new against old, by the evidence and the tests of a verdict.

The errors of one filter in two runs of a dive are paired. Their ratio is one sample of each dive, pooled as the
evidence of a candidate over several dives is. Of a single dive, its errors over time are compared.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import CONSISTENCY, DECIDING_TOGETHER, DRIFT_QUANTITIES, FEWEST_DIVES
from insdvl_replay.core.result import PAGE, PRINTED, Callout, DisplayTable, Only, Part, StoredReport, StoredResult
from insdvl_replay.core.tables import EvidenceRow, Number, PooledRow, finite
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation import answers
from insdvl_replay.evaluation.answers import (
    AGAINST,
    DECIDED,
    may_decide,
    pooled_candidate,
    pooled_sentence,
    verdict_of,
    would_settle,
)
from insdvl_replay.evaluation.series import paired_ratio, verdict_of_interval
from insdvl_replay.results.folder import TRAJECTORY_FILE
from insdvl_replay.results.trajectory import read_trajectory
from insdvl_replay.show.answers import (
    TONES,
    evidence_text,
    interval_text,
    ratio_text,
    reason_undecided,
    shouted,
    verdict_with_reason,
)
from insdvl_replay.show.document import ShownColumn, table_of
from insdvl_replay.show.first_screen import (
    ForestRow,
    by_dive_forest,
    change_of_value,
    evidence_forest,
    first_screen,
    section,
)

OLD: Final = "before"  # name of the old side in sentences
# Evidence of a single dive: columns of its trajectory, with their units.
_OVER_TIME: Final = {"position": ("position_error_m", "m"), "velocity": ("velocity_error_mps", "m/s")}
_NO_CHANGE: Final = 0.01  # of every value that decides: so small a change on a dive is none
_MOST_DRAWN: Final = 8  # rows of the forest plot


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
    def is_harm(self) -> bool:
        """Whether it fails `--fail-on worse`: worse, partly worse, or lost on a dive."""
        return self.verdict in (Verdict.WORSE, Verdict.MIXED) or self.lost > 0


class _Value(NamedTuple):
    evidence: str
    unit: str
    value: float


_Values = Mapping[str, Mapping[str, _Value]]  # by filter and quantity
Pairs = Sequence[tuple[StoredResult, StoredResult]]


def answers_of(pairs: Pairs) -> tuple[Answer, ...]:
    """Compare each filter that both sides have with itself, over all dives."""
    values = [(_measured(old.report), _measured(new.report)) for old, new in pairs]
    found = []
    for name in dict.fromkeys(name for old, new in values for name in new if name in old):
        having = [place for place, (old, new) in enumerate(values) if name in old and name in new]
        sides = {place: [_is_evaluated(side.report, name) for side in pairs[place]] for place in having}
        evaluated, lost = [place for place in having if any(sides[place])], list(sides.values()).count([True, False])
        evidence = [
            list(_rows(name, pairs[place][1].name, *(side[name] for side in values[place]))) for place in evaluated
        ]
        sizes = [_size_of_change(row) for rows in evidence for row in rows]
        largest = max(
            sizes, default=0.0 if all(old.report.tables == new.report.tables for old, new in pairs) else math.inf
        )
        pooled = pooled_candidate(name, OLD, evidence, len(having))
        answer = Answer(
            filter=name, baseline=OLD, verdict=pooled.verdict, dives=len(having), evaluated=len(evaluated), lost=lost,
            largest_change=largest, rows=pooled.rows, sentence=pooled_sentence(pooled),
        )  # fmt: skip
        if answer.is_same:
            answer = replace(answer, verdict=Verdict.EQUIVALENT, sentence=f"{name} {_is_same(largest)}.")
        elif len(having) == len(evaluated) == 1:
            over_time = tuple(_on_one_dive(name, *pairs[having[0]]))
            rows = (*over_time, *(row for row in pooled.rows if row.quantity not in _OVER_TIME))
            answer = replace(answer, verdict=verdict_of(over_time), rows=rows)
            answer = replace(answer, sentence=f"{name} {AGAINST[answer.verdict]} {OLD} on this dive: {answer.measured}")
        found.append(replace(answer, by_dive=tuple(_dive_by_dive(answer, evidence))))
    # What is not finite is missing, as in JSON.
    return msgspec.json.decode(msgspec.json.encode(found), type=tuple[Answer, ...])


def _dive_by_dive(answer: Answer, evidence: Sequence[Sequence[EvidenceRow]]) -> Iterator[DiveChange]:
    """Yield the values of the row that made the verdict, or could have."""
    quantity = [*answer.spoken, *answer.rows][0].quantity if answer.rows else ""
    for row in (row for rows in evidence for row in rows if row.quantity == quantity):
        yield DiveChange(row.log, quantity, row.unit, finite(row.baseline), finite(row.value), row.ratio)


def _measured(report: StoredReport) -> _Values:
    """Return the values of the evidence of each filter on a dive; of a filter alone, of its drift and outage tests."""
    found: dict[str, dict[str, _Value]] = {name: {} for name in (report.baseline, *report.filters)}

    def add(name: str, quantity: object, evidence: object, unit: object, value: object) -> None:
        if isinstance(value, int | float):
            found.setdefault(name, {}).setdefault(str(quantity), _Value(str(evidence), str(unit), float(value)))

    settings = report.config.get("filters")
    filters = settings.items() if isinstance(settings, dict) else ()
    rows = [row for row in report.tables.get("evidence", []) if row.get("evidence") != CONSISTENCY]
    # An onboard solution has a start of its own, and its rows other values of the baseline.
    solutions = [name for name, own in filters if isinstance(own, dict) and own.get("solution")]
    rows.sort(key=lambda row: row["filter"] in solutions)
    for row in rows:
        for name, column in ((str(row["filter"]), "value"), (report.baseline, "baseline")):
            add(name, row["quantity"], row.get("evidence"), row.get("unit"), row.get(column))
    if not rows:
        for row in report.tables.get("drift", []):
            if row["quantity"] in DRIFT_QUANTITIES and row["quantity"] != "position_h":
                add(str(row["filter"]), row["quantity"], "accuracy", row.get("unit"), row.get("rms"))
        for row in report.tables.get("outage", []):
            add(str(row["filter"]), f"outage_{row['window_s']}s", "outage", "m", row.get("drift_rms_m"))
    return found


def _is_evaluated(report: StoredReport, name: str) -> bool:
    """Return whether a filter is evaluated; the baseline is, if any candidate is."""
    verdicts = {filter_: row.get("verdict") for filter_, row in report.filters.items()}
    own = [verdicts[name]] if name in verdicts else list(verdicts.values())
    return not own or any(verdict != Verdict.NOT_EVALUATED for verdict in own)


def _rows(name: str, log: str, old: Mapping[str, _Value], new: Mapping[str, _Value]) -> Iterator[EvidenceRow]:
    for quantity in (quantity for quantity in old if quantity in new):
        (evidence, unit, was), now = old[quantity], new[quantity].value
        ratio = 1.0 if was == now else now / was if was > 0.0 else None
        yield EvidenceRow(log, name, evidence, quantity, unit, was, now, ratio, None, None, None, 1, 0, "")


def _size_of_change(row: EvidenceRow) -> float:
    """Return the relative change of a value that decides; of others only whether they changed."""
    if row.baseline == row.value:
        return 0.0
    if row.quantity not in DECIDING_TOGETHER:
        return _NO_CHANGE / 2.0
    return math.inf if row.ratio is None else abs(row.ratio - 1.0)


def _is_same(largest: float) -> str:
    return "has the same evidence as before" if largest == 0.0 else "changed by less than 1 % in all that decides"


# --- One dive.


def _on_one_dive(name: str, old: StoredResult, new: StoredResult) -> Iterator[PooledRow]:
    """Compare the errors of a filter over the time of one dive, if there is a reference."""
    before, after = (read_trajectory(side.folder / TRAJECTORY_FILE) for side in (old, new))
    if before is None or after is None or not (name in before.names and name in after.names):
        return
    for quantity, (column, unit) in _OVER_TIME.items():
        with np.errstate(over="ignore"):  # of a filter that diverged
            was_sq, now_sq = (side.of(name, column) ** 2 for side in (before, after))
        known = was_sq.shape == now_sq.shape and (was_sq + now_sq >= 0.0).any()
        if known:
            interval = paired_ratio(was_sq, now_sq)
            paired = was_sq + now_sq >= 0.0
            was, now = (math.sqrt(float(side[paired].mean())) for side in (was_sq, now_sq))
            yield PooledRow(
                new.name, name, "accuracy", quantity, unit, was, now, interval.ratio, interval.low, interval.high,
                1, int(interval.ratio < 1.0), interval.p, verdict_of_interval(interval),
            )  # fmt: skip


# --- Show.


def answer_lines(answers: Sequence[Answer]) -> list[Callout]:
    """Return a line for each filter: its verdict and the evidence that made it, or could have."""
    words = [(answer.filter, shouted(answer.verdict)) for answer in answers]
    widths = [max(map(len, column)) for column in zip(*words, strict=True)]
    lines = []
    for answer, pair in zip(answers, words, strict=True):
        columns = [word.ljust(width) for word, width in zip(pair, widths, strict=True)]
        lines.append(Callout("  ".join([*columns, _said(answer)]), TONES.get(answer.verdict, "")))
    return lines


def _said(answer: Answer) -> str:
    """Write the evidence of an answer: the row that made it, both for a mixed one; or what would decide."""
    if answer.is_same:
        return _is_same(finite(answer.largest_change))
    if answer.verdict == Verdict.NOT_EVALUATED:
        return f"evaluated in only {answer.evaluated} of {counted(answer.dives, 'dive')}"
    lost = f"no longer evaluated in {answer.lost} of {answer.dives}" if answer.lost else ""
    found = evidence_text(answer), reason_undecided(answer), would_settle(answer.verdict, answer.known), lost
    return "; ".join(filter(None, found))


_COLUMNS: Final[tuple[ShownColumn, ...]] = (
    ("filter", "l", "filter"),
    ("evidence", "l", "quantity:label"),
    ("", "l", "unit"),
    ("old", "r", "baseline:value"),
    ("new", "r", "value:value"),
    ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ("over dives", "r", interval_text),
    ("won", "r", lambda row: f"{row.dives_won}/{row.dives}"),
    ("", "l", verdict_with_reason),
)


def answer_table(answers: Sequence[Answer], *, everything: bool) -> Iterator[DisplayTable]:
    """Return the evidence behind the answers: all rows, or those that are better or worse and have a vote."""
    rows = [row for answer in answers for row in answer.known]
    kept = [row for row in rows if everything or (row.verdict in DECIDED and may_decide(row))]
    left = len(rows) - len(kept)
    footnote = "old, new: medians over the dives. ratio: new over old, geometric mean over the dives."
    footnote += f" {left} more rows without a change that decides: -v" if left else ""
    if kept:
        yield table_of("Evidence, new against old", kept, _COLUMNS, footnote, spare=(2, 7, 3, 4))


def answer_screen(answers: Sequence[Answer]) -> list[Part]:
    """Return the answers: a line for each filter, on pages a section with forest plots."""
    several = any(answer.dives > 1 for answer in answers)
    caption = f"Here new is over old.{' All dives: each is one sample.' if several else ''}"
    page = first_screen([section(answer, [_sentence_of(answer)], [*_plots(answer)]) for answer in answers], caption)
    return [Only(PRINTED, tuple(answer_lines(answers))), Only(PAGE, (page,))]


def _sentence_of(answer: Answer) -> str:
    if answer.is_same or answer.verdict == Verdict.NOT_EVALUATED:
        return f"{_said(answer)}."
    lost = f" No longer evaluated in {answer.lost} of {counted(answer.dives, 'dive')}." if answer.lost else ""
    return f"{answer.measured}{lost}"


def _plots(answer: Answer) -> Iterator[str]:
    """Yield the forest plots of an answer: the evidence, and the dives one by one."""
    yield evidence_forest("This dive" if answer.dives == 1 else "All dives", answer, _MOST_DRAWN)
    if answer.dives > 1:
        rows = [
            ForestRow(dive.log, dive.ratio, tone=Verdict.UNDECIDED, text=change_of_value(dive.old, dive.new, dive.unit))
            for dive in answer.by_dive
            if finite(dive.ratio) > 0.0
        ]
        yield by_dive_forest(answer.by_dive[0].quantity if answer.by_dive else "", rows)
