"""``insdvl-replay check``. The work is in `gated_dives`, which is imported only once there is work to do."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.options import (
    AllowCode,
    AllowDamaged,
    CheckFormat,
    Jobs,
    Preset,
    Quiet,
    Rerun,
    Scheduler,
    SchedulerTimeout,
    Settings,
    Verbose,
)
from insdvl_replay.core.errors import ConfigError


def check(
    gates: Annotated[Path, typer.Argument(metavar="GATES", help="What must hold, a TOML file.")],
    dives: Annotated[
        list[str],
        typer.Argument(
            metavar="[DIVE]...", help="Logs, bags, result folders, patterns, .txt lists; left out: those in GATES."
        ),
    ] = [],  # noqa: B006
    update: Annotated[bool, typer.Option("--update", help="Show what moved, then make it the baseline.")] = False,
    results: Annotated[
        Path, typer.Option("--results", metavar="DIR", help="Where each replayed dive gets a folder of its name.")
    ] = Path("checked"),
    config: Annotated[
        list[Path],
        typer.Option(
            "-c", "--config", metavar="FILE", help="Settings in place of those named in GATES. May be repeated."
        ),
    ] = [],  # noqa: B006
    preset: Preset = None,
    settings: Settings = [],  # noqa: B006
    allow_damaged: AllowDamaged = False,
    allow_code: AllowCode = False,
    format_: Annotated[CheckFormat, typer.Option("--format", help="How it is told.")] = CheckFormat.TEXT,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="FILE", help="Write it here, and text to stdout.")
    ] = None,
    summary: Annotated[
        Path | None, typer.Option("--summary-file", metavar="FILE", help="Add it here, too, as Markdown.")
    ] = None,
    only: Annotated[
        list[str], typer.Option("--only", metavar="GATE", help="Gates of this name or pattern alone. May be repeated.")
    ] = [],  # noqa: B006
    skip: Annotated[
        list[str], typer.Option("--skip", metavar="GATE", help="No gates of this name or pattern. May be repeated.")
    ] = [],  # noqa: B006
    shard: Annotated[
        str, typer.Option("--shard", metavar="I/N", help="Every N-th dive from the I-th: a part of the archive.")
    ] = "1/1",
    histories: Annotated[
        bool, typer.Option("--keep-histories", help="Write replay.mcap, the largest file of a result, too.")
    ] = False,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    scheduler_timeout: SchedulerTimeout = 60.0,
    rerun: Rerun = False,
    verbose: Verbose = 0,
    quiet: Quiet = False,
) -> int:
    """Hold dives against gates, for a job that runs every night.

    Logs are replayed first, but for those whose log, settings, versions and code are those of the result that lies
    there; result folders are taken as they are. All gates of all dives are judged. What is missing or empty never
    passes. The exit code is 0 if no gate of level error failed, 1 if one did, 3 if a dive cannot be used.

    \b
    Example:
      insdvl-replay check gates.toml
      insdvl-replay check gates.toml --jobs 4 --format junit --output gates.xml
      insdvl-replay check gates.toml replay/dive
      insdvl-replay check gates.toml --only "position*" --shard 1/4
    """
    from insdvl_replay.batch.cluster import Cluster
    from insdvl_replay.cli.gated_dives import CheckOptions, GivenSettings, OutputOptions, check_dives

    cluster = None if scheduler is None else Cluster(scheduler, scheduler_timeout)
    options = CheckOptions(
        results, jobs, cluster, rerun, update, allow_damaged, histories, tuple(only), tuple(skip), _shard(shard)
    )
    given = GivenSettings(preset, tuple(config), tuple(settings), allow_code)
    return check_dives(gates, dives, given, options, OutputOptions(format_, output, summary, verbose, quiet))


def _shard(text: str) -> tuple[int, int]:
    part, slash, parts = text.partition("/")
    if not (slash and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise ConfigError(f"--shard {text}: is not a part such as 1/4", "--shard 1/4, --shard 2/4 and so on")
    return int(part), int(parts)
