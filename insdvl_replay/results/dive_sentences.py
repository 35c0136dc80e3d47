"""What is said of one dive around its tables."""

from typing import Final

from insdvl_replay.core.tables import Candidate
from insdvl_replay.core.words import Gain
from insdvl_replay.report.display_table import percent
from insdvl_replay.results.json_report import Report

_IN_SHORT: Final[dict[str, str]] = {
    Gain.NOT_BORNE_OUT: "NOT borne out",
    Gain.WORSE: "WORSE",
    Gain.NONE_BELIEVED: "no improvement",
}
MEANS: Final = (
    "believed: mean over nine states, by the filter's own covariance; actual: median of the errors against the "
    "reference; sooner: mean convergence"
)
"""What stands in the columns of candidates."""


def replayed(report: Report) -> str:
    """Say in one line what was replayed."""
    candidates = f"{', '.join(report.filters)} against " if report.filters else ""
    return f"{report.log.name}: {candidates}{report.baseline} over {report.log.duration_s:.1f} s"


def heading(report: Report) -> str:
    """Say in one line what was replayed, and what has become of each believed improvement."""
    return "; ".join([replayed(report), *(f"{name}: {_in_short(found)}" for name, found in report.filters.items())])


def _in_short(candidate: Candidate) -> str:
    if candidate.improvement == Gain.NOT_JUDGED:
        return "NOT JUDGED"
    word = _IN_SHORT.get(candidate.improvement, candidate.improvement)
    return f"{percent(candidate.mean_improvement_pct)} believed, {word}"


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
        if means.improvement != Gain.NOT_JUDGED
    ]
