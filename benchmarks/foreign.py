"""How often the words on a filter of the user's are right, where the truth is known.

`make judge` runs this. The filter is a Python class: it runs the baseline, and its errors are then those of the
baseline times a factor. One factor is two. The other is drawn for each dive, as often above one as below, so that
nobody can say over many dives that this filter is better or worse. Verdicts are over disjoint groups of dives.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import msgspec
import numpy as np
from results import machine, table, write_part

from insdvl_replay.core.config import Config, Evaluation, Filter, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.core.tables import EvidenceRow
from insdvl_replay.core.words import Verdict
from insdvl_replay.evaluation.answers import pooled_candidate
from insdvl_replay.geometry.rotation import mat_from_vector, vector_from_mat
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.programs import UserProcesses, solution_of_class
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.preparation.solutions import interpolated, interpolated_attitude
from insdvl_replay.replay import replay_dive
from insdvl_replay.sim.dive import simulate_dive

GROUPS, POOLED, LENGTH_S, STARTS = 60, 8, 300.0, 4
SPREAD = 0.3  # standard deviation of the logarithm of the factor that is drawn
PRESET = "mems"
TRUTH = "FOREIGN_TRUTH"  # names the file with the exact motion and the factors
WORDS = ("better", "worse", "mixed", "equivalent", "undecided", "not evaluated")
FILTERS = {"twice": "twice the errors", "equal": "equal on average"}


class Scaled(Candidate):
    """The baseline, with errors times a factor."""

    name = ""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Run the baseline from the start that is given."""
        initial = Initial(source="level", heading_deg=0.0, latitude_deg=float(start.position[0] / DEG))
        config = msgspec.structs.replace(
            settings(), initial=initial, filters={"baseline": Filter(aiding=("velocity",))}
        )
        prepared = prepare_dive(dive, config)
        alignment = replace(prepared.alignment, start=start, start_ns=start.time_ns)
        prepared = replace(prepared, alignment=alignment)
        time_ns = dive.imu.within(start.time_ns, prepared.end_ns).time_ns[::5]
        found = run_one(prepared.filters[0], prepared, prepared_timeline(dive, prepared, time_ns))
        with np.load(os.environ[TRUTH]) as truth:
            true_ns, factor = truth["time_ns"], float(truth[self.name])
            position, velocity_n = (
                interpolated(true_ns, truth[name], found.time_ns) for name in ("position", "velocity_n")
            )
            mat_nb = interpolated_attitude(true_ns, truth["mat_nb"], found.time_ns)
        turn = vector_from_mat(found.mat_nb @ np.swapaxes(mat_nb, 1, 2))
        return Solution(
            found.time_ns,
            position + factor * (found.position - position),
            velocity_n + factor * (found.velocity_n - velocity_n),
            mat_from_vector(factor * turn) @ mat_nb,
        )


class Twice(Scaled):
    """Twice the errors."""

    name = "twice"


class Equal(Scaled):
    """A factor that is drawn for each dive."""

    name = "equal"


def settings() -> Config:
    """Return the settings of the baseline and of both filters."""
    filters = {"baseline": Filter(aiding=("velocity",))}
    filters |= {name: Filter(candidate=f"foreign:{name.title()}") for name in FILTERS}
    return msgspec.structs.replace(load_config(PRESET), filters=filters, evaluation=Evaluation(starts=STARTS))


def evidence_of_dive(seed: int) -> dict[str, list[EvidenceRow]]:
    """Simulate and replay one dive; return the evidence by filter."""
    dive = simulate_dive(
        ("lawnmower", "figure-eight")[seed % 2], seed=seed, duration_s=LENGTH_S, grade=PRESET, imu_rate_hz=25.0
    )
    motion, factor = dive.reference, np.exp(SPREAD * np.random.default_rng((seed, 77)).standard_normal())
    assert motion is not None
    with tempfile.TemporaryDirectory() as folder:
        os.environ[TRUTH] = str(Path(folder, "truth.npz"))
        columns = {"position": motion.position, "velocity_n": motion.velocity_n, "mat_nb": motion.mat_nb}
        np.savez(os.environ[TRUTH], time_ns=motion.time_ns, twice=2.0, equal=factor, **columns)
        config = settings()
        config = msgspec.structs.replace(config, evaluation=msgspec.structs.replace(config.evaluation, seed=seed))
        with patch.object(UserProcesses, "run", _run_here):
            replay = replay_dive(dive, config)
    return {
        name: [row for row in replay.tables.evidence if row.filter == name]
        if replay.verdicts[name].verdict != Verdict.NOT_EVALUATED
        else []
        for name in FILTERS
    }


def _run_here(processes: UserProcesses, run: str, dive_file: Path, start: CandidateStart) -> Solution:
    """Run the class in this process: words do not depend on it, and a new interpreter takes longer than the filter."""
    return solution_of_class(processes.settings.candidate or "", dive_file, start)


def words(groups: int, jobs: int) -> Iterator[tuple[str, Counter[str]]]:
    """Count the words on each filter over disjoint groups of dives."""
    with ProcessPoolExecutor(jobs) as pool:
        dives = list(pool.map(evidence_of_dive, range(groups * POOLED)))

    def word(name: str, of_group: Sequence[dict[str, list[EvidenceRow]]]) -> str:
        evaluated = [dive[name] for dive in of_group if dive[name]]
        return str(pooled_candidate(name, "baseline", evaluated, len(of_group)).verdict)

    for name in FILTERS:
        yield name, Counter(word(name, dives[first : first + POOLED]) for first in range(0, len(dives), POOLED))


def main() -> None:
    """Measure, print and write the page; exit with 1 if the rates are not as they must be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--groups", type=int, default=GROUPS)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    found = dict(words(given.groups, given.jobs))
    about = (
        f"{given.groups} groups of {POOLED} simulated dives of {LENGTH_S:.0f} s, with {STARTS} starts each. The filter "
        "is a Python class with the errors of the baseline times two, or times a factor that is drawn for each dive, "
        f"as often above one as below. {machine()}."
    )
    lines = [
        f"| {FILTERS[name]} | {' | '.join(str(counts[word]) for word in WORDS)} |" for name, counts in found.items()
    ]
    part = "\n".join(["# A filter of the user's", "", about, "", *table(("filter", *WORDS), lines)])
    write_part(part)
    sys.stdout.write(f"{part}\n")
    wrong = given.groups - found["twice"]["worse"], found["equal"]["better"] + found["equal"]["worse"]
    raise SystemExit(int(wrong[0] > 0 or wrong[1] > given.groups // 60))


if __name__ == "__main__":
    main()
