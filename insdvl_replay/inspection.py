"""A hall beside the replay: what a log holds, and everything that would stop a replay before its filters run."""

from dataclasses import replace
from pathlib import Path

from insdvl_replay import logs
from insdvl_replay.config import Config
from insdvl_replay.errors import UserError
from insdvl_replay.inventory import Inventory, Obstacle
from insdvl_replay.replay import prepare_dive


def inspect_log(path: Path, config: Config, *, deep: bool = False) -> Inventory:
    """Say what a log holds and whether it can be replayed.

    Parameters
    ----------
    path : Path
    config : Config
    deep : bool
        Read the messages of all roles whole, and go as far as a replay would before its filters run; else the first
        messages of each role tell about its clock and units.

    Returns
    -------
    Inventory

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    inventory = logs.survey_log(path, config, deep=deep)
    if not deep or inventory.obstacles:
        return inventory
    try:
        *_, notes = prepare_dive(logs.read_dive(path, config), config)
    except UserError as error:
        return replace(inventory, obstacles=(Obstacle(error.message, error.hint),))
    return replace(inventory, notes=inventory.notes + notes)
