"""A check of dives against gates: which dives, with which settings, their results, and what the gates say of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from insdvl_replay.batch.dive_paths import find_dives
from insdvl_replay.batch.found import Fetch, FoundDive
from insdvl_replay.batch.jobs import Outcome, ReplayJob, ReplayOptions, plan_jobs
from insdvl_replay.batch.local_settings import with_local_settings
from insdvl_replay.batch.replaying import Replaying, unheard
from insdvl_replay.batch.search import outcomes_of_shard
from insdvl_replay.batch.shards import ALL_DIVES, Shard, plan_share, with_noise_of_all
from insdvl_replay.changes.expected import require_expected, write_expected
from insdvl_replay.changes.findings import Checked, CheckResult, Finding
from insdvl_replay.changes.formats import badge_json
from insdvl_replay.changes.gate_file import Gates, require_known_filters
from insdvl_replay.changes.gates import checked_results, compare_with_expected, evaluate_gates
from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import ConfigError, error_context
from insdvl_replay.core.settings_layers import SettingsLayers
from insdvl_replay.results.folder import COMPLETE, require_replaceable_file, result_file

_ANOTHER_NAME: Final = "give it another name"
Changed = tuple[str, Finding]
"""The name of a dive, and a cell of it with the value that was expected before."""


@dataclass(frozen=True)
class Check:
    """The dives of a check, and how its logs are replayed."""

    gates: Gates
    dives: Sequence[FoundDive]  # logs and results
    shard: Shard  # whose dives are checked
    options: ReplayOptions
    configs: Mapping[Path | None, Config]  # of dives with a file of settings of their own, by it
    settings: Sequence[Path] = ()  # files of settings that are read

    def require_outputs(self, files: Mapping[str, Path | None]) -> None:
        """Raise a ConfigError if a file cannot be written, is read, is in a result that is read, or is named twice.

        Files that are written are given by the option that names them.
        """
        read = {self.gates.path.resolve(), *(file.resolve() for file in self.settings)}
        folders = set[Path]()
        for dive in self.dives:
            path = dive.path.resolve()
            read.add(path)
            if path.suffix == ".json":
                folders.add(path.parent)
            elif _is_result(dive):
                folders.add(path)
        written = dict[Path, str]()
        for option, file in files.items():
            if file is None:
                continue
            with error_context(option):
                require_replaceable_file(file, force=True)
                target = file.resolve()
                if target in read or target.parent in folders:
                    raise ConfigError(f"{file}: is an input of this check", _ANOTHER_NAME)
                other = written.setdefault(target, option)
                # A device takes several.
                if other != option and (file.is_file() or not file.exists()):
                    raise ConfigError(f"{file}: is also that of {other}", _ANOTHER_NAME)


@dataclass(frozen=True)
class Listener:
    """Who is told of a check while it goes on; by default nobody."""

    # of all dives, before gates are evaluated
    results: Callable[[Sequence[Checked]], None] = unheard
    # of expected values, before they are stored
    changes: Callable[[Sequence[Changed]], None] = unheard
    stored: Callable[[Path], None] = unheard  # a file of expected values


def plan_check(
    gates: Gates,
    names: Sequence[str],  # paths and patterns of dives, from the working directory
    layers: SettingsLayers,
    *,
    local_settings: bool = True,  # those next to the dives, where the layers name no file
    shard: Shard = ALL_DIVES,
    allow_damaged: bool = False,
    histories: bool = False,
    report: Callable[[str], None] = unheard,  # is told of filters that a file replaces
) -> Check:
    """Find the dives of a check, and load their settings.

    Without names, the dives are those that the gate file names, from its own folder.

    Raises
    ------
    ConfigError
        Neither the names nor the gate file name a dive, a name fits no dive, or settings are not valid.
    """
    content = gates.content
    folder = Path()
    if not names:
        names = content.dives
        folder = gates.path.parent
    if not names:
        hint = f'`insdvl-replay check {gates.path} DIVE...`, or dives = ["*.mcap"]'
        raise ConfigError(f"{gates.path}: names no dives", hint)
    dives = _with_settings_of_logs(
        find_dives(names, folder, results=True), layers, is_wanted=local_settings
    )
    loaded = layers.load_each([dive.settings for dive in dives], report=report)
    options = ReplayOptions(
        loaded.usual,
        allow_damaged=allow_damaged or content.allow_damaged,
        histories=histories,
    )
    files = [*layers.files, *filter(None, loaded.by_file)]
    return Check(gates, dives, shard, options, loaded.by_file, files)


def _with_settings_of_logs(
    dives: Sequence[FoundDive], layers: SettingsLayers, *, is_wanted: bool
) -> list[FoundDive]:
    """Give the logs among the dives the settings next to them; results are not replayed."""
    found = []
    for dive in dives:
        found += with_local_settings([dive], layers, is_wanted=is_wanted and not _is_result(dive))
    return found


def checked_dives(
    check: Check,
    output: Path,  # of the replays
    how: Replaying,
    fetch: Fetch,
    listener: Listener = Listener(),
    *,
    update: bool = False,  # store what is found as expected, before the gates are evaluated
) -> CheckResult:
    """Replay the logs of a check, and evaluate its gates.

    The listener is told in this order: of all results, of changed expected values, of each file of them that is stored.

    Raises
    ------
    ConfigError
        A gate is about a filter that no replay has, or results cannot be stored in the output. With ``update``: no gate
        has expected values, or gates that differ share a file of them.
    """
    if update:
        require_expected(check.gates)
    dives = _results_of(check, output, how, fetch)
    listener.results(dives)
    if update:
        listener.changes(compare_with_expected(check.gates, dives))
        for file in write_expected(check.gates, dives):
            listener.stored(file)
    return evaluate_gates(check.gates, dives)


def write_badge(found: CheckResult, file: Path) -> None:
    """Write the counts of the outcomes as a badge, in place of an older one."""
    with result_file(file, force=True) as made:
        made.write_bytes(badge_json(found))


def _results_of(
    check: Check,
    output: Path,
    how: Replaying,
    fetch: Fetch,
) -> list[Checked]:
    """Return the dives of a shard in their order: results as they are, logs with the result of their replay."""
    own = check.shard.places(check.dives)
    logs = list[FoundDive]()
    own_logs = set[int]()
    own_results = list[FoundDive]()
    for place, dive in enumerate(check.dives):
        if _is_result(dive):
            if place in own:
                own_results.append(dive)
            continue
        if place in own:
            own_logs.add(len(logs))
        logs.append(dive)
    results = iter(fetch(own_results))
    plan = partial(plan_jobs, output=output, options=check.options, configs=check.configs)
    share = plan_share(check.shard, logs, frozenset(own_logs), fetch, plan)
    # Stored results may have filters that no settings name.
    if own_logs and not own_results:
        require_known_filters(check.gates, _filters_of(share.own_jobs))
    checked: list[Checked] = []
    # One outcome for each log, in the order of the dives.
    with closing(outcomes_of_shard(with_noise_of_all(share, how), how)) as replays:
        for place in own:
            if _is_result(check.dives[place]):
                checked += checked_results(next(results).path)
            else:
                checked += _replayed(next(replays))
    return checked


def _filters_of(jobs: Sequence[ReplayJob]) -> list[str]:
    """Return the filters of all replays, each once."""
    names = dict[str, None]()
    for job in jobs:
        names.update(dict.fromkeys(job.options.config.filters))
    return list(names)


def _is_result(dive: FoundDive) -> bool:
    return dive.path.suffix == ".json" or (dive.path / COMPLETE).is_file()


def _replayed(outcome: Outcome) -> Iterator[Checked]:
    """Yield the result of a replay, or why there is none."""
    if isinstance(outcome.result, Exception):
        yield Checked(outcome.result, outcome.job.target)
    else:
        yield from checked_results(outcome.job.target)
