"""The tables of one dive for people: what each candidate gains, and how far each filter is to be trusted."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Protocol, TypeVar

from insdvl_replay.core.result_tables import NOT_JUDGED, is_whole
from insdvl_replay.report.display_table import MISSING, ShownTable, decimal, number, percent, row_label
from insdvl_replay.results.json_report import (
    Candidate,
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    ImprovementRow,
    ReferenceErrorRow,
    Report,
)

MEANS: Final = (
    "believed: mean over nine states, by the filter's own covariance; actual: median of the errors against the "
    "reference; sooner: mean convergence"
)
"""What stands in the columns of candidates."""


class _OfFilter(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_OfFilter)


def shown_tables(report: Report) -> list[ShownTable]:
    """Turn a report into tables for people, three for each candidate and three on how far to trust each filter.

    Parameters
    ----------
    report : Report

    Returns
    -------
    list of ShownTable
        Tables without rows are left out.
    """
    return list(_tables(report))


def glance_table(report: Report) -> ShownTable:
    """Lay each candidate's verdicts and mean improvements beside each other.

    Parameters
    ----------
    report : Report

    Returns
    -------
    ShownTable
    """
    return ShownTable(
        "At a glance",
        ("filter", "improvement", "believed", "actual", "sooner", "innovations", "errors"),
        "llrrrll",
        tuple(
            (
                name,
                *gain_cells(candidate),
                candidate.consistency,
                candidate.credibility or MISSING,
            )
            for name, candidate in report.filters.items()
        ),
        f"{MEANS}; innovations and errors: whether they are as large as the filter says",
    )


def gain_cells(candidate: Candidate) -> tuple[str, str, str, str]:
    """Write what a candidate gains: the verdict on it, what is believed, what is so, and how much sooner."""
    if candidate.improvement == NOT_JUDGED:
        return NOT_JUDGED, MISSING, MISSING, MISSING
    return (
        candidate.improvement,
        percent(candidate.mean_improvement_pct),
        percent(candidate.reference_improvement_pct),
        percent(candidate.mean_convergence_improvement_pct),
    )


def _tables(report: Report) -> Iterator[ShownTable]:
    tables = report.tables
    for name in report.filters:
        yield from _improvement(report.baseline, name, _of(name, tables.improvement))
        yield from _convergence(report.baseline, name, _of(name, tables.convergence))
        yield from _reference_error(report.baseline, name, _of(name, tables.reference_error))
    yield from _consistency([row for row in tables.consistency if is_whole(row.measurement)])
    yield from _innovations([row for row in tables.consistency if row.whiteness])
    for name in (report.baseline, *report.filters):
        yield from _credibility(name, _of(name, tables.credibility))


def _of(name: str, rows: Iterable[Row]) -> list[Row]:
    return [row for row in rows if row.filter == name]


def _improvement(baseline: str, name: str, rows: Sequence[ImprovementRow]) -> Iterator[ShownTable]:
    if rows:
        yield ShownTable(
            f"Improvement: standard deviations at the end, {name} against {baseline}",
            ("state", "unit", baseline, name, "improvement", "status"),
            "llrrrl",
            tuple(
                (
                    row_label(row.state),
                    row.unit,
                    number(row.baseline_sd),
                    number(row.sd),
                    percent(row.improvement_pct),
                    row.status,
                )
                for row in rows
            ),
        )


def _convergence(baseline: str, name: str, rows: Sequence[ConvergenceRow]) -> Iterator[ShownTable]:
    if rows:
        yield ShownTable(
            f"Convergence: when {name} is as sure as {baseline} is at the end",
            ("state", "unit", "target", f"{baseline}\n[s]", f"{name}\n[s]", "sooner", "status"),
            "llrrrrl",
            tuple(
                (
                    row_label(row.state),
                    row.unit,
                    number(row.target_sd),
                    number(row.baseline_s),
                    number(row.reached_s),
                    percent(row.improvement_pct),
                    row.status.replace("_", " "),
                )
                for row in rows
            ),
        )


def _reference_error(baseline: str, name: str, rows: Sequence[ReferenceErrorRow]) -> Iterator[ShownTable]:
    if rows:
        yield ShownTable(
            f"Reference error: distance from the reference, {name} against {baseline}",
            (
                "quantity",
                "unit",
                f"{baseline}\nrms",
                f"{name}\nrms",
                "better",
                f"{baseline}\nfinal",
                f"{name}\nfinal",
            ),
            "llrrrrr",
            tuple(
                (
                    row_label(row.quantity),
                    row.unit,
                    number(row.baseline_rmse),
                    number(row.rmse),
                    percent(row.improvement_pct),
                    number(row.baseline_final),
                    number(row.final),
                )
                for row in rows
            ),
            _not_compared(rows),
        )


def _not_compared(rows: Sequence[ReferenceErrorRow]) -> str:
    """Say why numbers are missing or mean nothing; the word alone where it holds for all rows."""
    quantities: dict[str, list[str]] = {}
    for row in rows:
        quantities.setdefault(row.status, []).append(row_label(row.quantity))
    quantities.pop("compared", None)
    return "; ".join(
        status if len(names) == len(rows) else f"{status}: {', '.join(names)}" for status, names in quantities.items()
    )


def _consistency(rows: Sequence[ConsistencyRow]) -> Iterator[ShownTable]:
    if rows:
        yield ShownTable(
            "Consistency: mean NIS and where 95 % of consistent filters would have it",
            ("filter", "measurement", "used", "rejected", "NIS", "low", "high", "verdict"),
            "llrrrrrl",
            tuple(
                (
                    row.filter,
                    row.measurement,
                    str(row.used),
                    str(row.rejected),
                    number(row.mean_nis),
                    number(row.low),
                    number(row.high),
                    row.verdict,
                )
                for row in rows
            ),
        )


def _innovations(rows: Sequence[ConsistencyRow]) -> Iterator[ShownTable]:
    if rows:
        yield ShownTable(
            "Innovations by axis: size, and likeness of each to the one before",
            ("filter", "measurement", "NIS / dof", "verdict", "likeness", "limit", "whiteness"),
            "llrlrrl",
            tuple(
                (
                    row.filter,
                    row.measurement.replace("_", " "),
                    number(row.mean_nis if row.mean_nis is None else row.mean_nis / row.dof),
                    row.verdict,
                    decimal(row.autocorrelation, 2),
                    decimal(row.autocorrelation_limit, 2),
                    row.whiteness,
                )
                for row in rows
            ),
        )


def _credibility(name: str, rows: Sequence[CredibilityRow]) -> Iterator[ShownTable]:
    compared = [row for row in rows if row.samples]
    if compared:
        yield ShownTable(
            f"Credibility: errors of {name} in its own standard deviations",
            ("quantity", "NEES", "low", "high", "in\n1 sd", "in\n3 sd", "indep.", "verdict"),
            "lrrrrrrl",
            tuple(
                (
                    row_label(row.quantity).replace("accelerometer", "accel."),
                    number(row.mean_nees),
                    decimal(row.low, 2),
                    decimal(row.high, 2),
                    decimal(row.within_1sd_pct, 1),
                    decimal(row.within_3sd_pct, 1),
                    decimal(row.effective_samples, 0),
                    row.verdict,
                )
                for row in compared
            ),
            f"Expected: NEES 1, all together {compared[-1].dof}; 68.3 % and 99.7 %. The reference is taken as exact. "
            "indep.: samples that do not repeat each other.",
        )
