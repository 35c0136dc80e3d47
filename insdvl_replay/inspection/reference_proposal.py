"""Settings to propose for a reference of an unknown type: its topic and fields by their names."""

import re
from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.inspection.proposed_settings import Setting
from insdvl_replay.inspection.stamp_proposal import stamp_setting
from insdvl_replay.inspection.topic_probe import ProbedTopic
from insdvl_replay.logs.container.recording import Recording

_WORDS: Final = {
    "latitude": re.compile(r"(^|[._])lat(itude)?([._]|$)"),
    "longitude": re.compile(r"(^|[._])(lon|lng|long|longitude)([._]|$)"),
    "depth": re.compile(r"(^|[._])depth([._]|$)"),
    "roll": re.compile(r"(^|[._])roll([._]|$)"),
    "pitch": re.compile(r"(^|[._])pitch([._]|$)"),
    "heading": re.compile(r"(^|[._])(heading|hdg|yaw)([._]|$)"),
}
"""An altitude is no height here: most vehicles mean that above the bottom."""
_PLACE: Final = ("latitude", "longitude")
_ATTITUDE: Final = ("roll", "pitch", "heading")
_NORTH: Final = re.compile(r"(?i)(.*(?:v|vel|velocity)_?)(n|north)")
_OTHERS: Final = {"n": ("e", "d"), "north": ("east", "down")}
_FULL_CIRCLE: Final = 6.3
"""No angle in radians is larger."""
_MEANT: Final = (
    "whether it is a solution to start from and to compare with; meant are roll starboard side down, pitch bow up and "
    "heading from north over east"
)


def reference_topic(seen: Sequence[ProbedTopic]) -> ProbedTopic | None:
    """Choose the topic with the most of a position, a velocity and an attitude."""
    return max((topic for topic in seen if _fields(topic)), key=lambda topic: len(_fields(topic)), default=None)


def reference_settings(log: Recording, topic: ProbedTopic) -> list[Setting]:
    """Propose topic, fields, unit and stamp of a reference."""
    fields = _fields(topic)
    settings = [Setting("reference.topic", topic.topic, open=_MEANT)]
    settings += [Setting(f"reference.{quantity}", path) for quantity, path in fields.items()]
    angles = [abs(topic.scalars[path]) for quantity, path in fields.items() if quantity in (*_PLACE, *_ATTITUDE)]
    return [*settings, _unit(max(angles)), stamp_setting(log, topic, "reference")]


def _fields(topic: ProbedTopic) -> dict[str, str]:
    """Find the fields of a solution; angles only where none is missing."""
    found = {quantity: path for quantity, words in _WORDS.items() if (path := _first(topic, words))}
    for together in (_PLACE, _ATTITUDE):
        if not found.keys() >= set(together):
            found = {quantity: path for quantity, path in found.items() if quantity not in together}
    if not found.keys() & {*_PLACE, *_ATTITUDE}:
        return {}
    velocity = next(_velocities(topic), None)
    return found | ({"velocity_n": velocity} if velocity else {})


def _first(topic: ProbedTopic, words: re.Pattern[str]) -> str | None:
    return next((path for path in topic.scalars if words.search(path.lower())), None)


def _velocities(topic: ProbedTopic) -> Iterator[str]:
    """Find fields such as ``vn``, ``ve``, ``vd`` or ``vel_north``, ``vel_east``, ``vel_down``."""
    for path in topic.scalars:
        if (match := _NORTH.fullmatch(path)) and (others := _OTHERS.get(match[2])):
            names = [path, *(f"{match[1]}{other}" for other in others)]
            if topic.scalars.keys() >= set(names):
                yield ", ".join(names)


def _unit(largest: float) -> Setting:
    if largest > _FULL_CIRCLE:
        return Setting("reference.angle_unit", "deg", f"an angle of {largest:.3g} is none in radians")
    return Setting("reference.angle_unit", "deg", open=f"no angle is larger than {largest:.3g}: deg or rad")
