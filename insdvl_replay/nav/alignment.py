"""Where and how a filter starts: from the reference, or level from gravity (configuration section ``[initial]``)."""

from dataclasses import dataclass

import numpy as np

from insdvl_replay import earth
from insdvl_replay.columns import Floats, ImuColumns, ReferenceColumns, TimeNs, seconds
from insdvl_replay.config import Initial
from insdvl_replay.errors import ConfigError, LogError, Note
from insdvl_replay.nav.dvl import DvlVelocities
from insdvl_replay.nav.start import Start
from insdvl_replay.rotation import mat_from_rpy, wrap_angle
from insdvl_replay.states import BA, BG, DEG, DEG_PER_HOUR, DV, MG, PHI

LEVELLING_S = 10.0
"""Time over which gravity is averaged to level the vehicle."""
FEWEST_SAMPLES = 10
"""With fewer samples gravity is not told from motion."""
FAR_S = 1.0
"""A reference row further than this from the start says little about it: a vehicle moves on."""


@dataclass(frozen=True)
class Alignment:
    """The start of a replay.

    Attributes
    ----------
    start_ns : int
        When the filters start.
    start : Start
        State and uncertainty.
    notes : tuple of Note
        What was taken from elsewhere than the reference.
    """

    start_ns: int
    start: Start
    notes: tuple[Note, ...]


def align(
    imu: ImuColumns,
    velocities: DvlVelocities,
    reference: ReferenceColumns | None,
    initial: Initial,
    lever_arm_b: Floats,
    start_ns: int,
    end_ns: int,
) -> Alignment:
    """Find the start: the reference's first attitude inside the span, or the first sample when levelling.

    What the reference lacks is taken from gravity (roll, pitch), from the first ping (velocity) and from the
    configuration (heading, position), each with a note.

    Parameters
    ----------
    imu : ImuColumns
    velocities : DvlVelocities
        Pings.
    reference : ReferenceColumns or None
    initial : Initial
        Configuration.
    lever_arm_b : ndarray, shape (3,)
        IMU to DVL, m.
    start_ns, end_ns : int
        Span that IMU and configuration allow.

    Returns
    -------
    Alignment

    Raises
    ------
    LogError
        The reference is missing or does not overlap the span.
    ConfigError
        Heading or latitude are needed and not configured.
    """
    notes: list[Note] = []
    check_start(
        initial,
        has_reference=reference is not None,
        has_position=reference is not None and reference.has_position,
        has_attitude=reference is not None and reference.has_attitude,
    )
    if initial.source == "level":
        reference = None
    if reference is not None and reference.has_attitude:
        start_ns = _first_attitude_ns(reference, start_ns, end_ns)
    position = _position(reference, initial, start_ns, notes)
    mat_nb = _attitude(imu, reference, initial, start_ns, notes)
    velocity_n = _velocity(imu, velocities, reference, mat_nb, lever_arm_b, start_ns, position, notes)
    start = Start(
        position,
        velocity_n,
        mat_nb,
        initial_sd(initial),
        np.array(initial.accel_bias_mg) * MG,
        np.array(initial.gyro_bias_degph) * DEG_PER_HOUR,
    )
    return Alignment(start_ns, start, tuple(notes))


def check_start(initial: Initial, *, has_reference: bool, has_position: bool, has_attitude: bool) -> None:
    """Refuse settings that leave open where or how a filter starts.

    Parameters
    ----------
    initial : Initial
    has_reference, has_position, has_attitude : bool
        Whether there is a reference, and what it gives.

    Raises
    ------
    LogError
        A reference is wanted, and there is none.
    ConfigError
        Heading or latitude are needed and not configured.
    """
    from_reference = initial.source == "reference"
    if from_reference and not has_reference:
        raise LogError(
            "no reference solution was found to start from",
            "name it with --set reference.topic=... and its fields, or start level: --set initial.source=level "
            "--set initial.heading_deg=... --set initial.latitude_deg=...",
        )
    if not (from_reference and has_position):
        _configured_latitude_deg(initial)
    if not (from_reference and has_attitude):
        _configured_heading_deg(initial)


def _configured_latitude_deg(initial: Initial) -> float:
    if initial.latitude_deg is None:
        raise ConfigError(
            "the latitude is needed for gravity and Earth rate, and no reference gives it",
            "--set initial.latitude_deg=...",
        )
    return initial.latitude_deg


def _configured_heading_deg(initial: Initial) -> float:
    if initial.heading_deg is None:
        raise ConfigError(
            "the heading at the start is needed, and no reference gives it", "--set initial.heading_deg=..."
        )
    return initial.heading_deg


def initial_sd(initial: Initial) -> Floats:
    """Give the initial standard deviations of the 12 error states.

    Parameters
    ----------
    initial : Initial

    Returns
    -------
    ndarray, shape (12,), SI units
    """
    sd = np.empty(12)
    sd[DV] = initial.velocity_sd_mps
    sd[PHI] = np.array(initial.misalignment_sd_deg) * DEG
    sd[BA] = initial.accel_bias_sd_mg * MG
    sd[BG] = initial.gyro_bias_sd_degph * DEG_PER_HOUR
    return sd


def _first_attitude_ns(reference: ReferenceColumns, start_ns: int, end_ns: int) -> int:
    """Find the first attitude in the span, if possible one that has a position near it."""
    has_attitude = np.isfinite(reference.mat_nb).all(axis=(1, 2))
    inside = has_attitude & (reference.time_ns >= start_ns) & (reference.time_ns < end_ns)
    located = inside & (_apart_s(reference.time_ns, reference.position[:, :2], reference.time_ns) <= FAR_S)
    inside = located if located.any() else inside
    if not inside.any():
        raise LogError(
            "the reference gives no attitude between the first and the last IMU sample of the span",
            "check that both are stamped by the same clock (imu.stamp, reference.stamp), or widen --start and --end",
        )
    return int(reference.time_ns[np.argmax(inside)])


def _position(reference: ReferenceColumns | None, initial: Initial, start_ns: int, notes: list[Note]) -> Floats:
    if reference is not None and reference.has_position:
        return _reference_position(reference, initial, start_ns, notes)
    latitude_deg = _configured_latitude_deg(initial)
    notes.append(Note("start_position_configured", f"started at the configured latitude {latitude_deg:g} deg"))
    return np.array([latitude_deg * DEG, initial.longitude_deg * DEG, initial.height_m])


def _reference_position(reference: ReferenceColumns, initial: Initial, start_ns: int, notes: list[Note]) -> Floats:
    horizontal, height_m = reference.position[:, :2].copy(), reference.position[:, 2:]
    first_longitude = horizontal[np.argmax(np.isfinite(horizontal).all(axis=1)), 1]
    horizontal[:, 1] = wrap_angle(horizontal[:, 1] - first_longitude)  # so that 180 deg lies between no two rows
    latitude, longitude = _at(reference.time_ns, horizontal, start_ns)
    apart_s = float(_apart_s(reference.time_ns, horizontal, np.array([start_ns]))[0])
    if apart_s > FAR_S:
        text = f"the position at the start is the reference's {apart_s:.1f} s away from it, and is off by as much"
        notes.append(
            Note("start_position_far", text, severity="warning", hint="--start near the reference's positions")
        )
    if np.isfinite(height_m).any():
        start_height_m = _at(reference.time_ns, height_m, start_ns)[0]
    else:
        start_height_m = initial.height_m
        notes.append(Note("start_height_configured", f"started at the configured height {initial.height_m:g} m"))
    return np.array([latitude, float(wrap_angle(longitude + first_longitude)), start_height_m])


def _attitude(
    imu: ImuColumns, reference: ReferenceColumns | None, initial: Initial, start_ns: int, notes: list[Note]
) -> Floats:
    if reference is not None and reference.has_attitude:
        there: Floats = reference.mat_nb[np.searchsorted(reference.time_ns, start_ns)]
        return there
    heading_deg = _configured_heading_deg(initial)
    rpy = level_from_gravity(imu, start_ns)
    rpy[2] = heading_deg * DEG
    notes.append(
        Note(
            "start_levelled",
            f"roll {rpy[0] / DEG:.2f} deg and pitch {rpy[1] / DEG:.2f} deg from gravity over {LEVELLING_S:g} s, "
            f"heading {heading_deg:g} deg from the configuration",
        )
    )
    return mat_from_rpy(rpy)


def level_from_gravity(imu: ImuColumns, start_ns: int) -> Floats:
    """Give roll and pitch from the mean specific force after the start; the heading is left at zero.

    Levelling as in Groves, chapter 5.

    Parameters
    ----------
    imu : ImuColumns
    start_ns : int

    Returns
    -------
    ndarray, shape (3,), rad

    Raises
    ------
    LogError
        Hardly a sample follows the start.
    """
    rows = (imu.time_ns >= start_ns) & (imu.time_ns <= start_ns + int(LEVELLING_S * 1e9))
    if rows.sum() < FEWEST_SAMPLES:
        raise LogError(
            f"only {rows.sum()} IMU samples lie in the {LEVELLING_S:g} s after the start, too few to find the level",
            "choose another --start",
        )
    x, y, z = imu.specific_force_b[rows].mean(axis=0)
    return np.array([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z)), 0.0])


def _velocity(
    imu: ImuColumns,
    velocities: DvlVelocities,
    reference: ReferenceColumns | None,
    mat_nb: Floats,
    lever_arm_b: Floats,
    start_ns: int,
    position: Floats,
    notes: list[Note],
) -> Floats:
    at_start = np.array([start_ns])
    if reference is not None and _apart_s(reference.time_ns, reference.velocity_n, at_start)[0] <= FAR_S:
        return _at(reference.time_ns, reference.velocity_n, start_ns)
    nearest = int(np.argmin(np.abs(velocities.time_ns - start_ns)))
    rate_ib_b = _at(imu.time_ns, imu.angular_rate_b, int(velocities.time_ns[nearest]))
    rate_ie_n = earth.EARTH_RATE * np.array([np.cos(position[0]), 0.0, -np.sin(position[0])])
    rate_eb_b = rate_ib_b - mat_nb.T @ rate_ie_n
    apart_s = abs(int(velocities.time_ns[nearest]) - start_ns) * 1e-9
    notes.append(Note("start_velocity_dvl", f"velocity at the start from the DVL's ping {apart_s:.2f} s away"))
    velocity_n: Floats = mat_nb @ (velocities.velocity_b[nearest] - np.cross(rate_eb_b, lever_arm_b))
    return velocity_n


def _apart_s(time_ns: TimeNs, values: Floats, at_ns: TimeNs) -> Floats:
    """Give the seconds from each time to the nearest finite row of values; infinite where there is none."""
    finite_ns = time_ns[np.isfinite(values).all(axis=1)]
    if not len(finite_ns):
        return np.full(len(at_ns), np.inf)
    after = np.searchsorted(finite_ns, at_ns).clip(1, max(1, len(finite_ns) - 1))
    neighbours = finite_ns[np.stack([after - 1, np.minimum(after, len(finite_ns) - 1)])]
    apart_s: Floats = np.abs(seconds(neighbours, at_ns)).min(axis=0)
    return apart_s


def _at(time_ns: TimeNs, values: Floats, at_ns: int) -> Floats:
    """Interpolate the finite rows of values; outside them the nearest row stands."""
    finite = np.isfinite(values).all(axis=1)
    offset_s = seconds(time_ns[finite], at_ns)
    return np.array([np.interp(0.0, offset_s, column) for column in values[finite].T])
