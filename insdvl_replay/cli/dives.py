"""Replay dives on as many workers as wanted, print each result in the order of the logs, and go on when one fails."""

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
from insdvl_replay.core.words import Severity
from insdvl_replay.report.page import is_page
from insdvl_replay.results.dive_document import dive_document, report_csv
from insdvl_replay.results.folder import require_replaceable_file, result_file
from insdvl_replay.results.json_report import Report, encode_report
from insdvl_replay.results.overviews import (
    Failure,
    evidence_csv,
    index_page,
    is_evidence,
    is_summary,
    pooled_sentences,
    summary_csv,
)

OVERVIEWS: Final = {
    "summary.csv": (summary_csv, is_summary),
    "evidence.csv": (evidence_csv, is_evidence),
    "index.html": (index_page, is_page),
}
"""What lays several dives beside each other, and by the name of its file is known from somebody else's work."""


@dataclass(frozen=True)
class RunOptions:
    """How dives are replayed, and what is printed.

    Attributes
    ----------
    format : Format
        Of what is printed.
    one_dive : bool
        All logs are one dive; else each is one.
    strict : bool
        Warnings make the exit code 3.
    force : bool
        Results made from another log, other settings or another version may be replaced.
    rerun : bool
        Replay also what is unchanged.
    jobs : int
        Dives at the same time.
    cluster : Cluster, optional
        In place of this machine.
    verbosity : int
        1: print all notes, not the warnings alone; 2: also where in the code an error arose.
    """

    format: Format
    one_dive: bool
    strict: bool
    force: bool
    rerun: bool
    jobs: int
    cluster: Cluster | None
    verbosity: int


def replay_dives(names: Sequence[str], output: Path, options: ReplayOptions, run: RunOptions) -> int:
    """Replay dives, one result folder each, and a summary if there are several."""
    dives = plan_jobs(find_dives(names), output, options, one_dive=run.one_dive)
    if len(dives) > 1:
        _require_own_names(dives, output, force=run.force)
    reports: list[Report | Failure] = []
    codes: dict[str, int] = {}
    together = run.format is Format.JSON and len(dives) > 1
    for outcome in outcomes(dives, run.jobs, run.cluster, force=run.force, rerun=run.rerun):
        name = outcome.job.target.name
        if isinstance(outcome.result, Exception):
            reports.append(Failure(name, str(outcome.result)))
            codes[name] = log_failure(outcome.result, run.verbosity)
            continue
        reports.append(outcome.result)
        codes[name] = _report_result(outcome, outcome.result, run, quiet=together)
    if together:
        write_stdout(encode_report([report for report in reports if isinstance(report, Report)]).decode())
    if len(dives) > 1:
        if run.format is Format.TABLE:
            write_stdout("".join(f"{sentence}\n" for sentence in pooled_sentences(reports)))
        _summarise(reports, codes, output)
    return max(codes.values())


def outcomes(
    dives: Sequence[ReplayJob], jobs: int, cluster: Cluster | None, *, force: bool, rerun: bool
) -> Generator[Outcome, None, None]:
    """Replay what has changed, and show the progress on a terminal."""
    known = known_reports(dives, force=force, rerun=rerun, report_note=lambda note: log_notes([note], verbose=True))
    changed = [dive for dive in dives if dive.target not in known]
    workers = local_workers(max(1, min(jobs, len(changed)))) if cluster is None else cluster_workers(cluster)
    if len(changed) == 1:
        with spinner(f"replaying {changed[0].name.name}{compiling()}"):
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


def _report_result(outcome: Outcome, report: Report, run: RunOptions, *, quiet: bool) -> int:
    if not quiet:
        write_stdout(
            in_format(
                run.format,
                document=lambda: dive_document(report),
                json=lambda: encode_report(report),
                csv=lambda: report_csv(report),
            )
        )
    log_notes(report.notes, verbose=run.verbosity > 0)
    log_to_stderr(f"{'unchanged' if outcome.unchanged else 'wrote'} {outcome.job.target}")
    return _fail_on_warnings(report, run.verbosity) if run.strict else 0


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
        require_replaceable_file(path, force=force or (path.is_file() and is_own(path.read_bytes())))


def _summarise(reports: Sequence[Report | Failure], codes: dict[str, int], output: Path) -> None:
    for overview, (write, _) in OVERVIEWS.items():
        with result_file(output / overview, force=True) as file:
            file.write_bytes(write(reports))
        log_to_stderr(f"wrote {output / overview}")
    if failed := [name for name, code in codes.items() if code]:
        reasons = [report.reason for report in reports if isinstance(report, Failure)]
        first = f"; the first: {reasons[0]}" if reasons else ""
        log_to_stderr(f"error: {len(failed)} of {len(codes)} logs failed: {', '.join(failed)}{first}")
