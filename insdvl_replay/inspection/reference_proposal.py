"""Settings to propose for a reference: its topic and fields by their names, and in which frame its velocity is."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import msgspec

from insdvl_replay.checks.reference import velocity_misfit
from insdvl_replay.core.config import Config
from insdvl_replay.inspection.proposed_settings import Setting, stamp_setting
from insdvl_replay.inspection.topic_probe import ProbedTopic
from insdvl_replay.logs.columns.reference import decode_reference
from insdvl_replay.logs.columns.table_reading import read_tables
from insdvl_replay.logs.columns.topic_requirements import Source
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
_FITS: Final = 0.1
"""Part of the way by which a velocity may miss the positions beside it."""
_CLEARLY: Final = 0.3
_MEANT: Final = (
    "whether it is a solution to start from and to compare with; meant are roll starboard side down, pitch bow up and "
    "heading from north over east"
)


def reference_topic(seen: Sequence[ProbedTopic]) -> ProbedTopic | None:
    """Choose the topic with the most of a position, a velocity and an attitude."""
    return max(
        (topic for topic in seen if _reference_fields(topic)),
        key=lambda topic: len(_reference_fields(topic)),
        default=None,
    )


def reference_settings(log: Recording, topic: ProbedTopic) -> list[Setting]:
    """Propose topic, fields, unit and stamp of a reference."""
    fields = _reference_fields(topic)
    settings = [Setting("reference.topic", topic.topic, open=_MEANT)]
    settings += [Setting(f"reference.{quantity}", path) for quantity, path in fields.items()]
    angles = [abs(topic.scalars[path]) for quantity, path in fields.items() if quantity in (*_PLACE, *_ATTITUDE)]
    return [*settings, _unit(max(angles)), stamp_setting(log, topic, "reference")]


def _reference_fields(topic: ProbedTopic) -> dict[str, str]:
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


def measured_reference(log: Recording, source: Source, config: Config) -> Iterator[Setting]:
    """Propose to take a velocity for one in the axes of the world, if only so it fits the positions beside it.

    That of `nav_msgs/Odometry` is to be in the body, and Gazebo writes it otherwise.
    """
    if config.reference.velocity_n is not None or not {"velocity_b", "local_position"} <= source.fields.keys():
        return
    path = source.fields["velocity_b"]
    initial = config.initial
    # Where on Earth it is does not matter to the way between positions.
    place = msgspec.structs.replace(initial, latitude_deg=initial.latitude_deg or 0.0)
    table = read_tables(log, [source])[0]
    misfits = []
    for velocity_n in (None, path):
        fields = source.fields if velocity_n is None else {**source.fields, "velocity_n": velocity_n}
        settings = msgspec.structs.replace(config.reference, velocity_n=velocity_n)
        columns, _ = decode_reference([replace(table, source=replace(source, fields=fields))], settings, place)
        misfits.append(None if columns is None else velocity_misfit(columns))
    in_body, in_world = misfits
    if in_body is None or in_world is None or in_world > min(_FITS, _CLEARLY * in_body):
        return
    text = (
        f"so it differs by {in_world:.1%} from the way between the positions; in the axes of the body, as its type has "
        f"it, by {in_body:.0%}"
    )
    yield Setting("reference.velocity_n", path, text)
