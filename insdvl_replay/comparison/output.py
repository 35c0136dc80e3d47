"""A comparison in every form in which it is printed."""

from dataclasses import astuple, fields, replace

from rich.console import Group, RenderableType
from rich.text import Text

from insdvl_replay.comparison.document import (
    WORDS,
    closing_lines,
    comparison_heading,
    comparison_tables,
    opening_lines,
)
from insdvl_replay.core.changes import Aggregate, Change, Comparison, Difference, DiveComparison
from insdvl_replay.report.csv_tables import rows_csv
from insdvl_replay.report.markup import latex_page, markdown_page
from insdvl_replay.report.page import Lead, Part, page
from insdvl_replay.report.terminal import dressed, spoken
from insdvl_replay.results.json_report import as_json


def comparison_json(comparison: Comparison) -> bytes:
    """Write a comparison as JSON, null for what is missing."""
    return as_json(comparison)


def comparison_csv(comparison: Comparison) -> str:
    """Write differences, dives, aggregates and changes one after the other.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
        Every line begins with the name of its part, the header's too; a blank line stands between the parts.
    """
    parts = {
        "difference": (_header(Difference), map(_difference_row, comparison.differences)),
        "dive": (("log", "old", "new", "matched_by", *WORDS), map(_dive_row, comparison.dives)),
        "aggregate": (_header(Aggregate), map(astuple, comparison.aggregates)),
        "change": (_header(Change), map(astuple, comparison.changes)),
    }
    return "\n".join(
        rows_csv(("part", *header), ((name, *row) for row in rows)) for name, (header, rows) in parts.items()
    )


def _header(kind: type[Difference | Aggregate | Change]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _difference_row(difference: Difference) -> tuple[object, ...]:
    return difference.block, difference.key, difference.old, difference.new, "; ".join(difference.logs)


def _dive_row(dive: DiveComparison) -> tuple[object, ...]:
    counts = [dive.tally.counts[word] if dive.tally else None for word in WORDS]
    return dive.log, dive.old, dive.new, dive.matched_by, *counts


def comparison_markdown(comparison: Comparison) -> str:
    """Dress a comparison in Markdown."""
    return markdown_page(
        comparison_heading(comparison),
        opening_lines(comparison),
        comparison_tables(comparison),
        closing_lines(comparison),
    )


def comparison_latex(comparison: Comparison) -> str:
    """Dress a comparison in LaTeX; needs booktabs."""
    return latex_page(comparison_heading(comparison), opening_lines(comparison), comparison_tables(comparison))


def comparison_html(comparison: Comparison) -> bytes:
    """Dress a comparison as a page of its own."""
    parts: list[Part] = [*map(Lead, opening_lines(comparison)), *comparison_tables(comparison)]
    return page(comparison_heading(comparison), [*parts, *closing_lines(comparison)])


def comparison_terminal(comparison: Comparison) -> Group:
    """Dress a comparison for a terminal, to be printed by a rich console."""
    parts: list[RenderableType] = [
        spoken(comparison_heading(comparison), "bold"),
        *map(spoken, opening_lines(comparison)),
    ]
    for table in comparison_tables(comparison):
        # On a line of its own, so that it is not folded to the width of a narrow table.
        parts += [Text(), spoken(table.title, "bold"), dressed(replace(table, title=""))]
    closing = closing_lines(comparison)
    return Group(*parts, *([Text(), *map(spoken, closing)] if closing else []))
