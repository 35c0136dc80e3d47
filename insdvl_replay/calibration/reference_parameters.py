"""The numbers of a reference that are calibrated, behind those of the DVL, and its settings with others."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from insdvl_replay.calibration.parameters import ALL_GROUPS, MOUNTING, PARAMETERS, Parameter
from insdvl_replay.core.config import Reference
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.states import DEG
from insdvl_replay.geometry.rotation import mat_from_rpy, mat_from_vector, rpy_from_mat

_AXIS_OF: Final = {"x": "sway or heave", "y": "rolling or pitching", "z": "turns about down"}
_WAY: Final = "way made good, and what shows the DVL's own mounting"
OF_REFERENCE: Final = (
    Parameter("reference_clock", "reference_clock", "s", 1.0, 0.5, 0.05, "changes of speed, or turns"),
    Parameter("reference_mounting_x", "reference_mounting", "deg", 1.0 / DEG, 2.0 * DEG, 0.1 * DEG, "turns, for level"),
    Parameter("reference_mounting_y", "reference_mounting", "deg", 1.0 / DEG, 2.0 * DEG, 0.1 * DEG, "turns, for level"),
    Parameter("reference_mounting_z", "reference_mounting", "deg", 1.0 / DEG, 2.0 * DEG, 0.1 * DEG, _WAY),
    Parameter("reference_arm_x", "reference_arm", "m", 1.0, 3.0, 0.02, "turns about down"),
    Parameter("reference_arm_y", "reference_arm", "m", 1.0, 3.0, 0.02, "turns about down"),
    Parameter("reference_arm_z", "reference_arm", "m", 1.0, 3.0, 0.02, "rolling or pitching"),
)
"""Changes from what ``[reference]`` says, in this order; the mounting is turned about the axes of b."""
REFERENCE_GROUPS: Final = (*ALL_GROUPS, "reference_arm", "reference_mounting", "reference_clock")
SHARED: Final = (*PARAMETERS, *OF_REFERENCE)
"""What all dives share: the DVL's numbers first, as changes from what the innovations said."""
HEADING: Final = MOUNTING.stop - 1
CLOCK: Final = len(PARAMETERS)
REFERENCE_MOUNTING: Final = slice(CLOCK + 1, CLOCK + 4)
REFERENCE_ARM: Final = slice(CLOCK + 4, CLOCK + 7)
SHARED_SD: Final = np.array([parameter.prior_sd for parameter in SHARED])
SHARED_STEPS: Final = np.array([parameter.step for parameter in SHARED])
LATEST_CLOCK_S: Final = 1.0


@dataclass(frozen=True)
class ReferenceGeometry:
    """The settings of ``[reference]`` that are calibrated."""

    latency_s: float
    lever_arm_m: tuple[float, float, float]
    mounting_rpy_deg: tuple[float, float, float]

    @classmethod
    def of(cls, settings: Reference) -> "ReferenceGeometry":
        """Take them from a configuration."""
        return cls(settings.latency_s, settings.lever_arm_m, settings.mounting_rpy_deg)

    @property
    def mat_br(self) -> Floats:
        """From the axes of its attitude to the body's, shape (3, 3)."""
        return mat_from_rpy(np.array(self.mounting_rpy_deg) * DEG)

    def changed(self, change: Floats) -> "ReferenceGeometry":
        """Return the settings after a change of `SHARED`; those of a group that does not change stay to the bit."""
        turn = change[REFERENCE_MOUNTING]
        roll, pitch, heading = (rpy_from_mat(mat_from_vector(turn) @ self.mat_br) / DEG).tolist()
        x, y, z = (np.array(self.lever_arm_m) + change[REFERENCE_ARM]).tolist()
        return ReferenceGeometry(
            self.latency_s + float(change[CLOCK]),
            (x, y, z),
            (roll, pitch, heading) if turn.any() else self.mounting_rpy_deg,
        )
