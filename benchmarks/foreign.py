"""How often the words on a filter of the user's are right, where the truth is known.

`make judge` runs this. The filter is a Python class: it runs the baseline, and its errors are then those of the
baseline times two. Verdicts are over disjoint groups of dives. Factors that scatter are in `scatter_worlds`.
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from judged import SIZES, Record, classes_run_here, record_of, verdict_over
from results import machine, table, write_part

from insdvl_replay.core.config import Config, Evaluation, Filter, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.core.words import Verdict
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude
from insdvl_replay.sim.dive import simulate_dive

GROUPS = 12
LENGTH_S = 300.0
STARTS = 2
PRESET = "tactical"
# As a simulated DVL errs; the preset's is too large for the baseline to be judged by.
DVL_SD_MPS = 0.006
TRUTH = "FOREIGN_TRUTH"  # names the file with the exact motion
FACTOR = 2.0
NAME = "twice"


class Twice(Candidate):
    """The baseline, with twice the errors."""

    name = NAME

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Run the baseline from the start that is given."""
        initial = Initial(
            source="level", heading_deg=0.0, latitude_deg=float(start.position[0] / DEG)
        )
        config = msgspec.structs.replace(
            settings(), initial=initial, filters={"baseline": Filter(aiding=("velocity",))}
        )
        prepared = prepare_dive(dive, config)
        alignment = replace(prepared.alignment, start=start, start_ns=start.time_ns)
        prepared = replace(prepared, alignment=alignment)
        time_ns = dive.imu.within(start.time_ns, prepared.end_ns).time_ns[::5]
        found = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared, time_ns))
        with np.load(os.environ[TRUTH]) as truth:
            true_ns = truth["time_ns"]
            # A run in which all stamps are a microsecond later ends behind the exact motion.
            at_ns = np.minimum(found.time_ns, true_ns[-1])
            position, velocity_n = (
                interpolated(true_ns, truth[name], at_ns) for name in ("position", "velocity_n")
            )
            mat_nb = interpolated_attitude(true_ns, truth["mat_nb"], at_ns)
        turn = vector_from_mat(found.mat_nb @ np.swapaxes(mat_nb, 1, 2))
        return Solution(
            found.time_ns,
            position + FACTOR * (found.position - position),
            velocity_n + FACTOR * (found.velocity_n - velocity_n),
            mat_from_vector(FACTOR * turn) @ mat_nb,
        )


def settings() -> Config:
    """Return the settings of the baseline and of the filter."""
    preset = load_config(PRESET)
    filters = {"baseline": Filter(aiding=("velocity",)), NAME: Filter(candidate="foreign:Twice")}
    dvl = msgspec.structs.replace(preset.dvl, velocity_sd_mps=DVL_SD_MPS)
    return msgspec.structs.replace(
        preset, dvl=dvl, filters=filters, evaluation=Evaluation(starts=STARTS)
    )


def record_of_dive(seed: int) -> Record:
    """Simulate and replay one dive; return what verdicts over dives are made of."""
    dive = simulate_dive(
        ("lawnmower", "figure-eight")[seed % 2],
        seed=seed,
        duration_s=LENGTH_S,
        grade=PRESET,
        imu_rate_hz=25.0,
    )
    motion = dive.reference
    assert motion is not None
    with tempfile.TemporaryDirectory() as folder:
        os.environ[TRUTH] = str(Path(folder, "truth.npz"))
        columns = {
            "position": motion.position,
            "velocity_n": motion.velocity_n,
            "mat_nb": motion.mat_nb,
        }
        np.savez(os.environ[TRUTH], time_ns=motion.time_ns, **columns)
        with classes_run_here():
            return record_of(replay_dive(dive, settings()), NAME)


def words(groups: int, jobs: int) -> dict[int, Counter[str]]:
    """Count the words over disjoint groups of dives, by their size."""
    dives = range(groups * max(SIZES))
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        records = list(pool.map(record_of_dive, dives))
    found = {}
    for size in SIZES:
        firsts = range(0, len(records) - size + 1, size)
        found[size] = Counter(
            verdict_over(NAME, "baseline", records[first : first + size]) for first in firsts
        )
    return found


def main() -> None:
    """Measure, print and write the page; exit with 1 if a group has another word than *worse*."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--groups", type=int, default=GROUPS, help="of the largest size")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    found = words(given.groups, given.jobs)
    about = (
        f"{given.groups * max(SIZES)} simulated dives of {LENGTH_S:.0f} s in disjoint groups. The filter is a Python "
        f"class with the errors of the baseline times {FACTOR:g}: *worse* is right. {machine()}."
    )
    said = [word for word in Verdict if any(counts[word] for counts in found.values())]
    lines = [
        f"| {size} | {counts.total()} | {' | '.join(str(counts[word]) for word in said)} |"
        for size, counts in found.items()
    ]
    columns = ("dives", "groups", *map(str, said))
    part = "\n".join(["# A filter of the user's", "", about, "", *table(columns, lines)])
    write_part(part)
    sys.stdout.write(f"{part}\n")
    raise SystemExit(int(any(set(counts) != {str(Verdict.WORSE)} for counts in found.values())))


if __name__ == "__main__":
    main()
