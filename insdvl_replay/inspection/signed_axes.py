"""Axes of an instrument as signed permutations, such as ``"+x-z+y"``."""

from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.logs.columns.imu import in_frd

_NAMES: Final = {"+x+y+z": "frd", "+x-y-z": "flu"}


def level_axes(force: Floats) -> list[Floats]:
    """List the right-handed axes in which gravity is felt upwards, as a level vehicle feels it, the likeliest first."""
    strongest = int(np.argmax(np.abs(force)))
    down = np.zeros(3)
    down[strongest] = -np.sign(force[strongest])
    forward = [axis for axis in (*np.eye(3), *-np.eye(3)) if not axis[strongest]]
    return [np.stack([axis, np.cross(down, axis), down]) for axis in forward]


def axes_text(rows: Floats) -> str:
    """Write axes as a signed permutation: forward, starboard and down in those of the instrument, (3, 3)."""
    text = ""
    for row in rows:
        sign = "+" if row.sum() > 0.0 else "-"
        text += sign + "xyz"[int(np.argmax(np.abs(row)))]
    return _NAMES.get(text, text)


def map_of(axes: str) -> Floats:
    """Return the map from readings to forward-starboard-down, (3, 3)."""
    return in_frd(np.eye(3), axes, "imu.axes").T
