"""Sine and cosine by additions and multiplications alone, which every processor rounds alike (IEEE 754).

The sines of libraries differ in their last bit from processor to processor, and would show in the bytes of a log.
"""

from typing import Final

import numpy as np

from insdvl_replay.core.columns import Floats

QUARTER_TURN: Final = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""Half of pi as a sum. The first two have 33 bits, so that their multiples up to 2^20 are exact.

Source: Cody and Waite, "Software Manual for the Elementary Functions", 1980; the parts are those of fdlibm.
"""
_SINE_ORDERS: Final = range(17, 1, -2)
_COSINE_ORDERS: Final = range(16, 0, -2)


def sine_and_cosine(angle: Floats) -> tuple[Floats, Floats]:
    """Give sine and cosine, within one unit of the last bit of 1.

    Parameters
    ----------
    angle : ndarray, any shape, rad
        Within a million of zero.

    Returns
    -------
    sine, cosine : ndarray, the same shape
    """
    quarters = np.rint(angle / QUARTER_TURN[0])
    rest = angle
    for part in QUARTER_TURN:
        rest = rest - quarters * part
    square = rest * rest
    sine, cosine = rest * _series(square, _SINE_ORDERS), _series(square, _COSINE_ORDERS)
    odd, second_half = quarters % 2.0 == 1.0, quarters % 4.0 >= 2.0
    sine, cosine = np.where(odd, cosine, sine), np.where(odd, -sine, cosine)
    return np.where(second_half, -sine, sine), np.where(second_half, -cosine, cosine)


def _series(square: Floats, orders: range) -> Floats:
    """Sum Taylor's series from its last term: ``1 - x^2/(n (n - 1)) (1 - x^2/((n + 2) (n + 1)) (...))``."""
    total = np.ones_like(square)
    for order in orders:
        total *= square
        total *= -1.0 / (order * (order - 1))
        total += 1.0
    return total
