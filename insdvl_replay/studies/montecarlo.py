"""The Monte Carlo study: compare the filters' uncertainty with their errors over many simulated dives."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import msgspec
import numpy as np
import pandas as pd

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive, Floats
from insdvl_replay.core.runtime import parallel_map, track_progress
from insdvl_replay.core.states import BA, BG, DV, NINE, PHI, STATES, State
from insdvl_replay.core.words import Consistency
from insdvl_replay.document.parts import (
    LIMIT,
    REFERENCE,
    Curve,
    DisplayTable,
    Figure,
    Panel,
    Result,
    filter_style,
)
from insdvl_replay.document.tables import table_of
from insdvl_replay.evaluation.ensemble import (
    Ensemble,
    RunErrors,
    Tally,
    ensemble_table,
    montecarlo_table,
    nees_table,
    outage_table,
    run_errors,
    run_table,
    runs_table,
    verdict_table,
)
from insdvl_replay.evaluation.sentences import why_in_spite
from insdvl_replay.nav.algebra import rotation_from_vector, vector
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.timeline import NO_GAPS
from insdvl_replay.preparation.alignment import Alignment
from insdvl_replay.preparation.filters import dvl_mounting, prepare_sensors, resolve_filters
from insdvl_replay.preparation.prepared import Prepared
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.preparation.start_sources import initial_sd
from insdvl_replay.sim.dive import add_errors, exact_dive, named
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors, ImuErrors

MATCHED: Final = "matched"
"""The grade of IMU and DVL whose errors are exactly as the first filter assumes."""
PICTURES: Final = {"navigation": STATES[:6], "biases": STATES[6:]}
"""The states in the two pictures of a filter."""
SIGMA: Final = f"{filter_style(0)} {filter_style(1)}"
"""The dashes of the first filter in the blue of the second, as in the paper."""
SETTLED: Final = 0.02
"""Share of the dive after which the panel's limits hold everything; before, sigma may be fifty times as high."""
FAR_ABOVE: Final = 10.0
"""Ratio of NEES to the interval from which the scale is logarithmic, so that all curves are visible."""
Outages = Sequence[tuple[float, float]]
"""Spans (start_s, end_s) without bottom track."""


# --- One run: draw errors of sensors and start, and compute the errors of each filter.


@dataclass(frozen=True)
class MonteCarloSetup:
    """The common part of all runs of a study."""

    exact: Dive  # perfect sensors; reference and truth have a row at the start and at each ping
    imu_errors: ImuErrors  # size of the errors of each run
    dvl_errors: DvlErrors
    # filters and uncertainty of the start; biases, scale, span and log are not used
    config: Config


def make_setup(
    scenario: str,
    config: Config,
    imu: str,
    duration_s: float | None = None,
    outages: Outages = (),
) -> MonteCarloSetup:
    """Simulate the exact dive and choose the errors of its sensors."""
    grades = {name: (errors, DvlErrors()) for name, errors in GRADES.items()}
    imu_errors, dvl_errors = named("IMU grade", imu, {MATCHED: matched_errors(config), **grades})
    exact = exact_dive(
        scenario,
        duration_s=duration_s,
        reference_at_pings=True,
        outages=outages,
        lever_arm_m=config.dvl.lever_arm_m,
        mounting_rpy_deg=config.dvl.mounting_rpy_deg,
    )
    return MonteCarloSetup(exact, imu_errors, dvl_errors, config)


def matched_errors(config: Config) -> tuple[ImuErrors, DvlErrors]:
    """Return sensor errors by the first filter's Q, R and initial uncertainty."""
    baseline = resolve_filters(config)[0]
    sd = initial_sd(config.initial)
    imu_errors = ImuErrors(
        accel_bias_sd_mps2=sd[BA][0],
        gyro_bias_sd_radps=sd[BG][0],
        **msgspec.structs.asdict(baseline.inertial_noise),
    )
    noise = baseline.dvl_noise
    return imu_errors, replace(DvlErrors(0.0, 0.0, 0.0, 0.0), **{noise.key: noise.sd_mps})


def run_seed(seed: int, run: int) -> int:
    """Return the seed of one run, to repeat it without the others."""
    return int(np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(1)[0])


def simulated_run(setup: MonteCarloSetup, seed: int) -> tuple[RunErrors, ...]:
    """Draw the errors of one run and replay it through every filter."""
    config = setup.config
    dive = add_errors(setup.exact, setup.imu_errors, setup.dvl_errors, seed)
    if dive.reference is None or dive.truth is None:
        raise ValueError("a simulated dive holds its truth")
    start_ns = int(dive.imu.time_ns[0])
    end_ns = int(dive.imu.time_ns[-1])
    mounting = replace(dvl_mounting(config), scale=1.0)
    velocities = dvl_velocities(dive.dvl, mounting, config.dvl.max_beam_residual_mps or np.inf)
    filters = resolve_filters(config)
    alignment = Alignment(start_ns, drawn_start(setup, seed), ())
    sensors, _ = prepare_sensors(dive.sensors, config, alignment.start, start_ns, end_ns)
    start = Prepared(velocities, alignment, end_ns, NO_GAPS, mounting, filters, None, sensors, ())
    timeline = prepared_timeline(dive, start)
    histories = (
        run_one(filter_, start, timeline, cov_ns=dive.reference.time_ns) for filter_ in filters
    )
    return tuple(run_errors(history, dive.reference, dive.truth) for history in histories)


def drawn_start(setup: MonteCarloSetup, seed: int) -> Start:
    """Return the start of the exact dive with a random error from the configured initial uncertainty.

    Biases start at zero: the true ones are drawn with the sensor errors.
    """
    if setup.exact.reference is None:
        raise ValueError("the filters start from the exact motion")
    # The sensors of `add_errors` draw from the seed's streams 0 to 2.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    exact = setup.exact.reference
    sd = initial_sd(setup.config.initial)
    turn = np.array(rotation_from_vector(vector(sd[PHI] * rng.standard_normal(3))))
    velocity_n = exact.velocity_n[0] + sd[DV] * rng.standard_normal(3)
    return Start(exact.position[0], velocity_n, turn @ exact.mat_nb[0], np.diag(sd**2))


# --- The study.


def study_montecarlo(
    scenario: str,
    config: Config,
    *,
    runs: int = 100,
    seed: int = 1,
    duration_s: float | None = None,
    imu: str = MATCHED,
    outages: Outages = (),
    jobs: int | None = None,
) -> tuple[Result, tuple[Ensemble, ...]]:
    """Simulate a dive many times and compare the filters' uncertainty with their true errors.

    ``imu`` is `MATCHED` or a name in `sensor_errors.GRADES`. The result does not depend on ``jobs``. Also returned are
    the ensembles, one for each filter, the baseline first. A ConfigError where a name is unknown or a duration wrong.
    """
    setup = make_setup(scenario, config, imu, duration_s, outages)
    seeds = [run_seed(seed, run) for run in range(1, runs + 1)]
    tallies: dict[str, Tally] = {}
    with closing(parallel_map(partial(simulated_run, setup), seeds, jobs)) as simulated:
        for _, errors in zip(track_progress("run", seeds), simulated, strict=True):
            for run in errors:
                tallies.setdefault(run.filter, Tally(run)).add(run)
    ensembles = tuple(tally.ensemble() for tally in tallies.values())
    tables = {"montecarlo": montecarlo_table(ensembles), "verdicts": verdict_table(ensembles)}
    if outages:
        tables["outages"] = outage_table(ensembles, outages)
    nees = nees_table(ensembles)
    asked, length, drawn = _asked(setup, imu, seed, outages)
    title = f"Monte Carlo study: {scenario}, {length}, {runs} runs, {drawn}"
    figures = {"nees": nees_figure(title, nees)}
    for ensemble in ensembles:
        of_filter = f"{ensemble.filter}: {title}"
        for name, states in PICTURES.items():
            figures[f"{ensemble.filter}_{name}"] = ensemble_figure(
                of_filter,
                states,
                ensemble.time_s,
                ensemble.sd,
                ensemble.error_sd,
                ensemble.error_mean,
            )
    result = Result(
        kind="montecarlo",
        title=title,
        sentences=tuple(_sentences(tables)),
        tables=tables,
        figures=figures,
        config=config,
        arguments=asked | {"runs": runs},
        series={
            "nees": nees,
            "ensemble": ensemble_table(ensembles),
            "runs": runs_table(seeds, list(tallies.values())),
        },
        display=tuple(_display(tables)),
    )
    return result, ensembles


def repeat_run(
    scenario: str,
    config: Config,
    run: int,
    *,
    seed: int = 1,
    duration_s: float | None = None,
    imu: str = MATCHED,
    outages: Outages = (),
) -> Result:
    """Repeat one run of a study, by its number, from 1."""
    setup = make_setup(scenario, config, imu, duration_s, outages)
    own_seed = run_seed(seed, run)
    table = run_table(simulated_run(setup, own_seed))
    asked, length, drawn = _asked(setup, imu, seed, outages)
    columns = (
        ("state", "l", "state:label"),
        ("unit", "l", "unit"),
        ("error", "r", "error"),
        ("sigma from P", "r", "sd"),
        ("error / sigma", "r", "ratio"),
    )
    return Result(
        kind="montecarlo",
        title=f"Run {run} of the Monte Carlo study: {scenario}, {length}, {drawn}",
        sentences=tuple(
            f"{row.filter}: NEES {row.mean_nees:.4g} in the mean over the pings, {row.final_nees:.4g} at the end "
            f"({len(STATES)} expected)"
            for row in table.drop_duplicates("filter").itertuples()
        ),
        tables={"run": table},
        config=config,
        arguments=asked | {"run": run, "run_seed": own_seed},
        display=tuple(
            table_of(f"Errors of {name} at the end of the run", rows, columns)
            for name, rows in table.groupby("filter", sort=False)
        ),
    )


def _asked(
    setup: MonteCarloSetup,
    imu: str,
    seed: int,
    outages: Outages,
) -> tuple[dict[str, Any], str, str]:
    """Return the arguments, the duration, and a text on the random draws."""
    time_ns = setup.exact.imu.time_ns
    duration_s = float(time_ns[-1] - time_ns[0]) * 1e-9
    asked = {"scenario": setup.exact.name, "duration_s": duration_s, "imu": imu, "seed": seed}
    drawn = f"IMU {imu}, seed {seed}"
    spans = ", ".join(f"{start_s:g} to {end_s:g} s" for start_s, end_s in outages)
    if spans:
        drawn += f", no bottom track from {spans}"
    return asked | {"outages": [list(outage) for outage in outages]}, f"{duration_s:g} s", drawn


# --- Screen and pictures.


def _sentences(tables: Mapping[str, pd.DataFrame]) -> Iterator[str]:
    """Yield a sentence on the consistency of each filter, and on the improvement of each candidate."""
    row: Any
    for row in tables["verdicts"].itertuples():
        sentence = f"{row.filter} is {row.verdict}"
        if row.why:
            sentence += f" ({why_in_spite(row.why)})"
        if row.verdict == Consistency.INSUFFICIENT:
            sentence = f"{row.filter}: too few runs for a verdict"
        yield (
            f"{sentence}. Mean NEES {row.mean_nees:.4g} over {row.runs} runs, 95 % interval {row.low:.4g} to "
            f"{row.high:.4g}; inside at {row.inside_pct:.0f} % of the pings"
        )
    baseline, *candidates = tables["verdicts"]["filter"]
    nine = tables["montecarlo"][tables["montecarlo"]["state"].isin([state.id for state in NINE])]
    for name in candidates:
        rows = nine[nine["filter"] == name]
        predicted = _smaller_or_larger(rows["predicted_improvement_pct"].mean())
        true = _smaller_or_larger(rows["true_improvement_pct"].mean())
        against = f"{name} against {baseline}, mean over nine states"
        yield f"{against}: predicted errors {predicted}, true errors {true}"


def _smaller_or_larger(improvement_pct: float) -> str:
    return f"{abs(improvement_pct):.1f} % {'smaller' if improvement_pct >= 0 else 'larger'}"


def _display(tables: Mapping[str, pd.DataFrame]) -> Iterator[DisplayTable]:
    """Lay out the errors of each filter, the verdicts, and the NEES through outages."""
    baseline, *_ = tables["verdicts"]["filter"]
    columns = [
        ("state", "l", "state:label"),
        ("unit", "l", "unit"),
        ("sigma\nfrom P", "r", "final_sd"),
        ("ensemble\nsigma", "r", "ensemble_sd"),
        ("ensemble\nmean", "r", "ensemble_mean"),
        ("rms /\nsigma", "r", "ratio"),
    ]
    gains = [
        ("prediction", "r", "predicted_improvement_pct:percent"),
        ("truth", "r", "true_improvement_pct:percent"),
    ]
    for name, rows in tables["montecarlo"].groupby("filter", sort=False):
        title = f"Predicted and true errors of {name} at the end"
        if name == baseline:
            yield table_of(title, rows, columns)
        else:
            title += f"; predicted and true improvement over {baseline}"
            yield table_of(title, rows, columns + gains)
    yield table_of(
        "NEES: mean over runs and pings, with its 95 % interval",
        tables["verdicts"],
        (
            ("filter", "l", "filter"),
            ("runs", "r", "runs"),
            ("NEES", "r", "mean_nees"),
            ("low", "r", "low"),
            ("high", "r", "high"),
            ("inside", "r", "inside_pct:percent"),
            ("at the end", "r", "final_nees"),
            ("verdict", "l", "verdict"),
        ),
    )
    if "outages" in tables:
        yield table_of(
            f"NEES through outages of the DVL, mean over the runs; {len(STATES)} expected",
            tables["outages"],
            (
                ("filter", "l", "filter"),
                ("from\n[s]", "r", lambda row: f"{row['start_s']:g}"),
                ("to\n[s]", "r", lambda row: f"{row['end_s']:g}"),
                ("before", "r", "nees_before"),
                ("last in\nit", "r", "nees_last"),
                ("after\n1.5 s", "r", "nees_soon"),
                ("after\n60 s", "r", "nees_later"),
                ("at the\nend", "r", "nees_final"),
            ),
        )


def nees_figure(title: str, nees: pd.DataFrame) -> Figure:
    """Draw the mean NEES of each filter over time, from `ensemble.nees_table`, with its interval."""
    low = float(nees["low"][0])
    high = float(nees["high"][0])
    curves = []
    legend = []
    for number, (name, rows) in enumerate(nees.groupby("filter", sort=False)):
        style = filter_style(number)
        curves.append(Curve(rows["time_s"].to_numpy(), rows["mean_nees"].to_numpy(), style))
        legend.append((style, str(name)))
    is_far_above = nees["mean_nees"].max() > FAR_ABOVE * high
    panel = Panel(
        "mean NEES",
        "time [s]",
        tuple(curves),
        levels=(low, high),
        y_scale="log" if is_far_above else "linear",
    )
    caption = "Dashed lines: 95 % interval of a consistent filter."
    return Figure(title, caption, (panel,), (*legend, (LIMIT, "95 % interval")))


def ensemble_figure(
    title: str,
    states: Sequence[State],
    time_s: Floats,
    sd: Floats,
    error_sd: Floats,
    error_mean: Floats,
) -> Figure:
    """Draw sigma from P, ensemble sigma and ensemble mean, (k, 12) in SI, over time, one panel for each state."""
    panels = []
    settled = time_s >= SETTLED * time_s[-1]
    for state in states:
        predicted = sd[:, state.index] / state.factor
        actual = error_sd[:, state.index] / state.factor
        mean = error_mean[:, state.index] / state.factor
        lowest = min(0.0, mean[settled].min())
        highest = max(predicted[settled].max(), actual[settled].max())
        curves = (
            Curve(time_s, actual, REFERENCE),
            Curve(time_s, mean, filter_style(2)),
            Curve(time_s, predicted, SIGMA),
        )
        y_limits = (1.1 * lowest - 0.1 * highest, 1.1 * highest)
        panels.append(
            Panel(f"{state.label} [{state.unit}]", "time [s]", curves, y_limits=y_limits)
        )
    return Figure(
        title,
        "If the filter is consistent, sigma from P is the same as that of the ensemble.",
        tuple(panels),
        (
            (SIGMA, "sigma from P"),
            (REFERENCE, "ensemble sigma"),
            (filter_style(2), "ensemble mean"),
        ),
    )
