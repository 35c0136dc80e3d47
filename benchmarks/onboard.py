"""How often the words on a vehicle's own solution are right, where the truth is known.

`make judge` runs this. The vehicle flies the baseline itself, from a start as wrong as the preset says, and what it
found is judged beside the same baseline: as it is, with errors five times as large, and with a fifth of them. Verdicts
are over groups of dives.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace

import msgspec
import numpy as np
from judged import SIZES, log_ratio_of, record_of, words_of_groups
from results import machine, table, write_part

from insdvl_replay.core.config import Config, Filter, Solution
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, ReferenceColumns, SolutionColumns
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.logs.columns.reference import no_covariances
from insdvl_replay.nav.levelling import drawn_starts
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import simulate_dive

DIVES = 16
LENGTH_S = 400.0
STARTS = 2
GROUPS = 60
SEED = 5
# Smaller than the simulated DVL's: preset mems is cautious about its IMU, and a baseline needs NIS / dof above 0.1.
DVL_SD_MPS = 0.004
PRESETS = ("mems", "tactical")
FACTORS = (1.0, 5.0, 0.2)


def flown_dive(preset: str, config: Config, seed: int, factor: float) -> Dive:
    """Make a dive with what its vehicle found from a start of its own, whose errors are by a factor larger."""
    dive = simulate_dive(
        ("lawnmower", "figure-eight")[seed % 2], seed=seed, duration_s=LENGTH_S, grade=preset
    )
    prepared = prepare_dive(dive, config)
    _, start = drawn_starts(prepared.alignment.start, 2, (seed, 77))
    begun = replace(prepared, alignment=replace(prepared.alignment, start=start))
    onboard = run_one(prepared.filters[0], begun, prepared_timeline(dive, prepared)).motion()
    reference = dive.reference
    assert reference is not None
    onboard = onboard.rows(np.isin(onboard.time_ns, reference.time_ns))
    true = reference.rows(np.isin(reference.time_ns, onboard.time_ns))
    solution = SolutionColumns(_with_errors(onboard, true, factor), None, *no_covariances())
    return replace(dive, solutions={"onboard": solution})


def _with_errors(
    onboard: ReferenceColumns, true: ReferenceColumns, factor: float
) -> ReferenceColumns:
    turn = vector_from_mat(onboard.mat_nb @ np.swapaxes(true.mat_nb, 1, 2))
    return replace(
        onboard,
        position=true.position + factor * (onboard.position - true.position),
        velocity_n=true.velocity_n + factor * (onboard.velocity_n - true.velocity_n),
        mat_nb=mat_from_vector(factor * turn) @ true.mat_nb,
    )


def rows() -> Iterator[tuple[str, ...]]:
    """Count the words of each preset, factor and way in which the start is laid."""
    for preset in PRESETS:
        for factor, align in [*((factor, "none") for factor in FACTORS), (1.0, "heading")]:
            solution = Solution(
                topic="/odometry", align="heading" if align == "heading" else "none"
            )
            filters = {
                "baseline": Filter(aiding=("velocity",)),
                "onboard": Filter(solution=solution),
            }
            given = load_config(preset)
            dvl = msgspec.structs.replace(given.dvl, velocity_sd_mps=DVL_SD_MPS)
            evaluation = msgspec.structs.replace(given.evaluation, starts=STARTS)
            config = msgspec.structs.replace(
                given, filters=filters, dvl=dvl, evaluation=evaluation
            )
            dives = (flown_dive(preset, config, seed, factor) for seed in range(DIVES))
            records = [record_of(replay_dive(dive, config), "onboard") for dive in dives]
            logs = np.array([log_ratio_of(record, "position") for record in records])
            known = logs[np.isfinite(logs)]
            told = (
                f"{np.exp(known.mean()):.2f}, s {known.std(ddof=1):.2f}" if len(known) > 1 else "-"
            )
            words = (
                words_of_groups("onboard", "baseline", records, size, GROUPS, SEED)
                for size in SIZES
            )
            yield preset, f"{factor:g}", align, told, *words


def main() -> None:
    """Measure, print and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    about = (
        f"{DIVES} simulated dives of {LENGTH_S:.0f} s a row, of which {GROUPS} groups of each size are drawn. The "
        "vehicle flew the baseline, from a start as wrong as the preset says, and what it found is judged beside it, "
        "with errors that are by a factor larger. The baseline starts where the reference does, so that a solution "
        "with a start of its own is truly worse. Where it is turned to the baseline's heading, its position is no "
        "evidence, and nothing decides. The ratio of the position "
        "errors is the geometric mean of the dives, with the scatter s of its logarithm; words are in percent of the "
        f"groups. {machine()}."
    )
    lines = [f"| {' | '.join(row)} |" for row in rows()]
    columns = ("preset", "factor", "laid", "position x", *(f"{size} dives" for size in SIZES))
    part = "\n".join(["# The vehicle's own solution", "", about, "", *table(columns, lines)])
    write_part(part)
    sys.stdout.write(f"{part}\n")


if __name__ == "__main__":
    main()
