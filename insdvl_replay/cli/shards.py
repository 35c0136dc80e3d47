"""``insdvl-replay run --shard`` and ``merge``. Slow imports wait until there is work to do."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import log_to_stderr

if TYPE_CHECKING:
    from insdvl_replay.batch.parts import ShardRun
    from insdvl_replay.batch.replaying import Replaying
    from insdvl_replay.cli.run_screen import Wanted
    from insdvl_replay.results.lake import LakeWriter


def replay_shard(
    run: "ShardRun", how: "Replaying", wanted: "Wanted", lake: "LakeWriter | None"
) -> int:
    """Replay the dives of a shard, and print what it has done."""
    from insdvl_replay.cli.run_screen import RunScreen

    screen = RunScreen(run.targets, run.folder, wanted, is_shard=True)
    # An interrupt may come here, and the workers must end before this process.
    with closing(run.outcomes(how, lake)) as replays:
        for outcome in replays:
            screen.add(outcome.job.target, outcome.result, unchanged=outcome.unchanged)
    part = run.write()
    if wanted.talks:
        log_to_stderr(f"wrote {run.file}")
    return screen.finish_shard(part.sentence)


def merge(
    parts: Annotated[
        list[Path],
        typer.Argument(
            metavar="PART...",
            help="Folders that `run --shard` wrote, each with one shard or several.",
        ),
    ],
    output: opt.Results = Path("replay"),
    format_: Annotated[opt.PageFormat, typer.Option("--format", help="Output format.")] = "table",
    tables: opt.ChosenTables = [],
    strict: opt.Strict = False,
    force: opt.Force = False,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
    color: opt.Colored = "auto",
) -> int:
    """Merge the shards of a run into the results of one run over all dives.

    Tables, pages and verdicts are those of one run, byte for byte. All shards must be there, of the same dives,
    settings and versions. A dive that failed in its shard is reported again, and the exit code is then 3.

    The parts stay as they are.

    \b
    Example:
      insdvl-replay merge parts -o results
      insdvl-replay merge part_1 part_2 part_3 part_4 -o results
    """
    from insdvl_replay.batch.merge import plan_merge
    from insdvl_replay.cli.run_screen import RunScreen, Wanted
    from insdvl_replay.show.dive import require_tables

    require_tables(tables)
    planned = plan_merge(parts, output, force=force)
    targets = planned.targets
    if len(targets) == 1:
        opt.require_no_table_over_dives(tables, targets[0].name)
    screen = RunScreen(targets, output, Wanted(format_, tables, verbose, quiet, strict))
    for dive in planned.dives(force=force):
        screen.add(dive.target, dive.result, unchanged=dive.unchanged)
    return screen.finish()
