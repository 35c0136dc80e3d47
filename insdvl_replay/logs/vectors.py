"""The fields of a type that could be a vector or the beams of a DVL, for types that nobody has told the tool about."""

from collections.abc import Iterable, Iterator
from typing import Final

from insdvl_replay.logs.field_paths import NUMBER, Kinds
from insdvl_replay.logs.ros2msg import PRIMITIVES

_AXES: Final = ("x", "y", "z")


def vector_paths(known: Kinds) -> list[str]:
    """Find what could be a vector or beams among the fields of a type.

    Parameters
    ----------
    known : mapping of str to str
        Every path of the type, with the type of what is there.

    Returns
    -------
    list of str
        Paths of structures of x, y and z; of three fields named for x, y and z, joined by commas; of arrays; and of one
        number of each element of a list. How many numbers a list holds only its messages tell.
    """
    numbers = [path for path, kind in known.items() if kind == NUMBER or kind in PRIMITIVES]
    single = [path for path in numbers if f"{path}[*]" not in known and "[*]" not in path]
    lists = [path.removesuffix("[*]") for path in numbers if path.count("[*]") == 1]
    return sorted({*_structures(numbers), *_named_for_axes(single), *lists})


def _structures(numbers: Iterable[str]) -> Iterator[str]:
    """Find structures of exactly x, y and z: with a w they are quaternions."""
    children: dict[str, list[str]] = {}
    for path in numbers:
        parent, _, child = path.rpartition(".")
        children.setdefault(parent, []).append(child)
    for parent, names in children.items():
        if sorted(names) == list(_AXES) and parent and "[*]" not in parent:
            yield parent


def _named_for_axes(single: Iterable[str]) -> Iterator[str]:
    """Find fields such as ``ax``, ``ay``, ``az`` or ``gyro_x``, ``gyro_y``, ``gyro_z``."""
    paths = set(single)
    for path in paths:
        is_name_of_more = len(path.rpartition(".")[2]) > 1
        parts = [path[:-1] + axis for axis in _AXES]
        if is_name_of_more and path.endswith(_AXES[0]) and paths.issuperset(parts):
            yield ", ".join(parts)
