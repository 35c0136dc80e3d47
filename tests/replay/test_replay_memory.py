"""A replay takes little memory beyond the columns it reads, and lets the readings go when the filters have run."""

import tracemalloc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vehicles_own import Told, write_odometry

from insdvl_replay.core.config import Config, Evaluation, Filter
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.preparation import replay
from insdvl_replay.preparation.prepared import read_checked_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

SHORT_S, LONG_S = 100.0, 1600.0


def dive_of(duration_s: float) -> Dive:
    return simulate_dive("lawnmower", seed=1, duration_s=duration_s)


def test_reading_takes_little_memory_beyond_the_columns(tmp_path: Path) -> None:
    """Besides columns of times and readings: times of the recorder, other topics, and little for a while."""
    path = tmp_path / "dive.mcap"
    write_dive(path, dive_of(LONG_S))
    read_dive(path, Config())
    tracemalloc.start()
    try:
        imu = read_dive(path, Config()).imu
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    kept = imu.time_ns.nbytes + imu.specific_force_b.nbytes + imu.angular_rate_b.nbytes
    blocks = 2 * 2**20  # open chunks, of which some are ready ahead
    assert peak < 2.25 * kept + blocks


def test_the_readings_are_let_go_before_the_tables_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, readings, make_tables = (
        tmp_path / "dive.mcap",
        list[Callable[[], Any]](),
        replay.tables_of_filters,
    )
    write_dive(path, dive_of(SHORT_S))

    def watched(*arguments: Any, **options: Any) -> Dive:
        dive = read_checked_dive(*arguments, **options)
        readings.extend(
            weakref.ref(column) for column in (dive.imu.specific_force_b, dive.imu.angular_rate_b)
        )
        return dive

    def tables_of(*arguments: Any, **options: Any) -> Any:
        assert [alive() for alive in readings] == [None, None]
        return make_tables(*arguments, **options)

    monkeypatch.setattr(replay, "read_checked_dive", watched)
    monkeypatch.setattr(replay, "tables_of_filters", tables_of)
    replay.replay_log(path, Config())


@pytest.mark.parametrize("quantity", ["time_ns", "specific_force_b", "angular_rate_b"])
def test_a_replay_lets_the_readings_go_and_keeps_the_times(quantity: str) -> None:
    dive = dive_of(SHORT_S)
    kept, given = (
        getattr(replay_dive(dive, Config()).dive.imu, quantity),
        getattr(dive.imu, quantity),
    )
    np.testing.assert_array_equal(kept, given if quantity == "time_ns" else given[:0])


# --- A solution of the vehicle's own, as often as the IMU reads.


def with_odometry(folder: Path, duration_s: float = LONG_S) -> tuple[list[Path], int]:
    """Write a dive, and beside it an odometry of which each message has covariances of its own; count these."""
    dive = dive_of(duration_s)
    write_dive(folder / "dive.mcap", dive)
    time_ns = dive.imu.time_ns
    count, moved_n = len(time_ns), (time_ns - time_ns[0])[:, None] * np.array([1e-9, 2e-9, 0.0])
    told = Told(
        time_ns,
        moved_n,
        np.tile([1.0, 2.0, 0.0], (count, 1)),
        Rotation.from_euler("z", 1e-5 * np.arange(count)[:, None]),
    )
    growing = np.linspace(1.0, 2.0, count)[:, None, None] * (np.eye(6) + 0.1)
    covariances = {"pose.covariance": growing, "twist.covariance": 0.01 * growing}
    return [
        folder / "dive.mcap",
        write_odometry(folder / "odometry.mcap", told, covariances),
    ], count


def settings(**filters: Filter) -> Config:
    return Config(
        filters={"baseline": Filter(aiding=("velocity",)), **filters},
        evaluation=Evaluation(starts=1),
    )


def peak_of(work: Callable[[], Any]) -> int:
    work()
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.nightly
def test_a_solution_takes_little_memory_beyond_its_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time, way, velocity and attitude of each message are kept, 128 bytes; of covariances, 216 more, some alone.

    While it is read, its fields are in memory, too: two times, way, quaternion and velocity, 96 bytes. There is no room
    for anything else that grows with their number.
    """
    monkeypatch.setattr("insdvl_replay.logs.columns.tables.MOST_SAMPLED", 1000)
    paths, count = with_odometry(tmp_path)
    beside = settings(onboard=Filter(solution="/odometry"))
    solution = read_dive(paths, beside).solutions["onboard"]
    told = (
        solution.motion.time_ns,
        solution.moved_n,
        solution.motion.velocity_n,
        solution.motion.mat_nb,
    )
    assert len(solution.motion.time_ns) == count
    assert sum(column.nbytes for column in told if column is not None) == 128 * count
    assert solution.motion.position.strides[0] == 0  # none is told
    assert len(solution.cov) <= 1000
    alone_peak, beside_peak = (
        peak_of(lambda c=config: read_dive(paths, c)) for config in (settings(), beside)
    )
    assert beside_peak - alone_peak < (128 + 96) * count


def test_a_solution_is_let_go_before_the_tables_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths, _ = with_odometry(tmp_path, SHORT_S)
    columns, make_tables = list[Callable[[], Any]](), replay.tables_of_filters

    def watched(*arguments: Any, **options: Any) -> Dive:
        dive = read_checked_dive(*arguments, **options)
        (solution,) = dive.solutions.values()
        columns.extend(
            weakref.ref(column)
            for column in (solution.moved_n, solution.cov, solution.motion.mat_nb)
        )
        return dive

    def tables_of(*arguments: Any, **options: Any) -> Any:
        assert [alive() for alive in columns] == [None, None, None]
        return make_tables(*arguments, **options)

    monkeypatch.setattr(replay, "read_checked_dive", watched)
    monkeypatch.setattr(replay, "tables_of_filters", tables_of)
    found = replay.replay_log(paths, settings(onboard=Filter(solution="/odometry")))
    assert found.tables.jumps[0].steps > 0
