"""``insdvl-replay inspect``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insdvl_replay.cli.messages import log_failure, log_to_stderr, write_stdout
from insdvl_replay.cli.options import (
    Colored,
    ConfigFiles,
    Force,
    Format,
    Logs,
    OneDive,
    Preset,
    Settings,
    Verbose,
)

if TYPE_CHECKING:
    from insdvl_replay.core.config import Config
    from insdvl_replay.inspection.inventory import Inventory


def inspect(
    logs: Logs,
    deep: Annotated[
        bool, typer.Option("--deep", help="Read the messages of all roles whole, not only the first of each.")
    ] = False,
    propose: Annotated[
        Path | None,
        typer.Option("--propose", metavar="FILE", help="Write settings with which to run these dives; looks deep."),
    ] = None,
    config: ConfigFiles = [],  # noqa: B006
    preset: Preset = None,
    settings: Settings = [],  # noqa: B006
    format_: Annotated[Format, typer.Option("--format", help="How it is printed.")] = "table",
    allow_damaged: Annotated[
        bool, typer.Option("--allow-damaged", help="Damage is no obstacle; what is lost is said.")
    ] = False,
    one_dive: OneDive = False,
    force: Force = False,
    verbose: Verbose = 0,
    color: Colored = "auto",
) -> int:
    """Say what is in a log, which topics a replay would use and why, and what would stop it.

    For what it cannot assign it prints settings to start from. --propose writes a file of them that `run -c` takes,
    with what trial runs show of noise, mounting and heading; what a person must decide stands in it. The exit code is 0
    whether or not the log can be replayed, and 3 when a file cannot be read at all; this does not stop the others.

    \b
    Example:
      insdvl-replay inspect dive.mcap
      insdvl-replay inspect dive.mcap --deep -c vehicle.toml
      insdvl-replay inspect dive.mcap --propose proposed.toml
      insdvl-replay inspect dives/*.mcap --format json
      insdvl-replay inspect sensors.mcap gnss.mcap --one-dive
    """
    from insdvl_replay.batch.dive_paths import find_dives
    from insdvl_replay.cli.screen import spinner, written
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.core.result import as_json
    from insdvl_replay.inspection.inventory import inspection_result, inventory_csv
    from insdvl_replay.inspection.survey import inspect_log
    from insdvl_replay.results.folder import require_replaceable_file

    if propose is not None:
        require_replaceable_file(propose, force=force)
    given, code = load_config(preset, config, settings, allow_code=True), 0
    if given.code:
        log_to_stderr(f"info: inspect runs no code of the settings; it leaves out {', '.join(given.code)}")
    resolved = given.without_code()
    found = find_dives(logs)
    dives = [found] if one_dive else [[dive] for dive in found]
    inventories: list[Inventory] = []
    inspected: list[Sequence[Path]] = []
    for dive in dives:
        try:
            with spinner(f"inspecting {dive[0].name}"):
                inventory = inspect_log(dive, resolved, deep=deep or propose is not None, allow_damaged=allow_damaged)
        except Exception as error:
            code = max(code, log_failure(error, verbose))
            continue
        if format_ != "json":
            is_csv, space = format_ == "csv", "\n" if inventories else ""
            text = inventory_csv(inventory) if is_csv else written(inspection_result(inventory), format_)
            write_stdout(space + text)
        inventories.append(inventory)
        inspected.append(dive)
    if format_ == "json":
        for content in [inventories] if len(dives) > 1 else inventories:
            write_stdout(as_json(content).decode())
    if propose is not None and inspected:
        _propose(propose, inspected, resolved, allow_damaged=allow_damaged, force=force)
    return code


def _propose(
    target: Path, dives: "Sequence[Sequence[Path]]", config: "Config", *, allow_damaged: bool, force: bool
) -> None:
    """Write settings; what is left to a person is said on stderr too."""
    from insdvl_replay.cli.screen import compiling, spinner
    from insdvl_replay.core.config_file import load_config
    from insdvl_replay.inspection.trial_runs import settings_file
    from insdvl_replay.results.folder import result_file

    with spinner(f"trying settings{compiling()}"):
        proposed = settings_file(dives, config, allow_damaged=allow_damaged)
    with result_file(target, force=force) as path:
        path.write_text(proposed.text, "utf-8")
        load_config(file=path)  # what could not be read back is not put in place
    log_to_stderr(f"wrote {target}")
    for failure in proposed.failures:
        log_to_stderr(f"stops a replay with it: {failure.message}; {failure.hint}")
    if proposed.decisions:
        log_to_stderr(f"to decide in it: {', '.join(proposed.decisions)}")
    if proposed.missing:
        log_to_stderr(f"without a value in it: {' '.join(f'--set {key}=...' for key in proposed.missing)}")
