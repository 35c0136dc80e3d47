"""What a log holds, and everything that would stop a replay before its filters run."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from insdvl_replay.core.config import Config
from insdvl_replay.core.errors import UserError
from insdvl_replay.inspection.inventory import Inventory, Obstacle
from insdvl_replay.inspection.survey import survey_log
from insdvl_replay.preparation.alignment import check_start


def inspect_log(
    path: Path | Sequence[Path], config: Config, *, deep: bool = False, allow_damaged: bool = False
) -> Inventory:
    """Say what a log holds and whether it can be replayed.

    Parameters
    ----------
    path : Path or sequence of Path
        A log, a bag, or several of them that are one dive.
    config : Config
    deep : bool
        Read the messages of all roles whole, and go as far as a replay would before its filters run; else the first
        messages of each role tell about its clock and units.
    allow_damaged : bool
        Damage is told, and is no obstacle.

    Returns
    -------
    Inventory

    Raises
    ------
    LogError
        The file cannot be read at all.
    """
    inventory = survey_log(path, config, deep=deep, allow_damaged=allow_damaged)
    try:
        if inventory.obstacles or not deep:
            _check_start(inventory, config)
            return inventory
        # Not imported before it is needed: a look at the file alone takes less than the filters' import.
        from insdvl_replay.preparation.prepared import prepare_dive, with_reference_at_imu
        from insdvl_replay.preparation.reading import read_checked_dive

        dive = read_checked_dive(path, config, allow_damaged=allow_damaged)
        notes = prepare_dive(with_reference_at_imu(dive, config), config).notes
    except UserError as error:
        obstacle = Obstacle(error.message, error.hint)
        return replace(inventory, obstacles=(*inventory.obstacles, obstacle))
    return replace(inventory, notes=dive.notes + notes)


def _check_start(inventory: Inventory, config: Config) -> None:
    """Refuse what a replay would refuse for want of a start, by what the types of the reference can give."""
    reference = next(role for role in inventory.roles if role.role == "reference")
    if reference.candidates:
        # Which of them is chosen decides what it gives.
        return
    check_start(
        config.initial,
        has_reference=bool(reference.fields),
        has_position="latitude" in reference.fields,
        has_attitude="quaternion" in reference.fields or "roll" in reference.fields,
    )
