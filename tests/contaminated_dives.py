"""Dives with pings that are far off, or noisier than they were, and filters that are told the truth of all others."""

from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np
from matched_sensors import MATCHED
from numpy.typing import NDArray

from insdvl_replay.core.config import Config, Dvl, Evaluation, Filter, Initial
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.sim.dive import simulate_dive
from insdvl_replay.studies.montecarlo import matched_errors

SHARE = 0.05
BEAM_SD_MPS = 0.01
CANDIDATES: tuple[Literal["adaptive", "student-t"], ...] = ("adaptive", "student-t")


def competitors(aiding: str, starts: int, states: tuple[str, ...] = ()) -> Config:
    """Aid a filter that believes what it is told of the noise, and one of each kind that does not."""
    return msgspec.structs.replace(
        MATCHED,
        dvl=Dvl(beam_sd_mps=BEAM_SD_MPS),
        initial=Initial(accel_bias_sd_mg=1.0, gyro_bias_sd_degph=0.1),
        evaluation=Evaluation(starts=starts),
        filters={
            "baseline": Filter(aiding=(aiding,), states=states),
            **{
                name: Filter(aiding=(aiding,), states=states, dvl_noise=name)
                for name in CANDIDATES
            },
        },
    )


def clean_dive(seed: int, length_s: float) -> Dive:
    """Simulate a lawnmower whose sensors err as the filters are told."""
    imu_errors, dvl_errors = matched_errors(competitors("beams", 1))
    return simulate_dive(
        "lawnmower", seed=seed, duration_s=length_s, imu_errors=imu_errors, dvl_errors=dvl_errors
    )


def contaminated_dive(seed: int, length_s: float, off_by_mps: float) -> Dive:
    """Simulate one of which a twentieth of the pings is off along each beam by so much (sd)."""
    hit = np.random.default_rng(seed).random(round(length_s) + 1) < SHARE
    return _with_errors(clean_dive(seed, length_s), hit, off_by_mps, seed)


def noisier_dive(seed: int, length_s: float, times: float) -> Dive:
    """Simulate one whose beams are so many times as noisy from the middle on."""
    late = np.arange(round(length_s) + 1) > length_s / 2.0
    return _with_errors(
        clean_dive(seed, length_s), late, BEAM_SD_MPS * float(np.sqrt(times**2 - 1.0)), seed
    )


def _with_errors(dive: Dive, hit: NDArray[np.bool_], sd_mps: float, seed: int) -> Dive:
    """Add errors to the beams of the pings that are hit, a ping a second."""
    assert dive.dvl.beam_velocity_mps is not None
    beams = dive.dvl.beam_velocity_mps.copy()
    hit = hit[: len(beams)]
    beams[hit] += np.random.default_rng((seed, 1)).normal(
        scale=sd_mps, size=(int(hit.sum()), beams.shape[1])
    )
    return replace(dive, dvl=replace(dive.dvl, beam_velocity_mps=beams))
