"""``insdvl-replay study``: the analyses behind a decision, one command each."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.options import Force, Preset, Settings, Verbose
from insdvl_replay.cli.run import Format

study = typer.Typer(rich_markup_mode=None, no_args_is_help=True)

StudyOutput = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="Where the study gets a folder of its own.")
]
ConfigFile = Annotated[
    Path | None, typer.Option("-c", "--config", metavar="FILE", help="Settings as TOML, on top of the preset.")
]
StudyFormat = Annotated[Format, typer.Option("--format", help="How the tables are printed.")]


@study.callback()
def about_studies() -> None:
    """Ask more than one replay can answer; each study writes tables as CSV, and pictures."""


@study.command()
def montecarlo(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="straight, figure-eight, lawnmower or static.")],
    runs: Annotated[int, typer.Option(metavar="N", min=2, help="How many dives to simulate.")] = 100,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of all runs; each draws a seed of its own.")] = 1,
    run: Annotated[
        int | None, typer.Option(metavar="K", min=1, help="Repeat one run alone, counted from 1, and print it.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Seconds; left out, as long as the scenario is.")
    ] = None,
    imu: Annotated[
        str,
        typer.Option(
            metavar="GRADE",
            help="How the sensors err: matched (exactly as the first filter believes), fog, tactical or mems.",
        ),
    ] = "matched",
    jobs: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Runs at the same time; left out, one for each core.")
    ] = None,
    output: StudyOutput = Path("study"),
    png: Annotated[bool, typer.Option("--png", help="Draw the pictures as PNG, too.")] = False,
    config: ConfigFile = None,
    preset: Preset = None,
    settings: Settings = [],  # noqa: B006
    format_: StudyFormat = Format.TABLE,
    force: Force = False,
    verbose: Verbose = 0,
) -> None:
    """Simulate a dive many times and hold the filters' uncertainty against their true errors.

    Every run draws its own sensor errors and its own error of the start. Per filter and state: the sigma from P beside
    the sigma and mean over the runs, NEES with its interval, and believed beside true improvement.

    \b
    Example:
      insdvl-replay study montecarlo lawnmower
      insdvl-replay study montecarlo straight --imu fog --preset fog --runs 200
      insdvl-replay study montecarlo straight --run 17
    """
    from insdvl_replay.cli.montecarlo import print_run, study_montecarlo
    from insdvl_replay.config_file import load_config

    resolved = load_config(preset, config, settings)
    if run is not None:
        print_run(scenario, resolved, run=run, seed=seed, duration_s=duration, imu=imu, format_=format_)
    else:
        study_montecarlo(
            scenario,
            resolved,
            output,
            runs=runs,
            seed=seed,
            duration_s=duration,
            imu=imu,
            jobs=jobs,
            png=png,
            format_=format_,
            force=force,
        )
