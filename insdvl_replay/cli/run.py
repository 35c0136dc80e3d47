"""``insdvl-replay run``. The work is in `dives`, which is imported only once there is work to do."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.options import (
    AllowCode,
    AllowDamaged,
    ChosenTables,
    Color,
    Colored,
    ConfigFiles,
    End,
    Force,
    Format,
    HistoryFormat,
    Jobs,
    Logs,
    OneDive,
    Preset,
    Quiet,
    Rerun,
    Scheduler,
    SchedulerTimeout,
    Settings,
    Start,
    Verbose,
    span_settings,
)


def run(
    logs: Logs,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Where each log gets a folder of its name.")
    ] = Path("replay"),
    config: ConfigFiles = [],  # noqa: B006
    preset: Preset = None,
    start: Start = None,
    end: End = None,
    settings: Settings = [],  # noqa: B006
    starts: Annotated[
        int | None,
        typer.Option(metavar="K", min=1, help="Run each filter from K drawn starts; 16 unless the settings say."),
    ] = None,
    format_: Annotated[Format, typer.Option("--format", help="How the tables are printed.")] = Format.TABLE,
    tables: ChosenTables = [],  # noqa: B006
    allow_damaged: AllowDamaged = False,
    allow_code: AllowCode = False,
    one_dive: OneDive = False,
    control: Annotated[
        bool, typer.Option("--control", help="Add a filter `tuned`: the baseline with its noise fitted to the log.")
    ] = False,
    tum: Annotated[
        bool, typer.Option("--tum", help="Write trajectories for evo, too: filter_NAME.tum and reference.tum.")
    ] = False,
    history: Annotated[
        HistoryFormat | None, typer.Option("--history", help="Write the whole history of each filter, too.")
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 3 if there is any warning.")] = False,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scheduler_timeout: SchedulerTimeout = 60.0,
    rerun: Rerun = False,
    force: Force = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
    color: Colored = Color.AUTO,
) -> int:
    """Replay dives through the configured filters.

    The screen has the word on each filter and the evidence for it; -v prints all tables, --table one of them.
    Each log gets a folder with report.html, CSV tables,
    report.json, replay.mcap and the settings; several logs also a summary.csv and an index.html that leads to them.
    A log that cannot be used does not stop the others. A dive whose log, settings and versions are those of the result
    that lies there is not replayed again.

    \b
    Example:
      insdvl-replay run dive.mcap
      insdvl-replay run dives/*.mcap -o results -c vehicle.toml --format md
      insdvl-replay run sensors.mcap gnss.mcap --one-dive
      insdvl-replay run archive --jobs 4
      insdvl-replay run dive.mcap --table evidence --format csv
      insdvl-replay run dive.mcap --tum
      insdvl-replay run dive.mcap --start 60 --set filters.aided.acceleration.window=5
    """
    from insdvl_replay.batch.cluster import Cluster
    from insdvl_replay.batch.jobs import ReplayOptions
    from insdvl_replay.cli.dives import RunOptions, replay_dives
    from insdvl_replay.core.config_file import load_config

    if history is HistoryFormat.PARQUET:
        from insdvl_replay.results.histories import require_parquet

        require_parquet()
    drawn = [] if starts is None else [f"evaluation.starts={starts}"]
    resolved = load_config(preset, config, [*settings, *span_settings(start, end), *drawn], allow_code=allow_code)
    cluster = None if scheduler is None else Cluster(scheduler, scheduler_timeout)
    return replay_dives(
        logs,
        output,
        ReplayOptions(
            resolved,
            allow_damaged=allow_damaged,
            control=control,
            trajectories=tum,
            history_format=history.value if history else "",
        ),
        RunOptions(format_, tuple(tables), one_dive, strict, force, rerun, jobs, cluster, verbose, quiet),
    )
