"""What to choose from, where no field of a log is named like what a role needs."""

from collections.abc import Iterator, Sequence
from typing import Final

from insdvl_replay.inspection.proposed_settings import Setting
from insdvl_replay.inspection.topic_probe import ProbedTopic

_NEEDED: Final = {"imu": ("specific_force", "angular_rate"), "dvl": ("velocity",)}
_INSTEAD: Final = {"velocity": ("beam_velocity =  # one number for each beam",)}
_LONGEST: Final = 12
"""Topics that are listed at most."""


def listed_settings(role: str, seen: Sequence[ProbedTopic]) -> Iterator[Setting]:
    """List every field with numbers, that a person may choose.

    Parameters
    ----------
    role : {'imu', 'dvl'}
    seen : sequence of ProbedTopic

    Yields
    ------
    Setting
        Without values; none where no topic has numbers.
    """
    if not seen:
        return
    often = sorted(seen, key=lambda topic: -topic.channel.messages)
    lines = [line for topic in often[:_LONGEST] for line in _lines(topic)]
    if (more := len(often) - _LONGEST) > 0:
        lines.append(f"and {more} topics with fewer messages")
    text = "no topic has fields that are named like those of this role; the topics with numbers, and their fields, are"
    yield Setting(f"{role}.topic", None, open=text, listed=tuple(lines))
    for quantity in _NEEDED[role]:
        text = 'one of three numbers, or three side by side as in "p, q, r"'
        yield Setting(f"{role}.{quantity}", None, open=text, others=_INSTEAD.get(quantity, ()))


def _lines(topic: ProbedTopic) -> Iterator[str]:
    yield f'"{topic.topic}", {topic.channel.messages} messages'
    for candidate in topic.candidates:
        yield f'  "{candidate.path}"'
        yield f"    {candidate}"
    for path, median in topic.scalars.items():
        yield f'  "{path}", median {median:.3g}'
