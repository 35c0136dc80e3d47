"""Many dives, each a job: where its result goes, and whether it is there already.

A result is known by its content: while the log's bytes, the resolved settings, the versions and the tool's own sources
are those that ``report.json`` names, and the files that it lists are whole, the dive is not replayed again. So an
interrupted run goes on where it stopped. With measurements of the user's own every dive is replayed.
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import msgspec

from insdvl_replay.batch.dive_paths import shared_settings
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.core.config import FREE, Config, flattened
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.errors import ConfigError, Note, UserError, listed
from insdvl_replay.core.report import (
    Report,
    StoredReport,
    decode_report,
    package_versions,
)
from insdvl_replay.core.runtime import parallel_map, sources_digest
from insdvl_replay.core.version import __version__
from insdvl_replay.core.words import Severity
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
    given: frozenset[str] = (
        frozenset()
    )  # keys of the settings that a search for others leaves as they are
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
    replaces: bool = (
        False  # a result was there when the replay was asked for; what comes meanwhile stays
    )
    may_replace: bool = (
        False  # this result, which has these settings with a noise that was fitted to other dives
    )
    sha256: str | None = (
        None  # of the logs, where a worker may see other files; empty if they cannot be read here
    )
    error: UserError | None = None  # why the dive cannot be had
    vehicle: str = ""  # that its manifest names

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
    configs: Mapping[Path | None, Config] = MappingProxyType(
        {}
    ),  # by the file of settings of a dive's own
    *,
    one_dive: bool = False,
) -> list[ReplayJob]:
    """Name each dive's result folder, below the output; two dives that would share a name are a ConfigError."""
    logs = [tuple(dive.path for dive in dives)] if one_dive else [(dive.path,) for dive in dives]
    firsts = [first for first, *_ in logs]
    givers = [dive.name_giver for dive in dives]
    files = [dive.settings for dive in dives]
    errors = [dive.error for dive in dives]
    vehicles = [dive.vehicle for dive in dives]
    if one_dive and len(dives) > 1:
        from insdvl_replay.logs import name_giver  # heavy

        firsts = [name_giver(logs[0])]
        givers = [name_giver(givers)]
        files = [shared_settings(dives, "--one-dive")]
        errors = [next((error for error in errors if error), None)]
        vehicles = [next(filter(None, vehicles), "")]
    own: dict[Path | None, ReplayOptions] = {
        file: replace(options, config=config, require_fit=False, blocked_by="")
        for file, config in configs.items()
        if file is not None
    }
    return [
        ReplayJob(
            log, first, output / name, own.get(file, options),
            replaces=os.path.lexists(output / name), error=error, vehicle=vehicle,
        )
        for log, first, name, file, error, vehicle in zip(
            logs, firsts, unique_names(givers), files, errors, vehicles, strict=True
        )
    ]  # fmt: skip


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
    # Where all is replaced anyway, no log needs to be digested.
    found = [None] * len(jobs) if force and rerun else parallel_map(known_report, jobs)
    for job, report in zip(jobs, found, strict=True):
        if isinstance(report, Report):
            # No digest is kept of all that code reads; its version stands for it.
            filters = job.options.config.filters.values()
            if not rerun and not any(
                filter_.code and filter_.version is None for filter_ in filters
            ):
                known[job.target] = report
            continue
        if isinstance(report, Note):
            if not force:
                raise ConfigError(report.text, "keep what was changed, or replace it with --force")
            report_note(report)
        may_replace = force or job.may_replace
        if not may_replace and (reason := _made_otherwise(job)):
            hint = "replace it with --force, or keep it and choose another folder with -o"
            raise ConfigError(f"{job.target}: {reason}", hint)
        require_replaceable_folder(job.target, force=may_replace)
    return known


def known_report(job: ReplayJob) -> Report | Note | None:
    """Return the report if another replay would give the same; a note if only its files are not whole.

    What is large is read last: the log, then the files of the result.
    """
    options = job.options
    try:
        report = decode_report(read_file(job.target / COMPLETE))
        names = (report.baseline, *report.filters)
        wanted = {*map(trajectory_file, names)} if "tum" in options.tracks else set()
        wanted |= {file for format_, file in MAPS.items() if format_ in options.tracks}
        wanted |= {REPLAY_LOG} if options.histories else set()
        wanted |= (
            {history_file(name, options.history_format) for name in names}
            if options.history_format
            else set()
        )
        config = _settings_before_the_fit(report.config, report.notes)
        codes = {note.code for note in report.notes}
        same = (
            (report.tool.version, report.tool.sources) == (options.version, options.sources)
            and report.versions == package_versions()
            and report.log.name == job.target.name
            and (CONTROL_NOTE in codes) == options.control
            and (bool(report.tables.assay) or not options.assay)
            and (DAMAGE_NOTE not in codes or options.allow_damaged)
            and msgspec.json.encode(config) == msgspec.json.encode(job.config)
            and wanted <= set(report.files)
            and log_digest(job) == report.log.sha256
        )
        damaged = damaged_files(job.target) if same else []
    except (
        OSError,
        *NOT_JSON,
        UserError,
    ):  # a log that is no longer whole is reported by its replay
        return None
    if damaged:
        text = f"{job.target}: not as its replay wrote it: {listed(damaged)}"
        return Note(DAMAGED_RESULT, text, len(damaged), Severity.WARNING)
    if same:
        return report
    return None


def _settings_before_the_fit(config: dict[str, Any], notes: Sequence[Note]) -> dict[str, Any]:
    """Return the settings of a result without the tuned baseline, which is known by its note, since it was fitted."""
    if not any(note.code == CONTROL_NOTE for note in notes):
        return config
    return config | {
        "filters": {name: config["filters"][name] for name in [*config["filters"]][:-1]}
    }


def _made_otherwise(job: ReplayJob) -> str:
    """Return what differs from the result in a job's folder; empty if there is none that can be read."""
    from insdvl_replay.changes.cells import changed_settings

    options = job.options
    try:
        stored = msgspec.json.decode(read_file(job.target / COMPLETE), type=StoredReport)
        configs = (
            _settings_before_the_fit(stored.config, stored.notes),
            msgspec.to_builtins(job.config),
        )
        was_fitted = any(note.code == CONTROL_NOTE for note in stored.notes)
        # The keys of a filter that only one side has say nothing more than its name.
        one_sided = tuple(
            f"filters.{name}." for name in {*configs[0]["filters"]} ^ {*configs[1]["filters"]}
        )
        old, new = (
            {"filters": ", ".join(config["filters"]), "--control": is_fitted}
            | {key: value for key, value in flattened(config) if not key.startswith(one_sided)}
            for config, is_fitted in zip(configs, (was_fitted, options.control), strict=True)
        )
        is_other_log = log_digest(job) != stored.log.sha256
    except (OSError, TypeError, KeyError, *NOT_JSON, UserError):
        return ""
    changes = changed_settings(old, new)
    asked = {"version": options.version, "sources": options.sources}
    is_other_version = (
        stored.versions != package_versions() or not asked.items() <= stored.tool.items()
    )
    # What a fit would set says something only where nothing else differs.
    fitted = ("noise.fit", *(key for word in options.config.noise.fit for key in FREE[word]))
    others = {key: text for key, text in changes.items() if not key.startswith(fitted)}
    if others or is_other_log or is_other_version:
        changes = others
    reasons = [
        *(["of another log"] if is_other_log else []),
        *(["by another version"] if is_other_version else []),
        *([f"with other settings: {listed(changes.values(), _MOST_SETTINGS)}"] if changes else []),
    ]
    if reasons:
        return f"holds a result {', '.join(reasons)}"
    return ""


def log_digest(job: ReplayJob) -> str:
    """Digest the logs of a dive as its report does."""
    if job.logs == (job.name,) and not job.name.is_dir():
        with job.name.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    from insdvl_replay.logs.formats.recording import (
        open_recording,
    )  # which knows the order of the parts

    log = open_recording(job.logs, allow_damaged=job.options.allow_damaged)
    with log.watched():
        return log.sha256()
