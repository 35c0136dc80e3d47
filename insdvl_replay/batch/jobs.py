"""Many dives, each a job: where its result goes, and its replay on as many workers as there are.

What is heavy to import waits until a dive is replayed: often none is.
"""

import hashlib
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from insdvl_replay import __version__
from insdvl_replay.batch.workers import WorkerLostError, Workers, do_each
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_record import unique_names
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.core.runtime import parallel_map, sources_digest
from insdvl_replay.results.folder import COMPLETE, result_digest, result_folder
from insdvl_replay.results.json_report import Report, decode_report, encode_report


@dataclass(frozen=True)
class ReplayOptions:
    """What is done to every dive."""

    config: Config
    allow_damaged: bool = False  # use what can be read of a damaged log
    control: bool = False  # add the baseline with its noise fitted
    trajectories: bool = False  # write TUM files, too
    histories: bool = True  # write replay.mcap
    history_format: str = ""  # of each filter's history beside it; empty for none
    version: str = __version__  # of the tool, which workers elsewhere must have, too
    sources: str = field(default_factory=sources_digest)  # likewise


@dataclass(frozen=True)
class ReplayJob:
    """One dive to be replayed."""

    logs: tuple[Path, ...]  # a log or a bag, or several of them that are one dive
    name: Path  # the one of them after which the dive is named
    target: Path  # its result folder, which bears the dive's name
    options: ReplayOptions
    sha256: str | None = None  # of the logs, where a worker may see other files; empty if they cannot be read here
    before: str | None = None  # `result_digest` of the target as the replay is asked for; another run's result stays


@dataclass(frozen=True)
class Outcome:
    """What became of one dive."""

    job: ReplayJob
    result: Report | Exception
    unchanged: bool = False  # the result lay there already


def plan_jobs(logs: Sequence[Path], output: Path, options: ReplayOptions, *, one_dive: bool = False) -> list[ReplayJob]:
    """Name each dive's result folder, below the output; a ConfigError says that two dives would share a name."""
    dives = [tuple(logs)] if one_dive else [(log,) for log in logs]
    givers = [_name_giver(dive) for dive in dives]
    names = unique_names(givers)
    return [
        ReplayJob(dive, giver, output / name, options, before=result_digest(output / name))
        for dive, giver, name in zip(dives, givers, names, strict=True)
    ]


def _name_giver(logs: tuple[Path, ...]) -> Path:
    if len(logs) == 1:
        return logs[0]
    from insdvl_replay.logs import name_giver

    return name_giver(logs)


def replay_jobs(
    jobs: Sequence[ReplayJob], known: dict[Path, Report], workers: Workers, after_dive: Callable[[Outcome], None]
) -> Generator[Outcome, None, None]:
    """Replay dives, each into its folder. One that fails does not stop the others.

    Those that `known_reports` has found need no replay; they are taken out on the way. ``after_dive`` is called as soon
    as a dive is done; outcomes come in the order of the jobs.
    """
    todo = [job for job in jobs if job.target not in known]
    done: dict[Path, Outcome] = {}
    sent = list(parallel_map(_for_elsewhere, todo)) if workers.are_elsewhere else todo
    with closing(do_each(replay_into, sent, workers)) as replays:
        for job in jobs:
            if job.target in known:
                yield Outcome(job, known.pop(job.target), unchanged=True)
                continue
            while job.target not in done:
                place, result = next(replays)
                outcome = Outcome(todo[place], _result_of(todo[place], result))
                after_dive(outcome)
                done[outcome.job.target] = outcome
            yield done.pop(job.target)


def _for_elsewhere(job: ReplayJob) -> ReplayJob:
    """Report which files are meant to a worker that may stand in another folder or on another machine."""
    try:
        digest = log_digest(job)
    except (OSError, LogError):  # its replay reports it
        digest = ""
    logs = tuple(log.absolute() for log in job.logs)
    return replace(job, logs=logs, name=job.name.absolute(), target=job.target.absolute(), sha256=digest)


def _result_of(job: ReplayJob, result: bytes | Exception) -> Report | Exception:
    if isinstance(result, WorkerLostError):  # workers do not know of logs
        return LogError(f"{job.name}: {result.message}", result.hint)
    return decode_report(result) if isinstance(result, bytes) else result


def replay_into(job: ReplayJob) -> bytes:
    """Replay one log into its folder."""
    wanted, here = f"{job.options.version} ({job.options.sources})", f"{__version__} ({sources_digest()})"
    if wanted != here:
        raise ConfigError(
            f"{job.name}: asked for by insdvl-replay {wanted}, but the worker has {here}",
            "install the same version on all workers",
        )
    from insdvl_replay.batch.noise_tuning import replay_with_tuned_baseline
    from insdvl_replay.replay import replay_log
    from insdvl_replay.results.result_files import save_histories, save_replay, save_trajectories

    started_at, start_s = datetime.now(UTC).isoformat(timespec="seconds"), time.perf_counter()
    run = replay_with_tuned_baseline if job.options.control else replay_log
    replay = run(job.logs, job.options.config, allow_damaged=job.options.allow_damaged, name=job.target.name)
    if job.sha256 is not None and replay.dive.sha256 != job.sha256:
        raise LogError(
            f"{job.name}: the worker has another file there: its SHA-256 is {replay.dive.sha256}, where the replay "
            f"was asked for it is {job.sha256 or 'not to be had'}",
            "--scheduler needs workers that see the same files under the same paths",
        )
    with result_folder(job.target, force=True, before=job.before) as folder:
        save_replay(replay, folder, histories=job.options.histories)
        if job.options.trajectories:
            save_trajectories(replay, folder)
        if job.options.history_format:
            save_histories(replay, folder, job.options.history_format)
        report = decode_report((folder / COMPLETE).read_bytes())
        tool = msgspec.structs.replace(
            report.tool, started_at=started_at, elapsed_s=round(time.perf_counter() - start_s, 3)
        )
        (folder / COMPLETE).write_bytes(encode_report(msgspec.structs.replace(report, tool=tool)))
    return (job.target / COMPLETE).read_bytes()


def log_digest(job: ReplayJob) -> str:
    """Digest the logs of a dive as its report does."""
    if job.logs == (job.name,) and not job.name.is_dir():
        with job.name.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    from insdvl_replay.logs.container.recording import open_recording  # which knows the order of the parts

    log = open_recording(job.logs, allow_damaged=job.options.allow_damaged)
    with log.watched():
        return log.sha256()
