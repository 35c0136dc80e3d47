"""How much work a sample of the IMU takes, counted and not timed: the same figures on any machine.

`make bench` runs this, with the helpers of the tests on the path. A step that goes message by message in Python shows
as calls a sample, a compiled loop that makes something at every epoch as arrays, and one that counts references or
takes one number at a time in its machine code; each of these costs as much as the mechanisation itself.
"""

import argparse
import cProfile
import pstats
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.runtime import _nrt_python, rtsys
from plain_filter import Inputs, baseline_inputs
from results import machine, table, write_part

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.logs import read_dive, write_dive
from insdvl_replay.nav.earth_model import LocalEarth, local_earth_at
from insdvl_replay.nav.error_model import propagate_cov
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.strapdown import Motion, NavState, propagate
from insdvl_replay.nav.timeline import Timeline, first_node, is_last, next_node
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.show.result_files import save_replay
from insdvl_replay.sim.dive import simulate_dive

SHORT_S = 100.0
LONG_S = 400.0
IMU_HZ = 100.0
PING_HZ = 1.0
SLOW_HZ = 50.0
FAST_HZ = 200.0
FILTER_S = 60.0
STILL = (0.0, 0.0, 0.0)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
GOALS = (
    "At most 0.7 calls a sample to read, 0.5 to write, 0.05 to filter and 1 to save; as many arrays at "
    f"{FAST_HZ:g} Hz as at {SLOW_HZ:g} Hz, no counted reference, and columns of the covariance that grow together."
)

Work = Callable[[], Any]


def dive_of(duration_s: float) -> Dive:
    """Simulate a dive."""
    return simulate_dive("lawnmower", seed=1, duration_s=duration_s, imu_rate_hz=IMU_HZ)


def calls(work: Work) -> int:
    """Count the function calls of Python that some work takes, those into C included."""
    profile = cProfile.Profile()
    profile.runcall(work)
    return int(pstats.Stats(profile).total_calls)  # type: ignore[attr-defined]


def calls_a_sample(work: Callable[[Dive], Work]) -> float:
    """Return the calls that each further sample costs; what is done once for every dive does not count."""
    short = work(dive_of(SHORT_S))
    long = work(dive_of(LONG_S))
    short()  # imports, and what is cached
    return (calls(long) - calls(short)) / ((LONG_S - SHORT_S) * IMU_HZ)


def calls_by_step(folder: Path) -> Iterator[tuple[str, float]]:
    """Count the calls a sample of each step that has to go through all samples."""

    def reading(dive: Dive) -> Work:
        path = folder / f"{len(dive.imu.time_ns)}.mcap"
        write_dive(path, dive)
        return lambda: read_dive(path, Config())

    yield "read a log", calls_a_sample(reading)
    yield (
        "write a log",
        calls_a_sample(lambda dive: lambda: write_dive(folder / "dive.mcap", dive)),
    )
    yield "filter", calls_a_sample(lambda dive: lambda: replay_dive(dive, Config()))
    yield (
        "filter and save",
        calls_a_sample(lambda dive: lambda: save_replay(replay_dive(dive, Config()), folder)),
    )


def inputs_at(imu_rate_hz: float) -> Inputs:
    """Prepare the baseline for readings at some rate."""
    return baseline_inputs(
        simulate_dive("straight", seed=1, duration_s=FILTER_S, imu_rate_hz=imu_rate_hz), Config()
    )


def arrays_made(inputs: Inputs) -> int:
    """Count the arrays that the compiled filter makes on its way."""
    timeline, start, noise_density, velocity = inputs
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats().alloc
        run_filter("baseline", timeline, start, noise_density, (velocity,), np.zeros(3))
        return int(rtsys.get_allocation_stats().alloc) - before
    finally:
        _nrt_python.memsys_disable_stats()


def machine_code(function: Any, *arguments: Any) -> str:
    """Compile a function anew, since what comes from the disk does not show itself, and return its LLVM code."""
    compiled = numba.njit(error_model="numpy", nogil=True)(function)
    compiled(*arguments)
    return str(compiled.inspect_llvm(compiled.signatures[0]))


def references_counted() -> int:
    """Count the places where mechanisation and covariance count a reference."""

    def go(
        timeline: Timeline, state: NavState, P: Floats, noise_density: Floats, place: LocalEarth
    ) -> NavState:
        before = first_node(timeline)
        while not is_last(timeline, before):
            now = next_node(timeline, before)
            dt = now.time_s - before.time_s
            state, motion = propagate(state, before.readings, now.readings, dt, place, 9.8)
            propagate_cov(P, motion, noise_density, dt)
            before = now
        return state

    inputs = inputs_at(SLOW_HZ)
    state = NavState(STILL, STILL, LEVEL, STILL, STILL)
    code = machine_code(
        go,
        inputs.timeline,
        state,
        np.eye(12).ravel(),
        inputs.noise_density,
        local_earth_at(0.0, 0.0),
    )
    return code.count("call void @NRT_incref")


def vector_products() -> int:
    """Count the places where several columns of the covariance are multiplied at once."""
    motion = Motion(STILL, STILL, STILL, LEVEL, STILL)
    return machine_code(propagate_cov, np.eye(12).ravel(), motion, np.ones(12), 0.01).count(
        "fmul <"
    )


def report() -> str:
    """Count, and make a part of the page of it."""
    with tempfile.TemporaryDirectory() as name:
        rows = [
            f"| calls of Python a sample: {step} | {count:.3f} |"
            for step, count in calls_by_step(Path(name))
        ]
    for rate_hz in (SLOW_HZ, FAST_HZ):
        arrays_a_ping = arrays_made(inputs_at(rate_hz)) / (FILTER_S * PING_HZ)
        rows.append(
            f"| arrays a ping that the filter makes, IMU at {rate_hz:g} Hz | {arrays_a_ping:.1f} |"
        )
    rows.append(
        f"| places where mechanisation and covariance count a reference | {references_counted()} |"
    )
    rows.append(f"| places where columns of the covariance grow together | {vector_products()} |")
    about = f"Counted, not timed. Calls into C count, too. {GOALS} {machine()}, numba {numba.__version__}."
    return "\n".join(["# Work", "", about, "", *table(("what", "count"), rows)]) + "\n"


def main() -> None:
    """Count, print and write the part of the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    part = report()
    sys.stdout.write(part)
    write_part(part)


if __name__ == "__main__":
    main()
