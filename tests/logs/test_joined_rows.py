"""A column that fills block by block is what its blocks are one below the other."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from insdvl_replay.logs.columns.tables import Column

NUMBERS = st.sampled_from([0.0, 1.0, np.nan])
BLOCKS = st.lists(st.lists(NUMBERS, min_size=1, max_size=4), min_size=1, max_size=6)


def filled(*blocks: NDArray[np.generic], announced: int = 3) -> NDArray[np.generic]:
    column = Column(announced)
    for block in blocks:
        column.add(block)
    return column.values()


@settings(derandomize=True, deadline=None)
@given(BLOCKS, st.integers(0, 30))
def test_rows_are_those_of_the_blocks(numbers: list[list[float]], announced: int) -> None:
    blocks = [np.array(block, dtype=np.float64).reshape(-1, 1) for block in numbers]
    np.testing.assert_array_equal(filled(*blocks, announced=announced), np.concatenate(blocks))


def test_a_column_of_rows_that_are_alike_takes_the_room_of_one() -> None:
    block = np.tile([[-1.0, np.nan, 3.0]], (1000, 1))
    rows = filled(*[block] * 50)
    assert rows.shape == (50_000, 3)
    assert rows.strides[0] == 0
    np.testing.assert_array_equal(rows, np.tile(block, (50, 1)))


def test_one_row_that_differs_is_kept() -> None:
    for row, other in ((0, 2.0), (1500, np.nan), (2999, 2.0)):
        values = np.ones((3000, 1))
        values[row] = other
        np.testing.assert_array_equal(filled(*np.split(values, 3)), values)


def test_whole_numbers_stay_whole_until_others_come() -> None:
    large = np.full((3, 1), 2**62 + 1)
    assert filled(large, large).dtype == np.int64
    assert filled(large, large).tolist() == [[2**62 + 1]] * 6
    np.testing.assert_array_equal(
        filled(np.ones((2, 1), np.int64), np.ones((2, 1))), np.ones((4, 1))
    )
    assert filled(np.ones((2, 1), np.int64), np.ones((2, 1))).dtype == np.float64


def test_shorter_rows_are_filled_up() -> None:
    one, two = np.ones((2, 1)), np.full((2, 2), 2.0)
    expected = [[1.0, np.nan], [1.0, np.nan], [2.0, 2.0], [2.0, 2.0], [1.0, np.nan], [1.0, np.nan]]
    np.testing.assert_array_equal(filled(one, two, one), expected)
    np.testing.assert_array_equal(
        filled(two, np.ones((1, 1), np.int64)), [[2.0, 2.0], [2.0, 2.0], [1.0, np.nan]]
    )
