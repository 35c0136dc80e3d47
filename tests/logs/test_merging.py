"""Channels and files of one topic laid together: each in its order, what is there twice once, two dives never."""

from dataclasses import replace

import numpy as np
import pytest
from small_tables import nanoseconds, small_table

from insdvl_replay.core.errors import LogError
from insdvl_replay.logs.columns.clean import raise_if_two_dives
from insdvl_replay.logs.columns.tables import merge_channels, repeated_rows

NAN = np.nan


def columns(log_times: list[int], values: list[float]) -> dict[str, np.ndarray]:
    return {"log_time": np.array(log_times)[:, None], "x": np.array(values)[:, None]}


def test_one_channel_is_given_back_as_it_is() -> None:
    given = columns([3, 1, 2], [1.0, 2.0, 3.0])
    merged, channel_ids, rows = merge_channels(given, [(7, 2), (7, 1)])
    assert merged is given
    assert (channel_ids.size, rows) == (0, None)


def test_channels_are_aligned_together_by_log_time() -> None:
    merged, channel_ids, rows = merge_channels(
        columns([1, 3, 2, 4], [1.0, 3.0, 2.0, 4.0]), [(1, 2), (2, 2)]
    )
    assert merged["x"].ravel().tolist() == [1.0, 2.0, 3.0, 4.0]
    assert rows is not None
    assert (channel_ids.tolist(), rows.tolist()) == ([1, 2, 1, 2], [0, 2, 1, 3])


def test_a_channel_stays_in_its_own_order() -> None:
    merged, channel_ids, _ = merge_channels(
        columns([1, 5, 2, 4], [1.0, 5.0, 2.0, 4.0]), [(1, 3), (2, 1)]
    )
    assert merged["x"].ravel()[channel_ids == 1].tolist() == [1.0, 5.0, 2.0]


def test_what_another_channel_holds_too_is_left_out_once() -> None:
    merged, channel_ids, rows = merge_channels(
        columns([1, 2, 1, 2], [1.0, NAN, 1.0, NAN]), [(1, 2), (2, 2)]
    )
    assert merged["log_time"].ravel().tolist() == [1, 2]
    assert rows is not None
    assert (channel_ids.tolist(), rows.tolist()) == ([1, 1], [0, 1])


@pytest.mark.parametrize(
    ("log_times", "values", "origin", "repeated"),
    [
        pytest.param([1, 1], [2.0, 2.0], [1, 1], False, id="of the same origin"),
        pytest.param([1, 1], [2.0, 3.0], [1, 2], False, id="another value"),
        pytest.param([1, 2], [2.0, 2.0], [1, 2], False, id="another time"),
        pytest.param([1, 1], [NAN, 2.0], [1, 2], False, id="a value that the other lacks"),
        pytest.param([1, 1], [NAN, NAN], [1, 2], True, id="the same"),
    ],
)
def test_a_repetition_is_the_same_message_of_another_origin(
    log_times: list[int], values: list[float], origin: list[int], repeated: bool
) -> None:
    assert repeated_rows(columns(log_times, values), np.array(origin)).tolist() == [
        False,
        repeated,
    ]


FILES = {
    "one after the other": [*range(10)],
    "one fills the gap of the other": [0, 1, 2, 8, 9, 3, 4, 5, 6, 7],
    "the same": [*range(5), *range(5)],
    "the same, one lost some": [0, 1, 2, 3, 4, 0, 2, 3, 4, 5],
}


@pytest.mark.parametrize("times", FILES.values(), ids=FILES.keys())
def test_files_of_one_dive_are_read_together(times: list[int]) -> None:
    table = replace(small_table(times), files=np.repeat([0, 1], 5))
    raise_if_two_dives(table, nanoseconds(times))


def test_files_whose_messages_are_among_each_other_are_two_dives() -> None:
    times = [0.0, 1.0, 2.0, 3.0, 4.0, 0.5, 1.5, 2.5, 3.5, 4.5]
    table = replace(small_table(times), files=np.repeat([0, 1], 5))
    with pytest.raises(
        LogError,
        match=r"in the 3\.500 s in which the files overlap, one has 4 messages and the others 4",
    ):
        raise_if_two_dives(table, nanoseconds(times))
