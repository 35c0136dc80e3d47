"""Replay dives on as many workers as wanted, print each result in the order of the logs, and go on when one fails."""

import os
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from insdvl_replay.batch.cluster import Cluster, cluster_workers
from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions, plan_jobs, replay_jobs
from insdvl_replay.batch.known_results import known_reports
from insdvl_replay.batch.workers import Workers, local_workers
from insdvl_replay.cli.messages import log_failure, log_notes, log_to_stderr, write_stdout
from insdvl_replay.cli.options import Format
from insdvl_replay.cli.screen import DivesBar, compiling, in_format, spinner
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.plain_text import visible
from insdvl_replay.core.words import Severity
from insdvl_replay.report.document import Only, Part
from insdvl_replay.report.page import is_page
from insdvl_replay.results.chosen_tables import csv_of, json_of, require_tables, tables_named
from insdvl_replay.results.dive_document import dive_document, heading
from insdvl_replay.results.dive_screen import dive_screen
from insdvl_replay.results.dives_screen import dives_screen
from insdvl_replay.results.folder import PAGE, require_replaceable_file, result_file
from insdvl_replay.results.json_report import Report, encode_report
from insdvl_replay.results.overviews import (
    Failure,
    evidence_csv,
    index_page,
    is_evidence,
    is_summary,
    overview_parts,
    summary_csv,
)

INDEX: Final = "index.html"
OVERVIEWS: Final = {
    "summary.csv": (summary_csv, is_summary),
    "evidence.csv": (evidence_csv, is_evidence),
    INDEX: (index_page, is_page),
}
"""What lays several dives beside each other, and by the name of its file is known from somebody else's work."""


@dataclass(frozen=True)
class RunOptions:
    """How dives are replayed, and what is printed."""

    format: Format
    tables: tuple[str, ...]  # that are printed, by name; empty for what the format shows
    one_dive: bool  # all logs are one dive; else each is one
    strict: bool  # warnings make the exit code 3
    force: bool  # results made from another log, other settings or another version may be replaced
    rerun: bool  # replay also what is unchanged
    jobs: int  # dives at the same time
    cluster: Cluster | None  # in place of this machine
    verbosity: int  # 1: print all tables and notes; 2: also where in the code an error arose
    quiet: bool  # print a line a dive, and errors

    @property
    def talks(self) -> bool:
        """Whether stderr names each result and warning: not beside a screen, which has them, on the same terminal."""
        return not (self.quiet or (self.shows_screen and sys.stderr.isatty()))

    @property
    def shows_screen(self) -> bool:
        """Whether the answer alone is shown."""
        return self.format is Format.TABLE and not (self.tables or self.verbosity or self.quiet)


def replay_dives(names: Sequence[str], output: Path, options: ReplayOptions, run: RunOptions) -> int:
    """Replay dives, one result folder each, and a summary if there are several."""
    require_tables(run.tables)
    dives = plan_jobs(find_dives(names), output, options, one_dive=run.one_dive)
    if len(dives) > 1:
        _require_own_names(dives, output, force=run.force)
    reports: list[Report | Failure] = []
    codes: dict[str, int] = {}
    unchanged = 0
    for outcome in outcomes(dives, run.jobs, run.cluster, force=run.force, rerun=run.rerun):
        name = outcome.job.target.name
        if isinstance(outcome.result, Exception):
            reports.append(Failure(name, str(outcome.result)))
            codes[name] = log_failure(outcome.result, run.verbosity)
            continue
        reports.append(outcome.result)
        unchanged += outcome.unchanged
        codes[name] = _report_result(outcome, outcome.result, run, alone=len(dives) == 1)
    if len(dives) > 1:
        _summarise(reports, output, quiet=not run.talks)
        if unchanged and not (run.quiet or run.talks):
            log_to_stderr(f"unchanged: {unchanged} of {len(dives)} dives")
        write_stdout(_together(reports, run, str(output / INDEX)))
        _report_failed(reports, codes)
    return max(codes.values())


def _together(reports: Sequence[Report | Failure], run: RunOptions, index: str) -> str:
    """Write what is printed once all of several dives are done."""
    done = [report for report in reports if isinstance(report, Report)]
    if run.format is Format.JSON:
        return (json_of(done, run.tables) if run.tables else encode_report(done)).decode()
    if run.format is Format.CSV:
        return csv_of(done, run.tables)
    if run.quiet:
        return ""
    overview: list[Part] = [] if run.tables else dives_screen(reports, index)
    shown = [Only(("terminal",), tuple(overview))] if run.format is Format.TABLE else overview_parts(reports)
    return in_format(run.format, document=lambda: shown, json=bytes, csv=str)


def outcomes(
    dives: Sequence[ReplayJob], jobs: int, cluster: Cluster | None, *, force: bool, rerun: bool
) -> Generator[Outcome, None, None]:
    """Replay what has changed, and show the progress on a terminal."""
    known = known_reports(dives, force=force, rerun=rerun, report_note=lambda note: log_notes([note], verbose=True))
    changed = [dive for dive in dives if dive.target not in known]
    if cluster is None:
        runs_code = any(dive.options.config.code for dive in changed)
        workers = local_workers(max(1, min(jobs, len(changed))), runs_code=runs_code)
    else:
        workers = cluster_workers(cluster)
    waits_for = compiling() if changed else ""
    if not changed:
        yield from replay_jobs(dives, known, workers, after_dive=lambda _: None)
    elif len(changed) == 1:
        with spinner(f"replaying {changed[0].name.name}{waits_for}"):
            finished = list(replay_jobs(dives, known, workers, after_dive=lambda _: None))
        yield from finished
    else:
        yield from _with_bar(dives, known, workers, len(changed))


def _with_bar(
    dives: Sequence[ReplayJob], known: dict[Path, Report], workers: Workers, changed: int
) -> Iterator[Outcome]:
    with DivesBar(changed) as bar:

        def count(outcome: Outcome) -> None:
            bar.advance(failed=isinstance(outcome.result, Exception))

        with closing(replay_jobs(dives, known, workers, count)) as replays:
            for outcome in replays:
                with bar.paused():
                    yield outcome


def _report_result(outcome: Outcome, report: Report, run: RunOptions, *, alone: bool) -> int:
    """Print what is printed of one dive: of several, their screen and what machines read come once all are done."""
    if run.talks or (alone and not run.quiet):
        log_notes(report.notes, verbose=run.verbosity > 0)
    if outcome.unchanged and alone and not (run.quiet or run.talks):
        log_to_stderr(f"unchanged {outcome.job.target}")
    if run.quiet and run.format is Format.TABLE:
        write_stdout(f"{visible(heading(report))}\n")
    elif alone or not (run.shows_screen or run.format in (Format.JSON, Format.CSV)):
        write_stdout(_printed(outcome, report, run))
    if run.talks:
        log_to_stderr(f"{'unchanged' if outcome.unchanged else 'wrote'} {outcome.job.target}")
    return _fail_on_warnings(report, run.verbosity) if run.strict else 0


def _printed(outcome: Outcome, report: Report, run: RunOptions) -> str:
    page = str(outcome.job.target / PAGE)

    def document() -> Sequence[Part]:
        if run.tables:
            return [table for name in run.tables for table in tables_named(report, name)]
        if run.shows_screen:
            return dive_screen(report, page)
        return dive_document(report)

    return in_format(
        run.format,
        document=document,
        json=lambda: json_of([report], run.tables) if run.tables else encode_report(report),
        csv=lambda: csv_of([report], run.tables),
    )


def _fail_on_warnings(report: Report, verbosity: int) -> int:
    warnings = [note.code for note in report.notes if note.severity == Severity.WARNING]
    if not warnings:
        return 0
    return log_failure(
        LogError(
            f"{report.log.name}: --strict allows no warnings, found {', '.join(warnings)}",
            "the result is written; leave --strict out to accept it",
        ),
        verbosity,
    )


def _require_own_names(dives: Sequence[ReplayJob], output: Path, *, force: bool) -> None:
    """Leave alone what bears an overview's name and is none: overviews are made of the results beside them."""
    for overview, (_, is_own) in OVERVIEWS.items():
        path = output / overview
        for dive in dives:
            if dive.target == path:
                raise ConfigError(
                    f"{dive.name}: its results would bear the name of an overview", "rename it, or replay it alone"
                )
        if os.path.lexists(path):
            if path.is_symlink() or not path.is_file():
                raise ConfigError(f"{path}: is no file of its own, and is not replaced", f"rm {path}")
            require_replaceable_file(path, force=force or is_own(path.read_bytes()))


def _summarise(reports: Sequence[Report | Failure], output: Path, *, quiet: bool) -> None:
    output.mkdir(parents=True, exist_ok=True)
    for overview, (write, _) in OVERVIEWS.items():
        with result_file(output / overview, force=True) as file:
            file.write_bytes(write(reports))
        if not quiet:
            log_to_stderr(f"wrote {output / overview}")


def _report_failed(reports: Sequence[Report | Failure], codes: dict[str, int]) -> None:
    if failed := [name for name, code in codes.items() if code]:
        reasons = [report.reason for report in reports if isinstance(report, Failure)]
        first = f"; the first: {reasons[0]}" if reasons else ""
        log_to_stderr(f"error: {len(failed)} of {len(codes)} logs failed: {', '.join(failed)}{first}")
