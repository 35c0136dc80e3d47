"""Many dives, each a job: where its result goes, and whether it is there already.

A result is known by its content: while the log's bytes, the resolved settings, the versions and the tool's own sources
are those that ``report.json`` names, and the files that it lists are whole, the dive is not replayed again. So an
interrupted run goes on where it stopped. With measurements of the user's own every dive is replayed.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import msgspec

from insdvl_replay.batch.dive_paths import shared_settings
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.local_settings import place_of_settings
from insdvl_replay.core.config import FREE, Config, flattened
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.errors import ConfigError, Note, UserError, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.report import (
    Report,
    StoredReport,
    decode_report,
    package_versions,
)
from insdvl_replay.core.runtime import parallel_map, sources_digest
from insdvl_replay.core.version import __version__
from insdvl_replay.results.folder import (
    COMPLETE,
    MAPS,
    NOT_JSON,
    REPLAY_LOG,
    damaged_files,
    history_file,
    read_file,
    require_replaceable_folder,
    trajectory_file,
)

if TYPE_CHECKING:
    from insdvl_replay.preparation.prepared import KeptDive

CONTROL_NOTE: Final = "control_fitted"
DAMAGE_NOTE: Final = "log_damaged"
DAMAGED_RESULT: Final = "result_damaged"
_MOST_SETTINGS: Final = 3  # in the error about a result with others


@dataclass(frozen=True)
class ReplayOptions:
    """What is done to every dive."""

    config: Config
    allow_damaged: bool = False  # use what can be read of a damaged log
    control: bool = False  # add the baseline with its noise fitted
    assay: bool = False  # also replay the baseline with planted faults
    tracks: tuple[str, ...] = ()  # formats of tracks that are written, too
    histories: bool = True  # write replay.mcap
    history_format: str = ""  # of each filter's history next to it; empty for none
    require_fit: bool = False  # refuse a dive that shows that the settings are wrong
    blocked_by: str = ""  # the option without which settings that fit would be searched for
    # keys of the settings that a search for others leaves as they are
    given: frozenset[str] = frozenset()
    found: tuple[Note, ...] = ()  # how the settings were found, if nobody made them
    vehicle: str = ""  # these settings as vehicle.toml
    version: str = __version__  # of the tool, which workers elsewhere must have, too
    sources: str = field(default_factory=sources_digest)  # likewise


@dataclass(frozen=True)
class ReplayJob:
    """One dive to be replayed."""

    logs: tuple[Path, ...]  # a log or a bag, or several of them that are one dive
    name: Path  # the one of them after which the dive is named
    target: Path  # its result folder, which bears the dive's name
    options: ReplayOptions
    # a result was there when the replay was asked for; what comes meanwhile stays
    replaces: bool = False
    # this result, which has these settings with a noise that was fitted to other dives
    may_replace: bool = False
    # of the logs, where a worker may see other files; empty if they cannot be read here
    sha256: str | None = None
    found_sha256: str = ""  # of the logs as they were when settings or noise were found by them
    error: UserError | None = None  # why the dive cannot be had
    vehicle: str = ""  # that its manifest names
    local_settings: str = (
        ""  # the file of settings that nobody has named, seen from the folder of the dive
    )
    # the dive, where it was read in this process to find its noise
    kept: "KeptDive | None" = field(default=None, compare=False)

    def forget(self) -> None:
        """Let go of a dive that was read before."""
        if self.kept is not None:
            self.kept.taken("")

    @property
    def config(self) -> Config:
        """The settings of its replay, with the vehicle of its own."""
        return self.options.config.of_vehicle(self.vehicle)


@dataclass(frozen=True)
class Outcome:
    """What became of one dive."""

    job: ReplayJob
    result: Report | Exception
    unchanged: bool = False  # the result was there already


def plan_jobs(
    dives: Sequence[FoundDive],
    output: Path,
    options: ReplayOptions,
    # by the file of settings of a dive's own
    configs: Mapping[Path | None, Config] = MappingProxyType({}),
    *,
    one_dive: bool = False,
) -> list[ReplayJob]:
    """Name each dive's result folder, below the output; two dives that would share a name are a ConfigError."""
    meant = [_alone(dive) for dive in dives]
    if one_dive and len(dives) > 1:
        meant = [_together(dives)]
    own: dict[Path | None, ReplayOptions] = {}
    for file, config in configs.items():
        if file is not None:
            own[file] = replace(options, config=config, require_fit=False, blocked_by="")
    jobs = []
    names = unique_names([one.name_giver for one in meant])
    for one, name in zip(meant, names, strict=True):
        target = output / name
        job = ReplayJob(
            one.logs,
            one.first,
            target,
            own.get(one.settings, options),
            replaces=os.path.lexists(target),
            error=one.error,
            vehicle=one.vehicle,
            local_settings=one.local_settings,
        )
        jobs.append(job)
    return jobs


@dataclass(frozen=True)
class _Meant:
    """The logs of one dive, and what is known of it."""

    logs: tuple[Path, ...]
    first: Path  # the log after which the dive is named
    name_giver: Path  # likewise, of a remote log by its URL
    settings: Path | None
    error: UserError | None
    vehicle: str
    local_settings: str


def _alone(dive: FoundDive) -> _Meant:
    """Return a log that is a dive."""
    return _Meant(
        (dive.path,),
        dive.path,
        dive.name_giver,
        dive.settings,
        dive.error,
        dive.vehicle,
        place_of_settings(dive),
    )


def _together(dives: Sequence[FoundDive]) -> _Meant:
    """Return logs that are one dive; it cannot be had if one of them cannot."""
    from insdvl_replay.logs import name_giver  # heavy

    logs = tuple(dive.path for dive in dives)
    error = None
    vehicle = ""
    for dive in dives:  # the first that has one
        error = error or dive.error
        vehicle = vehicle or dive.vehicle
    return _Meant(
        logs,
        name_giver(logs),
        name_giver([dive.name_giver for dive in dives]),
        shared_settings(dives, "--one-dive"),
        error,
        vehicle,
        place_of_settings(dives[0]),
    )


def known_reports(
    jobs: Sequence[ReplayJob],
    *,
    force: bool,
    rerun: bool = False,
    report_note: Callable[[Note], None] = lambda _: None,
) -> dict[Path, Report]:
    """Return the reports of dives whose result is there and whole, made from the same log, settings and versions.

    With ``force``, results made from anything else may be replaced; with ``rerun``, none is taken for known. A result
    whose files are not as they were written is reported, and replaced. A folder that is in the way, or holds what a
    result did not write, is a ConfigError.
    """
    known = {}
    jobs = [job for job in jobs if job.error is None]
    found: Iterable[Report | Note | None] = parallel_map(known_report, jobs)
    if force and rerun:  # all is replaced anyway, and no log needs to be digested
        found = [None] * len(jobs)
    for job, report in zip(jobs, found, strict=True):
        if not isinstance(report, Report):
            _require_replaceable(job, report, force=force, report_note=report_note)
        elif not rerun and not _runs_unknown_code(job):
            known[job.target] = report
    return known


def _require_replaceable(
    job: ReplayJob,
    damage: Note | None,
    *,
    force: bool,
    report_note: Callable[[Note], None],
) -> None:
    """Raise a ConfigError if the result of a job may not be written, where there is none that could be used."""
    if damage is not None:
        if not force:
            raise ConfigError(damage.text, "keep what was changed, or replace it with --force")
        report_note(damage)
    may_replace = force or job.may_replace
    if not may_replace:
        reason = _made_otherwise(job)
        if reason:
            hint = "replace it with --force, or keep it and choose another folder with -o"
            raise ConfigError(f"{job.target}: {reason}", hint)
    require_replaceable_folder(job.target, force=may_replace)


def _runs_unknown_code(job: ReplayJob) -> bool:
    """Return whether a filter runs code that has no version: no digest is kept of all that code reads."""
    filters = job.options.config.filters.values()
    return any(filter_.code and filter_.version is None for filter_ in filters)


def known_report(job: ReplayJob) -> Report | Note | None:
    """Return the report if another replay would give the same; a note if only its files are not whole.

    What is large is read last: the log, then the files of the result.
    """
    try:
        report = decode_report(read_file(job.target / COMPLETE))
        if not _is_as_asked(report, job) or log_digest(job) != report.log.sha256:
            return None
        damaged = damaged_files(job.target)
    except (OSError, *NOT_JSON, UserError):
        return None  # a log that is no longer whole is reported by its replay
    if damaged:
        return note(
            DAMAGED_RESULT,
            len(damaged),
            files=listed(damaged),
        ).about(job.target)
    return report


def _is_as_asked(report: Report, job: ReplayJob) -> bool:
    """Return whether a result has the version, name, settings and files that a job asks for."""
    options = job.options
    if (report.tool.version, report.tool.sources) != (options.version, options.sources):
        return False
    if report.versions != package_versions() or report.log.name != job.target.name:
        return False
    codes = {note.code for note in report.notes}
    if (CONTROL_NOTE in codes) != options.control:
        return False
    if options.assay and not report.tables.assay:
        return False
    if DAMAGE_NOTE in codes and not options.allow_damaged:
        return False
    config = _settings_before_the_fit(report.config, report.notes)
    if msgspec.json.encode(config) != msgspec.json.encode(job.config):
        return False
    return _files_asked_for(report, options) <= set(report.files)


def _files_asked_for(report: Report, options: ReplayOptions) -> set[str]:
    """Return the files that the options of a replay ask for."""
    names = (report.baseline, *report.filters)
    files = {file for format_, file in MAPS.items() if format_ in options.tracks}
    if "tum" in options.tracks:
        files.update(trajectory_file(name) for name in names)
    if options.histories:
        files.add(REPLAY_LOG)
    if options.history_format:
        files.update(history_file(name, options.history_format) for name in names)
    return files


def _settings_before_the_fit(config: dict[str, Any], notes: Sequence[Note]) -> dict[str, Any]:
    """Return the settings of a result without the tuned baseline, which is known by its note, since it was fitted."""
    if not _is_fitted(notes):
        return config
    planned = [*config["filters"]][:-1]
    return config | {"filters": {name: config["filters"][name] for name in planned}}


def _is_fitted(notes: Sequence[Note]) -> bool:
    """Return whether a replay had the tuned baseline."""
    return any(note.code == CONTROL_NOTE for note in notes)


def _made_otherwise(job: ReplayJob) -> str:
    """Return what differs from the result in a job's folder; empty if there is none that can be read."""
    options = job.options
    try:
        stored = msgspec.json.decode(read_file(job.target / COMPLETE), type=StoredReport)
        changes = _changes_since(stored, job)
        is_other_log = log_digest(job) != stored.log.sha256
    except (OSError, TypeError, KeyError, *NOT_JSON, UserError):
        return ""
    asked = {"version": options.version, "sources": options.sources}
    is_same_tool = asked.items() <= stored.tool.items()
    is_other_version = stored.versions != package_versions() or not is_same_tool
    # What a fit would set says something only where nothing else differs.
    fitted = ["noise.fit"]
    for word in options.config.noise.fit:
        fitted += FREE[word]
    others = {key: text for key, text in changes.items() if not key.startswith(tuple(fitted))}
    if others or is_other_log or is_other_version:
        changes = others
    reasons = []
    if is_other_log:
        reasons.append("of another log")
    if is_other_version:
        reasons.append("by another version")
    if changes:
        reasons.append(f"with other settings: {listed(changes.values(), _MOST_SETTINGS)}")
    if reasons:
        return f"holds a result {', '.join(reasons)}"
    return ""


def _changes_since(stored: StoredReport, job: ReplayJob) -> dict[str, str]:
    """Return the settings that differ from those of a stored result, each as a sentence by its key."""
    from insdvl_replay.changes.cells import changed_settings

    before = _settings_before_the_fit(stored.config, stored.notes)
    now = msgspec.to_builtins(job.config)
    # The keys of a filter that only one side has say nothing more than its name.
    one_sided = tuple(f"filters.{name}." for name in {*before["filters"]} ^ {*now["filters"]})
    was_fitted = _is_fitted(stored.notes)
    return changed_settings(
        _compared_settings(before, one_sided, is_fitted=was_fitted),
        _compared_settings(now, one_sided, is_fitted=job.options.control),
    )


def _compared_settings(
    config: dict[str, Any], left_out: tuple[str, ...], *, is_fitted: bool
) -> dict[str, Any]:
    """Return settings by their dotted keys, the names of the filters, and whether the baseline was tuned."""
    values = {key: value for key, value in flattened(config) if not key.startswith(left_out)}
    return {"filters": ", ".join(config["filters"]), "--control": is_fitted} | values


def log_digest(job: ReplayJob) -> str:
    """Digest the logs of a dive as its report does."""
    if job.logs == (job.name,) and not job.name.is_dir():
        with job.name.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    # which knows the order of the parts
    from insdvl_replay.logs.formats.recording import open_recording

    log = open_recording(job.logs, allow_damaged=job.options.allow_damaged)
    with log.watched():
        return log.sha256()
