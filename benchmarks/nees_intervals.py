"""How often the 95 % interval of a mean NEES holds the truth: one dive at a time, over many matched ones.

`make bench` runs this. Sensors, start and noise are exactly as the filter believes, so that the mean NEES of every
quantity is what is expected. Beside it stands how often the interval would hold it by the repetitions of the errors
alone, without what P says of their hanging on slower ones.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np
from results import machine, table, write_part

from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Floats
from insdvl_replay.core.quantities import CREDIBILITY_GROUPS, CREDIBILITY_QUANTITIES
from insdvl_replay.core.tables import CredibilityRow, finite
from insdvl_replay.evaluation.consistency import mean_interval
from insdvl_replay.evaluation.credibility import (
    StateErrors,
    about_vehicle,
    credibility_table,
    state_errors,
    whitened,
)
from insdvl_replay.evaluation.series import samples_in_mean_square
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.studies.montecarlo import MonteCarloSetup, drawn_start, matched_errors, run_seed

DIVES = 200
SEED = 1
DURATION_S = 300.0
SCENARIO: Final = "figure-eight"
PRESETS: Final = ("fog", "tactical", "mems")
COLUMNS: Final = (
    "quantity",
    *(f"{preset}: {what}" for preset in PRESETS for what in ("alone", "held", "samples")),
)


def matched_dives(preset: str, dives: int) -> Iterator[StateErrors]:
    """Run the preset's baseline over dives that it knows all about but what was drawn, the start included."""
    config = load_config(preset)
    config = msgspec.structs.replace(
        config, filters={config.baseline: config.filters[config.baseline]}
    )
    setup = MonteCarloSetup(
        exact_dive(SCENARIO, duration_s=DURATION_S), *matched_errors(config), config
    )
    for seed in (run_seed(SEED, dive) for dive in range(dives)):
        dive = add_errors(setup.exact, setup.imu_errors, setup.dvl_errors, seed)
        if dive.reference is None:
            raise ValueError("a simulated dive has a reference")
        prepared = prepare_dive(dive, config)
        begun = replace(
            prepared, alignment=replace(prepared.alignment, start=drawn_start(setup, seed))
        )
        timeline = prepared_timeline(dive, begun)
        history = run_one(begun.filters[0], begun, timeline, cov_ns=dive.reference.time_ns)
        yield state_errors(history, dive.reference, dive.truth).after(begun.alignment.start_ns)


def judged(errors: StateErrors) -> dict[str, CredibilityRow]:
    """Give the rows of one dive by quantity."""
    return {
        row.quantity: row for row in credibility_table("dive", ["baseline"], {"baseline": errors})
    }


def is_held(row: CredibilityRow) -> bool:
    """Return whether the interval holds the mean NEES of a filter whose true one is expected."""
    return finite(row.low) <= finite(row.mean_nees) <= finite(row.high)


def held_alone(errors: StateErrors, quantity: str) -> bool:
    """Return whether an interval would hold it that is of the repetitions of the errors alone."""
    series = _standardised(errors, quantity)
    low, high = mean_interval(series.shape[1], samples_in_mean_square(series))
    return low <= float(np.mean(np.sum(series**2, axis=1))) <= high


def _standardised(errors: StateErrors, quantity: str) -> Floats:
    if quantity in CREDIBILITY_GROUPS:
        states = CREDIBILITY_GROUPS[quantity]
        return whitened(errors.error[:, states], errors.cov[:, states, states])
    state = CREDIBILITY_QUANTITIES.index(quantity)
    turned = about_vehicle(errors)
    return turned.error[:, [state]] / turned.sd[:, [state]]


def cells_of(
    dives: Sequence[StateErrors], rows: Sequence[dict[str, CredibilityRow]], quantity: str
) -> list[str]:
    """Write how often intervals hold, by the errors alone and as they are, and the median number of samples."""
    alone = 100.0 * float(np.mean([held_alone(errors, quantity) for errors in dives]))
    held = 100.0 * float(np.mean([is_held(row[quantity]) for row in rows]))
    samples = float(np.median([finite(row[quantity].effective_samples) for row in rows]))
    return [f"{alone:.0f} %", f"{held:.0f} %", f"{samples:.1f}"]


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    quantities = [*CREDIBILITY_QUANTITIES, *CREDIBILITY_GROUPS]
    lines = {quantity: [quantity] for quantity in quantities}
    for preset in PRESETS:
        dives = list(matched_dives(preset, DIVES))
        rows = [judged(errors) for errors in dives]
        for quantity in quantities:
            lines[quantity] += cells_of(dives, rows, quantity)
    about = (
        f"Of {DIVES} dives of {DURATION_S:g} s (`{SCENARIO}`; sensors, noise and start exactly as the preset says), "
        "those whose mean NEES is inside the interval that 95 % should be in. *alone*: by how the errors repeat "
        "themselves; *held*: as `credibility.csv` has it, with what hangs on slower errors by P; *samples*: the "
        f"independent ones, median. {machine()}."
    )
    body = table(COLUMNS, [f"| {' | '.join(cells)} |" for cells in lines.values()])
    part = "\n".join(["# Intervals of mean NEES", "", about, "", *body])
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
