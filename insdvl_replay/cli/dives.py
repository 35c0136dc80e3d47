"""Replay one dive after the other, print each result, and go on when one fails."""

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from insdvl_replay.cli.messages import emit, tell, tell_failure, tell_notes
from insdvl_replay.cli.run import Format
from insdvl_replay.cli.screen import compiling, patience, rendered
from insdvl_replay.config import Config
from insdvl_replay.control import replay_with_control
from insdvl_replay.errors import ConfigError, LogError
from insdvl_replay.logs import name_giver
from insdvl_replay.replay import replay_log
from insdvl_replay.report.csv_tables import report_csv
from insdvl_replay.report.folder import (
    COMPLETE,
    refuse_existing_file,
    refuse_existing_folder,
    result_file,
    result_folder,
)
from insdvl_replay.report.index_page import index_page
from insdvl_replay.report.json_report import Report, Tool, decode_report, encode_report, encode_reports
from insdvl_replay.report.markup import latex_report, markdown_report
from insdvl_replay.report.summary import Failure, summary_csv
from insdvl_replay.result_files import save_replay

OVERVIEWS: Final = {"summary.csv": summary_csv, "index.html": index_page}
"""What lays several dives beside each other, by the name of its file."""

PRINTED = {
    Format.TABLE: rendered,
    Format.JSON: lambda report: encode_report(report).decode(),
    Format.CSV: report_csv,
    Format.MARKDOWN: markdown_report,
    Format.LATEX: latex_report,
}


def result_targets(
    logs: Sequence[Path], output: Path, *, force: bool, one_dive: bool = False
) -> dict[Path, tuple[Path, ...]]:
    """Name each dive's result folder before any work is done.

    Parameters
    ----------
    logs : sequence of Path
    output : Path
        The folder above.
    force : bool
        Results that exist may be replaced.
    one_dive : bool
        All logs are one dive; else each is one.

    Returns
    -------
    dict of Path to tuple of Path
        Result folder to the logs of the dive, in the order of the logs.

    Raises
    ------
    ConfigError
        Two logs would share a folder, or a result exists.
    """
    targets: dict[Path, tuple[Path, ...]] = {}
    dives = [tuple(logs)] if one_dive else [(log,) for log in logs]
    for dive in dives:
        log = name_giver(dive)
        target = output / log.absolute().stem
        if len(dives) > 1 and target.name in OVERVIEWS:
            raise ConfigError(f"{log}: its results would bear the name of the summary", "rename it, or replay it alone")
        if target in targets:
            raise ConfigError(
                f"{targets[target][0]} and {log} would both write {target}",
                "replay them one by one, each with its own -o, or with --one-dive if they are parts of one dive",
            )
        refuse_existing_folder(target, force=force)
        targets[target] = dive
    if len(dives) > 1:
        for name in OVERVIEWS:
            refuse_existing_file(output / name, force=force)
    return targets


def replay_dives(
    targets: Mapping[Path, tuple[Path, ...]],
    config: Config,
    output: Path,
    format_: Format,
    *,
    allow_damaged: bool,
    control: bool,
    strict: bool,
    force: bool,
    verbosity: int,
) -> int:
    """Replay dives, one result folder each, and a summary if there are several.

    Parameters
    ----------
    targets : mapping of Path to tuple of Path
        From `result_targets`.
    config : Config
    output : Path
        Folder of the summary and the page that leads to all dives.
    format_ : Format
        Of what is printed.
    allow_damaged : bool
        Use what can be read of a damaged log.
    control : bool
        Add the baseline with its noise fitted.
    strict : bool
        Warnings make the exit code 3.
    force : bool
        Replace older results.
    verbosity : int
        1: say all notes, not the warnings alone; 2: also where in the code an error arose.

    Returns
    -------
    int
        The worst exit code.
    """
    outcomes: list[Report | Failure] = []
    codes: dict[str, int] = {}
    together = format_ is Format.JSON and len(targets) > 1
    for target, logs in targets.items():
        try:
            report = _replayed(logs, target, config, allow_damaged=allow_damaged, control=control, force=force)
        except Exception as error:
            outcomes.append(Failure(target.name, str(error)))
            codes[target.name] = tell_failure(error, verbosity)
            continue
        if not together:
            emit(PRINTED[format_](report))
        tell_notes(report.notes, verbose=verbosity > 0)
        tell(f"wrote {target}")
        outcomes.append(report)
        codes[target.name] = _refuse_warnings(report, verbosity) if strict else 0
    if together:
        emit(encode_reports([outcome for outcome in outcomes if isinstance(outcome, Report)]).decode())
    if len(targets) > 1:
        _summarise(outcomes, codes, output, force=force)
    return max(codes.values())


def _replayed(
    logs: tuple[Path, ...], target: Path, config: Config, *, allow_damaged: bool, control: bool, force: bool
) -> Report:
    """Replay one dive into its folder. The time of day is added here: what the hall writes depends on the log alone."""
    started_at, start_s = datetime.now(UTC).isoformat(timespec="seconds"), time.perf_counter()
    with patience(f"replaying {name_giver(logs).name}{compiling()}"):
        replay = (replay_with_control if control else replay_log)(logs, config, allow_damaged=allow_damaged)
        with result_folder(target, force=force) as folder:
            save_replay(replay, folder)
            tool = Tool(started_at=started_at, elapsed_s=round(time.perf_counter() - start_s, 3))
            report = msgspec.structs.replace(decode_report((folder / COMPLETE).read_bytes()), tool=tool)
            (folder / COMPLETE).write_bytes(encode_report(report))
    return report


def _refuse_warnings(report: Report, verbosity: int) -> int:
    warnings = [note.code for note in report.notes if note.severity == "warning"]
    if not warnings:
        return 0
    return tell_failure(
        LogError(
            f"{report.log.name}: --strict allows no warnings, found {', '.join(warnings)}",
            "the result is written; leave --strict out to accept it",
        ),
        verbosity,
    )


def _summarise(outcomes: Sequence[Report | Failure], codes: Mapping[str, int], output: Path, *, force: bool) -> None:
    for name, overview in OVERVIEWS.items():
        with result_file(output / name, force=force) as file:
            file.write_bytes(overview(outcomes))
        tell(f"wrote {output / name}")
    if failed := [name for name, code in codes.items() if code]:
        reasons = [outcome.reason for outcome in outcomes if isinstance(outcome, Failure)]
        first = f"; the first: {reasons[0]}" if reasons else ""
        tell(f"error: {len(failed)} of {len(codes)} logs failed: {', '.join(failed)}{first}")
