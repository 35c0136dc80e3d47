"""The candidates of a prepared dive, run: over the whole of it, from random starts, and in windows without the DVL.

A candidate is anything that turns a dive and a start into a trajectory, a `History`: a built-in filter, a recorded
solution, which has one start and knows no other dive than its own, or a filter of the user's, run by `user_runs`. Parts
that a history lacks are not evaluated: a covariance, innovations, runs from other starts, windows without the DVL. The
compiled filter leaves the interpreter to other threads while it runs; on long dives each filter has its own thread.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final, TypeVar

import numpy as np
from msgspec.structs import replace as changed

from insdvl_replay.core.config import Config, Initial
from insdvl_replay.core.dive_columns import (
    Dive,
    Floats,
    Integers,
    ReferenceColumns,
    TimeNs,
    nanoseconds,
)
from insdvl_replay.core.errors import ConfigError, LogError, Note, error_context
from insdvl_replay.core.held_out import NOTHING
from insdvl_replay.core.history import History
from insdvl_replay.core.misfit import MISREAD, MOST_NIS, MisfitError
from insdvl_replay.core.notes import note
from insdvl_replay.core.runtime import parallel_map, report_stage, return_freed_memory
from insdvl_replay.core.states import DEG, DEG_PER_HOUR
from insdvl_replay.evaluation.consistency import MANY_REJECTED
from insdvl_replay.evaluation.drift import HeadingFit, heading_fit
from insdvl_replay.evaluation.evaluate import evaluated_times, with_solutions
from insdvl_replay.evaluation.outage_test import (
    OutagePlan,
    OutageRun,
    OutageRuns,
    distance_along_m,
    outage_run,
    plan_outages,
)
from insdvl_replay.evaluation.reference_errors import DrawnErrors, drawn_errors, run_from_start
from insdvl_replay.geometry.frames import north_east_m
from insdvl_replay.nav.dvl import parity_innovations
from insdvl_replay.nav.filter import run_filter
from insdvl_replay.nav.levelling import Start, drawn_starts, with_more_states
from insdvl_replay.nav.outage import gravity_drift, run_outage
from insdvl_replay.nav.timeline import FIRST_OTHER, NEVER, Gaps, Timeline, build_timeline
from insdvl_replay.preparation.filters import ResolvedFilter
from insdvl_replay.preparation.heading_draw import HeadingDraw, heading_draw
from insdvl_replay.preparation.plugins import Outage, in_outages
from insdvl_replay.preparation.prepared import Prepared, prepare_dive, with_reference_at_imu
from insdvl_replay.preparation.solutions import recorded_history

T = TypeVar("T")

# IMU samples from which filters run in threads; with fewer, threads cost what they save
WORTH_A_THREAD = 20_000
# IMU samples, in all runs from random starts together: three seconds of work
MOST_DRAWN_SAMPLES = 20_000_000
# times of the reference at which the errors of each of these runs are kept
MOST_DRAWN_TIMES = 5_000


@dataclass(frozen=True)
class RunPlan:
    """How the candidates of a dive are run."""

    evaluated_ns: TimeNs  # (c,) times of the reference at which errors are judged by P
    windows: OutagePlan  # without the DVL
    starts: int  # from which each candidate runs, the dive's own among them; 0 without a reference
    seed: int
    # a second start of those that depend on the heading of the first
    heading: HeadingDraw | None = None


@dataclass(frozen=True)
class Runs:
    """What the candidates of a dive gave, the baseline first."""

    histories: tuple[History, ...]
    drawn: tuple[DrawnErrors, ...]  # from random starts; empty without a reference
    outages: OutageRuns  # in windows without the DVL, of those that can be run there
    # of the filters, from the dive's own start as uncertain as [initial]
    spread: tuple[History, ...]
    # of recorded solutions, by name: positions and velocities of each sample
    motions: dict[str, ReferenceColumns]
    notes: tuple[Note, ...]
    # of filters of the user's, with the baseline
    user_outages: Mapping[str, OutageRuns] = field(default_factory=dict)
    printed: Mapping[str, str] = field(default_factory=dict)  # by filters of the user's
    # processor seconds of one run over the dive, by filter
    cpu_s: Mapping[str, float] = field(default_factory=dict)
    # by filter of the user's whose answers differ: why
    not_repeatable: Mapping[str, str] = field(default_factory=dict)
    # from the plan's second start: baseline, then candidates that depend on it
    turned: tuple[History, ...] = ()


def plan_runs(
    dive: Dive,
    prepared: Prepared,
    config: Config,
    *,
    starts: int | None = None,
) -> RunPlan:
    """Choose the times at which errors are judged, the windows without the DVL, and the number of starts."""
    start_ns = prepared.alignment.start_ns
    end_ns = prepared.end_ns
    if starts is None:
        starts = config.evaluation.starts
    if dive.reference is None:
        starts = 0
    filters = len(config.filters) - len(config.user_candidates)
    seed = config.evaluation.seed
    return RunPlan(
        evaluated_ns=evaluated_times(dive.reference, start_ns, end_ns, filters=filters),
        windows=plan_outages(prepared.velocities.time_ns, prepared.gaps.overlap, start_ns, end_ns),
        starts=starts,
        seed=seed,
        heading=heading_draw(dive, prepared, config, seed),
    )


def run_candidates(
    dive: Dive,
    prepared: Prepared,
    plan: RunPlan,
    config: Config,
) -> Runs:
    """Run every candidate over the dive, then the filters through windows without the DVL and from random starts.

    A history holds all of P where errors are judged by it, and where a window begins.
    """
    report_stage("running the filters")
    return_freed_memory()
    timeline = prepared_timeline(dive, prepared)
    cov_ns = np.union1d(plan.evaluated_ns, plan.windows.start_ns)
    timed = _side_by_side(
        timeline,
        lambda filter_: _timed(lambda: run_one(filter_, prepared, timeline, cov_ns=cov_ns)),
        prepared.filters,
    )
    histories = tuple(history for history, _ in timed)
    cpu_s = {history.filter: seconds for history, seconds in timed}
    spread = histories
    if prepared.alignment.spread_cov is not None:
        start = prepared.alignment.spread_start
        spread = _side_by_side(
            timeline,
            lambda filter_: run_one(filter_, prepared, timeline, start=start),
            prepared.filters,
        )
    outages = run_outages(dive, prepared, timeline, config, histories, plan.windows)
    turned = _from_drawn_heading(prepared, timeline, plan.heading)
    motions = dict[str, ReferenceColumns]()
    notes = list[Note]()
    for name, settings in config.solutions.items():
        found, motions[name], its_notes = recorded_history(
            name, dive.solutions[name], settings, dive.imu, histories[0], plan.evaluated_ns
        )
        histories = (*histories, found)
        notes = [*notes, *its_notes]
        if turned and not found.is_turned:
            turned = (*turned, _compared_alone(found))
    drawn: tuple[DrawnErrors, ...] = ()
    if plan.starts:
        drawn = with_solutions(
            run_from_drawn_starts(dive, prepared, plan.starts, plan.seed), histories, dive
        )
    return Runs(
        histories, drawn, outages, spread, motions, tuple(notes), cpu_s=cpu_s, turned=turned
    )


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    """Do some work; return its result and the processor seconds of this thread."""
    begun_s = time.thread_time()
    found = work()
    return found, time.thread_time() - begun_s


def _from_drawn_heading(
    prepared: Prepared, timeline: Timeline, draw: HeadingDraw | None
) -> tuple[History, ...]:
    """Run baseline and candidates from the second start, of which only the track counts."""
    if draw is None:
        return ()
    filters = [filter_ for filter_ in prepared.filters if filter_.name in draw.filters]
    return _side_by_side(
        timeline,
        lambda filter_: _compared_alone(run_one(filter_, prepared, timeline, start=draw.start)),
        filters,
    )


def _compared_alone(history: History) -> History:
    """Let go of the innovations that a comparison of tracks does not need."""
    return replace(
        history, innovations=tuple(met for met in history.innovations if met.is_held_out)
    )


def _side_by_side(
    timeline: Timeline, work: Callable[..., T], *arguments: Sequence[Any]
) -> tuple[T, ...]:
    """Do something for every filter, on a long dive for each in a thread of its own."""
    if len(timeline.sample_ns) < WORTH_A_THREAD:
        return tuple(map(work, *arguments))
    with ThreadPoolExecutor() as threads:
        return tuple(threads.map(work, *arguments))


def run_one(
    filter_: ResolvedFilter,
    prepared: Prepared,
    timeline: Timeline,
    *,
    start: Start | None = None,  # if not that of the dive
    cov_ns: TimeNs | None = None,
) -> History:
    """Run one filter over the time line of a prepared dive."""
    start = start or prepared.alignment.start
    has_heading_bias = "heading_bias" in filter_.states
    history = run_filter(
        filter_.name,
        timeline,
        with_more_states(start, filter_.more_sd, filter_.constants, heading_bias=has_heading_bias),
        measurements=filter_.measurements(
            prepared.velocities, prepared.mounting, prepared.gaps, prepared.sensors, prepared.beams
        ),
        cov_ns=cov_ns,
        **_filter_settings(filter_, prepared),
    )
    if prepared.beams is None or "beams" not in filter_.aiding:
        return history
    parity = parity_innovations(prepared.beams, filter_.beam_sd_mps(prepared.velocities))
    return replace(history, innovations=(*history.innovations, *parity))


def _filter_settings(filter_: ResolvedFilter, prepared: Prepared) -> dict[str, Any]:
    return {
        "noise_density": filter_.noise_density,
        "lever_arm_b": prepared.mounting.lever_arm_b,
        "more_states": filter_.states,
        "heading_bias_rate_hz": filter_.heading_bias_rate_hz,
        "noise_factors": prepared.noise.get(filter_.noise_factors or ""),
    }


def prepared_timeline(dive: Dive, prepared: Prepared, more_ns: TimeNs = NEVER) -> Timeline:
    """Merge the readings, the pings, the reference's times and some more of a prepared dive into one time line."""
    recorded_ns = more_ns
    if dive.reference is not None:
        recorded_ns = np.concatenate([dive.reference.time_ns, more_ns])
    beams_ns = NEVER
    if prepared.beams is not None:
        beams_ns = prepared.beams.time_ns
    return build_timeline(
        dive.imu,
        prepared.velocities.time_ns,
        recorded_ns,
        prepared.alignment.start_ns,
        prepared.end_ns,
        prepared.gaps,
        [sensor.valid_ns for sensor in prepared.sensors.values()],
        beams_ns,
    )


def run_outages(
    dive: Dive,
    prepared: Prepared,
    timeline: Timeline,
    config: Config,
    histories: tuple[History, ...],
    plan: OutagePlan,
) -> OutageRuns:
    """Run every filter through the windows of a plan, from its history, which holds P at their starts.

    User code is given the dive without the pings of each window.
    """
    report_stage("DVL outage test")
    groups = list[tuple[Sequence[Outage], Prepared, Timeline]]()
    windows_ns = tuple(plan.windows_ns)
    for windows, sensors, noise in in_outages(
        dive, config, prepared.sensors, prepared.noise, windows_ns
    ):
        part = replace(prepared, sensors=sensors, noise=noise)
        line = timeline
        if sensors is not prepared.sensors:
            line = prepared_timeline(dive, part)
        groups.append((windows, part, line))
    measured = prepared.velocities, prepared.mounting, prepared.gaps

    def outages(filter_: ResolvedFilter, history: History) -> tuple[OutageRun, ...]:
        found = dict[tuple[int, int], OutageRun]()
        drift = gravity_drift(history)
        (velocity,) = replace(filter_, aiding=("velocity",), held_out=NOTHING).measurements(
            *measured
        )
        for windows, part, line in groups:
            aiding = filter_.measurements(*measured, part.sensors, prepared.beams)
            others = (measurement for measurement in aiding if measurement.sensor >= FIRST_OTHER)
            kept = (velocity, *others)
            settings = _filter_settings(filter_, part)
            for window in windows:
                found[window] = outage_run(
                    run_outage(history, drift, line, window, kept, **settings)
                )
        return tuple(found[window] for window in windows_ns)

    runs = _side_by_side(timeline, outages, prepared.filters, histories)
    names = [filter_.name for filter_ in prepared.filters]
    distance_m = distance_along_m(prepared.velocities.time_ns, prepared.velocities.velocity_b)
    return OutageRuns(plan, distance_m, dict(zip(names, runs, strict=True)))


# --- Random starts.


def run_from_drawn_starts(
    dive: Dive,
    prepared: Prepared,
    count: int,
    seed: int = 0,
) -> tuple[DrawnErrors, ...]:
    """Run every filter from the dive's own start and from others that err as P0 says, and keep their true errors.

    The ``count`` of starts includes the dive's own. All filters have the same draws, and other dives have others. The
    errors end where the runs together have `MOST_DRAWN_SAMPLES`, and are of evenly chosen times of a reference that has
    more than `MOST_DRAWN_TIMES`.
    """
    report_stage("running the filters from random starts")
    starts, part, prepared = drawn_part(dive, prepared, count, seed)
    reference = part.reference
    timeline = prepared_timeline(part, prepared)
    assert reference is not None

    def run(work: tuple[ResolvedFilter, Start]) -> DrawnErrors:
        filter_, start = work
        history = run_one(filter_, prepared, timeline, start=start)
        return run_from_start(history, reference, dive.truth)

    works = list(product(prepared.filters, starts))
    runs_of: dict[str, list[DrawnErrors]] = {filter_.name: [] for filter_ in prepared.filters}
    for errors in parallel_map(run, works):
        runs_of[errors.filter].append(errors)
    own_sd = prepared.alignment.spread_cov is None
    return tuple(drawn_errors(runs, own_sd=own_sd) for runs in runs_of.values())


def drawn_part(
    dive: Dive,
    prepared: Prepared,
    count: int,
    seed: int,
) -> tuple[tuple[Start, ...], Dive, Prepared]:
    """Draw starts; return them with the part of the dive, and the times of its reference, over which they are run."""
    if dive.reference is None:
        raise ValueError(f"{dive.name}: errors need a reference")
    # Dives differ by these numbers, and they depend neither on a date nor on a processor.
    start_ns = prepared.alignment.start_ns
    time_ns = dive.imu.time_ns
    sizes = len(time_ns), len(prepared.velocities.time_ns), prepared.end_ns - start_ns
    alignment = prepared.alignment
    starts = (alignment.start, *drawn_starts(alignment.spread_start, count, (*sizes, seed))[1:])
    # The first part of the dive, and some times of its reference.
    last = int(np.searchsorted(time_ns, start_ns)) + MOST_DRAWN_SAMPLES // (
        count * len(prepared.filters)
    )
    end_ns = min(prepared.end_ns, int(time_ns[min(last, len(time_ns) - 1)]))
    inside = np.flatnonzero(
        (dive.reference.time_ns >= start_ns) & (dive.reference.time_ns <= end_ns)
    )
    chosen = inside[:: max(1, math.ceil(len(inside) / MOST_DRAWN_TIMES))]
    reference = dive.reference.rows(np.isin(np.arange(len(dive.reference.time_ns)), chosen))
    return starts, replace(dive, reference=reference), replace(prepared, end_ns=end_ns)


# --- The heading at the start, where only the positions of a reference tell it (``initial.heading_deg = "fit"``).

FIT: Final = "fit"
MOST_ROUNDS: Final = 6
SETTLED_DEG: Final = 0.02
HEADING_STEP_DEG: Final = 1.0
LONGEST_SILENCE_S: Final = 5.0  # of the DVL, in which the track goes on as well as before
SHORTEST_TRACK_S: Final = 30.0  # before a gap of the IMU, that is compared by itself
BIAS_STEP: Final = 0.2  # in the bias's standard deviation beforehand
# a filter that may move its biases takes errors of beams and accelerometers for a turn
HELD_BIAS_DEGPH: Final = 1.0
LEAST_SURE_DEG: Final = 15.0  # a heading that a track gives no better says nothing
# decimals; neither is known so well
HEADING_DIGITS = 2
BIAS_DIGITS = 1


@dataclass(frozen=True)
class FittedStart:
    """A start that was fitted to the track of a reference; the bias is the gyro's about down."""

    heading_deg: float
    heading_sd_deg: float
    gyro_bias_degph: float
    gyro_bias_sd_degph: float


def prepare_with_heading(dive: Dive, config: Config) -> Prepared:
    """Do all that comes before the filters of a dive from `with_reference_at_imu`, and fit the heading where asked for.

    An attitude of the reference to start from goes before a fit.
    """
    initial = config.initial
    reference = dive.reference
    starts_posed = (
        initial.source == "reference" and reference is not None and reference.has_attitude
    )
    if initial.heading_deg != FIT or starts_posed:
        return prepare_dive(dive, config)
    fitted = fitted_start(dive, config)
    # Random starts have the standard deviation of the track's fit, or that of the configuration if it is larger.
    north, east, down = initial.misalignment_sd_deg
    sds = (north, east, max(down, round(fitted.heading_sd_deg, HEADING_DIGITS)))
    started = _started(
        initial, fitted.heading_deg, fitted.gyro_bias_degph, misalignment_sd_deg=sds
    )
    settings = changed(config, initial=started)
    prepared = prepare_dive(dive, settings, fitted_heading_sd=fitted.heading_sd_deg * DEG)
    return replace(prepared, notes=(*prepared.notes, note("start_heading_fitted", fitted=fitted)))


def fitted_start(dive: Dive, config: Config) -> FittedStart:
    """Find the heading at the start, and the gyro's bias about down, that bring the baseline's track to the reference.

    The baseline is run, its track aligned with the reference's, and run again from what was found. Started far off, a
    good IMU measures that the Earth turns otherwise, and the filter bends the track: so this takes some rounds. The
    baseline is as sure of its heading as configured, and surer of its gyros, for a filter that is unsure turns by
    itself. ConfigError where the reference has no positions, LogError where its track is too short.
    """
    by_hand = "to set it: --set initial.heading_deg=... (from north over east)"
    reference = dive.reference
    initial = config.initial
    if reference is None or not reference.has_position:
        with error_context(dive.name):
            raise ConfigError(
                'initial.heading_deg = "fit" needs positions of a reference, but there are none',
                f"set reference.topic or reference.fix; {by_hand}",
            )
    config = changed(config, filters={config.baseline: config.filters[config.baseline]})
    placed = reference.rows(reference.known["positions"])
    heading_deg = 0.0
    bias_degph = initial.gyro_bias_degph[2]
    found = HeadingFit(np.inf, np.inf, 0.0, np.inf)
    for _ in range(MOST_ROUNDS):
        fit = _fit_from(dive, config, placed, heading_deg, bias_degph)
        if fit is None or not fit.heading_sd < LEAST_SURE_DEG * DEG:
            raise LogError(
                f"{dive.name}: the start heading cannot be determined from the reference's track",
                f"it needs some tens of metres in a minute, and gyros that drift little in this time; {by_hand}",
            )
        found = fit
        heading_deg = round((heading_deg + found.heading / DEG) % 360.0, HEADING_DIGITS)
        bias_degph = round(bias_degph + found.bias / DEG_PER_HOUR, BIAS_DIGITS)
        if abs(found.heading) < SETTLED_DEG * DEG:
            break
    # A bias that walks is, over the dive, another than at the start.
    time_s = np.ptp(placed.time_ns) * 1e-9
    bias_sd = np.hypot(
        found.bias_sd, config.noise.gyro_bias_walk_radps_rts * np.sqrt(time_s / 3.0)
    )
    return FittedStart(
        heading_deg=heading_deg,
        heading_sd_deg=found.heading_sd / DEG,
        gyro_bias_degph=bias_degph,
        gyro_bias_sd_degph=float(bias_sd) / DEG_PER_HOUR,
    )


def _fit_from(
    dive: Dive,
    config: Config,  # with the baseline alone
    placed: ReferenceColumns,  # the rows that have a position
    heading_deg: float,
    bias_degph: float,  # of the gyro about down
) -> HeadingFit | None:
    """Align the baseline's track from a start with the reference's; None where it is too short.

    The baseline runs from two starts next to it as well: the filter itself estimates a part of heading and bias, and
    turns.
    """
    initial = config.initial
    prior_degph = initial.gyro_bias_degph[2]
    prior_sd_degph = initial.gyro_bias_sd_degph
    bias_step_degph = BIAS_STEP * prior_sd_degph

    def run_from(heading_deg: float, bias_degph: float) -> tuple[Prepared, History]:
        started = _started(initial, heading_deg, bias_degph, gyro_bias_sd_degph=HELD_BIAS_DEGPH)
        prepared = prepare_dive(dive, changed(config, initial=started))
        line = prepared_timeline(dive, prepared)
        return prepared, run_one(prepared.filters[0], prepared, line)

    prepared, history = run_from(heading_deg, bias_degph)
    _, turned = run_from(heading_deg + HEADING_STEP_DEG, bias_degph)
    _, biased = run_from(heading_deg, bias_degph + bias_step_degph)
    seen_ns = _before_a_gap(placed.time_ns, prepared.gaps)
    compared_ns, piece = _tracked(seen_ns, prepared.velocities.time_ns)
    time_ns, ours, compared = np.intersect1d(history.time_ns, compared_ns, return_indices=True)
    reference_rows = np.searchsorted(placed.time_ns, time_ns)
    origin = placed.position[reference_rows[:1]]
    reference_m = _north_east(placed.position[reference_rows], origin)
    track_m = _north_east(history.position[ours], origin)
    turned_m = _north_east(turned.position[ours], origin)
    biased_m = _north_east(biased.position[ours], origin)
    return heading_fit(
        time_ns,
        estimated_m=track_m,
        per_heading_m=(turned_m - track_m) / (HEADING_STEP_DEG * DEG),
        per_bias_m=(biased_m - track_m) / (bias_step_degph * DEG_PER_HOUR),
        reference_m=reference_m,
        known_bias=((bias_degph - prior_degph) * DEG_PER_HOUR, prior_sd_degph * DEG_PER_HOUR),
        piece=piece[compared],
    )


def _north_east(position: Floats, origin: Floats) -> Floats:
    """Return positions as metres north and east of an origin, shape (k, 2)."""
    return np.stack(north_east_m(position, origin, origin), axis=1)


def _before_a_gap(time_ns: TimeNs, gaps: Gaps) -> TimeNs:
    """Return the times before the first long gap of the IMU, in which nobody saw how the vehicle turned.

    Where they are too few to show a heading, the whole dive is compared: the filter guesses the turn.
    """
    if not len(gaps.start_ns):
        return time_ns
    before_ns: TimeNs = time_ns[time_ns <= gaps.start_ns[0]]
    if len(before_ns) > 1 and before_ns[-1] - before_ns[0] >= nanoseconds(SHORTEST_TRACK_S):
        return before_ns
    return time_ns


def _tracked(time_ns: TimeNs, ping_ns: TimeNs) -> tuple[TimeNs, Integers]:
    """Return the times that are not in a long pause of the DVL, and in which piece of the track between pauses each is.

    Without DVL a track drifts by more in half a minute than a wrong heading moves it.
    """
    begins = np.flatnonzero(np.diff(ping_ns) > nanoseconds(LONGEST_SILENCE_S))
    ended = np.searchsorted(ping_ns[begins + 1], time_ns, "right")
    begun = np.searchsorted(ping_ns[begins], time_ns, "left")
    heard = begun == ended
    if len(ping_ns):
        aside_ns = nanoseconds(LONGEST_SILENCE_S)
        heard &= (time_ns >= ping_ns[0] - aside_ns) & (time_ns <= ping_ns[-1] + aside_ns)
    return time_ns[heard], ended[heard]


def _started(initial: Initial, heading_deg: float, bias_degph: float, **others: Any) -> Initial:
    bias = (*initial.gyro_bias_degph[:2], bias_degph)
    return changed(initial, heading_deg=heading_deg, gyro_bias_degph=bias, **others)


# --- Whether the settings fit a dive.


def require_described(dive: Dive) -> None:
    """Raise a MisfitError if axes or units are wrong, or if nobody has described the vehicle: simulated dives are."""
    for found in dive.notes:
        if found.code in MISREAD:
            raise MisfitError(f"{dive.name}: {found.text}", found.hint)
    if dive.truth is None:
        raise MisfitError(
            f"{dive.name}: nobody has described its sensors", "give their settings with -c"
        )


def require_fit_of(dive: Dive, config: Config) -> None:
    """Raise a MisfitError if the settings do not fit."""
    require_described(dive)
    size, rejected = baseline_fit(dive, config)
    if size > MOST_NIS or rejected > MANY_REJECTED:
        text = f"NIS/dof of the baseline is {size:.2g}, and it rejects {rejected:.0%} of the velocities"
        raise MisfitError(
            f"{dive.name}: {text}", "insdvl-replay calibrate fits geometry and noise"
        )


def baseline_fit(dive: Dive, config: Config) -> tuple[float, float]:
    """Return NIS over degrees of freedom of the baseline's velocities, and the share that it rejects."""
    dive = with_reference_at_imu(dive, config)
    alone = changed(config, filters={config.baseline: config.filters[config.baseline]})
    prepared = prepare_with_heading(dive, alone)
    innovations = run_one(
        prepared.filters[0], prepared, prepared_timeline(dive, prepared)
    ).innovations[0]
    sizes = innovations.nis * innovations.weight / innovations.dof
    return float(np.mean(sizes)), float(np.mean(~innovations.used))
