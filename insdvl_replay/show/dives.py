"""Several dives as shown: the summary for scripts, the tables of all dives, the page with a link to each dive."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, Final
from urllib.parse import quote

from msgspec import Struct

from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.errors import counted
from insdvl_replay.core.path_kinds import SUMMARY
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_whole, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import AnswerRow, Number, PooledRow, WhereRow
from insdvl_replay.core.words import GateStatus, ReasonCode, Severity
from insdvl_replay.document.page import SIGNATURE, page
from insdvl_replay.document.parts import (
    PAGE,
    PRINTED,
    Block,
    Callout,
    DisplayTable,
    Only,
    Part,
    Result,
    Title,
)
from insdvl_replay.document.tables import (
    MISSING,
    ShownColumn,
    number,
    shown,
    table_csv,
    table_of,
)
from insdvl_replay.evaluation.answers import EVERY_DIVE, CandidateAnswer, answer_row
from insdvl_replay.evaluation.sentences import (
    answer_lines,
    grounds,
    interval_of,
    paragraph,
    ratio_text,
    where_line,
)
from insdvl_replay.evaluation.verdicts import consistency_of
from insdvl_replay.evaluation.where import notable
from insdvl_replay.show.answers import (
    TONES,
    Failure,
    Outcome,
    answer_on_dive,
    answers_of,
    as_shown,
    baseline_names,
    candidate_names,
    has_reference,
    initial_text,
    of_filter,
    prediction_word,
    reports_of,
    start_text,
    where_of,
)
from insdvl_replay.show.dive import TOGETHER, VALUES, dive_section, replay_result, values_of
from insdvl_replay.show.first_screen import (
    DIVE_PAGE,
    dives_forest,
    evidence_forest,
    first_screen,
    is_where_drawn,
    section,
)

INDEX: Final = "index.html"

# --- For scripts: a summary, and the pooled evidence.


class SummaryRow(Struct, frozen=True):
    """One log and candidate, or the only filter. A failed log has a reason instead of numbers."""

    log: str
    filter: str | None = None
    verdict: str | None = None  # None where one dive has none
    evidence: str | None = None  # primary quantity
    ratio: Number = None  # on this dive
    acts: Number = None  # difference of both runs over the error of the baseline
    mean_improvement_pct: Number = None  # None without an evaluation
    mean_convergence_improvement_pct: Number = None
    prediction: str | None = None
    position_h_baseline_rmse_m: Number = None
    position_h_rmse_m: Number = None
    position_h_baseline_rmse_pct: Number = None
    position_h_rmse_pct: Number = None
    depth_rmse_m: Number = None
    velocity_rmse_mps: Number = None
    drift_60s_rms_m: Number = None
    outage_60s_drift_m: Number = None  # median
    nis_per_dof: Number = None
    consistency: str | None = None  # the worst
    consistency_of_each: str | None = None  # measurement, and of the errors
    warnings: int | None = None
    status: str = "done"  # or failed
    reason: str | None = None


def summary_rows(outcomes: Sequence[Outcome]) -> Iterator[SummaryRow]:
    """Yield a row for each log and candidate, or its only filter, in the order of the logs."""
    for outcome in outcomes:
        if isinstance(outcome, Failure):
            yield SummaryRow(outcome.log, status=GateStatus.FAILED, reason=outcome.reason)
            continue
        for name in outcome.filters or [outcome.baseline]:
            yield _summary_row(outcome, name)


def _summary_row(report: Report, name: str) -> SummaryRow:
    """Return the values of a filter on a dive, and its verdict if it is a candidate."""
    measured = of_filter(name, report.tables.consistency)
    words = [f"{row.measurement} {row.verdict}" for row in measured if is_whole(row.measurement)]
    known: dict[str, Any] = {}
    for column, value in values_of(report, name).items():
        if not math.isnan(value):
            known[column] = value
    known |= _errors_against_baseline(report, name)
    if name in report.filters:
        candidate = report.filters[name]
        consistency = candidate.consistency
        if candidate.credibility:
            words.append(f"errors {candidate.credibility}")
        known |= _verdict_in_summary(report, name)
    else:
        consistency = consistency_of(measured, name)
    warnings = [note for note in report.notes if note.severity == Severity.WARNING]
    return SummaryRow(
        report.log.name,
        name,
        consistency=consistency,
        consistency_of_each="; ".join(words),
        warnings=len(warnings),
        **known,
    )


def _errors_against_baseline(report: Report, name: str) -> dict[str, Any]:
    """Return the columns of the horizontal error that compare a filter with the baseline."""
    known: dict[str, Any] = {}
    for error in of_filter(name, report.tables.reference_error):
        if error.quantity == "position_h":
            known["position_h_baseline_rmse_m"] = error.baseline_rmse
        elif error.quantity == "position_h_pct":
            known["position_h_baseline_rmse_pct"] = error.baseline_rmse
            known["position_h_rmse_pct"] = error.rmse
    return known


def _verdict_in_summary(report: Report, name: str) -> dict[str, Any]:
    """Return the columns of the verdict on a candidate."""
    candidate = report.filters[name]
    answer = answer_on_dive(report, name)
    known: dict[str, Any] = {"prediction": candidate.prediction}
    if answer.undecided != ReasonCode.ONE_DIVE:
        known["verdict"] = answer.verdict
    if answer.verdict in WITHOUT_VERDICT:
        return known
    known["mean_improvement_pct"] = candidate.mean_improvement_pct
    known["mean_convergence_improvement_pct"] = candidate.mean_convergence_improvement_pct
    row = answer.decisive
    if row is not None:
        known |= {"evidence": row.quantity, "ratio": row.ratio, "acts": row.acts}
    return known


def answer_rows(outcomes: Sequence[Outcome]) -> list[AnswerRow]:
    """Return the answers of the headlines, a row for each candidate."""
    return [answer_row(answer) for answer in answers_of(reports_of(outcomes))]


def pooled_rows(outcomes: Sequence[Outcome]) -> list[PooledRow]:
    """Return the pooled evidence on all candidates that at least two dives have."""
    return list(chain.from_iterable(answer.rows for answer in _pooled(outcomes)))


def _pooled(outcomes: Sequence[Outcome]) -> list[CandidateAnswer]:
    return [answer for answer in answers_of(reports_of(outcomes)) if answer.log == EVERY_DIVE]


def where_rows(outcomes: Sequence[Outcome]) -> list[WhereRow]:
    """Return the drift by what the vehicle does, over all dives that have a candidate; of one dive its own rows."""
    reports = reports_of(outcomes)
    if len(reports) == 1:
        return list(reports[0].tables.where)
    return list(chain.from_iterable(where_of(reports, answers_of(reports)).values()))


NO_EVIDENCE: Final = (
    "no evidence. Accuracy takes a reference, the DVL outage test a dive of some minutes."
)

# --- The tables over all dives that `--table` names.

# Evidence rows of the summary, where a dive has them.
_SUMMARIES: Final = ("position", "position_pct", "drift_60s", "outage_60s")


def named_result(
    outcomes: Sequence[Outcome], names: Sequence[str], parts: Sequence[Part]
) -> Result:
    """Return named tables of all dives, with other parts before those over all dives."""
    rows: dict[str, tuple[type[Struct], Sequence[Struct]]] = {
        "answers": (AnswerRow, answer_rows(outcomes)),
        "pooled": (PooledRow, pooled_rows(outcomes)),
        "where": (WhereRow, where_rows(outcomes)),
        "summary": (SummaryRow, list(summary_rows(outcomes))),
    }
    reports = reports_of(outcomes)
    shown_parts = list(parts)
    for name in names:
        if name in TOGETHER:
            tables = list(_TOGETHER[name](outcomes))
            shown_parts += tables
            if not (tables or rows[name][1]):
                shown_parts.append(_missing_table(name, len(reports)))
    return replay_result(reports, shown_parts, names, rows)


def _missing_table(name: str, replayed: int) -> str:
    dives = counted(replayed, "dive")
    return f"There is no table {name}: {_NEEDED[name]}, and {dives} could be replayed."


def _answer_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Yield the table of the answers, if there is a candidate."""
    rows = answer_rows(outcomes)
    if rows:
        yield shown(AnswerRow, rows)


def _pooled_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    for answer in _pooled(outcomes):
        if answer.rows:
            rows = map(as_shown, answer.rows)
            yield shown(PooledRow, rows, filter=answer.filter, baseline=answer.baseline)
        elif answer.verdict in WITHOUT_VERDICT:
            why = f"{answer.verdict}: {answer.reason}"
            yield f"{answer.filter} against {answer.baseline}: {why}"
        else:
            yield f"{answer.filter} against {answer.baseline}: {NO_EVIDENCE}"


_WHERE: Final[tuple[ShownColumn, ...]] = (
    ("where", "l", "bin:label"),
    ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ("interval", "r", lambda row: interval_of(row.low, row.high)),
    ("to rest", "r", lambda row: ratio_text(row.to_rest)),
    ("interval", "r", lambda row: interval_of(row.to_rest_low, row.to_rest_high)),
    ("p", "r", "p_adjusted:significant"),
    ("dives", "r", "dives"),
    ("windows", "r", "windows"),
    ("", "l", lambda row: "notable" if row.stands_out else ""),
)


def _where_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Yield the drift by what the vehicle does, a table for each candidate."""
    reports = reports_of(outcomes)
    answers = answers_of(reports)
    found = where_of(reports, answers)
    for answer in answers:
        rows = found.get(answer.filter)
        if rows:
            names = f"{answer.filter} against {answer.baseline}"
            title = f"Where: drift in 30 s by what the vehicle does, {names}"
            yield table_of(title, rows, _WHERE, TO_REST)


TO_REST: Final = (
    "to rest: the ratio over that in the rest of the dive. A bin is notable if both "
    "intervals, which are valid for "
    "all bins together, are beyond the band of a factor 1.05 on the same side. No verdict "
    "depends on it."
)


def _summary_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Yield the values of dives by filters, a table for each quantity."""
    reports = reports_of(outcomes)
    names = candidate_names(reports)
    for quantity in _SUMMARIES:
        rows = []
        unit = ""
        for report in reports:
            found = {row.filter: row for row in report.tables.evidence if row.quantity == quantity}
            if not found:
                continue
            [first, *_] = found.values()
            unit = first.unit
            cells = [report.log.name, number(first.baseline)]
            for name in names:
                cells.append(number(found[name].value) if name in found else MISSING)
            rows.append(tuple(cells))
        if rows:
            title = f"Summary: {label(quantity)} [{unit}] of dives by filters"
            header = ("dive", baseline_names(reports), *names)
            yield DisplayTable(title, header, f"lr{'r' * len(names)}", tuple(rows))


_TOGETHER: Final = {
    "answers": _answer_tables,
    "pooled": _pooled_tables,
    "where": _where_tables,
    "summary": _summary_tables,
}
_NEEDED: Final = {
    "answers": "it takes a candidate",
    "pooled": "it takes two dives with the same candidate",
    "where": "it takes a reference, and a candidate on two dives with four windows of 30 s in a bin",
    "summary": "it takes a dive with evidence",
}


# --- The page, and the same in other formats.


def index_page(outcomes: Sequence[Outcome]) -> bytes:
    """Return the page of several dives, in the order of the logs; a script lets the reader sort its table."""
    return page([*_opening(outcomes, linked=True), *_tables(outcomes)], "sorting.js")


def _first_line(kind: type[Struct]) -> bytes:
    return table_csv(Block.of(kind, ()))


# The files of several dives together: the function that writes each, and its first bytes.
OVERVIEWS: Final[Mapping[str, tuple[Callable[[Sequence[Outcome]], bytes], bytes]]] = {
    SUMMARY: (
        lambda outcomes: table_csv(Block.of(SummaryRow, summary_rows(outcomes))),
        _first_line(SummaryRow),
    ),
    "answers.csv": (
        lambda outcomes: table_csv(Block.of(AnswerRow, answer_rows(outcomes))),
        _first_line(AnswerRow),
    ),
    "evidence.csv": (
        lambda outcomes: table_csv(Block.of(PooledRow, pooled_rows(outcomes))),
        _first_line(PooledRow),
    ),
    "where.csv": (
        lambda outcomes: table_csv(Block.of(WhereRow, where_rows(outcomes))),
        _first_line(WhereRow),
    ),
    INDEX: (index_page, SIGNATURE.encode()),
}


def overview_parts(outcomes: Sequence[Outcome]) -> list[Part]:
    """Return several dives as a document: the pooled verdict, a row for each dive and candidate, pooled rows."""
    parts: list[Part] = list(_opening(outcomes, linked=False))
    for part in _tables(outcomes):
        if isinstance(part, DisplayTable):
            part = replace(part, links=None)
        parts.append(part)
    return parts


def _opening(outcomes: Sequence[Outcome], *, linked: bool) -> Iterator[Part]:
    """Yield the title, which dives are copies, and the pooled verdicts."""
    reports = reports_of(outcomes)
    answers = answers_of(reports)
    yield Title(_title(outcomes, reports))
    _, notes = distinct_dives(reports)
    for note in notes:
        yield note.text
    start = start_text(reports)
    verdicts = []
    for answer in answers:
        verdicts.append(Callout(paragraph(answer, start), TONES.get(answer.verdict, "")))
    yield Only(PRINTED, tuple(verdicts))
    where = where_of(reports, answers)
    sections = []
    for answer in answers:
        rows = where.get(answer.filter, [])
        drawn = rows if is_where_drawn(rows, len(answers)) else []
        common = _is_common_start(answers)
        sections.append(_section_of(answer, reports, drawn, linked=linked, has_start=not common))
    if sections:
        yield Only(PAGE, (first_screen(sections, _caption(answers, reports)),))


def _caption(answers: Sequence[CandidateAnswer], reports: Sequence[Report]) -> str:
    """Return what all sections have in common; with several candidates also their starts."""
    caption = "All dives: each dive is one sample. Dive by dive: a single dive has no interval and no verdict."
    if _is_common_start(answers):
        if start := start_text(reports):
            caption += f" Start: {start}."
        if initial := initial_text(reports[0].config):
            caption += f" Drawn starts are as uncertain as [initial]: {initial}."
    return caption


def _is_common_start(answers: Sequence[CandidateAnswer]) -> bool:
    """Return whether the start is named below all sections rather than in each: it is the same on the same dives."""
    return len(answers) > 1 and len({answer.dives for answer in answers}) == 1


def _title(outcomes: Sequence[Outcome], reports: Sequence[Report]) -> str:
    """Return the number of dives, of those that failed, and the names of few candidates."""
    title = f"{len(outcomes)} dives"
    failed = len(outcomes) - len(reports)
    if failed:
        title += f", {failed} of them failed"
    names = candidate_names(reports)
    if 0 < len(names) <= MOST_NAMED:
        title += f": {', '.join(names)} against {reports[0].baseline}"
    return title


def _section_of(
    answer: CandidateAnswer,
    reports: Sequence[Report],
    where: Sequence[WhereRow],
    *,
    linked: bool,
    has_start: bool,  # in its own sentences
) -> str:
    """Return the section of a candidate: over all dives, or of the only dive that has it."""
    if answer.log == EVERY_DIVE:
        return _section(answer, reports, where, linked=linked, has_start=has_start)
    by_name = {report.log.name: report for report in reports}
    title = f"Evidence on {answer.log} alone"
    return dive_section(by_name[answer.log], answer.filter, title)


MOST_NAMED: Final = 4  # With more candidates, the title has no names.
_MOST_ROWS: Final = 8  # Evidence rows of the forest plot of all dives.


def _section(
    answer: CandidateAnswer,
    reports: Sequence[Report],
    where: Sequence[WhereRow],
    *,
    linked: bool,
    has_start: bool,
) -> str:
    dives = dives_forest(answer, reports, linked=linked)
    if answer.verdict in WITHOUT_VERDICT:
        said = f"Evaluated on {answer.evaluated} of {answer.dives} dives. Settle the reasons of the others first."
        return section(answer, [said, *answer_lines(answer)], [dives])
    title = "All dives"
    if answer.evaluated < answer.dives:
        title = f"All dives, {answer.evaluated} of {answer.dives}"
    having = [report for report in reports if answer.filter in report.filters]
    initial = ""
    start = ""
    if has_start or answer.from_drawn_heading is not None:
        start = start_text(having)
    if has_start:
        initial = initial_text(reports[0].config)
    sentences = [grounds(answer), *answer_lines(answer, initial, start)]
    if line := where_line(notable(where)):
        sentences.append(line)
    evidence = evidence_forest(title, answer, _MOST_ROWS, where)
    return section(answer, sentences, [evidence, dives])


# The meaning of the columns of candidates.
MEANS: Final = (
    "evidence: the primary quantity, with its ratio on this dive; acts: the difference of both runs over the error of "
    "the baseline; predicted: how much smaller sigma is, mean of nine states, by the filter's own covariance"
)
MEDIAN: Final = "without DVL: the median"


_DIVE: Final[tuple[ShownColumn, ...]] = (("dive", "l", "log"), ("filter", "l", "filter"))


def _consistency_text(row: SummaryRow) -> str:
    if row.consistency is None:
        return row.status
    return row.consistency


def _evidence_text(row: SummaryRow) -> str:
    if row.evidence:
        return label(row.evidence)
    return MISSING


def _prediction_text(row: SummaryRow) -> str:
    return prediction_word(row.mean_improvement_pct, row.prediction or "") or MISSING


def _candidate_position(row: SummaryRow) -> str:
    """Write the error of a candidate, with or without a verdict; of the only filter it is the baseline's."""
    if row.prediction is not None:
        return number(row.position_h_rmse_m)
    return MISSING


_CONSISTENCY: Final[ShownColumn] = ("consistency", "l", _consistency_text)
_LAST: Final[tuple[ShownColumn, ...]] = (
    _CONSISTENCY,
    ("warnings", "r", "warnings"),
    ("reason of failure", "l", "reason"),
)
_CANDIDATE: Final[tuple[ShownColumn, ...]] = (
    ("verdict", "l", "verdict"),
    ("evidence", "l", _evidence_text),
    ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ("acts", "r", "acts:share"),
    ("predicted", "r", "mean_improvement_pct:percent"),
    ("prediction", "l", _prediction_text),
    ("baseline\nposition [m]", "r", "position_h_baseline_rmse_m"),
    ("candidate\nposition [m]", "r", _candidate_position),
)


def _value_columns() -> Iterator[ShownColumn]:
    """Yield the values that a filter has without a candidate, under their names and units."""
    for column, (name, unit) in VALUES.items():
        head = f"{name}\n[{unit}]" if unit else name
        yield head, "r", f"{column}:value"


_ALONE: Final[tuple[ShownColumn, ...]] = tuple(_value_columns())


def _tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    """Yield the table of dives, each with a link to its page, and the pooled evidence; empty columns are left out."""
    rows = list(summary_rows(outcomes))
    reports = reports_of(outcomes)
    if candidate_names(reports):
        title = "Each candidate against its baseline"
        columns = [*_DIVE, *_CANDIDATE, *_LAST]
        footnote = MEANS
        if any(has_reference(report) for report in reports):
            footnote = f"{MEANS}; position: rms of the horizontal error"
    else:
        title = "Each dive"
        columns = [*_DIVE, *_ALONE, *_LAST]
        footnote = MEDIAN
    kept = _columns_with_values(rows, columns)
    links = tuple(_link(row) for row in rows)
    yield replace(table_of(title, rows, kept, footnote), links=links)
    yield from _pooled_tables(outcomes)
    yield from _where_tables(outcomes)


def _columns_with_values(
    rows: Sequence[SummaryRow], columns: Sequence[ShownColumn]
) -> list[ShownColumn]:
    """Return the columns in which anything is known."""
    kept = []
    cells = table_of("", rows, columns).rows
    for place, column in enumerate(columns):
        if any(row[place] != MISSING for row in cells):
            kept.append(column)
    return kept


def _link(row: SummaryRow) -> str:
    """Return the link to the page of a dive; a failed one has none."""
    if row.reason:
        return ""
    return f"{quote(row.log)}/{DIVE_PAGE}"


def table_alone(outcomes: Sequence[Outcome]) -> DisplayTable:
    """Return the values of filters without candidates, a row for each dive."""
    columns = [("dive by dive", "l", "log"), *_ALONE, _CONSISTENCY]
    return table_of("", summary_rows(outcomes), columns, MEDIAN, spare=(2, 6, 3, 7), folds=8)
