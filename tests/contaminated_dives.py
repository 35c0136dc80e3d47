"""Dives of which a share of the pings is far off, and filters that are told the truth of all others."""

from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np
from matched_sensors import MATCHED

from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Initial
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.studies.simulated_run import matched_errors

SHARE = 0.05
BEAM_SD_MPS = 0.01
CANDIDATES: tuple[Literal["adaptive", "student-t"], ...] = ("adaptive", "student-t")


def competitors(aiding: str, starts: int) -> Config:
    """Aid a filter that believes what it is told of the noise, and one of each kind that does not."""
    return msgspec.structs.replace(
        MATCHED,
        dvl=Dvl(beam_sd_mps=BEAM_SD_MPS),
        initial=Initial(accel_bias_sd_mg=1.0, gyro_bias_sd_degph=0.1),
        evaluation=Evaluation(starts=starts),
        filters={
            "baseline": Filter(aiding=(aiding,)),
            **{name: Filter(aiding=(aiding,), dvl_noise=name) for name in CANDIDATES},
        },
    )


def contaminated_dive(seed: int, length_s: float, off_by_mps: float) -> Dive:
    """Simulate a lawnmower; a twentieth of its pings is off along each beam by so much (sd), if by anything."""
    imu_errors, dvl_errors = matched_errors(competitors("beams", 1))
    dive = simulate_dive("lawnmower", seed=seed, duration_s=length_s, imu_errors=imu_errors, dvl_errors=dvl_errors)
    assert dive.dvl.beam_velocity_mps is not None
    rng, beams = np.random.default_rng(seed), dive.dvl.beam_velocity_mps.copy()
    hit = rng.random(len(beams)) < SHARE
    beams[hit] += rng.normal(scale=off_by_mps, size=(int(hit.sum()), beams.shape[1]))
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))
