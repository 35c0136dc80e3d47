"""The typer application with all commands."""

from typing import Annotated

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.analyses import calibrate, inspect, study
from insdvl_replay.cli.changes import check, compare, plan
from insdvl_replay.cli.demo import demo
from insdvl_replay.cli.lake import history, lake
from insdvl_replay.cli.messages import write_stdout
from insdvl_replay.cli.run import run
from insdvl_replay.cli.shards import merge
from insdvl_replay.cli.utilities import compile_, config, explain, figure, schema, simulate
from insdvl_replay.core.version import __version__

# Plain help: rich would add 0.1 s and cut lines in a pipe.
app = typer.Typer(
    cls=opt.PlainGroup,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    demo,
    run,
    merge,
    compare,
    check,
    history,
    plan,
    inspect,
    calibrate,
    figure,
    simulate,
    config,
    schema,
    explain,
):
    app.command(cls=opt.PlainCommand)(command)
app.command("compile", cls=opt.PlainCommand)(compile_)
app.add_typer(study, name="study")
app.add_typer(lake, name="lake")


def _print_version(wanted: bool) -> None:
    if wanted:
        write_stdout(f"insdvl-replay {__version__}\n")
        raise typer.Exit


@app.callback()
def insdvl_replay(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and exit.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Replay a dive through navigation filters and measure whether a change really helped.

    Exit codes: 0 done; 1 a limit is exceeded; 2 usage or configuration; 3 a log or a stored result cannot be used;
    4 internal error; 130 interrupted.

    \b
    Example:
      insdvl-replay demo
      insdvl-replay run dive.mcap
    """
