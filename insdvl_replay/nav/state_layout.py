"""Where the states that a filter has beside the twelve stand in its error state."""

from collections.abc import Collection
from typing import Final, NamedTuple

from insdvl_replay.core.states import MORE_STATES, STATES

ABSENT: Final = -1
"""In place of a row, of a state that a filter does not have."""


TWELVE: Final = len(STATES)
"""Rows of the states that every filter has."""


class StateLayout(NamedTuple):
    """The first row of each block of `states.MORE_STATES`, `ABSENT` where a filter does without.

    Those behind the position are constants of the sensors: nothing lets them grow, and what is found of them is added
    to what they are taken to be, as with biases. The first of them has the row ``constants``, or would have it. The
    bias of the heading is among them, but fades.
    """

    constants: int
    position: int
    dvl_scale: int
    dvl_yaw: int
    depth_zero: int
    heading_bias: int


def layout_of(more: Collection[str]) -> StateLayout:
    """Lay some blocks behind the twelve states, in the order of `states.MORE_STATES`."""
    first, row = {}, TWELVE
    for name, block in MORE_STATES.items():
        first[name] = row if name in more else ABSENT
        row += len(block) if name in more else 0
    return StateLayout(TWELVE + (len(MORE_STATES["position"]) if "position" in more else 0), **first)


TWELVE_ALONE: Final = layout_of(())
"""Of a filter that has no more."""
