"""Whether a DVL can be what its log says: in its unit, alive, and moving as the reference does.

What would make the tables wrong ends the work with the key that puts it right; what may make them wrong is a warning.
Horizontal vectors are complex numbers: forward or north, plus i times starboard or east.
"""

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from insdvl_replay.checks.imu import AXES, ENOUGH, LONGEST_STEP_S, Check, lies_within
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import DvlColumns, Floats, ReferenceColumns, TimeNs, seconds
from insdvl_replay.core.errors import LogError, Note
from insdvl_replay.core.states import DEG, FASTEST_MPS
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.frames import Complex, DvlMounting, horizontal, solve_beams
from insdvl_replay.geometry.rotation import wrap_angle

_LEAST_SPEED_MPS: Final = 0.2  # above a DVL's noise and a lever arm's swing
_LEAST_EXCURSION_MPS: Final = 0.015  # below it a DVL shows its noise


@dataclass(frozen=True)
class Fit:
    """How one series of horizontal vectors follows another.

    Attributes
    ----------
    scale : float
        Length of the first over the second.
    turn : float
        Angle by which the first is turned from the second, towards starboard, rad.
    coherence : float
        1 where the first is the second turned and scaled, 0 where they have nothing to do with each other.
    """

    scale: float
    turn: float
    coherence: float


def fit(measured: Complex, true: Complex) -> Fit:
    """Fit ``measured = scale exp(i turn) true`` by least squares, both of shape (k,)."""
    product = complex(np.vdot(true, measured))
    power, other_power = float(np.vdot(true, true).real), float(np.vdot(measured, measured).real)
    if not power or not other_power:
        return Fit(0.0, 0.0, 0.0)
    return Fit(abs(product) / power, float(np.angle(product)), abs(product) / float(np.sqrt(power * other_power)))


def dvl_by_velocity(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> Fit | None:
    """Compare the DVL's horizontal velocity in body axes with the reference's.

    Parameters
    ----------
    config : Config
        Mounting rotation and scale of the DVL.

    Returns
    -------
    Fit or None
        None where too few rows move, or lack velocity or attitude.
    """
    measured_b, true_b = _velocity_pairs(dvl, reference, config)
    measured, true = horizontal(measured_b), horizontal(true_b)
    moving = np.abs(true) > _LEAST_SPEED_MPS
    return fit(measured[moving], true[moving]) if np.count_nonzero(moving) >= ENOUGH else None


def axes_by_velocity(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> Floats:
    """Correlate the DVL's velocity with the reference's along each axis of the body, shape (3,).

    It is NaN along axes on which the velocity changes too little to tell.
    """
    measured_b, true_b = _velocity_pairs(dvl, reference, config)
    found = np.full(3, np.nan)
    if len(true_b) < ENOUGH:
        return found
    for axis in np.flatnonzero((true_b.std(axis=0) > _LEAST_EXCURSION_MPS) & (measured_b.std(axis=0) > 0.0)):
        found[axis] = np.corrcoef(measured_b[:, axis], true_b[:, axis])[0, 1]
    return found


def _velocity_pairs(dvl: DvlColumns, reference: ReferenceColumns, config: Config) -> tuple[Floats, Floats]:
    """Return the velocities of DVL and reference in body axes, at times of the reference that have both."""
    ping_ns, measured_b = velocities_b(dvl, config)
    complete = np.isfinite(reference.velocity_n).all(axis=1) & np.isfinite(reference.mat_nb).all(axis=(1, 2))
    if len(ping_ns) < ENOUGH:
        return np.empty((0, 3)), np.empty((0, 3))
    rows = np.flatnonzero(complete & lies_within(reference.time_ns, ping_ns))
    rows = rows[_pause_s(ping_ns, reference.time_ns[rows]) <= LONGEST_STEP_S]
    true_b = np.einsum("kji,kj->ki", reference.mat_nb[rows], reference.velocity_n[rows])
    at_s, ping_s = seconds(reference.time_ns[rows], ping_ns[0]), seconds(ping_ns, ping_ns[0])
    return np.stack([np.interp(at_s, ping_s, column) for column in measured_b.T], axis=1), true_b


def velocities_b(dvl: DvlColumns, config: Config) -> tuple[TimeNs, Floats]:
    """Return the velocities in body axes of the pings that have a velocity or all beams."""
    if dvl.velocity_d is not None:
        velocity_d = dvl.velocity_d
    elif dvl.beam_velocity_mps is not None and dvl.beam_vectors_d is not None:
        velocity_d = solve_beams(dvl.beam_velocity_mps, dvl.beam_vectors_d)[0]
        velocity_d[~np.isfinite(dvl.beam_velocity_mps).all(axis=1)] = np.nan
    else:
        raise ValueError("a DVL gives beams with their vectors, or velocities")
    good = np.isfinite(velocity_d).all(axis=1)
    mounting = DvlMounting.from_rpy(config.dvl.lever_arm_m, config.dvl.mounting_rpy_deg, config.dvl.scale)
    return dvl.time_ns[good], mounting.velocity_b(velocity_d[good])


def _pause_s(time_ns: TimeNs, at_ns: TimeNs) -> Floats:
    """Return the length of the step of ``time_ns`` in which each time lies."""
    after = np.clip(np.searchsorted(time_ns, at_ns), 1, len(time_ns) - 1)
    return seconds(time_ns[after], time_ns[after - 1])


SCALE_DOUBT: Final = 0.1
"""Share of a speed or a rate beyond what temperature, sound speed and lever arm explain."""
DIRECTION_DOUBT: Final = 10.0 * DEG
"""Beyond what lever arm and sideslip turn a velocity on average."""
FACTOR_OF_UNITS: Final = 5.0
"""A scale that is off by more is no calibration but another unit."""
COHERENT: Final = 0.97
"""Only what follows the reference this well can be measured by it."""
INCOHERENT: Final = 0.95
"""What follows the reference worse than this contradicts it."""
OPPOSITE: Final = -0.5
"""Correlation below which a velocity has the opposite sign; that of sound logs is above 0.7."""
UNIT_HINT: Final = 'dvl.velocity_unit = "mm/s", or "cm/s"; a wrong beam geometry is never that wrong'


def dvl_checks(place: str, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config) -> tuple[Check, ...]:
    """List what has to be looked at in the pings of a DVL."""
    return (
        partial(_speed_notes, place, dvl),
        partial(_zero_notes, dvl),
        partial(_constant_notes, dvl),
        partial(_velocity_notes, place, dvl, reference, config),
    )


def median_speed_mps(dvl: DvlColumns) -> float:
    """Return the largest component of a ping in the median, 0 without any."""
    values = dvl.velocity_d if dvl.velocity_d is not None else dvl.beam_velocity_mps
    if values is None or not np.isfinite(values).any():
        return 0.0
    return float(np.median(np.abs(values).max(axis=1, initial=0.0, where=np.isfinite(values))))


def scale_notes(place: str, scale: float, dvl: DvlColumns, config: Config) -> list[Note]:
    """Doubt the scale of a DVL, and refuse what must be another unit."""
    if abs(scale - 1.0) <= SCALE_DOUBT:
        return []
    text = f"the DVL's velocity is {scale:.3f} times the reference's, from the first ping on"
    if not 1.0 / FACTOR_OF_UNITS < scale < FACTOR_OF_UNITS:
        raise LogError(text, UNIT_HINT, place)
    hint = f"dvl.scale = {scale * config.dvl.scale:.3f}, or dvl.beam_tilt_deg"
    return [Note("dvl_scale", text, len(dvl.time_ns), Severity.WARNING, hint)]


def _speed_notes(place: str, dvl: DvlColumns) -> list[Note]:
    """Refuse speeds that no vehicle has for long."""
    speed_mps = median_speed_mps(dvl)
    if speed_mps > FASTEST_MPS:
        raise LogError(f"the DVL's largest component is {speed_mps:g} m/s in the median of its pings", UNIT_HINT, place)
    return []


def _zero_notes(dvl: DvlColumns) -> list[Note]:
    """Find pings that are exactly zero, as some instruments report without a lock."""
    values = dvl.velocity_d if dvl.velocity_d is not None else dvl.beam_velocity_mps
    if values is None:
        return []
    zero = np.flatnonzero((values == 0.0).all(axis=1))
    if not zero.size:
        return []
    first_s = float(seconds(dvl.time_ns[zero[:1]], dvl.time_ns[0])[0])
    text = (
        f"{zero.size} of {len(values)} pings are exactly zero, the first {first_s:.1f} s after the first ping: "
        "the instrument may have had no lock"
    )
    return [
        Note("dvl_zero", text, int(zero.size), Severity.WARNING, 'dvl.valid = "field.path" names what marks good pings')
    ]


def _constant_notes(dvl: DvlColumns) -> list[Note]:
    """Find beams or components that never change while others do."""
    columns = {}
    if dvl.velocity_d is not None:
        columns = dict(zip(AXES, dvl.velocity_d.T, strict=True))
    elif dvl.beam_velocity_mps is not None:
        columns = {f"along beam {i}": column for i, column in enumerate(dvl.beam_velocity_mps.T, start=1)}
    notes = []
    for name, column in columns.items():
        given = column[np.isfinite(column)]
        if len(given) >= ENOUGH and np.all(given == given[0]):
            always_mps = given[0] + 0.0  # which is never a negative zero
            text = (
                f"the velocity {name} is {always_mps:g} m/s in all {len(given)} pings that have it, from the first on"
            )
            hint = "dvl.velocity or dvl.beam_velocity names other fields"
            notes.append(Note("dvl_constant", text, len(given), Severity.WARNING, hint))
    return notes


def _velocity_notes(place: str, dvl: DvlColumns, reference: ReferenceColumns | None, config: Config) -> list[Note]:
    if reference is None:
        return []
    opposite = axes_by_velocity(dvl, reference, config)[1:] < OPPOSITE
    found = dvl_by_velocity(dvl, reference, config)
    if found is not None and found.coherence >= COHERENT and abs(found.turn) > DIRECTION_DOUBT:
        return [*scale_notes(place, found.scale, dvl, config), _direction_note(found, dvl, config)]
    if opposite.any():
        return [_axes_note([axis for axis, turned in zip(AXES[1:], opposite, strict=True) if turned], dvl)]
    if found is None or found.coherence >= COHERENT:
        return [] if found is None else scale_notes(place, found.scale, dvl, config)
    return [_contradiction_note(found, dvl)] if found.coherence < INCOHERENT else []


def _direction_note(found: Fit, dvl: DvlColumns, config: Config) -> Note:
    roll, pitch, heading = config.dvl.mounting_rpy_deg
    right = float(wrap_angle(np.asarray(heading * DEG - found.turn))) / DEG
    text = f"the DVL's velocity is turned by {found.turn / DEG:.0f} deg from the reference's, from the first ping on"
    hint = f"dvl.mounting_rpy_deg = [{roll:g}, {pitch:g}, {right:.0f}], or another reference.axes"
    return Note("dvl_direction", text, len(dvl.time_ns), Severity.WARNING, hint)


def _axes_note(axes: list[str], dvl: DvlColumns) -> Note:
    text = (
        f"the DVL's velocity has the opposite sign of the reference's along {' and '.join(axes)}, "
        "from the first ping on"
    )
    hint = 'dvl.axes = "flu" where it is "frd" now, or the reverse; for beams, dvl.beam_azimuth_deg'
    return Note("dvl_axes", text, len(dvl.time_ns), Severity.WARNING, hint)


def _contradiction_note(found: Fit, dvl: DvlColumns) -> Note:
    text = (
        f"the DVL's velocity does not follow the reference's, from the first ping on (coherence {found.coherence:.2f})"
    )
    hint = "dvl.beam_azimuth_deg, dvl.axes, reference.axes, or dvl.stamp and reference.stamp"
    return Note("dvl_contradiction", text, len(dvl.time_ns), Severity.WARNING, hint)
