"""The replays of jobs, each into its folder: here, or by as many workers as there are."""

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import replace as changed

from insdvl_replay.batch.fitted_noise import with_own_noise
from insdvl_replay.batch.jobs import Outcome, ReplayJob, known_report, log_digest
from insdvl_replay.batch.workers import Pool, WorkerLostError, do_each
from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import SCHEMA_LINE
from insdvl_replay.core.errors import ConfigError, LogError, UserError, listed
from insdvl_replay.core.notes import note
from insdvl_replay.core.report import Report, decode_report
from insdvl_replay.core.report import as_json as encode_report
from insdvl_replay.core.runtime import parallel_map, sources_digest, track_progress
from insdvl_replay.core.version import __version__
from insdvl_replay.results.folder import COMPLETE, VEHICLE_FILE, read_file, result_folder

if TYPE_CHECKING:
    from insdvl_replay.core.dive_columns import Dive
    from insdvl_replay.preparation.replay import Replay

SETTINGS_NOTE = "local_settings"


def replay_jobs(
    jobs: Sequence[ReplayJob],
    known: dict[Path, Report],
    pool: Pool | None,
    *,
    work: Callable[[ReplayJob], bytes] | None = None,
    elsewhere: bool = False,
) -> Generator[Outcome, None, None]:
    """Replay dives, each into its folder, or by another work. One that fails does not stop the others.

    Those that `known_reports` has found need no replay; they are taken out on the way. Outcomes are in the order of
    the jobs. Workers elsewhere may be in other folders, on other machines.
    """
    todo = [job for job in jobs if job.target not in known and job.error is None]
    done = {job.target: Outcome(job, job.error) for job in jobs if job.error is not None}
    steps = track_progress("dive", todo)
    next(steps, None)
    sent = list(parallel_map(_for_elsewhere, todo)) if elsewhere else todo
    with closing(do_each(work or replay_into, sent, pool)) as replays:
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


def _for_elsewhere(job: ReplayJob) -> ReplayJob:
    """Report which files are meant to a worker that may be in another folder or on another machine."""
    try:
        digest = log_digest(job)
    except (OSError, LogError):  # its replay reports it
        digest = ""
    logs = tuple(log.absolute() for log in job.logs)
    return replace(
        job,
        logs=logs,
        name=job.name.absolute(),
        target=job.target.absolute(),
        sha256=digest,
    )


def _with_assay(job: ReplayJob, replay: "Replay") -> "Replay":
    """Add what the baseline with planted faults does on this dive."""
    from insdvl_replay.batch.assay import assay_of
    from insdvl_replay.preparation.prepared import read_checked_dive

    allow_damaged = job.options.allow_damaged
    dive = read_checked_dive(
        job.logs, job.config, allow_damaged=allow_damaged, name=job.target.name
    )
    rows = assay_of(dive, job.config)
    tables = msgspec.structs.replace(replay.tables, assay=rows)
    return replace(replay, tables=tables)


def replayed(job: ReplayJob, name: str | None) -> "Replay":
    """Replay one dive as its job asks for; without a name it has that of its log."""
    # Heavy, and often no dive is replayed.
    from insdvl_replay.preparation.replay import Replay, replay_log

    options = job.options
    kept = partial(_kept_dive, job)
    run: Callable[..., Replay] = partial(replay_log, kept=kept)
    if options.control:
        from insdvl_replay.batch.noise_tuning import replay_with_tuned_baseline

        run = replay_with_tuned_baseline
    elif options.require_fit:
        run = partial(replay_log, kept=kept, require_fit=True)
    replay = run(job.logs, job.config, allow_damaged=options.allow_damaged, name=name)
    if options.assay:
        replay = _with_assay(job, replay)
    notes = options.found
    if job.local_settings:
        notes = (note(SETTINGS_NOTE, file=job.local_settings), *notes)
    if notes:
        replay = replace(replay, notes=(*notes, *replay.notes))
    return replay


def _kept_dive(job: ReplayJob) -> "Dive | None":
    """Return the dive that was read to find its noise; none if it is gone, or its log is another one by now."""
    if job.kept is None:
        return None
    try:
        digest = log_digest(job)
    except (OSError, UserError):  # which reading it again reports
        digest = ""
    return job.kept.taken(digest)


def _require_same_log(job: ReplayJob, replay: "Replay") -> None:
    """Refuse a log that is not the one which was meant, or by which the settings were found."""
    if job.sha256 is None and not job.found_sha256:
        return
    sha256 = replay.dive.sha256
    if job.sha256 is not None and sha256 != job.sha256:
        raise LogError(
            f"{job.name}: the worker has another file there: its SHA-256 is {sha256}, where the replay "
            f"was asked for it is {job.sha256 or 'not to be had'}",
            "--scheduler needs workers that see the same files under the same paths",
        )
    if job.found_sha256 and sha256 != job.found_sha256:
        raise LogError(
            f"{job.name}: the log has changed since its settings were found",
            "run it again once nobody writes to the log",
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
        job = with_own_noise(job)
        options = job.options
    if not job.replaces and isinstance(known_report(job), Report):
        return (job.target / COMPLETE).read_bytes()
    from insdvl_replay.show.result_files import save_histories, save_replay  # heavy

    started_at = datetime.now(UTC).isoformat(timespec="seconds")
    start_s = time.perf_counter()
    replay = replayed(job, job.target.name)
    _require_same_log(job, replay)
    with result_folder(job.target, force=job.replaces) as folder:
        save_replay(replay, folder, histories=options.histories)
        vehicle = b""
        if options.vehicle:
            vehicle = f"{SCHEMA_LINE}{options.vehicle}".encode()
        elif _has_settings(job.target / VEHICLE_FILE, options.config):
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
