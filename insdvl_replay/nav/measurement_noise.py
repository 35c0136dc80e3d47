"""Measurement noise that is not what it is said to be: innovations tell its size, or outliers are expected among them.

adaptive    R <- b R, f <- f + ((z' z - H P H') / R - f) / 30, from 0.1 to 10: by the innovations until this one;
            var(f) <- (29/30)^2 var(f) + 2 (S / R)^2 / 30^2, by S of a noise as it is said to be,
            b = f - 9 var(f) / (f - 1), or 1 within three sd: what of f is more than chance
student-t   R <- f R, f = max(1, (nu + NIS) / (nu + m + 3 sqrt(2 m))), nu = 10: for this innovation alone

Source: Sage and Husa, "Adaptive filtering with unknown prior statistics", 1969, with a window and limits as follow-ups
have them; James and Stein, "Estimation with quadratic loss", 1961, for what is believed of the factor; Roth, Oezkan and
Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", 2013, of which this is the first
step, in ratio to what it does at three sd of the NIS, where outliers begin. Without these two, clean dives drift by 2
to 6 % more; with them, by less than 1 %, see `benchmarks/noise.py`.
"""

import math
from typing import Final

from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import inlined

FIXED: Final = 0
ADAPTIVE: Final = 1
STUDENT_T: Final = 2

WINDOW: Final = 30.0
"""Innovations after which a step of the noise is followed but for a third."""
FLOOR: Final = 0.1
CEILING: Final = 10.0
"""Limits of the factor: a noise further off is a fault of the settings."""
CHANCE_SD: Final = 3.0
"""How far off may be by chance, in standard deviations: so far the noise is what it is said to be."""
DEGREES_OF_FREEDOM: Final = 10.0
"""Of Student's t: with 4 clean dives drift by 2 % more, with 20 outliers are let in further."""


@inlined
def outlier_factor(nis: float, size: int) -> float:
    """Return by how much R is larger than said where Student's t of an innovation of so many components has it."""
    by_chance = size + CHANCE_SD * math.sqrt(2.0 * size)
    return max(1.0, (DEGREES_OF_FREEDOM + nis) / (DEGREES_OF_FREEDOM + by_chance))


@inlined
def found_factor(found: float, believed: float, z: Floats, S: Floats, R: Floats, share: float) -> float:
    """Return how large R is by an innovation more; S was made with ``R``, which holds the factor believed until now.

    Of the square of one that a gate has rejected only as large a ``share`` counts as would have passed. Without these a
    noise that grows would never be found; with all of them an outlier would be taken for noise.
    """
    seen, size = 0.0, len(z)
    for i in range(size):
        seen += (share * z[i] * z[i] - (S[i, i] - R[i, i])) / (R[i, i] / believed)
    return min(CEILING, max(FLOOR, found + (seen / size - found) / WINDOW))


@inlined
def chance_var(var: float, believed: float, S: Floats, R: Floats) -> float:
    """Return the variance of what is found of a noise as it was said to be, by an innovation more.

    After an outage an innovation tells of the INS, and what it does to the factor is forgotten no sooner than this. The
    limits of the factor are its own.
    """
    of_one, size = 0.0, len(R)
    for i in range(size):
        of_one += 2.0 * ((S[i, i] - R[i, i]) / (R[i, i] / believed) + 1.0) ** 2
    kept = 1.0 - 1.0 / WINDOW
    return min(((CEILING - 1.0) / CHANCE_SD) ** 2, kept * kept * var + of_one / (size * WINDOW) ** 2)


@inlined
def believed_factor(found: float, var: float) -> float:
    """Return what is left of a factor beyond what innovations of a noise as it was said to be would find by chance."""
    excess = found - 1.0
    if excess**2 <= CHANCE_SD**2 * var:
        return 1.0
    return found - CHANCE_SD**2 * var / excess
