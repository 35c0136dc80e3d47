"""A column that fills block by block, in room that is made once for all that the log announces."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Filling:
    """A column that is not complete yet. As long as all rows are alike, it holds one of them.

    Parameters
    ----------
    announced : int
        How many rows are expected; more find room too.
    """

    def __init__(self, announced: int) -> None:
        self._announced = announced
        self._rows: NDArray[Any] = np.empty((0, 0), np.int64)
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
        if not self._count:
            self._rows = values[:1].copy()
        if self._is_one_row and _are_all(values, self._rows):
            self._count += len(values)
        else:
            self._append(values)

    def rows(self) -> NDArray[Any]:
        """Give all rows, shape (k, n); where all are alike, as a view of one that cannot be written to."""
        if self._is_one_row:
            return np.broadcast_to(self._rows, (self._count, self._rows.shape[1]))
        return self._rows[: self._count]

    @property
    def _is_one_row(self) -> bool:
        return len(self._rows) == 1

    def _append(self, values: NDArray[Any]) -> None:
        count, needed, width = self._count, self._count + len(values), values.shape[1]
        uneven = width != self._rows.shape[1]
        dtype = np.dtype(np.float64) if uneven else np.result_type(self._rows.dtype, values.dtype)
        room = len(self._rows) if needed <= len(self._rows) else max(needed + needed // 2, self._announced)
        self._make_room((room, max(width, self._rows.shape[1])), dtype)
        self._rows[count:needed, :width] = values
        if uneven:
            self._rows[count:needed, width:] = np.nan
        self._count = needed

    def _make_room(self, shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        if (shape, dtype) == (self._rows.shape, self._rows.dtype):
            return
        filled = self.rows()
        self._rows = np.empty(shape, dtype)
        self._rows[: self._count, : filled.shape[1]] = filled
        if filled.shape[1] < shape[1]:
            self._rows[: self._count, filled.shape[1] :] = np.nan


def _are_all(values: NDArray[Any], row: NDArray[Any]) -> bool:
    """Tell whether all rows are this one, NaN as NaN, and of its kind of number."""
    if values.dtype != row.dtype or values.shape[1] != row.shape[1]:
        return False
    same = values == row
    return bool(same.all() or np.all(same | (np.isnan(values) & np.isnan(row))))
