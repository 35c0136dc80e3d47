"""``insdvl-replay inspect``, ``calibrate`` and ``study``. Slow imports wait until there is work to do."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import (
    log_failure,
    log_findings,
    log_info,
    log_notes,
    log_to_stderr,
    write_stdout,
)
from insdvl_replay.core.errors import ConfigError, LogError, UserError
from insdvl_replay.core.urls import shown_url

if TYPE_CHECKING:
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.studies import StudyFolder
    from insdvl_replay.calibration.found import Given
    from insdvl_replay.core.config import Config
    from insdvl_replay.core.settings_layers import SettingsLayers
    from insdvl_replay.document.parts import Result
    from insdvl_replay.inspection.inventory import Inventory


# --- inspect


def inspect(
    logs: opt.Logs,
    deep: Annotated[
        bool, typer.Option("--deep", help="Read all messages of each role, not only the first.")
    ] = False,
    propose: Annotated[
        Path | None,
        typer.Option(
            "--propose", metavar="FILE", help="Write settings for these dives; implies --deep."
        ),
    ] = None,
    config: opt.ConfigFiles = [],
    no_config: opt.NoConfig = False,
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    format_: Annotated[opt.PageFormat, typer.Option("--format", help="Output format.")] = "table",
    allow_damaged: Annotated[
        bool,
        typer.Option(
            "--allow-damaged", help="Do not count damage as a blocker; a note counts what is lost."
        ),
    ] = False,
    offline: opt.Offline = False,
    one_dive: opt.OneDive = False,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> int:
    """Print what is in a log and what would stop a replay.

    The first line says whether the log can be replayed, and with which command. For each role follows the topic that a
    replay would use, and why. If a role has no topic, it prints settings to
    start from. --propose writes a settings file for `run -c`. Trial runs find noise, mounting and heading; comments in
    the file mark what you must decide. The exit code is 0 whether or not the log can be replayed, and 3 if a file
    cannot be read. Such a file does not stop the others.

    \b
    Example:
      insdvl-replay inspect dive.mcap
      insdvl-replay inspect dive.mcap --deep -c vehicle.toml
      insdvl-replay inspect dive.mcap --propose proposed.toml
      insdvl-replay inspect dive.mcap --deep --format html > dive.html
      insdvl-replay inspect dives/*.mcap --format json
      insdvl-replay inspect sensors.mcap gnss.mcap --one-dive
    """
    from insdvl_replay.batch.dive_paths import find_dives, shared_settings
    from insdvl_replay.batch.inspect_logs import Look, inspect_dive
    from insdvl_replay.batch.local_settings import with_local_settings
    from insdvl_replay.calibration.found import Given
    from insdvl_replay.cli.screen import fetch_with_progress, log_settings, progress, written
    from insdvl_replay.core.settings_layers import SettingsLayers
    from insdvl_replay.inspection.inventory import inspection_result
    from insdvl_replay.results.folder import require_replaceable_file

    if propose is not None:
        require_replaceable_file(propose, force=force)
    layers = SettingsLayers(preset, config, settings, allow_code=True)
    look = Look(
        deep=deep or propose is not None,
        one_dive=one_dive,
        offline=offline,
        allow_damaged=allow_damaged,
    )
    found = with_local_settings(find_dives(logs), layers, is_wanted=not no_config)
    log_settings(found)
    configs = _settings_without_code(layers, found)
    if format_ == "html" and len(found) > 1 and not one_dive:
        text = f"--format html: is a page of one dive, found {len(found)}"
        raise ConfigError(text, "name one log")
    found = look.fetched(found, fetch_with_progress)

    def inspected_dive(files: "Sequence[FoundDive]") -> "Inventory":
        with progress(f"inspecting {files[0].path.name}"):
            return inspect_dive(files, configs[files[0].settings], look)

    def show(files: "Sequence[FoundDive]", inventory: "Inventory") -> str:
        typed = _typed(files, layers, one_dive=one_dive, allow_damaged=allow_damaged)
        return written(inspection_result(inventory, typed), format_)

    dives = _as_dives(found, one_dive=one_dive)
    if format_ == "json":
        inspected, code = _inspect_each(dives, inspected_dive, verbose)
        _write_inventories(inspected, is_list=len(dives) > 1)
    else:
        inspected, code = _inspect_each(dives, inspected_dive, verbose, show)
    if propose is not None and inspected:
        shared = shared_settings(found, "--propose")
        given = Given(configs[shared], layers.keys(shared))
        paths = [one.paths for one in inspected]
        _propose(propose, paths, given, allow_damaged=allow_damaged, force=force)
    return code


class _Inspected(NamedTuple):
    """A dive that could be read, and what is in it."""

    paths: "list[Path]"
    inventory: "Inventory"


def _inspect_each(
    dives: "Sequence[Sequence[FoundDive]]",
    look: "Callable[[Sequence[FoundDive]], Inventory]",
    verbose: int,
    show: "Callable[[Sequence[FoundDive], Inventory], str] | None" = None,
) -> "tuple[list[_Inspected], int]":
    """Inspect dives and print each; return those that could be read, and the exit code of the others."""
    code = 0
    inspected: list[_Inspected] = []
    for files in dives:
        try:
            inventory = look(files)
        except Exception as error:
            code = max(code, log_failure(error, verbose))
            continue
        if show is not None:
            if inspected:
                write_stdout("\n")
            write_stdout(show(files, inventory))
        inspected.append(_Inspected([file.path for file in files], inventory))
    return inspected, code


def _settings_without_code(
    layers: "SettingsLayers", found: "Sequence[FoundDive]"
) -> "dict[Path | None, Config]":
    """Load the settings by the files of dives' own; say which of them are left out, since they name code."""
    configs = {}
    loaded = layers.load_each([dive.settings for dive in found], report=log_info)
    for file, given in loaded.by_file.items():
        if given.code:
            names = ", ".join(given.code)
            log_to_stderr(f"info: inspect runs no code from the settings; ignored: {names}")
        configs[file] = given.without_code()
    return configs


def _as_dives(found: "Sequence[FoundDive]", *, one_dive: bool) -> "list[Sequence[FoundDive]]":
    """Return the files of each dive."""
    if one_dive:
        return [found]
    return [[dive] for dive in found]


def _typed(
    files: "Sequence[FoundDive]",
    layers: "SettingsLayers",
    *,
    one_dive: bool,
    allow_damaged: bool,
) -> str:
    """Return logs and options with which other commands read a dive as this one did."""
    words = []
    for file in files:
        words.append(shown_url(file.url) if file.url else str(file.path))  # without secrets
    if one_dive:
        words.append("--one-dive")
    if layers.preset:
        words += ["--preset", layers.preset]
    for path in layers.files_with(files[0].settings):
        words += ["-c", str(path)]
    for setting in layers.overrides:
        words += ["--set", setting]
    if allow_damaged:
        words.append("--allow-damaged")
    return shlex.join(words)


def _write_inventories(inspected: "Sequence[_Inspected]", *, is_list: bool) -> None:
    """Write what is in the dives as JSON: a list of several, also if some of them cannot be read."""
    from insdvl_replay.core.report import as_json

    inventories = [one.inventory for one in inspected]
    if is_list:
        write_stdout(as_json(inventories).decode())
        return
    for inventory in inventories:
        write_stdout(as_json(inventory).decode())


def _propose(
    target: Path,
    dives: "Sequence[Sequence[Path]]",
    given: "Given",
    *,
    allow_damaged: bool,
    force: bool,
) -> None:
    """Write settings, and print on stderr what the user must decide."""
    from insdvl_replay.cli.screen import compiling, progress
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.inspection.automatic import settings_file
    from insdvl_replay.results.folder import result_file

    with progress("finding the settings", remark=compiling()):
        proposed = settings_file(dives, given, allow_damaged=allow_damaged)
    with result_file(target, force=force) as path:
        path.write_text(proposed.text, "utf-8")
        load_config(file=path)  # checks that it can be read back
    log_to_stderr(f"wrote {target}")
    log_findings(proposed.notes, target)
    if proposed.failure is not None:
        log_to_stderr(f"blocker: {proposed.failure.message}; hint: {proposed.failure.hint}")
    if proposed.missing:
        log_to_stderr(
            f"without a value in {target}: {' '.join(f'--set {key}=...' for key in proposed.missing)}"
        )


# --- calibrate


def calibrate(
    logs: opt.Logs,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write the result as settings for -c."
        ),
    ] = None,
    page_file: Annotated[
        Path | None,
        typer.Option(
            "--page", metavar="FILE", help="Write the result with pictures as one HTML page."
        ),
    ] = None,
    config: opt.ConfigFiles = [],
    no_config: opt.NoConfig = False,
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    only: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Some of arm, mounting, delay, scale and noise, separated by commas (default: all).",
        ),
    ] = None,
    reference: Annotated[
        bool,
        typer.Option(
            "--reference", help="Compare with the dives' references, and calibrate these, too."
        ),
    ] = False,
    delays: Annotated[
        Literal["each", "one"],
        typer.Option("--delays", help="A delay for each dive, or one for all."),
    ] = "each",
    mounting: Annotated[
        Literal["known", "unknown"],
        typer.Option("--mounting", help="If unknown, 24 mountings are tried first."),
    ] = "known",
    hold_out: Annotated[
        list[str],
        typer.Option(
            "--hold-out",
            metavar="SHARE|DIVE",
            help="Test dives that are not used in the fit: a share, or names.",
        ),
    ] = [],
    even_if_worse: Annotated[
        bool,
        typer.Option(
            "--even-if-worse", help="Also write estimates that are worse on held-out dives."
        ),
    ] = False,
    format_: opt.PrintedAs = "table",
    allow_damaged: opt.AllowDamaged = False,
    offline: opt.Offline = False,
    allow_code: opt.AllowCode = False,
    one_dive: opt.OneDive = False,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> int:
    """Estimate the DVL's geometry and the sensors' noise.

    The geometry is lever arm, mounting, delay and scale. The estimate uses the innovations of the dives and needs no
    reference. It needs turns and changes of speed. Parameters that the dives cannot determine are left unchanged.
    Nothing is applied: -o writes settings for `run -c`. They leave out what is worse on held-out dives: a geometry with
    more drift without DVL, or a noise with a worse NIS. -v also prints the correlations. The exit code is 0 if
    something was estimated, and 3 if nothing was or a log cannot be used.

    \b
    Example:
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml -o calibrated.toml
      insdvl-replay run dives/*.mcap -c vehicle.toml -c calibrated.toml
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml --hold-out 0.3 --page found.html
      insdvl-replay calibrate dives/*.mcap -c vehicle.toml --reference -o calibrated.toml
      insdvl-replay calibrate archive --only arm,delay --mounting unknown
    """
    from insdvl_replay.batch.calibrate import Asked, calibrate_logs
    from insdvl_replay.batch.dive_paths import find_dives, shared_settings
    from insdvl_replay.batch.local_settings import with_local_settings
    from insdvl_replay.calibration.dives import require_groups
    from insdvl_replay.calibration.output import calibration_result
    from insdvl_replay.cli.screen import (
        CALIBRATION,
        compiling,
        fetch_with_progress,
        log_settings,
        progress,
        written,
    )
    from insdvl_replay.core.settings_layers import SettingsLayers
    from insdvl_replay.document.render import render
    from insdvl_replay.results.folder import require_replaceable_file, result_file

    layers = SettingsLayers(preset, config, settings, allow_code)
    logs_found = with_local_settings(find_dives(logs), layers, is_wanted=not no_config)
    own = shared_settings(logs_found, "calibrate")
    log_settings(logs_found)
    resolved = layers.load(own, report=log_info)
    names = None if only is None else only.split(",")
    asked = Asked(
        require_groups(names, reference=reference),
        hold_out,
        reference,
        one_delay=delays == "one",
        mounting_unknown=mounting == "unknown",
    )
    for file in (output, page_file):
        if file is not None:
            require_replaceable_file(file, force=force)
    logs_found = fetch_with_progress(logs_found, offline=offline)
    codes = [0]

    def failed(error: Exception) -> None:
        codes.append(log_failure(error, verbose))

    with progress("calibrating", CALIBRATION, compiling()):
        dives = _as_dives(logs_found, one_dive=one_dive)
        calibrated = calibrate_logs(dives, resolved, asked, failed, allow_damaged=allow_damaged)
    if calibrated is None:
        return max(codes)
    for name, note in calibrated.notes:
        log_notes([note.about(name)], verbose=verbose > 0)
    lay_out = partial(
        calibration_result,
        calibrated.dives.found,
        calibrated.dives.config,
        "" if output is None else str(output),
        _options_of_settings(preset, config, own),
        even_if_worse=even_if_worse,
    )
    write_stdout(written(lay_out(verbose=verbose > 0), format_))
    contents: dict[Path, str] = {}
    if page_file is not None:
        contents[page_file] = render(lay_out(calibrated.figures()), "html")
    if output is not None and calibrated.is_found:
        contents[output] = calibrated.settings(even_if_worse=even_if_worse)
    # Both files, or none if the work is interrupted.
    with ExitStack() as stack:
        for file, content in contents.items():
            stack.enter_context(result_file(file, force=force)).write_text(content, "utf-8")
    for file in contents:
        log_to_stderr(f"wrote {file}")
    if not calibrated.is_found:
        raise LogError(
            "nothing could be estimated from these dives",
            "record a dive with turns at speed, changes of speed, roll and pitch",
        )
    return max(codes)


def _options_of_settings(preset: str | None, files: Sequence[Path], own: Path | None) -> str:
    """Write the options with which `run` has the same settings: the preset, and the files or the dives' own file."""
    from insdvl_replay.batch.local_settings import as_typed

    words = []
    if preset is not None:
        words += ["--preset", preset]
    if own is not None and not files:
        files = [own]
    for file in files:
        words += ["-c", as_typed(file)]
    return shlex.join(words)


# --- study

study = typer.Typer(rich_markup_mode=None, no_args_is_help=True)
Png = Annotated[bool, typer.Option("--png", help="Also draw the pictures as PNG.")]

StudyOutput = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="DIR", help="Output folder; each study gets a subfolder."
    ),
]


@study.callback()
def about_studies() -> None:
    """Run a Monte Carlo, window or observability study.

    Each study writes tables as CSV, and pictures.
    """


@study.command(cls=opt.PlainCommand)
def montecarlo(
    scenario: opt.Scenario,
    runs: Annotated[
        int, typer.Option(metavar="N", min=2, help="Number of simulated dives.")
    ] = 100,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Random seed of the study.")] = 1,
    run: Annotated[
        int | None,
        typer.Option(metavar="K", min=1, help="Repeat only run K, counted from 1, and print it."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", help="Duration in s (default: that of the scenario)."),
    ] = None,
    imu: Annotated[
        str,
        typer.Option(
            metavar="GRADE",
            help="Sensor errors: matched (as the first filter assumes), fog, tactical or mems.",
        ),
    ] = "matched",
    outage: opt.Outages = [],
    jobs: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of parallel runs (default: one per core)."),
    ] = None,
    output: StudyOutput = Path("study"),
    png: Png = False,
    config: opt.ConfigFiles = [],
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    format_: opt.PrintedAs = "table",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Simulate a dive many times and compare the filters' uncertainty with their true errors.

    Every run draws its own sensor errors and start error. For each filter and state: sigma from P, sigma and mean over
    the runs, NEES with its interval, and predicted and true improvement. With --outage also NEES before, in and after
    each outage.

    \b
    Example:
      insdvl-replay study montecarlo lawnmower
      insdvl-replay study montecarlo lawnmower --preset mems --outage 300:480
      insdvl-replay study montecarlo straight --imu fog --preset fog --runs 200
      insdvl-replay study montecarlo straight --run 17
    """
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.studies.montecarlo import repeat_run, study_montecarlo

    resolved = load_config(preset, config, settings)
    outages = opt.outage_spans(outage)
    asked: dict[str, Any] = {"seed": seed, "duration_s": duration, "imu": imu, "outages": outages}
    if run is not None:
        from insdvl_replay.cli.screen import written

        write_stdout(written(repeat_run(scenario, resolved, run, **asked), format_))
        return
    target = output / f"montecarlo-{scenario}"
    folder = _study_folder(target, f"simulating {scenario}", force=force, png=png)
    result = folder.keep(
        lambda: study_montecarlo(scenario, resolved, runs=runs, jobs=jobs, **asked)[0]
    )
    _print_study(result, folder, format_, verbose)


@study.command(cls=opt.PlainCommand)
def window(
    logs: opt.Logs,
    longest: Annotated[
        int,
        typer.Option(
            "--longest",
            metavar="N",
            min=2,
            max=1000,
            help="Try windows of 2 to N velocities.",
        ),
    ] = 10,
    start: opt.Start = None,
    end: opt.End = None,
    jobs: Annotated[
        int, typer.Option("--jobs", metavar="N", min=1, help="Number of dives in parallel.")
    ] = 1,
    output: StudyOutput = Path("study"),
    png: Png = False,
    config: opt.ConfigFiles = [],
    no_config: opt.NoConfig = False,
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    format_: opt.PrintedAs = "table",
    offline: opt.Offline = False,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> int:
    """Find the number of past velocities that makes the best acceleration.

    The slope of the DVL's velocities is compared with the acceleration of the reference, at the middle and at the end
    of the window, with the lever arm compensated and ignored. Several logs are pooled, and each also has its own rows.
    A log that cannot be used does not stop the others.

    \b
    Example:
      insdvl-replay study window dives/*.mcap -c vehicle.toml
      insdvl-replay study window dive.mcap --longest 20
    """
    from insdvl_replay.batch.dive_paths import find_dives, shared_settings
    from insdvl_replay.batch.local_settings import with_local_settings
    from insdvl_replay.batch.studies import window_study
    from insdvl_replay.cli.screen import fetch_with_progress, log_settings
    from insdvl_replay.core.settings_layers import SettingsLayers

    given = [*settings, *opt.span_settings(start, end)]
    layers = SettingsLayers(preset, config, given, allow_code=True)
    found = with_local_settings(find_dives(logs), layers, is_wanted=not no_config)
    own = shared_settings(found, "study window")
    log_settings(found)
    resolved = layers.load(own).without_code()
    found = fetch_with_progress(found, offline=offline)
    folder = _study_folder(output / "window", "comparing accelerations", force=force, png=png)

    def failed(error: UserError) -> None:
        log_failure(error, verbose)

    done = window_study(found, resolved, longest, folder, failed, jobs=jobs)
    if done.result is not None:
        _print_study(done.result, folder, format_, verbose)
    if done.left_out:
        which = f"{len(done.left_out)} of {done.studied} logs"
        first = done.left_out[0].text
        log_to_stderr(f"error: {which} could not be used; the first: {first}")
    return done.exit_code


@study.command(cls=opt.PlainCommand)
def observability(
    dive: Annotated[
        str, typer.Argument(metavar="LOG|SCENARIO", help="A log, or the name of a scenario.")
    ],
    start: opt.Start = None,
    end: opt.End = None,
    no_earth_rate: Annotated[
        bool, typer.Option("--no-earth-rate", help="Assume a flat Earth that does not rotate.")
    ] = False,
    output: StudyOutput = Path("study"),
    png: Png = False,
    config: opt.ConfigFiles = [],
    no_config: opt.NoConfig = False,
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    format_: opt.PrintedAs = "table",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Find which errors at the start of a dive its measurements can observe, and which they cannot.

    For velocities, accelerations in both models, and both together: rank, singular values, and the unobservable
    directions with names and numbers.

    \b
    Example:
      insdvl-replay study observability straight --no-earth-rate
      insdvl-replay study observability dive.mcap --start 60 --end 180
    """
    from insdvl_replay.batch.found import FoundDive
    from insdvl_replay.batch.local_settings import with_local_settings
    from insdvl_replay.cli.screen import log_settings
    from insdvl_replay.core.dive_record import dive_name
    from insdvl_replay.core.settings_layers import SettingsLayers
    from insdvl_replay.studies.observability import study_observability

    given = [*settings, *opt.span_settings(start, end)]
    layers = SettingsLayers(preset, config, given, allow_code=True)
    is_log = Path(dive).exists()  # else the name of a scenario
    [found] = with_local_settings(
        [FoundDive(Path(dive))], layers, is_wanted=is_log and not no_config
    )
    log_settings([found])
    resolved = layers.load(found.settings).without_code()
    target = output / f"observability-{dive_name(Path(dive))}"
    folder = _study_folder(target, "stacking the measurements", force=force, png=png)
    result = folder.keep(lambda: study_observability(dive, resolved, earth_rate=not no_earth_rate))
    _print_study(result, folder, format_, verbose)


def _study_folder(
    target: Path,
    text: str,
    *,
    force: bool,
    png: bool,
) -> "StudyFolder":
    """Return where a study is stored; its progress is shown with a text."""
    from insdvl_replay.batch.studies import StudyFolder
    from insdvl_replay.cli.screen import compiling, progress

    return StudyFolder(target, force, png, lambda: progress(text, remark=compiling()))


def _print_study(
    result: "Result",
    folder: "StudyFolder",
    format_: opt.Format,
    verbose: int,
) -> None:
    """Print a study that was stored, its notes and its folder."""
    from insdvl_replay.cli.screen import written

    write_stdout(written(result, format_))
    log_notes(result.notes, verbose=verbose > 0)
    log_to_stderr(f"wrote {folder.path}")
