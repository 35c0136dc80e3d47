"""The error states, once, with names and units; also the units that logs may use, and what no vehicle exceeds.

Twelve are the paper's, and every filter has them. More can be added to a filter, see `MORE_STATES`.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

DEG: Final = 0.017453292519943295
"""One degree in rad."""
MRAD: Final = 1e-3
"""One milliradian in rad."""
STANDARD_GRAVITY_MPS2: Final = 9.80665
"""What g stands for as a unit."""
MG: Final = 9.80665e-3
"""One thousandth of standard gravity in m/s^2."""
DEG_PER_HOUR: Final = DEG / 3600.0
"""One degree per hour in rad/s."""


@dataclass(frozen=True)
class State:
    """One error state.

    Attributes
    ----------
    index : int
        Row in the error state vector.
    id : str
        Name in tables, columns and gates.
    label : str
        Name in words.
    symbol : str
        The paper's symbol.
    si_unit, unit : str
        Unit inside, and unit shown.
    factor : float
        One shown unit in SI: ``shown = si / factor``.
    """

    index: int
    id: str
    label: str
    symbol: str
    si_unit: str
    unit: str
    factor: float


DV: Final = slice(0, 3)
"""Velocity error, in n."""
PHI: Final = slice(3, 6)
"""Misalignment, in n."""
BA: Final = slice(6, 9)
"""Accelerometer bias, in b."""
BG: Final = slice(9, 12)
"""Gyro bias, in b."""
POSITION: Final = slice(12, 15)
"""Position error, in n, of a filter that estimates it: the first of `MORE_STATES`."""


def _triplet(
    first: int, id_: str, label: str, symbol: str, axes: str, si_unit: str, unit: str, factor: float
) -> list[State]:
    words = {"n": "north", "e": "east", "d": "down", "x": "x", "y": "y", "z": "z"}
    return [
        State(first + i, f"{id_}_{axis}", f"{label}, {words[axis]}", f"{symbol}_{axis}", si_unit, unit, factor)
        for i, axis in enumerate(axes)
    ]


STATES: Final[tuple[State, ...]] = (
    *_triplet(0, "dv", "velocity error", "δv", "ned", "m/s", "m/s", 1.0),
    *_triplet(3, "phi", "misalignment", "φ", "ned", "rad", "mrad", MRAD),
    *_triplet(6, "ba", "accelerometer bias", "b_a", "xyz", "m/s^2", "mg", MG),
    *_triplet(9, "bg", "gyro bias", "b_g", "xyz", "rad/s", "deg/h", DEG_PER_HOUR),
)

MORE_STATES: Final[dict[str, tuple[State, ...]]] = {
    "position": tuple(_triplet(0, "dp", "position error", "δp", "ned", "m", "m", 1.0)),
    "dvl_scale": (State(0, "dvl_scale", "scale error of the DVL", "κ", "1", "%", 0.01),),
    "dvl_yaw": (State(0, "dvl_yaw", "yaw of the DVL's mounting", "ψ", "rad", "deg", DEG),),
    "depth_zero": (State(0, "depth_zero", "zero of the depth gauge", "d_0", "m", "m", 1.0),),
    "heading_bias": (State(0, "heading_bias", "bias of the heading sensor", "b_ψ", "rad", "deg", DEG),),
}
"""Blocks of states that a filter can have beside the twelve, in the order in which they follow them."""


def states_with(more: Collection[str]) -> tuple[State, ...]:
    """Return the twelve states and those of some blocks of `MORE_STATES`, each with its row."""
    states = [*STATES, *(state for name, block in MORE_STATES.items() if name in more for state in block)]
    return tuple(replace(state, index=row) for row, state in enumerate(states))


NINE: Final[tuple[State, ...]] = STATES[3:]
"""The nine states whose mean the paper reports: all but the velocity errors, which the DVL measures directly."""


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
