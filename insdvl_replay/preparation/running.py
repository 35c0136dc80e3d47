"""The filters of a prepared dive, run: over the whole of it, from drawn starts, and without velocities for a while.

The compiled filter leaves the interpreter to others while it runs; on long dives each filter has a thread of its own.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, TimeNs
from insdvl_replay.core.history import History
from insdvl_replay.core.runtime import parallel_map, report_stage, return_freed_memory
from insdvl_replay.evaluation.errors import DrawnErrors, drawn_errors, run_from_start
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRun,
    OutageRuns,
    distance_along_m,
    outage_run,
    plan_outages,
)
from insdvl_replay.nav.dvl import parity_innovations
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import Start, drawn_starts, with_more_states
from insdvl_replay.nav.measurements import Measurement
from insdvl_replay.nav.outage import coast
from insdvl_replay.nav.timeline import FIRST_OTHER, NEVER, Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.own_measurements import Outage, in_outages
from insdvl_replay.preparation.prepared import Prepared

T = TypeVar("T")
_Group = tuple[Sequence[Outage], dict[str, Measurement], Timeline]
"""Outages, with the sensors and the time line of all of them."""

WORTH_A_THREAD = 20_000
"""IMU samples from which filters run beside each other; with fewer, to start threads takes what it saves."""
MOST_DRAWN_SAMPLES = 20_000_000
"""IMU samples, in all runs from drawn starts together: three seconds of work."""
MOST_DRAWN_TIMES = 5_000
"""Times of the reference at which the errors of each of these runs are kept."""


def run_filters(prepared: Prepared, timeline: Timeline, *, cov_ns: TimeNs | None = None) -> tuple[History, ...]:
    """Run every filter of a dive, in the order of the configuration; histories keep all of P at times, shape (c,)."""
    report_stage("running the filters")
    return_freed_memory()
    run = partial(run_one, prepared=prepared, timeline=timeline, cov_ns=cov_ns)
    return _side_by_side(timeline, run, prepared.filters)


def _side_by_side(timeline: Timeline, work: Callable[..., T], *of_filters: Sequence[Any]) -> tuple[T, ...]:
    """Do something for every filter, on a long dive for each in a thread of its own."""
    if len(timeline.sample_ns) < WORTH_A_THREAD:
        return tuple(map(work, *of_filters))
    with ThreadPoolExecutor() as threads:
        return tuple(threads.map(work, *of_filters))


def run_one(
    filter_: ResolvedFilter, prepared: Prepared, timeline: Timeline, *, cov_ns: TimeNs | None = None
) -> History:
    """Run one filter over the time line of a prepared dive; ``cov_ns`` as of `run_filters`."""
    history = run_filter(
        filter_.name,
        timeline,
        with_more_states(
            prepared.alignment.start, filter_.more_sd, filter_.constants, heading_bias="heading_bias" in filter_.states
        ),
        filter_.noise_density,
        filter_.measurements(prepared.velocities, prepared.mounting, prepared.gaps, prepared.sensors, prepared.beams),
        prepared.mounting.lever_arm_b,
        more_states=filter_.states,
        heading_bias_rate_hz=filter_.heading_bias_rate_hz,
        cov_ns=cov_ns,
    )
    if prepared.beams is None or "beams" not in filter_.aiding:
        return history
    parity = parity_innovations(prepared.beams, filter_.beam_sd_mps(prepared.velocities))
    return replace(history, innovations=(*history.innovations, *parity))


def prepared_timeline(dive: Dive, prepared: Prepared) -> Timeline:
    """Lay the readings, the pings and the reference's times of a prepared dive on one time line."""
    reference_ns = dive.reference.time_ns if dive.reference else np.empty(0, dtype=np.int64)
    return build_timeline(
        dive.imu,
        prepared.velocities.time_ns,
        reference_ns,
        prepared.alignment.start_ns,
        prepared.end_ns,
        prepared.gaps,
        [sensor.valid_ns for sensor in prepared.sensors.values()],
        NEVER if prepared.beams is None else prepared.beams.time_ns,
    )


def coasting_plan(prepared: Prepared) -> OutagePlan:
    """Lay the windows without velocities into a dive; `run_filters` has to keep all of P at its ``start_ns``."""
    return plan_outages(
        prepared.velocities.time_ns, prepared.gaps.overlap, prepared.alignment.start_ns, prepared.end_ns
    )


def coasting_of(
    dive: Dive,
    config: Config,
    prepared: Prepared,
    timeline: Timeline,
    histories: tuple[History, ...],
    plan: OutagePlan,
) -> OutageRuns:
    """Let every filter coast through the windows of a plan, from its history, which holds P at their starts.

    User code is given the dive without the pings of each window.
    """
    report_stage("coasting without velocities")
    groups = list[_Group]()
    for outages, sensors in in_outages(dive, config, prepared.sensors, tuple(plan.windows_ns)):
        is_whole = sensors is prepared.sensors
        lines = timeline if is_whole else prepared_timeline(dive, replace(prepared, sensors=sensors))
        groups.append((outages, sensors, lines))
    coasts = partial(_coasts_of_one, prepared=prepared, groups=groups, plan=plan)
    runs = _side_by_side(timeline, coasts, prepared.filters, histories)
    distance_m = distance_along_m(prepared.velocities.time_ns, prepared.velocities.velocity_b)
    return OutageRuns(
        plan, distance_m, {history.filter: of_one for history, of_one in zip(histories, runs, strict=True)}
    )


def _coasts_of_one(
    filter_: ResolvedFilter, history: History, *, prepared: Prepared, groups: Sequence[_Group], plan: OutagePlan
) -> tuple[OutageRun, ...]:
    by_velocity = replace(filter_, aiding=("velocity",), withheld=())
    measured, found = (prepared.velocities, prepared.mounting, prepared.gaps), dict[tuple[int, int], OutageRun]()
    (velocity,) = by_velocity.measurements(*measured)
    for outages, sensors, timeline in groups:
        aiding = filter_.measurements(*measured, sensors, prepared.beams)
        run_on = partial(
            coast, history, timeline, noise_density=filter_.noise_density,
            measurements=(velocity, *(one for one in aiding if one.sensor >= FIRST_OTHER)),
            lever_arm_b=prepared.mounting.lever_arm_b, more_states=filter_.states,
            heading_bias_rate_hz=filter_.heading_bias_rate_hz,
        )  # fmt: skip
        found |= {window: outage_run(run_on(window)) for window in outages}
    return tuple(found[window] for window in plan.windows_ns)


def run_from_drawn_starts(dive: Dive, prepared: Prepared, count: int, seed: int = 0) -> tuple[DrawnErrors, ...]:
    """Run every filter from the dive's own start and from others that err as P0 says, and keep their true errors.

    The ``count`` of starts includes the dive's own. All filters have the same draws, and other dives have others. The
    errors end where the runs together have `MOST_DRAWN_SAMPLES`, and are of evenly chosen times of a reference that has
    more than `MOST_DRAWN_TIMES`.
    """
    report_stage("running the filters from drawn starts")
    starts = drawn_starts(prepared.alignment.start, count, (*_sizes(dive, prepared), seed))
    dive, prepared = _first_part(dive, prepared, MOST_DRAWN_SAMPLES // (count * len(prepared.filters)))
    timeline = prepared_timeline(dive, prepared)
    run = partial(_run_from, dive=dive, prepared=prepared, timeline=timeline)
    runs = list(parallel_map(run, [(filter_, begun) for filter_ in prepared.filters for begun in starts]))
    return tuple(drawn_errors(runs[row : row + count]) for row in range(0, len(runs), count))


def _sizes(dive: Dive, prepared: Prepared) -> tuple[int, int, int]:
    """Return numbers by which dives differ, and which hang neither on their date nor on a processor."""
    return len(dive.imu.time_ns), len(prepared.velocities.time_ns), prepared.end_ns - prepared.alignment.start_ns


def _first_part(dive: Dive, prepared: Prepared, samples: int) -> tuple[Dive, Prepared]:
    """End a prepared dive after so many samples of the IMU, and thin its reference."""
    if dive.reference is None:
        raise ValueError(f"{dive.name}: errors need a reference")
    start_ns, time_ns = prepared.alignment.start_ns, dive.imu.time_ns
    last = min(int(np.searchsorted(time_ns, start_ns)) + samples, len(time_ns) - 1)
    end_ns = min(prepared.end_ns, int(time_ns[last]))
    inside = (dive.reference.time_ns >= start_ns) & (dive.reference.time_ns <= end_ns)
    chosen = np.flatnonzero(inside)[:: max(1, math.ceil(inside.sum() / MOST_DRAWN_TIMES))]
    reference = dive.reference.rows(np.isin(np.arange(len(inside)), chosen))
    first_part = replace(
        prepared,
        velocities=prepared.velocities.within(start_ns, end_ns),
        gaps=prepared.gaps.within(start_ns, end_ns),
        beams=None if prepared.beams is None else prepared.beams.within(start_ns, end_ns),
        sensors={name: sensor.until(end_ns) for name, sensor in prepared.sensors.items()},
        end_ns=end_ns,
    )
    return replace(dive, reference=reference), first_part


def _run_from(work: tuple[ResolvedFilter, Start], dive: Dive, prepared: Prepared, timeline: Timeline) -> DrawnErrors:
    filter_, start = work
    if dive.reference is None:
        raise ValueError(f"{dive.name}: errors need a reference")
    begun = replace(prepared, alignment=replace(prepared.alignment, start=start))
    return run_from_start(run_one(filter_, begun, timeline), dive.reference, dive.truth)
