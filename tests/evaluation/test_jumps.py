"""Steps of a position that its own velocity does not explain, where the steps are known."""

from dataclasses import replace

import numpy as np
import pytest
from test_consistency import history

from insdvl_replay.core.dive_columns import Floats, ReferenceColumns
from insdvl_replay.core.tables import JumpRow
from insdvl_replay.evaluation.drift import jump_table
from insdvl_replay.geometry.frames import least_difference, moved_position

RATE_HZ = 5
TIME_S = np.arange(600) / RATE_HZ
TURN_RADPS = 0.2
VELOCITY_N = np.stack(
    [np.cos(TURN_RADPS * TIME_S), np.sin(TURN_RADPS * TIME_S), 0.0 * TIME_S], axis=1
)
WAY_N = (
    np.stack(
        [np.sin(TURN_RADPS * TIME_S), 1.0 - np.cos(TURN_RADPS * TIME_S), 0.0 * TIME_S], axis=1
    )
    / TURN_RADPS
)


def found(moved_n: Floats, velocity_n: Floats = VELOCITY_N, time_s: Floats = TIME_S) -> JumpRow:
    """Look at a vehicle that turns all the time, beside a history that spans it."""
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    origin = np.broadcast_to([0.57, 0.61, -5.0], moved_n.shape)
    motion = ReferenceColumns(
        time_ns, moved_position(origin, moved_n), velocity_n, np.full((len(moved_n), 3, 3), np.nan)
    )
    beside = replace(
        history("onboard", np.full(2, 3.0)), time_ns=time_ns[[0, -1]], is_partial=True
    )
    (row,) = jump_table("dive", [beside], {"onboard": motion})
    return row


def jumping(*jumps: tuple[int, float]) -> Floats:
    """Move the vehicle north from some rows on."""
    moved_n = WAY_N.copy()
    for row, size_m in jumps:
        moved_n[row:, 0] += size_m
    return moved_n


def test_a_turn_is_no_jump() -> None:
    row = found(WAY_N)
    assert (row.jumps, row.steps) == (0, len(TIME_S) - 1)
    assert row.largest_m is not None
    assert row.largest_m < 1e-3


@pytest.mark.parametrize("told", [True, False])
def test_jumps_are_counted_whether_or_not_a_velocity_is_reported(told: bool) -> None:
    velocity_n = VELOCITY_N if told else np.full_like(VELOCITY_N, np.nan)
    row = found(jumping((100, 0.7), (300, -3.0), (301, 1.0)), velocity_n)
    assert (row.jumps, row.largest_m) == (3, pytest.approx(3.0, abs=0.02))
    assert row.largest_at_s == pytest.approx(300 / RATE_HZ)


def test_each_step_is_compared_with_three_before_and_three_after() -> None:
    steps = np.array([[1.0], [1.0], [1.0], [1.0], [5.0], [6.0], [7.0], [20.0], [9.0]])
    assert least_difference(steps).tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 11.0, 2.0]


def test_the_edge_of_a_gap_is_no_jump() -> None:
    """A fix a second and its noise: the last step before the gap has its like before it alone."""
    time_s = np.r_[np.arange(100.0), np.arange(140.0, 240.0)]
    moved_n = np.column_stack([time_s, 0.0 * time_s, 0.0 * time_s])
    moved_n[time_s < 100.0, 1] = 0.2 * time_s[time_s < 100.0]
    moved_n += np.random.default_rng(0).normal(0.0, 0.005, moved_n.shape)
    row = found(moved_n, np.full_like(moved_n, np.nan), time_s)
    assert row.jumps == 0


def test_what_is_smaller_or_usual_is_no_jump() -> None:
    """Less than half a metre; or noise of which ten robust standard deviations are more."""
    assert found(jumping((100, 0.45))).jumps == 0
    noise_m = np.random.default_rng(1).normal(0.0, 0.5, WAY_N.shape)
    assert found(jumping((100, 2.0)) + noise_m).jumps == 0
    assert found(jumping((100, 12.0)) + noise_m).jumps == 1


def test_positions_that_are_until_there_is_a_new_one_do_not_jump() -> None:
    """Told at 5 Hz, new once in two seconds: each new one is two metres on."""
    standing = WAY_N[(np.arange(len(TIME_S)) // 10) * 10]
    assert found(standing).jumps == 0
    standing[200:, 0] += 4.0
    assert found(standing).jumps == 1


def test_a_filter_that_goes_by_its_velocity_has_no_row() -> None:
    assert jump_table("dive", [history("baseline", np.full(5, 3.0))], {}) == []
