"""The answer to a change: printed by ``compare`` for two results, and by ``run --against`` for two replays."""

import shlex
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from insdvl_replay.cli.messages import (
    exit_code_of,
    log_failure,
    log_findings,
    log_notes,
    log_to_stderr,
    write_stdout,
)
from insdvl_replay.core.errors import LimitError, Note, visible

if TYPE_CHECKING:
    from insdvl_replay.batch.against import BothSides
    from insdvl_replay.batch.jobs import Outcome, ReplayJob
    from insdvl_replay.changes.comparison import Comparison
    from insdvl_replay.core.report import Report


def print_comparison(
    found: "Comparison",
    shown: "Comparison",  # what the screen and pages have of it
    format_: str,
    verbose: int,
    *,
    quiet: bool,
    all_values: bool,
    command: str = "",  # the one that shows all values, if it is not the one that was typed
) -> None:
    """Print the answer to a change, and the values behind it, in any format."""
    from insdvl_replay.changes import comparison_document as documents
    from insdvl_replay.cli.screen import written

    if quiet and format_ == "table":
        write_stdout(
            "".join(f"{visible(line.text)}\n" for line in documents.answer_lines(found.answers))
        )
        other_logs = documents.other_logs_text(found)
        if other_logs:
            log_to_stderr(f"warning: {other_logs}")
    else:
        document = documents.comparison_document(
            shown, values=all_values or format_ == "latex", every_row=verbose > 0, command=command
        )
        write_stdout(written(documents.comparison_result(found, document), format_))
    log_notes(found.notes, verbose=verbose > 0)


def answer_against(
    sides: "BothSides",
    replays: "Generator[Outcome, None, None]",  # of both
    limit: float | str | None,  # of what may be worse
    format_: str,
    verbose: int,
    *,
    quiet: bool,
) -> int:
    """Print what there is to say of the replays before and after a change, and their comparison as `compare` does."""
    from insdvl_replay.batch.against import compare_sides
    from insdvl_replay.changes.comparison import find_violation, only_changed

    done = list[str]()
    codes = list[int]()
    said = set[str]()  # both sides may say the same, which is printed once
    before = _Before(sides.before.jobs, verbose)
    with closing(replays):
        for outcome in replays:
            report = outcome.result
            if isinstance(report, Exception):
                codes.append(exit_code_of(report))
                if str(report) not in said:
                    said.add(str(report))
                    log_failure(report, verbose)
                continue
            done.append(report.log.name)
            if not quiet:
                before.tell(outcome.job, report)
    found = compare_sides(sides, done)
    if found is None:
        return max(codes, default=0)
    compare = shlex.join(["insdvl-replay", "compare", found.old, found.new])
    print_comparison(
        found,
        only_changed(found),
        format_,
        verbose,
        quiet=quiet,
        all_values=False,
        command=f"{compare} ",
    )
    worse = find_violation(found, limit)
    if worse is not None:
        codes.append(log_failure(LimitError(worse), verbose))
    return max(codes, default=0)


@dataclass
class _Before:
    """What is said of the replays before a change; those after it would say the same."""

    jobs: "Sequence[ReplayJob]"
    verbose: int
    _said: set[tuple[Note, ...]] = field(default_factory=set)  # which noise was found

    def tell(self, job: "ReplayJob", report: "Report") -> None:
        """Report the notes of a dive, if it is one before the change."""
        from insdvl_replay.results.folder import VEHICLE_FILE

        if job not in self.jobs:
            return
        found = tuple(note for note in report.notes if note.is_finding)
        if found not in self._said:
            self._said.add(found)
            log_findings(found, job.target / VEHICLE_FILE)
        dive = ""
        if len(self.jobs) > 1:
            dive = report.log.name
        log_notes(report.notes, verbose=self.verbose > 0, dive=dive)
