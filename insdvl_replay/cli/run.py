"""``insdvl-replay run``. Slow imports wait until there is work to do."""

import os
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.core.errors import ConfigError, LogError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from contextlib import AbstractContextManager

    from insdvl_replay.batch.jobs import Outcome, ReplayJob
    from insdvl_replay.calibration.found import Given
    from insdvl_replay.core.config import Config
    from insdvl_replay.core.report import Report
    from insdvl_replay.show.answers import Failure

_BEGINNING = 1000  # bytes at the start of a file that identify an overview of this tool


def run(
    logs: opt.Logs,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Output folder; each log gets a subfolder with its name.",
        ),
    ] = Path("replay"),
    config: opt.ConfigFiles = [],
    preset: opt.Preset = None,
    start: opt.Start = None,
    end: opt.End = None,
    settings: opt.Settings = [],
    auto: Annotated[
        bool,
        typer.Option(
            "--auto/--no-auto",
            help="If a log needs settings and none are given, find them, or stop.",
        ),
    ] = True,
    starts: Annotated[
        int | None,
        typer.Option(
            metavar="K",
            min=1,
            help="Drawn starts of each filter, for convergence (default: evaluation.starts, 16).",
        ),
    ] = None,
    format_: Annotated[opt.PageFormat, typer.Option("--format", help="Output format.")] = "table",
    tables: opt.ChosenTables = [],
    allow_damaged: opt.AllowDamaged = False,
    offline: opt.Offline = False,
    allow_code: opt.AllowCode = False,
    one_dive: opt.OneDive = False,
    assay: Annotated[
        bool,
        typer.Option(
            "--assay",
            help="Also replay the baseline with planted faults: what could these dives have shown?",
        ),
    ] = False,
    control: Annotated[
        bool,
        typer.Option(
            "--control", help="Add a filter `tuned`: the baseline with its noise fitted to the log."
        ),
    ] = False,
    tum: Annotated[
        bool,
        typer.Option(
            "--tum", help="Also write trajectories for evo: filter_NAME.tum and reference.tum."
        ),
    ] = False,
    kml: Annotated[
        bool, typer.Option("--kml", help="Also write all tracks as tracks.kml, for Google Earth.")
    ] = False,
    geojson: Annotated[
        bool,
        typer.Option(
            "--geojson", help="Also write all tracks as tracks.geojson, for QGIS and web maps."
        ),
    ] = False,
    history: Annotated[
        Literal["csv", "parquet"] | None,
        typer.Option("--history", help="Also write the full history of each filter."),
    ] = None,
    lake: Annotated[
        Path | None,
        typer.Option(
            "--lake",
            metavar="DIR",
            help="Also write the evidence of each dive into this folder, a Parquet dataset of many runs.",
        ),
    ] = None,
    against: Annotated[
        list[str],
        typer.Option(
            "--against",
            metavar="KEY=VALUE",
            help="Also replay with this setting, and say whether it helped. Several of them are one change.",
        ),
    ] = [],
    fail_on: opt.FailOn = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 3 if there is any warning.")
    ] = False,
    jobs: opt.Jobs = 1,
    scheduler: opt.Scheduler = None,
    rerun: opt.Rerun = False,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
    color: opt.Colored = "auto",
) -> int:
    """Replay dives through the configured filters.

    The screen shows the verdict of each filter and the evidence for it. -v prints all tables, --table one of them.

    Each log gets a folder with report.html, CSV tables, report.json, replay.mcap and the settings. Several logs also
    get a summary.csv and an index.html with links to each dive.

    A log that cannot be used does not stop the others. A dive is replayed only if its log, the settings or the
    versions have changed since its last result.

    Without -c, a log that cannot be replayed as it is gets settings: topics, units, axes, noise and geometry are tried
    and calibrated; what --set or --preset gives stays. stderr says what was found or assumed. vehicle.toml in the
    result holds these settings for -c.

    Noise that neither --preset nor -c nor --set gives is fitted to the dives together, by the class of their IMU and
    the innovations. A line says which noise it is. `--preset levy-klein` is the paper's.

    --against KEY=VALUE replays each dive twice, without and with the setting, into the folders before and after. It
    prints for each filter whether the setting helped, as `compare` does.

    \b
    Example:
      insdvl-replay run dive.mcap
      insdvl-replay run dives/*.mcap -o results -c vehicle.toml --format md
      insdvl-replay run sensors.mcap gnss.mcap --one-dive
      insdvl-replay run archive --jobs 4
      insdvl-replay run dive.mcap --table evidence --format csv
      insdvl-replay run dives/*.mcap --table pooled --table summary --format latex > tables.tex
      insdvl-replay run dive.mcap --tum --kml --geojson
      insdvl-replay run dive.mcap --start 60 --set filters.aided.acceleration.window=5
      insdvl-replay run dives/*.mcap -c vehicle.toml --against dvl.beam_sd_mps=0.006
      insdvl-replay run archive --lake lake
    """
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.batch.jobs import ReplayOptions, plan_both_sides, plan_jobs
    from insdvl_replay.cli.messages import (
        is_finding,
        log_failure,
        log_findings,
        log_info,
        log_notes,
        log_to_stderr,
        own_findings,
        write_stdout,
    )
    from insdvl_replay.cli.screen import fetch_with_progress, written
    from insdvl_replay.core.config_file import changed_by, given_keys
    from insdvl_replay.core.errors import Note, visible
    from insdvl_replay.core.report import Report
    from insdvl_replay.document.parts import Part
    from insdvl_replay.results.folder import PAGE, VEHICLE_FILE, require_parquet, result_file
    from insdvl_replay.results.stored_results import earlier_results
    from insdvl_replay.show.answers import Failure
    from insdvl_replay.show.dive import (
        TOGETHER,
        dive_document,
        replay_result,
        require_tables,
        tables_named,
    )
    from insdvl_replay.show.dives import INDEX, OVERVIEWS, overview_parts
    from insdvl_replay.show.screens import dive_screen, dives_screen, quiet_lines

    if history == "parquet":
        require_parquet("--history parquet", "--history csv")
    require_tables(tables)
    given = [*settings, *opt.span_settings(start, end, starts)]
    load = partial(_settings, preset, config, given, allow_code)
    # One of these options keeps a run without settings from searching for some.
    blocked_by = (
        "--against" if against else "--control" if control else "--scheduler" if scheduler else ""
    )
    is_free = auto and not config
    options = ReplayOptions(
        load(report=log_info),
        allow_damaged=allow_damaged,
        control=control,
        assay=assay,
        tracks=("tum",) * tum + ("kml",) * kml + ("geojson",) * geojson,
        history_format=history or "",
        require_fit=is_free and not blocked_by,
        blocked_by=blocked_by if is_free else "",
        given=given_keys(preset, config, settings) if is_free else frozenset(),
    )
    found = find_dives(logs)
    configs = {file: load(file) for file in {dive.settings for dive in found}}
    changed = _changed_settings(load, configs, against, fail_on, tables, strict=strict)
    if changed:
        from insdvl_replay.batch.fitted_noise import with_same_noise
        from insdvl_replay.cli.against import answer_against

        both = options, replace(options, config=changed.get(None, options.config))
        sides = plan_both_sides(
            fetch_with_progress(found, offline=offline),
            output,
            both,
            (configs, changed),
            one_dive=one_dive,
        )
        (old, before), (new, after) = sides
        before, after = with_same_noise(
            before,
            after,
            lambda _, config: changed_by(config, against, allow_code=allow_code),
            force=force,
            rerun=rerun,
            while_fitting=_while_fitting,
        )
        sides = ((old, before), (new, after))
        dives = [*before, *after]
        replays = outcomes(dives, jobs, scheduler, force=force, rerun=rerun, quiet=quiet, lake=lake)
        return answer_against(sides, replays, fail_on, format_, verbose, quiet=quiet)
    dives = plan_jobs(
        fetch_with_progress(found, offline=offline), output, options, configs, one_dive=one_dive
    )
    alone = len(dives) == 1
    # Tables over all dives are printed once all are done, and so is what cannot be printed dive by dive.
    at_the_end = format_ in ("json", "csv", "html") or set(tables) in (
        {*TOGETHER},
        *({name} for name in TOGETHER),
    )
    _require_overviews(dives, output, tables, force=force)
    # With the screen, stderr names each result and warning only if it is not the same terminal.
    shows_screen = format_ == "table" and not (tables or verbose or quiet)
    talks = not (quiet or (shows_screen and sys.stderr.isatty()))

    # For several dives, the screen is printed once all are done, and so are the lines of a quiet run.
    brief = quiet and format_ == "table"
    prints_each = not brief and (not (at_the_end or shows_screen) or (alone and not tables))

    def shown(report: Report, target: Path) -> str:
        parts: Sequence[Part] = tables_named(report, *tables)
        if not tables:
            parts = (
                dive_screen(report, str(target / PAGE)) if shows_screen else dive_document(report)
            )
        return written(replay_result(report, parts, tables), format_)

    reports: list[Report | Failure] = []
    codes: dict[str, int] = {}
    unchanged = 0
    explained = False
    said = set[tuple[Note, ...]]()  # what was found of the vehicle, or of several
    replays = outcomes(dives, jobs, scheduler, force=force, rerun=rerun, quiet=quiet, lake=lake)
    with closing(
        replays
    ):  # an interrupt may come here, and the workers must end before this process
        for outcome in replays:
            name = outcome.job.target.name
            target = outcome.job.target
            report = outcome.result
            if isinstance(report, Exception):
                reports.append(Failure(name, str(report)))
                codes[name] = log_failure(report, verbose)
                continue
            reports.append(report)
            unchanged += outcome.unchanged
            findings = tuple(own_findings(report.notes) or filter(is_finding, report.notes))
            if not quiet and findings not in said:
                said.add(findings)
                log_findings(findings, target / VEHICLE_FILE)
            if talks or (alone and not quiet):
                warned = [note for note in report.notes if not is_finding(note)]
                log_notes(warned, verbose=verbose > 0, dive="" if alone else name)
                if verbose and report.notes and not explained:
                    log_to_stderr("`insdvl-replay explain CODE` tells more about a note")
                    explained = True
            _log_cpu_s(report.tool.cpu_s, verbose)
            if talks or (outcome.unchanged and alone and not quiet):
                log_to_stderr(f"{'unchanged' if outcome.unchanged else 'wrote'} {target}")
            if prints_each:
                write_stdout(shown(report, target))
            codes[name] = _strict_code(name, report, verbose) if strict else 0
    if brief:
        write_stdout("".join(f"{visible(line)}\n" for line in quiet_lines(reports)))
    elif tables:
        write_stdout(_tables_of_all(reports, tables, format_, at_the_end=at_the_end))
    if alone:
        return max(codes.values())

    output.mkdir(parents=True, exist_ok=True)
    for overview, (write, _) in OVERVIEWS.items():
        with result_file(output / overview, force=True) as file:
            file.write_bytes(write(reports))
        if talks:
            log_to_stderr(f"wrote {output / overview}")
    log_notes(earlier_results(output, codes), verbose=False)
    if unchanged and not (quiet or talks):
        log_to_stderr(f"unchanged: {unchanged} of {len(dives)} dives")
    if not tables and (not quiet or format_ in ("json", "csv", "html")):
        last = (
            dives_screen(reports, str(output / INDEX))
            if format_ == "table"
            else overview_parts(reports)
        )
        done = [report for report in reports if isinstance(report, Report)]
        write_stdout(written(replay_result(done, last), format_))
    if failed := [name for name, code in codes.items() if code]:
        first = next(
            (f"; the first: {report.reason}" for report in reports if isinstance(report, Failure)),
            "",
        )
        log_to_stderr(
            f"error: {len(failed)} of {len(codes)} logs failed: {', '.join(failed)}{first}"
        )
    return max(codes.values())


def _log_cpu_s(cpu_s: "Mapping[str, float]", verbose: int) -> None:
    """Report how many processor seconds one run of each filter over the dive took, if verbose."""
    from insdvl_replay.cli.messages import log_to_stderr

    if verbose and cpu_s:
        times = ", ".join(f"{name} {seconds:.3g} s" for name, seconds in cpu_s.items())
        log_to_stderr(f"processor time of one run over the dive: {times}")


def _strict_code(name: str, report: "Report", verbose: int) -> int:
    """Return the exit code of a dive that may have no warnings."""
    from insdvl_replay.cli.messages import log_failure

    warnings = [note.code for note in report.notes if note.severity == "warning"]
    if not warnings:
        return 0
    found = f"{name}: --strict allows no warnings, found {', '.join(warnings)}"
    return log_failure(
        LogError(found, "the result was written; leave --strict out to accept it"), verbose
    )


def _settings(
    preset: str | None,
    config: list[Path],
    given: list[str],
    allow_code: bool,
    own: Path | None = None,
    **options: Any,
) -> "Config":
    """Resolve the settings, or those of a dive that has some of its own."""
    from insdvl_replay.core.config_file import load_config

    return load_config(
        preset, opt.settings_files(own, config), given, allow_code=allow_code, **options
    )


def _changed_settings(
    load: "Callable[..., Config]",
    configs: "dict[Path | None, Config]",  # by the file of settings of a dive's own
    against: list[str],
    fail_on: str | None,
    tables: list[str],
    *,
    strict: bool,
) -> "dict[Path | None, Config]":
    """Return the settings changed by ``--against``; empty without it. It is an error if that changes no dive."""
    from msgspec.structs import replace as with_values

    if not against:
        if fail_on is not None:
            raise ConfigError(
                "--fail-on: works with --against only",
                "`insdvl-replay compare OLD NEW --fail-on worse`",
            )
        return {}
    changed = {
        file: load(file, against=against) for file in configs
    }  # whose noise is not fitted yet
    if changed == configs:
        raise ConfigError(f"--against {against[-1]}: is the setting already", "give another value")
    unheeded = [
        config.dvl.beam_sd_mps
        for file, config in configs.items()
        if with_values(changed[file].dvl, velocity_sd_mps=config.dvl.velocity_sd_mps) == config.dvl
        and with_values(changed[file], dvl=config.dvl) == config
    ]
    if None not in unheeded and len(unheeded) == len(configs):
        text = f"--against {against[-1]}: has no effect, since dvl.beam_sd_mps = {unheeded[0]:g} decides"
        raise ConfigError(text, "change dvl.beam_sd_mps, or add --against dvl.beam_sd_mps=none")
    if tables or strict:
        option = "--table" if tables else "--strict"
        raise ConfigError(
            f"--against: does not work with {option}", "use `insdvl-replay compare` afterwards"
        )
    return changed


def _while_fitting() -> "AbstractContextManager[object]":
    """Show on a terminal that a noise is fitted."""
    from insdvl_replay.cli.screen import REPLAY, compiling, progress

    return progress("fitting the noise", REPLAY, compiling())


def _tables_of_all(
    reports: "Sequence[Report | Failure]", tables: list[str], format_: str, *, at_the_end: bool
) -> str:
    """Return the named tables over all dives, after those of each dive if these are printed at the end, too."""
    from insdvl_replay.cli.screen import written
    from insdvl_replay.core.report import Report
    from insdvl_replay.document.parts import Heading, Part
    from insdvl_replay.show.dive import TOGETHER, tables_named
    from insdvl_replay.show.dives import named_result

    parts: list[Part] = []
    for report in reports if at_the_end else ():
        if isinstance(report, Report):
            parts += [Heading(report.log.name), *tables_named(report, *tables)]
    is_wanted = at_the_end or not set(tables).isdisjoint(TOGETHER)
    if is_wanted:
        return written(named_result(reports, tables, parts), format_)
    return ""


def _require_overviews(
    dives: "Sequence[ReplayJob]", output: Path, tables: list[str], *, force: bool
) -> None:
    """Raise if an overview cannot be written. A file with its name that is no overview is not replaced."""
    from insdvl_replay.results.folder import require_replaceable_file
    from insdvl_replay.show.dives import OVERVIEWS

    if len(dives) == 1:
        if "pooled" in tables:
            raise ConfigError(
                f"--table pooled: {dives[0].name} is one dive", "name two dives or more"
            )
        return
    for name, (_, beginning) in OVERVIEWS.items():
        path = output / name
        for dive in dives:
            if dive.target == path:
                raise ConfigError(
                    f"{dive.name}: its results would have the name of an overview",
                    "rename it, or replay it alone",
                )
        if os.path.lexists(path):
            if path.is_symlink() or not path.is_file():
                raise ConfigError(
                    f"{path}: is a link or a folder, and is not replaced", f"rm {path}"
                )
            require_replaceable_file(
                path, force=force or beginning in path.read_bytes()[:_BEGINNING]
            )


def outcomes_without_settings(
    dives: "Sequence[ReplayJob]", jobs: int, *, force: bool, rerun: bool
) -> "Generator[Outcome, None, None]":
    """Replay the dives of a vehicle that can be replayed as they are; find settings for the others together."""
    from insdvl_replay.batch.fitted_noise import with_fitted_noise
    from insdvl_replay.batch.jobs import known_reports
    from insdvl_replay.calibration.found import Given
    from insdvl_replay.cli.messages import is_finding
    from insdvl_replay.cli.screen import REPLAY, compiling, progress
    from insdvl_replay.core.errors import Note, UserError
    from insdvl_replay.core.words import Severity
    from insdvl_replay.inspection.automatic import find_settings, stored_settings
    from insdvl_replay.preparation.run import MisfitError

    def with_options(dives: "Sequence[ReplayJob]", **changes: object) -> "list[ReplayJob]":
        changed = replace(dives[0].options, require_fit=False, **changes)  # type: ignore[arg-type]
        return [replace(dive, options=changed) for dive in dives]

    def stored_report(dive: "ReplayJob", config: "Config | None") -> "Report | None":
        if config is None:
            return None
        plain = with_options([dive], config=config, tracks=(), history_format="")
        return known_reports(plain, force=True).get(dive.target)

    options = dives[0].options
    given = Given(options.config, options.given)
    stored = [stored_settings(dive.target, given) for dive in dives]
    reports = [stored_report(dive, config) for dive, config in zip(dives, stored, strict=True)]
    if not rerun and _are_known(stored, reports):
        same = list["ReplayJob"]()
        for dive, config, report in zip(dives, stored, reports, strict=True):
            earlier = report or reports[0]
            found_before = tuple(filter(is_finding, earlier.notes if earlier else ()))
            same += with_options([dive], config=config, found=found_before)
        yield from outcomes_as_planned(same, jobs, None, force=force, rerun=rerun)
        return
    unknown = [dive for dive, report in zip(dives, reports, strict=True) if report is None]
    known_reports(
        unknown, force=force, rerun=rerun
    )  # results that may not be replaced stop it before any work is done
    # Settings that were found for other dives than these are found again, and replace those.
    force = force or all(
        not dive.target.exists() or report for dive, report in zip(dives, reports, strict=True)
    )
    unfitted = dives
    dives = with_fitted_noise(dives, force=force, rerun=rerun, while_fitting=_while_fitting)
    (first,) = outcomes_as_planned(dives[:1], 1, None, force=force, rerun=rerun)
    if not _needs_settings(first):
        yield first
        others = list["ReplayJob"]()
        for outcome in (
            outcomes_as_planned(dives[1:], jobs, None, force=force, rerun=rerun)
            if dives[1:]
            else ()
        ):
            if _needs_settings(outcome):
                others += [dive for dive in unfitted if dive.target == outcome.job.target]
            else:
                yield outcome
        if others:
            yield from outcomes_without_settings(others, jobs, force=force, rerun=rerun)
        return
    try:
        with progress("finding the settings", REPLAY, compiling()):
            found = find_settings(
                [dive.logs for dive in dives], given, allow_damaged=options.allow_damaged
            )
    except UserError as error:
        if isinstance(first.result, MisfitError):
            text = f"no settings were found: {error.message}. The default settings are used, which nobody has chosen"
            note = Note("found_nothing", text, 1, Severity.WARNING, error.hint)
            planned = with_options(unfitted, found=(note,))
            yield from outcomes_as_planned(planned, jobs, None, force=force, rerun=rerun)
            return
        yield replace(first, result=error)
        if unfitted[1:]:
            yield from outcomes_without_settings(unfitted[1:], jobs, force=force, rerun=rerun)
        return
    found_for = with_options(dives, config=found.config, found=found.notes, vehicle=found.text)
    yield from _outcomes_by_groups(found_for, given, found.config, jobs, force=force, rerun=rerun)


def _are_known(stored: "Sequence[Config | None]", reports: "Sequence[Report | None]") -> bool:
    """Return whether an earlier run found the settings of all dives: those of the first, or some of their own."""
    from insdvl_replay.cli.messages import own_findings

    if reports[0] is None:
        return False
    for config, report in zip(stored, reports, strict=True):
        has_own = report is not None and bool(own_findings(report.notes))
        if config != stored[0] and not has_own:
            return False
    return True


def _outcomes_by_groups(
    dives: "Sequence[ReplayJob]",
    given: "Given",
    common: "Config",
    jobs: int,
    *,
    force: bool,
    rerun: bool,
) -> "Generator[Outcome, None, None]":
    """Replay the dives of a vehicle; those that contradict the first one's settings get some of their own together."""
    from insdvl_replay.cli.screen import REPLAY, compiling, progress
    from insdvl_replay.core.errors import UserError
    from insdvl_replay.inspection.automatic import find_settings, settings_of_one

    outcomes = outcomes_as_planned(dives, jobs, None, force=force, rerun=rerun)
    first = next(outcomes)
    yield first
    contradicting = list["Outcome"]()
    for outcome in outcomes:
        if _contradicts(outcome, first):
            contradicting.append(outcome)
        else:
            yield outcome
    if not contradicting:
        return
    others = [outcome.job for outcome in contradicting]
    try:
        with progress("finding the settings of single dives", REPLAY, compiling()):
            allow_damaged = dives[0].options.allow_damaged
            found = find_settings(
                [dive.logs for dive in others], given, allow_damaged=allow_damaged
            )
    except UserError:
        yield from contradicting
        return
    own = list["ReplayJob"]()
    for dive in others:
        of_dive = settings_of_one(found, dive.target.name, common)
        options = replace(
            dive.options, config=of_dive.config, found=of_dive.notes, vehicle=of_dive.text
        )
        own.append(replace(dive, options=options))
    # What the common settings gave is replaced.
    yield from _outcomes_by_groups(own, given, common, jobs, force=True, rerun=rerun)


def _contradicts(outcome: "Outcome", first: "Outcome") -> bool:
    """Return whether the settings that fit the first dive of a vehicle do not fit another one."""
    from insdvl_replay.core.report import Report
    from insdvl_replay.preparation.run import MISREAD, MOST_NIS
    from insdvl_replay.show.dive import values_of

    if not isinstance(first.result, Report):
        return False
    if not isinstance(outcome.result, Report):
        return _needs_settings(outcome)
    codes, known = (
        {note.code for note in report.notes} & MISREAD for report in (outcome.result, first.result)
    )
    if codes - known:
        return True
    size, usual = (
        values_of(report, report.baseline)["nis_per_dof"]
        for report in (outcome.result, first.result)
    )
    return size > MOST_NIS >= usual


def _needs_settings(outcome: "Outcome") -> bool:
    """Return whether other settings may help: not where the result cannot be written, or where the process ends."""
    from insdvl_replay.batch.workers import WorkerLostError
    from insdvl_replay.core.errors import TargetError, UserError

    error = outcome.result
    return isinstance(error, UserError) and not isinstance(error, WorkerLostError | TargetError)


def _with_search_hint(outcome: "Outcome", hint: str) -> "tuple[Outcome, str]":
    """Return an outcome whose error has a hint if other settings may help, and a line if its settings may not fit."""
    from insdvl_replay.core.errors import UserError
    from insdvl_replay.core.report import Report
    from insdvl_replay.logs.formats.recording import open_recording
    from insdvl_replay.preparation.run import MISREAD, MOST_NIS
    from insdvl_replay.show.dive import values_of

    found = outcome.result
    if isinstance(found, UserError) and _needs_settings(outcome):
        with suppress(OSError, UserError):
            open_recording(outcome.job.logs, allow_damaged=True)  # else settings do not help
            hints = "; or ".join(filter(None, (found.hint, hint)))
            outcome = replace(outcome, result=type(found)(found.what, hints, *found.where))
    elif isinstance(found, Report):
        # As `require_fit_of`: nobody has chosen the noise of the sensors of a dive that is not simulated.
        is_simulated = any(channel.role == "truth" for channel in found.log.channels)
        is_misread = not MISREAD.isdisjoint(note.code for note in found.notes)
        if (
            is_misread
            or not is_simulated
            or values_of(found, found.baseline)["nis_per_dof"] > MOST_NIS
        ):
            return outcome, f"hint: these settings may not fit {found.log.name}: {hint}"
    return outcome, ""


def outcomes(
    dives: "Sequence[ReplayJob]",
    jobs: int,
    scheduler: str | None,
    *,
    force: bool,
    rerun: bool,
    quiet: bool = False,
    lake: Path | None = None,
) -> "Generator[Outcome, None, None]":
    """Replay what has changed, and show the progress on a terminal. All results are written into the lake."""
    from insdvl_replay.cli.messages import log_to_stderr
    from insdvl_replay.results.folder import add_to_lake, require_lake

    if lake is not None:
        require_lake(lake, {dive.target.parent for dive in dives})
    needing = [dive for dive in dives if dive.options.require_fit and dive.error is None]
    settled = [dive for dive in dives if dive not in needing]
    parts = (
        [outcomes_as_planned(settled, jobs, scheduler, force=force, rerun=rerun)] if settled else []
    )
    parts += [outcomes_without_settings(needing, jobs, force=force, rerun=rerun)] if needing else []
    is_said = quiet
    for replays in parts:
        with closing(replays):
            for outcome in replays:
                if option := outcome.job.options.blocked_by:
                    hint = f"run without {option} first; then use its vehicle.toml with -c"
                    outcome, line = _with_search_hint(outcome, hint)
                    if line and not is_said:
                        log_to_stderr(line)
                        is_said = True
                if lake is not None and not isinstance(outcome.result, Exception):
                    add_to_lake(lake, outcome.result)
                yield outcome


def outcomes_as_planned(
    dives: "Sequence[ReplayJob]", jobs: int, scheduler: str | None, *, force: bool, rerun: bool
) -> "Generator[Outcome, None, None]":
    """Replay dives with the settings of their jobs."""
    from insdvl_replay.batch.fitted_noise import with_fitted_noise
    from insdvl_replay.batch.jobs import known_reports
    from insdvl_replay.batch.runs import replay_jobs
    from insdvl_replay.batch.workers import cluster_pool, local_pool
    from insdvl_replay.cli.messages import log_notes
    from insdvl_replay.cli.screen import REPLAY, compiling, progress

    dives = with_fitted_noise(dives, force=force, rerun=rerun, while_fitting=_while_fitting)
    known = known_reports(
        dives, force=force, rerun=rerun, report_note=lambda note: log_notes([note], verbose=True)
    )
    changed = [dive for dive in dives if dive.target not in known]
    if scheduler is None:
        runs_code = any(dive.options.config.code for dive in changed)
        pool = local_pool(max(1, min(jobs, len(changed))), runs_code=runs_code)
    else:
        pool = cluster_pool(scheduler)
    replays = replay_jobs(dives, known, pool, elsewhere=scheduler is not None)
    if not changed:
        yield from replays
        return
    text = f"replay {changed[0].name.name}" if len(changed) == 1 else "replay"
    with progress(text, REPLAY, compiling()) as paused, closing(replays):
        for outcome in replays:
            with paused():
                yield outcome
