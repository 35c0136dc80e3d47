"""Results that are there already: what need not be replayed again.

A result is known by its content: while the log's bytes, the resolved settings, the versions and the tool's own sources
are those that ``report.json`` names, and the files that it lists are whole, the dive is not replayed again. So an
interrupted run goes on where it stopped. With measurements of the user's own every dive is replayed.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from insdvl_replay.batch.jobs import ReplayJob, ReplayOptions, log_digest
from insdvl_replay.core.errors import ConfigError, Note, UserError, listed
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.words import Severity
from insdvl_replay.results.folder import (
    COMPLETE,
    NOT_JSON,
    REPLAY_LOG,
    damaged_files,
    history_file,
    read_file,
    require_replaceable_folder,
    trajectory_file,
)
from insdvl_replay.results.json_report import Report, decode_report, package_versions
from insdvl_replay.results.workspace import clear_leftovers

CONTROL_NOTE: Final = "control_fitted"
DAMAGE_NOTE: Final = "log_damaged"
DAMAGED_RESULT: Final = "result_damaged"


def known_reports(
    jobs: Sequence[ReplayJob], *, force: bool, rerun: bool = False, report_note: Callable[[Note], None] = lambda _: None
) -> dict[Path, Report]:
    """Find the dives whose result is there already and whole, made from the same log, settings and versions.

    With ``force``, results made from anything else may be replaced; with ``rerun``, none is taken for known. A result
    whose files are not as they were written is reported, and replaced. A ConfigError tells that a folder is in the way,
    or holds what a result did not write.
    """
    for folder in {job.target.parent for job in jobs}:
        clear_leftovers(folder)
    known = {}
    # Where all is replaced anyway, no log needs to be digested.
    found = [None] * len(jobs) if force and rerun else parallel_map(_known_report, jobs)
    for job, report in zip(jobs, found, strict=True):
        if isinstance(report, Report):
            if not rerun and not job.options.config.code:  # no digest is kept of all that code reads
                known[job.target] = report
            continue
        if isinstance(report, Note):
            if not force:
                raise ConfigError(report.text, "keep what was changed, or replace it with --force")
            report_note(report)
        require_replaceable_folder(job.target, force=force)
    return known


def _known_report(job: ReplayJob) -> Report | Note | None:
    """Return the result that is there if another replay would give the same; a note if only its files are not whole.

    What is large is read last: the log, then the files of the result.
    """
    try:
        report = decode_report(read_file(job.target / COMPLETE))
        filters = [report.baseline, *report.filters] if job.options.trajectories else []
        wanted = {*map(trajectory_file, filters), *([REPLAY_LOG] if job.options.histories else [])}
        if job.options.history_format:
            wanted |= {history_file(name, job.options.history_format) for name in (report.baseline, *report.filters)}
        same = (
            (report.tool.version, report.tool.sources) == (job.options.version, job.options.sources)
            and report.versions == package_versions()
            and report.log.name == job.target.name
            and _is_of(job.options, report)
            and wanted <= set(report.files)
            and log_digest(job) == report.log.sha256
        )
        damaged = damaged_files(job.target) if same else []
    except (OSError, *NOT_JSON, UserError):  # a log that is no longer whole is reported by its replay
        return None
    if damaged:
        text = f"{job.target}: not as its replay wrote it: {listed(damaged)}"
        return Note(DAMAGED_RESULT, text, len(damaged), Severity.WARNING)
    return report if same else None


def _is_of(options: ReplayOptions, report: Report) -> bool:
    """Compare settings with those of a result. The tuned baseline is known by its note, since it was fitted."""
    codes = {note.code for note in report.notes}
    if (CONTROL_NOTE in codes) != options.control or (DAMAGE_NOTE in codes and not options.allow_damaged):
        return False
    config = report.config
    if options.control:
        *configured, _ = config["filters"]
        config = config | {"filters": {name: config["filters"][name] for name in configured}}
    return msgspec.json.encode(config) == msgspec.json.encode(options.config)
