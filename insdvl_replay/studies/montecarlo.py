"""The Monte Carlo study: many simulated dives, and whether the filters' uncertainty is as large as their errors."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from insdvl_replay.core.config import Config
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.core.states import STATES
from insdvl_replay.evaluation.ensemble import (
    Ensemble,
    Tally,
    ensemble_table,
    montecarlo_table,
    nees_table,
    outage_table,
    run_table,
    runs_table,
    verdict_table,
)
from insdvl_replay.studies.montecarlo_document import (
    ensemble_figure,
    montecarlo_display,
    montecarlo_sentences,
    nees_figure,
    run_display,
    run_sentences,
)
from insdvl_replay.studies.simulated_run import MATCHED, MonteCarloSetup, make_setup, run_seed, simulated_run
from insdvl_replay.studies.study_report import StudyReport, write_study

PICTURES: Final = {"navigation": STATES[:6], "biases": STATES[6:]}
"""What the two pictures of a filter show."""


def study_montecarlo(
    scenario: str,
    config: Config,
    *,
    runs: int = 100,
    seed: int = 1,
    duration_s: float | None = None,
    imu: str = MATCHED,
    outages: Sequence[tuple[float, float]] = (),
    jobs: int | None = None,
    after_run: Callable[[], object] = lambda: None,
) -> tuple[StudyReport, tuple[Ensemble, ...]]:
    """Simulate a dive many times and hold the filters' uncertainty against their true errors.

    Parameters
    ----------
    scenario : str
        A name in `trajectories.SCENARIOS`.
    runs : int
        At least two.
    seed : int
        Of all runs.
    duration_s : float, optional
        Left out: the scenario's own.
    imu : str
        `MATCHED`, or a name in `sensor_errors.GRADES`.
    outages : sequence of (start_s, end_s)
        Spans in which no beam finds the bottom; with any, there is a table ``outages`` of the NEES through them.
    jobs : int, optional
        Runs at the same time; left out, one for each core. The result does not depend on it.
    after_run : callable
        Called after each run, to show progress.

    Returns
    -------
    tuple of Ensemble
        One for each filter; the first is the baseline.

    Raises
    ------
    ConfigError
        Unknown scenario or grade, or a duration that cannot be.
    """
    setup = make_setup(scenario, config, imu, duration_s, outages)
    seeds = [run_seed(seed, run) for run in range(1, runs + 1)]
    tallies: dict[str, Tally] = {}
    for errors in parallel_map(partial(simulated_run, setup), seeds, jobs):
        for run in errors:
            tallies.setdefault(run.filter, Tally(run)).add(run)
        after_run()
    ensembles = tuple(tally.ensemble() for tally in tallies.values())
    tables = {"montecarlo": montecarlo_table(ensembles), "verdicts": verdict_table(ensembles)}
    if outages:
        tables["outages"] = outage_table(ensembles, outages)
    report = StudyReport(
        study="montecarlo",
        title=f"Monte Carlo study: {scenario}, {_length(setup)}, {runs} runs, {_drawn(imu, seed, outages)}",
        arguments=_arguments(setup, imu, seed, outages) | {"runs": runs},
        sentences=montecarlo_sentences(tables),
        tables=tables,
        display=montecarlo_display(tables),
        config=config,
        series={
            "nees": nees_table(ensembles),
            "ensemble": ensemble_table(ensembles),
            "runs": runs_table(seeds, list(tallies.values())),
        },
    )
    return report, ensembles


def save_montecarlo(report: StudyReport, ensembles: tuple[Ensemble, ...], folder: Path, *, png: bool = False) -> None:
    """Write a study's files into an empty folder; the same study gives the same bytes.

    Parameters
    ----------
    folder : Path
        Exists.
    png : bool
        Draw the pictures as PNG, too.
    """
    pictures = {
        f"{ensemble.filter}_{name}": ensemble_figure(
            f"{ensemble.filter}: {report.title}",
            states,
            *(ensemble.time_s, ensemble.sd, ensemble.error_sd, ensemble.error_mean),
        )
        for ensemble in ensembles
        for name, states in PICTURES.items()
    }
    write_study(report, folder, {"nees": nees_figure(report.title, report.series["nees"]), **pictures}, png=png)


def repeat_run(
    scenario: str,
    config: Config,
    run: int,
    *,
    seed: int = 1,
    duration_s: float | None = None,
    imu: str = MATCHED,
    outages: Sequence[tuple[float, float]] = (),
) -> StudyReport:
    """Repeat one run of a study.

    Parameters
    ----------
    scenario, config, seed, duration_s, imu, outages
        As of `study_montecarlo`.
    run : int
        Its number, from 1.

    Raises
    ------
    ConfigError
        As of `study_montecarlo`.
    """
    setup, own_seed = make_setup(scenario, config, imu, duration_s, outages), run_seed(seed, run)
    table = run_table(simulated_run(setup, own_seed))
    return StudyReport(
        study="montecarlo",
        title=f"Run {run} of the Monte Carlo study: {scenario}, {_length(setup)}, {_drawn(imu, seed, outages)}",
        arguments=_arguments(setup, imu, seed, outages) | {"run": run, "run_seed": own_seed},
        sentences=run_sentences(table),
        tables={"run": table},
        display=run_display(table),
        config=config,
    )


def _length(setup: MonteCarloSetup) -> str:
    return f"{_duration_s(setup):g} s"


def _duration_s(setup: MonteCarloSetup) -> float:
    time_ns = setup.exact.imu.time_ns
    return float(time_ns[-1] - time_ns[0]) * 1e-9


def _drawn(imu: str, seed: int, outages: Sequence[tuple[float, float]]) -> str:
    spans = ", ".join(f"{start_s:g} to {end_s:g} s" for start_s, end_s in outages)
    return f"IMU {imu}, seed {seed}{f', no bottom from {spans}' if spans else ''}"


def _arguments(setup: MonteCarloSetup, imu: str, seed: int, outages: Sequence[tuple[float, float]]) -> dict[str, Any]:
    asked = {"scenario": setup.exact.name, "duration_s": _duration_s(setup), "imu": imu, "seed": seed}
    return asked | {"outages": [list(outage) for outage in outages]}
