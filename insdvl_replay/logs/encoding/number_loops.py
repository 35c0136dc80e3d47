"""The loop over the numbers in messages, compiled."""

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.runtime import compiled, inlined


@compiled
def read_bits(data: NDArray[np.uint8], starts: NDArray[np.int64], places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Do what `binary_fields.read_bits` does, touching each byte that is wanted once, and no other."""
    bits = np.empty((places.shape[1], starts.size), np.int64)
    for number in range(places.shape[1]):
        offset, size, signed = places[0, number], places[1, number], places[2, number]
        beyond = 64 - 8 * size if signed else 0
        for row in range(starts.size):
            bits[number, row] = (_whole(data, np.uint64(starts[row] + offset), size) << beyond) >> beyond
    return bits


@inlined
def _whole(data: NDArray[np.uint8], place: np.uint64, size: int) -> np.int64:
    """Return the whole number of 1, 2, 4 or 8 bytes, of which the first counts least."""
    if size == 8:
        return _four_bytes(data, place) | _four_bytes(data, place + np.uint64(4)) << 32
    if size == 4:
        return _four_bytes(data, place)
    number = np.int64(data[place])
    return number if size == 1 else number | np.int64(data[place + np.uint64(1)]) << 8


@inlined
def _four_bytes(data: NDArray[np.uint8], place: np.uint64) -> np.int64:
    """Written out and with places that cannot be negative, so that the compiler makes one step of it."""
    low = np.int64(data[place]) | np.int64(data[place + np.uint64(1)]) << 8
    return low | np.int64(data[place + np.uint64(2)]) << 16 | np.int64(data[place + np.uint64(3)]) << 24
