"""Damage: where a file is not what the format says, and what was lost by it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from insdvl_replay.errors import Note

_SHOWN: Final = 3
"""Places that are told one by one."""


class DamageError(Exception):
    """Bytes that are not what the format says.

    Parameters
    ----------
    offset : int
        Where in the file.
    found : str
        What stands there.
    """

    def __init__(self, offset: int, found: str) -> None:
        super().__init__(offset, found)
        self.offset = offset
        self.found = found


@dataclass(frozen=True)
class Damage:
    """A damaged place.

    Attributes
    ----------
    offset : int
        Where in the file.
    found : str
        What stands there.
    messages : int or None
        How many messages were lost; None where nobody knows.
    seconds : float or None
        The time that these span.
    """

    offset: int
    found: str
    messages: int | None = 0
    seconds: float | None = None


def lost(damages: Sequence[Damage], missing: int | None) -> str:
    """Say what was lost in all.

    Parameters
    ----------
    damages : sequence of Damage
    missing : int or None
        Messages that the log announces and that are not found, where it announces any.

    Returns
    -------
    str
    """
    known = [damage.messages for damage in damages if damage.messages is not None]
    messages, seconds = sum(known), sum(damage.seconds or 0.0 for damage in damages)
    if missing is not None:
        amount = str(max(missing, 0))
    elif len(known) == len(damages):
        amount = str(messages)
    else:
        amount = f"at least {messages}" if messages else "an unknown number of"
    return f"{amount} messages" + (f" ({seconds:.3f} s)" if seconds else "") + " are lost"


def damage_note(name: str, damages: Sequence[Damage], missing: int | None) -> Note:
    """Say what was found and lost in a damaged log.

    Parameters
    ----------
    name : str
        Of the log.
    damages : sequence of Damage
        At least one.
    missing : int or None
        As of `lost`.

    Returns
    -------
    Note
        A warning, ``log_damaged``.
    """
    shown = "; ".join(f"byte {damage.offset}: {damage.found}" for damage in damages[:_SHOWN])
    more = f"; and {len(damages) - _SHOWN} more" if len(damages) > _SHOWN else ""
    places = "1 place" if len(damages) == 1 else f"{len(damages)} places"
    text = f"{name} is damaged in {places}, {lost(damages, missing)} ({shown}{more})"
    return Note("log_damaged", text, len(damages), "warning", "copy the log again from the recorder if it still has it")
