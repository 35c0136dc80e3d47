"""Several dives beside each other: one row for each log and candidate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.core.tables import is_whole
from insdvl_replay.core.words import Gain
from insdvl_replay.report.csv_tables import rows_csv
from insdvl_replay.results.json_report import Report

COLUMNS: Final = (
    "log", "filter", "mean_improvement_pct", "mean_convergence_improvement_pct", "position_h_baseline_rmse_m",
    "position_h_rmse_m", "position_h_baseline_rmse_pct", "position_h_rmse_pct", "improvement", "verdicts", "status",
    "reason",
)  # fmt: skip


@dataclass(frozen=True)
class Failure:
    """A log that could not be replayed.

    Attributes
    ----------
    log : str
        Name of the log.
    reason : str
        One sentence.
    """

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


def is_summary(data: bytes) -> bool:
    """Say whether a file is a summary."""
    return data.startswith(rows_csv(COLUMNS, ()).encode())


def _summary_rows(outcome: Report | Failure) -> Iterator[tuple[object, ...]]:
    if isinstance(outcome, Failure):
        yield (outcome.log, *[None] * (len(COLUMNS) - 3), "failed", outcome.reason)
        return
    for name, means in outcome.filters.items():
        judged = means.improvement != Gain.NOT_JUDGED
        yield (
            outcome.log.name,
            name,
            means.mean_improvement_pct if judged else None,
            means.mean_convergence_improvement_pct if judged else None,
            *position_rmse(outcome, name, "position_h"),
            *position_rmse(outcome, name, "position_h_pct"),
            means.improvement,
            _verdicts(outcome, name),
            "done",
            None,
        )


def position_rmse(report: Report, name: str, quantity: str) -> tuple[float | None, float | None]:
    """Give the baseline's and a candidate's rms position error.

    Parameters
    ----------
    report : Report
    name : str
        A candidate.
    quantity : str
        ``position_h`` or ``position_h_pct``.

    Returns
    -------
    tuple of float or None
        Baseline and candidate; None where the dive has no reference.
    """
    for row in report.tables.reference_error:
        if (row.filter, row.quantity) == (name, quantity):
            return row.baseline_rmse, row.rmse
    return None, None


def _verdicts(report: Report, name: str) -> str:
    """Name the verdicts of the whole measurements, and that of the errors."""
    measurements = (row for row in report.tables.consistency if row.filter == name and is_whole(row.measurement))
    errors = (f"errors {word}" for word in [report.filters[name].credibility] if word)
    return "; ".join([*(f"{row.measurement} {row.verdict}" for row in measurements), *errors])
