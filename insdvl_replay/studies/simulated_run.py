"""One run of a Monte Carlo study: draw errors of the sensors and of the start, and see how far each filter is off."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from insdvl_replay.core.config import Config
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.states import BA, BG, DV, PHI
from insdvl_replay.evaluation.ensemble import RunErrors, run_errors
from insdvl_replay.nav.algebra import rotation_from_vector, vector
from insdvl_replay.nav.dvl import dvl_velocities
from insdvl_replay.nav.levelling import Start
from insdvl_replay.nav.timeline import NO_GAPS
from insdvl_replay.preparation.alignment import Alignment, initial_sd
from insdvl_replay.preparation.filters import dvl_mounting, prepare_sensors, resolve_filters
from insdvl_replay.preparation.prepared import Prepared
from insdvl_replay.preparation.run import prepared_timeline, run_one
from insdvl_replay.sim.dive import add_errors, exact_dive, named
from insdvl_replay.sim.sensor_errors import GRADES, DvlErrors, ImuErrors

MATCHED: Final = "matched"
"""The grade of an IMU, and of the DVL beside it, that errs exactly as the first filter believes."""


@dataclass(frozen=True)
class MonteCarloSetup:
    """What all runs of a study have in common.

    Attributes
    ----------
    exact : Dive
        With perfect sensors; its reference and truth have a row at the start and at each ping.
    imu_errors, dvl_errors
        How large the errors are that each run draws.
    config : Config
        The filters, and how uncertain their start is. What it says of one vehicle's biases, scale, span and log does
        not concern simulated sensors.
    """

    exact: Dive
    imu_errors: ImuErrors
    dvl_errors: DvlErrors
    config: Config


def make_setup(
    scenario: str,
    config: Config,
    imu: str,
    duration_s: float | None = None,
    outages: Sequence[tuple[float, float]] = (),
) -> MonteCarloSetup:
    """Simulate the exact dive and choose the errors of its sensors."""
    grades = {name: (errors, DvlErrors()) for name, errors in GRADES.items()}
    imu_errors, dvl_errors = named("IMU grade", imu, {MATCHED: matched_errors(config), **grades})
    exact = exact_dive(
        scenario,
        duration_s=duration_s,
        reference_at_pings=True,
        outages=outages,
        lever_arm_m=config.dvl.lever_arm_m,
        mounting_rpy_deg=config.dvl.mounting_rpy_deg,
    )
    return MonteCarloSetup(exact, imu_errors, dvl_errors, config)


def matched_errors(config: Config) -> tuple[ImuErrors, DvlErrors]:
    """Return sensor errors by the first filter's Q, R and initial uncertainty."""
    baseline, sd = resolve_filters(config)[0], initial_sd(config.initial)
    imu_errors = ImuErrors(
        accel_bias_sd_mps2=sd[BA][0],
        gyro_bias_sd_radps=sd[BG][0],
        **msgspec.structs.asdict(baseline.inertial_noise),
    )
    noise = baseline.dvl_noise
    return imu_errors, replace(DvlErrors(0.0, 0.0, 0.0, 0.0), **{noise.key: noise.sd_mps})


def run_seed(seed: int, run: int) -> int:
    """Return the seed of one run, from which it can be repeated without the others."""
    return int(np.random.SeedSequence(seed, spawn_key=(run,)).generate_state(1)[0])


def simulated_run(setup: MonteCarloSetup, seed: int) -> tuple[RunErrors, ...]:
    """Draw the errors of one run and replay it through every filter."""
    config, dive = setup.config, add_errors(setup.exact, setup.imu_errors, setup.dvl_errors, seed)
    if dive.reference is None or dive.truth is None:
        raise ValueError("a simulated dive holds its truth")
    start_ns, end_ns = int(dive.imu.time_ns[0]), int(dive.imu.time_ns[-1])
    mounting = replace(dvl_mounting(config), scale=1.0)
    velocities = dvl_velocities(dive.dvl, mounting, config.dvl.max_beam_residual_mps or np.inf)
    filters = resolve_filters(config)
    alignment = Alignment(start_ns, drawn_start(setup, seed), ())
    sensors, _ = prepare_sensors(dive.sensors, config, alignment.start, start_ns, end_ns)
    start = Prepared(velocities, alignment, end_ns, NO_GAPS, mounting, filters, None, sensors, ())
    timeline = prepared_timeline(dive, start)
    histories = (run_one(filter_, start, timeline, cov_ns=dive.reference.time_ns) for filter_ in filters)
    return tuple(run_errors(history, dive.reference, dive.truth) for history in histories)


def drawn_start(setup: MonteCarloSetup, seed: int) -> Start:
    """Start where the exact dive does, off by what the configured initial uncertainty allows.

    Biases are estimated as zero: how large they are is the sensors' part of the draw.
    """
    if setup.exact.reference is None:
        raise ValueError("the filters start from the exact motion")
    # The sensors of `add_errors` draw from the seed's streams 0 to 2.
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    position, velocity_n, mat_nb = (
        column[0]
        for column in (setup.exact.reference.position, setup.exact.reference.velocity_n, setup.exact.reference.mat_nb)
    )
    sd = initial_sd(setup.config.initial)
    turn = np.array(rotation_from_vector(vector(sd[PHI] * rng.standard_normal(3))))
    return Start(position, velocity_n + sd[DV] * rng.standard_normal(3), turn @ mat_nb, np.diag(sd**2))
