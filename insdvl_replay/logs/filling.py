"""A column that fills block by block, in room that is made once for all that the log announces."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Filling:
    """A column that is not complete yet.

    Parameters
    ----------
    announced : int
        How many rows are expected; more find room too.
    """

    def __init__(self, announced: int) -> None:
        self._rows: NDArray[Any] = np.empty((announced, 0), np.int64)
        self._count = 0

    def __len__(self) -> int:
        """Give the number of rows so far."""
        return self._count

    def add(self, values: NDArray[Any]) -> None:
        """Put rows below the others.

        Parameters
        ----------
        values : ndarray, shape (k, n)
            Where rows are shorter than others, they are filled up with NaN.
        """
        count, needed, width = self._count, self._count + len(values), values.shape[1]
        if not count:
            self._rows = np.empty((max(len(self._rows), needed), width), values.dtype)
        uneven = width != self._rows.shape[1]
        dtype = np.dtype(np.float64) if uneven else np.result_type(self._rows.dtype, values.dtype)
        room = len(self._rows) if needed <= len(self._rows) else needed + needed // 2
        self._make_room((room, max(width, self._rows.shape[1])), dtype)
        self._rows[count:needed, :width] = values
        if uneven:
            self._rows[count:needed, width:] = np.nan
        self._count = needed

    def rows(self) -> NDArray[Any]:
        """Give all rows, shape (k, n)."""
        return self._rows[: self._count]

    def _make_room(self, shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        if (shape, dtype) == (self._rows.shape, self._rows.dtype):
            return
        filled = self.rows()
        self._rows = np.empty(shape, dtype)
        self._rows[: self._count, : filled.shape[1]] = filled
        if filled.shape[1] < shape[1]:
            self._rows[: self._count, filled.shape[1] :] = np.nan
