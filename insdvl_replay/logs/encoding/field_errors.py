"""What to tell a user whose field path leads nowhere: which fields there are, and how to join them."""

import re
from typing import Final

from insdvl_replay.core.errors import LogError, most_like, nearest
from insdvl_replay.logs.encoding.field_paths import TEXTS, Kinds, find_path

_LISTED: Final = 24
"""Fields that an error lists at most."""


def check_path(path: str, known: Kinds, type_name: str) -> None:
    """Refuse a path that a type does not know, or at which there are no numbers.

    Parameters
    ----------
    path : str
    known : mapping of str to str
    type_name : str
        For messages to the user.

    Raises
    ------
    LogError
        With the path that is like it, and those that there are.
    """
    kind = find_path(path, known)
    if kind is None:
        meant = nearest(path, known)
        hint = fields_hint(known, path)
        raise LogError(f"{type_name} has no field '{path}'", f"the nearest one is '{meant}'; {hint}" if meant else hint)
    if kind in TEXTS:
        raise LogError(f"field '{path}' of {type_name} is text", f"name one of numbers; {fields_hint(known, path)}")


def fields_hint(known: Kinds, path: str) -> str:
    """List the fields with numbers, for a hint to the user.

    Parameters
    ----------
    known : mapping of str to str
    path : str
        Where there are too many fields, those are listed that are named most like it.

    Returns
    -------
    str
    """
    numbers = {name: kind for name, kind in known.items() if kind not in TEXTS and f"{name}[*]" not in known}
    if not numbers:
        return "the type has no fields of numbers"
    near = set(most_like(path, numbers, _LISTED))
    shortest_first = sorted(
        (name for name in numbers if name in near), key=lambda name: len(re.findall(r"[.\[]", name))
    )
    listed = ", ".join(f"{name} ({numbers[name]})" for name in shortest_first)
    more = f" and {len(numbers) - len(near)} more" if len(numbers) > len(near) else ""
    return f'its fields are {listed}{more}; "p, q, r" sets fields side by side'
