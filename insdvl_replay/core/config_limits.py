"""Values that no vehicle has: lengths and angles that were meant in another unit."""

from collections.abc import Iterator
from typing import Final

from insdvl_replay.core.config import Config

LONGEST_ARM_M: Final = 50.0
"""Half of the longest vehicle that carries an IMU and a DVL; longer arms were meant in millimetres or centimetres."""
LARGEST_ANGLE_DEG: Final = 360.0
_ARMS: Final = ("dvl", "depth", "position", "reference")
_MOUNTINGS: Final = ("dvl", "heading", "reference")

Problem = tuple[tuple[str, ...], str, str]
"""Key, what is wrong with its value, and a hint."""


def impossible_values(config: Config) -> Iterator[Problem]:
    """Yield lever arms and angles that no vehicle has."""
    for section in _ARMS:
        arm_m = getattr(config, section).lever_arm_m
        longest_m = max(arm_m, key=abs)
        if abs(longest_m) > LONGEST_ARM_M:
            what = f"{section}.lever_arm_m has {longest_m:g} m, and no vehicle is so long"
            yield (section, "lever_arm_m"), what, _in_metres(longest_m)
    for section in _MOUNTINGS:
        angles_deg = getattr(config, section).mounting_rpy_deg
        yield from _angle_problem((section, "mounting_rpy_deg"), max(angles_deg, key=abs))
    if isinstance(config.initial.heading_deg, float | int):
        yield from _angle_problem(("initial", "heading_deg"), config.initial.heading_deg)


def _in_metres(length: float) -> str:
    return f"lever arms are in metres: {length:g} mm are {length / 1e3:g}"


def _angle_problem(key: tuple[str, str], angle_deg: float) -> Iterator[Problem]:
    if abs(angle_deg) > LARGEST_ANGLE_DEG:
        what = f"{'.'.join(key)} has {angle_deg:g} deg, more than a whole turn"
        yield (
            key,
            what,
            f"angles are in degrees, from -{LARGEST_ANGLE_DEG:g} to {LARGEST_ANGLE_DEG:g}",
        )
