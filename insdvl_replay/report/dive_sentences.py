"""What is said of one dive around its tables."""

from insdvl_replay.report.json_report import Report
from insdvl_replay.report.shown import percent


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
