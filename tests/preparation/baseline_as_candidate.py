"""The built-in baseline as a filter of a user's: a class, and as a script a program."""

from dataclasses import replace

import numpy as np

from insdvl_replay.core.config import Config, Filter, Initial
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import DEG
from insdvl_replay.nav.user_candidate import Candidate, CandidateStart, Solution
from insdvl_replay.preparation.prepared import prepare_dive
from insdvl_replay.preparation.run import prepared_timeline, run_one

FITTING = load_config("fog", overrides=["dvl.velocity_sd_mps=0.005"])
"""Settings whose noise is that of the simulated sensors; with another one nothing is evaluated."""


class Baseline(Candidate):
    """The baseline, with its trajectory alone."""

    gives_cov = False

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Run it from the start that is given."""
        initial = Initial(
            source="level", heading_deg=0.0, latitude_deg=float(start.position[0] / DEG)
        )
        filters = {"baseline": Filter(aiding=("velocity",))}
        config = Config(initial=initial, noise=FITTING.noise, dvl=FITTING.dvl, filters=filters)
        prepared = prepare_dive(dive, config)
        alignment = replace(prepared.alignment, start=start, start_ns=start.time_ns)
        mounting = replace(prepared.mounting, lever_arm_b=start.dvl_lever_arm_b)
        prepared = replace(prepared, alignment=alignment, mounting=mounting)
        time_ns = dive.imu.within(start.time_ns, prepared.end_ns).time_ns
        line = prepared_timeline(dive, prepared, time_ns)
        history = run_one(
            prepared.filters[0], prepared, line, cov_ns=time_ns[:: 10 if self.gives_cov else 10**9]
        )
        solution = Solution(history.time_ns, history.position, history.velocity_n, history.mat_nb)
        if not self.gives_cov:
            return solution
        cov = np.full((len(history.cov_ns), 9, 9), np.nan)
        cov[:, :6, :6] = history.cov[:, :6, :6]
        met = history.innovations[0]
        innovation = np.full((len(history.time_ns), 3), np.nan)
        innovation_cov = np.full((len(history.time_ns), 3, 3), np.nan)
        at = np.searchsorted(history.time_ns, met.time_ns)
        innovation[at], innovation_cov[at] = met.innovation, met.sd[:, :, None] ** 2 * np.eye(3)
        return replace(
            solution,
            cov=cov,
            cov_ns=history.cov_ns,
            innovation_b=innovation,
            innovation_cov=innovation_cov,
        )


class BaselineWithCov(Baseline):
    """The baseline, with covariance and innovations."""

    gives_cov = True


class OwnSolution(Solution):
    """A kind of solution that only the module of the class knows."""


class Deriving(Baseline):
    """A class that returns its own kind of solution."""

    def run(self, dive: Dive, start: CandidateStart) -> Solution:
        """Return it."""
        return OwnSolution(**vars(super().run(dive, start)))


if __name__ == "__main__":
    # Processes of the class load this module, and need nothing of it.
    from insdvl_replay.api import run_as_program

    run_as_program(Baseline)
