"""Many dives: which of them have to be replayed, and their replay on as many workers as there are.

A result is known by its content: while the log's bytes, the resolved settings, the versions and the tool's own sources
are those that ``report.json`` names, and the files that it lists are whole, the dive is not replayed again. So an
interrupted run goes on where it stopped. What is heavy to import waits until a dive is replayed: often none is.
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
from insdvl_replay.batch.executors import WorkerLostError, Workers, do_each
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_names import unique_names
from insdvl_replay.core.errors import ConfigError, LogError, Note, UserError, listed
from insdvl_replay.core.sources import sources_digest
from insdvl_replay.core.threads import each
from insdvl_replay.results.file_list import damaged_files
from insdvl_replay.results.folder import COMPLETE, refuse_existing_folder, result_folder, trajectory_file
from insdvl_replay.results.json_report import Report, decode_report, encode_report, package_versions
from insdvl_replay.results.workspace import clear_leftovers

CONTROL_NOTE = "control_fitted"
DAMAGE_NOTE = "log_damaged"
DAMAGED_RESULT = "result_damaged"


@dataclass(frozen=True)
class Order:
    """What is done to every dive.

    Attributes
    ----------
    config : Config
    allow_damaged : bool
        Use what can be read of a damaged log.
    control : bool
        Add the baseline with its noise fitted.
    trajectories : bool
        Write TUM files, too.
    version, sources : str
        Of the tool, which workers elsewhere must have, too.
    """

    config: Config
    allow_damaged: bool = False
    control: bool = False
    trajectories: bool = False
    version: str = __version__
    sources: str = field(default_factory=sources_digest)


@dataclass(frozen=True)
class Task:
    """One dive to be replayed.

    Attributes
    ----------
    logs : tuple of Path
        An MCAP file or a bag, or several of them that are one dive.
    name : Path
        The one of them after which the dive is named.
    target : Path
        Its result folder, which bears the dive's name.
    order : Order
    sha256 : str or None
        Of the logs, where the one who asks for the replay may see other files than the one who does it; empty if they
        cannot be read there.
    """

    logs: tuple[Path, ...]
    name: Path
    target: Path
    order: Order
    sha256: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one dive.

    Attributes
    ----------
    task : Task
    result : Report or Exception
    unchanged : bool
        The result lay there already.
    """

    task: Task
    result: Report | Exception
    unchanged: bool = False


def plan_tasks(logs: Sequence[Path], output: Path, order: Order, *, one_dive: bool = False) -> list[Task]:
    """Name each dive's result folder.

    Parameters
    ----------
    logs : sequence of Path
    output : Path
        The folder above.
    order : Order
    one_dive : bool
        All logs are one dive; else each is one.

    Returns
    -------
    list of Task
        In the order of the logs.

    Raises
    ------
    ConfigError
        Two dives would share a name.
    """
    dives = [tuple(logs)] if one_dive else [(log,) for log in logs]
    givers = [_name_giver(dive) for dive in dives]
    names = unique_names(givers)
    return [Task(dive, giver, output / name, order) for dive, giver, name in zip(dives, givers, names, strict=True)]


def _name_giver(logs: tuple[Path, ...]) -> Path:
    if len(logs) == 1:
        return logs[0]
    from insdvl_replay.logs import name_giver

    return name_giver(logs)


def known_reports(
    tasks: Sequence[Task], *, force: bool, rerun: bool = False, tell: Callable[[Note], None] = lambda _: None
) -> dict[Path, Report]:
    """Find the dives whose result is there already and whole, made from the same log, settings and versions.

    Parameters
    ----------
    tasks : sequence of Task
    force : bool
        Results made from anything else may be replaced.
    rerun : bool
        Take none for known.
    tell : callable
        Called for each result whose files are not as they were written, which is replaced.

    Returns
    -------
    dict of Path to Report
        By result folder.

    Raises
    ------
    ConfigError
        A folder is in the way, or holds what a result did not write.
    """
    for folder in {task.target.parent for task in tasks}:
        clear_leftovers(folder)
    known = {}
    # Where all is replaced anyway, no log needs to be digested.
    found = [None] * len(tasks) if force and rerun else each(_known_report, tasks)
    for task, report in zip(tasks, found, strict=True):
        if isinstance(report, Report):
            if not rerun:
                known[task.target] = report
            continue
        if isinstance(report, Note):
            if not force:
                raise ConfigError(report.text, "keep what was changed, or replace it with --force")
            tell(report)
        refuse_existing_folder(task.target, force=force)
    return known


def replay_archive(
    tasks: Sequence[Task], known: dict[Path, Report], workers: Workers, after_dive: Callable[[Outcome], None]
) -> Generator[Outcome, None, None]:
    """Replay dives, each into its folder. One that fails does not stop the others.

    Parameters
    ----------
    tasks : sequence of Task
    known : dict of Path to Report
        Those that need no replay, from `known_reports`. It is emptied on the way.
    workers : Workers
    after_dive : callable
        Called as soon as a dive is done, in any order.

    Yields
    ------
    Outcome
        In the order of the tasks.
    """
    todo = [task for task in tasks if task.target not in known]
    done: dict[Path, Outcome] = {}
    sent = list(each(_for_elsewhere, todo)) if workers.are_elsewhere else todo
    with closing(do_each(replay_into, sent, workers)) as replays:
        for task in tasks:
            if task.target in known:
                yield Outcome(task, known.pop(task.target), unchanged=True)
                continue
            while task.target not in done:
                place, result = next(replays)
                outcome = Outcome(todo[place], _result_of(todo[place], result))
                after_dive(outcome)
                done[outcome.task.target] = outcome
            yield done.pop(task.target)


def _for_elsewhere(task: Task) -> Task:
    """Say which files are meant to a worker that may stand in another folder or on another machine."""
    try:
        digest = log_digest(task)
    except (OSError, LogError):  # the replay tells it
        digest = ""
    logs = tuple(log.absolute() for log in task.logs)
    return replace(task, logs=logs, name=task.name.absolute(), target=task.target.absolute(), sha256=digest)


def _result_of(task: Task, result: bytes | Exception) -> Report | Exception:
    if isinstance(result, WorkerLostError):  # workers do not know of logs
        clear_leftovers(task.target.parent)
        return LogError(f"{task.name}: {result.message}", result.hint)
    return decode_report(result) if isinstance(result, bytes) else result


def replay_into(task: Task) -> bytes:
    """Replay one log into its folder.

    Parameters
    ----------
    task : Task

    Returns
    -------
    bytes
        The report as it was written, with the time of day, which is added here, and the list of files: what the room
        writes depends on the log alone.

    Raises
    ------
    LogError, ConfigError
        As of `replay.replay_log`; or this worker has another version of the tool, or another file.
    """
    wanted, here = f"{task.order.version} ({task.order.sources})", f"{__version__} ({sources_digest()})"
    if wanted != here:
        raise ConfigError(
            f"{task.name}: asked for by insdvl-replay {wanted}, but the worker has {here}",
            "install the same version on all workers",
        )
    from insdvl_replay.batch.noise_tuning import replay_with_control
    from insdvl_replay.replay import replay_log
    from insdvl_replay.results.result_files import save_replay
    from insdvl_replay.results.trajectories import save_trajectories

    started_at, start_s = datetime.now(UTC).isoformat(timespec="seconds"), time.perf_counter()
    run = replay_with_control if task.order.control else replay_log
    replay = run(task.logs, task.order.config, allow_damaged=task.order.allow_damaged, name=task.target.name)
    if task.sha256 is not None and replay.dive.sha256 != task.sha256:
        raise LogError(
            f"{task.name}: the worker has another file there: its SHA-256 is {replay.dive.sha256}, where the replay "
            f"was asked for it is {task.sha256 or 'not to be had'}",
            "--scheduler needs workers that see the same files under the same paths",
        )
    with result_folder(task.target, force=True) as folder:
        save_replay(replay, folder)
        if task.order.trajectories:
            save_trajectories(replay, folder)
        report = decode_report((folder / COMPLETE).read_bytes())
        tool = msgspec.structs.replace(
            report.tool, started_at=started_at, elapsed_s=round(time.perf_counter() - start_s, 3)
        )
        (folder / COMPLETE).write_bytes(encode_report(msgspec.structs.replace(report, tool=tool)))
    return (task.target / COMPLETE).read_bytes()


def _known_report(task: Task) -> Report | Note | None:
    """Give the result that is there if another replay would give the same; a note if only its files are not whole.

    What is large is read last: the log, then the files of the result.
    """
    try:
        report = decode_report((task.target / COMPLETE).read_bytes())
        filters = [report.baseline, *report.filters] if task.order.trajectories else []
        same = (
            (report.tool.version, report.tool.sources) == (task.order.version, task.order.sources)
            and report.versions == package_versions()
            and report.log.name == task.target.name
            and _is_of(task.order, report)
            and set(map(trajectory_file, filters)) <= set(report.files)
            and log_digest(task) == report.log.sha256
        )
        damaged = damaged_files(task.target) if same else []
    except (OSError, msgspec.DecodeError, UserError):  # a log that is no longer whole is told by its replay
        return None
    if damaged:
        text = f"{task.target}: not as its replay wrote it: {listed(damaged)}"
        return Note(DAMAGED_RESULT, text, len(damaged), "warning")
    return report if same else None


def _is_of(order: Order, report: Report) -> bool:
    """Say whether a result was made with these settings. The control is known by its note, since it was fitted."""
    codes = {note.code for note in report.notes}
    if (CONTROL_NOTE in codes) != order.control or (DAMAGE_NOTE in codes and not order.allow_damaged):
        return False
    config = report.config
    if order.control:
        *configured, _ = config["filters"]
        config = config | {"filters": {name: config["filters"][name] for name in configured}}
    return msgspec.json.encode(config) == msgspec.json.encode(order.config)


def log_digest(task: Task) -> str:
    """Digest the logs of a dive as its report does.

    Parameters
    ----------
    task : Task

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.

    Raises
    ------
    OSError, LogError
        A log cannot be read.
    """
    if task.logs == (task.name,) and not task.name.is_dir():
        with task.name.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    from insdvl_replay.logs.container.recording import open_recording  # which knows the order of the parts

    log = open_recording(task.logs, allow_damaged=task.order.allow_damaged)
    with log.watched():
        return log.sha256()
