"""What clean columns say of their times."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from insdvl_replay.core.dive_columns import ImuColumns, distinct, in_spans

TIMES = st.lists(st.one_of(st.integers(0, 20), st.integers(-(2**63), 2**63 - 1)), max_size=50)


@given(TIMES)
def test_distinct_times_are_those_of_numpy(times: list[int]) -> None:
    time_ns = np.array(times, np.int64)
    np.testing.assert_array_equal(distinct(time_ns), np.unique(time_ns))


@given(
    st.lists(st.integers(0, 40), max_size=20),
    st.lists(st.integers(0, 40), max_size=8, unique=True),
)
def test_times_in_spans_are_those_that_lie_in_one_of_them(
    times: list[int], edges: list[int]
) -> None:
    """A span ends where the next one may begin; its start does not belong to it."""
    ordered = sorted(edges)
    spans = list(zip(ordered[::2], ordered[1::2], strict=False))
    expected = [any(start < time <= end for start, end in spans) for time in times]
    assert in_spans(np.array(times, np.int64), spans).tolist() == expected


def test_usual_step_is_the_median_and_unknown_of_a_single_sample() -> None:
    def step_s(*time_ns: int) -> float:
        readings = np.zeros((len(time_ns), 3))
        return ImuColumns(np.array(time_ns), readings, readings).usual_step_s

    assert step_s(0, 10_000_000, 20_000_000, 3_000_000_000) == 0.01
    assert np.isnan(step_s(5))


def test_samples_within_a_span_are_kept_to_its_ends_and_not_copied() -> None:
    readings = np.arange(15.0).reshape(5, 3)
    imu = ImuColumns(np.array([10, 20, 30, 40, 50]), readings, -readings)
    part = imu.within(15, 40)
    assert part.time_ns.tolist() == [20, 30, 40]
    np.testing.assert_array_equal(part.specific_force_b, readings[1:4])
    np.testing.assert_array_equal(part.angular_rate_b, -readings[1:4])
    assert np.shares_memory(part.specific_force_b, readings)
