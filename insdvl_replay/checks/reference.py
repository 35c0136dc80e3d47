"""Whether a reference can be what its log says: it moves where the sensors do, and is somewhere on Earth."""

from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import median_speed_mps
from insdvl_replay.checks.gyro_comparison import LONGEST_STEP_S, turned_by
from insdvl_replay.checks.imu import Check
from insdvl_replay.checks.reference_motion import motion_checks
from insdvl_replay.core.columns import DvlColumns, Floats, ImuColumns, ReferenceColumns, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DEG

MOVING_MPS: Final = 0.1
"""What a DVL measures in the median while a vehicle moves, beyond its noise."""
TURNED: Final = 30.0 * DEG
"""What gyros add up to while a vehicle turns, beyond their bias and Earth's rate."""

_ENOUGH: Final = 20


def reference_checks(imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns) -> tuple[Check, ...]:
    """List what has to be looked at in a reference."""
    return (partial(_constant_notes, imu, dvl, reference), *motion_checks(imu, reference))


def _constant_notes(imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns) -> list[Note]:
    found = []
    if median_speed_mps(dvl) > MOVING_MPS:
        # A velocity may be constant, but not zero.
        velocities = reference.velocity_n[reference.known["velocities"]]
        resting = len(velocities) > 0 and not velocities.any()
        still = {"position": _is_constant(reference.position[:, :2]), "velocity": resting}
        found += [(name, "the DVL measures a speed") for name, stands in still.items() if stands]
    if _is_constant(reference.mat_nb.reshape(-1, 9)) and _turns(imu):
        found.append(("attitude", "the gyros show turns"))
    return [
        Note(
            "reference_constant",
            f"the {name} of the reference is the same in all its rows, from the first on, while {doing}",
            len(reference.time_ns),
            "warning",
            "reference.topic and reference.fix name others",
        )
        for name, doing in found
    ]


def _is_constant(rows: Floats) -> bool:
    given = rows[np.isfinite(rows).all(axis=1)]
    return len(given) >= _ENOUGH and bool((given == given[0]).all())


def _turns(imu: ImuColumns) -> bool:
    at_s = seconds(imu.time_ns, imu.time_ns[0])
    return bool(np.ptp(turned_by(imu, at_s, LONGEST_STEP_S), axis=0).max() > TURNED)
