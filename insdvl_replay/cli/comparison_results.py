"""Print what moved between two sets of results."""

from insdvl_replay.changes import Comparison
from insdvl_replay.cli.messages import emit
from insdvl_replay.cli.run import Format
from insdvl_replay.cli.screen import printed
from insdvl_replay.report.comparison_output import (
    comparison_csv,
    comparison_json,
    comparison_latex,
    comparison_markdown,
    comparison_terminal,
)

PRINTED = {
    Format.TABLE: lambda comparison: printed(comparison_terminal(comparison)),
    Format.JSON: lambda comparison: comparison_json(comparison).decode(),
    Format.CSV: comparison_csv,
    Format.MARKDOWN: comparison_markdown,
    Format.LATEX: comparison_latex,
}


def print_comparison(comparison: Comparison, format_: Format) -> None:
    """Write a comparison to stdout."""
    emit(PRINTED[format_](comparison))
