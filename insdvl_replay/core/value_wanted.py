"""What is wrong with a value in a user's file, in words that need no programming language."""

import re
from contextlib import suppress
from typing import Any, Final

import msgspec

_KINDS: Final = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a section",
}
_BOUNDS: Final = {">=": "of at least", ">": "above", "<=": "of at most", "<": "below"}
_EXPECTED: Final = re.compile(
    r"Expected `(?P<kinds>[\w |]+)`(?: (?P<sign>[<>]=?) (?P<bound>\S+?))?(?: of length (?P<length>.+?))?(?:, got .*)?"
)
_LACKING: Final = re.compile(r"Object missing required field `(\w+)`")


def value_wanted(reason: str) -> str:
    """Say what msgspec says of a value, without the names of its types; what it says otherwise stays.

    Parameters
    ----------
    reason : str
        Such as ``Expected `array` of length 3, got 2``.
    """
    if lacking := _LACKING.fullmatch(reason):
        return f"lacks {lacking[1]}"
    found = _EXPECTED.fullmatch(reason)
    if found is None:
        return reason[:1].lower() + reason[1:]
    kinds = [_KINDS.get(kind.strip(), kind.strip()) for kind in found["kinds"].split("|") if kind.strip() != "null"]
    if "a number" in kinds and "a whole number" in kinds:
        kinds.remove("a whole number")
    bound = f" {_BOUNDS[found['sign']]} {float(found['bound']):g}" if found["sign"] else ""
    length = f" of {found['length']} values" if found["length"] else ""
    return f"needs {' or '.join(kinds)}{bound}{length}"


def list_meant(value: object, kind: Any) -> str:
    """Write as TOML the list that was meant by what is none, such as a single word; empty if nobody can know.

    Parameters
    ----------
    value : object
        Such as ``"position"``, or ``"[depth, position]"`` where a shell took the quotes away.
    kind : type
        Which the list has to be of.
    """
    parts = [part.strip() for part in value.strip(" []").split(",")] if isinstance(value, str) else [value]
    with suppress(ValueError):
        parts = [float(part) if isinstance(part, str) else part for part in parts]
    for entries in (parts, [0.0, 0.0, 0.0]):
        with suppress(msgspec.ValidationError):
            msgspec.convert(entries, kind)
            return ", ".join(msgspec.json.encode(entry).decode() for entry in entries).join("[]")
    return ""
