"""The answer to a change: printed by ``compare`` for two results, and by ``run --against`` for two replays."""

import shlex
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from insdvl_replay.cli.messages import (
    is_finding,
    log_failure,
    log_findings,
    log_notes,
    write_stdout,
)
from insdvl_replay.core.errors import LimitError, Note, visible

if TYPE_CHECKING:
    from insdvl_replay.batch.jobs import Outcome, ReplayJob
    from insdvl_replay.changes.comparison import Comparison


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
    else:
        document = documents.comparison_document(
            shown, values=all_values or format_ == "latex", every_row=verbose > 0, command=command
        )
        write_stdout(written(documents.comparison_result(found, document), format_))
    log_notes(found.notes, verbose=verbose > 0)


def answer_against(
    sides: "Sequence[tuple[Path, Sequence[ReplayJob]]]",  # folder and replays before, and after a change of settings
    replays: "Generator[Outcome, None, None]",  # of both
    fail_on: str | None,
    format_: str,
    verbose: int,
    *,
    quiet: bool,
) -> int:
    """Replay dives with the settings and with changed ones, and print the comparison as `compare` does."""
    from insdvl_replay.changes import comparison as changes
    from insdvl_replay.results.folder import VEHICLE_FILE

    limit = changes.parse_limit(fail_on)
    (old, old_jobs), (new, _) = sides
    failures = dict[str, int]()  # exit code by sentence, as both sides may say the same
    done = list[str]()
    said = set[tuple[Note, ...]]()
    with closing(replays):
        for outcome in replays:
            report = outcome.result
            if not isinstance(report, Exception):
                done.append(report.log.name)
                if outcome.job in old_jobs and not quiet:
                    found_noise = tuple(filter(is_finding, report.notes))
                    if found_noise not in said:
                        said.add(found_noise)
                        log_findings(found_noise, outcome.job.target / VEHICLE_FILE)
                    dive = report.log.name if len(old_jobs) > 1 else ""
                    log_notes(report.notes, verbose=verbose > 0, dive=dive)
            elif str(report) not in failures:
                failures[str(report)] = log_failure(report, verbose)
    if both := [name for name in dict.fromkeys(done) if done.count(name) > 1]:
        found = changes.compare_results(old, new, dives=both)
        command = f"{shlex.join(['insdvl-replay', 'compare', str(old), str(new)])} "
        print_comparison(
            found,
            changes.only_changed(found),
            format_,
            verbose,
            quiet=quiet,
            all_values=False,
            command=command,
        )
        if worse := changes.find_violation(found, limit):
            failures[worse] = log_failure(LimitError(worse), verbose)
    return max(failures.values(), default=0)
