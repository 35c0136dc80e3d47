"""Velocities that an instrument has turned with its own attitude, turned back into the axes of the vehicle."""

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.errors import Note
from insdvl_replay.core.notes import note
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy, turned
from insdvl_replay.logs.formats.instrument_file import InstrumentFile


def turned_back(
    velocity_n: Floats,
    rpy_deg: Floats,
) -> Floats:
    """Return velocities in north, east, down, (k, 3), in forward, starboard, down by the attitude, (k, 3)."""
    mat_nb = mat_from_rpy(rpy_deg * DEG)
    return turned(np.swapaxes(mat_nb, -1, -2), velocity_n)


def turned_back_note(
    file: InstrumentFile,
    count: int,
    *,
    in_earth: bool,
) -> Note:
    """Report velocities that the instrument has turned."""
    what = "levelled by the instrument"
    if in_earth:
        what = "in axes of the earth"
    return note(
        "dvl_turned_back",
        count,
        file=file.path.name,
        what=what,
    )
