"""Whether a filter is as sure as it says after an outage of the DVL: mean NEES over many matched setups.

`make bench` runs this. Sensors, start and noise are exactly as the filter believes, preset by preset, so that the mean
NEES of a filter that is right is 12 throughout.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
from results import machine, table, write_part

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.runtime import parallel_map
from insdvl_replay.evaluation.ensemble import RunErrors
from insdvl_replay.sim.dive import exact_dive
from insdvl_replay.studies.montecarlo import make_setup, run_seed, simulated_run

RUNS = 40
SEED = 1
SCENARIO = "lawnmower"
BEFORE_S = 300.0
AFTER_S = 300.0
IMU_RATE_HZ = 50.0
LENGTHS_S = {
    "mems": (0.0, 120.0, 180.0, 300.0, 1200.0, 2400.0),
    "tactical": (0.0, 300.0, 1200.0, 2400.0, 3600.0),
    "fog": (0.0, 1200.0, 3600.0, 7200.0),
}
COLUMNS = (
    "preset",
    "outage [s]",
    "before",
    "last in it",
    "after 1.5 s",
    "after 60 s",
    "at the end",
    "not finite",
)


def runs_through(preset: str, length_s: float) -> list[RunErrors]:
    """Run the preset's baseline through many dives with one outage."""
    config = load_config(preset)
    config = msgspec.structs.replace(
        config, filters={config.baseline: config.filters[config.baseline]}
    )
    outages = [(BEFORE_S, BEFORE_S + length_s)] if length_s else []
    exact = exact_dive(
        SCENARIO,
        duration_s=BEFORE_S + length_s + AFTER_S,
        imu_rate_hz=IMU_RATE_HZ,
        reference_at_pings=True,
        outages=outages,
    )
    setup = replace(make_setup(SCENARIO, config, "matched", 10.0), exact=exact)
    return [
        run
        for (run,) in parallel_map(
            lambda k: simulated_run(setup, run_seed(SEED, k)), range(1, RUNS + 1)
        )
    ]


def nees_at(runs: Sequence[RunErrors], times_s: Sequence[float]) -> Floats:
    """Give the mean NEES over the runs at the last times before some."""
    rows = np.searchsorted(runs[0].time_s, times_s) - 1
    mean: Floats = np.mean([run.nees[rows] for run in runs], axis=0)
    return mean


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows = []
    for preset, lengths_s in LENGTHS_S.items():
        for length_s in lengths_s:
            runs = runs_through(preset, length_s)
            end_s = BEFORE_S + length_s
            means = nees_at(runs, [BEFORE_S, end_s, end_s + 1.5, end_s + 60.0, end_s + AFTER_S])
            broken = sum(not np.isfinite(run.nees).all() for run in runs)
            cells = [
                preset,
                f"{length_s:g}" if length_s else "none",
                *(f"{mean:.1f}" for mean in means),
                str(broken),
            ]
            rows.append(f"| {' | '.join(cells)} |")
    about = (
        f"Mean NEES of the baseline, 12 expected, over {RUNS} runs of `{SCENARIO}` with one outage of the DVL from "
        f"{BEFORE_S:g} s on, and {AFTER_S:g} s after it. The sensors, the IMU at {IMU_RATE_HZ:g} Hz, err exactly "
        f"as the preset says. {machine()}."
    )
    part = "\n".join(["# After an outage", "", about, "", *table(COLUMNS, rows)])
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
