"""Whether the filter is as good as it says, on worlds drawn from its own model: noise, biases and start."""

from dataclasses import dataclass, replace
from functools import partial

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from insdvl_replay.core.config import Acceleration, Config, Dvl, Filter, Initial, Noise
from insdvl_replay.core.config_file import load_config
from insdvl_replay.core.dive_columns import Dive, Floats, ReferenceColumns
from insdvl_replay.core.history import History
from insdvl_replay.core.states import DEG_PER_HOUR, DV, MG, PHI
from insdvl_replay.preparation.replay import replay_dive
from insdvl_replay.preparation.start_sources import initial_sd
from insdvl_replay.sim.dive import START_NS, add_errors, exact_dive
from insdvl_replay.sim.sensor_errors import DvlErrors, ImuErrors
from insdvl_replay.studies.montecarlo import make_setup, run_seed, simulated_run

RUNS, SEED = 50, 1
TIMES_S = np.array(
    [10.0, 60.0, 105.0, 150.0]
)  # settled, at the end of the long leg, in a turn, after two turns

BEAM_SD_MPS = 0.0042
DENSITIES = {
    "accel_white_mps_rts": 5e-3,
    "gyro_white_rad_rts": 4.4e-5,
    "accel_bias_walk_mps2_rts": 2e-5,
    "gyro_bias_walk_radps_rts": 8e-8,
}
IMU_ERRORS = ImuErrors(
    accel_bias_sd_mps2=3.0 * MG, gyro_bias_sd_radps=10.0 * DEG_PER_HOUR, **DENSITIES
)
DVL_ERRORS = DvlErrors(
    beam_sd_mps=BEAM_SD_MPS, beam_bias_sd_mps=0.0, beam_scale_sd=0.0, beam_quantum_mps=0.0
)
AIDED = partial(Filter, aiding=("velocity", "acceleration"))
CONFIG = Config(
    noise=Noise(**DENSITIES),
    initial=Initial(
        uncertainty="settings", velocity_sd_mps=0.1, accel_bias_sd_mg=3.0, gyro_bias_sd_degph=10.0
    ),
    dvl=Dvl(beam_sd_mps=BEAM_SD_MPS),
    filters={
        "baseline": Filter(aiding=("velocity",)),
        "windowed": AIDED(acceleration=Acceleration(model="windowed")),
        "published": AIDED(acceleration=Acceleration(model="published")),
    },
)


@dataclass(frozen=True)
class Consistency:
    """Mean over the runs, by filter: NEES at `TIMES_S`, and NIS of the velocity over all pings."""

    nees: dict[str, Floats]
    nis: dict[str, float]
    pings: int


@pytest.fixture(scope="module")
def consistency() -> Consistency:
    exact = exact_dive("figure-eight", duration_s=float(TIMES_S[-1]), imu_rate_hz=50.0)
    runs = [histories_of(exact, SEED + run) for run in range(RUNS)]
    nees = {name: np.mean([run[name][0] for run in runs], axis=0) for name in CONFIG.filters}
    nis = {name: float(np.mean([run[name][1] for run in runs])) for name in CONFIG.filters}
    return Consistency(nees, nis, RUNS * len(exact.dvl.time_ns))


def histories_of(exact: Dive, seed: int) -> dict[str, tuple[Floats, float]]:
    """Draw a world and a start, and give each filter's NEES and mean NIS."""
    assert exact.reference is not None
    spoiled = add_errors(exact, IMU_ERRORS, DVL_ERRORS, seed)
    start = wrong_start(
        exact.reference, initial_sd(CONFIG.initial), np.random.default_rng([seed, 12])
    )
    replay = replay_dive(replace(spoiled, reference=start), CONFIG, keep_cov=True)
    spoiled = replace(spoiled, reference=exact.reference)
    return {
        history.filter: (nees(history, spoiled), float(history.innovations[0].nis.mean()))
        for history in replay.histories
    }


def wrong_start(
    reference: ReferenceColumns, sd: Floats, rng: np.random.Generator
) -> ReferenceColumns:
    """Move the first row, where the filters start, as far off the motion as their sd says."""
    velocity_n, mat_nb = reference.velocity_n.copy(), reference.mat_nb.copy()
    velocity_n[0] += sd[DV] * rng.standard_normal(3)
    mat_nb[0] = Rotation.from_rotvec(sd[PHI] * rng.standard_normal(3)).as_matrix() @ mat_nb[0]
    return replace(reference, velocity_n=velocity_n, mat_nb=mat_nb)


def nees(history: History, truth: Dive) -> Floats:
    """Give ``x' P^-1 x`` at `TIMES_S`, with x as the filter defines it; a bias left in the readings is true minus
    estimated."""
    assert truth.reference is not None
    assert truth.truth is not None
    at_ns = START_NS + (TIMES_S * 1e9).astype(np.int64)
    ours, theirs = (
        np.searchsorted(history.time_ns, at_ns),
        np.searchsorted(truth.reference.time_ns, at_ns),
    )
    turned = history.mat_nb[ours] @ np.swapaxes(truth.reference.mat_nb[theirs], 1, 2)
    error = np.hstack(
        [
            history.velocity_n[ours] - truth.reference.velocity_n[theirs],
            Rotation.from_matrix(turned).as_rotvec(),
            truth.truth.accel_bias_b[theirs] - history.accel_bias_b[ours],
            truth.truth.gyro_bias_b[theirs] - history.gyro_bias_b[ours],
        ]
    )
    of_cov = np.searchsorted(history.cov_ns, at_ns)
    whitened = np.linalg.solve(history.cov[of_cov], error[..., None])[..., 0]
    return np.asarray(np.sum(error * whitened, axis=1))


def mean_interval(dof: int, count: int) -> tuple[float, float]:
    """Give the 95 % interval of the mean of chi-square variables."""
    tails = chi2(dof * count)
    return float(tails.ppf(0.025)) / count, float(tails.ppf(0.975)) / count


@pytest.mark.nightly
def test_baseline_is_as_good_as_it_says(consistency: Consistency) -> None:
    low, high = mean_interval(12, RUNS)
    assert (consistency.nees["baseline"] > low).all()
    assert (consistency.nees["baseline"] < high).all()


@pytest.mark.nightly
def test_baselines_innovations_are_as_large_as_it_says(consistency: Consistency) -> None:
    low, high = mean_interval(3, consistency.pings)
    assert low < consistency.nis["baseline"] < high


@pytest.mark.nightly
def test_published_acceleration_makes_the_filter_predict_too_much(
    consistency: Consistency,
) -> None:
    _, high = mean_interval(12, RUNS)
    assert (consistency.nees["published"] > 3.0 * high).all(), (
        "white noise of one sample taken for the window's"
    )
    assert consistency.nees["published"][2:].min() > 100.0 * high, "in a turn it leaves out w x v"


@pytest.mark.nightly
def test_windowed_acceleration_predicts_too_much_for_using_velocities_twice(
    consistency: Consistency,
) -> None:
    _, high = mean_interval(12, RUNS)
    assert (consistency.nees["windowed"] > high).all()
    assert (consistency.nees["windowed"] < 3.0 * high).all()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("preset", "start_s", "end_s", "end_of_dive_s", "highest"),
    [
        ("mems", 300.0, 300.0, 600.0, 18.0),
        ("mems", 300.0, 420.0, 600.0, 18.0),
        ("mems", 300.0, 480.0, 600.0, 18.0),
        ("mems", 300.0, 600.0, 720.0, 18.0),
        ("tactical", 300.0, 1500.0, 1800.0, 25.0),
    ],
)
def test_filter_comes_back_from_an_outage_as_sure_as_it_says(
    preset: str, start_s: float, end_s: float, end_of_dive_s: float, highest: float
) -> None:
    """Misalignments of some degrees meet velocities that have drifted by tens of m/s: the retraction must be exact."""
    config = load_config(preset)
    config = replace_filters(config, {"baseline": config.filters["baseline"]})
    exact = exact_dive(
        "lawnmower",
        duration_s=end_of_dive_s,
        imu_rate_hz=50.0,
        reference_at_pings=True,
        outages=[(start_s, end_s)] if end_s > start_s else [],
    )
    world = replace(make_setup("lawnmower", config, "matched", 10.0), exact=exact)
    runs = [simulated_run(world, run_seed(SEED, run))[0] for run in range(40)]
    nees = np.array([run.nees for run in runs])
    assert np.isfinite(nees).all()
    later = np.searchsorted(runs[0].time_s, [end_s + 1.5, end_s + 60.0, end_of_dive_s]) - 1
    assert (nees.mean(axis=0)[later] < highest).all()
    assert (nees.mean(axis=0)[later] > 8.0).all()


def replace_filters(config: Config, filters: dict[str, Filter]) -> Config:
    return msgspec.structs.replace(config, filters=filters)


@pytest.mark.nightly
def test_heading_is_as_sure_as_it_says_where_corrections_are_as_large_as_the_velocity() -> None:
    """The paper's noise moves a lawnmower's 0.17 m/s by as much between two pings, and a correction moves it back."""
    config = Config(filters={"baseline": Filter(aiding=("velocity",))})
    exact = exact_dive("lawnmower", reference_at_pings=True, imu_rate_hz=10.0)
    world = replace(make_setup("lawnmower", config, "matched"), exact=exact)
    runs = [simulated_run(world, run_seed(SEED, run))[0] for run in range(RUNS)]
    low, high = mean_interval(12, RUNS)
    assert low < np.mean([run.nees[-1] for run in runs]) < high
    heading_error = np.array([run.error[-1, PHI][2] for run in runs])
    heading_var = np.mean([run.var[-1, PHI][2] for run in runs])
    assert np.sqrt(np.mean(heading_error**2) / heading_var) < 1.3
