"""The numbers that are calibrated, of the DVL and of a reference, and prepared pings as they would be with others.

No log is read again: a delay moves pings in time, mounting and scale turn and stretch their velocities, and with
another lever arm the filter looks at another place.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct

from insdvl_replay.core.config import Dvl, Reference
from insdvl_replay.core.dive_columns import Floats, nanoseconds
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.frames import DvlMounting
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, rpy_from_mat
from insdvl_replay.nav.dvl import DvlVelocities


class Parameter(NamedTuple):
    """One of the numbers."""

    name: str
    group: str  # what ``--only`` calls it
    label: str
    unit: str
    shown_as: float  # factor from SI to the unit
    prior_sd: float  # how far the vehicle's papers may be off, SI
    step: float  # of central differences, SI: large enough that the log's own grain does not show
    shown_by: str  # the manoeuvre without which nobody can tell


_TIME: Final = ("s", 1.0, 0.5, 0.05)
_LENGTH: Final = ("m", 1.0, 3.0, 0.02)
_ANGLE: Final = ("deg", 1.0 / DEG, 2.0 * DEG, 0.1 * DEG)
# The mounting's prior is 2 deg, not the 5 to 10 deg by which papers may be off. With 5 deg a straight line moved roll
# and pitch on 12 of 12 simulated dives, with errors of up to 3.4 of the sds that were said: how a filter levels looks
# like a mounting. With 2 deg its signal to noise stays near 2, and nothing moves. A mounting that is further off is
# found where the dive shows it.
_SPEED: Final = "changes of speed, or turns at speed"
_TURNS: Final = "turns about down"
_LEANING: Final = "rolling or pitching"
_WAY: Final = "way made good, and what shows the DVL's own mounting"

PARAMETERS: Final = (
    Parameter("delay", "delay", "delay", *_TIME, _SPEED),
    Parameter("mounting_x", "mounting", "mounting x", *_ANGLE, "sway or heave"),
    Parameter("mounting_y", "mounting", "mounting y", *_ANGLE, "changes of speed, or porpoising"),
    Parameter("mounting_z", "mounting", "mounting z", *_ANGLE, _SPEED),
    Parameter("arm_x", "arm", "arm x", *_LENGTH, _TURNS),
    Parameter("arm_y", "arm", "arm y", *_LENGTH, _TURNS),
    Parameter("arm_z", "arm", "arm z", *_LENGTH, _LEANING),
    Parameter("scale", "scale", "scale", "%", 100.0, 0.05, 1e-3, "large changes of speed"),
)
"""Of the DVL: changes from what the configuration says. The mounting is turned about the axes of b; the scale is the
logarithm of its factor."""
REFERENCE_PARAMETERS: Final = (
    Parameter("reference_clock", "reference_clock", "ref. clock", *_TIME, "changes of speed, or turns"),
    Parameter("reference_mounting_x", "reference_mounting", "ref. mounting x", *_ANGLE, "turns, for level"),
    Parameter("reference_mounting_y", "reference_mounting", "ref. mounting y", *_ANGLE, "turns, for level"),
    Parameter("reference_mounting_z", "reference_mounting", "ref. mounting z", *_ANGLE, _WAY),
    Parameter("reference_arm_x", "reference_arm", "ref. arm x", *_LENGTH, _TURNS),
    Parameter("reference_arm_y", "reference_arm", "ref. arm y", *_LENGTH, _TURNS),
    Parameter("reference_arm_z", "reference_arm", "ref. arm z", *_LENGTH, _LEANING),
)
"""Of a reference, in the same order."""
SHARED: Final = (*PARAMETERS, *REFERENCE_PARAMETERS)  # what all dives share beside a reference
LABELS: Final = {parameter.name: parameter.label for parameter in SHARED}
NAMES: Final = tuple(parameter.name for parameter in PARAMETERS)
NOISE: Final = "noise"
ALL_GROUPS: Final = ("arm", "mounting", "delay", "scale", NOISE)
REFERENCE_GROUPS: Final = (*ALL_GROUPS, "reference_arm", "reference_mounting", "reference_clock")
DELAY, SCALE, HEADING = (NAMES.index(name) for name in ("delay", "scale", "mounting_z"))
MOUNTING, ARM = slice(1, 4), slice(4, 7)
CLOCK: Final = len(PARAMETERS)
REFERENCE_MOUNTING, REFERENCE_ARM = slice(CLOCK + 1, CLOCK + 4), slice(CLOCK + 4, CLOCK + 7)
SHARED_SD: Final = np.array([parameter.prior_sd for parameter in SHARED])
SHARED_STEPS: Final = np.array([parameter.step for parameter in SHARED])
PRIOR_SD, STEPS = SHARED_SD[:CLOCK], SHARED_STEPS[:CLOCK]


def moved_pings(velocities: DvlVelocities, change: Floats) -> DvlVelocities:
    """Return what the DVL says if it were built in otherwise."""
    turn_b, scale = mat_from_vector(change[MOUNTING]), np.exp(change[SCALE])
    return replace(
        velocities,
        time_ns=velocities.time_ns - nanoseconds(float(change[DELAY])),
        velocity_b=velocities.velocity_b @ turn_b.T / scale,
        unit_cov_b=turn_b @ velocities.unit_cov_b @ turn_b.T,
        full_unit_cov_b=turn_b @ velocities.full_unit_cov_b @ turn_b.T,
    )


def moved_mounting(mounting: DvlMounting, change: Floats) -> DvlMounting:
    """Return the mounting with which a log would have to be read for `moved_pings`."""
    return DvlMounting(
        mounting.lever_arm_b + change[ARM],
        mat_from_vector(change[MOUNTING]) @ mounting.mat_bd,
        mounting.scale * float(np.exp(change[SCALE])),
    )


class Geometry(Struct, frozen=True):
    """The keys of ``[dvl]`` or ``[reference]`` that are calibrated."""

    latency_s: float
    lever_arm_m: tuple[float, float, float]
    mounting_rpy_deg: tuple[float, float, float]
    scale: float = 1.0  # of a DVL

    @classmethod
    def of(cls, settings: Dvl | Reference) -> "Geometry":
        """Take them from a configuration."""
        scale = settings.scale if isinstance(settings, Dvl) else 1.0
        return cls(settings.latency_s, settings.lever_arm_m, settings.mounting_rpy_deg, scale)

    @property
    def mat_b(self) -> Floats:
        """Rotation from the instrument's axes to the body's, (3, 3)."""
        return mat_from_rpy(np.array(self.mounting_rpy_deg) * DEG)

    def changed(self, change: Floats) -> "Geometry":
        """Return the settings after a change, (7,) or with a scale (8,); a group without change stays to the bit."""
        turn = change[MOUNTING]
        roll, pitch, heading = (rpy_from_mat(mat_from_vector(turn) @ self.mat_b) / DEG).tolist()
        x, y, z = (np.array(self.lever_arm_m) + change[ARM]).tolist()
        return Geometry(
            self.latency_s + float(change[DELAY]),
            (x, y, z),
            (roll, pitch, heading) if turn.any() else self.mounting_rpy_deg,
            self.scale * float(np.exp(change[SCALE:].sum())),
        )
