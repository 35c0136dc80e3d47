"""``insdvl-replay compare``."""

from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.messages import log_notes, write_stdout


def compare(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="Result folder, report.json, or folder of results.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="The same after the change.")],
    dives: Annotated[
        list[str], typer.Option("--dive", metavar="NAME", help="Compare this dive alone. May be repeated.")
    ] = [],  # noqa: B006
    tables: Annotated[
        list[str], typer.Option("--table", metavar="NAME", help="Compare this table alone. May be repeated.")
    ] = [],  # noqa: B006
    columns: Annotated[
        list[str], typer.Option("--column", metavar="NAME", help="Compare this column alone. May be repeated.")
    ] = [],  # noqa: B006
    pairs: Annotated[
        list[str],
        typer.Option("--pair", metavar="OLD=NEW", help="Compare filters of different names. May be repeated."),
    ] = [],  # noqa: B006
    tolerance: Annotated[
        str | None,
        typer.Option(metavar="P%", help="Up to here a change is none. Left out: up to the last printed digit."),
    ] = None,
    only_changed: Annotated[
        bool, typer.Option("--only-changed", help="Show all values that moved, and not the evidence alone.")
    ] = False,
    everything: Annotated[bool, typer.Option("--all", help="Show all values, also those that are the same.")] = False,
    fail_on: Annotated[
        str | None,
        typer.Option(metavar="LIMIT", help="Exit with 1 on `worse`, on `worse:5%` (by more than that), or `changed`."),
    ] = None,
    format_: Annotated[
        opt.ComparisonFormat, typer.Option("--format", help="How it is printed.")
    ] = opt.ComparisonFormat.TABLE,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
    color: opt.Colored = opt.Color.AUTO,
) -> None:
    """Compare stored results: what moved, by how much, and whether that is better.

    Verdicts that changed come first, then what differs in settings, tool and log, and the evidence that moved. Dives
    are matched by the hash of their log, then by name. Rows that are gone and numbers that were lost count as worse.

    \b
    Example:
      insdvl-replay compare before/dive after/dive --only-changed
      insdvl-replay compare before after --format html > comparison.html
      insdvl-replay compare before after --table reference_error --column rmse --fail-on worse:5%
    """
    from insdvl_replay.changes.comparison import (
        Selection,
        brief_document,
        compare_results,
        comparison_csv,
        comparison_document,
        find_violation,
        opening_lines,
        parse_limit,
        parse_pairs,
        parse_percentage,
    )
    from insdvl_replay.changes.comparison import only_changed as without_same
    from insdvl_replay.cli.screen import in_format
    from insdvl_replay.core.errors import LimitError, visible
    from insdvl_replay.core.result import as_json

    limit = 0.0 if fail_on is None else parse_limit(fail_on)
    tolerance_pct = None if tolerance is None else parse_percentage(tolerance, "--tolerance ")
    selection = Selection(tuple(tables), tuple(columns), tuple(dives), parse_pairs(pairs), tolerance_pct)
    comparison = compare_results(old, new, selection)
    whole = without_same(comparison) if only_changed else comparison
    chosen = everything or only_changed or tables or columns or dives or format_ is opt.ComparisonFormat.LATEX
    lay_out, seen = (
        (comparison_document if chosen else brief_document),
        comparison if everything else without_same(comparison),
    )
    if quiet and format_ is opt.ComparisonFormat.TABLE:
        write_stdout("".join(f"{visible(line)}\n" for line in opening_lines(comparison)[:1]))
    else:
        write_stdout(
            in_format(
                format_,
                document=lambda: lay_out(seen),
                json=lambda: as_json(whole),
                csv=lambda: comparison_csv(whole),
            )
        )
    log_notes(comparison.notes, verbose=verbose > 0)
    if fail_on is not None and (found := find_violation(comparison, limit)):
        raise LimitError(found)
