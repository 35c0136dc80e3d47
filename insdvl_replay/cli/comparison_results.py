"""Print what moved between two sets of results."""

from collections.abc import Callable
from typing import Final

from insdvl_replay.cli.messages import write_stdout
from insdvl_replay.cli.options import ComparisonFormat
from insdvl_replay.cli.screen import printed
from insdvl_replay.comparison.output import (
    comparison_csv,
    comparison_html,
    comparison_json,
    comparison_latex,
    comparison_markdown,
    comparison_terminal,
)
from insdvl_replay.core.changes import Comparison

PRINTED: Final[dict[ComparisonFormat, Callable[[Comparison], str]]] = {
    ComparisonFormat.TABLE: lambda comparison: printed(comparison_terminal(comparison)),
    ComparisonFormat.JSON: lambda comparison: comparison_json(comparison).decode(),
    ComparisonFormat.CSV: comparison_csv,
    ComparisonFormat.MARKDOWN: comparison_markdown,
    ComparisonFormat.LATEX: comparison_latex,
    ComparisonFormat.HTML: lambda comparison: comparison_html(comparison).decode(),
}


def print_comparison(comparison: Comparison, format_: ComparisonFormat) -> None:
    """Write a comparison to stdout."""
    write_stdout(PRINTED[format_](comparison))
