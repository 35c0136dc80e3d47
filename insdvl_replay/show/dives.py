"""Several dives as shown: the summary for scripts, the tables of all dives, the page with a link to each dive."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final
from urllib.parse import quote

from msgspec import Struct

from insdvl_replay.core.distinct import distinct_dives
from insdvl_replay.core.errors import counted
from insdvl_replay.core.path_kinds import SUMMARY
from insdvl_replay.core.quantities import WITHOUT_VERDICT, is_whole, label
from insdvl_replay.core.report import Report
from insdvl_replay.core.tables import AnswerRow, Number, PooledRow
from insdvl_replay.core.words import GateStatus, Severity
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
from insdvl_replay.evaluation.sentences import answer_lines, grounds, paragraph, ratio_text
from insdvl_replay.evaluation.verdicts import consistency_of
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
)
from insdvl_replay.show.dive import TOGETHER, VALUES, dive_section, replay_result, values_of
from insdvl_replay.show.first_screen import (
    DIVE_PAGE,
    dives_forest,
    evidence_forest,
    first_screen,
    section,
)

INDEX: Final = "index.html"

# --- For scripts: a summary, and the pooled evidence.


class SummaryRow(Struct, frozen=True):
    """One log and candidate, or the only filter. A failed log has a reason instead of numbers."""

    log: str
    filter: str | None = None
    verdict: str | None = None
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
        warnings = sum(note.severity == Severity.WARNING for note in outcome.notes)
        for name in outcome.filters or [outcome.baseline]:
            measured = of_filter(name, outcome.tables.consistency)
            words = [
                f"{row.measurement} {row.verdict}" for row in measured if is_whole(row.measurement)
            ]
            known: dict[str, Any] = {
                key: value for key, value in values_of(outcome, name).items() if value == value
            }
            if (candidate := outcome.filters.get(name)) is not None:
                answer = answer_on_dive(outcome, name)
                known |= {"verdict": answer.verdict, "prediction": candidate.prediction}
                words += [f"errors {candidate.credibility}"] if candidate.credibility else []
                if answer.verdict not in WITHOUT_VERDICT:
                    known["mean_improvement_pct"] = candidate.mean_improvement_pct
                    known["mean_convergence_improvement_pct"] = (
                        candidate.mean_convergence_improvement_pct
                    )
                if answer.verdict not in WITHOUT_VERDICT and (row := answer.decisive) is not None:
                    known |= {"evidence": row.quantity, "ratio": row.ratio, "acts": row.acts}
            for error in of_filter(name, outcome.tables.reference_error):
                if error.quantity == "position_h":
                    known["position_h_baseline_rmse_m"] = error.baseline_rmse
                elif error.quantity == "position_h_pct":
                    known["position_h_baseline_rmse_pct"] = error.baseline_rmse
                    known["position_h_rmse_pct"] = error.rmse
            worst = consistency_of(measured, name) if candidate is None else candidate.consistency
            yield SummaryRow(
                outcome.log.name,
                name,
                consistency=worst,
                consistency_of_each="; ".join(words),
                warnings=warnings,
                **known,
            )


def answer_rows(outcomes: Sequence[Outcome]) -> list[AnswerRow]:
    """Return the answers of the headlines, a row for each candidate."""
    return [answer_row(answer) for answer in answers_of(reports_of(outcomes))]


def pooled_rows(outcomes: Sequence[Outcome]) -> list[PooledRow]:
    """Return the pooled evidence on all candidates that at least two dives have."""
    return [row for answer in _pooled(outcomes) for row in answer.rows]


def _pooled(outcomes: Sequence[Outcome]) -> list[CandidateAnswer]:
    return [answer for answer in answers_of(reports_of(outcomes)) if answer.log == EVERY_DIVE]


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
        "summary": (SummaryRow, list(summary_rows(outcomes))),
    }
    reports = reports_of(outcomes)
    shown_tables = list[Part]()
    for name in (name for name in names if name in TOGETHER):
        missing = f"There is no table {name}: {_NEEDED[name]}, and {counted(len(reports), 'dive')} could be replayed."
        shown_tables += list(_TOGETHER[name](outcomes)) or [missing]
    return replay_result(reports, [*parts, *shown_tables], names, rows)


def _answer_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable]:
    """Yield the table of the answers, if there is a candidate."""
    rows = answer_rows(outcomes)
    if rows:
        yield shown(AnswerRow, rows)


def _pooled_tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    for answer in _pooled(outcomes):
        if not answer.rows:
            is_evaluated = answer.verdict not in WITHOUT_VERDICT
            why = NO_EVIDENCE if is_evaluated else f"{answer.verdict}: {answer.reason}"
            yield f"{answer.filter} against {answer.baseline}: {why}"
            continue
        yield shown(
            PooledRow, map(as_shown, answer.rows), filter=answer.filter, baseline=answer.baseline
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
            for row in list(found.values())[:1]:
                values = (number(found[name].value) if name in found else MISSING for name in names)
                rows.append((report.log.name, number(row.baseline), *values))
                unit = row.unit
        if rows:
            title = f"Summary: {label(quantity)} [{unit}] of dives by filters"
            header = ("dive", baseline_names(reports), *names)
            yield DisplayTable(title, header, f"lr{'r' * len(names)}", tuple(rows))


_TOGETHER: Final = {
    "answers": _answer_tables,
    "pooled": _pooled_tables,
    "summary": _summary_tables,
}
_NEEDED: Final = {
    "answers": "it takes a candidate",
    "pooled": "it takes two dives with the same candidate",
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
    INDEX: (index_page, SIGNATURE.encode()),
}


def overview_parts(outcomes: Sequence[Outcome]) -> list[Part]:
    """Return several dives as a document: the pooled verdict, a row for each dive and candidate, pooled rows."""
    tables = [
        replace(part, links=None) if isinstance(part, DisplayTable) else part
        for part in _tables(outcomes)
    ]
    return [*_opening(outcomes, linked=False), *tables]


def _opening(outcomes: Sequence[Outcome], *, linked: bool) -> Iterator[Part]:
    """Yield the pooled verdicts, and the number of dives with each verdict."""
    reports = reports_of(outcomes)
    failed = len(outcomes) - len(reports)
    answers = answers_of(reports)
    names = candidate_names(reports)
    compared = (
        f": {', '.join(names)} against {reports[0].baseline}"
        if 0 < len(names) <= MOST_NAMED
        else ""
    )
    yield Title(f"{len(outcomes)} dives{f', {failed} of them failed' if failed else ''}{compared}")
    _, notes = distinct_dives(reports)
    yield from (note.text for note in notes)
    start = start_text(reports)
    yield Only(
        PRINTED,
        tuple(
            Callout(paragraph(answer, start), TONES.get(answer.verdict, "")) for answer in answers
        ),
    )
    initial = initial_text(reports[0].config) if reports else ""
    sections = []
    for answer in answers:
        if answer.log == EVERY_DIVE:
            sections.append(_section(answer, reports, initial, linked=linked))
        else:
            report = next(report for report in reports if report.log.name == answer.log)
            sections.append(
                dive_section(report, answer.filter, f"Evidence on {report.log.name} alone")
            )
    caption = (
        "All dives: each is one sample. Dive by dive: one dive has no interval and no verdict."
    )
    yield Only(PAGE, (first_screen(sections, caption),) if sections else ())


MOST_NAMED: Final = 4  # With more candidates, the title has no names.
_MOST_ROWS: Final = 8  # Evidence rows of the forest plot of all dives.


def _section(
    answer: CandidateAnswer, reports: Sequence[Report], initial: str, *, linked: bool
) -> str:
    dives = dives_forest(answer, reports, linked=linked)
    if answer.verdict in WITHOUT_VERDICT:
        said = f"Evaluated on {answer.evaluated} of {answer.dives} dives. Settle the reasons of the others first."
        return section(answer, [said, *answer_lines(answer)], [dives])
    title = (
        f"All dives, {answer.evaluated} of {answer.dives}"
        if answer.evaluated < answer.dives
        else "All dives"
    )
    plots = [evidence_forest(title, answer, _MOST_ROWS), dives]
    having = [report for report in reports if answer.filter in report.filters]
    return section(
        answer, [grounds(answer), *answer_lines(answer, initial, start_text(having))], plots
    )


# The meaning of the columns of candidates.
MEANS: Final = (
    "evidence: the primary quantity, with its ratio on this dive; acts: the difference of both runs over the error of "
    "the baseline; predicted: how much smaller sigma is, mean of nine states, by the filter's own covariance"
)
MEDIAN: Final = "without DVL: the median"


_DIVE: Final[tuple[ShownColumn, ...]] = (("dive", "l", "log"), ("filter", "l", "filter"))
_CONSISTENCY: Final[ShownColumn] = (
    "consistency", "l", lambda row: row.status if row.consistency is None else row.consistency,
)  # fmt: skip
_LAST: Final[tuple[ShownColumn, ...]] = (
    _CONSISTENCY,
    ("warnings", "r", "warnings"),
    ("reason of failure", "l", "reason"),
)
_CANDIDATE: Final[tuple[ShownColumn, ...]] = (
    ("verdict", "l", "verdict"),
    ("evidence", "l", lambda row: label(row.evidence) if row.evidence else MISSING),
    ("ratio", "r", lambda row: ratio_text(row.ratio)),
    ("acts", "r", "acts:share"),
    ("predicted", "r", "mean_improvement_pct:percent"),
    (
        "prediction",
        "l",
        lambda row: prediction_word(row.mean_improvement_pct, row.prediction) or MISSING,
    ),
    ("baseline\nposition [m]", "r", "position_h_baseline_rmse_m"),
    (
        "candidate\nposition [m]",
        "r",
        lambda row: number(row.position_h_rmse_m if row.verdict else None),
    ),
)
_ALONE: Final[tuple[ShownColumn, ...]] = tuple(
    (f"{name}\n[{unit}]" if unit else name, "r", f"{column}:value")
    for column, (name, unit) in VALUES.items()
)


def _tables(outcomes: Sequence[Outcome]) -> Iterator[DisplayTable | str]:
    """Yield the table of dives, each with a link to its page, and the pooled evidence; empty columns are left out."""
    rows = list(summary_rows(outcomes))
    reports = reports_of(outcomes)
    title = "Each dive"
    footnote = MEDIAN
    own = _ALONE
    if candidate_names(reports):
        known = any(has_reference(report) for report in reports)
        title = "Each candidate against its baseline"
        own = _CANDIDATE
        footnote = f"{MEANS}; position: rms of the horizontal error" if known else MEANS
    columns = [*_DIVE, *own, *_LAST]
    cells = zip(*table_of("", rows, columns).rows, strict=True)
    columns = [
        column for column, texts in zip(columns, cells, strict=True) if set(texts) != {MISSING}
    ]
    links = tuple("" if row.reason else f"{quote(row.log)}/{DIVE_PAGE}" for row in rows)
    yield replace(table_of(title, rows, columns, footnote), links=links)
    yield from _pooled_tables(outcomes)


def table_alone(outcomes: Sequence[Outcome]) -> DisplayTable:
    """Return the values of filters without candidates, a row for each dive."""
    columns = [("dive by dive", "l", "log"), *_ALONE, _CONSISTENCY]
    return table_of("", summary_rows(outcomes), columns, MEDIAN, spare=(2, 6, 3, 7), folds=8)
