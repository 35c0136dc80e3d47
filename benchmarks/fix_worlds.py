"""Surveys with fixes of the position: whether the verdict sees what good ones gain, and what bad ones cost.

A filter that is aided by a fix a minute is held against one that has none, over two hours. In the first world every fix
errs as it says. In the second one fifth are off by tens of metres, as acoustic fixes are that were reflected, and no
gate keeps them out. `python benchmarks/fix_worlds.py` prints what is seen of each dive, and the verdict on all of them.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Final

import msgspec
import numpy as np
from worlds import Harm, World

from insdvl_replay.core.config import Config, Evaluation, Filter, Position
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, SensorColumns
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.evaluation.sentences import headline
from insdvl_replay.geometry.frames import moved_position
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.sim.dive import add_errors, exact_dive
from insdvl_replay.studies.montecarlo import matched_errors

DIVES: Final = 8
SEED: Final = 32
FIX_SD_M = 2.0
BAD_SD_M = 23.0
BAD_SHARE = 0.2
WAY: Final = {"duration_s": 7200.0, "imu_rate_hz": 25.0, "reference_rate_hz": 1.0}


def fixes(
    dive: Dive, rng: np.random.Generator, *, every_s: int = 60, bad_share: float = 0.0
) -> Dive:
    """Add fixes to a simulated dive whose reference, which is exact, has 1 Hz; a share of them is far off."""
    if dive.reference is None:
        raise ValueError("a simulated dive has a reference")
    known = dive.reference.rows(np.arange(len(dive.reference.time_ns)) % every_s == every_s // 2)
    sd_m = np.where(rng.random((len(known.time_ns), 1)) < bad_share, BAD_SD_M, FIX_SD_M)
    off_m = sd_m * rng.standard_normal((len(sd_m), 3))
    values = moved_position(known.position, off_m * [1.0, 1.0, 0.0])[:, :2]
    return replace(dive, sensors={"position": SensorColumns(known.time_ns, values)})


def _world(name: str, config: Config, harm: Harm) -> World:
    filters = {
        "baseline": Filter(aiding=("velocity",)),
        "fixed": Filter(aiding=("velocity", "position")),
    }
    config = msgspec.structs.replace(config, filters=filters, position=Position(sd_m=FIX_SD_M))
    return World(name, config, *matched_errors(config), WAY, harm)


FIX_WORLDS: Final = (
    _world("good fixes", load_config("fog"), fixes),
    _world("one fix in five is bad", load_config("fog"), partial(fixes, bad_share=BAD_SHARE)),
)


def lines(world: World, dives: int, starts: int) -> Iterator[str]:
    """Replay dives of a world, a line each, and judge all of them together."""
    evidence: list[list[EvidenceRow]] = []
    config = world.config
    exact = exact_dive("figure-eight", **world.way)
    for dive in range(dives):
        errors_rng, harm_rng = np.random.SeedSequence(SEED, spawn_key=(dive,)).spawn(2)
        made = add_errors(
            exact, world.imu_errors, world.dvl_errors, int(errors_rng.generate_state(1)[0])
        )
        made = replace(world.harm(made, np.random.default_rng(harm_rng)), name=f"dive {dive + 1}")
        replay = replay_dive(
            made, msgspec.structs.replace(config, evaluation=Evaluation(starts=starts, seed=dive))
        )
        (found,) = replay.verdicts.values()
        rows = replay.tables.evidence
        not_evaluated = (
            f"; not evaluated: {found.reason}" if found.verdict == Verdict.NOT_EVALUATED else ""
        )
        if not not_evaluated:
            evidence.append(rows)
        told = {row.quantity: f"{row.baseline:.2f} -> {row.value:.2f} {row.unit}" for row in rows}
        ratios = {row.quantity: row.ratio for row in rows}
        nis = next(row for row in replay.tables.consistency if row.measurement == "position")
        yield (
            f"position {told['position']}, at the end {told['position_end']}, "
            f"drift in 60 s {ratios['drift_60s']:.3f}, outages of 60 s {ratios['outage_60s']:.3f}, "
            f"NIS of fixes {nis.mean_nis:.3g} ({nis.dof} expected){not_evaluated}"
        )
    yield headline(pooled_candidate("fixed", "baseline", evidence, dives))


def main() -> None:
    """Print the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dives", type=int, default=DIVES, help="in each world")
    parser.add_argument("--starts", type=int, default=16)
    arguments = parser.parse_args()
    for world in FIX_WORLDS:
        sys.stdout.write(f"\n{world.name}\n")
        for line in lines(world, arguments.dives, arguments.starts):
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
