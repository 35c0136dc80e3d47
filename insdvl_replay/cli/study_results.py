"""Print what a study found."""

from insdvl_replay.cli.messages import write_stdout
from insdvl_replay.cli.options import Format
from insdvl_replay.cli.screen import printed
from insdvl_replay.studies.study_report import (
    StudyReport,
    study_csv,
    study_json,
    study_latex,
    study_markdown,
    study_terminal,
)

PRINTED = {
    Format.TABLE: lambda report: printed(study_terminal(report)),
    Format.JSON: lambda report: study_json(report).decode(),
    Format.CSV: study_csv,
    Format.MARKDOWN: study_markdown,
    Format.LATEX: study_latex,
}


def print_study(report: StudyReport, format_: Format) -> None:
    """Write a study to stdout."""
    write_stdout(PRINTED[format_](report))
