"""Several dives as shown: the summary for scripts, the tables of all dives, the page with a link to each dive."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final
from urllib.parse import quote

from msgspec import Struct

from insdvl_replay.core.errors import counted
from insdvl_replay.core.quantities import is_whole, label
from insdvl_replay.core.result import PAGE, PRINTED, Block, Callout, DisplayTable, Only, Part, Report, Result, Title
from insdvl_replay.core.tables import Number, PooledRow
from insdvl_replay.core.words import GateStatus, Severity, Verdict
from insdvl_replay.evaluation.answers import CandidateAnswer, pooled_sentence
from insdvl_replay.evaluation.verdicts import consistency_of
from insdvl_replay.show.answers import (
    TONES,
    Failure,
    Outcome,
    answer_on_dive,
    as_shown,
    baseline_names,
    candidate_names,
    evidence_cells,
    has_reference,
    pooled_answers,
    prediction_word,
    reports_of,
    verdict_counts,
)
from insdvl_replay.show.dive import TOGETHER, UNITS_ALONE, dive_section, replay_result, values_alone
from insdvl_replay.show.document import MISSING, number, percent, shown, table_csv, table_of
from insdvl_replay.show.first_screen import DIVE_PAGE, dives_forest, evidence_forest, first_screen, section
from insdvl_replay.show.page import SIGNATURE, page

INDEX: Final = "index.html"

# --- For scripts: a summary, and the pooled evidence.


class SummaryRow(Struct, frozen=True):
    """One log and candidate. A failed log has a reason instead of numbers; without an evaluation there is no gain."""

    log: str
    filter: str | None = None
    mean_improvement_pct: Number = None
    mean_convergence_improvement_pct: Number = None
    position_h_baseline_rmse_m: Number = None
    position_h_rmse_m: Number = None
    position_h_baseline_rmse_pct: Number = None
    position_h_rmse_pct: Number = None
    improvement: str | None = None
    prediction: str | None = None
    verdicts: str | None = None
    status: str = "done"  # or failed
    reason: str | None = None


def summary_rows(outcomes: Sequence[Outcome]) -> Iterator[SummaryRow]:
    """Yield a row for each log and candidate, in the order of the logs."""
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            yield SummaryRow(outcome.log, status="failed", reason=outcome.reason)
            continue
        if not outcome.filters:
            yield SummaryRow(outcome.log.name)
        for name, candidate in outcome.filters.items():
            gains = (candidate.mean_improvement_pct, candidate.mean_convergence_improvement_pct)
            if candidate.verdict == Verdict.NOT_EVALUATED:
                gains = (None, None)
            positions = (*_position_rmse(outcome, name, "position_h"), *_position_rmse(outcome, name, "position_h_pct"))
            measured = [row for row in outcome.tables.consistency if row.filter == name and is_whole(row.measurement)]
            verdicts = [f"{row.measurement} {row.verdict}" for row in measured]
            verdicts += [f"errors {candidate.credibility}"] if candidate.credibility else []
            words = (candidate.verdict, candidate.prediction, "; ".join(verdicts))
            yield SummaryRow(outcome.log.name, name, *gains, *positions, *words)


def _position_rmse(report: Report, name: str, quantity: str) -> tuple[float | None, float | None]:
    """Return the baseline's and a candidate's rms position error."""
    rows = (row for row in report.tables.reference_error if (row.filter, row.quantity) == (name, quantity))
    return next(((row.baseline_rmse, row.rmse) for row in rows), (None, None))


def pooled_rows(outcomes: Sequence[Outcome]) -> list[PooledRow]:
    """Return the pooled evidence on all candidates."""
    return [row for answer in pooled_answers(reports_of(outcomes)) for row in answer.rows]


NO_EVIDENCE: Final = "no evidence. Accuracy takes a reference, the DVL outage test a dive of some minutes."

# --- The tables over all dives that `--table` names.

# Evidence rows of the summary, where a dive has them.
_SUMMARIES: Final = ("position", "position_pct", "drift_60s", "outage_60s")


def named_result(outcomes: Sequence[Outcome], names: Sequence[str], parts: Sequence[Part]) -> Result:
    """Return named tables of all dives, with other parts before those over all dives."""
    rows: dict[str, tuple[type[Struct], Sequence[Struct]]] = {
        "pooled": (PooledRow, pooled_rows(outcomes)),
        "summary": (SummaryRow, list(summary_rows(outcomes))),
    }
    reports, shown_tables = reports_of(outcomes), list[Part]()
    for name in (name for name in names if name in TOGETHER):
        missing = f"There is no table {name}: {_NEEDED[name]}, and {counted(len(reports), 'dive')} could be replayed."
        shown_tables += list(_TOGETHER[name](outcomes)) or [missing]
    return replay_result(reports, [*parts, *shown_tables], names, rows)


def _pooled_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    for answer in pooled_answers(reports_of(outcomes)):
        if not answer.rows:
            yield f"{answer.filter} against {answer.baseline}: {NO_EVIDENCE}"
            continue
        yield shown(PooledRow, map(as_shown, answer.rows), filter=answer.filter, baseline=answer.baseline)


def _summary_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Yield the values of dives by filters, a table for each quantity."""
    reports = reports_of(outcomes)
    names = candidate_names(reports)
    for quantity in _SUMMARIES:
        rows, unit = [], ""
        for report in reports:
            found = {row.filter: row for row in report.tables.evidence if row.quantity == quantity}
            for row in list(found.values())[:1]:
                values = (number(found[name].value) if name in found else MISSING for name in names)
                rows.append((report.log.name, number(row.baseline), *values))
                unit = row.unit
        if rows:
            title = f"Summary: {label(quantity)} [{unit}] of dives by filters"
            header = ("dive", baseline_names(reports), *names)
            yield DisplayTable(title, header, f"lr{'r' * len(names)}", tuple(rows), title_apart=True)


_TOGETHER: Final = {"pooled": _pooled_tables, "summary": _summary_tables}
_NEEDED: Final = {"pooled": "it takes two dives with the same candidate", "summary": "it takes a dive with evidence"}


# --- The page, and the same in other formats.


def index_page(outcomes: Sequence[Outcome]) -> bytes:
    """Return the page of several dives, in the order of the logs; a script lets the reader sort its table."""
    return page([*_opening(outcomes, linked=True), *_tables(outcomes)], "sorting.js")


def _first_line(kind: type[Struct]) -> bytes:
    return table_csv(Block.of(kind, ()))


# The files of several dives together: the function that writes each, and its first bytes.
OVERVIEWS: Final[Mapping[str, tuple[Callable[[Sequence[Outcome]], bytes], bytes]]] = {
    "summary.csv": (lambda outcomes: table_csv(Block.of(SummaryRow, summary_rows(outcomes))), _first_line(SummaryRow)),
    "evidence.csv": (lambda outcomes: table_csv(Block.of(PooledRow, pooled_rows(outcomes))), _first_line(PooledRow)),
    INDEX: (index_page, SIGNATURE.encode()),
}


def overview_parts(outcomes: Sequence[Outcome]) -> list[Part]:
    """Return several dives as a document: the pooled verdict, a row for each dive and candidate, pooled rows."""
    tables = [replace(part, links=None) if isinstance(part, DisplayTable) else part for part in _tables(outcomes)]
    return [*_opening(outcomes, linked=False), *tables]


def _opening(outcomes: Sequence[Outcome], *, linked: bool) -> Iterator[Part]:
    """Yield the pooled verdicts, and the number of dives with each verdict."""
    reports = reports_of(outcomes)
    failed = len(outcomes) - len(reports)
    pooled, names = pooled_answers(reports), candidate_names(reports)
    compared = f": {', '.join(names)} against {reports[0].baseline}" if 0 < len(names) <= MOST_NAMED else ""
    yield Title(f"{len(outcomes)} dives{f', {failed} of them failed' if failed else ''}{compared}")
    found = "; ".join(f"{name}: {verdict_counts(name, reports)}" for name in names)
    callouts = [Callout(pooled_sentence(answer), TONES.get(answer.verdict, "")) for answer in pooled]
    callouts += [Callout(f"Dive by dive, against the baseline: {found}.")] if found else []
    yield Only(PRINTED, tuple(callouts))
    sections = [_section(answer, reports, linked=linked) for answer in pooled]
    for name in (name for name in names if name not in {answer.filter for answer in pooled}):
        [report] = (report for report in reports if name in report.filters)
        sections.append(dive_section(report, name, f"Evidence on {report.log.name} alone"))
    evidence = [row for report in reports for row in report.tables.evidence if row.evidence == "accuracy"]
    starts = max((row.starts for row in evidence), default=0)
    over = f" Dive by dive: ratios of accuracy are over {starts} random starts." if starts > 1 else ""
    caption = f"All dives: each is one sample.{over}"
    yield Only(PAGE, (first_screen(sections, caption),) if sections else ())


MOST_NAMED: Final = 4  # With more candidates, the title has no names.
_MOST_ROWS: Final = 8  # Evidence rows of the forest plot of all dives.


def _section(answer: CandidateAnswer[PooledRow], reports: Sequence[Report], *, linked: bool) -> str:
    counts = f"Dive by dive: {verdict_counts(answer.filter, reports)}."
    dives = dives_forest(answer, reports, linked=linked)
    if answer.verdict == Verdict.NOT_EVALUATED:
        said = f"Evaluated on {answer.evaluated} of {answer.dives} dives. Settle the reasons of the others first."
        return section(answer, [said, counts], [dives])
    title = f"All dives, {answer.evaluated} of {answer.dives}" if answer.evaluated < answer.dives else "All dives"
    plots = [evidence_forest(title, answer, _MOST_ROWS), dives]
    return section(answer, [answer.measured, answer.predicted, counts], plots)


# The meaning of the columns of candidates.
MEANS: Final = (
    "evidence: the row that decided, or could have, with its ratio; predicted: how much smaller sigma is, mean of nine "
    "states, by the filter's own covariance"
)
MEDIAN: Final = "without DVL: the median"
# The columns of filters without candidates.
_ALONE: Final = tuple((f"{name}\n[{unit}]" if unit else name, "r", name) for name, unit in UNITS_ALONE.items())
_COLUMNS: Final = (
    ("dive", "l", "dive"),
    ("filter", "l", "filter"),
    ("verdict", "l", "verdict"),
    ("evidence", "l", "evidence"),
    ("ratio", "r", "ratio"),
    ("interval", "r", "interval"),
    ("predicted", "r", "predicted"),
    ("prediction", "l", "prediction"),
    ("baseline\nposition [m]", "r", "baseline_m"),
    ("candidate\nposition [m]", "r", "candidate_m"),
    *_ALONE,
    ("consistency", "l", "consistency"),
    ("warnings", "r", "warnings"),
    ("reason of failure", "l", "reason"),
)


def _tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    """Yield the table of dives, each with a link to its page, and the pooled evidence; empty columns are left out."""
    rows, reports = [row for outcome in outcomes for row in _dive_rows(outcome)], reports_of(outcomes)
    columns = [column for column in _COLUMNS if any(row[column[2]] not in (MISSING, "") for row in rows)]
    title, footnote = "Each dive", MEDIAN
    if candidate_names(reports):
        known = any(has_reference(report) for report in reports)
        title = "Each candidate against its baseline"
        footnote = f"{MEANS}; position: rms of the horizontal error" if known else MEANS
    links = tuple(f"{quote(row['dive'])}/{DIVE_PAGE}" if not row["reason"] else "" for row in rows)
    yield replace(table_of(title, rows, columns, footnote), links=links)
    yield from _pooled_tables(outcomes)


def table_alone(outcomes: Sequence[Outcome]) -> DisplayTable:
    """Return the values of filters without candidates, a row for each dive."""
    rows = [row for outcome in outcomes for row in _dive_rows(outcome)]
    columns = (("dive by dive", "l", "dive"), *_ALONE, ("consistency", "l", "consistency"))
    return table_of("", rows, columns, MEDIAN, spare=(2, 6, 3, 7), folds=8)


def _dive_rows(outcome: Outcome) -> Iterator[dict[str, str]]:
    """Yield a row for each candidate of a dive, or for its only filter, with text for each column."""
    empty = dict.fromkeys((key for _, _, key in _COLUMNS), MISSING)
    if isinstance(outcome, Failure):
        yield empty | {"dive": outcome.log, "consistency": GateStatus.FAILED, "reason": outcome.reason}
        return
    warnings = sum(note.severity == Severity.WARNING for note in outcome.notes)
    empty |= {"dive": outcome.log.name, "warnings": str(warnings), "reason": ""}
    if not outcome.filters:
        consistency = consistency_of(outcome.tables.consistency, outcome.baseline)
        yield empty | {"filter": outcome.baseline, "consistency": consistency} | values_alone(outcome)
    for name, candidate in outcome.filters.items():
        row = empty | {"filter": name, "consistency": candidate.consistency}
        row |= zip(("baseline_m", "candidate_m"), map(number, _position_rmse(outcome, name, "position_h")), strict=True)
        answer = answer_on_dive(outcome, name)
        row |= zip(("verdict", "evidence", "ratio", "interval"), (answer.verdict, *evidence_cells(answer)), strict=True)
        if answer.verdict != Verdict.NOT_EVALUATED:
            row["predicted"] = percent(answer.predicted_pct)
            row["prediction"] = prediction_word(answer.predicted_pct, answer.prediction) or MISSING
        yield row
