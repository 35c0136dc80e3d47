"""``insdvl-replay study``: the analyses behind a decision, one command each."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insdvl_replay.cli import options as opt

if TYPE_CHECKING:
    from insdvl_replay.core.result import Result

study = typer.Typer(rich_markup_mode=None, no_args_is_help=True)

StudyOutput = Annotated[
    Path, typer.Option("-o", "--output", metavar="DIR", help="Where the study gets a folder of its own.")
]
StudyFormat = Annotated[opt.Format, typer.Option("--format", help="How the tables are printed.")]


@study.callback()
def about_studies() -> None:
    """Ask more than one replay can answer; each study writes tables as CSV, and pictures."""


@study.command(cls=opt.PlainCommand)
def montecarlo(
    scenario: opt.Scenario,
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
    outage: opt.Outages = [],  # noqa: B006
    jobs: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Runs at the same time; left out, one for each core.")
    ] = None,
    output: StudyOutput = Path("study"),
    png: Annotated[bool, typer.Option("--png", help="Draw the pictures as PNG, too.")] = False,
    config: opt.ConfigFiles = [],  # noqa: B006
    preset: opt.Preset = None,
    settings: opt.Settings = [],  # noqa: B006
    format_: StudyFormat = "table",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Simulate a dive many times and hold the filters' uncertainty against their true errors.

    Every run draws its own sensor errors and its own error of the start. Per filter and state: the sigma from P beside
    the sigma and mean over the runs, NEES with its interval, and believed beside true improvement.
    With outages of the DVL also NEES before, in and after each.

    \b
    Example:
      insdvl-replay study montecarlo lawnmower
      insdvl-replay study montecarlo lawnmower --preset mems --outage 300:480
      insdvl-replay study montecarlo straight --imu fog --preset fog --runs 200
      insdvl-replay study montecarlo straight --run 17
    """
    from insdvl_replay.cli.screen import compiling, progress
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.studies.montecarlo import repeat_run, study_montecarlo

    resolved, target = load_config(preset, config, settings), output / f"montecarlo-{scenario}"
    outages = opt.outage_spans(outage)
    if run is not None:
        _print(repeat_run(scenario, resolved, run, seed=seed, duration_s=duration, imu=imu, outages=outages), format_)
        return
    _require(target, force=force, png=png)
    with progress(f"simulating {scenario}", runs, note=compiling().lstrip("; ")) as after_run:
        report, _ = study_montecarlo(
            scenario,
            resolved,
            runs=runs,
            seed=seed,
            duration_s=duration,
            imu=imu,
            outages=outages,
            jobs=jobs,
            after_run=after_run,
        )
    _keep(report, target, format_, verbose=verbose > 0, force=force, png=png)


@study.command(cls=opt.PlainCommand)
def window(
    logs: opt.Logs,
    longest: Annotated[
        int, typer.Option("--longest", metavar="N", min=2, max=1000, help="Try windows of 2 to N velocities.")
    ] = 10,
    start: opt.Start = None,
    end: opt.End = None,
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=1, help="Dives at the same time.")] = 1,
    output: StudyOutput = Path("study"),
    png: Annotated[bool, typer.Option("--png", help="Draw the picture as PNG, too.")] = False,
    config: opt.ConfigFiles = [],  # noqa: B006
    preset: opt.Preset = None,
    settings: opt.Settings = [],  # noqa: B006
    format_: StudyFormat = "table",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> int:
    """Find the number of past velocities that makes the best acceleration.

    The slope of the DVL's velocities is held against the acceleration of the reference, at the middle of its window and
    at its end, with the lever arm compensated and ignored. Several logs are pooled, with rows of their own beside.
    A log that cannot be used does not stop the others.

    \b
    Example:
      insdvl-replay study window dives/*.mcap -c vehicle.toml
      insdvl-replay study window dive.mcap --longest 20
    """
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.cli.messages import log_to_stderr
    from insdvl_replay.cli.screen import spinner
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.core.errors import LogError
    from insdvl_replay.studies.window import LEFT_OUT, study_window

    given = [*settings, *opt.span_settings(start, end)]
    resolved, target = load_config(preset, config, given, allow_code=True).without_code(), output / "window"
    dives = find_dives(logs)
    _require(target, force=force, png=png)
    with spinner("comparing accelerations"):
        report = study_window(dives, resolved, longest, jobs=jobs)
    _keep(report, target, format_, verbose=verbose > 0, force=force, png=png)
    left_out = [note.text for note in report.notes if note.code == LEFT_OUT]
    if left_out:
        log_to_stderr(f"error: {len(left_out)} of {len(dives)} logs could not be used; the first: {left_out[0]}")
    return LogError.exit_code if left_out else 0


@study.command(cls=opt.PlainCommand)
def observability(
    dive: Annotated[str, typer.Argument(metavar="LOG|SCENARIO", help="A recorded dive, or a scenario by its name.")],
    start: opt.Start = None,
    end: opt.End = None,
    no_earth_rate: Annotated[bool, typer.Option("--no-earth-rate", help="Let the Earth be flat and at rest.")] = False,
    output: StudyOutput = Path("study"),
    png: Annotated[bool, typer.Option("--png", help="Draw the picture as PNG, too.")] = False,
    config: opt.ConfigFiles = [],  # noqa: B006
    preset: opt.Preset = None,
    settings: opt.Settings = [],  # noqa: B006
    format_: StudyFormat = "table",
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Say which errors at the start of a dive its measurements can tell apart, and which they cannot.

    For velocities, accelerations in either model, and both together: rank, singular values, and the directions of error
    that nothing shows, in words and numbers.

    \b
    Example:
      insdvl-replay study observability straight --no-earth-rate
      insdvl-replay study observability dive.mcap --start 60 --end 180
    """
    from insdvl_replay.cli.screen import compiling, spinner
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.core.dive_record import dive_name
    from insdvl_replay.studies.observability import study_observability

    resolved = load_config(preset, config, [*settings, *opt.span_settings(start, end)], allow_code=True).without_code()
    target = output / f"observability-{dive_name(Path(dive))}"
    _require(target, force=force, png=png)
    with spinner(f"stacking the measurements{compiling()}"):
        report = study_observability(dive, resolved, earth_rate=not no_earth_rate)
    _keep(report, target, format_, verbose=verbose > 0, force=force, png=png)


def _require(target: Path, *, force: bool, png: bool) -> None:
    """Raise before the work what would stop its files from being written."""
    from insdvl_replay.results.folder import require_replaceable_folder
    from insdvl_replay.show.paper import require_matplotlib

    require_replaceable_folder(target, force=force)
    if png:
        require_matplotlib()


def _keep(report: "Result", target: Path, format_: opt.Format, *, verbose: bool, force: bool, png: bool) -> None:
    """Write the files of a study, print it, and say what was lost and where the files are."""
    from insdvl_replay.cli.messages import log_notes, log_to_stderr
    from insdvl_replay.results.folder import result_folder
    from insdvl_replay.show.render import save_result

    with result_folder(target, force=force) as folder:
        save_result(report, folder, png=png)
    _print(report, format_)
    log_notes(report.notes, verbose=verbose)
    log_to_stderr(f"wrote {target}")


def _print(report: "Result", format_: opt.Format) -> None:
    from insdvl_replay.cli.messages import write_stdout
    from insdvl_replay.cli.screen import written

    write_stdout(written(report, format_))
