"""Many dives, each a job: where its result goes, whether it is there already, and its replay by as many workers.

A result is known by its content: while the log's bytes, the resolved settings, the versions and the tool's own sources
are those that ``report.json`` names, and the files that it lists are whole, the dive is not replayed again. So an
interrupted run goes on where it stopped. With measurements of the user's own every dive is replayed.
"""

import hashlib
import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import replace as changed

from insdvl_replay.batch.dive_paths import shared_settings
from insdvl_replay.batch.found import FoundDive
from insdvl_replay.batch.workers import Pool, WorkerLostError, do_each
from insdvl_replay.core.config import FREE, Config, flattened
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.errors import ConfigError, LogError, Note, UserError, listed
from insdvl_replay.core.report import (
    Report,
    StoredReport,
    decode_report,
    package_versions,
)
from insdvl_replay.core.report import as_json as encode_report
from insdvl_replay.core.runtime import parallel_map, sources_digest, track_progress
from insdvl_replay.core.version import __version__
from insdvl_replay.core.words import Severity
from insdvl_replay.results.folder import (
    COMPLETE,
    MAPS,
    NOT_JSON,
    REPLAY_LOG,
    VEHICLE_FILE,
    damaged_files,
    history_file,
    read_file,
    require_replaceable_folder,
    result_folder,
    trajectory_file,
)

if TYPE_CHECKING:
    from insdvl_replay.changes.gate_file import Checked, Gates
    from insdvl_replay.preparation.replay import Replay

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


def plan_both_sides(
    dives: Sequence[FoundDive],
    output: Path,
    options: tuple[ReplayOptions, ReplayOptions],
    configs: Sequence[Mapping[Path | None, Config]] = ({}, {}),
    *,
    one_dive: bool = False,
) -> tuple[tuple[Path, list[ReplayJob]], tuple[Path, list[ReplayJob]]]:
    """Plan the replays before and after a change of settings, each side in its folder below the output."""
    old = output / "before"
    new = output / "after"
    return (
        (old, plan_jobs(dives, old, options[0], configs[0], one_dive=one_dive)),
        (new, plan_jobs(dives, new, options[1], configs[1], one_dive=one_dive)),
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
    # Where all is replaced anyway, no log needs to be digested.
    found = [None] * len(jobs) if force and rerun else parallel_map(_known_report, jobs)
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


def _known_report(job: ReplayJob) -> Report | Note | None:
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
    settings = changed_settings(old, new)
    asked = {"version": options.version, "sources": options.sources}
    is_other_version = (
        stored.versions != package_versions() or not asked.items() <= stored.tool.items()
    )
    # What a fit would set says something only where nothing else differs.
    fitted = ("noise.fit", *(key for word in options.config.noise.fit for key in FREE[word]))
    others = [change for change in settings if not change.startswith(fitted)]
    if others or is_other_log or is_other_version:
        settings = others
    reasons = [
        *(["of another log"] if is_other_log else []),
        *(["by another version"] if is_other_version else []),
        *([f"with other settings: {listed(settings, _MOST_SETTINGS)}"] if settings else []),
    ]
    if reasons:
        return f"holds a result {', '.join(reasons)}"
    return ""


def replay_jobs(
    jobs: Sequence[ReplayJob],
    known: dict[Path, Report],
    pool: Pool | None,
    *,
    elsewhere: bool = False,
) -> Generator[Outcome, None, None]:
    """Replay dives, each into its folder. One that fails does not stop the others.

    Those that `known_reports` has found need no replay; they are taken out on the way. Outcomes are in the order of
    the jobs. Workers elsewhere may be in other folders, on other machines.
    """
    todo = [job for job in jobs if job.target not in known and job.error is None]
    done = {job.target: Outcome(job, job.error) for job in jobs if job.error is not None}
    steps = track_progress("dive", todo)
    next(steps, None)
    sent = list(parallel_map(_for_elsewhere, todo)) if elsewhere else todo
    with closing(do_each(replay_into, sent, pool)) as replays:
        for job in jobs:
            if job.target in known:
                yield Outcome(job, known.pop(job.target), unchanged=True)
                continue
            while job.target not in done:
                place, result = next(replays)
                finished = todo[place]
                if isinstance(result, WorkerLostError):  # workers do not know of logs
                    result = _lost(finished, result)
                found = decode_report(result) if isinstance(result, bytes) else result
                done[finished.target] = Outcome(finished, found)
                next(steps, None)
            yield done.pop(job.target)
        for _ in replays:  # nothing more comes, and workers end by themselves
            pass


def _lost(job: ReplayJob, error: WorkerLostError) -> WorkerLostError:
    """Say which dive ended its process, and whose code ran in it: programs and classes of candidates have their own."""
    filters = {
        name: filter_.code for name, filter_ in job.options.config.computed.items() if filter_.code
    }
    if not filters:
        return WorkerLostError(f"{job.name}: {error.message}", error.hint)
    code = listed([f"filters.{name} ({', '.join(words)})" for name, words in filters.items()])
    return WorkerLostError(
        f"{job.name}: its process ended twice; it runs the code of {code}",
        f"this code may crash, or call os._exit; to replay without it: --set filters.{[*filters][-1]}=false",
    )


def checked_dives(
    gates: "Gates",
    dives: Sequence[FoundDive],  # logs and results
    output: Path,  # of the replays
    options: ReplayOptions,
    replay: Callable[[Sequence[ReplayJob]], Generator[Outcome, None, None]],
    configs: Mapping[Path | None, Config] = MappingProxyType({}),
) -> "list[Checked]":
    """Return the dives of a check in their order: results as they are, logs with the result of their replay."""
    from insdvl_replay.changes.gate_file import Checked, require_known_filters
    from insdvl_replay.changes.gates import checked_results

    logs = [
        dive
        for dive in dives
        if dive.path.suffix != ".json" and not (dive.path / COMPLETE).is_file()
    ]
    jobs = plan_jobs(logs, output, options, configs)
    if len(logs) == len(dives):  # stored results may have other filters
        require_known_filters(
            gates, list(dict.fromkeys(name for job in jobs for name in job.options.config.filters))
        )
    checked = list[Checked]()
    with closing(replay(jobs)) as replays:
        for dive in dives:
            folder = dive.path
            if dive in logs:
                outcome = next(replays)
                folder = outcome.job.target
                if isinstance(outcome.result, Exception):
                    checked.append(Checked(outcome.result, folder))
                    continue
            checked += checked_results(folder)
    return checked


def _for_elsewhere(job: ReplayJob) -> ReplayJob:
    """Report which files are meant to a worker that may be in another folder or on another machine."""
    try:
        digest = log_digest(job)
    except (OSError, LogError):  # its replay reports it
        digest = ""
    logs = tuple(log.absolute() for log in job.logs)
    return replace(
        job, logs=logs, name=job.name.absolute(), target=job.target.absolute(), sha256=digest
    )


def _with_assay(job: ReplayJob, replay: "Replay") -> "Replay":
    """Add what the baseline with planted faults does on this dive."""
    from insdvl_replay.batch.assay import assay_of
    from insdvl_replay.preparation.prepared import read_checked_dive

    allow_damaged = job.options.allow_damaged
    dive = read_checked_dive(
        job.logs, job.config, allow_damaged=allow_damaged, name=job.target.name
    )
    return replace(
        replay, tables=msgspec.structs.replace(replay.tables, assay=assay_of(dive, job.config))
    )


def replay_into(job: ReplayJob) -> bytes:
    """Replay one dive into its folder, and return its report.

    A worker may die after it wrote the folder and before its answer arrives. The same result there is the answer.
    """
    options = job.options
    wanted = f"{options.version} ({options.sources})"
    here = f"{__version__} ({sources_digest()})"
    if wanted != here:
        raise ConfigError(
            f"{job.name}: asked for by insdvl-replay {wanted}, but the worker has {here}",
            "install the same version on all workers",
        )
    if options.config.noise.fit:  # of logs that only this worker can read
        from insdvl_replay.batch.fitted_noise import with_own_noise

        job = with_own_noise(job)
        options = job.options
    if not job.replaces and isinstance(_known_report(job), Report):
        return (job.target / COMPLETE).read_bytes()
    # Heavy, and often no dive is replayed.
    from insdvl_replay.preparation.replay import Replay, replay_log
    from insdvl_replay.show.result_files import save_histories, save_replay

    run: Callable[..., Replay] = (
        partial(replay_log, require_fit=True) if options.require_fit else replay_log
    )
    if options.control:
        from insdvl_replay.batch.noise_tuning import replay_with_tuned_baseline

        run = replay_with_tuned_baseline
    started_at = datetime.now(UTC).isoformat(timespec="seconds")
    start_s = time.perf_counter()
    replay = run(job.logs, job.config, allow_damaged=options.allow_damaged, name=job.target.name)
    if options.assay:
        replay = _with_assay(job, replay)
    if options.found:
        replay = replace(replay, notes=(*options.found, *replay.notes))
    if job.sha256 is not None and replay.dive.sha256 != job.sha256:
        raise LogError(
            f"{job.name}: the worker has another file there: its SHA-256 is {replay.dive.sha256}, where the replay "
            f"was asked for it is {job.sha256 or 'not to be had'}",
            "--scheduler needs workers that see the same files under the same paths",
        )
    with result_folder(job.target, force=job.replaces) as folder:
        save_replay(replay, folder, histories=options.histories)
        vehicle = options.vehicle.encode()
        if not vehicle and _has_settings(job.target / VEHICLE_FILE, options.config):
            vehicle = read_file(job.target / VEHICLE_FILE)
        if vehicle:
            (folder / VEHICLE_FILE).write_bytes(vehicle)
        if options.tracks:
            from insdvl_replay.show.tracks import save_tracks

            save_tracks(replay, folder, options.tracks)
        if options.history_format:
            save_histories(replay, folder, options.history_format)
        report = decode_report((folder / COMPLETE).read_bytes())
        elapsed_s = round(time.perf_counter() - start_s, 3)
        cpu_s = {name: round(seconds, 3) for name, seconds in replay.cpu_s.items()}
        tool = msgspec.structs.replace(
            report.tool, started_at=started_at, elapsed_s=elapsed_s, cpu_s=cpu_s
        )
        (folder / COMPLETE).write_bytes(encode_report(msgspec.structs.replace(report, tool=tool)))
    return (job.target / COMPLETE).read_bytes()


def _has_settings(file: Path, config: Config) -> bool:
    """Return whether a file of found settings is that of a replay, where they were given with -c or used again."""
    from insdvl_replay.core.config_file import load_config

    try:
        found = load_config(file=file) if file.is_file() else None
    except UserError:
        return False
    return (
        found is not None
        and changed(found, span=config.span, evaluation=config.evaluation) == config
    )


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
