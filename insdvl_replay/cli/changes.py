"""``insdvl-replay compare`` and ``check``: changes between results. Slow imports wait until they are needed."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import typer

from insdvl_replay.cli import options as opt
from insdvl_replay.cli.against import print_comparison
from insdvl_replay.cli.messages import (
    log_failure,
    log_findings,
    log_info,
    log_notes,
    log_to_stderr,
    write_stdout,
)
from insdvl_replay.core.errors import (
    ConfigError,
    LimitError,
    Note,
)
from insdvl_replay.core.words import GateStatus

if TYPE_CHECKING:
    from insdvl_replay.changes.findings import Checked, CheckResult

GATE_FAILED = 1
_MISSED: Final = (GateStatus.UNUSABLE, GateStatus.FAILED)


def compare(
    old: Annotated[
        str,
        typer.Argument(
            metavar="OLD",
            help="Result folder, report.json, or folder of results. With --reference: trajectories, a folder with a "
            "file for each dive, or one file.",
        ),
    ],
    new: Annotated[
        list[str],
        typer.Argument(
            metavar="NEW...",
            help="The same after the change; with --reference also several.",
        ),
    ],
    reference: Annotated[
        str | None,
        typer.Option(
            "--reference",
            metavar="TRUTH",
            help="Compare trajectories with those of this reference: TUM, tables, or topics of logs (dive.mcap:/odom).",
        ),
    ] = None,
    align: Annotated[
        Literal["none", "yaw", "se3", "sim3"] | None,
        typer.Option(help="With --reference: fit each trajectory to the reference first."),
    ] = None,
    axes: Annotated[
        Literal["ned_frd", "enu_flu"] | None,
        typer.Option(help="With --reference: axes of OLD and NEW (default: by the format)."),
    ] = None,
    reference_axes: Annotated[
        Literal["ned_frd", "enu_flu"] | None,
        typer.Option("--reference-axes", help="With --reference: axes of the reference."),
    ] = None,
    primary: Annotated[
        str | None,
        typer.Option(
            "--primary",
            metavar="NAME",
            help="With --reference: the quantity that decides, such as drift_100m (default: position).",
        ),
    ] = None,
    max_diff: Annotated[
        float | None,
        typer.Option(
            "--max-diff",
            metavar="S",
            min=0.0,
            help="With --reference: most seconds between stamps of poses, for APE and RPE (default: 0.01).",
        ),
    ] = None,
    rpe: Annotated[
        list[str],
        typer.Option(
            "--rpe",
            metavar="DELTA",
            help="With --reference: length of RPE, in poses or metres, such as 1f or 100m. May be repeated.",
        ),
    ] = [],
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="With --reference: RPE of all pairs of poses.")
    ] = False,
    dives: Annotated[
        list[str],
        typer.Option("--dive", metavar="NAME", help="Compare only this dive. May be repeated."),
    ] = [],
    tables: Annotated[
        list[str],
        typer.Option("--table", metavar="NAME", help="Compare only this table. May be repeated."),
    ] = [],
    columns: Annotated[
        list[str],
        typer.Option(
            "--column", metavar="NAME", help="Compare only this column. May be repeated."
        ),
    ] = [],
    pairs: Annotated[
        list[str],
        typer.Option(
            "--pair",
            metavar="OLD=NEW",
            help="Compare filters with different names. May be repeated.",
        ),
    ] = [],
    tolerance: Annotated[
        str | None,
        typer.Option(
            metavar="P%",
            help="Changes up to this count as the same (default: the last printed digit).",
        ),
    ] = None,
    only_changed: Annotated[
        bool,
        typer.Option(
            "--only-changed", help="Show all values that changed, not only the evidence."
        ),
    ] = False,
    everything: Annotated[
        bool, typer.Option("--all", help="Show all values, also unchanged ones.")
    ] = False,
    fail_on: opt.FailOn = None,
    format_: Annotated[opt.PageFormat, typer.Option("--format", help="Output format.")] = "table",
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
    color: opt.Colored = "auto",
) -> None:
    """Compare stored results and show what changed; or trajectories with those of a reference.

    The first line names the settings that differ. Then each filter has a line: its verdict, new against old, with the
    tests of `run` over all dives. From three dives on a difference can be better or worse, and only if it is above 5 %.
    Dives are matched by the hash of their log, then by name. -q prints the verdicts alone.

    With --reference each side holds trajectories of any program. Files of the same name are one dive, and folders with
    files of the same name, such as run_1 and run_2, are repeated runs. Nothing is aligned unless --align asks for it.

    \b
    Example:
      insdvl-replay compare before/dive after/dive --only-changed
      insdvl-replay compare before after --format html > comparison.html
      insdvl-replay compare before after -q --fail-on worse
      insdvl-replay compare before after --table reference_error --column rmse --fail-on 5%
      insdvl-replay compare old new --reference truth
      insdvl-replay compare dives:/odom_old dives:/odom_new --reference dives:/truth --align yaw
    """
    if as_json:
        format_ = "json"
    given = {
        "--align": align,
        "--axes": axes,
        "--reference-axes": reference_axes,
        "--primary": primary,
        "--max-diff": max_diff,
        "--rpe": rpe,
        "--all-pairs": all_pairs,
    }
    of_results = {
        "--column": columns,
        "--pair": pairs,
        "--tolerance": tolerance,
        "--only-changed": only_changed,
        "--all": everything,
    }
    if reference is not None:
        _require_none_of(of_results, "compares stored results", "leave out --reference")
        from insdvl_replay.cli.trajectories import compare_with_reference

        compare_with_reference(
            old,
            new,
            reference,
            {
                "align": align,
                "axes": axes,
                "reference_axes": reference_axes,
                "primary": primary,
                "max_diff_s": max_diff,
                "rpe": rpe,
                "all_pairs": all_pairs,
            },
            dives=dives,
            tables=tables,
            fail_on=fail_on,
            format_=format_,
            verbose=verbose,
            quiet=quiet,
        )
        return
    hint = f"--reference TRUTH, the trajectories to compare {old} with"
    _require_none_of(given, "compares trajectories", hint)
    if len(new) > 1:
        text = f"{new[1]}: is a third side, and results are compared two by two"
        raise ConfigError(text, hint)
    from insdvl_replay.changes import comparison as changes

    limit = changes.parse_limit(fail_on)
    found = changes.compare_results(
        Path(old),
        Path(new[0]),
        tables=tables,
        columns=columns,
        dives=dives,
        filter_pairs=changes.parse_pairs(pairs),
        tolerance_pct=changes.parse_percentage(tolerance, "--tolerance") if tolerance else None,
    )
    moved = changes.only_changed(found)
    all_values = bool(everything or only_changed or tables or columns or dives)
    print_comparison(
        moved if only_changed else found,
        found if everything else moved,
        format_,
        verbose,
        quiet=quiet,
        all_values=all_values,
    )
    worse = changes.find_violation(found, limit)
    if worse is not None:
        raise LimitError(worse)


def _require_none_of(given: Mapping[str, object], does: str, hint: str) -> None:
    """Raise a ConfigError if an option is given that another kind of comparison has."""
    for name, value in given.items():
        if value:
            raise ConfigError(f"{name}: {does}", hint)


def plan(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="RESULTS", help="A result folder, or a folder of results."),
    ] = None,
    tracks: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Instead of RESULTS: what so many dives can find."),
    ] = None,
    ratio: Annotated[
        float, typer.Option(metavar="R", help="With --tracks: the ratio that is looked for.")
    ] = 0.9,
    format_: opt.PrintedAs = "table",
    verbose: opt.Verbose = 0,
    color: opt.Colored = "auto",
) -> None:
    """Show what change the dives of a result can find, and how many dives find smaller ones.

    A change is found if it is better or worse in four of five cases. The scatter over dives is that of the result.
    Without a result, --tracks tells it for several scatters.

    \b
    Example:
      insdvl-replay plan replay
      insdvl-replay plan replay --format csv > plan.csv
      insdvl-replay plan --tracks 5 --ratio 0.9
    """
    from insdvl_replay.cli.screen import written
    from insdvl_replay.core.report import Report
    from insdvl_replay.results.stored_results import read_reports
    from insdvl_replay.show.plan import EITHER, plan_of_tracks, plan_result

    if folder is None and tracks is not None:
        write_stdout(written(plan_of_tracks(tracks, ratio), format_))
        return
    if folder is None or tracks is not None:
        raise ConfigError(*EITHER)
    found, notes = read_reports(folder, Report)
    write_stdout(written(plan_result([report for _, report in found]), format_))
    log_notes(notes, verbose=verbose > 0)


def _log_fitted_noise(checked: "Sequence[Checked]") -> None:
    """Say with which noise logs were replayed for which the gates name none."""
    from insdvl_replay.results.folder import VEHICLE_FILE

    said = set[tuple[Note, ...]]()
    for result, folder in checked:
        if isinstance(result, Exception):
            continue
        found = tuple(note for note in result.notes if note.is_finding)
        if found not in said:
            said.add(found)
            log_findings(found, folder / VEHICLE_FILE)


def check(
    gates: Annotated[Path, typer.Argument(metavar="GATES", help="TOML file with the gates.")],
    dives: Annotated[
        list[str],
        typer.Argument(
            metavar="[DIVE]...",
            help="Logs, bags, result folders, patterns, .txt lists; left out: those in GATES.",
        ),
    ] = [],
    update: Annotated[
        bool,
        typer.Option("--update", help="Show what changed, then store the new values as expected."),
    ] = False,
    results: Annotated[
        Path,
        typer.Option(
            "--results",
            metavar="DIR",
            help="Output folder; each replayed dive gets a subfolder with its name.",
        ),
    ] = Path("checked"),
    config: Annotated[
        list[Path],
        typer.Option(
            "-c",
            "--config",
            metavar="FILE",
            help="Settings that replace those named in GATES. May be repeated.",
        ),
    ] = [],
    no_config: opt.NoConfig = False,
    preset: opt.Preset = None,
    settings: opt.Settings = [],
    allow_damaged: opt.AllowDamaged = False,
    offline: opt.Offline = False,
    allow_code: opt.AllowCode = False,
    format_: Annotated[opt.CheckFormat, typer.Option("--format", help="Output format.")] = "text",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="FILE", help="Write the output to this file, and text to stdout."
        ),
    ] = None,
    summary: Annotated[
        Path | None,
        typer.Option(
            "--summary-file", metavar="FILE", help="Append the output to this file as Markdown."
        ),
    ] = None,
    badge: Annotated[
        Path | None,
        typer.Option(
            "--badge", metavar="FILE", help="Write the counts as JSON for a badge of shields.io."
        ),
    ] = None,
    only: Annotated[
        list[str],
        typer.Option(
            "--only", metavar="GATE", help="Only gates with this name or pattern. May be repeated."
        ),
    ] = [],
    skip: Annotated[
        list[str],
        typer.Option(
            "--skip", metavar="GATE", help="Skip gates with this name or pattern. May be repeated."
        ),
    ] = [],
    shard: opt.Shard = None,
    histories: Annotated[
        bool,
        typer.Option(
            "--keep-histories", help="Also write replay.mcap, the largest file of a result."
        ),
    ] = False,
    jobs: opt.Jobs = 1,
    scheduler: opt.Scheduler = None,
    rerun: opt.Rerun = False,
    verbose: opt.Verbose = 0,
    quiet: opt.Quiet = False,
) -> int:
    """Check dives against gates, for example in a nightly job.

    Logs are replayed first, if the log, the settings, the versions or the code have changed since the last result.
    Noise that the gates do not name is fitted to the dives, as in `run`. Result folders are used as they are. Every
    gate is evaluated on every dive. A missing or empty value never passes. The exit code is 0 if no gate of level
    error failed, 1 if one did, 3 if a dive cannot be used.

    \b
    Example:
      insdvl-replay check gates.toml
      insdvl-replay check gates.toml --jobs 4 --format junit --output gates.xml
      insdvl-replay check gates.toml replay/dive
      insdvl-replay check gates.toml --only "position*" --shard 1/4
      insdvl-replay check gates.toml --badge badge.json
    """
    from insdvl_replay.batch.check import Listener, checked_dives, plan_check, write_badge
    from insdvl_replay.batch.shards import ALL_DIVES, parse_shard
    from insdvl_replay.changes.formats import check_sentence, update_text
    from insdvl_replay.changes.gate_file import chosen_gates, load_gates, settings_of
    from insdvl_replay.cli.screen import fetch_with_progress, log_settings, replaying
    from insdvl_replay.core.settings_layers import SettingsLayers

    meant = parse_shard(shard or str(ALL_DIVES))
    chosen = chosen_gates(load_gates(gates), only, skip)
    layers = SettingsLayers(
        preset or chosen.content.preset, config or settings_of(chosen), settings, allow_code
    )
    planned = plan_check(
        chosen,
        dives,
        layers,
        local_settings=not no_config,
        shard=meant,
        allow_damaged=allow_damaged,
        histories=histories,
        report=log_info,
    )
    log_settings(planned.dives, quiet=quiet)
    files = {"--output": output, "--summary-file": summary, "--badge": badge}
    planned.require_outputs(files)
    codes = [0]

    def tell_results(checked: "Sequence[Checked]") -> None:
        for dive in checked:
            if isinstance(dive.result, Exception):
                codes.append(log_failure(dive.result, verbose))
        if not quiet:
            _log_fitted_noise(checked)

    found = checked_dives(
        planned,
        results,
        replaying(jobs, scheduler, force=True, rerun=rerun, quiet=quiet),
        partial(fetch_with_progress, offline=offline),
        Listener(
            results=tell_results,
            changes=lambda changes: write_stdout(update_text(changes)),
            stored=lambda file: log_to_stderr(f"wrote {file}"),
        ),
        update=update,
    )
    _print_check(found, format_, output, summary, quiet=quiet)
    if badge is not None:
        write_badge(found, badge)
    if found.count(GateStatus.FAILED):
        codes.append(GATE_FAILED)
    # None is missed where no gate is about the dive that cannot be used, which was reported above.
    missed = [item for item in found.outcomes if item.status in _MISSED]
    if max(codes) and missed:
        first = missed[0]
        reasons = "; ".join(first.explained)
        sentence = check_sentence(found)
        log_to_stderr(f"error: {sentence}; the first: {first.dive}: {first.gate}: {reasons}")
    return max(codes)


def _print_check(
    found: "CheckResult",
    format_: opt.CheckFormat,
    output: Path | None,
    summary: Path | None,
    *,
    quiet: bool,
) -> None:
    """Print what the gates say, and write it into the files that are asked for."""
    from insdvl_replay.changes.formats import check_sentence, check_text, in_format
    from insdvl_replay.results.folder import result_file

    text = in_format(found, format_)
    if quiet and format_ == "text":
        text = f"{check_sentence(found)}\n"
    if output is None:
        write_stdout(text, commands=format_ == "github")
    else:
        with result_file(output, force=True) as file:
            file.write_text(text, "utf-8")
        write_stdout(check_text(found))
    if summary is not None:
        _append(summary, in_format(found, "md"))


def _append(file: Path, text: str) -> None:
    """Write at the end of a file, to which other steps of a job write, too."""
    try:
        with file.open("a", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        hint = "check the path of --summary-file"
        raise ConfigError(f"{file}: cannot be written: {error.strerror}", hint) from error
