"""Which key was meant by one that is not known: spelled alike, of the same words, or of another section."""

import re
from collections.abc import Collection, Iterator, Mapping
from typing import Final

from insdvl_replay.core.errors import most_like, nearest

_MISSPELLED: Final = 0.85
"""Share of letters of a name that was meant beyond doubt, whatever other names share words with it."""
_MOST: Final = 3
"""Names in a hint that are as likely as each other."""
_ALSO_CALLED: Final[Mapping[str, str]] = {
    "noise": "sd white", "std": "sd", "stddev": "sd", "sigma": "sd", "delay": "latency", "lag": "latency",
    "offset": "lever arm", "mount": "mounting", "misalignment": "mounting", "gps": "position", "gnss": "position",
    "usbl": "position", "compass": "heading", "ahrs": "heading", "pressure": "depth",
}  # fmt: skip
"""What others call it, and the words of the keys here."""
_UNITS: Final = frozenset(["m", "s", "deg", "rad", "pct", "hz", "mg", "mps", "mps2", "radps", "degph", "degps", "rts"])
"""Names that have but the unit in common do not mean the same."""


def likely_names(name: str, known: Collection[str]) -> list[str]:
    """Return the known names of which another may be a slip: the most likely, or several that are as likely.

    Words are what stands between underscores and dots, without units; a few go by other names, such as noise for sd.
    """
    if misspelled := most_like(name, known, most=1, least=_MISSPELLED):
        return misspelled
    if related := _with_most_words(name, known, least=1):
        return related
    return [near] if (near := nearest(name, known)) else []


def likely_elsewhere(name: str, paths: Collection[str]) -> list[str]:
    """Return the dotted paths of other sections that end with a key, or else share two words with it."""
    same = [path for path in paths if path.rpartition(".")[2] == name]
    return same[:_MOST] or _with_most_words(name, paths, least=2)


def _with_most_words(name: str, known: Collection[str], least: int) -> list[str]:
    wanted = {word for part in _words(name) for word in (part, *_ALSO_CALLED.get(part, "").split())}
    shared = {other: len(wanted.intersection(_words(other))) for other in known}
    most = max(shared.values(), default=0)
    alike = [other for other, count in shared.items() if count == most]
    return most_like(name, alike, most=_MOST) if most >= least else []


def _words(name: str) -> Iterator[str]:
    return (word for word in re.split(r"[_.]", name.lower()) if word and word not in _UNITS)
