"""``insdvl-replay lake`` and ``history``: the evidence of many replays. Slow imports wait until there is work to do."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import write_stdout

Lake = Annotated[
    Path, typer.Argument(metavar="LAKE", help="The folder that `run --lake` has written.")
]


def history(
    folder: Lake,
    quantity: Annotated[
        str,
        typer.Option(
            "--quantity",
            metavar="NAME",
            show_default=False,
            help="Show the ratio of this quantity (default: the one that decides).",
        ),
    ] = "",
    format_: Annotated[opt.PageFormat, typer.Option("--format", help="Output format.")] = "table",
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Show how each filter did over the versions in a lake, and name the steps where that changed.

    A version is what `run --lake DIR --revision NAME` named, such as a commit. Without names it is the version of the
    tool with the settings and your code. Each version is compared with the first one since the last step, on the dives
    of both. A step is named if the ratio changed by more than 5 %, by an interval that all versions share. It may be
    looked at after every version and every dive.

    \b
    Example:
      insdvl-replay history lake
      insdvl-replay history lake --format html > history.html
      insdvl-replay history lake --quantity drift_30s --format csv
    """
    from insdvl_replay.cli.screen import written
    from insdvl_replay.show.history import history_result

    write_stdout(written(history_result(folder, quantity), format_))


lake = typer.Typer(rich_markup_mode=None, no_args_is_help=True)


@lake.callback()
def work_on_lake() -> None:
    """Work on the evidence of many replays, which `run --lake` collects."""


@lake.command(cls=opt.PlainCommand)
def compact(
    folder: Lake,
    format_: opt.PrintedAs = "table",
    verbose: opt.Verbose = 0,
) -> None:
    """Join the files of a lake into one, which queries read much faster.

    Each row stays as it is. A query that runs meanwhile sees each row once or stops with an error. So it is after a
    kill: the next `lake compact`, or the next run with this lake, removes what was left. A run that leaves more than
    500 files compacts the lake by itself.

    \b
    Example:
      insdvl-replay lake compact lake
      insdvl-replay lake compact lake --format json
    """
    from insdvl_replay.cli.screen import written
    from insdvl_replay.results.lake import compact_lake
    from insdvl_replay.show.lake import compacted_result

    write_stdout(written(compacted_result(compact_lake(folder)), format_))
