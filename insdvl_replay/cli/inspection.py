"""``insdvl-replay inspect``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from insdvl_replay.cli.messages import emit
from insdvl_replay.cli.options import Preset, Settings, Verbose


class InspectionFormat(StrEnum):
    """How an inventory is printed."""

    TABLE = "table"
    JSON = "json"


def inspect(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A recorded dive.")],
    deep: Annotated[
        bool, typer.Option("--deep", help="Read the messages of all roles whole, not only the first of each.")
    ] = False,
    config: Annotated[
        Path | None, typer.Option("-c", "--config", metavar="FILE", help="Settings as TOML, on top of the preset.")
    ] = None,
    preset: Preset = None,
    settings: Settings = [],  # noqa: B006
    format_: Annotated[InspectionFormat, typer.Option("--format", help="How it is printed.")] = InspectionFormat.TABLE,
    verbose: Verbose = 0,
) -> None:
    """Say what is in a log, which topics a replay would use and why, and what would stop it.

    For what it cannot assign it prints settings to start from. The exit code is 0 whether or not the log can be
    replayed, and 3 when the file cannot be read at all.

    \b
    Example:
      insdvl-replay inspect dive.mcap
      insdvl-replay inspect dive.mcap --deep -c vehicle.toml
      insdvl-replay inspect dive.mcap --format json
    """
    from insdvl_replay.cli.screen import patience, printed
    from insdvl_replay.config_file import load_config
    from insdvl_replay.inspection import inspect_log
    from insdvl_replay.report.inspection import encode_inventory, terminal_inventory

    with patience(f"reading {log.name}"):
        inventory = inspect_log(log, load_config(preset, config, settings), deep=deep)
    if format_ is InspectionFormat.JSON:
        emit(encode_inventory(inventory).decode())
    else:
        tables, sentences = terminal_inventory(inventory)
        emit(printed(tables) + "".join(f"{line}\n" for line in sentences))
