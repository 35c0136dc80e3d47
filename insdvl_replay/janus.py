"""The geometry of a Janus DVL: beams tilted from the instrument's z axis, evenly around it."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from insdvl_replay.columns import Floats
from insdvl_replay.states import DEG

TILT_DEG: Final = 30.0
"""From the z axis; most instruments have 20, 22.5, 25 or 30."""
AZIMUTH_DEG: Final = (45.0, 135.0, 225.0, 315.0)
"""From forward towards starboard."""


def beam_vectors(tilt_deg: float = TILT_DEG, azimuth_deg: Sequence[float] = AZIMUTH_DEG) -> Floats:
    """Make the unit vectors of the beams, from the instrument towards the seabed.

    Levy and Klein print vectors of rank 2 that are not of unit length; see equations/beams.md.

    Parameters
    ----------
    tilt_deg : float
        Angle from the DVL's z axis.
    azimuth_deg : sequence of float
        One for each beam, from forward towards starboard.

    Returns
    -------
    ndarray, shape (beams, 3)
        In d.
    """
    tilt, azimuth = tilt_deg * DEG, np.array(azimuth_deg) * DEG
    down = np.full_like(azimuth, np.cos(tilt))
    return np.column_stack([np.cos(azimuth) * np.sin(tilt), np.sin(azimuth) * np.sin(tilt), down])
