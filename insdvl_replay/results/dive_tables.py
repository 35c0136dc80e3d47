"""What people see of one dive: its first lines, what each candidate gains, and how far each filter is to be trusted."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Protocol, TypeVar

from msgspec.structs import replace

from insdvl_replay.core.quantities import DECIDING, HONESTY, is_whole, label
from insdvl_replay.core.table import Number, finite
from insdvl_replay.core.tables import (
    Candidate,
    CoastingRow,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    DriftRow,
    EvidenceRow,
    ImprovementRow,
    JumpRow,
    PooledRow,
    ReferenceErrorRow,
    TrackFitRow,
)
from insdvl_replay.core.words import Judgement, ReferenceStatus
from insdvl_replay.evaluation.over_dives import PooledCandidate
from insdvl_replay.report.document import (
    MISSING,
    Column,
    DisplayTable,
    decimal,
    number,
    percent,
    shown,
    table_of,
)
from insdvl_replay.results.json_report import Report

NO_REFERENCE: Final = (
    "There is no reference: how far the filters are off, how fast they really converge, whether their errors are as "
    "large as they say, and whether they gain what they believe cannot be told."
)
SPECIFIED: Final = (
    "Of distance: the final horizontal error. CEP50 and CEP95: half and 95 % of the horizontal errors of this run are "
    "smaller. Without DVL: median drift over the windows of the outage test, by the withheld velocities."
)
"""What the numbers of the headline are."""
_SIGN: Final = "\N{PLUS-MINUS SIGN}"
_FEWEST_DIGITS, _MOST_DIGITS = 2, 5


MEANS: Final = (
    "measured: how much smaller the error is by the first piece of evidence; believed: mean over nine states, by the "
    "filter's own covariance"
)
"""What stands in the columns of candidates."""
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


def has_reference(report: Report) -> bool:
    """Return whether the dive has a reference to compare with; early reports lack one of the tables that say so."""
    found = [row.verdict for row in report.tables.credibility] + [row.status for row in report.tables.reference_error]
    return any(word != ReferenceStatus.NO_REFERENCE for word in found)


def track_fit_line(report: Report) -> Iterator[str]:
    """State in a line what would lay the baseline's track on the reference's, where that is known."""
    fit = {row.quantity: row for row in report.tables.track_fit if row.filter == report.baseline}
    if fit:
        scale, turn = (f"{quantity} {_with_sd(fit[quantity])} {fit[quantity].unit}" for quantity in ("scale", "turn"))
        yield f"track fit: {scale}, {turn}"


def _with_sd(row: TrackFitRow) -> str:
    """Write a number with its standard error, to the first digit of that at least."""
    digits = next((n for n in range(_FEWEST_DIGITS, _MOST_DIGITS) if finite(row.fitted_sd) >= 10.0**-n), _FEWEST_DIGITS)
    sd = "" if row.fitted_sd is None else f" {_SIGN} {row.fitted_sd:.{digits}f}"
    return f"{finite(row.fitted):+.{digits}f}{sd}"


def headline_table(report: Report, title: str = "", footnote: str = "") -> Iterator[DisplayTable]:
    """Lay out what INS/DVL systems are specified by, a line for each filter: this run's own errors, where known."""
    position = {row.filter: row for row in report.tables.drift if row.quantity == "position_h"}
    outages = {(row.window_s, row.filter): row.drift_median_m for row in report.tables.coasting if row.windows}
    tested = {window_s for window_s, _ in outages}
    windows_s = [window_s for window_s in ("60", "120") if window_s in tested] or sorted(tested)[:1]
    header = ["this run", *(("of distance", "CEP50", "CEP95", "end") if position else ())]
    header += [f"{window_s} s{'' if i else ' without DVL'}" for i, window_s in enumerate(windows_s)]
    rows = []
    for name in (report.baseline, *report.filters):
        row = position.get(name)
        errors = [MISSING] * 4 if row is None else [_of_distance(row), *map(_metres, (row.p50, row.p95, row.final))]
        drifts = [_metres(outages.get((window_s, name))) for window_s in windows_s]
        rows.append((name, *(errors if position else ()), *drifts))
    if len(header) > 1:
        spare = tuple(range(len(header) - 1, 1, -1))
        yield DisplayTable(title, tuple(header), f"l{'r' * (len(header) - 1)}", tuple(rows), footnote, spare=spare)


def _of_distance(row: DriftRow) -> str:
    known = row.final_of_distance_pct is not None
    return f"{row.final_of_distance_pct:.2f} % of {row.distance_m:.0f} m" if known else MISSING


def _metres(value: Number) -> str:
    return MISSING if value is None else f"{value:.3g} m" if value < 1000.0 else f"{value:.0f} m"


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
        rows = [row for row in _of(name, report.tables.evidence) if row.baseline is not None or row.value is not None]
        if rows:
            with_votes = [replace(row, word=word_in_table(row)) for row in rows]
            footnote = _how_measured(rows, is_read=is_read(report, name))
            yield shown(EvidenceRow, with_votes, footnote=footnote, filter=name, baseline=report.baseline)
    if report.tables.coasting:
        yield shown(CoastingRow, report.tables.coasting)


def filter_tables(report: Report) -> Iterator[DisplayTable]:
    """Lay out three tables for each candidate and three on how far to trust each filter, those that have rows."""
    tables = report.tables
    for name in report.filters:
        names = {"filter": name, "baseline": report.baseline}
        if improvement := _of(name, tables.improvement):
            yield shown(ImprovementRow, improvement, **names)
        if convergence := _of(name, tables.convergence):
            footnote = (
                f"{report.baseline} ends at {number(convergence[0].baseline_s)} s. nearest: when the sigma of {name} "
                "is nearest to the target, the time of Levy and Klein. It may turn back there."
            )
            yield shown(ConvergenceRow, convergence, footnote=footnote, **names)
        errors = _of(name, tables.reference_error)
        if compared := [row for row in errors if row.samples]:
            yield shown(ReferenceErrorRow, compared, footnote=_not_compared(errors), **names)
    if consistency := [row for row in tables.consistency if is_whole(row.measurement)]:
        footnote = _in_spite([(f"{row.filter} {row.measurement}", row.why) for row in consistency])
        yield shown(ConsistencyRow, consistency, footnote=footnote)
    if innovations := [row for row in tables.consistency if row.whiteness]:
        yield _innovations(innovations)
    for name in (report.baseline, *report.filters):
        if nees := [row for row in _of(name, tables.credibility) if row.samples]:
            footnote = (
                f"Expected: NEES 1, of a group 3, all together {nees[-1].dof}; 68.3 % and 99.7 %. The reference is "
                "taken as exact. indep.: samples that do not repeat each other. "
            )
            footnote += _in_spite([(label(row.quantity), row.why) for row in nees])
            yield shown(CredibilityRow, nees, footnote=footnote, filter=name)


def reference_tables(report: Report) -> Iterator[DisplayTable]:
    """Lay out how far each filter is from the reference, nothing without one; and how often positions jump."""
    tables, quantities = report.tables, list(dict.fromkeys(row.quantity for row in report.tables.drift))
    if tables.drift:
        yield shown(DriftRow, sorted(tables.drift, key=lambda row: quantities.index(row.quantity)))
    if tables.track_fit:
        yield shown(TrackFitRow, tables.track_fit)
    if tables.jumps:
        yield shown(JumpRow, tables.jumps)


def pooled_table(pooled: PooledCandidate) -> DisplayTable:
    """Lay out what several dives say of a candidate together."""
    return shown(PooledRow, pooled.rows, filter=pooled.name, baseline=pooled.baseline)


def _of(name: str, rows: Iterable[Row]) -> list[Row]:
    return [row for row in rows if row.filter == name]


def _innovations(rows: Sequence[ConsistencyRow]) -> DisplayTable:
    columns: list[Column[ConsistencyRow]] = [
        ("filter", "l", lambda row: row.filter),
        ("measurement", "l", lambda row: row.measurement.replace("_", " ")),
        ("NIS / dof", "r", lambda row: number(row.mean_nis if row.mean_nis is None else row.mean_nis / row.dof)),
        ("verdict", "l", lambda row: row.verdict),
        ("likeness", "r", lambda row: decimal(row.autocorrelation, 2)),
        ("limit", "r", lambda row: decimal(row.autocorrelation_limit, 2)),
        ("whiteness", "l", lambda row: row.whiteness),
    ]
    return table_of("Innovations by axis: size, and likeness of each to the one before", rows, columns)


def word_in_table(row: EvidenceRow) -> str:
    """Return the word on a piece of evidence, in brackets where it has no vote."""
    return row.word if row.quantity in DECIDING or not row.word else f"({row.word})"


def is_read(report: Report, name: str) -> bool:
    """Return whether a filter is a solution that was read; early reports know of none."""
    return bool(report.config.get("filters", {}).get(name, {}).get("solution"))


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


def _not_compared(rows: Sequence[ReferenceErrorRow]) -> str:
    """State why numbers are missing or mean nothing; the word alone where it holds for all rows."""
    quantities: dict[str, list[str]] = {}
    for row in rows:
        quantities.setdefault(row.status, []).append(label(row.quantity))
    quantities.pop(ReferenceStatus.COMPARED, None)
    return "; ".join(
        status if len(names) == len(rows) else f"{status}: {', '.join(names)}" for status, names in quantities.items()
    )


def _in_spite(names: Iterable[tuple[str, str]]) -> str:
    """State why verdicts are not what the interval beside them says."""
    reasons: dict[str, list[str]] = {}
    for name, why in names:
        reasons.setdefault(why, []).append(name)
    reasons.pop("", None)
    named = "; ".join(f"{why}: {', '.join(found)}" for why, found in reasons.items())
    return f"In spite of the interval, {named}." if named else ""
