"""Measurement noise that is not what it is said to be: innovations tell its size, or outliers are expected among them.

adaptive    R <- f R, f <- f + ((z' z - H P H') / R - f) / 30, from 0.1 to 10: by the innovations until this one
student-t   R <- f R, f = max(1, (nu + NIS) / (nu + m)), nu = 20: for this innovation alone

Source: Sage and Husa, "Adaptive filtering with unknown prior statistics", 1969, with a window and limits as follow-ups
have them; Roth, Oezkan and Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", 2013, of
which this is the first step, taken only where it makes R larger.
"""

from typing import Final

from insdvl_replay.core.compiled import inlined
from insdvl_replay.core.dive_columns import Floats

FIXED: Final = 0
ADAPTIVE: Final = 1
STUDENT_T: Final = 2

WINDOW: Final = 30.0
"""Innovations after which a step of the noise is followed but for a third."""
FLOOR: Final = 0.1
CEILING: Final = 10.0
"""Limits of the factor: a noise further off is a fault of the settings."""
DEGREES_OF_FREEDOM: Final = 20.0
"""Of Student's t: with the 4 that are often taken clean dives drift by 8 % more; outliers are kept out no better."""


@inlined
def outlier_factor(nis: float, size: int) -> float:
    """Return by how much R is larger than said where Student's t of an innovation of so many components has it."""
    return max(1.0, (DEGREES_OF_FREEDOM + nis) / (DEGREES_OF_FREEDOM + size))


@inlined
def adapted_factor(factor: float, z: Floats, S: Floats, R: Floats) -> float:
    """Return how large R is by an innovation more; S was made with ``R``, which holds the factor until now."""
    found, size = 0.0, len(z)
    for i in range(size):
        found += (z[i] * z[i] - (S[i, i] - R[i, i])) / (R[i, i] / factor)
    return min(CEILING, max(FLOOR, factor + (found / size - factor) / WINDOW))
