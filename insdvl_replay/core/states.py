"""What filters estimate and what aids them: the error states, the sensors, the columns of a trajectory, and units.

Twelve states are the paper's, and every filter has them. More can be added to a filter, see `MORE_STATES`.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

# Units in SI. Inside everything is SI; what is shown is divided by these.
DEG: Final = 0.017453292519943295  # rad
MRAD: Final = 1e-3  # rad
MG: Final = 9.80665e-3  # m/s^2, a thousandth of standard gravity
STANDARD_GRAVITY_MPS2: Final = 9.80665
DEG_PER_HOUR: Final = DEG / 3600.0  # rad/s

# What no vehicle with a DVL exceeds.
LARGEST_FORCE_MPS2: Final = 500.0  # 50 g
LARGEST_RATE_RADPS: Final = 35.0  # 2000 deg/s, the range of the quickest gyros on vehicles
FASTEST_MPS: Final = 20.0  # over ground
LOWEST_M: Final = -11_000.0  # the deepest trench, above the ellipsoid
HIGHEST_M: Final = 9_000.0  # above any lake
# with a minus it would be a depth of the sea, but programs write it for none
NO_HEIGHT_M: Final = 9_999.0
LARGEST_ANGLE_RAD: Final = 720.0 * DEG
GRAVITY_MPS2: Final = 9.81  # near enough to tell a unit by


@dataclass(frozen=True)
class State:
    """One error state."""

    index: int  # row in the error state vector
    id: str  # name in tables, columns and gates
    label: str  # name in words
    unit: str  # that is shown
    factor: float  # one shown unit in SI: shown = si / factor


DV: Final = slice(0, 3)  # Velocity error, in n.
PHI: Final = slice(3, 6)  # Misalignment, in n.
BA: Final = slice(6, 9)  # Accelerometer bias, in b.
BG: Final = slice(9, 12)  # Gyro bias, in b.
# Position error, in n, of a filter that estimates it: the first of `MORE_STATES`.
POSITION: Final = slice(12, 15)


def _triplet(
    first: int,
    id_: str,
    label: str,
    axes: str,
    unit: str,
    factor: float,
) -> list[State]:
    words = {"n": "north", "e": "east", "d": "down", "x": "x", "y": "y", "z": "z"}
    return [
        State(first + i, f"{id_}_{axis}", f"{label}, {words[axis]}", unit, factor)
        for i, axis in enumerate(axes)
    ]


STATES: Final[tuple[State, ...]] = (
    *_triplet(0, "dv", "velocity error", "ned", "m/s", 1.0),
    *_triplet(3, "phi", "misalignment", "ned", "mrad", MRAD),
    *_triplet(6, "ba", "accelerometer bias", "xyz", "mg", MG),
    *_triplet(9, "bg", "gyro bias", "xyz", "deg/h", DEG_PER_HOUR),
)
# The nine states whose mean the paper reports: all but the velocity errors, which the DVL measures directly.
NINE: Final[tuple[State, ...]] = STATES[3:]
# Blocks of states that a filter can have beside the twelve, in the order in which they follow them.
MORE_STATES: Final[dict[str, tuple[State, ...]]] = {
    "position": tuple(_triplet(0, "dp", "position error", "ned", "m", 1.0)),
    "dvl_scale": (State(0, "dvl_scale", "scale error of the DVL", "%", 0.01),),
    "dvl_yaw": (State(0, "dvl_yaw", "yaw of the DVL's mounting", "deg", DEG),),
    "depth_zero": (State(0, "depth_zero", "zero of the depth gauge", "m", 1.0),),
    "heading_bias": (State(0, "heading_bias", "bias of the heading sensor", "deg", DEG),),
}


def states_with(more: Collection[str]) -> tuple[State, ...]:
    """Return the twelve states and those of some blocks of `MORE_STATES`, each with its row."""
    states = [*STATES]
    for name, block in MORE_STATES.items():
        if name in more:
            states += block
    return tuple(replace(state, index=row) for row, state in enumerate(states))


@dataclass(frozen=True)
class Sensor:
    """A sensor beside the IMU and the DVL.

    Its name is a word in a filter's ``aiding``, its section of the settings, its role among the topics of a log, and
    the name of its measurement in the tables.
    """

    unit: str  # of its measurement in the tables
    components: tuple[str, ...]  # of a reading; none of a sensor that reads one number
    states: tuple[str, ...]  # of MORE_STATES, that a filter needs to be aided by it
    quantities: tuple[str, ...]  # keys of its section that hold field paths
    enough: tuple[frozenset[str], ...]  # the quantities of one of these sets make a reading
    together: frozenset[str] = frozenset()  # quantities that are of no use without each other


AXES_N: Final = ("n", "e", "d")
SENSORS: Final[dict[str, Sensor]] = {
    "depth": Sensor(
        unit="m",
        components=(),
        states=("position", "depth_zero"),
        quantities=("depth", "height", "pressure"),
        enough=(frozenset({"depth"}), frozenset({"height"}), frozenset({"pressure"})),
    ),
    "heading": Sensor(
        unit="rad",
        components=(),
        states=(),
        quantities=("quaternion", "heading", "roll", "pitch"),
        enough=(frozenset({"quaternion"}), frozenset({"heading"})),
        together=frozenset({"roll", "pitch"}),
    ),
    "position": Sensor(
        unit="m",
        components=AXES_N,
        states=("position",),
        quantities=("latitude", "longitude", "height"),
        enough=(frozenset({"latitude", "longitude"}),),
    ),
}
DVL_AIDING: Final = ("velocity", "acceleration", "beams")
AIDING: Final = (*DVL_AIDING, *SENSORS)  # Words for what can aid a filter.
# In place of the heading at the start, and as what the start comes from.
BY_SENSOR: Final = "sensor"


def states_for(aiding: Iterable[str]) -> tuple[str, ...]:
    """Return the blocks of states beside the twelve that a filter with this aiding needs."""
    blocks: dict[str, None] = {}  # each once
    for word in aiding:
        if word in SENSORS:
            blocks |= dict.fromkeys(SENSORS[word].states)
    return tuple(blocks)


# Columns of a trajectory by groups: a difference is small if it is small compared with the largest of its group.
GROUPS: Final = {
    "position": ("position_n_m", "position_e_m", "position_d_m"),
    "velocity": ("velocity_n_mps", "velocity_e_mps", "velocity_d_mps"),
    "attitude": ("roll_deg", "pitch_deg", "heading_deg"),
    "accelerometer_bias": ("ba_x_mg", "ba_y_mg", "ba_z_mg"),
    "gyro_bias": ("bg_x_degph", "bg_y_degph", "bg_z_degph"),
    "velocity_sd": tuple(f"{state.id}_sd" for state in STATES[DV]),
    "misalignment_sd": tuple(f"{state.id}_sd" for state in STATES[PHI]),
    "accelerometer_bias_sd": tuple(f"{state.id}_sd" for state in STATES[BA]),
    "gyro_bias_sd": tuple(f"{state.id}_sd" for state in STATES[BG]),
    "nis": ("nis_velocity", "nis_acceleration"),
    "error": (
        "position_error_m",
        "depth_error_m",
        "velocity_error_mps",
        "level_error_deg",
        "heading_error_deg",
    ),
}
COLUMNS: Final[tuple[str, ...]] = tuple(chain.from_iterable(GROUPS.values()))
# Columns that wrap around at 360 deg.
ANGLES: Final = (
    "roll_deg",
    "pitch_deg",
    "heading_deg",
    "heading_error_deg",
)
