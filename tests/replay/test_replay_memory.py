"""A replay takes little memory beyond the columns it reads, and lets the readings go when the filters have run."""

import tracemalloc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insdvl_replay import replay
from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.preparation.reading import read_checked_dive
from insdvl_replay.replay import replay_dive
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


def test_the_readings_are_let_go_before_the_tables_are_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, readings, make_tables = tmp_path / "dive.mcap", list[Callable[[], Any]](), replay.tables_of_filters
    write_dive(path, dive_of(SHORT_S))

    def watched(*arguments: Any, **options: Any) -> Dive:
        dive = read_checked_dive(*arguments, **options)
        readings.extend(weakref.ref(column) for column in (dive.imu.specific_force_b, dive.imu.angular_rate_b))
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
    kept, given = getattr(replay_dive(dive, Config()).dive.imu, quantity), getattr(dive.imu, quantity)
    np.testing.assert_array_equal(kept, given if quantity == "time_ns" else given[:0])
