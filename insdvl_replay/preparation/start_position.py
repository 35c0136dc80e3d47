"""The position at the start: the reference's, a fix, or the configured one."""

from typing import Final

import numpy as np

from insdvl_replay.core.config import Initial
from insdvl_replay.core.dive_columns import Floats, ReferenceColumns, TimeNs, apart_s, at_time
from insdvl_replay.core.errors import ConfigError, Note
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Severity
from insdvl_replay.geometry.rotation import wrap_angle

FAR_S: Final = 1.0
"""What is further than this from the start says little about it: a vehicle moves on."""
CONTRADICTION_DEG: Final = 0.1
"""A latitude that a user gives in round numbers is as near as this."""


def start_position(
    reference: ReferenceColumns | None, initial: Initial, start_ns: int, notes: list[Note], *, is_fix: bool = False
) -> Floats:
    """Find the position at the start: the reference's where it has any, else the configured one, or a fix in its place.

    Latitude rad, longitude rad and height m, shape (3,); notes say what was taken from elsewhere, or is far.
    """
    if reference is not None and reference.has_position:
        return _reference_position(reference, initial, start_ns, notes)
    latitude_deg = configured_latitude_deg(initial)
    if not is_fix:
        notes.append(Note("start_position_configured", f"started at the configured latitude {latitude_deg:g} deg"))
    return np.array([latitude_deg * DEG, initial.longitude_deg * DEG, initial.height_m])


def _reference_position(reference: ReferenceColumns, initial: Initial, start_ns: int, notes: list[Note]) -> Floats:
    horizontal, height_m = reference.position[:, :2].copy(), reference.position[:, 2:]
    first_longitude = horizontal[np.argmax(np.isfinite(horizontal).all(axis=1)), 1]
    horizontal[:, 1] = wrap_angle(horizontal[:, 1] - first_longitude)  # so that 180 deg lies between no two rows
    latitude, longitude = at_time(reference.time_ns, horizontal, start_ns)
    far = _far_notes("position", reference.time_ns, horizontal, start_ns)
    if np.isfinite(height_m).any():
        start_height_m = at_time(reference.time_ns, height_m, start_ns)[0]
        far = far or _far_notes("height", reference.time_ns, height_m, start_ns)
    else:
        start_height_m = initial.height_m
        notes.append(configured_height_note(initial))
    notes += far + _latitude_notes(initial, float(latitude) / DEG)
    return np.array([latitude, float(wrap_angle(longitude + first_longitude)), start_height_m])


def configured_height_note(initial: Initial) -> Note:
    """State that filters start at the configured height, since nothing else gives one."""
    return Note("start_height_configured", f"started at the configured height {initial.height_m:g} m")


def _far_notes(quantity: str, time_ns: TimeNs, values: Floats, start_ns: int) -> list[Note]:
    far_s = float(apart_s(time_ns, values, np.array([start_ns]))[0])
    if far_s <= FAR_S:
        return []
    text = f"the {quantity} at the start is the reference's {far_s:.1f} s away from it, and is off by as much"
    return [
        Note(f"start_{quantity}_far", text, severity=Severity.WARNING, hint=f"--start near the reference's {quantity}s")
    ]


def _latitude_notes(initial: Initial, latitude_deg: float) -> list[Note]:
    """State that a latitude is configured in vain, where it is another than the reference's."""
    if initial.latitude_deg is None or abs(initial.latitude_deg - latitude_deg) <= CONTRADICTION_DEG:
        return []
    hint = "leave initial.latitude_deg out, or name another reference.topic or reference.fix"
    theirs = f"{latitude_deg:.4g} deg"
    return [idle_note("start_latitude_contradiction", "latitude_deg", initial.latitude_deg, theirs, hint)]


def idle_note(code: str, key: str, configured: float, theirs: str, hint: str) -> Note:
    """Warn of a number in ``[initial]`` that the reference goes before."""
    text = f"initial.{key} is {configured:g}, but the reference starts at {theirs}, which counts"
    return Note(code, text, severity=Severity.WARNING, hint=hint)


def configured_latitude_deg(initial: Initial) -> float:
    """Return the configured latitude, deg."""
    if initial.latitude_deg is None:
        raise ConfigError(
            "the latitude is needed for gravity and Earth rate, and no reference gives it",
            "--set initial.latitude_deg=...",
        )
    return initial.latitude_deg
