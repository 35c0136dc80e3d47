"""Several dives beside each other, one row for each log and candidate, and what they say together.

A summary and the pooled evidence for scripts, a page for people.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Final
from urllib.parse import quote

from msgspec.structs import astuple

from insdvl_replay.core.quantities import is_whole
from insdvl_replay.core.tables import PooledRow
from insdvl_replay.core.words import Judgement, Severity
from insdvl_replay.evaluation.over_dives import PooledCandidate, pooled_candidate, pooled_sentence
from insdvl_replay.report.csv_tables import rows_csv
from insdvl_replay.report.document import MISSING, Callout, DisplayTable, LinkedTable, Part, Title, number
from insdvl_replay.report.page import page
from insdvl_replay.results.dive_tables import MEANS, TONES, gain_cells, has_reference, pooled_table
from insdvl_replay.results.folder import PAGE
from insdvl_replay.results.json_report import Report

COLUMNS: Final = (
    "log", "filter", "mean_improvement_pct", "mean_convergence_improvement_pct", "position_h_baseline_rmse_m",
    "position_h_rmse_m", "position_h_baseline_rmse_pct", "position_h_rmse_pct", "improvement", "belief", "verdicts",
    "status", "reason",
)  # fmt: skip
_HEADER: Final = (
    "dive", "filter", "judgement", "measured", "believed", "belief", "baseline\nposition [m]",
    "candidate\nposition [m]", "consistency", "warnings", "failed because",
)  # fmt: skip
_ALIGNMENT: Final = "lllrrlrrlrl"
_OF_REFERENCE: Final = ("belief", "baseline\nposition [m]", "candidate\nposition [m]")
"""Columns of which dives without a reference have nothing to say."""


@dataclass(frozen=True)
class Failure:
    """A log that could not be replayed, and why, in one sentence."""

    log: str
    reason: str


def summary_csv(outcomes: Sequence[Report | Failure]) -> bytes:
    """Lay several dives beside each other.

    Parameters
    ----------
    outcomes : sequence of Report or Failure
        In the order in which the logs were given.

    Returns
    -------
    bytes
        CSV; status is ``done`` or ``failed``, and a failed log has a reason instead of numbers. A candidate that is
        ``not judged`` has no gain.
    """
    return rows_csv(COLUMNS, (row for outcome in outcomes for row in _summary_rows(outcome))).encode()


def evidence_csv(outcomes: Sequence[Report | Failure]) -> bytes:
    """Pool the evidence of several dives, as CSV."""
    rows = (astuple(row) for pooled in pooled_candidates(outcomes) for row in pooled.rows)
    return rows_csv(PooledRow.__struct_fields__, rows).encode()


def is_evidence(data: bytes) -> bool:
    """Return whether a file is pooled evidence."""
    return data.startswith(rows_csv(PooledRow.__struct_fields__, ()).encode())


def pooled_candidates(outcomes: Sequence[Report | Failure]) -> list[PooledCandidate]:
    """Pool the evidence on each candidate of a name, where two dives at least have it."""
    reports = [outcome for outcome in outcomes if isinstance(outcome, Report)]
    names = dict.fromkeys(name for report in reports for name in report.filters)
    found = [_pooled(name, [report for report in reports if name in report.filters]) for name in names]
    return [pooled for pooled in found if pooled.dives > 1]


def _pooled(name: str, reports: Sequence[Report]) -> PooledCandidate:
    judged = [report for report in reports if report.filters[name].improvement != Judgement.NOT_JUDGED]
    rows = [[row for row in report.tables.evidence if row.filter == name] for report in judged]
    baselines = {report.baseline for report in reports}
    return pooled_candidate(name, " or ".join(sorted(baselines)), rows, len(reports))


def is_summary(data: bytes) -> bool:
    """Return whether a file is a summary."""
    return data.startswith(rows_csv(COLUMNS, ()).encode())


def _summary_rows(outcome: Report | Failure) -> Iterator[tuple[object, ...]]:
    if isinstance(outcome, Failure):
        yield (outcome.log, *[None] * (len(COLUMNS) - 3), "failed", outcome.reason)
        return
    for name, means in outcome.filters.items():
        judged = means.improvement != Judgement.NOT_JUDGED
        yield (
            outcome.log.name,
            name,
            means.mean_improvement_pct if judged else None,
            means.mean_convergence_improvement_pct if judged else None,
            *position_rmse(outcome, name, "position_h"),
            *position_rmse(outcome, name, "position_h_pct"),
            means.improvement,
            means.belief,
            _verdicts(outcome, name),
            "done",
            None,
        )


def position_rmse(report: Report, name: str, quantity: str) -> tuple[float | None, float | None]:
    """Return the baseline's and a candidate's rms position error."""
    for row in report.tables.reference_error:
        if (row.filter, row.quantity) == (name, quantity):
            return row.baseline_rmse, row.rmse
    return None, None


def _verdicts(report: Report, name: str) -> str:
    """Name the verdicts of the whole measurements, and that of the errors."""
    measurements = (row for row in report.tables.consistency if row.filter == name and is_whole(row.measurement))
    errors = (f"errors {word}" for word in [report.filters[name].credibility] if word)
    return "; ".join([*(f"{row.measurement} {row.verdict}" for row in measurements), *errors])


def overview_parts(outcomes: Sequence[Report | Failure]) -> list[Part]:
    """Lay several dives beside each other: what all say together, a row for each dive and candidate, pooled rows."""
    table, _ = _dives_table(outcomes)
    pooled = [pooled_table(one) for one in pooled_candidates(outcomes)]
    return [Title(_counted(outcomes)), *_opening(outcomes), table, *pooled]


def _counted(outcomes: Sequence[Report | Failure]) -> str:
    failed = sum(isinstance(outcome, Failure) for outcome in outcomes)
    return f"{len(outcomes)} dives" + (f", {failed} of them failed" if failed else "")


def index_page(outcomes: Sequence[Report | Failure]) -> bytes:
    """Write the page of several dives.

    Parameters
    ----------
    outcomes : sequence of Report or Failure
        In the order in which the logs were given.

    Returns
    -------
    bytes
        A table, whose columns a script lets the reader sort.
    """
    table, links = _dives_table(outcomes)
    script = files("insdvl_replay.report").joinpath("sorting.js").read_text("utf-8")
    pooled = [pooled_table(one) for one in pooled_candidates(outcomes)]
    return page([Title(_counted(outcomes)), *_opening(outcomes), LinkedTable(table, links), *pooled], script)


def _dives_table(outcomes: Sequence[Report | Failure]) -> tuple[DisplayTable, tuple[str, ...]]:
    """Return the table of the dives, and where each row leads."""
    rows = [row for outcome in outcomes for row in _index_rows(outcome)]
    failed = sum(isinstance(outcome, Failure) for outcome in outcomes)
    known = any(isinstance(outcome, Report) and has_reference(outcome) for outcome in outcomes)
    left_out = {*(() if known else _OF_REFERENCE), *(() if failed else _HEADER[-1:])}
    shown = [place for place, name in enumerate(_HEADER) if name not in left_out]
    table = DisplayTable(
        "Each candidate against its baseline",
        tuple(_HEADER[place] for place in shown),
        "".join(_ALIGNMENT[place] for place in shown),
        tuple(tuple(cells[place] for place in shown) for cells, _ in rows),
        f"{MEANS}; position: rms of the horizontal error" if known else MEANS,
    )
    return table, tuple(link for _, link in rows)


def _opening(outcomes: Sequence[Report | Failure]) -> Iterator[Callout]:
    """State how many candidates are better, worse, or neither."""
    reports = [outcome for outcome in outcomes if isinstance(outcome, Report)]
    counts: dict[str, Counter[str]] = {}
    for report in reports:
        for name, candidate in report.filters.items():
            counts.setdefault(name, Counter())[candidate.improvement] += 1
    for pooled in pooled_candidates(outcomes):
        yield Callout(pooled_sentence(pooled), TONES.get(pooled.judgement, ""))
    if counts:
        found = (
            f"{name}: {', '.join(f'{count} {word}' for word, count in words.most_common())}"
            for name, words in counts.items()
        )
        yield Callout(f"Dive by dive, against the baseline: {'; '.join(found)}.")


def _index_rows(outcome: Report | Failure) -> Iterator[tuple[tuple[str, ...], str]]:
    """Return the cells of each row, and where it leads."""
    if isinstance(outcome, Failure):
        yield (outcome.log, *[MISSING] * 9, outcome.reason), ""
        return
    warnings = sum(note.severity == Severity.WARNING for note in outcome.notes)
    for name, candidate in outcome.filters.items():
        position_m = position_rmse(outcome, name, "position_h")
        cells = (
            outcome.log.name,
            name,
            *gain_cells(outcome, name),
            *map(number, position_m),
            candidate.consistency,
            str(warnings),
            "",
        )
        yield cells, f"{quote(outcome.log.name)}/{PAGE}"
