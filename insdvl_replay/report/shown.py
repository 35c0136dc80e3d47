"""A report as tables for people: titles, units, four significant digits. `terminal` and `markup` dress them."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from insdvl_replay.report.json_report import (
    ConsistencyRow,
    ConvergenceRow,
    CredibilityRow,
    ImprovementRow,
    ReferenceErrorRow,
    Report,
)
from insdvl_replay.result_tables import is_whole
from insdvl_replay.states import STATES

MISSING: Final = "-"
_LABELS: Final = {state.id: state.label for state in STATES}
_QUANTITIES: Final = {
    "velocity_n": "velocity, north",
    "velocity_e": "velocity, east",
    "velocity_d": "velocity, down",
    "roll": "roll",
    "pitch": "pitch",
    "heading": "heading",
    "position_h": "position",
    "depth": "depth",
    "position_h_pct": "pos. / distance",
    "all": "all together",
}


class _OfFilter(Protocol):
    @property
    def filter(self) -> str: ...


Row = TypeVar("Row", bound=_OfFilter)


@dataclass(frozen=True)
class ShownTable:
    """A table ready to be dressed.

    Attributes
    ----------
    title : str
        What it says, in one line.
    header : tuple of str
        Column names with units; a line break is a good place to fold.
    alignment : str
        One letter for each column: l for words, r for numbers.
    rows : tuple of tuples of str
    footnote : str
        What the rows cannot say.
    """

    title: str
    header: tuple[str, ...]
    alignment: str
    rows: tuple[tuple[str, ...], ...]
    footnote: str = ""


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


def heading(report: Report) -> str:
    """Say in one line what was replayed."""
    filters = " against ".join([", ".join(report.filters), report.baseline] if report.filters else [report.baseline])
    return f"{report.log.name}: {filters} over {report.log.duration_s:.1f} s"


def verdict_lines(report: Report) -> list[str]:
    """Say of each candidate what it believes, whether that is so, and how far it is to be trusted."""
    return [candidate.verdict for candidate in report.filters.values()]


def closing_lines(report: Report) -> list[str]:
    """Say for each candidate what its mean improvement is, and whose opinion that is."""
    return [
        f"{name}: mean improvement over nine states {percent(means.mean_improvement_pct)} (believed by the filter's "
        "own covariance; see reference error and consistency), "
        f"mean convergence {percent(means.mean_convergence_improvement_pct)} sooner"
        for name, means in report.filters.items()
    ]


def row_label(name: str) -> str:
    """Name a state or quantity in words; other names stand for themselves."""
    return _LABELS.get(name) or _QUANTITIES.get(name, name)


def number(value: float | None) -> str:
    """Write a number with four significant digits, without an exponent where that stays short.

    Parameters
    ----------
    value : float or None

    Returns
    -------
    str
    """
    if value is None:
        return MISSING
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 7:
        return f"{value:.{max(3 - exponent, 0)}f}"
    return f"{value:.2e}"


def decimal(value: float | None, digits: int) -> str:
    """Write a number with a fixed number of digits after the point."""
    return MISSING if value is None else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """Write a percentage with one digit."""
    return MISSING if value is None else f"{value:.1f} %"


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
                    _LABELS[row.state],
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
                    _LABELS[row.state],
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
                    _QUANTITIES.get(row.quantity, row.quantity),
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
        quantities.setdefault(row.status, []).append(_QUANTITIES.get(row.quantity, row.quantity))
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
                    _QUANTITIES.get(row.quantity) or _LABELS[row.quantity].replace("accelerometer", "accel."),
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
