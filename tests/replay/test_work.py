"""Work is counted, not timed: a step that is done message by message in Python again fails here on any machine.

So does a compiled loop that makes something, counts a reference or takes one number at a time where it did not.
"""

import cProfile
import pstats
import tracemalloc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from plain_filter import Inputs, baseline_inputs

from insdvl_replay import replay
from insdvl_replay.core.columns import Dive, Floats
from insdvl_replay.core.config import Config
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.nav.error_model import propagate_cov
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.local_earth import Place, place_at
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import Timeline, first_node, is_last, next_node
from insdvl_replay.preparation.reading import read_checked_dive
from insdvl_replay.replay import replay_dive
from insdvl_replay.results.result_files import save_replay
from insdvl_replay.sim.dive import simulate_dive

SHORT_S, LONG_S = 100.0, 400.0
IMU_HZ = 100.0


def dive_of(duration_s: float) -> Dive:
    return simulate_dive("lawnmower", seed=1, duration_s=duration_s)


def calls(work: Callable[[], Any]) -> int:
    """Function calls of Python that some work takes, those into C included."""
    profile = cProfile.Profile()
    profile.runcall(work)
    return int(pstats.Stats(profile).total_calls)  # type: ignore[attr-defined]


def calls_a_sample(work: Callable[[Dive], Callable[[], Any]]) -> float:
    """How many calls each further sample of the IMU costs; what is done once for every dive does not count."""
    short, long = work(dive_of(SHORT_S)), work(dive_of(LONG_S))
    short()  # imports, and what is cached
    return (calls(long) - calls(short)) / ((LONG_S - SHORT_S) * IMU_HZ)


def test_reading_calls_nothing_for_each_message(tmp_path: Path) -> None:
    def reading(dive: Dive) -> Callable[[], Dive]:
        path = tmp_path / f"{len(dive.imu.time_ns)}.mcap"
        write_dive(path, dive)
        return lambda: read_dive(path, Config())

    assert calls_a_sample(reading) < 0.7


def test_writing_a_log_calls_nothing_for_each_message(tmp_path: Path) -> None:
    assert calls_a_sample(lambda dive: lambda: write_dive(tmp_path / "dive.mcap", dive)) < 0.5


def test_filtering_calls_nothing_for_each_epoch() -> None:
    assert calls_a_sample(lambda dive: lambda: replay_dive(dive, Config())) < 0.05


def test_saving_calls_little_for_each_epoch(tmp_path: Path) -> None:
    assert calls_a_sample(lambda dive: lambda: save_replay(replay_dive(dive, Config()), tmp_path)) < 1.0


def test_reading_takes_little_memory_beyond_the_columns(tmp_path: Path) -> None:
    """Besides columns of times and readings: times of the recorder, other topics, and little for a while."""
    path = tmp_path / "dive.mcap"
    write_dive(path, dive_of(4.0 * LONG_S))
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


def test_the_readings_are_gone_when_the_tables_are_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, readings, make_tables = tmp_path / "dive.mcap", list[Callable[[], Any]](), replay.compared_filters
    write_dive(path, dive_of(SHORT_S))

    def watched(*arguments: Any, **options: Any) -> Dive:
        dive = read_checked_dive(*arguments, **options)
        readings.extend(weakref.ref(column) for column in (dive.imu.specific_force_b, dive.imu.angular_rate_b))
        return dive

    def tables_of(*arguments: Any, **options: Any) -> Any:
        assert [alive() for alive in readings] == [None, None]
        return make_tables(*arguments, **options)

    monkeypatch.setattr(replay, "read_checked_dive", watched)
    monkeypatch.setattr(replay, "compared_filters", tables_of)
    replay.replay_log(path, Config())


@pytest.mark.parametrize("quantity", ["time_ns", "specific_force_b", "angular_rate_b"])
def test_a_replay_lets_the_readings_go_and_keeps_the_times(quantity: str) -> None:
    dive = dive_of(SHORT_S)
    kept, given = getattr(replay_dive(dive, Config()).dive.imu, quantity), getattr(dive.imu, quantity)
    np.testing.assert_array_equal(kept, given if quantity == "time_ns" else given[:0])


# Compiled loops


def inputs_at(imu_rate_hz: float) -> Inputs:
    return baseline_inputs(simulate_dive("straight", seed=1, duration_s=60.0, imu_rate_hz=imu_rate_hz), Config())


def arrays_made(inputs: Inputs) -> int:
    """Arrays that the compiled filter makes on its way."""
    timeline, start, noise_density, velocity = inputs
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats().alloc
        run_filter("baseline", timeline, start, noise_density, (velocity,), np.zeros(3))
        return int(rtsys.get_allocation_stats().alloc) - before
    finally:
        _nrt_python.memsys_disable_stats()


def test_the_filter_makes_arrays_at_pings_alone() -> None:
    slow, fast = arrays_made(inputs_at(50.0)), arrays_made(inputs_at(200.0))
    assert 0 < slow == fast


def llvm_of(function: Any, *arguments: Any) -> str:
    """Compile a function anew, since what comes from the disk does not show itself, and give its code."""
    compiled = numba.njit(error_model="numpy", nogil=True)(function)
    compiled(*arguments)
    return str(compiled.inspect_llvm(compiled.signatures[0]))


STILL = (0.0, 0.0, 0.0)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def test_mechanisation_and_covariance_count_no_references() -> None:
    """Each takes as long as twenty multiplications."""

    def go(timeline: Timeline, state: NavState, P: Floats, noise_density: Floats, place: Place) -> NavState:
        before = first_node(timeline)
        while not is_last(timeline, before):
            now = next_node(timeline, before)
            dt = now.time_s - before.time_s
            state, motion = propagate(state, now.specific_force_b, now.angular_rate_b, dt, place, 9.8)
            propagate_cov(P, motion, noise_density, dt)
            before = now
        return state

    inputs, state = inputs_at(50.0), NavState(STILL, STILL, LEVEL, STILL, STILL)
    code = llvm_of(go, inputs.timeline, state, np.eye(12).ravel(), inputs.noise_density, place_at(0.0, 0.0))
    assert "call void @NRT_incref" not in code


def test_several_columns_of_the_covariance_grow_at_once() -> None:
    motion = Motion(STILL, STILL, STILL, LEVEL, STILL)
    assert "fmul <" in llvm_of(propagate_cov, np.eye(12).ravel(), motion, np.ones(12), 0.01)
