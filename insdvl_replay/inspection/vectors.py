"""The fields of a type that could be a vector, the beams of a DVL, a time or a single number of either.

For types that nobody has told the tool about: only the structure and the names of their fields tell.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Final

from insdvl_replay.logs.encoding.field_paths import NUMBER, Kinds
from insdvl_replay.logs.encoding.ros2msg import PRIMITIVES

_FAMILIES: Final = (
    ("x", "y", "z"),
    ("X", "Y", "Z"),
    ("p", "q", "r"),
    ("u", "v", "w"),
    ("surge", "sway", "heave"),
    ("forward", "starboard", "down"),
    ("fwd", "stbd", "down"),
    ("roll", "pitch", "yaw"),
    ("1", "2", "3", "4"),
    ("0", "1", "2", "3"),
    ("1", "2", "3"),
    ("0", "1", "2"),
)
"""Words and letters by which fields differ that belong together; of two families that begin alike the longer first."""
_SECONDS: Final = {"sec", "secs", "seconds"}
_NANOSECONDS: Final = {"nsec", "nsecs", "nanosec", "nanos", "nanoseconds"}


def vector_paths(known: Kinds) -> list[str]:
    """Find what could be a vector or beams among the fields of a type."""
    numbers = _numbers(known)
    lists = [path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1]
    structures = set(_structures(numbers))
    closed = structures | set(_quaternions(numbers))
    single = [path for path in scalar_paths(known) if path.rpartition(".")[0] not in closed]
    return sorted({*structures, *_families(single), *lists})


def scalar_paths(known: Kinds) -> list[str]:
    """Find the single numbers among the fields of a type."""
    in_times = tuple(f"{path}." for path in time_paths(known))
    numbers = [path for path in _numbers(known) if f"{path}[*]" not in known and "[*]" not in path]
    return [path for path in numbers if not path.startswith(in_times)]


def time_paths(known: Kinds) -> list[str]:
    """Find the times and durations of a type: structures of seconds and nanoseconds."""
    return [
        path
        for path, names in _children(_numbers(known)).items()
        if len(names) == 2 and names[0] in _SECONDS and names[1] in _NANOSECONDS
    ]


def _numbers(known: Kinds) -> list[str]:
    return [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]


def _children(numbers: Iterable[str]) -> dict[str, list[str]]:
    """Give the names of the numbers in each structure that is in no list."""
    children: dict[str, list[str]] = {}
    for path in numbers:
        parent, _, child = path.rpartition(".")
        if parent and "[*]" not in parent:
            children.setdefault(parent, []).append(child)
    return children


def _structures(numbers: Iterable[str]) -> Iterator[str]:
    """Find structures of exactly x, y and z."""
    return (path for path, names in _children(numbers).items() if sorted(names) == ["x", "y", "z"])


def _quaternions(numbers: Iterable[str]) -> Iterator[str]:
    return (path for path, names in _children(numbers).items() if sorted(names) == ["w", "x", "y", "z"])


def _families(single: Iterable[str]) -> Iterator[str]:
    """Find fields such as ``ax``, ``ay``, ``az`` or ``p``, ``q``, ``r`` or ``beam_1`` to ``beam_4``."""
    paths = set(single)
    for path in paths:
        complete = (names for names in _siblings(path) if paths.issuperset(names))
        names = next(complete, None)
        if names is not None:
            yield ", ".join(names)


def _siblings(path: str) -> Iterator[list[str]]:
    """Give the names that a field and its siblings would have, were it the first of a family; longer families first."""
    parent, dot, name = path.rpartition(".")
    for first, *others in _FAMILIES:
        for place in re.finditer(first, name):
            before, after = f"{parent}{dot}{name[: place.start()]}", name[place.end() :]
            yield [path, *(f"{before}{other}{after}" for other in others)]
