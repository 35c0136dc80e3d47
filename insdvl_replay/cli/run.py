"""``insdvl-replay run``. Slow imports wait until there is work to do."""

from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import log_info
from insdvl_replay.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from insdvl_replay.results.lake import LakeWriter

_COMPARE_AFTERWARDS = "use `insdvl-replay compare` afterwards"


def run(
    logs: opt.Logs,
    output: opt.Results = Path("replay"),
    config: opt.ConfigFiles = [],
    no_config: opt.NoConfig = False,
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
            "--control",
            help="Add a filter `tuned`: the baseline with its noise fitted to the log.",
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
    revision: Annotated[
        str,
        typer.Option(
            "--revision",
            metavar="NAME",
            show_default=False,
            help="With --lake: name this version of filters, code and settings, such as by its commit, for `history`.",
        ),
    ] = "",
    against: Annotated[
        list[str],
        typer.Option(
            "--against",
            metavar="KEY=VALUE",
            help="Also replay with this setting, and say whether it helped. Several of them are one change.",
        ),
    ] = [],
    fail_on: opt.FailOn = None,
    strict: opt.Strict = False,
    shard: opt.Shard = None,
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

    If -c is left out, insdvl-replay.toml in the folder of a dive, or the nearest above it, is used as with -c, and a
    line says so. --no-config ignores it.

    Noise that neither --preset nor -c nor --set gives is fitted to the dives together, by the class of their IMU and
    the innovations. A line says which noise it is. `--preset levy-klein` is the paper's.

    --against KEY=VALUE replays each dive twice, without and with the setting, into the folders before and after. It
    prints for each filter whether the setting helped, as `compare` does.

    --shard I/N replays one of N equal shares of the dives, on any machine. `insdvl-replay merge` makes the result of
    one run of them.

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
      insdvl-replay run archive --lake lake --revision v1.3
      insdvl-replay run archive -c vehicle.toml --shard 2/4 -o parts
    """
    from insdvl_replay.batch.against import plan_against
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.batch.jobs import ReplayOptions, plan_jobs
    from insdvl_replay.batch.local_settings import with_local_settings
    from insdvl_replay.batch.overviews import require_overviews, require_own_names
    from insdvl_replay.batch.search import outcomes, with_search, without_search
    from insdvl_replay.cli.against import answer_against
    from insdvl_replay.cli.run_screen import RunScreen, Wanted
    from insdvl_replay.cli.screen import fetch_with_progress, log_settings, replaying
    from insdvl_replay.core.settings_layers import SettingsLayers
    from insdvl_replay.results.folder import require_parquet
    from insdvl_replay.results.stored_results import dives_of_run
    from insdvl_replay.show.dive import require_tables

    if history == "parquet":
        require_parquet("--history parquet", "--history csv")
    require_tables(tables)
    _require_together(against, fail_on, tables, strict=strict)
    if shard is not None:
        _require_shared(against, tables, format_, one_dive=one_dive)
    added = _lake_writer(lake, revision, against)
    given = [*settings, *opt.span_settings(start, end, starts)]
    layers = SettingsLayers(preset, config, given, allow_code)
    found = with_local_settings(find_dives(logs), layers, is_wanted=not no_config)
    log_settings(found, quiet=quiet)
    loaded = layers.load_each([dive.settings for dive in found], report=log_info)
    options = ReplayOptions(
        loaded.usual,
        allow_damaged=allow_damaged,
        control=control,
        assay=assay,
        tracks=_tracks(tum=tum, kml=kml, geojson=geojson),
        history_format=history or "",
    )
    if auto and not config:
        options = with_search(options, layers, _blocking(against, scheduler, control=control))
    how = replaying(jobs, scheduler, force=force, rerun=rerun, quiet=quiet)
    wanted = Wanted(format_, tables, verbose, quiet, strict)
    fetch = partial(fetch_with_progress, offline=offline)
    if shard is not None:
        from insdvl_replay.batch.parts import plan_shard_run
        from insdvl_replay.cli.shards import replay_shard

        refusing = without_search(options)
        planned = plan_shard_run(shard, found, output, refusing, loaded.by_file, fetch)
        return replay_shard(planned, how, wanted, added)
    if against:
        from insdvl_replay.changes.comparison import parse_limit  # needs scipy

        limit = parse_limit(fail_on)
        sides = plan_against(
            found, output, options, layers, against, fetch, how, one_dive=one_dive
        )
        replays = outcomes(sides.jobs, how, added)
        return answer_against(sides, replays, limit, format_, verbose, quiet=quiet)
    dives = plan_jobs(fetch(found), output, options, loaded.by_file, one_dive=one_dive)
    if len(dives) > 1 or dives_of_run(output) is not None:
        require_own_names(dives)
        require_overviews(output, force=force)
    if len(dives) == 1:
        opt.require_no_table_over_dives(tables, str(dives[0].name))
    screen = RunScreen([dive.target for dive in dives], output, wanted)
    # An interrupt may come here, and the workers must end before this process.
    with closing(outcomes(dives, how, added)) as replays:
        for outcome in replays:
            screen.add(outcome.job.target, outcome.result, unchanged=outcome.unchanged)
    return screen.finish()


def _require_together(
    against: "Sequence[str]",
    fail_on: str | None,
    tables: "Sequence[str]",
    *,
    strict: bool,
) -> None:
    """Raise a ConfigError where ``--against`` stands beside an option that it does not go with, or one needs it."""
    if not against and fail_on is not None:
        hint = "`insdvl-replay compare OLD NEW --fail-on worse`"
        raise ConfigError("--fail-on: works with --against only", hint)
    if against and tables:
        raise ConfigError("--against: does not work with --table", _COMPARE_AFTERWARDS)
    if against and strict:
        raise ConfigError("--against: does not work with --strict", _COMPARE_AFTERWARDS)


def _lake_writer(
    lake: Path | None, revision: str, against: "Sequence[str]"
) -> "LakeWriter | None":
    """Return what adds replays to a lake. Raise a ConfigError for a name of a version that nothing would keep apart."""
    from insdvl_replay.results.lake import LakeWriter, require_revision

    if revision and lake is None:
        raise ConfigError("--revision: works with --lake only", "--lake lake")
    if revision and against:
        raise ConfigError(
            "--revision: does not work with --against, which has two versions", "leave it out"
        )
    if lake is None:
        return None
    require_revision(revision)
    return LakeWriter(lake, revision)


def _require_shared(
    against: "Sequence[str]",
    tables: "Sequence[str]",
    format_: str,
    *,
    one_dive: bool,
) -> None:
    """Raise a ConfigError where ``--shard`` stands beside an option that is about all dives, or makes them one."""
    if against:
        hint = "run the shards with each setting, merge both, and use `insdvl-replay compare`"
        raise ConfigError("--shard: does not work with --against", hint)
    if one_dive:
        raise ConfigError("--shard: does not work with --one-dive", "one dive has one shard")
    if tables or format_ != "table":
        option = "--format"
        if tables:
            option = "--table"
        hint = f"`insdvl-replay merge PART... {option} ...` afterwards"
        raise ConfigError(f"--shard: does not work with {option}", hint)


def _tracks(*, tum: bool, kml: bool, geojson: bool) -> tuple[str, ...]:
    """Return the formats of tracks that are asked for."""
    asked = {"tum": tum, "kml": kml, "geojson": geojson}
    return tuple(name for name, is_asked in asked.items() if is_asked)


def _blocking(against: "Sequence[str]", scheduler: str | None, *, control: bool) -> str:
    """Return the option that keeps a run without settings from searching for some."""
    if against:
        return "--against"
    if control:
        return "--control"
    if scheduler:
        return "--scheduler"
    return ""
