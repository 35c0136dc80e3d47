"""What has a part in the reference, or comes from it, so that the reference does not judge the filters that use it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from insdvl_replay.core.errors import Note

_ENDING: Final = "_is_reference"
_SOLUTION: Final = "solution_"


def sensor_is_reference(sensor: str) -> str:
    """Return the code of the note that the readings of a sensor are the reference's own."""
    return f"{sensor}{_ENDING}"


def solution_is_reference(name: str) -> str:
    """Return the code of the note that an onboard solution, by the name of its filter, is or may be the reference."""
    return f"{_SOLUTION}{name}{_ENDING}"


def is_independent(settings: Mapping[str, Any]) -> bool:
    """Return whether the reference of a result shares no sensors with the filters; early results do not say so."""
    return settings.get("reference", {}).get("independent") is not False


@dataclass(frozen=True)
class OfReference:
    """What of a dive is made of the reference."""

    sensors: frozenset[str]
    solutions: frozenset[str]  # names of their filters

    @classmethod
    def noted(cls, notes: Iterable[Note]) -> "OfReference":
        """Return what notes have found."""
        sensors = set[str]()
        solutions = set[str]()
        for note in notes:
            if not note.code.endswith(_ENDING):
                continue
            name = note.code.removesuffix(_ENDING)
            if name.startswith(_SOLUTION):
                solutions.add(name.removeprefix(_SOLUTION))
            else:
                sensors.add(name)
        return cls(frozenset(sensors), frozenset(solutions))
