"""Whether a reference can be what its log says: it moves where the sensors do, and is somewhere on Earth."""

from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.dvl import median_speed_mps
from insdvl_replay.checks.imu import LONGEST_STEP_S, Check, lies_within, turned_by
from insdvl_replay.core.dive_columns import DvlColumns, Floats, ImuColumns, ReferenceColumns, seconds
from insdvl_replay.core.errors import Note
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import AROUND, Complex, Steps, find_jumps, least_difference, steps_of, unexplained_m
from insdvl_replay.geometry.rotation import vector_from_mat

_LEG_S: Final = 10.0
"""Over so long a leg, single positions of a receiver are good enough to give a direction."""
_LEGS: Final = 4
_LEAST_M: Final = 20.0
_FOLLOWS: Final = 0.8
_LEGS_OF_SCALE: Final = 10  # fewer do not tell how they scatter
_SCALE_OFF: Final = 0.003
_SIGNIFICANT: Final = 3.0

_JUMP_M: Final = 2.0
_JUMP_RAD: Final = 5.0 * DEG
_CURVED_S: Final = 1.5  # in longer steps a turning vehicle turns unlike in the ones around


def motion_checks(imu: ImuColumns, reference: ReferenceColumns) -> tuple[Check, ...]:
    """List what has to be looked at in the motion of a reference."""
    return (
        partial(_scale_notes, reference),
        partial(_position_jump_notes, reference),
        partial(_attitude_jump_notes, imu, reference),
    )


def _scale_notes(reference: ReferenceColumns) -> list[Note]:
    """Compare displacements by positions with those by velocity, over legs."""
    by_position_m, by_velocity_m = _legs(steps_of(reference))
    if len(by_position_m) < _LEGS or min(np.abs(by_position_m).sum(), np.abs(by_velocity_m).sum()) < _LEAST_M:
        return []
    count = int(np.count_nonzero(reference.known["positions"] & reference.known["velocities"]))
    power, product = float(np.vdot(by_velocity_m, by_velocity_m).real), np.vdot(by_velocity_m, by_position_m).real
    coherence = float(product / (np.sqrt(power) * np.linalg.norm(by_position_m)))
    if coherence < _FOLLOWS:
        text = (
            "the positions of the reference do not move as its velocity says, from the first on "
            f"(coherence {coherence:.2f})"
        )
        hint = "reference.axes, reference.angle_unit, or the fields reference.latitude, longitude and velocity_n"
        return [Note("reference_contradiction", text, count, Severity.WARNING, hint)]
    # Noise of the velocity makes the one too small, noise of the positions the other too large: the scale lies between.
    scale, at_most = float(product / power), float(np.vdot(by_position_m, by_position_m).real / product)
    # Each leg's own residual stands for its noise, whatever its length.
    scale_sd = float(np.linalg.norm((by_velocity_m.conj() * (by_position_m - scale * by_velocity_m)).real)) / power
    off, surely_off = abs(scale - 1.0), max(scale - 1.0, 1.0 - at_most)
    if len(by_position_m) < _LEGS_OF_SCALE or surely_off < max(_SCALE_OFF, _SIGNIFICANT * scale_sd):
        return []
    text = (
        f"the positions of the reference go {100.0 * off:.2f} +- {100.0 * scale_sd:.2f} % "
        f"{'further' if scale > 1.0 else 'less far'} than its velocity says; it cannot be right in both"
    )
    hint = "a DVL whose dvl.scale fits the one fails the other"
    return [Note("reference_scale", text, len(by_position_m), Severity.WARNING, hint)]


def velocity_misfit(reference: ReferenceColumns) -> float | None:
    """Return by which part of the way its velocity and its positions differ over legs; None where they tell nothing."""
    by_position_m, by_velocity_m = _legs(steps_of(reference))
    way_m = float(np.linalg.norm(by_position_m))
    if len(by_position_m) < _LEGS or np.abs(by_position_m).sum() < _LEAST_M:
        return None
    return float(np.linalg.norm(by_velocity_m - by_position_m)) / way_m


def _legs(steps: Steps) -> tuple[Complex, Complex]:
    """Add steps up to legs, of which each has to be known whole and not much longer than it is meant to be."""
    if not len(steps.time_s):
        return steps.by_position_m, steps.by_velocity_m
    # Each leg begins with the first row at or behind a multiple of its length, of which the last row ends one.
    legs = np.floor(steps.time_s / _LEG_S)
    legs[-1] = np.ceil(steps.time_s[-1] / _LEG_S) - 1.0
    rows = np.append(0, np.flatnonzero(np.diff(legs) > 0.0) + 1)
    by_position_m, by_velocity_m = (
        np.diff(np.append(0.0, np.cumsum(way_m))[rows])
        for way_m in (steps.by_position_m, np.nan_to_num(steps.by_velocity_m))
    )
    unknown = np.diff(np.append(0, np.cumsum(~np.isfinite(steps.by_velocity_m)))[rows])
    whole = (unknown == 0) & (np.diff(steps.time_s[rows]) < 2.0 * _LEG_S)
    return by_position_m[whole], by_velocity_m[whole]


def _position_jump_notes(reference: ReferenceColumns) -> list[Note]:
    """Find steps that neither the velocity nor any of the steps around explains."""
    steps = steps_of(reference)
    unlike_m = unexplained_m(steps)
    return _jump_notes("positions", unlike_m, _JUMP_M, "m", 1.0, steps.time_s)


def _attitude_jump_notes(imu: ImuColumns, reference: ReferenceColumns) -> list[Note]:
    """Find turns from row to row that the gyros do not show, and that are no error of gyros.

    Such an error is in the steps around, too, and is smaller than what they show.
    """
    rows = np.flatnonzero(reference.known["attitudes"] & lies_within(reference.time_ns, imu.time_ns))
    if len(rows) <= 2 * AROUND + 1:
        return []
    time_s, mat_nb = seconds(reference.time_ns[rows], imu.time_ns[0]), reference.mat_nb[rows]
    step_s = np.diff(time_s)
    shown = np.diff(turned_by(imu, time_s), axis=0)
    unseen = vector_from_mat(np.swapaxes(mat_nb[:-1], 1, 2) @ mat_nb[1:]) - shown
    unlike = np.fmin(np.linalg.norm(unseen, axis=1), least_difference(unseen))
    unlike[step_s > _CURVED_S] = np.nan
    smallest = np.maximum(_JUMP_RAD, np.linalg.norm(shown, axis=1))
    return _jump_notes("attitudes", unlike, smallest, "deg", DEG, time_s - time_s[0])


def _jump_notes(
    quantity: str, unlike: Floats, smallest: float | Floats, unit: str, factor: float, time_s: Floats
) -> list[Note]:
    jumps = find_jumps(unlike, smallest)
    if not jumps.size:
        return []
    largest = int(jumps[np.argmax(unlike[jumps])])
    text = (
        f"the {quantity} of the reference jump in {jumps.size} of {len(unlike)} steps, the most by "
        f"{unlike[largest] / factor:.1f} {unit} at {time_s[largest + 1]:.1f} s after the first"
    )
    hint = "--start and --end choose a part without jumps, which count as errors of the filters"
    return [Note("reference_jump", text, int(jumps.size), Severity.WARNING, hint)]


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
            Severity.WARNING,
            "reference.topic and reference.fix name others",
        )
        for name, doing in found
    ]


def says_anything(reference: ReferenceColumns) -> bool:
    """Return whether it gives an attitude, a position, or a velocity that is not always zero."""
    return reference.has_attitude or reference.has_position or bool(np.nan_to_num(reference.velocity_n).any())


def _is_constant(rows: Floats) -> bool:
    given = rows[np.isfinite(rows).all(axis=1)]
    return len(given) >= _ENOUGH and bool((given == given[0]).all())


def _turns(imu: ImuColumns) -> bool:
    at_s = seconds(imu.time_ns, imu.time_ns[0])
    return bool(np.ptp(turned_by(imu, at_s, LONGEST_STEP_S), axis=0).max() > TURNED)
