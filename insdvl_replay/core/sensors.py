"""The sensors that can aid a filter beside the IMU and the DVL: a word each, which names all that belongs to it.

The word stands in a filter's ``aiding``; it is the sensor's section of the configuration, its role among the topics of
a log, and the name of its measurement in the tables.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from insdvl_replay.core.config import Config


@dataclass(frozen=True)
class Sensor:
    """One sensor.

    Attributes
    ----------
    unit : str
        Of its measurement in the tables.
    components : tuple of str
        Names of what one reading holds; none of a sensor that reads one number.
    states : tuple of str
        Names in `states.MORE_STATES` that a filter needs to be aided by it.
    quantities : tuple of str
        Keys of its section that hold field paths.
    enough : tuple of set of str
        The quantities of one of these sets make a reading.
    together : set of str
        Quantities that say nothing without each other.
    """

    unit: str
    components: tuple[str, ...]
    states: tuple[str, ...]
    quantities: tuple[str, ...]
    enough: tuple[frozenset[str], ...]
    together: frozenset[str] = frozenset()


AXES_N: Final = ("n", "e", "d")
"""Axes of a measurement in n."""
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
"""What the DVL aids by."""
AIDING: Final = (*DVL_AIDING, *SENSORS)
"""Words for what a filter can be aided by."""


BY_SENSOR: Final = "sensor"
"""In place of the heading at the start, and as what the start comes from."""


def asked_sensors(config: "Config") -> tuple[str, ...]:
    """Name the sensors that a replay reads, in their order: by which filters are aided, or start, or are judged."""
    asked = {*config.evaluation.withheld, *(word for filter_ in config.filters.values() for word in filter_.aiding)}
    asked |= {"heading"} if BY_SENSOR in (config.initial.source, config.initial.heading_deg) else set()
    return tuple(name for name in SENSORS if name in asked)


def states_for(aiding: Iterable[str]) -> tuple[str, ...]:
    """Name the blocks of states beside the twelve that what a filter is aided by needs."""
    return tuple(dict.fromkeys(block for word in aiding if word in SENSORS for block in SENSORS[word].states))
