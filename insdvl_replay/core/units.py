"""Units that the settings name, and the sizes that readings can have in them."""

from typing import Final

from insdvl_replay.core.states import DEG, MG

SPECIFIC_FORCE_UNITS: Final = {"m/s2": 1.0, "g": 1000.0 * MG, "mg": MG}
"""m/s^2 of one unit."""
ANGULAR_RATE_UNITS: Final = {"rad/s": 1.0, "deg/s": DEG}
"""rad/s of one unit."""
VELOCITY_UNITS: Final = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2}
"""m/s of one unit."""

LARGEST_FORCE_MPS2: Final = 500.0
"""50 g; no vehicle that carries a DVL feels it."""
LARGEST_RATE_RADPS: Final = 35.0
"""2000 deg/s, the range of the quickest gyros on vehicles."""
FASTEST_MPS: Final = 20.0
"""No vehicle with a DVL is faster over ground."""
GRAVITY_MPS2: Final = 9.81
"""Near enough to tell a unit by."""
