"""The public Python interface: a function for each command, and results with data frames and a notebook view.

Use ``from insdvl_replay import load_config, replay_log, read_results``. These names are stable; all other modules may
change.

A mistake of the caller's is a ConfigError, a LogError or a ResultError, with a hint in ``hint``. An argument of another
kind, such as settings where a path is expected, is a WrongArgumentError, which is a ConfigError and a TypeError.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from insdvl_replay.core.config import Config
from insdvl_replay.core.config_file import load_config as _load_config
from insdvl_replay.core.config_file import toml_value
from insdvl_replay.core.errors import ConfigError, Note, ResultError, hint_for
from insdvl_replay.core.path_kinds import result_hint, result_named
from insdvl_replay.core.report import Report
from insdvl_replay.core.settings_layers import SettingsLayers
from insdvl_replay.document.parts import (
    Block,
    Callout,
    Code,
    Part,
    Title,
)
from insdvl_replay.document.parts import Result as Content
from insdvl_replay.document.tables import header_and_rows
from insdvl_replay.nav.user_candidate import Candidate as Candidate
from insdvl_replay.nav.user_candidate import Solution as Solution
from insdvl_replay.nav.user_measurement import UserMeasurement as UserMeasurement
from insdvl_replay.nav.user_measurement import UserNoise as UserNoise
from insdvl_replay.nav.user_measurement import UserReadings as UserReadings
from insdvl_replay.preparation.user_process import run_as_program as run_as_program
from insdvl_replay.results.folder import (
    MAPS,
    PAGE,
    TRAJECTORY_FILE,
    is_result,
    result_file,
    result_folder,
)
from insdvl_replay.results.stored_results import read_one_result, read_reports
from insdvl_replay.show.screens import dive_screen, dives_screen

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from insdvl_replay.batch.check import Check
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.jobs import ReplayJob
    from insdvl_replay.changes.gate_file import Gates
    from insdvl_replay.preparation.replay import Replay
    from insdvl_replay.results.trajectory import Trajectory
    from insdvl_replay.show.answers import Failure

Text = str | Path
Paths = Text | Sequence[Text]
Settings = Config | Paths


def load_config(
    *files: Text,
    preset: str | None = None,
    settings: Mapping[str, object] | str | Sequence[str] = (),
    allow_code: bool = False,
) -> Config:
    """Return the resolved settings, as the command line does.

    Parameters
    ----------
    *files : str or Path
        TOML files. Later files override earlier ones.
    preset : str, optional
        ``levy-klein`` (of the paper by Levy and Klein, arXiv:2308.11762), ``fog``, ``tactical`` or ``mems``. Without
        one, and without ``[noise]``, a replay fits the noise to the dives.
    settings : mapping, str or sequence of str
        Single settings by their dotted keys: ``{"dvl.scale": 1.01}``, or ``["dvl.scale=1.01"]``. Values may be tuples,
        NumPy arrays and numbers, and paths. Nested mappings set only their own keys.
    allow_code : bool
        Allow settings that name your code, as ``module:Class``. A replay then runs this code.

    Raises
    ------
    ConfigError
        A file cannot be read, a key or value is not valid, or a setting names code without ``allow_code``.
    """
    pairs = [*_pairs(settings)] if isinstance(settings, Mapping) else _names(settings)
    return _load_config(
        preset, [_path("files", file) for file in files], pairs, allow_code=allow_code
    )


def _pairs(settings: Mapping[str, object], within: str = "") -> Iterator[str]:
    for name, value in settings.items():
        key = f"{within}{name}"
        if isinstance(value, Mapping):
            yield from _pairs(value, f"{key}.")
        else:
            yield f"{key}={toml_value(_plain(key, value))}"


def _plain(key: str, value: object) -> object:
    """Convert NumPy values and paths to TOML values."""
    if value is None:
        raise ConfigError(
            f"{key}: None is not a valid value", "leave the key out to use its default"
        )
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(key, item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value


class WrongArgumentError(ConfigError, TypeError):
    """An argument is of another kind: an object where a path is expected, or the other way round."""

    __str__ = Exception.__str__


def _path(name: str, given: object) -> Path:
    """Return an argument as a path."""
    if isinstance(given, str | os.PathLike):
        return Path(given)
    hint = "give the path of a file or a folder"
    if isinstance(given, Config):
        hint = "settings are the argument `config`"
    elif isinstance(given, Result):
        hint = "save it first: `result.save(FOLDER)`, and give this folder"
    raise WrongArgumentError(f"{name}: is not a path, but a {type(given).__name__}", hint)


def _paths(given: Paths, name: str = "log") -> list[Path]:
    if isinstance(given, Iterable) and not isinstance(given, str | Path | Mapping):
        return [_path(name, part) for part in given]
    return [_path(name, given)]


def _names(given: str | float | Iterable[str | float]) -> list[str]:
    """Return an argument of several names; a text, or a number, is one of them."""
    if isinstance(given, str | float):
        return [str(given)]
    return [str(name) for name in given]


def _logs(given: Paths, name: str = "log") -> list[Path]:
    """Return the paths of logs; none is an error."""
    paths = _paths(given, name)
    if not paths:
        raise ConfigError(f"{name}: names no dive", "give the path of a log")
    for path in paths:
        if (folder := result_named(path)) is not None and is_result(folder):
            raise ConfigError(f"{path}: is a result, not a log", result_hint(folder))
        if path.suffix == ".toml":
            raise ConfigError(
                f"{path}: is a TOML file, not a log", "settings are the argument `config`"
            )
    return paths


def _settings(given: Settings | None, name: str = "config") -> SettingsLayers:
    """Return an argument as settings; paths are read as `load_config` reads them, and None gives the defaults."""
    if given is None:
        return SettingsLayers()
    if isinstance(given, Config):
        return SettingsLayers(ready=given)
    if isinstance(given, str | os.PathLike | list | tuple):
        return SettingsLayers(files=_paths(given, name))
    if isinstance(given, Mapping):
        raise WrongArgumentError(
            f"{name}: is not settings, but a {type(given).__name__}",
            f"{name}=load_config(settings=...)",
        )
    raise WrongArgumentError(
        f"{name}: is not settings, but a {type(given).__name__}",
        f"{name}=load_config('vehicle.toml')",
    )


def _settings_of(given: Settings | None, dives: "Sequence[FoundDive]") -> "_Given":
    """Return an argument as settings for dives; None means those next to them, as on the command line."""
    from insdvl_replay.batch.dive_paths import shared_settings
    from insdvl_replay.batch.local_settings import place_of_settings, with_local_settings

    layers = _settings(given)
    found = with_local_settings(dives, layers, is_wanted=given is None)
    own = shared_settings(found, "config")
    return _Given(layers, own, place_of_settings(found[0]))


@dataclass(frozen=True)
class _Given:
    """The settings for some dives."""

    layers: SettingsLayers
    own: Path | None  # the file next to the dives or above them, if it is used
    place: str  # where it is, seen from the first dive

    def load(self) -> Config:
        return self.layers.load(self.own)


# --- What a command does.


def replay_log(
    log: Paths,
    config: Settings | None = None,
    *,
    allow_damaged: bool = False,
    name: str | None = None,
    auto: bool = False,
) -> "DiveResult":
    """Replay a dive through the configured filters and return the result.

    Parameters
    ----------
    log : str, Path or sequence of them
        An MCAP file or a bag folder, or several of one dive.
    config : Config, str, Path or sequence of them, optional
        From `load_config`, or TOML files as for it. Default: an ``insdvl-replay.toml`` in the folder of the log or
        above it, which a note names, or else the default settings, which are ``load_config()``. Noise that they do not
        give is fitted to the dive, and a note says so.
    allow_damaged : bool
        Use the readable part of a damaged log.
    name : str, optional
        Name of the dive. Default: the name of the log.
    auto : bool
        If the log cannot be replayed as it is, find settings, as ``run`` does. The notes say what was found.

    Raises
    ------
    LogError
        The log cannot be used, or is damaged and ``allow_damaged`` is not given.
    ConfigError
        There is no log, it is a result, or the settings do not fit it.
    """
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.in_memory import replay_in_memory
    from insdvl_replay.batch.jobs import ReplayOptions
    from insdvl_replay.batch.search import with_search
    from insdvl_replay.show.result_files import report_of

    paths = _logs(log)
    given = _settings_of(config, [FoundDive(path) for path in paths])
    options = ReplayOptions(given.load(), allow_damaged=allow_damaged)
    if auto and given.own is None:
        options = with_search(options, given.layers)
    replay = replay_in_memory(paths, options, name, local_settings=given.place)
    return DiveResult(report_of(replay), _replay=replay)


def read_result(folder: Text) -> "DiveResult":
    """Return the result in a folder that `run` or `DiveResult.save` wrote.

    Parameters
    ----------
    folder : str or Path
        The folder, or a folder with one result somewhere in it.

    Raises
    ------
    ConfigError
        The folder holds no result, or several.
    ResultError
        The result cannot be read, or is of a version that cannot be read.
    """
    found, report = read_one_result(_path("folder", folder), Report)
    return DiveResult(report, folder=found)


def read_results(folder: Text) -> "DiveResults":
    """Return the results of all dives in a folder, with their pooled evidence.

    Where a run of several dives has written its summary, the dives of the last run count: those that it replayed, or
    the one of a later run of one dive. Results of earlier runs beside them are left out, and named in `content.notes`.

    Parameters
    ----------
    folder : str or Path
        A folder of results, which may be in folders below it.

    Raises
    ------
    ConfigError
        The folder holds no result, or the last run into it has replayed no dive.
    ResultError
        A result cannot be read, or is of a version that cannot be read.
    """
    found, notes = read_reports(_path("folder", folder), Report)
    dives = {}
    for file, report in found:
        place = os.path.relpath(file.parent, folder)
        dives[place] = DiveResult(report, file.parent)
    reports = [report for _, report in found]
    return DiveResults(_content_of_dives(reports, notes), dives, Path(folder))


def _content_of_dives(outcomes: "Sequence[Report | Failure]", notes: Sequence[Note]) -> Content:
    """Return all tables of several dives as data."""
    from insdvl_replay.core.tables import TABLES
    from insdvl_replay.show.dive import TOGETHER
    from insdvl_replay.show.dives import named_result, overview_parts

    names = [layout.name for layout in TABLES]
    content = named_result(outcomes, [*names, *TOGETHER], ())
    return replace(content, document=overview_parts(outcomes), notes=notes)


def run_shard(
    logs: Paths,
    shard: str,
    folder: Text,
    config: Settings | None = None,
    *,
    auto: bool = False,
    allow_damaged: bool = False,
    force: bool = False,
) -> "CommandResult":
    """Replay one of several equal shares of the dives into a folder, for `merge`: table shard has a row for each.

    Parameters
    ----------
    logs : str, Path or sequence of them
        All dives, as logs, folders of them, patterns, lists or manifests.
    shard : str
        Which share it is: ``1/4`` has every fourth dive, starting at the first, counted by their names.
    folder : str or Path
        The folder of the results. Those that are up to date are used again.
    config : Config, str, Path or sequence of them, optional
        From `load_config`, or TOML files as for it. Default: as for `replay_log`. Noise that they do not give is that
        of a run over all dives.
    auto : bool
        Refuse a dive whose settings a run over all dives would find. Nothing is searched for.
    allow_damaged : bool
        Use the readable part of damaged logs.
    force : bool
        Replace other results.

    Raises
    ------
    ConfigError
        No dive is named, the shard is not of the form ``1/4``, settings are not valid, or other results are in the
        folder. A log that cannot be used raises nothing: its row says why.
    """
    from insdvl_replay.batch.jobs import ReplayOptions
    from insdvl_replay.batch.manifest import fetch_dives
    from insdvl_replay.batch.parts import plan_shard_run, replay_shard, shard_result
    from insdvl_replay.batch.search import with_search, without_search

    layers = _settings(config)
    dives = _found_dives(logs, layers, is_local=config is None)
    loaded = layers.load_each([dive.settings for dive in dives])
    options = ReplayOptions(loaded.usual, allow_damaged)
    if auto:
        options = without_search(with_search(options, layers))
    output = _path("folder", folder)
    run = plan_shard_run(shard, dives, output, options, loaded.by_file, fetch_dives)
    return CommandResult(shard_result(replay_shard(run, force=force)))


def _found_dives(logs: Paths, layers: SettingsLayers, *, is_local: bool) -> "list[FoundDive]":
    """Return the dives of logs, with the settings next to them if these are asked for."""
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.batch.local_settings import with_local_settings

    names = [str(path) for path in _paths(logs, "logs")]
    return with_local_settings(find_dives(names), layers, is_wanted=is_local)


def merge(parts: Paths, folder: Text, *, force: bool = False) -> "DiveResults":
    """Merge the shards of a run into the results of one run over all dives, byte for byte.

    Table summary also has the dives that failed.

    Parameters
    ----------
    parts : str, Path or sequence of them
        Folders that `run_shard` or ``run --shard`` wrote, each with one shard or several.
    folder : str or Path
        The folder of the results.
    force : bool
        Replace other results.

    Raises
    ------
    ConfigError
        A shard is missing or there twice, shards are of different dives, settings or versions, or other results are in
        the folder.
    ResultError
        A result is not as its shard wrote it.
    """
    from insdvl_replay.batch.merge import plan_merge
    from insdvl_replay.batch.overviews import write_overviews
    from insdvl_replay.show.answers import Failure

    output = _path("folder", folder)
    planned = plan_merge(_paths(parts, "parts"), output, force=force)
    outcomes: list[Report | Failure] = []
    dives = {}
    for dive in planned.dives(force=force):
        name = dive.target.name
        if isinstance(dive.result, Report):
            dives[name] = DiveResult(dive.result, dive.target)
            outcomes.append(dive.result)
        else:
            outcomes.append(Failure(name, str(dive.result)))
    if len(outcomes) > 1:
        write_overviews(outcomes, output)
    return DiveResults(_content_of_dives(outcomes, ()), dives, output)


def plan(
    folder: Text | None = None, *, tracks: int | None = None, ratio: float = 0.9
) -> "CommandResult":
    """Return what the dives of a result can find, and how many dives find smaller changes: table plan.

    Parameters
    ----------
    folder : str, Path or None
        A result folder, or a folder of results.
    tracks : int or None
        Instead of a folder: what so many dives can find, for several scatters over dives.
    ratio : float
        With ``tracks``: the ratio of errors that is looked for, below the band.

    Raises
    ------
    ConfigError
        The folder holds no result, both or none of folder and tracks are given, or the ratio cannot be found.
    ResultError
        A result cannot be read, or is of a version that cannot be read.
    """
    from insdvl_replay.show.plan import EITHER, plan_of_tracks, plan_result

    if folder is None and tracks is not None:
        return CommandResult(plan_of_tracks(tracks, ratio))
    if folder is None or tracks is not None:
        raise ConfigError(*EITHER)
    found, notes = read_reports(_path("folder", folder), Report)
    return CommandResult(replace(plan_result([report for _, report in found]), notes=notes))


def simulate(scenario: str, output: Text, *, force: bool = False, **options: Any) -> Path:
    """Write a simulated dive as a log and return its path.

    Parameters
    ----------
    scenario : str
        ``straight``, ``figure-eight``, ``lawnmower``, ``static`` or ``calibration``.
    output : str or Path
        The MCAP file.
    force : bool
        Replace an existing file.
    **options
        ``seed``, ``duration_s``, ``grade`` (of the IMU), ``outages`` (pairs of seconds), ``lever_arm_m``,
        ``mounting_rpy_deg``, ``dvl_delay_s``, ``dvl_scale`` and others of `sim.dive.simulate_dive`. The end of a name
        is its unit; the lever arm is from the IMU to the DVL, forward, right and down.

    Raises
    ------
    ConfigError
        A scenario or a value is not valid, there is no such option, or the file exists without ``force`` or cannot be
        written.
    """
    from insdvl_replay.logs import write_dive
    from insdvl_replay.sim.dive import OPTIONS, simulate_dive

    for name in options:
        if name not in OPTIONS:
            raise WrongArgumentError(f"option '{name}' is not known", hint_for(name, OPTIONS))
    with result_file(_path("output", output), force=force) as path:
        write_dive(path, simulate_dive(scenario, **options))
    return Path(output)


def demo(folder: Text) -> "dict[str, CommandResult]":
    """Simulate six dives, and judge three changes of their settings: one helps, one does harm, one does nothing.

    Parameters
    ----------
    folder : str or Path
        For the dives, the results and a page for each answer. It may be that of an earlier demonstration.

    Returns
    -------
    dict of str to CommandResult
        The comparisons, as `compare` returns them, by ``lever_arm``, ``scale`` and ``gate``.

    Raises
    ------
    ConfigError
        There is something else in the folder, or it cannot be written.
    """
    from insdvl_replay.batch.demo import demo_answers, make_dives
    from insdvl_replay.batch.replaying import Replaying, unheard
    from insdvl_replay.changes.comparison_document import comparison_document, comparison_result

    target = _path("folder", folder)
    make_dives(target)
    results = {}
    for answer in demo_answers(target, Replaying(force=True), unheard):
        found = answer.found
        content = comparison_result(found, comparison_document(found))
        results[answer.question.name] = CommandResult(content)
    return results


def inspect(
    log: Paths,
    config: Settings | None = None,
    *,
    deep: bool = False,
    allow_damaged: bool = False,
) -> "CommandResult":
    """Return what is in a log, or in several of one dive, and what would stop a replay.

    The tables are file, topics, roles, clocks, pings, reference and notes.

    Parameters
    ----------
    log : str, Path or sequence of them
        A log or a bag folder, or several of one dive.
    config : Config, str, Path or sequence of them, optional
        The settings that a replay would have. Default: as for `replay_log`.
    deep : bool
        Read all messages of each role, not only the first.
    allow_damaged : bool
        Look at the readable part of a damaged log.

    Raises
    ------
    LogError
        The log cannot be read.
    ConfigError
        There is no log, it is a result, or settings are not valid.
    """
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.inspect_logs import Look, inspect_dive
    from insdvl_replay.inspection.inventory import inspection_result

    files = [FoundDive(path) for path in _logs(log)]
    settings = _settings_of(config, files).load()
    look = Look(deep=deep, one_dive=True, allow_damaged=allow_damaged)
    inventory = inspect_dive(files, settings, look)
    return CommandResult(inspection_result(inventory, " ".join(str(file.path) for file in files)))


def propose(
    logs: Paths, config: Settings | None = None, *, allow_damaged: bool = False
) -> "CommandResult":
    """Propose settings for the dives of a vehicle, a log each; `CommandResult.settings` has them as TOML.

    Table missing has the keys that nothing in the logs tells.

    Parameters
    ----------
    logs : str, Path or sequence of them
        A log for each dive.
    config : Config, str, Path or sequence of them, optional
        Settings that are known, and stay as they are. Default: as for `replay_log`.
    allow_damaged : bool
        Use the readable part of damaged logs.

    Raises
    ------
    LogError
        A log cannot be read.
    ConfigError
        There is no log, one is a result, or settings are not valid.
    """
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.calibration.found import Given
    from insdvl_replay.inspection.automatic import settings_file

    paths = _logs(logs, "logs")
    settings = _settings_of(config, [FoundDive(path) for path in paths])
    given = Given(settings.load().without_code(), settings.layers.keys(settings.own))
    found = settings_file([[path] for path in paths], given, allow_damaged=allow_damaged)
    sentences = [note.finding for note in found.notes]
    if found.failure is not None:
        sentences.append(f"blocker: {found.failure.message}; hint: {found.failure.hint}")
    title = "Proposed settings"
    blocks = {"missing": Block(("key",), [(key,) for key in found.missing])}
    document: list[Part] = [Title(title), *map(Callout, sentences), Code(found.text, "toml")]
    return CommandResult(
        Content("proposal", title, sentences, blocks, document=document, settings=found.text)
    )


def calibrate(
    logs: Paths,
    config: Settings | None = None,
    *,
    only: str | Sequence[str] | None = None,
    reference: bool = False,
    one_delay: bool = False,
    mounting_unknown: bool = False,
    hold_out: str | float | Sequence[str | float] = (),
    allow_damaged: bool = False,
) -> "CommandResult":
    """Estimate the DVL's geometry and the sensors' noise, a log each dive; `CommandResult.settings` is TOML.

    The tables are parameters, noise and dives. A row has the unit of its values.

    Parameters
    ----------
    logs : str, Path or sequence of them
        A log for each dive.
    config : Config, str, Path or sequence of them, optional
        Settings to begin with. Default: as for `replay_log`.
    only : str or sequence of str, optional
        Some of ``arm``, ``mounting``, ``delay``, ``scale`` and ``noise``. Default: all.
    reference : bool
        Compare with the dives' references, and calibrate these, too.
    one_delay : bool
        Estimate one delay for all dives, not one for each.
    mounting_unknown : bool
        Try 24 mountings first.
    hold_out : str, float or sequence of them
        Dives that test the result: names, or a share between 0 and 1.
    allow_damaged : bool
        Use the readable part of damaged logs.

    Raises
    ------
    LogError
        A log cannot be used.
    ConfigError
        There is no log, one is a result, a word in ``only`` or a dive in ``hold_out`` is not known, or the settings do
        not fit the logs.
    """
    from insdvl_replay.batch.calibrate import Asked, calibrate_logs
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.calibration.dives import require_groups
    from insdvl_replay.calibration.output import calibration_result

    def failed(error: Exception) -> None:
        raise error

    groups = None if only is None else _names(only)
    asked = Asked(
        require_groups(groups, reference=reference),
        _names(hold_out),
        reference,
        one_delay,
        mounting_unknown,
    )
    files = [FoundDive(path) for path in _logs(logs, "logs")]
    settings = _settings_of(config, files).load()
    dives = [[file] for file in files]
    calibrated = calibrate_logs(dives, settings, asked, failed, allow_damaged=allow_damaged)
    assert calibrated is not None
    found = calibrated.dives
    content = calibration_result(found.found, found.config, figures=calibrated.figures())
    return CommandResult(replace(content, settings=calibrated.settings()))


def compare(
    old: Text,
    new: Text,
    *,
    tables: str | Sequence[str] = (),
    columns: str | Sequence[str] = (),
    dives: str | Sequence[str] = (),
    pairs: Mapping[str, str] | None = None,
    tolerance_pct: float | None = None,
) -> "CommandResult":
    """Compare stored results: tables answer, difference, dive, aggregate and change.

    Parameters
    ----------
    old, new : str or Path
        Result folders, or folders of results.
    tables, columns, dives : str or sequence of str
        Compare only these. Default: all.
    pairs : mapping of str to str, optional
        The new name of a filter by its old one.
    tolerance_pct : float, optional
        Changes up to this, in percent, count as the same. Default: the last printed digit.

    Raises
    ------
    ConfigError
        A folder holds no result, no dive or candidate is on both sides, a name is not known, or the tolerance is no
        percentage.
    ResultError
        A result cannot be read.
    """
    from insdvl_replay.changes.comparison import compare_results
    from insdvl_replay.changes.comparison_document import comparison_document, comparison_result

    found = compare_results(
        _path("old", old),
        _path("new", new),
        tables=_names(tables),
        columns=_names(columns),
        dives=_names(dives),
        filter_pairs=pairs or {},
        tolerance_pct=tolerance_pct,
    )
    return CommandResult(comparison_result(found, comparison_document(found)))


def compare_trajectories(
    old: Text,
    new: Text | Sequence[Text],
    reference: Text,
    *,
    align: str = "none",
    axes: str | None = None,
    reference_axes: str | None = None,
    primary: str = "",
    max_diff_s: float | None = None,
    rpe: str | Sequence[str] = (),
    all_pairs: bool = False,
    dives: str | Sequence[str] = (),
) -> "CommandResult":
    """Compare trajectories of any program with those of a reference.

    Tables are answer, dive, evidence, trajectory_errors and credibility.

    Parameters
    ----------
    old, new, reference : str or Path, or sequence of them for several ``new``
        Folders with a file for each dive, or single files: TUM, tables, or logs, of which ``dive.mcap:/odom`` names a
        topic. Files of the same name are one dive.
    align : str
        ``none``, or what is fitted first: ``yaw``, ``se3`` or ``sim3``.
    axes, reference_axes : str, optional
        ``enu_flu`` or ``ned_frd``. Default: by the format.
    primary : str
        The quantity that decides. Default: position.
    max_diff_s : float, optional
        Most seconds between the stamps of poses, for APE and RPE. Default: 0.01.
    rpe : str or sequence of str
        Lengths of RPE, such as ``1f`` or ``100m``. Default: ``1f``.
    all_pairs : bool
        RPE of all pairs of poses, not only of consecutive ones.
    dives : str or sequence of str
        Only these.

    Raises
    ------
    ConfigError
        A side has no trajectory, no dive has files on all sides, or a name or a value is not known.
    LogError
        No dive can be compared; the reason is that of the first one.
    """
    from insdvl_replay.trajectories.comparison import compare_trajectories as compared
    from insdvl_replay.trajectories.comparison import options_of
    from insdvl_replay.trajectories.document import trajectories_result

    options = options_of(
        align=align,
        axes=axes,
        reference_axes=reference_axes,
        primary=primary,
        max_diff_s=max_diff_s,
        rpe=_names(rpe),
        all_pairs=all_pairs,
        dives=_names(dives),
    )
    sides = [new] if isinstance(new, str | os.PathLike) else [*new]
    found = compared(str(old), [str(side) for side in sides], str(reference), options)
    return CommandResult(trajectories_result(found))


def compare_settings(
    logs: Paths,
    before: Settings,
    after: Settings,
    folder: Text,
    *,
    allow_damaged: bool = False,
    force: bool = False,
) -> "CommandResult":
    """Replay dives with two settings, a log each, into ``folder/before`` and ``folder/after``, and compare them.

    The tables are those of `compare`.

    Parameters
    ----------
    logs : str, Path or sequence of them
        A log for each dive.
    before, after : Config, str, Path or sequence of them
        From `load_config`, or TOML files as for it. Noise that they do not give is fitted once, with ``before``.
    folder : str or Path
        Results that are up to date are used again.
    allow_damaged : bool
        Use the readable part of damaged logs.
    force : bool
        Replace other results.

    Raises
    ------
    LogError
        A log cannot be used.
    ConfigError
        There is no log, one is a result, the settings do not differ or do not fit a log, or other results are in the
        folder.
    """
    from insdvl_replay.batch.against import compare_sides, plan_both_sides, require_change
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.jobs import ReplayOptions
    from insdvl_replay.batch.replaying import Replaying
    from insdvl_replay.batch.search import outcomes
    from insdvl_replay.calibration.fitted_noise import with_noise_of
    from insdvl_replay.changes.comparison_document import comparison_document, comparison_result

    def changed(job: "ReplayJob", fitted: Config) -> Config:
        return with_noise_of(job.options.config, fitted)

    old = _settings(before, "before").load()
    new = _settings(after, "after").load()
    dives = [FoundDive(path) for path in _logs(logs, "logs")]
    require_change({None: old}, {None: new}, "after")
    options = ReplayOptions(old, allow_damaged), ReplayOptions(new, allow_damaged)
    how = Replaying(force=force)
    sides = plan_both_sides(dives, _path("folder", folder), options, ({}, {}), changed, how)
    done = []
    for outcome in outcomes(sides.jobs, how):
        if isinstance(outcome.result, Exception):
            raise outcome.result
        done.append(outcome.result.log.name)
    found = compare_sides(sides, done)
    assert found is not None
    return CommandResult(comparison_result(found, comparison_document(found)))


def check(
    gates: Text,
    dives: Paths = (),
    config: Settings | None = None,
    *,
    results: Text = "checked",
    update: bool = False,
    badge: Text | None = None,
) -> "CommandResult":
    """Check dives against gates: table gates has the status of each gate on each dive.

    Parameters
    ----------
    gates : str or Path
        TOML file with the gates.
    dives : str, Path or sequence of them
        Logs or result folders. Default: those named in ``gates``.
    config : Config, str, Path or sequence of them, optional
        Settings for logs, as files above the preset that ``gates`` names. Default: those named in ``gates``, or else as
        for `replay_log`.
    results : str or Path
        Folder for the results of logs, which are replayed if something has changed.
    update : bool
        Store the values of the dives as expected before the gates are evaluated, as ``--update`` does.
    badge : str or Path, optional
        A file that gets the counts as JSON for a badge of shields.io, as ``--badge`` writes it.

    Raises
    ------
    ConfigError
        The gates or the settings are not valid, no dive is named, or a result cannot be written. A log that cannot be
        used raises nothing: its gates have not passed.
    ResultError
        A result that was given cannot be read.
    """
    from insdvl_replay.batch.check import checked_dives, write_badge
    from insdvl_replay.batch.manifest import fetch_dives
    from insdvl_replay.batch.replaying import Replaying
    from insdvl_replay.changes.formats import check_result

    planned = _planned_check(gates, dives, config)
    if badge is not None:
        planned.require_outputs({"badge": _path("badge", badge)})
    folder = _path("results", results)
    outcome = checked_dives(planned, folder, Replaying(force=True), fetch_dives, update=update)
    if badge is not None:
        write_badge(outcome, _path("badge", badge))
    return CommandResult(check_result(outcome))


def _planned_check(gates: Text, dives: Paths, config: Settings | None) -> "Check":
    """Find the dives of a check, and load its gates and settings."""
    from insdvl_replay.batch.check import plan_check
    from insdvl_replay.changes.gate_file import load_gates

    found = load_gates(_path("gates", gates))
    named = []
    if dives:
        named = [str(path) for path in _paths(dives, "dives")]
    layers = _with_gates(_settings(config), found)
    return plan_check(found, named, layers, local_settings=config is None)


def _with_gates(layers: SettingsLayers, gates: "Gates") -> SettingsLayers:
    """Return settings above the preset that gates name, or those that they name themselves."""
    from insdvl_replay.changes.gate_file import settings_of

    if layers.ready is not None:
        return layers
    return SettingsLayers(gates.content.preset, layers.files or settings_of(gates))


def history(lake: Text, quantity: str = "") -> "CommandResult":
    """Return how each filter did over the versions in a lake, and where that changed: tables step and version.

    Parameters
    ----------
    lake : str or Path
        The folder that ``run --lake`` wrote.
    quantity : str
        The quantity whose ratio it is. Default: the one that decides, for each filter.

    Raises
    ------
    ConfigError
        It is no lake, the quantity is not known, or pyarrow is not installed.
    ResultError
        The lake has no ratio of the quantity.
    """
    from insdvl_replay.show.history import history_result

    return CommandResult(history_result(_path("lake", lake), quantity))


def compact_lake(lake: Text) -> "CommandResult":
    """Join the files of a lake into one, and return how many there were: table lake.

    Parameters
    ----------
    lake : str or Path
        The folder that ``run --lake`` wrote.

    Raises
    ------
    ConfigError
        It is no lake, cannot be written, or pyarrow is not installed.
    """
    from insdvl_replay.results.lake import compact_lake as _compact_lake
    from insdvl_replay.show.lake import compacted_result

    return CommandResult(compacted_result(_compact_lake(_path("lake", lake))))


# --- Results.


class UnknownNameError(ConfigError, KeyError):
    """A result has no table or filter of this name; the hint lists near or all names."""

    __str__ = Exception.__str__  # a KeyError's is in quotes


class Named(dict[str, "pd.DataFrame"]):
    """Data frames by name; an unknown name raises an UnknownNameError, which is a ConfigError and a KeyError."""

    def __init__(self, kind: str, frames: "Mapping[str, pd.DataFrame]") -> None:
        super().__init__(frames)
        self._kind = kind

    def __missing__(self, name: str) -> "pd.DataFrame":
        raise UnknownNameError(
            f"{self._kind} '{name}' is not known", hint_for(name, self, most=len(self))
        )


def _frame(table: Any) -> "pd.DataFrame":
    """Return a table as a data frame; missing numbers are NaN."""
    import pandas as pd

    if isinstance(table, pd.DataFrame):
        return table
    header, rows = header_and_rows(table)
    return pd.DataFrame(list(rows), columns=list(header))


class Result:
    """What every function returns: data frames in ``tables``, and ``save``. Notebooks and prompts show it."""

    def _screen(self) -> Sequence[Part]:
        raise NotImplementedError

    def __str__(self) -> str:
        """Return the screen that the command line shows."""
        import io

        from rich.console import Console

        from insdvl_replay.document.text import for_terminal

        console = Console(width=100, file=io.StringIO(), record=True)
        console.print(for_terminal(self._screen()))
        return "\n".join(line.rstrip() for line in console.export_text().rstrip().split("\n"))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from insdvl_replay.document.page import fragment

        return fragment(self._screen())


@dataclass(frozen=True, repr=False)
class CommandResult(Result):
    """The result of `inspect`, `propose`, `calibrate`, `compare` or `check`, or of many dives."""

    content: Content  # as data

    @property
    def tables(self) -> dict[str, "pd.DataFrame"]:
        """Each table as a data frame, by name; missing values are NaN.

        The end of a column's name is its unit, else column ``unit`` has it. An unknown name raises an UnknownNameError.
        """
        return Named("table", {name: _frame(table) for name, table in self.content.tables.items()})

    @property
    def settings(self) -> str:
        """The settings that `propose` or `calibrate` found, as TOML for `load_config`; else empty."""
        return self.content.settings

    def save(self, folder: Text, *, force: bool = False) -> Path:
        """Write page, tables, report.json and, as proposed.toml, the settings into a new folder; return its path.

        Parameters
        ----------
        folder : str or Path
            The folder that is made.
        force : bool
            Replace a result folder of this name.

        Raises
        ------
        ConfigError
            It exists without ``force`` or is no result folder, or cannot be written.
        """
        from insdvl_replay.document.render import save_result

        with result_folder(_path("folder", folder), force=force) as made:
            save_result(replace(self.content, data=None), made)
        return Path(folder)

    def _screen(self) -> Sequence[Part]:
        from insdvl_replay.document.render import document

        return document(self.content)


@dataclass(frozen=True, repr=False)
class DiveResult(Result):
    """The result of one dive. In a notebook it shows the verdict on each candidate and the evidence."""

    report: Report  # the complete result as data
    folder: Path | None = None  # the folder that it was read from
    _replay: "Replay | None" = None

    @property
    def name(self) -> str:
        """The name of the dive."""
        return self.report.log.name

    @property
    def words(self) -> dict[str, str]:
        """The verdict on each candidate, such as better, worse, mixed, undecided, not repeatable or not evaluated."""
        return {name: str(candidate.verdict) for name, candidate in self.report.filters.items()}

    @property
    def tables(self) -> dict[str, "pd.DataFrame"]:
        """Each table as a data frame, by name, such as evidence or outage; missing values are NaN.

        The end of a column's name is its unit, else column ``unit`` has it. An unknown name raises an UnknownNameError.
        """
        from insdvl_replay.core.tables import each_table

        rows = {
            layout.name: Block.of(layout.row, rows)
            for layout, rows in each_table(self.report.tables)
        }
        return Named("table", {name: _frame(block) for name, block in rows.items()})

    @property
    def trajectory(self) -> "pd.DataFrame":
        """States, standard deviations and errors of all filters once a second, with columns filter and time_s.

        The time is s from the start of the replay. Positions are m from the baseline's start and velocities are over
        ground, both along n (north, east, down); biases are along b (forward, right, down). The end of a column's name
        is its unit.

        Raises
        ------
        ResultError
            The result folder has no readable trajectory.
        """
        import pandas as pd

        from insdvl_replay.core.states import COLUMNS

        found = self._trajectory
        frames = [
            pd.DataFrame(values, columns=list(COLUMNS)).assign(filter=name, time_s=found.time_s)
            for name, values in zip(found.names, found.values, strict=True)
        ]
        return pd.concat(frames, ignore_index=True)[["filter", "time_s", *COLUMNS]]

    @property
    def _trajectory(self) -> "Trajectory":
        from insdvl_replay.results.trajectory import read_trajectory, trajectory_of

        if self._replay is not None:
            return trajectory_of(self._replay)
        found = read_trajectory((self.folder or Path()) / TRAJECTORY_FILE)
        if found is None:
            raise ResultError(
                f"{self.folder}: has no readable {TRAJECTORY_FILE}", "replay the log again"
            )
        return found

    @property
    def histories(self) -> dict[str, "pd.DataFrame"]:
        """The full history of each filter: states and standard deviations at each of its times.

        Raises
        ------
        ResultError
            The result folder has no readable histories.
        """
        from insdvl_replay.results.frames import history_frame, read_histories

        if self._replay is not None:
            frames = {history.filter: history_frame(history) for history in self._replay.histories}
        else:
            frames = read_histories(
                self.folder or Path(), [self.report.baseline, *self.report.filters]
            )
        return Named("filter", frames)

    @property
    def reference(self) -> "pd.DataFrame":
        """The reference inside the replay, at each of its times; no rows without one.

        Raises
        ------
        ResultError
            The result folder has no readable histories.
        """
        from insdvl_replay.results.frames import read_reference, reference_frame

        if self._replay is None:
            return read_reference(self.folder or Path(), self.report.baseline)
        replay = self._replay
        origin = replay.histories[0].position[0]
        return reference_frame(replay.dive.reference, replay.start_ns, replay.end_ns, origin)

    def figure(
        self,
        kind: str = "error",
        *,
        width_mm: float = 88,
        states: str = "",
    ) -> "Figure":
        """Return a matplotlib figure for a paper, as ``insdvl-replay figure`` draws it.

        Parameters
        ----------
        kind : str
            ``error``, ``track``, ``sigma``, ``nis``, ``outage`` or ``convergence``. The track of a stored result has
            the reference if there is a `replay.mcap`.
        width_mm : float
            88 is a column, 180 a page.
        states : str
            For ``sigma``: states, or the start of their names, such as ``ba,bg``.

        Raises
        ------
        ConfigError
            A kind, width or state is not known, the result has nothing to draw for this kind, or matplotlib is not
            installed.
        ResultError
            The result folder has no readable trajectory.
        """
        import msgspec

        from insdvl_replay.document.paper import paper_canvas, require_width
        from insdvl_replay.show.plots.all_plots import chosen_states, paper_figure

        require_width(width_mm, f"width_mm={width_mm}")
        chosen = chosen_states(kind, states, f"states={states}")
        rows = msgspec.to_builtins(self.report.tables)
        drawing = paper_figure(kind, self._trajectory, rows, chosen, self._drawn_reference)
        return paper_canvas(drawing, width_mm)

    def _drawn_reference(self) -> "pd.DataFrame | None":
        """Return the reference for a figure, which does without it."""
        from insdvl_replay.results.frames import stored_reference

        if self._replay is None:
            return stored_reference(self.folder or Path(), self.report.baseline)
        return self.reference

    def save_tracks(self, file: Text, *, force: bool = False) -> Path:
        """Write the tracks of all filters and the reference as ``.kml`` or ``.geojson``, and return the path.

        Parameters
        ----------
        file : str or Path
            The file, whose ending says the format.
        force : bool
            Replace an existing file.

        Raises
        ------
        ConfigError
            It has another ending, exists without ``force``, or cannot be written.
        ResultError
            The result folder has no readable histories.
        """
        from insdvl_replay.show.tracks import map_of_tracks

        target = _path("file", file)
        if (format_ := target.suffix.removeprefix(".")) not in MAPS:
            raise ConfigError(
                f"{target}: does not end in .kml or .geojson", f"{target.with_suffix('.geojson')}"
            )
        with result_file(target, force=force) as path:
            path.write_bytes(map_of_tracks(format_, self.name, self.histories, self.reference))
        return target

    def save(self, folder: Text, *, force: bool = False) -> Path:
        """Write the result folder, as `run` does, and return its path.

        Parameters
        ----------
        folder : str or Path
            The folder that is made.
        force : bool
            Replace a result folder of this name.

        Raises
        ------
        ConfigError
            It exists without ``force`` or is no result folder, or cannot be written.
        ValueError
            The result was read, and is in a folder already.
        """
        from insdvl_replay.show.result_files import save_replay

        if self._replay is None:
            raise ValueError(f"{self.name}: is already stored in {self.folder}")
        target = _path("folder", folder)
        with result_folder(target, force=force) as made:
            save_replay(self._replay, made)
        return target

    def _screen(self) -> Sequence[Part]:
        return dive_screen(self.report, str(self.folder / PAGE) if self.folder else "not saved")


@dataclass(frozen=True, repr=False)
class DiveResults(CommandResult):
    """The results of several dives; table pooled is the pooled evidence, and summary has a row for each dive."""

    dives: dict[str, DiveResult]  # by folder, which has the name of the dive
    folder: Path  # of all

    @property
    def words(self) -> dict[str, str]:
        """The verdict of all dives together on each candidate."""
        from insdvl_replay.show.answers import answers_of

        return {found.filter: str(found.verdict) for found in answers_of(self._reports)}

    @property
    def _reports(self) -> list[Report]:
        return [dive.report for dive in self.dives.values()]

    def _screen(self) -> Sequence[Part]:
        from insdvl_replay.show.dives import INDEX

        return dives_screen(self._reports, f"{self.folder}/{INDEX}")
