"""What filters are not told of a dive, and why: that which is held out judges them.

Settings hold sensors out, the outage test pings of the DVL, and from programs and classes is held back all that judges
filters. Which dives a calibration does not fit is in `calibration/held_out.py`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

Span = tuple[int, int]  # ns: after the first time, up to the second
NOTHING_PASSES: Final = -1.0
"""A gate below any NIS: a filter predicts such a measurement and uses none of it."""
# So begins the name of a measurement by a sensor that is held out.
_PREFIX: Final = "held_out_"
# So begin the roles of topics that may be made of any sensor, and of any ping.
_MIXTURES: Final = ("reference", "filters.")
_JUDGES: Final = (*_MIXTURES, "truth")


class Why(Enum):
    """Why a filter is not told something of a dive."""

    SENSOR = auto()  # The settings hold this sensor out.
    MIXTURE = auto()  # It may contain a sensor that is held out.
    JUDGE = auto()  # Errors of filters are measured by it.
    OUTAGE = auto()  # It is, or may contain, the DVL: not told are the times in outages.


@dataclass(frozen=True)
class HeldOut:
    """What is held out of a dive."""

    # that no filter uses and that evaluate all filters; names in `states.SENSORS`
    sensors: tuple[str, ...] = ()
    # of the DVL; in the order of time and without overlap
    outages: tuple[Span, ...] = ()
    # whether reference, truth and onboard solutions are held out as a whole
    judges: bool = False

    def in_outages(self, outages: Sequence[Span]) -> "HeldOut":
        """Hold out the pings in some outages, too."""
        return replace(self, outages=tuple(outages))

    def with_judges(self) -> "HeldOut":
        """Hold out all that judges filters, too."""
        return replace(self, judges=True)

    def why(self, role: str) -> Why | None:
        """Return why that which plays a role is not told; None where all of it is told.

        Parameters
        ----------
        role : str
            That of a topic: a sensor, ``dvl``, ``reference``, ``truth``, or ``filters.NAME.solution``.
        """
        if role in self.sensors:
            return Why.SENSOR
        if self.judges and role.startswith(_JUDGES):
            return Why.JUDGE
        is_mixture = role.startswith(_MIXTURES)
        if self.sensors and is_mixture:
            return Why.MIXTURE
        if self.outages and (is_mixture or role == "dvl"):
            return Why.OUTAGE
        return None

    def given(self, aiding: Iterable[str]) -> tuple[str, ...]:
        """Return the part of a filter's aiding that it is told."""
        return tuple(aid for aid in aiding if aid not in self.sensors)

    def met(self, aiding: Iterable[str]) -> set[str]:
        """Return all that a filter predicts: what aids it, and what it is only compared with."""
        return {*aiding, *self.sensors}


NOTHING: Final = HeldOut()


def held_out_name(sensor: str) -> str:
    """Name the measurement by a sensor that is held out."""
    return f"{_PREFIX}{sensor}"


def held_out_sensor(measurement: str) -> str:
    """Return the sensor by whose name a measurement is held out; empty for those that filters use."""
    if measurement.startswith(_PREFIX):
        return measurement.removeprefix(_PREFIX)
    return ""


def is_never_used(gate: float) -> bool:
    """Return whether a gate is that of a measurement which is held out."""
    return gate < 0.0
