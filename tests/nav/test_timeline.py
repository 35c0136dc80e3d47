"""Nodes stand at the times of validity, to the nanosecond, and readings between samples on a cubic through them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from instants import instants

from insdvl_replay.core.dive_columns import Floats, ImuColumns, TimeNs
from insdvl_replay.nav.timeline import Timeline, build_timeline

EPOCH_NS = 1_704_067_200_000_000_001
"""A date in nanoseconds, which a float would round to multiples of 256."""
MS = 1_000_000
NONE = np.empty(0, dtype=np.int64)


def imu_at(time_ns: TimeNs, seed: int = 1) -> ImuColumns:
    rng = np.random.default_rng(seed)
    return ImuColumns(
        time_ns, rng.normal(size=(len(time_ns), 3)), rng.normal(size=(len(time_ns), 3))
    )


def imu_100_hz(samples: int = 11) -> ImuColumns:
    return imu_at(EPOCH_NS + 10 * MS * np.arange(samples))


def ns(*offsets: int) -> TimeNs:
    return EPOCH_NS + np.array(offsets, dtype=np.int64)


def whole(imu: ImuColumns, ping_ns: TimeNs, reference_ns: TimeNs = NONE) -> Timeline:
    return build_timeline(imu, ping_ns, reference_ns, int(imu.time_ns[0]), int(imu.time_ns[-1]))


def integral(timeline: Timeline) -> Floats:
    at = instants(timeline)
    dt = np.diff(at.time_s)[:, None]
    means = 0.5 * (at.specific_force_b[1:] + at.specific_force_b[:-1])
    bends = dt**2 / 12.0 * (at.force_bend_b[1:] + at.force_bend_b[:-1])
    return np.asarray(np.sum(dt * (means - bends), axis=0))


@pytest.mark.parametrize(
    ("offset_ns", "nodes"),
    [
        (20 * MS, 11),
        (20 * MS + 1, 12),
        (25 * MS, 12),
        (30 * MS - 1, 12),
        (1, 12),
        (100 * MS - 1, 12),
        (100 * MS, 11),
    ],
    ids=[
        "on a sample",
        "just after",
        "between",
        "just before",
        "first nanosecond",
        "last but one",
        "at the end",
    ],
)
def test_ping_has_its_own_node_at_its_own_nanosecond(offset_ns: int, nodes: int) -> None:
    at = instants(whole(imu_100_hz(), ns(offset_ns)))
    assert len(at.time_ns) == nodes
    row = int(np.flatnonzero(at.ping >= 0).item())
    assert at.ping[row] == 0
    assert at.time_ns[row] == EPOCH_NS + offset_ns
    assert at.record[row]
    assert at.time_s[row] == pytest.approx(offset_ns * 1e-9, abs=1e-15)


@pytest.mark.parametrize("imu_hz", [50, 100, 400])
@pytest.mark.parametrize("dvl_hz", [1, 3, 10])
def test_every_sample_ping_and_reference_has_one_node(imu_hz: int, dvl_hz: int) -> None:
    imu = imu_at(EPOCH_NS + np.rint(np.arange(5 * imu_hz + 1) * 1e9 / imu_hz).astype(np.int64))
    ping_ns = EPOCH_NS + np.rint((0.0137 + np.arange(4 * dvl_hz)) * 1e9 / dvl_hz).astype(np.int64)
    reference_ns = EPOCH_NS + np.rint(np.arange(21) * 0.25e9).astype(np.int64)
    at = instants(whole(imu, ping_ns, reference_ns))
    assert set(at.time_ns.tolist()) == {
        *imu.time_ns.tolist(),
        *ping_ns.tolist(),
        *reference_ns.tolist(),
    }
    assert (np.diff(at.time_ns) > 0).all()
    np.testing.assert_array_equal(at.time_ns[at.ping >= 0], ping_ns)
    np.testing.assert_array_equal(at.ping[at.ping >= 0], np.arange(len(ping_ns)))
    assert set(at.time_ns[at.record].tolist()) == {*ping_ns.tolist(), *reference_ns.tolist()}


def test_reference_at_the_time_of_a_ping_shares_its_node() -> None:
    at = instants(whole(imu_100_hz(), ns(33 * MS), ns(33 * MS, 66 * MS)))
    assert (at.time_ns[at.record] - EPOCH_NS).tolist() == [0, 33 * MS, 66 * MS, 100 * MS]
    assert (at.time_ns[at.ping >= 0] - EPOCH_NS).tolist() == [33 * MS]


def test_reference_outside_the_span_is_left_out() -> None:
    reference_ns = ns(-1, 0, 14 * MS, 15 * MS, 50 * MS, 85 * MS, 86 * MS, 101 * MS)
    at = instants(build_timeline(imu_100_hz(), NONE, reference_ns, *ns(15 * MS, 85 * MS).tolist()))
    assert (at.time_ns[at.record] - EPOCH_NS).tolist() == [15 * MS, 50 * MS, 85 * MS]


def test_span_may_begin_and_end_between_samples() -> None:
    at = instants(build_timeline(imu_100_hz(), ns(85 * MS), NONE, *ns(15 * MS, 85 * MS).tolist()))
    assert (at.time_ns[[0, 1, -2, -1]] - EPOCH_NS).tolist() == [15 * MS, 20 * MS, 80 * MS, 85 * MS]
    assert at.time_s[0] == 0.0
    assert at.record[[0, -1]].all()
    assert at.ping[-1] == 0


PING_OFFSETS_NS = (1, 5 * MS, 10 * MS, 37 * MS, 100 * MS - 1)


def test_readings_between_samples_are_on_a_cubic() -> None:
    """Whatever is a parabola in time is met, at uneven steps and at the ends, too; a line has no bend."""
    time_ns = EPOCH_NS + np.cumsum([0, 10, 12, 8, 10, 15, 9, 10, 11, 10, 5]) * MS
    time_s = (time_ns - EPOCH_NS) * 1e-9
    force_b = np.column_stack([time_s**2, 1.0 - time_s, 3.0 * time_s**2 + time_s])
    imu = ImuColumns(
        time_ns, force_b, np.column_stack([-2.0 * time_s**2, time_s, np.ones_like(time_s)])
    )
    at = instants(whole(imu, ns(*PING_OFFSETS_NS)))
    np.testing.assert_allclose(
        at.specific_force_b[:, 2], 3.0 * at.time_s**2 + at.time_s, rtol=0.0, atol=1e-12
    )
    np.testing.assert_allclose(
        at.force_bend_b, np.tile([1.0, 0.0, 3.0], (len(at.time_s), 1)), rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(at.rate_bend_b[:, 0], -2.0, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(integral(whole(imu, NONE))[0], 0.1**3 / 3.0, rtol=1e-9)


def test_readings_at_samples_are_the_samples() -> None:
    imu = imu_100_hz()
    at = instants(whole(imu, ns(*PING_OFFSETS_NS)))
    np.testing.assert_array_equal(
        at.specific_force_b[np.isin(at.time_ns, imu.time_ns)], imu.specific_force_b
    )
    np.testing.assert_array_equal(
        at.angular_rate_b[np.isin(at.time_ns, imu.time_ns)], imu.angular_rate_b
    )


def test_readings_are_straight_beside_lost_samples() -> None:
    """One step is then many times as long as the next, and a bend would be noise."""
    imu = imu_at(EPOCH_NS + np.array([0, 10, 20, 30, 80, 90, 100, 110]) * MS)
    at = instants(whole(imu, ns(55 * MS)))
    assert (at.force_bend_b[[1, 2]] != 0.0).all()
    assert not at.force_bend_b[[3, 4, 5]].any()
    np.testing.assert_allclose(
        at.angular_rate_b[4], imu.angular_rate_b[3:5].mean(axis=0), rtol=1e-12
    )


@pytest.mark.parametrize("samples", [2, 3])
def test_two_or_three_samples_are_a_time_line(samples: int) -> None:
    at = instants(whole(imu_100_hz(samples), ns(4 * MS)))
    assert np.isfinite(at.specific_force_b).all()
    assert at.force_bend_b.any() == (samples == 3)


def test_a_part_of_a_dive_bends_as_the_whole() -> None:
    """A time line holds a sample more on either side."""
    imu = imu_100_hz()
    at = instants(whole(imu, ns(*PING_OFFSETS_NS)))
    part = instants(build_timeline(imu, ns(37 * MS), NONE, *ns(20 * MS, 40 * MS).tolist()))
    rows = np.searchsorted(at.time_ns, part.time_ns)
    assert part.time_ns.tolist() == ns(20 * MS, 30 * MS, 37 * MS, 40 * MS).tolist()
    np.testing.assert_allclose(part.force_bend_b, at.force_bend_b[rows], rtol=1e-9)


def test_a_time_line_does_not_copy_the_readings_unless_the_loop_cannot_take_them() -> None:
    imu = imu_100_hz()
    assert np.shares_memory(whole(imu, NONE).specific_force_b, imu.specific_force_b)
    strided = ImuColumns(imu.time_ns, np.asfortranarray(imu.specific_force_b), imu.angular_rate_b)
    assert whole(strided, NONE).specific_force_b.flags.c_contiguous
    assert integral(whole(strided, NONE)).tolist() == integral(whole(imu, NONE)).tolist()


def test_a_time_line_takes_memory_for_its_events_alone() -> None:
    """A copy of what stands in the samples would be the largest part of a long dive."""
    imu = imu_100_hz(100_000)
    timeline = whole(imu, imu.time_ns[0] + 10_000 * MS * np.arange(1, 100))
    of_samples = {"sample_ns", "specific_force_b", "angular_rate_b"}
    own = sum(
        column.nbytes for name, column in timeline._asdict().items() if name not in of_samples
    )
    assert own < 0.01 * imu.specific_force_b.nbytes
    assert all(
        np.shares_memory(getattr(timeline, name), getattr(imu, name.replace("sample", "time")))
        for name in of_samples
    )


@settings(derandomize=True, deadline=None)
@given(st.sets(st.integers(1, 100 * MS), max_size=30))
def test_pings_do_not_change_what_the_readings_add_up_to(offsets_ns: set[int]) -> None:
    imu = imu_100_hz()
    np.testing.assert_allclose(
        integral(whole(imu, ns(*sorted(offsets_ns)))), integral(whole(imu, NONE)), atol=1e-15
    )


def test_readings_after_the_end_are_left_out() -> None:
    at = instants(
        build_timeline(
            imu_100_hz(), ns(80 * MS, 80 * MS + 1), NONE, *ns(20 * MS, 80 * MS).tolist()
        )
    )
    assert (at.time_ns[at.ping >= 0] - EPOCH_NS).tolist() == [80 * MS]


@pytest.mark.parametrize(
    ("ping_offset_ns", "start_offset_ns", "end_offset_ns", "message"),
    [
        (50 * MS, -1, 100 * MS, "the span lies outside"),
        (50 * MS, 0, 100 * MS + 1, "the span lies outside"),
        (20 * MS, 20 * MS, 80 * MS, "a reading lies before"),
    ],
    ids=["starts before the samples", "ends after them", "ping at the start"],
)
def test_one_nanosecond_outside_is_refused(
    ping_offset_ns: int, start_offset_ns: int, end_offset_ns: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        build_timeline(
            imu_100_hz(), ns(ping_offset_ns), NONE, *ns(start_offset_ns, end_offset_ns).tolist()
        )
