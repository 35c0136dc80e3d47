"""The loop over the numbers in messages, compiled."""

import numpy as np
from numpy.typing import NDArray

from insdvl_replay.core.compiled import compiled, inlined
from insdvl_replay.logs.encoding.cdr_numbers import Places


@compiled
def read_bits(data: NDArray[np.uint8], starts: NDArray[np.int64], places: Places) -> NDArray[np.int64]:
    """Do what `cdr_numbers.read_bits` does, touching each byte that is wanted once, and no other."""
    bits = np.empty((places.start.size, starts.size), np.int64)
    for i in range(places.start.size):
        start, size = places.start[i], places.size[i]
        beyond = 64 - 8 * size if places.signed[i] else 0
        for row in range(starts.size):
            bits[i, row] = (_whole(data, np.uint64(starts[row] + start), size) << beyond) >> beyond
    return bits


@inlined
def _whole(data: NDArray[np.uint8], place: np.uint64, size: int) -> np.int64:
    """Give the whole number of 1, 2, 4 or 8 bytes, of which the first counts least."""
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
