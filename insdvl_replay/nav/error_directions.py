"""Directions of error that have a name, since straight and level motion hides them.

A misalignment tilts gravity, and an accelerometer bias can level it out again: the pair stays as it is. So does a
heading error with the velocity error that turns the way as a whole. On the turning Earth each also needs the gyro bias
that takes the Earth's rate out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.nav.local_earth import normal_gravity, place_at, transport_curvature, transport_rate_n
from insdvl_replay.nav.observability import Observability
from insdvl_replay.nav.state_layout import TWELVE
from insdvl_replay.nav.vector_algebra import vector

_AXES: Final = ("north", "east", "down")
_ACROSS: Final = {"north": "east", "east": "north"}


@dataclass(frozen=True)
class ErrorDirection:
    """A direction in the space of the 12 error states.

    Attributes
    ----------
    id : str
        Name in tables.
    label : str
        Name in words.
    error : ndarray, shape (12,)
        SI units; the leading state is 1.
    """

    id: str
    label: str
    error: Floats

    def scaled(self, prior_sd: Floats) -> Floats:
        """Return the direction in prior standard deviations, of unit length."""
        scaled = self.error / prior_sd
        unit: Floats = scaled / np.linalg.norm(scaled)
        return unit


def named_directions(
    position: Floats, velocity_n: Floats, mat_nb: Floats, *, earth_rate: bool = True
) -> tuple[ErrorDirection, ...]:
    """Make the directions that steady motion hides from velocities, or from accelerations.

    Equations (50) to (54) of Levy and Klein, and what they leave out; see equations/observability.md.

    Parameters
    ----------
    position, velocity_n : ndarray, shape (3,)
        At the start; latitude rad, longitude rad, height m, and m/s.
    mat_nb : ndarray, shape (3, 3)
        Attitude at the start.
    earth_rate : bool
        False: on an Earth that is flat and at rest.

    Returns
    -------
    tuple of ErrorDirection
        In an order in which each is simpler than those after it.
    """
    still = np.zeros(3)
    rate_ie_n, rate_en_n = _rates_n(position, velocity_n) if earth_rate else (still, still)
    rate_in_n = rate_ie_n + rate_en_n
    gravity_n = np.array([0.0, 0.0, normal_gravity(position[0], position[2])])
    coriolis_n = rate_ie_n + rate_in_n
    force_n = np.cross(coriolis_n, velocity_n) - gravity_n
    axes_n = np.eye(3)
    velocities = [
        ErrorDirection(f"dv_{axis[0]}", f"velocity error {axis}", _error(dv=axis_n))
        for axis, axis_n in zip(_AXES, axes_n, strict=True)
    ]
    tilts = []
    for axis, phi in zip(_AXES, axes_n, strict=True):
        dv = -np.cross(velocity_n, phi)
        ba = mat_nb.T @ (np.cross(force_n, phi) + np.cross(coriolis_n, dv))
        transport_error_n = _rates_n(position, dv)[1] if earth_rate else still
        bg = mat_nb.T @ (np.cross(rate_in_n, phi) + transport_error_n)
        tilts.append(
            ErrorDirection(f"phi_{axis[0]} held", _tilt_label(axis, earth_rate), _error(dv=dv, phi=phi, ba=ba, bg=bg))
        )
    down_b = mat_nb.T @ axes_n[2]
    across_b = -mat_nb.T @ np.cross(velocity_n, axes_n[2])
    gyro = ErrorDirection("bg_d", "gyro bias about down", _error(bg=down_b))
    # A heading that drifts by the one bends the way as steadily as the other does.
    centripetal = "gyro bias about down with accelerometer bias across"
    bent = ErrorDirection("bg_d held", centripetal, _error(ba=across_b, bg=down_b))
    return (*velocities, *tilts, gyro, bent)


def name_unobservable(
    observability: Observability, directions: tuple[ErrorDirection, ...], prior_sd: Floats
) -> tuple[ErrorDirection, ...]:
    """Find the named directions that make up what is not observable.

    The least seen come first. A direction is taken if more than half of it lies in what is unobservable and not yet
    named.

    Parameters
    ----------
    directions : tuple of ErrorDirection
        From `named_directions`.
    prior_sd : ndarray, shape (12,)
        Standard deviations of the states at the start, SI units.

    Returns
    -------
    tuple of ErrorDirection
        At most 12 less the rank; in the order of ``directions``.
    """
    unnamed, found = observability.unobservable, set()
    for direction in sorted(directions, key=lambda each: observability.response(each.scaled(prior_sd))):
        part = unnamed.T @ (unnamed @ direction.scaled(prior_sd))
        if part @ part > 0.5:
            found.add(direction.id)
            # What remains is at right angles to the part just named.
            _, _, basis = np.linalg.svd(unnamed @ (np.eye(TWELVE) - np.outer(part, part) / (part @ part)))
            unnamed = basis[: len(unnamed) - 1]
    return tuple(direction for direction in directions if direction.id in found)


def _tilt_label(axis: str, earth_rate: bool) -> str:
    label = "heading with velocity error across"
    if axis in _ACROSS:
        label = f"misalignment about {axis} with accelerometer bias {_ACROSS[axis]}"
    return f"{label} and gyro bias" if earth_rate else label


def _error(**parts: Floats) -> Floats:
    places = {"dv": DV, "phi": PHI, "ba": BA, "bg": BG}
    error = np.zeros(TWELVE)
    for name, part in parts.items():
        error[places[name]] = part
    return error


def _rates_n(position: Floats, velocity_n: Floats) -> tuple[Floats, Floats]:
    """Return the rates of the Earth, and of n against the Earth at a velocity."""
    latitude, height_m = float(position[0]), float(position[2])
    place = place_at(latitude, height_m)
    rate_en_n = transport_rate_n(transport_curvature(place, height_m), vector(velocity_n))
    return np.array(place.rate_ie_n), np.array(rate_en_n)
