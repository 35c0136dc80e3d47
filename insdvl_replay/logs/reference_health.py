"""Whether a reference can be what its log says: it moves where the sensors do, and is somewhere on Earth."""

from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.columns import DvlColumns, Floats, ImuColumns, ReferenceColumns, TimeNs, seconds
from insdvl_replay.errors import Note
from insdvl_replay.logs.dvl_comparison import Complex, horizontal, north_east_m
from insdvl_replay.logs.dvl_health import median_speed_mps
from insdvl_replay.logs.gyro_comparison import LONGEST_STEP_S, turned_by
from insdvl_replay.logs.imu_health import Check
from insdvl_replay.states import DEG

MOVING_MPS: Final = 0.1
"""What a DVL measures in the median while a vehicle moves, beyond its noise."""
TURNED: Final = 30.0 * DEG
"""What gyros add up to while a vehicle turns, beyond their bias and Earth's rate."""

_LEG_S: Final = 10.0
"""Over so long a leg, single positions of a receiver are good enough to tell a direction."""
_LEGS: Final = 4
_LEAST_M: Final = 20.0
_FOLLOWS: Final = 0.8
_ENOUGH: Final = 20


def reference_checks(imu: ImuColumns, dvl: DvlColumns, reference: ReferenceColumns) -> tuple[Check, ...]:
    """List what has to be looked at in a reference.

    Parameters
    ----------
    imu : ImuColumns
    dvl : DvlColumns
    reference : ReferenceColumns

    Returns
    -------
    tuple of Check
        They find quantities that never change while the sensors show a vehicle that moves, and positions that move
        in another way than the velocity says.
    """
    return (partial(_constant_notes, imu, dvl, reference), partial(_motion_notes, reference))


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


def _motion_notes(reference: ReferenceColumns) -> list[Note]:
    """Compare the ways between positions with what the velocity adds up to in the same time."""
    given = np.isfinite(reference.position[:, :2]).all(axis=1) & np.isfinite(reference.velocity_n).all(axis=1)
    if not given.any():
        return []
    gone_m, said_m = _legs(reference.time_ns[given], reference.position[given], horizontal(reference.velocity_n[given]))
    if len(gone_m) < _LEGS or min(np.abs(gone_m).sum(), np.abs(said_m).sum()) < _LEAST_M:
        return []
    coherence = float(np.vdot(gone_m, said_m).real / (np.linalg.norm(gone_m) * np.linalg.norm(said_m)))
    if coherence >= _FOLLOWS:
        return []
    text = (
        "the positions of the reference do not move as its velocity says, from the first on "
        f"(coherence {coherence:.2f})"
    )
    hint = "reference.axes, reference.angle_unit, or the fields reference.latitude, longitude and velocity_n"
    return [Note("reference_contradiction", text, int(np.count_nonzero(given)), "warning", hint)]


def _legs(time_ns: TimeNs, position: Floats, velocity: Complex) -> tuple[Complex, Complex]:
    """Give the ways of legs without a pause, in m: by the positions, and as the horizontal velocity adds up."""
    time_s = seconds(time_ns, time_ns[0])
    step_s = np.diff(time_s)
    summed_m = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step_s))
    pauses = np.concatenate([[0], np.cumsum(step_s > LONGEST_STEP_S)])
    rows = np.unique(np.searchsorted(time_s, np.arange(0.0, time_s[-1], _LEG_S)))
    whole = np.diff(pauses[rows]) == 0
    return np.diff(north_east_m(position)[rows])[whole], np.diff(summed_m[rows])[whole]


def _is_constant(rows: Floats) -> bool:
    given = rows[np.isfinite(rows).all(axis=1)]
    return len(given) >= _ENOUGH and bool((given == given[0]).all())


def _turns(imu: ImuColumns) -> bool:
    at_s = seconds(imu.time_ns, imu.time_ns[0])
    return bool(np.ptp(turned_by(imu, at_s), axis=0).max() > TURNED)
