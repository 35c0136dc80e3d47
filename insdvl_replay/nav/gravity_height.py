"""The height at which gravity is taken: the INS's own as long as velocities hold it, and then the last of those.

Gravity falls by 3.1e-6 m/s^2 a metre. An unaided INS that takes it at its own height drives that height away,
e-fold in 570 s, and leaves a wrong gravity behind when velocities return, which the filter takes for an accelerometer
bias. Twelve states have no height in which that uncertainty could stand. A vehicle stays near its depth.
"""

from typing import Final, NamedTuple

from insdvl_replay.core.compiled import inlined

HOLD_AFTER_S: Final = 300.0
"""Without a velocity for so long, an acceleration error a has moved the height by a T^2 / 2, and gravity there by 14 %
of a; after 600 s it is 55 %."""


class GravityHeight(NamedTuple):
    """Where gravity is taken.

    Attributes
    ----------
    height_m : float
    drift_m : float
        What the INS's height has moved by while this one was held: how much higher it is.
    aided_s : float
        When a velocity was used last, seconds from the start.
    """

    height_m: float
    drift_m: float
    aided_s: float


@inlined
def followed(gravity: GravityHeight, height_m: float, time_s: float) -> GravityHeight:
    """Let the height of gravity follow that of the INS, or hold it.

    Parameters
    ----------
    gravity : GravityHeight
        At the node before.
    height_m : float
        Of the INS.
    time_s : float
        Seconds from the start.

    Returns
    -------
    GravityHeight
    """
    if time_s - gravity.aided_s <= HOLD_AFTER_S:
        return GravityHeight(height_m - gravity.drift_m, gravity.drift_m, gravity.aided_s)
    return GravityHeight(gravity.height_m, height_m - gravity.height_m, gravity.aided_s)
