"""A dive as it is replayed: read from its log, with its columns looked at."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from insdvl_replay import logs
from insdvl_replay.checks.plausibility import plausibility_notes
from insdvl_replay.checks.sensors import sensor_notes
from insdvl_replay.checks.solutions import solution_notes
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive


def read_checked_dive(path: Path | Sequence[Path], config: Config, *, allow_damaged: bool = False) -> Dive:
    """Read a dive, and look for what cannot be in its columns.

    Parameters
    ----------
    path, config, allow_damaged
        As of `logs.read_dive`.

    Returns
    -------
    Dive
        What is odd is a note.

    Raises
    ------
    LogError, ConfigError
        As of `logs.read_dive`; or the columns hold what would make the tables wrong.
    """
    dive = logs.read_dive(path, config, allow_damaged=allow_damaged)
    place = str(logs.name_giver((path,) if isinstance(path, Path) else path))
    notes = plausibility_notes(place, dive.imu, dive.dvl, dive.reference, config)
    notes += sensor_notes(dive.sensors, dive.reference, config)
    notes += solution_notes(dive.solutions, dive.reference, config)
    return replace(dive, notes=(*dive.notes, *notes))
