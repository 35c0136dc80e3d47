"""The page of several dives: one row for each dive and candidate, which leads to the dive's own page."""

from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Final
from urllib.parse import quote

from insdvl_replay.report.display_table import MISSING, ShownTable, number
from insdvl_replay.report.page import Lead, LinkedTable, page
from insdvl_replay.results.dive_sentences import MEANS
from insdvl_replay.results.dive_tables import gain_cells
from insdvl_replay.results.folder import PAGE
from insdvl_replay.results.json_report import Report
from insdvl_replay.results.summary import Failure, position_rmse

_HEADER: Final = (
    "dive", "filter", "improvement", "believed", "actual", "sooner", "baseline\nposition [m]",
    "candidate\nposition [m]", "consistency", "warnings", "failed because",
)  # fmt: skip
_ALIGNMENT: Final = "lllrrrrrlrl"


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
    rows = [row for outcome in outcomes for row in _rows(outcome)]
    failed = sum(isinstance(outcome, Failure) for outcome in outcomes)
    columns = len(_HEADER) if failed else len(_HEADER) - 1
    table = ShownTable(
        "Each candidate against its baseline",
        _HEADER[:columns],
        _ALIGNMENT[:columns],
        tuple(cells[:columns] for cells, _ in rows),
        f"{MEANS}; position: rms of the horizontal error",
    )
    words = f"{len(outcomes)} dives" + (f", {failed} of them failed" if failed else "")
    script = files("insdvl_replay.report").joinpath("sorting.js").read_text("utf-8")
    return page(words, [*_opening(outcomes), LinkedTable(table, tuple(link for _, link in rows))], script)


def _opening(outcomes: Sequence[Report | Failure]) -> Iterator[Lead]:
    """Say of how many candidates the improvement is borne out."""
    reports = [outcome for outcome in outcomes if isinstance(outcome, Report)]
    counts = Counter(candidate.improvement for report in reports for candidate in report.filters.values())
    if counts:
        found = ", ".join(f"{count} {word}" for word, count in counts.most_common())
        yield Lead(f"Improvements over the baseline: {found}.")


def _rows(outcome: Report | Failure) -> Iterator[tuple[tuple[str, ...], str]]:
    """Give the cells of each row, and where it leads."""
    if isinstance(outcome, Failure):
        yield (outcome.log, *[MISSING] * 9, outcome.reason), ""
        return
    warnings = sum(note.severity == "warning" for note in outcome.notes)
    for name, candidate in outcome.filters.items():
        position_m = position_rmse(outcome, name, "position_h")
        cells = (
            outcome.log.name,
            name,
            *gain_cells(candidate),
            *map(number, position_m),
            candidate.consistency,
            str(warnings),
            "",
        )
        yield cells, f"{quote(outcome.log.name)}/{PAGE}"
