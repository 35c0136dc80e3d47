"""The tables of one dive for people: what each candidate gains, and how far each filter is to be trusted."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Protocol, TypeVar

from insdvl_replay.core.pooled_row import PooledRow
from insdvl_replay.core.quantities import DECIDING, NAMES, is_whole
from insdvl_replay.core.rows import (
    ConvergenceRow,
    EvidenceRow,
    ImprovementRow,
    ReferenceErrorRow,
)
from insdvl_replay.core.table_layout import Number, finite
from insdvl_replay.core.tables import Candidate
from insdvl_replay.core.track_rows import CoastingRow
from insdvl_replay.core.words import Judgement, ReferenceStatus
from insdvl_replay.evaluation.honesty import HONESTY
from insdvl_replay.evaluation.pooled_evidence import PooledCandidate
from insdvl_replay.report.document import (
    MISSING,
    Column,
    DisplayTable,
    decimal,
    number,
    percent,
    row_label,
    significant,
    table_of,
)
from insdvl_replay.results.json_report import Report
from insdvl_replay.results.reference_tables import has_reference
from insdvl_replay.results.trust_tables import consistency_tables, credibility_tables, innovations_tables

EVIDENCE: Final = "Evidence: what was measured"
"""Begins the title of the table of each candidate."""
TENFOLD: Final = 10.0
"""From here on, a ratio has as many digits as other numbers."""
MEANS: Final = (
    "measured: how much smaller the error is by the first piece of evidence; believed: mean over nine states, by the "
    "filter's own covariance"
)
"""What stands in the columns of candidates."""
BLIND: Final = (
    "Where a wrong heading, scale or constant turn of the mounting takes the track is not seen: the DVL itself shares "
    "it."
)
"""What withheld velocities cannot tell."""
TONES: Final[dict[str, str]] = {
    Judgement.BETTER: "good",
    Judgement.MIXED: "bad",
    Judgement.WORSE: "bad",
    Judgement.NOT_JUDGED: "bad",
}
"""How the page colours what is said of a candidate."""


class _OfFilter(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_OfFilter)


def glance_table(report: Report) -> DisplayTable:
    """Lay each candidate's verdicts and its measured and believed improvement beside each other, as far as known."""
    known = has_reference(report)
    columns: list[Column[tuple[str, Candidate]]] = [
        ("filter", "l", lambda one: one[0]),
        ("judgement", "l", lambda one: gain_cells(report, one[0])[0]),
        ("measured", "r", lambda one: gain_cells(report, one[0])[1]),
        ("believed", "r", lambda one: gain_cells(report, one[0])[2]),
        *([("belief", "l", lambda one: gain_cells(report, one[0])[3])] if known else []),
        ("innovations", "l", lambda one: one[1].consistency),
        *([("errors", "l", lambda one: one[1].credibility or MISSING)] if known else []),
    ]
    words = "innovations and errors" if known else "innovations"
    footnote = f"{MEANS}; {words}: whether they are as large as the filter says"
    return table_of("At a glance", list(report.filters.items()), columns, footnote)


def gain_cells(report: Report, name: str) -> tuple[str, str, str, str]:
    """Write what a candidate gains: the judgement, what is measured and believed, and whether that is borne out."""
    candidate = report.filters[name]
    if candidate.improvement == Judgement.NOT_JUDGED:
        return Judgement.NOT_JUDGED, MISSING, MISSING, MISSING
    first = next((row for row in report.tables.evidence if row.filter == name and row.evidence != HONESTY), None)
    measured = MISSING if first is None or first.ratio is None else percent(100.0 * (1.0 - first.ratio))
    return candidate.improvement, measured, percent(candidate.mean_improvement_pct), candidate.belief or MISSING


def evidence_tables(report: Report) -> Iterator[DisplayTable]:
    """Lay out what was measured of each candidate, and how all filters coast, where there are rows."""
    for name in report.filters:
        yield from _evidence(report, name, _of(name, report.tables.evidence))
    yield from _coasting(report.tables.coasting)


def filter_tables(report: Report) -> Iterator[DisplayTable]:
    """Lay out three tables for each candidate and three on how far to trust each filter, those that have rows."""
    tables = report.tables
    for name in report.filters:
        yield from _improvement(report.baseline, name, _of(name, tables.improvement))
        yield from _convergence(report.baseline, name, _of(name, tables.convergence))
        yield from _reference_error(report.baseline, name, _of(name, tables.reference_error))
    yield from consistency_tables([row for row in tables.consistency if is_whole(row.measurement)])
    yield from innovations_tables([row for row in tables.consistency if row.whiteness])
    for name in (report.baseline, *report.filters):
        yield from credibility_tables(name, _of(name, tables.credibility))


def _of(name: str, rows: Iterable[Row]) -> list[Row]:
    return [row for row in rows if row.filter == name]


def _evidence(report: Report, name: str, rows: Sequence[EvidenceRow]) -> Iterator[DisplayTable]:
    baseline = report.baseline
    rows = [row for row in rows if row.baseline is not None or row.value is not None]
    if rows:
        columns: list[Column[EvidenceRow]] = [
            ("quantity", "l", lambda row: NAMES[row.quantity]),
            ("word", "l", word_in_table),
            ("unit", "l", lambda row: row.unit),
            (baseline, "r", lambda row: number(row.baseline)),
            (name, "r", lambda row: number(row.value)),
            ("ratio", "r", lambda row: _ratio(row.ratio)),
            ("low", "r", lambda row: _ratio(row.low)),
            ("high", "r", lambda row: _ratio(row.high)),
            ("n", "r", lambda row: decimal(row.effective_samples, 0)),
            ("p", "r", lambda row: decimal(row.p, 4)),
            ("why", "l", lambda row: row.why),
        ]
        title = f"{EVIDENCE}, {name} against {baseline}"
        yield table_of(title, rows, columns, _how_measured(rows, is_read=is_read(report, name)))


def word_in_table(row: EvidenceRow) -> str:
    """Return the word on a piece of evidence, in brackets where it has no vote."""
    return row.word if row.quantity in DECIDING or not row.word else f"({row.word})"


def is_read(report: Report, name: str) -> bool:
    """Return whether a filter is a solution that was read; early reports know of none."""
    return bool(report.config.get("filters", {}).get(name, {}).get("solution"))


def pooled_table(pooled: PooledCandidate) -> DisplayTable:
    """Lay out what several dives say of a candidate together."""
    columns: list[Column[PooledRow]] = [
        ("quantity", "l", lambda row: NAMES[row.quantity]),
        ("word", "l", lambda row: row.word),
        ("ratio", "r", lambda row: _ratio(row.ratio)),
        ("low", "r", lambda row: _ratio(row.low)),
        ("high", "r", lambda row: _ratio(row.high)),
        ("dives", "r", lambda row: str(row.dives)),
        ("won", "r", lambda row: str(row.dives_won)),
        ("p", "r", lambda row: decimal(row.p, 4)),
    ]
    return table_of(
        f"All dives together: {pooled.name} against {pooled.baseline}",
        pooled.rows,
        columns,
        "geometric mean of the dives' ratios, its 95 % interval over dives, and p, both by Student's t, each dive one "
        "sample; three dives are the fewest that decide",
    )


def _ratio(value: Number) -> str:
    """Write a ratio with three decimals, a large one with four digits."""
    return decimal(value, 3) if abs(finite(value)) < TENFOLD else number(value)


def _how_measured(rows: Sequence[EvidenceRow], *, is_read: bool) -> str:
    starts = max(row.starts for row in rows)
    if is_read:
        begun = (
            f"the one start that it had against {starts} of the baseline, whose scatter low and high allow for"
            if starts > 1
            else "the one start that it had against that of the baseline, which is without error (--starts 16)"
        )
        return (
            f"{begun}; n: independent values that the interval rests on; of NEES the ratio is of how far it is from 1"
        )
    drawn = (
        f"values: of this dive from its own start; ratio of accuracy: from {starts} starts, drawn from what filters say"
        if starts > 1
        else "from one start, without error: what aiding gains from errors of the start is not seen (--starts 16)"
    )
    return (
        f"{drawn}; low to high: 95 % interval on this dive, other dives may differ by more; p below 0.01 decides, rows "
        "in brackets have no vote; n: independent values that the interval rests on; the ratio of NIS and of NEES is "
        "of how far they are from 1"
    )


def _coasting(rows: Sequence[CoastingRow]) -> Iterator[DisplayTable]:
    if rows:
        columns: list[Column[CoastingRow]] = [
            ("filter", "l", lambda row: row.filter),
            ("for", "r", lambda row: f"{row.window_s} s"),
            ("windows", "r", lambda row: str(row.windows)),
            ("median\n[m]", "r", lambda row: number(row.drift_median_m)),
            ("95 %\n[m]", "r", lambda row: number(row.drift_p95_m)),
            ("of way\n[%]", "r", lambda row: decimal(row.drift_of_distance_pct, 2)),
            ("down\n[m]", "r", lambda row: number(row.vertical_median_m)),
            ("rms\nratio", "r", lambda row: decimal(row.ratio_to_baseline, 2)),
            ("won\n[%]", "r", lambda row: decimal(row.windows_won_pct, 0)),
            ("NIS\n/ dof", "r", lambda row: significant(row.nis_per_dof)),
        ]
        yield table_of(
            "Coasting: drift while the DVL is withheld",
            rows,
            columns,
            BLIND,
        )


def _improvement(baseline: str, name: str, rows: Sequence[ImprovementRow]) -> Iterator[DisplayTable]:
    if rows:
        columns: list[Column[ImprovementRow]] = [
            ("state", "l", lambda row: row_label(row.state)),
            ("unit", "l", lambda row: row.unit),
            (baseline, "r", lambda row: number(row.baseline_sd)),
            (name, "r", lambda row: number(row.sd)),
            ("improvement", "r", lambda row: percent(row.improvement_pct)),
            ("status", "l", lambda row: row.status),
        ]
        yield table_of(f"Improvement: standard deviations at the end, {name} against {baseline}", rows, columns)


def _convergence(baseline: str, name: str, rows: Sequence[ConvergenceRow]) -> Iterator[DisplayTable]:
    if rows:
        columns: list[Column[ConvergenceRow]] = [
            ("state", "l", lambda row: row_label(row.state)),
            ("unit", "l", lambda row: row.unit),
            ("target", "r", lambda row: number(row.target_sd)),
            (f"{name}\n[s]", "r", lambda row: number(row.reached_s)),
            ("sooner", "r", lambda row: percent(row.improvement_pct)),
            ("status", "l", lambda row: row.status.replace("_", " ")),
            ("nearest\n[s]", "r", lambda row: number(row.nearest_approach_s)),
            ("sooner", "r", lambda row: percent(row.nearest_approach_improvement_pct)),
        ]
        end_s = number(rows[0].baseline_s)
        footnote = f"{baseline} ends at {end_s} s. nearest: when the sigma of {name} is nearest to the target, the "
        footnote += "time of Levy and Klein. It may turn back there."
        yield table_of(f"Convergence: when {name} is as sure as {baseline} is at the end", rows, columns, footnote)


def _reference_error(baseline: str, name: str, rows: Sequence[ReferenceErrorRow]) -> Iterator[DisplayTable]:
    compared = [row for row in rows if row.samples]
    if compared:
        columns: list[Column[ReferenceErrorRow]] = [
            ("quantity", "l", lambda row: row_label(row.quantity)),
            ("unit", "l", lambda row: row.unit),
            (f"{baseline}\nrms", "r", lambda row: number(row.baseline_rmse)),
            (f"{name}\nrms", "r", lambda row: number(row.rmse)),
            ("better", "r", lambda row: percent(row.improvement_pct)),
            (f"{baseline}\nfinal", "r", lambda row: number(row.baseline_final)),
            (f"{name}\nfinal", "r", lambda row: number(row.final)),
        ]
        title = f"Reference error: distance from the reference, {name} against {baseline}"
        yield table_of(title, compared, columns, _not_compared(rows))


def _not_compared(rows: Sequence[ReferenceErrorRow]) -> str:
    """State why numbers are missing or mean nothing; the word alone where it holds for all rows."""
    quantities: dict[str, list[str]] = {}
    for row in rows:
        quantities.setdefault(row.status, []).append(row_label(row.quantity))
    quantities.pop(ReferenceStatus.COMPARED, None)
    return "; ".join(
        status if len(names) == len(rows) else f"{status}: {', '.join(names)}" for status, names in quantities.items()
    )
